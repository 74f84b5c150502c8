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
    lines: grid lines; rim: the edge of the plate; target, actuators: their outlines. All lie on the surface.
    """

    surface: pyvista.StructuredGrid
    lines: pyvista.PolyData
    rim: pyvista.PolyData
    target: pyvista.PolyData
    actuators: pyvista.PolyData


def scale_over(displacements: Iterable[np.ndarray], size: tuple[float, float]) -> Scale:
    """The scale that holds for all the fields given: those of one case over its times, or of several cases.

    displacements: arrays of any shape [m]; size: sides of the plate [m]. Values that are not finite are passed
    over; where nothing moves, the scale is 1 µm and heights are true. The limit is the largest displacement,
    rounded up to two digits so that the colour bar has short numbers.
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
    """A field on its grid, drawn with exaggerated heights; bilinear between nodes."""

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
    def heights(self) -> np.ndarray:
        """(ny, nx) heights [m]; zero where the field is not finite, which VTK could not place."""
        return np.where(np.isfinite(self.displacement), self.displacement, 0.0) * self.factor

    def outline(self, area: Area) -> np.ndarray:
        """(points, 3) closed way around a rectangle, with a point wherever it crosses a grid line."""
        x0, x1, y0, y1 = area
        x = np.array([x0, *self.x[(self.x > x0) & (self.x < x1)], x1])
        y = np.array([y0, *self.y[(self.y > y0) & (self.y < y1)], y1])
        way_x = [x, np.full(y.size, x1), x[::-1], np.full(y.size, x0)]
        way_y = [np.full(x.size, y0), y, np.full(x.size, y1), y[::-1]]
        at = np.column_stack([np.concatenate(way_x), np.concatenate(way_y)])
        return np.column_stack([at, self._heights_at(at[:, 0], at[:, 1])])

    def _heights_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Bilinear interpolation of the heights."""
        ny, nx = self.displacement.shape
        column = np.clip(x / self.size[0], 0, 1) * (nx - 1)
        row = np.clip(y / self.size[1], 0, 1) * (ny - 1)
        j, i = np.minimum(column.astype(int), nx - 2), np.minimum(row.astype(int), ny - 2)
        right, up, heights = column - j, row - i, self.heights
        below = (1 - right) * heights[i, j] + right * heights[i, j + 1]
        above = (1 - right) * heights[i + 1, j] + right * heights[i + 1, j + 1]
        return (1 - up) * below + up * above


def _surface(sheet: _Sheet, per_metre: float) -> pyvista.StructuredGrid:
    import pyvista

    x, y = np.meshgrid(sheet.x, sheet.y)
    mesh = pyvista.StructuredGrid()
    mesh.points = np.column_stack([x.ravel(), y.ravel(), sheet.heights.ravel()])
    mesh.dimensions = (x.shape[1], x.shape[0], 1)
    mesh.point_data[FIELD] = np.asarray(sheet.displacement, dtype=float).ravel() * per_metre
    return mesh


def _grid_lines(sheet: _Sheet) -> list[np.ndarray]:
    x, y = np.meshgrid(sheet.x, sheet.y)
    nodes = np.stack([x, y, sheet.heights], axis=-1)
    step_y, step_x = (max(1, round((n - 1) / LINES)) for n in x.shape)
    return [*nodes[::step_y], *nodes[:, ::step_x].swapaxes(0, 1)]


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
