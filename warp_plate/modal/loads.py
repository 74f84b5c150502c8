"""Loads in time, between the moments at which their formulas change.

Actuator k presses with Re(Z_k w_k(t)) from t = 0 on. A tone is w = exp(iωt). A burst's envelope is a sum of
exponentials between its four corners: 1 between the ramps, and ½ − ¼ exp(iπs/ramp) − ¼ exp(−iπs/ramp) in each of them,
s being the time since its foot. Between two corners of any actuator all loads are therefore sums of exponentials, for
which responses have closed forms.

Sweeps, signals from files, and loads that travel are smooth between such moments, and are taken as polynomials of the
time on equal blocks, through Chebyshev's points, whose error for a phase ωH in a block is 2 (ωH/4)^(n+1) / (n+1)!, n
the degree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre

from warp_plate.effects.moving_load import MovingLoad
from warp_plate.modal.modes import ModalPlate
from warp_plate.plate.designs import actuator_spaces, patch_ends, per_plate_of
from warp_plate.plate.signals import actuator_frequencies, highest_frequency
from warp_plate.plate.waveforms import read_samples, sample_at, sweep
from warp_plate.scene.drive import Burst, Drive
from warp_plate.scene.model import Scene

# Moments closer together than this part of the run are the same.
SAME = 1e-12
# Weights of 1, exp(iπs/ramp) and exp(−iπs/ramp) in a ramp, and the signs of their exponents.
RAMP_WEIGHTS, RAMP_SIGNS = np.array([0.5, -0.25, -0.25]), np.array([0.0, 1.0, -1.0])
DEGREE = 6
TOLERANCE = 1e-8
# Sides of a moving load below this part of the plate's are points.
POINT = 1e-6
# Points of the polynomials in a block from 0 to 1, and the matrix that makes coefficients of powers of their values.
NODES = (1 - np.cos(np.pi * (2 * np.arange(DEGREE + 1) + 1) / (2 * DEGREE + 2))) / 2
TO_POWERS = np.linalg.inv(np.vander(NODES, increasing=True))
# Places along each side at which forces are tried to see which motions count, and points along a side of such a patch.
PLACES, TRIAL_POINTS = 8, 3


@dataclass(frozen=True)
class ExponentialLoads:
    """Unit loads Σ_j weights_kj exp(rates_kj (t − start)) in an interval of time."""

    start: float  # Start of the interval [s]
    end: float  # End of the interval [s]
    rates: np.ndarray  # (actuators, terms) imaginary exponents [1/s]
    weights: np.ndarray  # (actuators, terms) complex weights, 0 for an actuator that is switched off

    def values(self, times: np.ndarray) -> np.ndarray:
        """Return (actuators, times) loads at times in the interval [s]."""
        since = np.asarray(times) - self.start
        return np.asarray((self.weights[..., None] * np.exp(self.rates[..., None] * since)).sum(axis=1))

    def modulate(self, frequency: np.ndarray) -> ExponentialLoads:
        """Return the loads modulated by tones of frequencies (actuators,) [Hz] starting at t = 0."""
        rate = 2j * math.pi * frequency[:, None]
        return replace(self, rates=self.rates + rate, weights=self.weights * np.exp(rate * self.start))


@dataclass(frozen=True)
class SampledLoads:
    """Loads in an interval of time that is divided into equal blocks."""

    start: float  # Start of the interval [s]
    end: float  # End of the interval [s]
    # (rows, columns, blocks, DEGREE + 1) coefficients of the powers of the time, counted from 0 to 1 in each block; one
    # row for unit loads of the actuators, one for each mode for modal forces
    coefficients: np.ndarray

    @property
    def length(self) -> float:
        """Length of a block [s]."""
        return (self.end - self.start) / self.coefficients.shape[2]

    def times_inputs(self, inputs: np.ndarray) -> SampledLoads:
        """Return modal forces as loads of the poles, by their inputs (poles, modes)."""
        if not self.coefficients.any():
            return self
        return replace(self, coefficients=np.tensordot(inputs, self.coefficients, axes=1))

    def part(self, rows: np.ndarray) -> SampledLoads:
        """Return the loads of some of the poles."""
        return self if len(self.coefficients) == 1 else replace(self, coefficients=self.coefficients[rows])

    def rows(self, count: int, blocks: np.ndarray) -> np.ndarray:
        """Return (count, columns, blocks, DEGREE + 1) coefficients of some blocks."""
        some = self.coefficients[:, :, blocks]
        return np.broadcast_to(some, (count, *some.shape[1:]))


def has_exponential_loads(drive: Drive) -> bool:
    """Return whether the actuators' loads are sums of exponentials: tones and bursts of tones."""
    return drive.chirp is None and drive.signal is None


