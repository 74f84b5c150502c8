"""Motion of a plate: frame by frame, or as its steady motion under a drive at one moment of the explorer."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.quantities.sound_levels import POWER_REFERENCE
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene

# Nodes that move less than this fraction of the largest amplitude have no phase.
STILL = 1e-4
# Least square of a velocity relative to the target's that a level tells apart from rest: −200 dB.
LOWEST_SQUARE = 1e-20
QUADRANTS = ("lower left", "lower right", "upper left", "upper right")


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of one plate, frame by frame.

    Further fields over the plate are its properties: ``rms_velocity``, ``level``, ``phase`` and ``kinetic_energy``.
    Node (j, i) of (ny, nx) lies at x = i/(nx − 1) and y = j/(ny − 1) of the plate's sides.

    Attributes:
        name: Name of the case, or of the mode with its frequency.
        frequency: Frequency of the drive or mode [Hz].
        span: Start and end [s]; the frames divide it evenly up to half a time step, and it ends one frame after the
            last.
        times: (frames,) times [s].
        displacement: (frames, ny, nx) displacement [m]; of a mode relative to its largest.
        velocity: (frames, ny, nx) velocity [m/s or 1/s]; of a drive half a time step later, as in the kernels.
        surface_density: (ny, nx) mass per area [kg/m²].
        localization_factor: Localization factor of the drive over the scene's window; None for a mode.
        scene: Scene of a plate with other frequencies or positions; None if it is the common one.
        only_actuator: Name of the only actuator that is driven, if there is just one.
        target: (ny, nx) weights of the nodes of the drive's target; None for a mode and for waveforms that focus.
    """

    name: str
    frequency: float
    span: tuple[float, float]
    times: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    surface_density: np.ndarray
    localization_factor: float | None = None
    scene: Scene | None = None
    only_actuator: str = ""
    target: np.ndarray | None = None

    def __repr__(self) -> str:
        frames, ny, nx = self.displacement.shape
        return f"<Motion {self.name}: {frames} frames of {nx} × {ny} nodes, {self.span[0]:g} to {self.span[1]:g} s>"

    @cached_property
    def kinetic_energy(self) -> np.ndarray:
        """(frames, ny, nx) kinetic energy per area, ½ρH u̇² [J/m²]."""
        return 0.5 * self.surface_density * self.velocity**2

    @cached_property
    def rms_velocity(self) -> np.ndarray:
        """(ny, nx) root mean square of the velocity over the span [m/s].

        A frame's weight is half the gaps to its neighbours, the first frame following the last. So the mean of a
        periodic motion over whole periods is exact but for its high harmonics.
        """
        length = self.span[1] - self.span[0]
        gaps = np.diff(self.times, append=self.times[0] + length)
        weights = ((gaps + np.roll(gaps, 1)) / (2 * length))[:, None, None]
        return np.asarray(np.sqrt((weights * self.velocity**2).sum(axis=0)))

    @cached_property
    def level(self) -> np.ndarray:
        """(ny, nx) RMS velocity relative to that of the target, averaged as squares [dB]; NaN if the target rests.

        SceneError: the motion has no target.
        """
        if self.target is None:
            raise SceneError("field = 'level': levels are relative to a target; this motion has none")
        squares = self.rms_velocity.astype(float) ** 2
        mean = (self.target * squares).sum() / self.target.sum()
        with np.errstate(invalid="ignore", divide="ignore"):
            return 10 * np.log10(np.maximum(squares / mean, LOWEST_SQUARE))

    @cached_property
    def phase(self) -> np.ndarray:
        """(ny, nx) phase lag φ [rad], −π ... π, of the least-squares fit A cos(ωt − φ) + constant to the frames.

        NaN where the plate hardly moves or is not finite.
        """
        angle = 2 * math.pi * self.frequency * self.times
        basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
        flat = self.displacement.reshape(len(self.times), -1).astype(float)
        # Nodes that have blown up must not spoil the fit of the others.
        flat = np.where(np.isfinite(flat).all(axis=0), flat, 0.0)
        cosine, sine, _ = np.linalg.lstsq(basis, flat, rcond=None)[0].reshape(3, *self.displacement.shape[1:])
        amplitude = np.hypot(cosine, sine)
        moving = amplitude > STILL * np.max(amplitude, initial=0.0)
        return np.where(moving, np.arctan2(sine, cosine), math.nan)


@dataclass(frozen=True, eq=False)
class SteadyMotion:
    """Steady motion of a plate, u(θ) = Re(amplitude · exp(iθ)) at the phase θ = ωt of the drive."""

    amplitude: np.ndarray  # (ny, nx) complex amplitude [m]
    residual: float = 0.0  # RMS of the motion that does not repeat with the drive, relative to all motion

    def at(self, phase: float) -> np.ndarray:
        """Return the (ny, nx) displacement [m] at a phase of the drive [rad]."""
        return np.asarray(math.cos(phase) * self.amplitude.real - math.sin(phase) * self.amplitude.imag)

    def peak(self) -> float:
        """Return the largest displacement of any node at any time [m]."""
        return float(np.abs(self.amplitude).max())


@dataclass(frozen=True, eq=False)
class DriveResponse:
    """A drive, and the motion and energies of the plate under it."""

    scene: Scene  # with the current frequency and damping
    phasors: np.ndarray  # (actuators,) complex amplitudes of the drive [N/m²]
    motion: SteadyMotion
    energy: Mapping[str, float]  # average over the window [J] of the regions "plate", "target" and the ``QUADRANTS``
    bound: float | None  # upper bound of the localization factor over all drives; None if unknown
    # peak acceleration [m/s²] at the weakest and the worst point of the regions of a specification; empty by time
    # steps, and if a target is a mask
    levels: Mapping[str, tuple[float, float]]
    sound_power: float | None  # A-weighted sound power of the plate in a rigid baffle [W]; None where levels are empty

    @property
    def localization_factor(self) -> float:
        return self.share("target")

    @property
    def sound_level(self) -> float | None:
        """A-weighted sound power level [dB re 1 pW]; None where the sound is unknown, −∞ for a plate at rest."""
        if self.sound_power is None:
            return None
        return 10 * math.log10(self.sound_power / POWER_REFERENCE) if self.sound_power > 0 else -math.inf

    def share(self, region: str) -> float:
        """Return the fraction of the plate's kinetic energy in a region; NaN for a plate at rest."""
        return self.energy[region] / self.energy["plate"] if self.energy["plate"] > 0 else float("nan")


@dataclass(frozen=True, eq=False)
class SwarmSnapshot:
    """A particle swarm at one iteration."""

    phasors: np.ndarray  # (particles, actuators) drives of the particles, relative to the first actuator
    factors: np.ndarray  # (particles,) localization factors
    best: np.ndarray  # (iterations,) best localization factor after each iteration
    best_phasors: np.ndarray | None  # (actuators,) best drive; None before the first finite one
    iterations: int


def quadrants(size: tuple[float, float]) -> dict[str, Area]:
    """Return the areas x0, x1, y0, y1 [m] of the ``QUADRANTS`` of a plate with these side lengths [m]."""
    spans_x, spans_y = (((0.0, side / 2), (side / 2, side)) for side in size)
    areas = [(*x, *y) for y in spans_y for x in spans_x]
    return dict(zip(QUADRANTS, areas, strict=True))
