"""What the drives for several targets do at each other's: cases and regions by name, and the table of shares.

A result whose scene has several targets holds the best drive for the first of them as the case "best", for every other
one as the case "best NAME"; their energies have a region "target NAME" for each target beside the plate and the case's
own "target".
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from warp_plate.result.model import Result
from warp_plate.scene.model import Scene
from warp_plate.scene.target import NamedTarget


def target_regions(scene: Scene) -> dict[str, NamedTarget]:
    """The scene's several targets by the names of their regions; nothing where it has but one."""
    return {f"target {target.name}": target for target in scene.targets}


def target_cases(scene: Scene) -> dict[str, str]:
    """The case of the best drive for each of the several targets, by the target's name."""
    return {target.name: f"best {target.name}" if index else "best" for index, target in enumerate(scene.targets)}


def best_drive_scenes(result: Result) -> dict[str, Scene]:
    """By case, the scene that ``simulate`` runs as each best drive; aimed at its own target where there are several.

    Raises:
        SceneError: a magnitude beyond what a scene may have.
    """
    scene = result.scene
    aims = {name: scene.aimed_at(index) for index, name in enumerate(target_cases(scene).values())}
    return {
        name: replace(result, scene=aim).driven_scene(result.cases[name])
        for name, aim in (aims or {"best": scene}).items()
        if name in result.cases
    }


def crosstalk(result: Result) -> np.ndarray:
    """(drives, targets) share of the plate's kinetic energy in each target's region under the drive found for each.

    NaN in the rows of targets that an interrupted search did not come to.
    """
    regions, rows = target_regions(result.scene), []
    for name in target_cases(result.scene).values():
        energy = result.cases[name].energy if name in result.cases else {}
        plate = energy.get("plate", 0.0)
        rows.append([energy.get(region, math.nan) / plate if plate > 0 else math.nan for region in regions])
    return np.array(rows).reshape(len(rows), len(regions))


def decibels(shares: np.ndarray) -> np.ndarray:
    """(drives, targets) of a table of shares against each drive's own target; −∞ where nothing moves."""
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.diag(shares)[:, None]
        found: np.ndarray = 10 * (np.log10(np.maximum(shares, 0)) - np.log10(own))
    return found
