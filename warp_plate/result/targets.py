"""Several targets of a scene: the energy in each of them under the drive of each, and their outlines.

The case "best" is the best drive for the first target, "best NAME" that for another. The energies of all cases have a
region "target NAME" for each target, beside "plate" and the case's own "target".
"""

from __future__ import annotations

import numpy as np

from warp_plate.plate.shapes import read_mask
from warp_plate.quantities.region_quantities import decibels
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import NamedTarget, Target

DISC_CORNERS = 96


def target_regions(scene: Scene) -> dict[str, NamedTarget]:
    """Return the targets by region name; empty if the scene has a single target."""
    return {f"target {target.name}": target for target in scene.targets}


def target_cases(scene: Scene) -> dict[str, str]:
    """Return the name of the case with the best drive by target name; empty if the scene has a single target."""
    return {target.name: f"best {target.name}" if index else "best" for index, target in enumerate(scene.targets)}


def relative_to_own(shares: np.ndarray) -> np.ndarray:
    """Return (drives, targets) fractions relative to each drive's own target [dB]; −∞ where nothing moves."""
    return decibels(shares, np.diag(shares)[:, None])


def outlines(scene: Scene) -> list[np.ndarray]:
    """Return closed outlines (points, 2) [m] of all targets of a scene."""
    return [outline for key, target in scene.targets_by_key.items() for outline in target_outlines(scene, key, target)]


def target_outlines(scene: Scene, key: str, target: Target) -> list[np.ndarray]:
    """Return closed outlines (points, 2) [m] of one target.

    Those of a mask are its contours at ½; none if its file is gone, as of a result that was moved.
    """
    if (corners := target.corners(DISC_CORNERS)) is not None:
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
    return [np.asarray(line) for line in contour_generator(*padded).lines(0.5)]