def exponential_loads(
    burst: Burst | None, frequency: np.ndarray, delay: np.ndarray, end: float
) -> list[ExponentialLoads]:
    """Return tones of ``frequency`` (actuators,) [Hz], or bursts of them that begin at ``delay`` (actuators,) [s]."""
    return [envelope.modulate(frequency) for envelope in _envelopes(burst, delay, end)]


def sampled_loads(scene: Scene, frequency: np.ndarray, delay: np.ndarray, end: float) -> list[SampledLoads]:
    """Return the unit loads of a sweep that begins at ``frequency`` (actuators,) [Hz], or of a file, from t = 0 to
    ``end`` [s], with bursts that begin at ``delay`` (actuators,) [s]."""
    chirp, longest, cuts = scene.drive.chirp, math.inf, []
    highest = max(float(frequency.max()), highest_frequency(scene))
    carrier: Callable[[np.ndarray], np.ndarray]
    if scene.drive.signal is not None:
        samples = read_samples(scene.drive.signal, scene.folder, delay.size)
        highest, longest = max(highest, samples.highest_frequency()), 1 / samples.rate
        carrier = partial(sample_at, samples)
    else:
        assert chirp is not None
        cuts = [chirp.duration]

        def carrier(times: np.ndarray) -> np.ndarray:
            return np.asarray(np.exp(1j * sweep(chirp, frequency[:, None], times)))

    burst = scene.drive.burst
    omega = 2 * math.pi * (highest + (0.5 / burst.ramp if burst is not None and burst.ramp else 0.0))
    loads = []
    for envelope in _envelopes(burst, delay, end, cuts):
        times = _sample_times(envelope.start, envelope.end, omega, longest)
        flat = times.ravel()
        values = (envelope.values(flat) * carrier(flat)).reshape(1, delay.size, *times.shape)
        loads.append(SampledLoads(envelope.start, envelope.end, values @ TO_POWERS.T))
    return loads


def _envelopes(
    burst: Burst | None, delay: np.ndarray, end: float, cuts: Iterable[float] = ()
) -> list[ExponentialLoads]:
    """Return the envelopes of bursts, 1 if None, that begin at ``delay`` (actuators,), from t = 0 to ``end`` [s],
    between their corners and ``cuts`` [s]."""
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


def moving_loads(plate: ModalPlate, end: float) -> list[SampledLoads]:
    """Return the modal forces [N/√kg] of a scene's moving load, if it has one, as one column from t = 0 to ``end``."""
    scene = plate.scene
    load = scene.effects.travelling
    if load is None:
        return []
    last = end if load.to_time is None else min(load.to_time, end)
    cuts, spans = {0.0, end, load.from_time, last}, []
    for start, speed, side, interval in zip(
        load.start, load.velocity, scene.plate.size, plate.space.interval_sizes, strict=True
    ):
        if speed:
            edges = [edge + sign * load.size / 2 for edge in (0.0, side) for sign in (-1, 1)]
            cuts.update(load.from_time + (edge - start) / speed for edge in edges)
            spans.append(interval / 2 / abs(speed))
    moments = sorted(cut for cut in cuts if 0 <= cut <= end)
    omega, loads = 2 * math.pi * (load.frequency or 0.0), []
    for low, high in pairwise(moments):
        acting = load.from_time <= (low + high) / 2 <= last and _touches(scene, load, (low + high) / 2)
        longest = min(spans, default=math.inf) if acting else math.inf
        times = _sample_times(low, high, omega if acting else 0.0, longest)
        flat = times.ravel()
        forces = _moving_forces(plate, load, flat) if acting else np.zeros((1, flat.size))
        values = forces.reshape(len(forces), 1, *times.shape).astype(complex)
        loads.append(SampledLoads(low, high, values @ TO_POWERS.T))
    return loads


