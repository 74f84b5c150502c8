"""Plates in a PyVista plotter, alone or side by side in motion: their actors, and their updates from frame to frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz import annotations
from warp_plate.viz.annotations import LEGEND_WIDTH, lookup_table
from warp_plate.viz.captions import frame_caption
from warp_plate.viz.colours import DEFAULT_COLOURS, ColourOptions
from warp_plate.viz.fields import DrawingScale, motion_scales
from warp_plate.viz.meshes import SCALARS, PlateMeshes, SurfaceLines
from warp_plate.viz.styles import EDGE_STYLES, GRID, INK, TARGET

if TYPE_CHECKING:
    import pyvista

PLATES_PER_ROW = 3


@dataclass(frozen=True)
class LineLayer:
    """Lines and their style; without the offset, the surface would hide half of a wide line on a slope."""

    lines: SurfaceLines
    colour: str  # #rrggbb
    width: float  # [font sizes]
    depth_offset: int  # steps of the depth buffer towards the viewer
    opacity: float = 1.0


class PlateActors:
    """A plate in the active subplot of a plotter, whose camera points at it; updated in place without rendering.

    Args:
        displacement: (ny, nx) [m], see :meth:`PlateMeshes.update` also for ``values``.
        scale: colours and heights; pictures that are to be compared share one.
        text: caption; the height factor is added to its last line.
        font_size: height of the text [pixels]; line widths are relative to it.
        bar: True to draw colour bar and legend in this subplot.

    Attributes:
        surface, caption: actors of the surface and of the text above the plate.
    """

    def __init__(
        self, plotter: pyvista.Plotter, scene: Scene, displacement: np.ndarray, scale: DrawingScale, text: str,
        font_size: int, bar: bool = True, values: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        # Lines are blended in the order in which they are added; order-independent transparency takes twice the time.
        plotter.renderer.SetUseOIT(False)
        self.meshes = PlateMeshes(scene, displacement, scale, values)
        unlit = {"lighting": False, "show_scalar_bar": False}
        self.surface = plotter.add_mesh(self.meshes.surface, scalars=SCALARS, clim=scale.clim, **unlit)
        for layer in line_layers(self.meshes):
            look = {"color": layer.colour, "line_width": layer.width * font_size, "opacity": layer.opacity}
            actor = plotter.add_mesh(layer.lines.mesh, **look, **unlit)
            actor.mapper.resolve = "polygon_offset"  # a global switch of VTK that the next line depends on
            actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -layer.depth_offset)
        label_x, label_y = annotations.axis_labels(scene.plate.size)
        annotations.add_text(plotter, *label_x, font_size)
        annotations.add_text(plotter, *label_y, font_size).GetTextProperty().SetJustificationToRight()
        self._bar = annotations.add_legend(plotter, scene, scale, font_size) if bar else None
        self.caption, self._text = annotations.add_text(plotter, text, (0.03, 0.97), font_size), text
        self.rescale(scale)
        self.update(displacement, values)
        share = annotations.free_width(plotter, font_size) if bar else 1.0
        annotations.look_at_plate(plotter, scene.plate.size, font_size, share)

    def update(self, displacement: np.ndarray, values: np.ndarray | None = None, text: str | None = None) -> None:
        """Move to another field, see :meth:`PlateMeshes.update`, with another caption if a text is given."""
        self.meshes.update(displacement, self.scale, values)
        self._text = self._text if text is None else text
        self.caption.SetInput(", ".join(filter(None, (self._text, self.scale.heights))))

    def rescale(self, scale: DrawingScale) -> None:
        """Take another scale; a call of :meth:`update` must follow."""
        self.scale = scale
        self.surface.mapper.lookup_table = lookup_table(scale)
        self.surface.mapper.scalar_range = scale.clim
        # Between 179° and −179° lies 180°, not 0°: interpolate colours of angles, not angles.
        self.surface.mapper.interpolate_before_map = scale.field.kind != "cyclic"
        if self._bar is not None:
            annotations.set_colour_bar(self._bar, scale)


def line_layers(meshes: PlateMeshes) -> list[LineLayer]:
    """Return all lines of a plate in drawing order, with a target's line beside that of an edge."""
    styles = {"grid": (GRID, 0.033, 300), "target": (TARGET, 0.125, 500), "actuators": (INK, 0.1, 600)}
    for kind, edge in EDGE_STYLES.items():
        styles[kind] = (edge.colour, edge.width / 18, 400 if kind == "clamped" else 560)
    layers = []
    for name, lines in meshes.lines.items():
        colour, width, offset = styles[name]
        if name in ("target", "actuators"):  # a light rim sets the line off against dark colours
            layers.append(LineLayer(lines, "#ffffff", width + 0.1, offset - 20, 0.5))
        layers.append(LineLayer(lines, colour, width, offset))
    return layers


