"""The table ``[plate]``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from warp_plate.scene.fields import Density, Point, Positive, Table, Unit, YoungModulus


class Plate(Table):
    """Geometry and material of the plate."""

    size: Annotated[tuple[Positive, Positive], Unit("m"), Field(examples=[[0.2, 0.12]])]
    """Sides along x and y."""
    thickness: Annotated[Positive, Unit("m"), Field(examples=[0.7e-3])]
    """Thickness H, at most a fifth of the shorter side."""
    young_modulus: Annotated[YoungModulus, Field(examples=[72e9])]
    """Young's modulus E."""
    poisson_ratio: Annotated[float, Field(ge=-0.99, lt=0.5, examples=[0.22]), Unit("1")]
    """Poisson's ratio ν."""
    density: Annotated[Density, Field(examples=[2480.0])]
    """Density ρ."""

    @property
    def rigidity(self) -> float:
        """Bending rigidity EH³/12(1 − ν²) [N·m] of the isotropic plate."""
        return self.young_modulus * self.thickness**3 / (12 * (1 - self.poisson_ratio**2))

    @model_validator(mode="after")
    def _thin(self) -> Plate:
        self.check_thin(self.thickness, "thickness: ")
        return self

    def check_point(self, key: str, point: Point) -> None:
        """Raise ValueError, beginning with ``key``, unless a point x, y [m] is on the plate."""
        if not all(0 <= at <= side for at, side in zip(point, self.size, strict=True)):
            raise ValueError(f"{key}: {list(point)} is off the plate of {list(self.size)} m")

    def check_thin(self, thickness: float, head: str = "") -> None:
        """Raise ValueError, beginning with ``head``, unless a thickness [m] is small against the sides."""
        if thickness > min(self.size) / 5:
            limit = "a plate is thinner than a fifth of its side (lengths are in metres)"
            raise ValueError(f"{head}{thickness:g} m is not thin for a side of {min(self.size):g} m; {limit}")
