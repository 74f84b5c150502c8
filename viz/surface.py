"""What is drawn of a plate: PyVista meshes that follow a field, as data and without a window.

Heights are exaggerated: a node at (x, y) with displacement u is drawn at (x, y, factor × u), all in metres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.outlines import outlines
from warp_plate.scene.model import Area, Scene
from warp_plate.viz.edges import SIDES, kinds_of
from warp_plate.viz.quantity import Scale

if TYPE_CHECKING:
    import pyvista

FIELD = "colour"
# About as many grid lines as the paper's 27 x 27 nodes have; finer grids show every second, third, ... line.
LINES = 26
# A width of a dashed side's line, as a share of the mean side of the plate.
DASH = 0.008


@dataclass(frozen=True)
class OnSurface:
    """Polylines on the triangles of the surface.

    nodes: (points, 3) the corners of the triangle that holds a point; shares: (points, 3) of their heights in its own.
    """

    mesh: pyvista.PolyData
    nodes: np.ndarray
    shares: np.ndarray

    def follow(self, heights: np.ndarray) -> None:
        """Lift every point onto the surface; heights: (nodes,) x fastest [m]."""
        self.mesh.points[:, 2] = np.einsum("pc,pc->p", heights[self.nodes], self.shares)


@dataclass(frozen=True)
class PlateMeshes:
    """The parts of one picture; :meth:`show` moves them all.

    surface: one point a node, x fastest, with the point data FIELD in the colour bar's unit. lines: grid lines inside
    the plate; sides: its edge, by what holds it (keys of SIDES); target, actuators: outlines. All lie on the surface.
    """

    surface: pyvista.PolyData
    lines: OnSurface
    sides: Mapping[str, OnSurface]
    target: OnSurface
    actuators: OnSurface

    @property
    def outlines(self) -> tuple[OnSurface, ...]:
        """All that follows the surface."""
        return self.lines, *self.sides.values(), self.target, self.actuators

    def show(self, displacement: np.ndarray, scale: Scale, colours: np.ndarray | None = None) -> None:
        """Move to another field, in place.

        Args:
            displacement: (ny, nx) [m]; drawn at rest where it is not finite, which VTK could not place.
            colours: (ny, nx) of the scale's quantity in its SI unit; left out: the displacement.
        """
        heights = (np.where(np.isfinite(displacement), displacement, 0) * scale.factor).ravel()
        self.surface.points[:, 2] = heights
        shown = displacement if colours is None else colours
        self.surface.point_data[FIELD][:] = np.asarray(shown, dtype=float).ravel() * scale.per_base
        for outline in self.outlines:
            outline.follow(heights)


def plate_meshes(
    scene: Scene, displacement: np.ndarray, scale: Scale, colours: np.ndarray | None = None
) -> PlateMeshes:
    """Everything that is drawn of one field; see :meth:`PlateMeshes.show`."""
    import pyvista

    sheet = _Sheet(scene.plate.size, (displacement.shape[1], displacement.shape[0]))
    surface = pyvista.PolyData.from_regular_faces(sheet.flat, sheet.triangles)
    surface.point_data[FIELD] = np.zeros(displacement.size)
    meshes = PlateMeshes(
        surface=surface,
        lines=sheet.lay(sheet.grid_lines()),
        sides={kind: sheet.lay(sheet.sides(kind, names)) for kind, names in kinds_of(scene).items()},
        target=sheet.lay([sheet.along(way) for way in outlines(scene)]),
        actuators=sheet.lay([sheet.outline(actuator.area) for actuator in scene.actuators]),
    )
    meshes.show(displacement, scale, colours)
    return meshes


def caption(drive: str, time: float, localization_factor: float, decimals: int | None = None) -> str:
    """Two lines: the drive and the time [s]; the localization factor in percent.

    decimals: of the time, so that the text of a moving picture keeps its length; left out: four digits.
    """
    share = f"{100 * localization_factor:.2f} %" if math.isfinite(localization_factor) else "not defined"
    moment = f"{time:.4g}" if decimals is None else f"{time:.{decimals}f}"
    return f"{drive}, t = {moment} s\nlocalization factor {share}"


@dataclass(frozen=True)
class _Sheet:
    """The grid, flat: sides of the plate [m] and nodes along them.

    Each cell is two flat triangles, split from its lower left to its upper right node, so that it is certain
    where a line on the surface runs.
    """

    size: tuple[float, float]
    nodes: tuple[int, int]

    @property
    def x(self) -> np.ndarray:
        return np.linspace(0, self.size[0], self.nodes[0])

    @property
    def y(self) -> np.ndarray:
        return np.linspace(0, self.size[1], self.nodes[1])

    @property
    def flat(self) -> np.ndarray:
        """(nodes, 3) where the nodes rest, x fastest."""
        x, y = np.meshgrid(self.x, self.y)
        return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)

    @property
    def triangles(self) -> np.ndarray:
        """(triangles, 3) indices of nodes, cell by cell, x fastest.

        A cell's two stand together, so that what draws them finds most of their nodes at hand.
        """
        index = np.arange(math.prod(self.nodes)).reshape(self.nodes[::-1])
        corner, right, up, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        lower, upper = np.stack([corner, right, across], -1), np.stack([corner, across, up], -1)
        return np.stack([lower, upper], axis=2).reshape(-1, 3)

    def line(self, start: Sequence[float], end: Sequence[float]) -> np.ndarray:
        """(points, 2) a straight way, with a point wherever it crosses a triangle's side."""
        ends = np.array([start, end], dtype=float)
        x, y = (ends / self.size * (np.array(self.nodes) - 1)).T
        shares = [np.array([0.0, 1.0])]
        # Lines of the grid along y and along x, and the cells' diagonals, are where one of these is a whole number.
        for low, high in (x, y, x - y):
            whole = np.arange(math.ceil(min(low, high)), math.floor(max(low, high)) + 1)
            shares.append((whole - low) / (high - low) if low != high else np.empty(0))
        share = np.unique(np.concatenate(shares))[:, None]
        return (1 - share) * ends[0] + share * ends[1]

    def along(self, way: np.ndarray) -> np.ndarray:
        """(points, 2) a way through given points (points, 2)."""
        return np.concatenate([self.line(*ends) for ends in pairwise(way)])

    def outline(self, area: Area) -> np.ndarray:
        """(points, 2) closed way around a rectangle."""
        x0, x1, y0, y1 = area
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
        return self.along(np.array(corners))

    def sides(self, kind: str, names: Sequence[str]) -> list[np.ndarray]:
        """The sides of one kind, or their dashes."""
        width, height = self.size
        ends = {
            "left": ((0, 0), (0, height)),
            "bottom": ((0, 0), (width, 0)),
            "right": ((width, 0), (width, height)),
            "top": ((0, height), (width, height)),
        }
        dashes = SIDES[kind].dashes
        ways = []
        for name in names:
            start, end = (np.array(corner, dtype=float) for corner in ends[name])
            for low, high in _dashes(dashes, float(np.abs(end - start).max()), DASH * math.sqrt(math.prod(self.size))):
                ways.append(self.line(start + low * (end - start), start + high * (end - start)))
        return ways

    def grid_lines(self) -> list[np.ndarray]:
        step_x, step_y = (max(1, round((n - 1) / LINES)) for n in self.nodes)
        x, y = self.x, self.y
        return [
            *(np.column_stack([x, np.full_like(x, at)]) for at in y[step_y:-1:step_y]),
            *(np.column_stack([np.full_like(y, at), y]) for at in x[step_x:-1:step_x]),
        ]

    def lay(self, ways: Sequence[np.ndarray]) -> OnSurface:
        """Ways (points, 2) as polylines of one mesh that can follow the surface."""
        import pyvista

        points = np.concatenate([np.empty((0, 2)), *ways])
        starts = np.cumsum([0, *(len(way) for way in ways)])
        cells = [
            np.concatenate([[len(way)], np.arange(start, start + len(way))])
            for way, start in zip(ways, starts[:-1], strict=True)
        ]
        places = np.column_stack([points, np.zeros(len(points))])
        mesh = pyvista.PolyData(places, lines=np.concatenate(cells)) if cells else pyvista.PolyData()
        return OnSurface(mesh, *self._held_by(points))

    def _held_by(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(points, 3) the nodes of the triangle that each point lies in, and their shares."""
        j, right = _cell(points[:, 0], self.x)
        i, up = _cell(points[:, 1], self.y)
        lower = right >= up
        row = self.nodes[0]
        corner, across = i * row + j, (i + 1) * row + j + 1
        side = np.where(lower, i * row + j + 1, (i + 1) * row + j)
        first, second = np.maximum(right, up), np.minimum(right, up)
        return np.stack([corner, side, across], -1), np.stack([1 - first, first - second, second], -1)


def _dashes(dashes: tuple[float, float] | None, length: float, unit: float) -> list[tuple[float, float]]:
    """Beginnings and ends of the dashes of a line, as shares of its length; a solid line is one."""
    if dashes is None:
        return [(0.0, 1.0)]
    drawn, gap = (part * unit for part in dashes)
    count = max(1, round((length + gap) / (drawn + gap)))
    pitch = 1 / (count - gap / (drawn + gap))
    share = pitch * drawn / (drawn + gap)
    return [(index * pitch, min(index * pitch + share, 1.0)) for index in range(count)]


def _cell(at: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For points along one axis: the cells that hold them and how far into the cell they are, 0 to 1."""
    position = np.clip(at / nodes[-1], 0, 1) * (nodes.size - 1)
    cell = np.minimum(position.astype(int), nodes.size - 2)
    return cell, position - cell
