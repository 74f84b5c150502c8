"""The largest displacement of a plate by its modes: over a grid of its own, and on the target's outline.

The maximum of a region often lies on its outline, where the displacement has a slope: there a grid alone would miss
several per cent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.motion import modal_amplitudes
from warp_plate.plate.signals import actuator_frequencies
from warp_plate.result.targets import target_outlines

# Points along each side of the plate.
SIDE = 101
# Displacements that are computed at once.
BLOCK_NUMBERS = 2**22


def largest_displacements(plate: ModalPlate, phasors: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest magnitudes (plates, SIDE, SIDE) [m] over the plate, and (plates,) on its target's outline.

    Steady motion of one frequency has the amplitude of its parts in phase and a quarter of a period later, whatever the
    times; any other motion is sampled at them.
    """
    scene = plate.scene
    x, y = (np.linspace(0, side, SIDE) for side in scene.plate.size)
    points = _along(target_outlines(scene, "target", scene.target), max(scene.plate.size) / SIDE)
    at_points = plate.at_points(points)
    over_plate, on_outline = np.zeros((len(phasors), SIDE, SIDE)), np.zeros((len(phasors), len(points)))
    frequencies = set(actuator_frequencies(scene).tolist())
    steady = scene.steady and len(frequencies) == 1
    if steady:
        times = np.array([0.0, 0.25 / frequencies.pop()])
    some = max(2, BLOCK_NUMBERS // max(1, over_plate.size + on_outline.size))
    for first in range(0, times.size, some):
        amplitudes = modal_amplitudes(plate, phasors, times[first : first + some])
        on_grid, on_points = plate.displacement(amplitudes, x, y), amplitudes @ at_points
        for largest, moved in ((over_plate, on_grid), (on_outline, on_points)):
            size = np.hypot(moved[:, 0], moved[:, 1]) if steady else np.abs(moved).max(axis=1)
            np.maximum(largest, size, out=largest)
    return over_plate, on_outline.max(axis=1, initial=0.0)


def _along(outlines: Sequence[np.ndarray], spacing: float) -> np.ndarray:
    """Return points (points, 2) along closed outlines, their corners and others at most ``spacing`` [m] apart."""
    points = [np.empty((0, 2))]
    for outline in outlines:
        length = np.concatenate([[0.0], np.hypot(*np.diff(outline, axis=0).T).cumsum()])
        at = np.union1d(length, np.linspace(0, length[-1], math.ceil(length[-1] / spacing) + 1))
        points.append(np.column_stack([np.interp(at, length, column) for column in outline.T]))
    return np.concatenate(points)
