"""Plates in 3-D: PyVista meshes that follow a displacement field, their actors in a plotter, and plates side by side.

Heights are exaggerated: a node at (x, y) with displacement u is drawn at (x, y, height factor × u), all in metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.plate.shapes import outlines
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz import annotations
from warp_plate.viz.annotations import EDGE_STYLES, GRID, INK, LEGEND_WIDTH, TARGET, edges_by_kind
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, DrawingScale, motion_scales
from warp_plate.viz.outlined import OutlinedNodes, on_plate, outlined_nodes

if TYPE_CHECKING:
    import pyvista

SCALARS = "colour"
# About as many grid lines as the paper's 27 x 27 nodes have; of finer grids every second, third, … line is drawn.
GRID_LINES = 26
PLATES_PER_ROW = 3
# Size of actuators' names [font sizes].
NAME_SIZE = 0.75


@dataclass(frozen=True)
class SurfaceLines:
    """Lines that lie on the triangles of the surface."""

    mesh: pyvista.PolyData  # straight segments, each within one triangle
    nodes: np.ndarray  # (points, 3) corners of the triangle that holds each point
    weights: np.ndarray  # (points, 3) barycentric coordinates of the points in their triangles


class PlateMeshes:
    """Meshes of one plate; for the arguments see :meth:`update`.

    ``surface`` has a point per node, x fastest, with point data SCALARS in the unit of the colour bar. ``lines`` are in
    drawing order: those inside the plate, edges by their support, outlines of targets and of actuators.
    """

    def __init__(
        self, scene: Scene, displacement: np.ndarray, scale: DrawingScale, values: np.ndarray | None = None
    ) -> None:
        import pyvista

        grid = _FlatGrid(scene.plate.size, displacement.shape[::-1], outlined_nodes(scene, displacement.shape))
        self._outlined = grid.outlined
        self.surface = pyvista.PolyData.from_regular_faces(grid.points(), grid.triangles())
        self.surface.point_data[SCALARS] = np.zeros(displacement.size)
        edges: dict[str, list[Any]] = dict(edges_by_kind(scene))
        for path in edges.pop("support", ()):
            edges.setdefault("support", []).extend(on_plate(scene, [path]) if len(path) > 2 else [path])
        paths = {
            "grid": grid.inner_lines(),
            **edges,
            "target": on_plate(scene, outlines(scene)),
            "actuators": on_plate(scene, [actuator.closed_path() for actuator in scene.actuators]),
        }
        self.lines = {name: grid.lines(drawn) for name, drawn in paths.items() if drawn}
        self.update(displacement, scale, values)

    def update(self, displacement: np.ndarray, scale: DrawingScale, values: np.ndarray | None = None) -> None:
        """Move in place to another displacement (ny, nx) [m], at rest where it is not finite, and other values of the
        scale's field in its SI unit (default: the displacement)."""
        scalars = displacement if values is None else values
        if self._outlined is not None:
            displacement = self._outlined.continued(displacement, moved=True)
            scalars = self._outlined.continued(scalars, moved=True, straight=scale.field.kind != "cyclic")
        heights = (np.where(np.isfinite(displacement), displacement, 0) * scale.height_factor).ravel()
        self.surface.points[:, 2] = heights
        self.surface.point_data[SCALARS][:] = np.asarray(scalars, dtype=float).ravel() * scale.unit_factor
        for lines in self.lines.values():
            lines.mesh.points[:, 2] = np.einsum("pc,pc->p", heights[lines.nodes], lines.weights)


