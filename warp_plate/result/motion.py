"""A plate in motion: frames that follow each other, and what can be told of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.scene.model import Scene

# Where a plate moves less than this part of its peak, its phase says nothing.
STILL = 1e-4


@dataclass(frozen=True)
class Motion:
    """One plate, frame by frame.

    name: of the drive or mode; frequency: of the drive or mode [Hz]; span: beginning and end of the time that the
        frames fill, evenly up to half a time step [s]; the frame after the last would come at its end.
    times: (frames,) [s]; displacement: (frames, ny, nx) [m], or over its largest for a mode; velocity: the same per
        second, of a drive half a time step later, where the kernels have it and take the energy of it;
        surface_density: (ny, nx) [kg/m²].
    localization_factor: of the drive, over the scene's window; None for a mode.
    scene: where the plate has frequencies or places of its own; None: the one that all share.
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
        """(ny, nx) root of the mean square of the velocity over the span [m/s]."""
        shares = self._shares[:, None, None]
        root: np.ndarray = np.sqrt((shares * self.velocity**2).sum(axis=0))
        return root

    @cached_property
    def phase(self) -> np.ndarray:
        """(ny, nx) lag φ [rad], −π ... π, of the part A cos(ωt − φ) + constant that fits the frames best.

        NaN where the plate hardly moves, or is not finite.
        """
        angle = 2 * math.pi * self.frequency * self.times
        basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
        flat = self.displacement.reshape(len(self.times), -1).astype(float)
        # A plate that has blown up has no phase, and must not harm the others' fit.
        known = np.isfinite(flat).all(axis=0)
        flat = np.where(known, flat, 0.0)
        cosine, sine, _ = np.linalg.lstsq(basis, flat, rcond=None)[0].reshape(3, *self.displacement.shape[1:])
        size = np.hypot(cosine, sine)
        moving = size > STILL * np.max(size, initial=0.0)
        return np.where(moving, np.arctan2(sine, cosine), math.nan)

    @property
    def _shares(self) -> np.ndarray:
        """(frames,) shares of the span: half the gap to the frames before and after, the first coming after the last.

        So the mean of a periodic motion over whole periods is exact but for its high harmonics.
        """
        length = self.span[1] - self.span[0]
        gaps = np.diff(self.times, append=self.times[0] + length)
        return (gaps + np.roll(gaps, 1)) / (2 * length)
