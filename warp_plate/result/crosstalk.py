"""Crosstalk between several targets: the energy in each of them under the drive found for each.

A result whose scene has several targets holds the best drive for the first one as the case "best", and for another as
"best NAME". The energies of all cases have a region "target NAME" for each target, beside "plate" and the case's own
"target".
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from warp_plate.result.model import Result
from warp_plate.scene.model import Scene
from warp_plate.scene.target import NamedTarget


def target_regions(scene: Scene) -> dict[str, NamedTarget]:
    """Return the targets by region name; empty if the scene has a single target."""
    return {f"target {target.name}": target for target in scene.targets}


def target_cases(scene: Scene) -> dict[str, str]:
    """Return the name of the case with the best drive by target name; empty if the scene has a single target."""
    return {target.name: f"best {target.name}" if index else "best" for index, target in enumerate(scene.targets)}


def best_drive_scenes(result: Result) -> dict[str, Scene]:
    """Return the scene that ``simulate`` runs as each best drive, by case; aimed at the drive's own target.

    Raises:
        SceneError: a magnitude is larger than a scene may have.
    """
    scene = result.scene
    aimed = {name: scene.aimed_at(index) for index, name in enumerate(target_cases(scene).values())} or {"best": scene}
    return {
        name: replace(result, scene=aim).driven_scene(result.cases[name])
        for name, aim in aimed.items()
        if name in result.cases
    }


def crosstalk(result: Result) -> np.ndarray:
    """Return the (drives, targets) fractions of the plate's energy in each target under the drive for each.

    Rows of targets that an interrupted search did not reach are NaN.
    """
    regions, rows = target_regions(result.scene), []
    for name in target_cases(result.scene).values():
        energy = result.cases[name].energy if name in result.cases else {}
        plate = energy.get("plate", 0.0)
        rows.append([energy.get(region, math.nan) / plate if plate > 0 else math.nan for region in regions])
    return np.array(rows).reshape(len(rows), len(regions))


def decibels(shares: np.ndarray) -> np.ndarray:
    """Return (drives, targets) fractions relative to each drive's own target [dB]; −∞ where nothing moves."""
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.diag(shares)[:, None]
        levels: np.ndarray = 10 * (np.log10(np.maximum(shares, 0)) - np.log10(own))
    return levels
