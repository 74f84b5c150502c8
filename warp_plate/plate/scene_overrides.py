"""Scenes with other drives and other places of their actuators."""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_plate.scene.fields import SMALLEST
from warp_plate.scene.model import Scene


def scene_with(
    scene: Scene,
    magnitude: np.ndarray | None = None,
    phase: np.ndarray | None = None,
    frequency: np.ndarray | None = None,
    centre: np.ndarray | None = None,
    delay: np.ndarray | None = None,
) -> Scene:
    """Return a scene with other values of its actuators (default: the scene's).

    Forces stay forces. A frequency or delay that all actuators share becomes the drive's own.

    Args:
        magnitude: (actuators,) magnitudes [N/m², or V].
        phase: (actuators,) phase lags [rad].
        frequency: (actuators,) frequencies [Hz].
        centre: (actuators, 2) x, y of the actuators' centres [m].
        delay: (actuators,) starts of the bursts [s].

    Raises:
        SceneError: No scene may have such numbers, for example a magnitude beyond 1e30.
    """
    actuators: list[dict[str, Any]] = [actuator.model_dump() for actuator in scene.actuators]
    drive = scene.drive.model_dump()
    if magnitude is not None:
        magnitude = magnitude * [actuator.amplitude_area for actuator in scene.actuators]
    keys = [actuator.amplitude_key for actuator in scene.actuators]
    for names, values in ((keys, magnitude), (["phase"] * len(keys), phase)):
        if values is not None:
            for actuator, name, value in zip(actuators, names, values.tolist(), strict=True):
                actuator[name] = value if abs(value) >= SMALLEST else 0.0
    for name, values, table, key in (
        ("frequency", frequency, drive, "frequency"),
        ("delay", delay, drive["burst"], "start"),
    ):
        if values is None:
            continue
        shared = table is not None and bool((values == values[0]).all())
        if shared:
            table[key] = float(values[0])
        for actuator, value in zip(actuators, values.tolist(), strict=True):
            actuator[name] = None if shared else value
    if centre is not None:
        for actuator, (x, y) in zip(actuators, centre.tolist(), strict=True):
            x0, x1, y0, y1 = actuator["area"]
            actuator["area"] = (*_span_around(x, x0, x1), *_span_around(y, y0, y1))
    return scene.with_tables(drive=drive, actuators=actuators)


def scene_phasors(scene: Scene) -> np.ndarray:
    """Return (actuators,) phasors of the actuators' magnitudes and phases."""
    magnitude = np.array([actuator.magnitude for actuator in scene.actuators])
    phase = np.array([actuator.phase for actuator in scene.actuators])
    phasors: np.ndarray = magnitude * np.exp(-1j * phase)
    return phasors


def actuator_centres(scene: Scene) -> np.ndarray:
    """Return (actuators, 2) x, y of the actuators' centres [m]."""
    areas = np.array([actuator.area for actuator in scene.actuators])
    return np.stack([(areas[:, 0] + areas[:, 1]) / 2, (areas[:, 2] + areas[:, 3]) / 2], axis=1)


def _span_around(middle: float, low: float, high: float) -> tuple[float, float]:
    """Return low and high moved to another middle; unchanged to the last bit if the middle is the same."""
    if middle == (low + high) / 2:
        return low, high
    return middle - (high - low) / 2, middle + (high - low) / 2
