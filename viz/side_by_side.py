"""Plates in motion side by side with a common scale, as windows, pictures and movies show them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import LEGEND_WIDTH, add_legend, set_colour_bar
from warp_plate.viz.captions import frame_caption
from warp_plate.viz.fields import DrawingScale, common_scale, field_of
from warp_plate.viz.scene3d import add_plate

if TYPE_CHECKING:
    import pyvista

PLATES_PER_ROW = 3


class SideBySide:
    """Plates of one scene in the subplots of a plotter, row by row, with a legend in the last column.

    The plotter is not rendered by any method.

    Args:
        plotter: with the subplots of :func:`plate_subplots`.
        motions: with the same number of frames each.
        quantity: field in colour, a key of FIELDS; natural modes show their displacement.
        font_size: height of the text [pixels].

    Attributes:
        plates: one for each motion.
        scale: common scale of all plates and frames.
        frames: number of frames.
        frame: index of the shown frame.
    """

    def __init__(
        self, plotter: pyvista.Plotter, scene: Scene, motions: Sequence[Motion], quantity: str, font_size: int
    ) -> None:
        self.scene = scene
        self.motions = list(motions)
        self.frames, self.frame = len(motions[0].times), 0
        self.scale = self._take_field(quantity)
        self.plates = []
        _, columns = rows_and_columns(len(motions))
        for index, (motion, values) in enumerate(zip(motions, self._values, strict=True)):
            plotter.subplot(*divmod(index, columns))
            text, placed = frame_caption(motion, 0, scene), motion.scene or scene
            field = motion.displacement[0]
            self.plates.append(add_plate(plotter, placed, field, self.scale, text, font_size, False, values[0]))
        plotter.subplot(0, columns)
        self._bar = add_legend(plotter, scene, self.scale, font_size)

    def show(self, frame: int) -> None:
        """Move all plates to a frame, counted modulo the number of frames."""
        self.frame = frame % self.frames
        for motion, values, plate in zip(self.motions, self._values, self.plates, strict=True):
            text = frame_caption(motion, self.frame, self.scene)
            # Some fields are constant in time, with a single frame.
            plate.update(motion.displacement[self.frame], values[self.frame % len(values)], text)

    def colour_by(self, quantity: str) -> None:
        """Show another field in colour at the same frame and heights."""
        self._rescale(replace(self._take_field(quantity), warp_factor=self.scale.warp_factor))

    def exaggerate(self, warp_factor: float) -> None:
        """Exaggerate heights by this factor, rounded to three digits."""
        self._rescale(replace(self.scale, warp_factor=float(f"{warp_factor:.3g}")))

    def _take_field(self, quantity: str) -> DrawingScale:
        """Read a field of all motions and return its scale."""
        field = field_of(self.motions, quantity)
        self._values = [field.values(motion) for motion in self.motions]
        return common_scale(self.scene, self.motions, field)

    def _rescale(self, scale: DrawingScale) -> None:
        self.scale = scale
        set_colour_bar(self._bar, scale)
        for plate in self.plates:
            plate.rescale(scale)
        self.show(self.frame)


def rows_and_columns(plates: int) -> tuple[int, int]:
    """Return the numbers of rows and columns of plates."""
    columns = min(plates, PLATES_PER_ROW)
    return math.ceil(plates / columns), columns


def plate_subplots(plates: int, width: int, font_size: int) -> dict[str, Any]:
    """Return shape and column widths [pixels] of a PyVista plotter for plates of this width, and their legend."""
    rows, columns = rows_and_columns(plates)
    widths = [width] * columns + [round(LEGEND_WIDTH * font_size)]
    return {"shape": (rows, columns + 1), "col_weights": widths}
