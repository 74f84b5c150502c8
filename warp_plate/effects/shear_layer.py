"""A layer under the plate that resists shear, as in Pasternak's foundation."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.effect import IN_PLANE, Effect, Panel, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit


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
