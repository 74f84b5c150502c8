"""Rigidities of an orthotropic plate."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from warp_plate.effects.effect import Effect, Setting
from warp_plate.scene.fields import Moderate, Positive, Unit

# Largest ratio of two rigidities. Beyond it rounding gives rigid motions stiffness and hides the smaller one.
APART = 1e9


class Orthotropic(Effect):
    """An orthotropic plate: Mx = Dx u_xx + D1 u_yy, My = D1 u_xx + Dy u_yy, Mxy = 2 Dxy u_xy.

    The rigidities [N·m] replace D = EH³/12(1 − ν²) of an isotropic plate, for which Dx = Dy = D, D1 = νD and
    Dxy = (1 − ν)D/2.
    """

    Dx: Annotated[Positive, Unit("N·m"), Field(examples=[0.012])]
    """Bending rigidity along x."""
    Dy: Annotated[Positive, Unit("N·m"), Field(examples=[0.01])]
    """Bending rigidity along y."""
    D1: Annotated[Moderate, Unit("N·m"), Field(examples=[0.003])]
    """Coupling between both directions; D1² must be below Dx Dy."""
    Dxy: Annotated[Positive, Unit("N·m"), Field(examples=[0.004])]
    """Twisting rigidity."""

    in_kernels = False

    @model_validator(mode="after")
    def _positive_definite(self) -> Orthotropic:
        if self.Dx * self.Dy * (1 - 1e-9) <= self.D1**2:
            root = (self.Dx * self.Dy) ** 0.5
            raise ValueError(f"D1: {self.D1:g} N·m gives negative energies; |D1| must be below √(Dx Dy) = {root:g}")
        return self

    @model_validator(mode="after")
    def _comparable(self) -> Orthotropic:
        (least, soft), *_, (largest, stiff) = sorted((getattr(self, key), key) for key in ("Dx", "Dy", "Dxy"))
        if largest > APART * least:
            hides = f"{largest:g} N·m hides {soft} = {least:g} N·m in rounding"
            raise ValueError(f"{stiff}: {hides}; write at most {APART * least:g}")
        return self

    @property
    def rigidities(self) -> tuple[float, float, float, float]:
        """Dx, D1, Dy, Dxy [N·m]."""
        return self.Dx, self.D1, self.Dy, self.Dxy

    @property
    def section_keys(self) -> tuple[str, ...]:
        return ("",)

    def scaled(self, stiffness: float, thickness: float, damping: float) -> dict[str, Any]:
        return {key: value * stiffness * thickness**3 for key, value in self.model_dump().items()}  # in place of EH³

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        bending, ratio = setting.plate.rigidity, setting.plate.poisson_ratio
        table = cls(Dx=1.1 * bending, Dy=bending, D1=ratio * bending, Dxy=(1 - ratio) / 2 * bending)
        return table, "Dx a tenth above that of the isotropic plate"
