"""What is drawn of a displacement field: scales, texts and PyVista meshes, as data and without a window.

Heights are exaggerated: a node at (x, y) with displacement u is drawn at (x, y, factor × u), all in metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Area, Scene

if TYPE_CHECKING:
    import pyvista

FIELD = "displacement"
# The largest displacement of a case is drawn this high, as a share of the plate's shorter side.
TALLEST = 0.12
# About as many grid lines as the paper's 27 x 27 nodes have; finer grids show every second, third, ... line.
LINES = 26
UNITS = (("nm", 1e9), ("µm", 1e6), ("mm", 1e3), ("m", 1.0))


@dataclass(frozen=True)
class Scale:
    """What all pictures that are to be compared share.

    limit: colours run from −limit to limit [m]; factor: how many times heights are exaggerated;
    unit: of the colour bar; per_metre: how many of it make a metre.
    """

    limit: float
    factor: float
    unit: str
    per_metre: float

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the colour bar in its unit."""
        end = self.limit * self.per_metre
        return -end, end

    @property
    def heights(self) -> str:
        """The height factor in words."""
        return f"heights × {self.factor:.15g}"


@dataclass(frozen=True)
class PlateMeshes:
    """The parts of one picture.

    surface: one point a node, x fastest, with point data "displacement" in the colour bar's unit.
    lines: grid lines inside the plate; rim: its edge; target, actuators: outlines. All lie on the surface.
    """

    surface: pyvista.PolyData
    lines: pyvista.PolyData
    rim: pyvista.PolyData
    target: pyvista.PolyData
    actuators: pyvista.PolyData


def scale_over(displacements: Iterable[np.ndarray], size: tuple[float, float]) -> Scale:
    """The scale that holds for all the fields given: those of one case over its times, or of several cases.

    displacements: arrays of any shape [m]; size: sides of the plate [m]. The limit is the largest
    displacement, rounded up to two digits so that the colour bar has short numbers. Values that are not
    finite are passed over; where nothing moves, the scale is 1 µm and heights are true.
    """
    limit = max((_largest(field) for field in displacements), default=0.0)
    if limit == 0:
        return Scale(limit=1e-6, factor=1.0, unit="µm", per_metre=1e6)
    limit = _rounded_up(limit)
    unit, per_metre = next((pair for pair in UNITS if limit * pair[1] < 1000), UNITS[-1])
    return Scale(limit, _two_digits(TALLEST * min(size) / limit), unit, per_metre)


def plate_meshes(scene: Scene, displacement: np.ndarray, scale: Scale) -> PlateMeshes:
    """Everything that is drawn of one field: displacement (ny, nx) [m]."""
    sheet = _Sheet(scene.plate.size, displacement, scale.factor)
    whole = (0.0, scene.plate.size[0], 0.0, scene.plate.size[1])
    return PlateMeshes(
        surface=_surface(sheet, scale.per_metre),
        lines=_polylines(_grid_lines(sheet)),
        rim=_polylines([sheet.outline(whole)]),
        target=_polylines([sheet.outline(scene.target.area)]),
        actuators=_polylines([sheet.outline(actuator.area) for actuator in scene.actuators]),
    )


def caption(drive: str, time: float, localization_factor: float) -> str:
    """Two lines: the drive and the time [s]; the localization factor in percent."""
    share = f"{100 * localization_factor:.2f} %" if math.isfinite(localization_factor) else "not defined"
    return f"{drive}, t = {time:.4g} s\nlocalization factor {share}"


