"""Several targets of a scene: the energy in each of them under the drive of each, and their outlines.

The case "best" is the best drive for the first target, "best NAME" that for another. The energies of all cases have a
region "target NAME" for each target, beside "plate" and the case's own "target".
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.plate.shapes import read_mask
from warp_plate.quantities.region_quantities import decibels
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import NamedTarget, Target

if TYPE_CHECKING:
    from warp_plate.result.model import Result

DISC_CORNERS = 96


def target_regions(scene: Scene) -> dict[str, NamedTarget]:
    """Return the targets by region name; empty if the scene has a single target."""
    return {f"target {target.name}": target for target in scene.targets}


def target_cases(scene: Scene) -> dict[str, str]:
    """Return the name of the case with the best drive by target name; empty if the scene has a single target."""
    return {target.name: f"best {target.name}" if index else "best" for index, target in enumerate(scene.targets)}


def best_drive_scenes(result: Result) -> dict[str, Scene]:
    """Return the scene that ``simulate`` runs as each best drive, by case; aimed at the drive's own target.

    A SceneError is raised if a magnitude is larger than a scene may have.
    """
    scene = result.scene
    aimed = {name: scene.aimed_at(index) for index, name in enumerate(target_cases(scene).values())} or {"best": scene}
    present = [name for name in aimed if name in result.cases]
    return {name: replace(result, scene=aimed[name]).driven_scene(result.cases[name]) for name in present}


def crosstalk(result: Result) -> np.ndarray:
    """Return the (drives, targets) fractions of the plate's energy in each target; NaN for drives not reached."""
    regions, rows = target_regions(result.scene), []
    for name in target_cases(result.scene).values():
        energy = result.cases[name].energy if name in result.cases else {}
        plate = energy.get("plate", 0.0)
        rows.append([energy.get(region, math.nan) / plate if plate > 0 else math.nan for region in regions])
    return np.array(rows).reshape(len(rows), len(regions))


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
