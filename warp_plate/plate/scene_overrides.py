"""From what a plate of a batch had of its own to a scene that is that plate, and back."""

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
    """The scene with other magnitudes, phases [rad], frequencies [Hz] and burst starts [s], (actuators,), and other
    middles of its actuators, (actuators, 2) [m]; None: as the scene has them.

    A frequency or start that all actuators share becomes the drive's own.

    Raises:
        SceneError: numbers that no scene may have, such as a magnitude beyond 1e30.
    """
    actuators: list[dict[str, Any]] = [one.model_dump() for one in scene.actuators]
    drive = scene.drive.model_dump()
    for name, values in (("magnitude", magnitude), ("phase", phase)):
        if values is not None:
            for actuator, value in zip(actuators, values.tolist(), strict=True):
                # What is too small to be told from zero is zero.
                actuator[name] = value if abs(value) >= SMALLEST else 0.0
    common = (("frequency", frequency, drive, "frequency"), ("delay", delay, drive["burst"], "start"))
    for name, values, table, key in common:
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
            actuator["area"] = (*_span(x0, x1, x), *_span(y0, y1, y))
    return scene.with_tables(drive=drive, actuators=actuators)


def scene_phasors(scene: Scene) -> np.ndarray:
    """(actuators,) the phasors of the magnitudes and phases that the scene gives its actuators."""
    magnitude = np.array([actuator.magnitude for actuator in scene.actuators])
    phase = np.array([actuator.phase for actuator in scene.actuators])
    drive: np.ndarray = magnitude * np.exp(-1j * phase)
    return drive


def actuator_centres(scene: Scene) -> np.ndarray:
    """(actuators, 2) x, y of the actuators' middles [m]."""
    areas = np.array([one.area for one in scene.actuators])
    return np.stack([(areas[:, 0] + areas[:, 1]) / 2, (areas[:, 2] + areas[:, 3]) / 2], axis=1)


def _span(low: float, high: float, middle: float) -> tuple[float, float]:
    """As long as before, around another middle; the same to the last bit where it is the same."""
    if middle == (low + high) / 2:
        return low, high
    return middle - (high - low) / 2, middle + (high - low) / 2
