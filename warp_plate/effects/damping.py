"""Viscous damping."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from warp_plate.effects.effect import Effect, Panel, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit

# Loss factor at the drive's frequency, typical of plastics and glued joints.
TYPICAL_LOSS = 0.02


class Damping(Effect):
    """Viscous damping, c u̇ on the left of the equation of motion."""

    viscous: Annotated[NotNegative, Unit("N·s/m³"), Field(examples=[88.0])]
    """Damping c."""
    scheme: Annotated[Literal["centred", "backward"], Field(examples=["backward"])] = "centred"
    """Velocity that is damped: "centred" in the step (second order, same stability limit), or "backward", from the
    last half-step, as in equation (6) of the source paper (first order, lower limit)."""

    damping_keys = ("viscous",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("damping", self.viscous)

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        plate = setting.plate
        viscous = TYPICAL_LOSS * setting.angular_frequency * plate.density * plate.thickness
        return cls(viscous=viscous), f"{viscous:.2g} N·s/m³ (loss factor {TYPICAL_LOSS:g})"
