"""Masses on springs and dampers that stand on patches of the plate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from warp_plate.effects.effect import Effect, Panel, Patch, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit
from warp_plate.scene.target import PlateRegion


class Oscillator(Effect, PlateRegion):
    """A mass on a patch of the plate, held by a spring and a damper: a fingertip, a foam pad."""

    mass: Annotated[NotNegative, Unit("kg"), Field(examples=[5e-3])] = 0.0
    """Mass; without mass the spring and damper are fixed to the ground."""
    stiffness: Annotated[NotNegative, Unit("N/m"), Field(examples=[2000.0])] = 0.0
    """Stiffness of the spring."""
    damping: Annotated[NotNegative, Unit("N·s/m"), Field(examples=[3.0])] = 0.0
    """Damping."""

    @model_validator(mode="after")
    def _attached(self) -> Oscillator:
        if self.stiffness == 0 and self.damping == 0:
            raise ValueError("stiffness: an oscillator needs a stiffness or a damping")
        return self

    def terms(self, plate: Panel) -> Iterator[Term]:
        patch = Patch(self.region, self.mass)
        yield Term("stiffness", self.stiffness, place=patch, label="oscillator")
        yield Term("damping", self.damping, place=patch, label="oscillator")

    @property
    def at_rest(self) -> Self:
        """Without a mass that only a damper holds: natural modes leave it at rest."""
        return self if self.stiffness > 0 else self.model_copy(update={"mass": 0.0})

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        x0, x1, y0, y1 = setting.spot
        half = min(5e-3, (x1 - x0) / 2, (y1 - y0) / 2)
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
        finger = cls(area=(x - half, x + half, y - half, y + half), mass=5e-3, stiffness=500.0, damping=2.0)
        text = "a fingertip in the middle of the target: 5 g, 500 N/m, 2 N·s/m (orders of magnitude of a light touch)"
        return (finger,), text
