"""Plates in motion side by side, with one scale for all: what the window, movies and pages show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.lettering import LEGEND_WIDTH
from warp_plate.viz.quantity import MODE, QUANTITIES, Quantity, Scale, scale_over
from warp_plate.viz.scene3d import DrawnPlate, add_plate
from warp_plate.viz.surface import caption

if TYPE_CHECKING:
    import pyvista

DRIVES = {
    "equal": "equal drive",
    "single": "single actuator",
    "best": "best drive found",
    "drive": "given drive",
}


class Comparison:
    """Plates of one scene in the subplots of a plotter, from left to right and top to bottom; the last has the legend.

    plates: one for each motion; scale: common to all. Nothing is rendered until the plotter is.
    """

    def __init__(
        self,
        plotter: pyvista.Plotter,
        scene: Scene,
        motions: Sequence[Motion],
        quantity: str = "displacement",
        font_size: int = 20,
    ) -> None:
        """quantity: a key of QUANTITIES, passed over for modes; plotter: with a subplot for each motion, in a row.

        Every motion must have as many frames as the others.
        """
        self.scene = scene
        self.motions = list(motions)
        self.frame = 0
        self.quantity = self._quantity(quantity)
        self._colours = [self.quantity.values(motion) for motion in motions]
        self.scale = self._scale()
        self.plates: list[DrawnPlate] = []
        for index, motion in enumerate(self.motions):
            plotter.subplot(0, index)
            self.plates.append(
                add_plate(
                    plotter,
                    scene,
                    motion.displacement[0],
                    self.scale,
                    heading(motion, 0),
                    font_size,
                    bar=index == len(self.motions) - 1,
                    colours=self._colour(index, 0),
                )
            )

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.motions[0].times)

    def show(self, frame: int) -> None:
        """Move all plates to a frame; those beyond the last begin again."""
        self.frame = frame % self.frames
        for index, (motion, plate) in enumerate(zip(self.motions, self.plates, strict=True)):
            field = motion.displacement[self.frame]
            plate.update(field, self._colour(index, self.frame), heading(motion, self.frame))

    def colour_by(self, quantity: str) -> None:
        """Show another quantity in colour, at the frame that is shown."""
        self.quantity = self._quantity(quantity)
        self._colours = [self.quantity.values(motion) for motion in self.motions]
        self._rescale(replace(self._scale(), factor=self.scale.factor))

    def exaggerate(self, factor: float) -> None:
        """Draw heights so many times their true size."""
        self._rescale(replace(self.scale, factor=float(f"{factor:.3g}")))

    def _rescale(self, scale: Scale) -> None:
        self.scale = scale
        for plate in self.plates:
            plate.rescale(scale)
        self.show(self.frame)

    def _scale(self) -> Scale:
        fields = [motion.displacement for motion in self.motions]
        return scale_over(fields, self.scene.plate.size, self.quantity, self._colours)

    def _quantity(self, name: str) -> Quantity:
        return MODE if self.motions[0].localization_factor is None else QUANTITIES[name]

    def _colour(self, index: int, frame: int) -> np.ndarray:
        """(ny, nx) of one plate; the same at all frames where there is only one."""
        fields = self._colours[index]
        return fields[frame % len(fields)]


def heading(motion: Motion, frame: int) -> str:
    """What stands above a plate: drive, time and localization factor, or the mode."""
    if motion.localization_factor is None:
        return motion.name
    # Enough decimals to tell one frame from the next.
    decimals = max(0, math.ceil(-math.log10((motion.span[1] - motion.span[0]) / len(motion.times))))
    name = DRIVES.get(motion.name, motion.name)
    return caption(name, float(motion.times[frame]), motion.localization_factor, decimals)


def widths(plates: int, each: int, font_size: int) -> list[int]:
    """Widths of the subplots in pixels: the last has the legend beside its plate."""
    return [each] * (plates - 1) + [each + round(LEGEND_WIDTH * font_size)]