@dataclass(frozen=True)
class _Sheet:
    """A field on its grid, drawn with exaggerated heights.

    Each cell is two flat triangles, split from its lower left to its upper right node, so that it is certain
    where a line on the surface runs.
    """

    size: tuple[float, float]
    displacement: np.ndarray
    factor: float

    @property
    def x(self) -> np.ndarray:
        return np.linspace(0, self.size[0], self.displacement.shape[1])

    @property
    def y(self) -> np.ndarray:
        return np.linspace(0, self.size[1], self.displacement.shape[0])

    @property
    def nodes(self) -> np.ndarray:
        """(ny, nx, 3) where the nodes are drawn; at rest where u is not finite, which VTK could not place."""
        x, y = np.meshgrid(self.x, self.y)
        heights = np.where(np.isfinite(self.displacement), self.displacement, 0) * self.factor
        return np.stack([x, y, heights], -1)

    @property
    def triangles(self) -> np.ndarray:
        """(triangles, 3) indices of nodes, x fastest."""
        index = np.arange(self.displacement.size).reshape(self.displacement.shape)
        corner, right, up, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        lower, upper = np.stack([corner, right, across], -1), np.stack([corner, across, up], -1)
        return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])

    def outline(self, area: Area) -> np.ndarray:
        """(points, 3) closed way around a rectangle, with a point wherever it crosses a triangle's side."""
        x0, x1, y0, y1 = area
        bottom, top = (_crossings(x0, x1, self.x, _offset(y, self.y)) for y in (y0, y1))
        left, right = (_crossings(y0, y1, self.y, _offset(x, self.x)) for x in (x0, x1))
        sides = [
            (bottom, np.full(bottom.size, y0)),
            (np.full(right.size, x1), right),
            (top[::-1], np.full(top.size, y1)),
            (np.full(left.size, x0), left[::-1]),
        ]
        x, y = (np.concatenate(way) for way in zip(*sides, strict=True))
        return np.column_stack([x, y, self._heights_at(x, y)])

    def _heights_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights of the triangles at the points x, y."""
        j, right = _cell(x, self.x)
        i, up = _cell(y, self.y)
        heights = self.nodes[..., 2]
        corner, across = heights[i, j], heights[i + 1, j + 1]
        side = np.where(right >= up, heights[i, j + 1], heights[i + 1, j])
        first, second = np.maximum(right, up), np.minimum(right, up)
        return corner + first * (side - corner) + second * (across - side)


def _cell(at: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For points along one axis: the cells that hold them and how far into the cell they are, 0 to 1."""
    position = np.clip(at / nodes[-1], 0, 1) * (nodes.size - 1)
    cell = np.minimum(position.astype(int), nodes.size - 2)
    return cell, position - cell


def _offset(at: float, nodes: np.ndarray) -> float:
    """How far into its cell a point is, as a share of the cell."""
    return float(_cell(np.array([at]), nodes)[1][0])


def _crossings(start: float, end: float, nodes: np.ndarray, offset: float) -> np.ndarray:
    """Where a line along this axis crosses grid lines and, the share ``offset`` behind them, diagonals."""
    sides = np.concatenate([nodes, nodes[:-1] + offset * nodes[1]])
    return np.array([start, *np.unique(sides[(sides > start) & (sides < end)]), end])


def _surface(sheet: _Sheet, per_metre: float) -> pyvista.PolyData:
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(sheet.nodes.reshape(-1, 3), sheet.triangles)
    mesh.point_data[FIELD] = np.asarray(sheet.displacement, dtype=float).ravel() * per_metre
    return mesh


def _grid_lines(sheet: _Sheet) -> list[np.ndarray]:
    nodes = sheet.nodes
    step_y, step_x = (max(1, round((n - 1) / LINES)) for n in nodes.shape[:2])
    return [*nodes[step_y:-1:step_y], *nodes[:, step_x:-1:step_x].swapaxes(0, 1)]


def _polylines(ways: list[np.ndarray]) -> pyvista.PolyData:
    """One mesh with a polyline for each way (points, 3)."""
    import pyvista

    starts = np.cumsum([0, *(len(way) for way in ways)])
    cells = [
        np.concatenate([[len(way)], np.arange(start, start + len(way))])
        for way, start in zip(ways, starts[:-1], strict=True)
    ]
    return pyvista.PolyData(np.concatenate(ways), lines=np.concatenate(cells))


def _largest(field: np.ndarray) -> float:
    return float(np.max(np.abs(field), initial=0.0, where=np.isfinite(field)))


def _rounded_up(value: float) -> float:
    """To two significant digits; never below the value."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return max(value, float(f"{math.ceil(value / digit * (1 - 1e-12)) * digit:.2g}"))


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")
