"""What a live view shows at one moment: plain data, whoever made it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.scene.model import Area, Scene

QUADRANTS = ("lower left", "lower right", "upper left", "upper right")


@dataclass(frozen=True)
class SteadyMotion:
    """A plate's steady motion, u(θ) = Re Σ amplitudes[k] exp(i orders[k] θ), θ = ωt being the drive's phase.

    orders: (orders,) whole multiples of the drive's frequency; amplitudes: (orders, ny, nx) complex [m].
    residual: what of the motion it was taken from does not repeat with the drive, as a share of the whole (root of
    mean squares); start-up motion that has not died out, mostly.
    """

    orders: np.ndarray
    amplitudes: np.ndarray
    residual: float = 0.0

    def at(self, phase: float) -> np.ndarray:
        """(ny, nx) displacement [m] at a phase of the drive [rad]."""
        field = np.zeros(self.amplitudes.shape[1:])
        # Real parts only, and no library that would start threads for so little work.
        for order, amplitude in zip(self.orders, self.amplitudes, strict=True):
            field += math.cos(order * phase) * amplitude.real - math.sin(order * phase) * amplitude.imag
        return field

    def peak(self) -> float:
        """The largest displacement of any node at any time [m]."""
        if self.orders.size == 1 and self.orders[0] == 1:
            return float(np.abs(self.amplitudes).max())
        return float(max(np.abs(self.at(phase)).max() for phase in np.linspace(0, 2 * math.pi, 48, endpoint=False)))


@dataclass(frozen=True)
class DriveResponse:
    """A drive, the motion under it and its energies.

    scene: with the frequency and the damping that hold. drive: (actuators,) phasors [N/m²].
    energy: averaged over the window [J], of "plate", "target" and the QUADRANTS by name.
    bound: the largest localization factor that any drive can reach; None where none is claimed.
    """

    scene: Scene
    phasors: np.ndarray
    motion: SteadyMotion
    energy: Mapping[str, float]
    bound: float | None

    @property
    def localization_factor(self) -> float:
        """Share of the plate's kinetic energy in the target; not a number for a plate at rest."""
        return self.share("target")

    def share(self, region: str) -> float:
        """Share of the plate's kinetic energy in a region; not a number for a plate at rest."""
        return self.energy[region] / self.energy["plate"] if self.energy["plate"] > 0 else float("nan")


@dataclass(frozen=True)
class SwarmSnapshot:
    """A search at one iteration.

    drives: (particles, actuators) what the particles stand for, the first actuator's being 1; factors: (particles,)
    their localization factors; best: (iterations,) best so far after each iteration; best_phasors: (actuators,), None
    before any finite one; iterations: how many there will be; running: whether it goes on.
    """

    phasors: np.ndarray
    factors: np.ndarray
    best: np.ndarray
    best_phasors: np.ndarray | None
    iterations: int
    running: bool


def quadrants(size: tuple[float, float]) -> dict[str, Area]:
    """The four quarters of a plate of these sides [m], by the names in QUADRANTS: x0, x1, y0, y1 [m]."""
    (width, height), middle = size, (size[0] / 2, size[1] / 2)
    return {
        "lower left": (0.0, middle[0], 0.0, middle[1]),
        "lower right": (middle[0], width, 0.0, middle[1]),
        "upper left": (0.0, middle[0], middle[1], height),
        "upper right": (middle[0], width, middle[1], height),
    }
