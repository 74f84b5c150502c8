"""Plates in motion side by side, with one scale for all: what the window, pictures, movies and pages show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.crosstalk import target_cases
from warp_plate.result.model import Case, Result
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.lettering import LEGEND_WIDTH, add_legend, set_bar
from warp_plate.viz.quantity import MODE, QUANTITIES, Quantity, Scale, scale_over
from warp_plate.viz.scene3d import DrawnPlate, add_plate
from warp_plate.viz.surface import caption

if TYPE_CHECKING:
    import pyvista

DRIVES = {
    "equal": "equal drive",
    "single": "single actuator",
    "time_reversal": "time reversal",
    "inverse_filter": "inverse filter",
    "nominal": "found without scatter",
    "best": "best drive found",
    "drive": "given drive",
}
# Of plates in a row.
WIDEST = 3


class Comparison:
    """Plates of one scene in the subplots of a plotter, row by row; a last column has the legend.

    plates: one for each motion; scale: common to all. Nothing is rendered until the plotter is.
    """

    def __init__(
        self,
        plotter: pyvista.Plotter,
        scene: Scene,
        motions: Sequence[Motion],
        quantity: str = "displacement",
        font_size: int = 20,
        legend: tuple[int, int] | None = None,
        alike: Sequence[Motion] = (),
    ) -> None:
        """quantity: a key of QUANTITIES, passed over for modes; plotter: see :func:`layout`; legend: its subplot, left
        out: behind the first row; alike: motions that the scale must hold for too.

        Every motion must have as many frames as the others.
        """
        self.scene = scene
        self.motions = list(motions)
        self.frame = 0
        self.quantity = quantity_of(self.motions, quantity)
        self._colours = [self.quantity.values(motion) for motion in motions]
        self._alike = [*self.motions, *alike]
        self.scale = common_scale(scene, self._alike, self.quantity)
        self.plates: list[DrawnPlate] = []
        _, columns = rows_and_columns(len(self.motions))
        for index, motion in enumerate(self.motions):
            row, column = divmod(index, columns)
            plotter.subplot(row, column)
            field, colours = motion.displacement[0], self._colour(index, 0)
            text, own = heading(motion, 0, scene), motion.scene or scene
            self.plates.append(add_plate(plotter, own, field, self.scale, text, font_size, False, colours))
        plotter.subplot(*(legend or (0, columns)))
        self._bar = add_legend(plotter, scene, self.scale, font_size)

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.motions[0].times)

    def show(self, frame: int) -> None:
        """Move all plates to a frame; those beyond the last begin again."""
        self.frame = frame % self.frames
        for index, (motion, plate) in enumerate(zip(self.motions, self.plates, strict=True)):
            field = motion.displacement[self.frame]
            plate.update(field, self._colour(index, self.frame), heading(motion, self.frame, self.scene))

    def colour_by(self, quantity: str) -> None:
        """Show another quantity in colour, at the frame that is shown."""
        self.quantity = quantity_of(self.motions, quantity)
        self._colours = [self.quantity.values(motion) for motion in self.motions]
        scale = common_scale(self.scene, self._alike, self.quantity)
        self._rescale(replace(scale, factor=self.scale.factor))

    def exaggerate(self, factor: float) -> None:
        """Draw heights so many times their true size."""
        self._rescale(replace(self.scale, factor=float(f"{factor:.3g}")))

    def _rescale(self, scale: Scale) -> None:
        self.scale = scale
        set_bar(self._bar, scale)
        for plate in self.plates:
            plate.rescale(scale)
        self.show(self.frame)

    def _colour(self, index: int, frame: int) -> np.ndarray:
        """(ny, nx) of one plate; the same at all frames where there is only one."""
        fields = self._colours[index]
        return fields[frame % len(fields)]


def common_scale(scene: Scene, motions: Sequence[Motion], quantity: Quantity) -> Scale:
    """One scale for all plates and frames."""
    colours = [quantity.values(motion) for motion in motions]
    return scale_over([motion.displacement for motion in motions], scene.plate.size, quantity, colours)


def quantity_of(motions: Sequence[Motion], name: str) -> Quantity:
    """The quantity of this name; natural shapes have but one."""
    return MODE if motions[0].localization_factor is None else QUANTITIES[name]


def drive_words(name: str, scene: Scene) -> str:
    """A case of a result of this scene, for people."""
    targets = {case: target for target, case in target_cases(scene).items()}
    return f"best drive for {targets[name]}" if name in targets else DRIVES.get(name, name)


def heading(motion: Motion, frame: int, scene: Scene) -> str:
    """What stands above a plate: drive, time and localization factor, or the mode."""
    if motion.localization_factor is None:
        return motion.name
    # Enough decimals to tell one frame from the next.
    decimals = max(0, math.ceil(-math.log10((motion.span[1] - motion.span[0]) / len(motion.times))))
    return caption(drive_words(motion.name, scene), float(motion.times[frame]), motion.localization_factor, decimals)


def ordered(result: Result) -> dict[str, Case]:
    """Cases in the paper's order, then those of further targets in the scene's, then any others; a file gives them back
    by alphabet."""
    names = dict.fromkeys([*DRIVES, *target_cases(result.scene).values(), *result.cases])
    return {name: result.cases[name] for name in names if name in result.cases}


def rows_and_columns(plates: int) -> tuple[int, int]:
    """How so many plates are laid out."""
    columns = min(plates, WIDEST)
    return math.ceil(plates / columns), columns


def layout(plates: int, each: int, font_size: int) -> dict[str, Any]:
    """Of a PyVista plotter: its subplots, the widths of its columns in pixels, each plate's and the legend's."""
    rows, columns = rows_and_columns(plates)
    return {
        "shape": (rows, columns + 1),
        "col_weights": [each] * columns + [round(LEGEND_WIDTH * font_size)],
    }
