"""Plates with an outline in pictures: fields continued beyond it, meshes that end at it, and images clipped to it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.outline.outline import Outline
from warp_plate.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Steps to the neighbours of a node, (rows, columns).
STEPS = np.array([(j, i) for j in (-1, 0, 1) for i in (-1, 0, 1) if (j, i) != (0, 0)])


class OutlinedNodes:
    """The nodes of a grid over the frame of a plate with an outline.

    Nodes off the plate that have a neighbour on it form the rim. Its values continue those of the nearest neighbour
    and of the next node behind along a straight line.

    Attributes:
        inside: (ny, nx) true for nodes on the plate.
        rim: (n, 2) row and column of the nodes of the rim.
    """

    def __init__(self, outline: Outline, size: tuple[float, float], nodes: tuple[int, int]) -> None:
        self.outline = outline
        x, y = (np.linspace(0, side, count) for side, count in zip(size, nodes, strict=True))
        self._places = np.stack(np.meshgrid(x, y), axis=-1)
        self.inside = outline.contains(self._places)
        beside = np.pad(self.inside, 1)
        near = np.array([beside[1 + j : 1 + j + y.size, 1 + i : 1 + i + x.size] for j, i in STEPS])
        self.rim = np.argwhere(near.any(axis=0) & ~self.inside)
        self._near = near[:, *self.rim.T]

    @cached_property
    def moved(self) -> np.ndarray:
        """(n, 2) points of the outline nearest to the rim [m]."""
        import shapely

        lines = shapely.MultiLineString([[*line, line[0]] for line in self.outline.polygons()])
        rim = shapely.points(self._places[*self.rim.T])
        return np.asarray(shapely.get_coordinates(shapely.shortest_line(rim, lines)).reshape(-1, 2, 2)[:, 1])

    @property
    def places(self) -> np.ndarray:
        """(ny, nx, 2) places of the nodes [m], those of the rim on the outline."""
        places = self._places.copy()
        places[*self.rim.T] = self.moved
        return places

    @property
    def shown(self) -> np.ndarray:
        """(ny − 1, nx − 1) true for cells that touch the plate."""
        known = self.inside.copy()
        known[*self.rim.T] = True
        corners = [known[:-1, :-1], known[1:, :-1], known[:-1, 1:], known[1:, 1:]]
        touched = self.inside[:-1, :-1] | self.inside[1:, :-1] | self.inside[:-1, 1:] | self.inside[1:, 1:]
        return np.asarray(np.logical_and.reduce(corners) & touched)

    def continued(self, fields: np.ndarray, moved: bool = False, straight: bool = True) -> np.ndarray:
        """Return fields (..., ny, nx) with values on the rim.

        Args:
            fields: Fields over the nodes.
            moved: True for values at the places where ``places`` has the rim, False for values at its nodes.
            straight: False to take the value of the nearest neighbour alone, as of angles.
        """
        ends, last = self.moved if moved else self._places[*self.rim.T], np.array(self.inside.shape) - 1
        first, second = (self.rim[:, None] + factor * STEPS for factor in (1, 2))
        away = np.linalg.norm(self._places[*np.moveaxis(np.clip(first, 0, last), -1, 0)] - ends[:, None], axis=-1)
        behind = self.inside[*np.moveaxis(np.clip(second, 0, last), -1, 0)] & (second == np.clip(second, 0, last)).all(
            -1
        )
        # The nearest neighbour with a node behind it, else the nearest.
        chosen = np.where(self._near.T, away + np.where(behind, 0, away.max()), np.inf).argmin(axis=1)
        each = np.arange(len(self.rim))
        first, second, away = first[each, chosen], np.clip(second[each, chosen], 0, last), away[each, chosen]
        pitch = np.linalg.norm(self._places[*first.T] - self._places[*self.rim.T], axis=-1)
        part = np.where(behind[each, chosen] & straight, away / pitch, 0.0)
        values = np.array(fields, dtype=float)
        near, far = values[..., *first.T], np.where(part > 0, values[..., *second.T], 0.0)
        values[..., *self.rim.T] = (1 + part) * near - part * far
        return values


_nodes_of = lru_cache(8)(OutlinedNodes)


def outlined_nodes(scene: Scene, shape: tuple[int, ...]) -> OutlinedNodes | None:
    """Return the nodes of fields of a shape (..., ny, nx); None for a rectangle."""
    if scene.plate.outline is None or scene.outline is None:
        return None
    return _nodes_of(scene.outline, scene.plate.size, (shape[-1], shape[-2]))


def continued(scene: Scene, fields: np.ndarray, straight: bool = True) -> np.ndarray:
    """Return fields (..., ny, nx), of a plate with an outline with values just beyond it."""
    nodes = outlined_nodes(scene, fields.shape)
    return fields if nodes is None else nodes.continued(fields, straight=straight)


def clip(artist: Any, axes: Axes, scene: Scene) -> None:
    """Clip an image to the plate, and leave the paper white where there is none."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if scene.plate.outline is None or scene.outline is None:
        return
    loops = [Path([*line, line[0]], closed=True) for line in scene.outline.polygons()]
    artist.set_clip_path(PathPatch(Path.make_compound_path(*loops), transform=axes.transData))
    artist.set_in_layout(False)  # a clipped image would push titles out of the figure
    axes.spines[:].set_visible(False)


def on_plate(scene: Scene, paths: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the outer outlines (points, 2) [m], closed, of what lies on the plate inside closed paths."""
    if scene.outline is None:
        return list(paths)
    import shapely

    shell, *holes = scene.outline.polygons()
    valid = {"method": "structure", "keep_collapsed": False}
    covered = [shapely.make_valid(shapely.Polygon(path), **valid) for path in paths]
    parts = shapely.get_parts(shapely.intersection(covered, shapely.Polygon(shell, holes)))
    return [shapely.get_coordinates(part.exterior) for part in parts if part.area > 0]
