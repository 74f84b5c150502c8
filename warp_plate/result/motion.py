"""Frames of a moving plate, and the fields derived from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.scene.model import Scene

# Nodes that move less than this fraction of the largest amplitude have no phase.
STILL = 1e-4


@dataclass(frozen=True)
class Motion:
    """Motion of one plate, frame by frame.

    Attributes:
        name: Name of the drive or mode.
        frequency: Frequency of the drive or mode [Hz].
        span: Start and end of the time span of the frames [s]. They divide it evenly, up to half a time step; the frame
            after the last one would lie at its end.
        times: (frames,) times [s].
        displacement: (frames, ny, nx) displacement [m], for a mode relative to its largest.
        velocity: (frames, ny, nx) velocity [m/s or 1/s]; of a drive half a time step later, where the kernels have it
            and take its energy.
        surface_density: (ny, nx) mass per area [kg/m²].
        localization_factor: Localization factor of the drive over the scene's window; None for a mode.
        scene: Scene of a plate with frequencies or positions of its own; None if it is the common one.
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
        root: np.ndarray = np.sqrt((weights * self.velocity**2).sum(axis=0))
        return root

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
