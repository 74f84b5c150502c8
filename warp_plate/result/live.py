"""Data classes of what the explorer shows at one moment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.scene.model import Area, Scene

QUADRANTS = ("lower left", "lower right", "upper left", "upper right")


@dataclass(frozen=True)
class SteadyMotion:
    """Steady motion of a plate, u(θ) = Re Σ amplitudes[k] exp(i orders[k] θ) at the phase θ = ωt of the drive.

    Attributes:
        orders: (orders,) integer multiples of the drive's frequency.
        amplitudes: (orders, ny, nx) complex amplitudes [m].
        residual: Root mean square of the part of the motion that does not repeat with the drive, mostly start-up
            motion, relative to that of all motion.
    """

    orders: np.ndarray
    amplitudes: np.ndarray
    residual: float = 0.0

    def at(self, phase: float) -> np.ndarray:
        """Return the (ny, nx) displacement [m] at a phase of the drive [rad]."""
        field = np.zeros(self.amplitudes.shape[1:])
        # Real arithmetic, and no matrix product: its threads cost more than this little work.
        for order, amplitude in zip(self.orders, self.amplitudes, strict=True):
            field += math.cos(order * phase) * amplitude.real - math.sin(order * phase) * amplitude.imag
        return field

    def peak(self) -> float:
        """Return the largest displacement of any node at any time [m]."""
        if self.orders.size == 1 and self.orders[0] == 1:
            return float(np.abs(self.amplitudes).max())
        return float(max(np.abs(self.at(phase)).max() for phase in np.linspace(0, 2 * math.pi, 48, endpoint=False)))


@dataclass(frozen=True)
class DriveResponse:
    """A drive, and the motion and energies of the plate under it.

    Attributes:
        scene: The scene with the current frequency and damping.
        phasors: (actuators,) complex amplitudes of the drive [N/m²].
        motion: Steady motion of the plate.
        energy: Energy averaged over the window [J] by region: "plate", "target" and the ``QUADRANTS``.
        bound: Upper bound of the localization factor over all drives; None if unknown.
    """

    scene: Scene
    phasors: np.ndarray
    motion: SteadyMotion
    energy: Mapping[str, float]
    bound: float | None

    @property
    def localization_factor(self) -> float:
        """Fraction of the plate's kinetic energy in the target; NaN for a plate at rest."""
        return self.share("target")

    def share(self, region: str) -> float:
        """Return the fraction of the plate's kinetic energy in a region; NaN for a plate at rest."""
        return self.energy[region] / self.energy["plate"] if self.energy["plate"] > 0 else float("nan")


@dataclass(frozen=True)
class SwarmSnapshot:
    """A particle swarm at one iteration.

    Attributes:
        phasors: (particles, actuators) drives of the particles, relative to the first actuator.
        factors: (particles,) localization factors.
        best: (iterations,) best localization factor after each iteration.
        best_phasors: (actuators,) best drive; None before the first finite one.
        iterations: Number of iterations of the whole search.
        running: True if the search continues.
    """

    phasors: np.ndarray
    factors: np.ndarray
    best: np.ndarray
    best_phasors: np.ndarray | None
    iterations: int
    running: bool


def quadrants(size: tuple[float, float]) -> dict[str, Area]:
    """Return the areas x0, x1, y0, y1 [m] of the ``QUADRANTS`` of a plate with these side lengths [m]."""
    (width, height), middle = size, (size[0] / 2, size[1] / 2)
    left, right, lower, upper = (0.0, middle[0]), (middle[0], width), (0.0, middle[1]), (middle[1], height)
    return dict(zip(QUADRANTS, ((*left, *lower), (*right, *lower), (*left, *upper), (*right, *upper)), strict=True))
