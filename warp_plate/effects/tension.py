"""In-plane tension or compression."""

import math
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.effect import IN_PLANE, Effect, Panel, Setting, Term
from warp_plate.scene.fields import Moderate, Unit


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
