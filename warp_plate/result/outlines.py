"""Outlines of targets, for pictures."""

from __future__ import annotations

import numpy as np

from warp_plate.plate.shapes import read_mask
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

DISC_CORNERS = 96
MASK_LEVEL = 0.5


def outlines(scene: Scene) -> list[np.ndarray]:
    """Return closed outlines (points, 2) [m] of all targets of a scene."""
    return [way for key, target in scene.targets_by_key.items() for way in target_outlines(scene, key, target)]


def target_outlines(scene: Scene, key: str, target: Target) -> list[np.ndarray]:
    """Return closed outlines (points, 2) [m] of one target.

    Those of a mask are its contours at ``MASK_LEVEL``; none if its file is gone, as beside a moved result.
    """
    corners = target.corners(DISC_CORNERS)
    if corners is not None:
        return [np.concatenate([corners, corners[:1]])]
    from contourpy import contour_generator

    try:
        values = read_mask(scene, key, target)
    except SceneError:
        return []
    values = np.broadcast_to(values, (max(len(values), 2), max(values.shape[1], 2)))
    x, y = (np.linspace(0, side, count) for side, count in zip(scene.plate.size, values.shape[::-1], strict=True))
    # A rim of zeros at the place of the edge closes the contours that meet the edge.
    padded = np.pad(x, 1, mode="edge"), np.pad(y, 1, mode="edge"), np.pad(values, 1)
    return [np.asarray(way) for way in contour_generator(*padded).lines(MASK_LEVEL)]
