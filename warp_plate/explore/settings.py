"""What a live model can be asked for: drives, frequency, damping, and how far each goes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from warp_plate.scene.effects import Damping
from warp_plate.scene.model import Scene

# How far the sliders go: frequencies as multiples of the scene's; damping as a multiple of the scene's, or where it has
# none, a loss factor at its frequency; magnitudes as a multiple of the scene's largest.
FREQUENCIES = (0.2, 2.0)
DAMPINGS, LOSS_FACTOR = 5.0, 0.5
MAGNITUDES = 2.0
# A period has at least this many steps, where the scene fixes the step.
STEPS_A_PERIOD = 4


@dataclass(frozen=True)
class Ranges:
    """Ends of the sliders: magnitude [N/m²] and damping [N·s/m³] start at 0; frequencies [Hz]."""

    magnitude: float
    damping: float
    frequency: tuple[float, float]


@dataclass(frozen=True)
class Settings:
    """What is asked for: frequency [Hz], damping [N·s/m³], (actuators,) magnitudes [N/m²] and phase lags [rad]."""

    frequency: float
    damping: float
    magnitude: tuple[float, ...]
    phase: tuple[float, ...]

    @property
    def drive(self) -> np.ndarray:
        """(actuators,) phasors [N/m²]."""
        return np.array(self.magnitude) * np.exp(-1j * np.array(self.phase))


def ranges_of(scene: Scene) -> Ranges:
    """How far the sliders go."""
    frequency, inertia = scene.drive.frequency, scene.plate.density * scene.plate.thickness
    named = scene.effects.damping.viscous if scene.effects.damping else 0.0
    damping = DAMPINGS * named or LOSS_FACTOR * scene.drive_angular_frequency * inertia
    highest = FREQUENCIES[1] * frequency
    if scene.grid.time_step is not None:
        highest = max(frequency, min(highest, 1 / (STEPS_A_PERIOD * scene.grid.time_step)))
    lowest = min(frequency, max(FREQUENCIES[0] * frequency, 1 / scene.window.end))
    largest = max((abs(one.magnitude) for one in scene.actuators), default=0.0) or 1.0
    return Ranges(MAGNITUDES * largest, damping, (lowest, highest))


def changed_scene(scene: Scene, frequency: float, damping: float) -> Scene:
    """The scene at another frequency [Hz] and with other viscous damping [N·s/m³]; none is left out of the kernel."""
    table = scene.effects.damping
    if table is not None:
        table = table.model_copy(update={"viscous": damping})
    elif damping > 0:
        table = Damping(viscous=damping)
    return scene.model_copy(
        update={
            "drive": scene.drive.model_copy(update={"frequency": frequency}),
            "effects": scene.effects.model_copy(update={"damping": table}),
        }
    )


def polar(drive: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Magnitudes and phase lags, 0 ≤ φ < 2π."""
    phase = np.where(drive == 0, 0.0, np.mod(-np.angle(drive), 2 * math.pi))
    return tuple(np.abs(drive).tolist()), tuple(phase.tolist())
