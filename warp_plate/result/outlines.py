"""The way round a target, for pictures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from warp_plate.plate.shapes import read_mask
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# A drawn disc's.
CORNERS = 96
# Of a mask: where its numbers pass this one.
LEVEL = 0.5


def outlines(scene: Scene) -> list[np.ndarray]:
    """Ways (points, 2) [m], each closed, around all targets of a scene."""
    return [way for key, target in scene.targets_by_key.items() for way in target_outlines(scene, key, target)]


def target_outlines(scene: Scene, key: str, target: Target) -> list[np.ndarray]:
    """The ways around one target.

    A mask's are where it passes LEVEL; there are none where its file is no longer there, as beside a moved result.
    """
    corners = target.corners(CORNERS)
    if corners is not None:
        return [np.concatenate([corners, corners[:1]])]
    try:
        values = read_mask(scene, key, target)
    except SceneError:
        return []
    values = np.broadcast_to(values, (max(len(values), 2), max(values.shape[1], 2)))
    x, y = (np.linspace(0, side, count) for side, count in zip(scene.plate.size, values.shape[::-1], strict=True))
    # A rim of zeros in the same place as the edge, along which an outline that meets the edge goes on.
    return _contours(np.pad(x, 1, mode="edge"), np.pad(y, 1, mode="edge"), np.pad(values, 1))


def _contours(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Closed ways (points, 2) along which values (points of y, points of x) pass LEVEL; zeros at the rim.

    Each cell is two triangles, in each of which the way is straight between two of its sides.
    """
    index = np.arange(values.size).reshape(values.shape)
    low, right, up, across = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    triangles = np.concatenate([np.stack([low, right, across], 1), np.stack([low, across, up], 1)])
    above = values.ravel() >= LEVEL
    triangles = triangles[above[triangles].any(axis=1) & ~above[triangles].all(axis=1)]
    ahead: dict[tuple[int, int], tuple[int, int]] = {}
    for corners in triangles.tolist():
        sides = [(a, b) for a, b in pairwise([*corners, corners[0]]) if above[a] != above[b]]
        # Triangles go round counterclockwise: with what is above on the left, the way enters by the side that sinks.
        enter, leave = sorted(sides, key=lambda side: above[side[1]])
        ahead[(min(enter), max(enter))] = (min(leave), max(leave))
    ways = []
    while ahead:
        start, now = ahead.popitem()
        way = [start, now]
        while now != start:
            now = ahead.pop(now)
            way.append(now)
        first, second = np.array(way).T
        here, there = values.ravel()[first], values.ravel()[second]
        share = (LEVEL - here) / (there - here)
        column, row = (np.stack([first, second]) % x.size, np.stack([first, second]) // x.size)
        ways.append(
            np.column_stack([(1 - share) * axis[at[0]] + share * axis[at[1]] for axis, at in ((x, column), (y, row))])
        )
    return ways
