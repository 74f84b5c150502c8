"""Sound of a plate as its observers take it: the points where it is heard, the baffle, and what unit inputs radiate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import air_of, efficiencies
from warp_plate.modal.unbaffled import radiation_of, refuse_outline
from warp_plate.result.frequency_response import OF_PLATE, SOUND_POWER, SOUND_PRESSURE, Quantity
from warp_plate.scene.errors import SceneError, numbers_of
from warp_plate.scene.model import Scene

# Distance from the plate of points that listen unless others are named [m].
DISTANCE = 1.0
Point = tuple[float, float]
# Return (n, responses) from frequencies (n,) [Hz] and amplitudes (n, modes, inputs) under unit inputs.
Observer = Callable[[np.ndarray, np.ndarray], np.ndarray]


def target_middles(scene: Scene) -> list[Point]:
    """Return the middle of the bounding box of each target [m]; of a mask, the middle of the plate."""
    width, height = scene.plate.size
    middles = []
    for target in scene.targets_by_key.values():
        corners = target.corners(of_disc=4)
        if corners is None:
            corners = np.array([(0, 0), (width, height)])
        x, y = (corners.min(axis=0) + corners.max(axis=0)) / 2
        middles.append((float(x), float(y)))
    return list(dict.fromkeys(middles))


def listening_points(scene: Scene, points: Sequence[Any], quantity: str = SOUND_PRESSURE) -> list[tuple[float, ...]]:
    """Return points (x, y, z) [m] of pressures, 1 m above the middles of the targets unless others are named; none of
    other quantities."""
    if quantity in OF_PLATE and len(points):
        raise SceneError(f"points = {points[0]}: the {quantity} is that of the whole plate; leave out points")
    if quantity in OF_PLATE:
        return []
    given = [tuple(numbers_of(f"points[{index}]", point, 3, "x, y, z in metres")) for index, point in enumerate(points)]
    return given or [(x, y, DISTANCE) for x, y in target_middles(scene)]


def in_baffle(scene: Scene, baffle: bool) -> bool:
    """Return if the sound of a scene is that of a plate in a baffle; SceneError: without one, it has an outline."""
    baffle = baffle and (scene.effects.air is None or scene.effects.air.baffle)
    if not baffle:
        refuse_outline(scene)
    return baffle


def observe_sound(
    plate: ModalPlate, highest: float, quantity: Quantity, points: Sequence[Any], baffle: bool
) -> Observer:
    """Return the observer of the sound of a plate up to a highest frequency [Hz]."""
    air = air_of(plate.scene)
    radiation = radiation_of(plate, highest, air, baffle)

    def observe(frequencies: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        if quantity == SOUND_PRESSURE:
            return radiation.pressures(frequencies, amplitudes, np.array(points)).mT.reshape(len(frequencies), -1)
        powers = radiation.powers(frequencies, amplitudes)
        if quantity == SOUND_POWER:
            return powers
        return efficiencies(plate, air, frequencies, amplitudes, powers) / (1 if baffle else 2)

    return observe
