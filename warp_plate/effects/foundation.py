"""An elastic bed under the plate."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.effect import Effect, Panel, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit


class Foundation(Effect):
    """An elastic foundation under the whole plate, k u + c u̇ on the left of the equation of motion."""

    stiffness: Annotated[NotNegative, Unit("N/m³"), Field(examples=[1e7])]
    """Stiffness k."""
    damping: Annotated[NotNegative, Unit("N·s/m³"), Field(examples=[100.0])] = 0.0
    """Damping c."""

    damping_keys = ("damping",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("stiffness", self.stiffness)
        if self.damping:
            yield Term("damping", self.damping)

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(stiffness=1e7), "1e7 N/m³ (10 mm of foam of 0.1 MPa)"
