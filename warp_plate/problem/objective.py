"""What the search is after: from positions of the swarm to drives, and from energies to losses."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from warp_plate.plate.weights import localization_factor
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Objective


def drives_of(positions: np.ndarray) -> np.ndarray:
    """(plates, actuators) phasors Z [N/m²] of positions (plates, 2·(actuators − 1)).

    Section II.C of the source paper: a position is w₂ ... w_M, φ₂ ... φ_M, with w₁ = 1 and φ₁ = 0, because a common
    factor does not change the localization factor, nor does a common phase once the plate vibrates steadily (in the
    scene ``paper`` what is left of the start moves it by 4e-5); Z = w exp(−iφ).
    """
    magnitude, phase = np.split(np.asarray(positions, dtype=float), 2, axis=1)
    first = np.ones((len(magnitude), 1), dtype=complex)
    return np.concatenate([first, magnitude * np.exp(-1j * phase)], axis=1)


def unit_of_drives(scene: Scene) -> float:
    """What a magnitude of one in the search stands for: the largest magnitude that the scene's actuators have.

    Where displacements are linear in the drives a common factor changes no localization factor, and it is one.
    """
    largest = max(abs(actuator.magnitude) for actuator in scene.actuators)
    return 1.0 if scene.linear or largest == 0 else largest


def loss(energy: np.ndarray) -> np.ndarray:
    """(plates,) Λ = 1 − LF, Problem 2 of the source paper."""
    return 1 - localization_factor(energy)


def least_size(objectives: Iterable[Objective]) -> float:
    """What tolerances of a loss are parts of where the loss itself is smaller (``record.size_of``); 1 of 1 − LF.

    Localization, contrast and uniformity are numbers of order one, whose sum with others may pass zero. A velocity or a
    displacement is as small as its unit makes it: its own size is all that there is to go by.
    """
    return float(sum(one.weight for one in objectives if one.kind not in ("velocity", "displacement")))
