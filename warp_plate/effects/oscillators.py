"""Masses on springs and dampers that stand on patches of the plate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from warp_plate.effects.effect import Effect, Panel, Patch, Setting, Term
from warp_plate.scene.fields import NotNegative, Positive, Unit
from warp_plate.scene.target import PlateRegion

# Largest number of oscillators in a lattice.
MOST_COPIES = 10_000
Count = Annotated[int, Field(ge=1, le=MOST_COPIES)]


class Oscillator(Effect, PlateRegion):
    """A mass on a patch of the plate, held by a spring and a damper: a fingertip, a foam pad, or a lattice of them."""

    mass: Annotated[NotNegative, Unit("kg"), Field(examples=[5e-3])] = 0.0
    """Mass; without mass the spring and damper are fixed to the ground."""
    stiffness: Annotated[NotNegative, Unit("N/m"), Field(examples=[2000.0])] = 0.0
    """Stiffness of the spring."""
    damping: Annotated[NotNegative, Unit("N·s/m"), Field(examples=[3.0])] = 0.0
    """Damping."""
    lattice: Annotated[tuple[Count, Count] | None, Field(examples=[[20, 14]])] = None
    """Numbers of equal oscillators along x and y, of which the shape is the lower left one (default: one alone)."""
    pitch: Annotated[tuple[Positive, Positive] | None, Unit("m"), Field(examples=[[0.01, 0.01]])] = None
    """Distances of the oscillators of a lattice along x and y."""

    @model_validator(mode="after")
    def _attached(self) -> Oscillator:
        if self.stiffness == 0 and self.damping == 0:
            raise ValueError("stiffness: an oscillator needs a stiffness or a damping")
        if (self.lattice is None) != (self.pitch is None):
            raise ValueError("lattice: write lattice = [columns, rows] with pitch = [dx, dy], or neither")
        if len(self.places) > MOST_COPIES:
            raise ValueError(f"lattice: {len(self.places)} oscillators; at most {MOST_COPIES} are possible")
        return self

    @property
    def places(self) -> list[tuple[int, int]]:
        """Columns and rows of the oscillators of the lattice."""
        columns, rows = self.lattice or (1, 1)
        return [(column, row) for row in range(rows) for column in range(columns)]

    def copy_at(self, column: int, row: int) -> PlateRegion:
        """Return the shape of an oscillator of the lattice."""
        if (column, row) == (0, 0):
            return self.region
        assert self.pitch is not None
        return self.moved_to(self.middle[0] + column * self.pitch[0], self.middle[1] + row * self.pitch[1])

    def check(self, key: str, size: tuple[float, float], over: bool = False, note: str = "") -> None:
        """Check the first and the last oscillator, see :meth:`PlateRegion.check`."""
        super().check(key, size, over, note)
        if self.lattice is not None:
            self.copy_at(*self.places[-1]).check(key, size, over, f" of the last of lattice = {list(self.lattice)}")

    def terms(self, plate: Panel) -> Iterator[Term]:
        for place in self.places:
            patch = Patch(self.copy_at(*place), self.mass)
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