def _moving_forces(plate: ModalPlate, load: MovingLoad, times: np.ndarray) -> np.ndarray:
    """Return (modes, times) modal forces [N/√kg] while the load is on the plate."""
    width, height = plate.scene.plate.size
    x, y = _places(load, times)
    force = load.force * np.cos(2 * math.pi * (load.frequency or 0.0) * times)
    half = load.size / 2
    if load.size < POINT * min(width, height):
        return plate.at_points(np.stack([np.clip(x, 0, width), np.clip(y, 0, height)], axis=1)) * force
    sides = [np.clip(at + sign * half, 0, side) for at, side in ((x, width), (y, height)) for sign in (-1, 1)]
    return plate.patch_forces(np.stack(sides, axis=1)) * force / load.size**2


def _touches(scene: Scene, load: MovingLoad, time: float) -> bool:
    """Return whether the moving load is on the plate at a time [s]."""
    slack = load.size / 2 + 1e-12 * max(scene.plate.size)
    places = zip(_places(load, np.array([time])), scene.plate.size, strict=True)
    return all(-slack <= at[0] <= side + slack for at, side in places)


def _places(load: MovingLoad, times: np.ndarray) -> Iterable[np.ndarray]:
    """Return x and y of the moving load's middle [m] at times [s]."""
    return [start + speed * (times - load.from_time) for start, speed in zip(load.start, load.velocity, strict=True)]


def _sample_times(low: float, high: float, omega: float, longest: float) -> np.ndarray:
    """Return (blocks, DEGREE + 1) times [s] for loads of up to ``omega`` [rad/s], blocks of up to ``longest`` [s]."""
    phase = 4 * (TOLERANCE * math.factorial(DEGREE + 1) / 2) ** (1 / (DEGREE + 1))
    count = max(1, math.ceil((high - low) * omega / phase), math.ceil((high - low) / longest))
    length = (high - low) / count
    return np.asarray(low + length * (np.arange(count)[:, None] + NODES))


def trial_forces(plate: ModalPlate) -> np.ndarray:
    """Return (modes, trials) modal forces of the actuators where they are, and wherever a search may place them."""
    scene = plate.scene
    if scene.piezo or scene.coil_indices:
        return plate.actuator_forces()
    ends = patch_ends(scene.actuators)
    half = np.ptp(ends, axis=2) / 2
    spaces = actuator_spaces(scene, per_plate_of(scene))
    low, high = spaces[:, [0, 2]] + half, spaces[:, [1, 3]] - half
    parts = (np.arange(PLACES) + 0.5) / PLACES
    centre = low + np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 1, 2) * (high - low)
    placed = np.stack([centre - half, centre + half], axis=-1).reshape(-1, 4)
    areas = np.unique(np.concatenate([ends.reshape(-1, 4), placed]).round(9), axis=0)
    if scene.outline is None:
        return plate.patch_forces(areas)
    # Gauss's rule alone, which needs no chords: only sizes count.
    s, weights = legendre.leggauss(TRIAL_POINTS)
    x, y = (low[:, None] + (high - low)[:, None] * (s + 1) / 2 for low, high in (areas.T[:2], areas.T[2:]))
    places = np.stack(np.broadcast_arrays(x[:, :, None], y[:, None]), axis=-1)
    values = plate.at_points(places.reshape(-1, 2)).reshape(-1, *places.shape[:3])
    return np.einsum("mpxy,x,y,p->mp", values, weights, weights, np.ptp(areas[:, :2], 1) * np.ptp(areas[:, 2:], 1) / 4)


def trial_frequencies(scene: Scene) -> np.ndarray:
    """Return the rising frequencies [Hz] of the actuators and of the ends of their search."""
    searched = scene.search.frequency
    return np.array(sorted({*actuator_frequencies(scene).tolist(), *(searched.range if searched is not None else ())}))
