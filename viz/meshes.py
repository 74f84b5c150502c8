"""PyVista meshes of a plate that follow a displacement field, as data without a window.

Heights are exaggerated: a node at (x, y) with displacement u is drawn at (x, y, warp factor × u), all in metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.targets import outlines
from warp_plate.scene.model import Scene
from warp_plate.viz.fields import DrawingScale
from warp_plate.viz.styles import edges_by_kind, rectangle

if TYPE_CHECKING:
    import pyvista

SCALARS = "colour"
# About as many grid lines as the paper's 27 x 27 nodes have; of finer grids every second, third, … line is drawn.
GRID_LINES = 26


@dataclass(frozen=True)
class SurfaceLines:
    """Lines that lie on the triangles of the surface.

    Attributes:
        mesh: straight segments, each within one triangle.
        nodes: (points, 3) corners of the triangle that holds each point.
        weights: (points, 3) barycentric coordinates of the points in their triangles.
    """

    mesh: pyvista.PolyData
    nodes: np.ndarray
    weights: np.ndarray


class PlateMeshes:
    """Meshes of one plate; for the arguments see :meth:`update`.

    Attributes:
        surface: a point per node, x fastest, with point data SCALARS in the unit of the colour bar.
        lines: "grid" (lines inside the plate), edges by their support (a key of EDGE_STYLES), outlines of the "target"
            or targets and of the "actuators", in drawing order; those that are there.
    """

    def __init__(
        self, scene: Scene, displacement: np.ndarray, scale: DrawingScale, values: np.ndarray | None = None
    ) -> None:
        import pyvista

        grid = _FlatGrid(scene.plate.size, displacement.shape[::-1])
        self.surface = pyvista.PolyData.from_regular_faces(grid.points(), grid.triangles())
        self.surface.point_data[SCALARS] = np.zeros(displacement.size)
        paths = {
            "grid": grid.inner_lines(),
            **{kind: list(ends.values()) for kind, ends in edges_by_kind(scene).items()},
            "target": outlines(scene),
            "actuators": [rectangle(actuator.area) for actuator in scene.actuators],
        }
        self.lines = {name: grid.lines(drawn) for name, drawn in paths.items() if drawn}
        self.update(displacement, scale, values)

    def update(self, displacement: np.ndarray, scale: DrawingScale, values: np.ndarray | None = None) -> None:
        """Move to another field in place.

        Args:
            displacement: (ny, nx) [m]; nodes without a finite one are drawn at rest.
            values: (ny, nx) of the scale's field in its SI unit (default: the displacement).
        """
        heights = (np.where(np.isfinite(displacement), displacement, 0) * scale.warp_factor).ravel()
        self.surface.points[:, 2] = heights
        scalars = displacement if values is None else values
        self.surface.point_data[SCALARS][:] = np.asarray(scalars, dtype=float).ravel() * scale.unit_factor
        for lines in self.lines.values():
            lines.mesh.points[:, 2] = np.einsum("pc,pc->p", heights[lines.nodes], lines.weights)


@dataclass(frozen=True)
class _FlatGrid:
    """The undeformed grid; each cell is two triangles, split from its lower left to its upper right node."""

    size: tuple[float, float]  # [m]
    nodes: tuple[int, ...]  # along x and y

    def points(self) -> np.ndarray:
        """Return (nodes, 3) positions of the nodes at rest, x fastest."""
        x, y = np.meshgrid(*map(np.linspace, (0, 0), self.size, self.nodes))
        return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)

    def triangles(self) -> np.ndarray:
        """Return (triangles, 3) node indices, cell by cell, so that a renderer finds most nodes in its cache."""
        index = np.arange(math.prod(self.nodes)).reshape(self.nodes[::-1])
        corner, right, up, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        lower, upper = np.stack([corner, right, across], -1), np.stack([corner, across, up], -1)
        return np.stack([lower, upper], axis=2).reshape(-1, 3)

    def inner_lines(self) -> list[list[tuple[float, float]]]:
        """Return the ends of grid lines inside the plate, about GRID_LINES each way."""
        (width, height), positions = self.size, []
        for side, nodes in zip(self.size, self.nodes, strict=True):
            step = max(1, round((nodes - 1) / GRID_LINES))
            positions.append(np.linspace(0, side, nodes)[step:-1:step])
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
