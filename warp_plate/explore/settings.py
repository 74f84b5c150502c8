"""Settings of the explorer and the ranges of its sliders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from warp_plate.effects.damping import Damping
from warp_plate.problem.design_variables import magnitude_unit
from warp_plate.scene.model import Scene

# Ends of the sliders as multiples of the scene's values; if it has no damping, as a loss factor at its frequency.
FREQUENCY_RANGE, MAGNITUDE_RANGE, DAMPING_RANGE, LOSS_FACTOR_RANGE = (0.2, 2.0), 2.0, 5.0, 0.5
MIN_STEPS_PER_PERIOD = 4  # if the scene fixes the time step


@dataclass(frozen=True)
class SliderRanges:
    """Ends of the sliders."""

    magnitude: float  # largest magnitude of an actuator [N/m²]; the least is 0
    damping: float  # largest viscous damping [N·s/m³]; the least is 0
    frequency: tuple[float, float]  # least and largest frequency of the drive [Hz]


@dataclass(frozen=True)
class LiveSettings:
    """Positions of the sliders."""

    frequency: float  # frequency of the drive [Hz]
    damping: float  # viscous damping [N·s/m³]
    magnitude: tuple[float, ...]  # magnitude of each actuator [N/m²]
    phase: tuple[float, ...]  # phase lag of each actuator [rad]

    @property
    def phasors(self) -> np.ndarray:
        """(actuators,) complex amplitudes of the drive [N/m²]."""
        return np.array(self.magnitude) * np.exp(-1j * np.array(self.phase))


def slider_ranges(scene: Scene) -> SliderRanges:
    """Return the ends of the sliders for a scene, within the limits of its run."""
    frequency, surface_density = scene.drive.frequency, scene.plate.density * scene.plate.thickness
    stiff = scene.drive_angular_frequency * surface_density  # damping of a loss factor of 1
    damping = DAMPING_RANGE * scene_damping(scene) or LOSS_FACTOR_RANGE * stiff
    highest = FREQUENCY_RANGE[1] * frequency
    if scene.grid.time_step is not None:
        highest = max(frequency, min(highest, 1 / (MIN_STEPS_PER_PERIOD * scene.grid.time_step)))
    lowest = min(frequency, max(FREQUENCY_RANGE[0] * frequency, 1 / scene.window.end))
    return SliderRanges(MAGNITUDE_RANGE * magnitude_unit(scene), damping, (lowest, highest))


def scene_damping(scene: Scene) -> float:
    """Return the viscous damping of the scene [N·s/m³]; 0 if it has none."""
    return scene.effects.damping.viscous if scene.effects.damping else 0.0


def changed_scene(scene: Scene, frequency: float, damping: float) -> Scene:
    """Return the scene at another frequency [Hz] and with other viscous damping [N·s/m³], if any."""
    table = scene.effects.damping or (Damping(viscous=damping) if damping > 0 else None)
    table = table and table.model_copy(update={"viscous": damping})
    drive = scene.drive.model_copy(update={"frequency": frequency})
    return scene.model_copy(update={"drive": drive, "effects": scene.effects.model_copy(update={"damping": table})})


def polar(phasors: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the magnitudes and the phase lags 0 ≤ φ < 2π of phasors."""
    phase = np.where(phasors == 0, 0.0, np.mod(-np.angle(phasors), 2 * math.pi))
    return tuple(np.abs(phasors).tolist()), tuple(phase.tolist())
