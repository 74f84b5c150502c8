"""Unit loads of a scene's actuators in time, between the moments at which they are switched.

Actuator k presses with Re(Z_k w_k(t)) from t = 0 on. A tone is w = exp(iωt). A burst's envelope is a sum of
exponentials between its four corners: 1 between the ramps, and ½ − ¼ exp(iπs/ramp) − ¼ exp(−iπs/ramp) in each of them,
s being the time since its foot. Between two corners of any actuator all loads are therefore sums of exponentials, for
which responses have closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from warp_plate.scene.drive import Burst
from warp_plate.scene.model import Scene

# Moments closer together than this part of the run are the same.
SAME = 1e-12
# Weights of 1, exp(iπs/ramp) and exp(−iπs/ramp) in a ramp, and the signs of their exponents.
RAMP_WEIGHTS, RAMP_SIGNS = np.array([0.5, -0.25, -0.25]), np.array([0.0, 1.0, -1.0])


@dataclass(frozen=True)
class ExponentialLoads:
    """Unit loads Σ_j weights_kj exp(rates_kj (t − start)) in an interval of time.

    Attributes:
        start: Start of the interval [s].
        end: End of the interval [s].
        rates: (actuators, terms) imaginary exponents [1/s].
        weights: (actuators, terms) complex weights, 0 for an actuator that is switched off.
    """

    start: float
    end: float
    rates: np.ndarray
    weights: np.ndarray

    def values(self, times: np.ndarray) -> np.ndarray:
        """Return (actuators, times) loads at times in the interval [s]."""
        since = np.asarray(times) - self.start
        return np.asarray((self.weights[..., None] * np.exp(self.rates[..., None] * since)).sum(axis=1))

    def times_tones(self, frequency: np.ndarray) -> ExponentialLoads:
        """Return the loads times tones of frequencies (actuators,) [Hz] that begin at t = 0."""
        rate = 2j * math.pi * frequency[:, None]
        return replace(self, rates=self.rates + rate, weights=self.weights * np.exp(rate * self.start))


def has_exponential_loads(scene: Scene) -> bool:
    """Return whether the actuators' loads are sums of exponentials: tones and bursts of tones."""
    return scene.drive.chirp is None and scene.drive.signal is None


def exponential_loads(scene: Scene, frequency: np.ndarray, delay: np.ndarray, end: float) -> list[ExponentialLoads]:
    """Return tones of ``frequency`` (actuators,) [Hz], or bursts of them that begin at ``delay`` (actuators,) [s]."""
    return [envelope.times_tones(frequency) for envelope in envelopes(scene.drive.burst, delay, end)]


def envelopes(burst: Burst | None, delay: np.ndarray, end: float, cuts: Iterable[float] = ()) -> list[ExponentialLoads]:
    """Return the envelopes of bursts between their corners, from t = 0 to ``end`` [s].

    Args:
        burst: Burst; None for envelopes of 1.
        delay: (actuators,) starts of the first bursts [s].
        end: End of the run [s].
        cuts: Further times that intervals are cut at [s].
    """
    corners = {0.0, end, *cuts}
    if burst is not None:
        corners.update(corner for start in delay.tolist() for corner in _corners(burst, start, end))
    moments = sorted(corner for corner in corners if 0 <= corner <= end)
    apart = [moments[0], *(late for early, late in pairwise(moments) if late - early > SAME * end)]
    apart[-1] = end
    if burst is None:
        one = np.ones((delay.size, 1), complex)
        return [ExponentialLoads(low, high, 0 * one, one) for low, high in pairwise(apart)]
    return [_envelope(burst, delay, low, high) for low, high in pairwise(apart)]


def _corners(burst: Burst, start: float, end: float) -> Iterator[float]:
    """Yield the moments up to ``end`` at which an envelope changes its formula [s]."""
    foot = start
    while foot < end:
        yield from (foot, foot + burst.ramp, foot + burst.duration - burst.ramp, foot + burst.duration)
        if burst.period is None:
            return
        foot += burst.period


def _envelope(burst: Burst, delay: np.ndarray, low: float, high: float) -> ExponentialLoads:
    """Return the envelopes between two moments that follow each other [s]."""
    since = (low + high) / 2 - delay
    if burst.period is not None:
        since = np.where(since > 0, since % burst.period, since)
    foot = (low + high) / 2 - since
    rising = (since > 0) & (since < burst.ramp)
    falling = (since > burst.duration - burst.ramp) & (since < burst.duration)
    on = (since > 0) & (since < burst.duration)
    ramping = rising | falling
    if not ramping.any():
        return ExponentialLoads(low, high, np.zeros((delay.size, 1), complex), on[:, None].astype(complex))
    rates = 1j * math.pi / burst.ramp * RAMP_SIGNS * ramping[:, None]
    feet = foot + np.where(falling, burst.duration, 0)  # a fall is a rise in reverse, and even about its foot
    weights = RAMP_WEIGHTS * np.exp(rates * (low - feet)[:, None])
    return ExponentialLoads(low, high, rates, np.where(ramping[:, None], weights, on[:, None] * [1.0, 0.0, 0.0]))
