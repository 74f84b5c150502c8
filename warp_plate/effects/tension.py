"""In-plane forces, given or by stretching, and a layer under the plate that resists shear, which acts like them.

The kernels and NumPy functions of stretching take Berger's tension from ``plate/bending.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.effect import IN_PLANE, Effect, Panel, Setting, Term
from warp_plate.scene.fields import Moderate, NotNegative, Unit


class Tension(Effect):
    """In-plane tension, −(Tx u_xx + Ty u_yy) on the left of the equation of motion; a plate that buckles is refused."""

    x: Annotated[Moderate, Unit("N/m"), Field(examples=[50.0])] = 0.0
    """Force per length along x, positive in tension."""
    y: Annotated[Moderate, Unit("N/m"), Field(examples=[20.0])] = 0.0
    """Force per length along y."""

    def terms(self, plate: Panel) -> Iterator[Term]:
        for factors, force in zip(IN_PLANE, (self.x, self.y), strict=True):
            yield Term("stiffness", force, factors)

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        force = 0.1 * math.pi**2 * setting.plate.rigidity / min(setting.plate.size) ** 2
        text = "along x and y (a tenth of π²D/L², the buckling load of a supported strip)"
        return cls(x=force, y=force), f"{force:.2g} N/m {text}"


class ShearLayer(Effect):
    """A layer that resists shear, −G ∇²u on the left of the equation of motion (P. L. Pasternak, 1954).

    Beside ``[effects.foundation]`` it couples the springs of the bed: a foam of shear modulus μ and thickness h, fixed
    below, has G of about μh/3.
    """

    stiffness: Annotated[NotNegative, Unit("N/m"), Field(examples=[200.0])]
    """Shear stiffness G."""

    def terms(self, plate: Panel) -> Iterator[Term]:
        for factors in IN_PLANE:
            yield Term("stiffness", self.stiffness, factors)

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(stiffness=100.0), "100 N/m (10 mm of foam of 0.03 MPa in shear)"


class Stretching(Effect):
    """Stretching at large amplitude, after Berger, for an isotropic plate with in-plane fixed edges: the tension
    N = 6D/(H² area) ∫ |∇u|² dA, −N∇²u on the left of the equation of motion."""

    linear = False

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(), "named"