@dataclass(frozen=True)
class _FlatGrid:
    """The undeformed grid; each cell is two triangles, split from its lower left to its upper right node."""

    size: tuple[float, float]  # [m]
    nodes: tuple[int, ...]  # along x and y
    outlined: OutlinedNodes | None = None  # those of a plate with an outline

    def points(self) -> np.ndarray:
        """Return (nodes, 3) positions of the nodes at rest, x fastest."""
        if self.outlined is not None:
            x, y = np.moveaxis(self.outlined.places, -1, 0)
        else:
            x, y = np.meshgrid(*map(np.linspace, (0, 0), self.size, self.nodes))
        return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)

    def triangles(self) -> np.ndarray:
        """Return (triangles, 3) node indices, cell by cell, so that a renderer finds most nodes in its cache."""
        index = np.arange(math.prod(self.nodes)).reshape(self.nodes[::-1])
        corner, right, up, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        lower, upper = np.stack([corner, right, across], -1), np.stack([corner, across, up], -1)
        cells = np.stack([lower, upper], axis=2)
        return (cells if self.outlined is None else cells[self.outlined.shown]).reshape(-1, 3)

    def inner_lines(self) -> list[list[tuple[float, float]]]:
        """Return the ends of grid lines inside the plate, about GRID_LINES each way."""
        (width, height), positions = self.size, []
        for side, nodes in zip(self.size, self.nodes, strict=True):
            step = max(1, round((nodes - 1) / GRID_LINES))
            positions.append(np.linspace(0, side, nodes)[step:-1:step])
        if self.outlined is not None:
            chords = self.outlined.outline.chords
            along_x = [[(low, y), (high, y)] for y in positions[1] for low, high in chords(0, y)]
            return along_x + [[(x, low), (x, high)] for x in positions[0] for low, high in chords(1, x)]
        return [[(0, y), (width, y)] for y in positions[1]] + [[(x, 0), (x, height)] for x in positions[0]]

    def lines(self, paths: Sequence[Sequence[Sequence[float]] | np.ndarray]) -> SurfaceLines:
        """Return lines on the surface along paths through (corners, 2)."""
        import pyvista

        pieces = [self._line(*ends) for path in paths for ends in pairwise(path)]
        points = np.concatenate(pieces)
        last = np.cumsum([len(piece) for piece in pieces]) - 1
        first = np.setdiff1d(np.arange(len(points)), last)
        segments = np.column_stack([np.full_like(first, 2), first, first + 1])
        mesh = pyvista.PolyData(np.column_stack([points, np.zeros(len(points))]), lines=segments.ravel())
        return SurfaceLines(mesh, *self._barycentric(points))

    def _line(self, start: Sequence[float], end: Sequence[float]) -> np.ndarray:
        """Return the (points, 2) of a straight line, with a point at each crossing of a triangle's side."""
        ends = np.array([start, end], dtype=float)
        x, y = (ends / self.size * (np.array(self.nodes) - 1)).T
        shares = [np.array([0.0, 1.0])]
        # On grid lines along y, along x, and on the diagonals, one of these coordinates is a whole number.
        for low, high in (x, y, x - y):
            crossings = np.arange(math.ceil(min(low, high)), math.floor(max(low, high)) + 1)
            shares.append((crossings - low) / (high - low) if low != high else np.empty(0))
        share = np.unique(np.concatenate(shares).round(12))[:, None]
        return (1 - share) * ends[0] + share * ends[1]

    def _barycentric(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (points, 3) nodes of the triangles that hold the points, and (points, 3) weights."""
        position = np.clip(points / self.size, 0, 1) * (np.array(self.nodes) - 1)
        cell = np.minimum(position.astype(int), np.array(self.nodes) - 2)
        (j, i), (right, up), row = cell.T, (position - cell).T, self.nodes[0]
        corner, across = i * row + j, (i + 1) * row + j + 1
        middle = np.where(right >= up, i * row + j + 1, (i + 1) * row + j)
        larger, smaller = np.maximum(right, up), np.minimum(right, up)
        return np.stack([corner, middle, across], -1), np.stack([1 - larger, larger - smaller, smaller], -1)


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

    Line widths are relative to the font size [pixels]; the height factor is added to the last line of the caption.
    ``bar`` adds colour bar and legend. ``surface`` and ``caption`` are the actors of the surface and of the text above;
    ``names`` are the places of the actuators' names.
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
        self.names, self._named_nodes = annotations.name_actuators(
            plotter, scene, displacement.shape, round(NAME_SIZE * font_size)
        )
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
        self.names.points[:, 2] = self.meshes.surface.points[self._named_nodes, 2]
        self.names.Modified()
        self._text = self._text if text is None else text
        self.caption.SetInput(", ".join(filter(None, (self._text, self.scale.heights_text))))

    def rescale(self, scale: DrawingScale) -> None:
        """Take another scale; a call of :meth:`update` must follow."""
        self.scale = scale
        self.surface.mapper.lookup_table = annotations.lookup_table(scale)
        self.surface.mapper.scalar_range = scale.clim
        # Between 179° and −179° lies 180°, not 0°: interpolate colours of angles, not angles.
        self.surface.mapper.interpolate_before_map = scale.field.kind != "cyclic"
        if self._bar is not None:
            annotations.set_colour_bar(self._bar, scale)


def line_layers(meshes: PlateMeshes) -> list[LineLayer]:
    """Return all lines of a plate in drawing order, with a target's line beside that of an edge."""
    styles = {"grid": (GRID, 0.033, 300), "target": (TARGET, 0.125, 500), "actuators": (INK, 0.1, 600)}
    for kind, edge in EDGE_STYLES.items():
        wide = kind in ("clamped", "springs")  # wider than a target's line, which lies on it
        styles[kind] = (edge.colour, (3.2 if wide else edge.width) / 18, 400 if wide else 560)
    layers = []
    for name, lines in meshes.lines.items():
        colour, width, offset = styles[name]
        if name in ("target", "actuators"):  # a light rim sets the line off against dark colours
            layers.append(LineLayer(lines, "#ffffff", width + 0.1, offset - 20, 0.5))
        layers.append(LineLayer(lines, colour, width, offset))
    return layers


class SideBySide:
    """Plates of one scene, with the same number of frames each, in the subplots of :func:`plate_subplots`, row by row;
    not rendered. Plates with limits of their own have a legend each, others share one.

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
        self.plates, separate = [], colours.separate
        _, columns = rows_and_columns(len(motions))
        for index, (motion, scale, values) in enumerate(zip(motions, self.scales, self._values, strict=True)):
            plotter.subplot(*divmod(index, columns))
            text, placed = annotations.frame_caption(motion, 0, scene), motion.scene or scene
            field = motion.displacement[0]
            self.plates.append(PlateActors(plotter, placed, field, scale, text, font_size, separate, values[0]))
        if not separate:
            plotter.subplot(0, columns)
        self._bar = None if separate else annotations.add_legend(plotter, scene, self.scales[0], font_size)

    def show(self, frame: int) -> None:
        """Move all plates to a frame, counted modulo the number of frames."""
        self.frame = frame % self.frames
        for motion, values, plate in zip(self.motions, self._values, self.plates, strict=True):
            text = annotations.frame_caption(motion, self.frame, self.scene)
            # Some fields are constant in time, with a single frame.
            plate.update(motion.displacement[self.frame], values[self.frame % len(values)], text)

    def colour_by(self, quantity: str) -> None:
        """Show another field in colour at the same frame and heights, within limits that suit it."""
        colours = replace(self.colours, limits="each" if self.colours.separate else "common")
        scales, self._values = motion_scales(self.scene, self.motions, quantity, colours)
        pairs = zip(scales, self.scales, strict=True)
        self._rescale([replace(scale, height_factor=before.height_factor) for scale, before in pairs])

    def exaggerate(self, height_factor: float) -> None:
        """Exaggerate heights of the first plate by this factor, rounded to three digits, and others in proportion."""
        ratio = height_factor / self.scales[0].height_factor
        factors = [float(f"{ratio * scale.height_factor:.3g}") for scale in self.scales]
        self._rescale([replace(scale, height_factor=new) for scale, new in zip(self.scales, factors, strict=True)])

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


def plate_subplots(plates: int, width: int, font_size: int, separate: bool = False) -> dict[str, Any]:
    """Return shape and column widths [pixels] of a PyVista plotter for plates of this width, and for their legend in
    the last column, or for ``separate`` legends beside them."""
    rows, columns = rows_and_columns(plates)
    legend = round(LEGEND_WIDTH * font_size)
    widths = [width + legend] * columns if separate else [width] * columns + [legend]
    return {"shape": (rows, len(widths)), "col_weights": widths}