class SideBySide:
    """Plates of one scene in the subplots of a plotter, row by row; not rendered.

    Args:
        plotter: with the subplots of :func:`plate_subplots`.
        motions: with the same number of frames each.
        quantity: field in colour, a key of FIELDS; natural modes show their displacement.
        font_size: height of the text [pixels].
        colours: colour map and limits; plates with limits of their own have a legend each, others share one.

    Attributes:
        plates: one for each motion.
        scales: scale of each plate for all frames.
        frames, frame: number of frames, and index of the shown one.
    """

    def __init__(
        self, plotter: pyvista.Plotter, scene: Scene, motions: Sequence[Motion], quantity: str, font_size: int,
        colours: ColourOptions = DEFAULT_COLOURS,
    ) -> None:  # fmt: skip
        self.scene, self.motions, self.colours = scene, list(motions), colours
        self.frames, self.frame = len(motions[0].times), 0
        self.scales, self._values = motion_scales(scene, motions, quantity, colours)
        self.plates, each = [], colours.each
        _, columns = rows_and_columns(len(motions))
        for index, (motion, scale, values) in enumerate(zip(motions, self.scales, self._values, strict=True)):
            plotter.subplot(*divmod(index, columns))
            text, placed = frame_caption(motion, 0, scene), motion.scene or scene
            field = motion.displacement[0]
            self.plates.append(PlateActors(plotter, placed, field, scale, text, font_size, each, values[0]))
        if not each:
            plotter.subplot(0, columns)
        self._bar = None if each else annotations.add_legend(plotter, scene, self.scales[0], font_size)

    def show(self, frame: int) -> None:
        """Move all plates to a frame, counted modulo the number of frames."""
        self.frame = frame % self.frames
        for motion, values, plate in zip(self.motions, self._values, self.plates, strict=True):
            text = frame_caption(motion, self.frame, self.scene)
            # Some fields are constant in time, with a single frame.
            plate.update(motion.displacement[self.frame], values[self.frame % len(values)], text)

    def colour_by(self, quantity: str) -> None:
        """Show another field in colour at the same frame and heights, within limits that suit it."""
        colours = replace(self.colours, limits="each" if self.colours.each else "common")
        scales, self._values = motion_scales(self.scene, self.motions, quantity, colours)
        pairs = zip(scales, self.scales, strict=True)
        self._rescale([replace(scale, warp_factor=before.warp_factor) for scale, before in pairs])

    def exaggerate(self, warp_factor: float) -> None:
        """Exaggerate heights of the first plate by this factor, rounded to three digits, and others in proportion."""
        ratio = warp_factor / self.scales[0].warp_factor
        factors = [float(f"{ratio * scale.warp_factor:.3g}") for scale in self.scales]
        self._rescale([replace(scale, warp_factor=new) for scale, new in zip(self.scales, factors, strict=True)])

    def _rescale(self, scales: list[DrawingScale]) -> None:
        self.scales = scales
        if self._bar is not None:
            annotations.set_colour_bar(self._bar, scales[0])
        for plate, scale in zip(self.plates, scales, strict=True):
            plate.rescale(scale)
        self.show(self.frame)


def rows_and_columns(plates: int) -> tuple[int, int]:
    """Return the numbers of rows and columns of plates."""
    columns = min(plates, PLATES_PER_ROW)
    return math.ceil(plates / columns), columns


def plate_subplots(plates: int, width: int, font_size: int, each: bool = False) -> dict[str, Any]:
    """Return shape and column widths [pixels] of a PyVista plotter for plates of this width, and for their legend in
    the last column, or for ``each`` plate's legend beside it."""
    rows, columns = rows_and_columns(plates)
    legend = round(LEGEND_WIDTH * font_size)
    widths = [width + legend] * columns if each else [width] * columns + [legend]
    return {"shape": (rows, len(widths)), "col_weights": widths}
