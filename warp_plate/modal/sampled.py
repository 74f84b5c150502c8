"""Loads that are no sums of exponentials: sweeps, signals from files, and loads that travel.

Between the moments at which their formula changes they are smooth, and are taken as polynomials of the time on equal
blocks, through Chebyshev's points, whose error for a turn ωH in a block is 2 (ωH/4)^(n+1) / (n+1)!, n the degree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from warp_plate.modal.loads import envelopes
from warp_plate.modal.modes import ModalPlate
from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.waveforms import read_samples, sample_at, sweep
from warp_plate.scene.model import Scene

DEGREE = 6
TOLERANCE = 1e-8
# Sides of a moving load below this part of the plate's are points.
POINT = 1e-6
# Points of the polynomials in a block from 0 to 1, and the matrix that makes coefficients of powers of their values.
NODES = (1 - np.cos(np.pi * (2 * np.arange(DEGREE + 1) + 1) / (2 * DEGREE + 2))) / 2
TO_POWERS = np.linalg.inv(np.vander(NODES, increasing=True))


@dataclass(frozen=True)
class SampledLoads:
    """Loads in an interval of time that is divided into equal blocks.

    Attributes:
        start: Start of the interval [s].
        end: End of the interval [s].
        coefficients: (rows, columns, blocks, DEGREE + 1) coefficients of the powers of the time, counted from 0 to 1 in
            each block; one row for unit loads of the actuators, one for each mode for modal forces.
    """

    start: float
    end: float
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


def sampled_loads(scene: Scene, frequency: np.ndarray, delay: np.ndarray, end: float) -> list[SampledLoads]:
    """Return the unit loads of a sweep or file, from t = 0 to ``end`` [s].

    Args:
        scene: Scene with ``drive.chirp`` or ``drive.signal``.
        frequency: (actuators,) frequencies at which sweeps begin [Hz].
        delay: (actuators,) starts of the bursts [s].
        end: End of the run [s].

    Raises:
        SceneError: The file is missing or malformed.
    """
    chirp, longest, cuts = scene.drive.chirp, math.inf, []
    highest = max(float(frequency.max()), highest_frequency(scene))
    carrier: Callable[[np.ndarray], np.ndarray]
    if scene.drive.signal is not None:
        samples = read_samples(scene.drive.signal, scene.folder, delay.size)
        highest, longest = max(highest, samples.highest_frequency()), 1 / samples.rate

        def carrier(times: np.ndarray) -> np.ndarray:
            return sample_at(samples, times)
    else:
        assert chirp is not None
        cuts = [chirp.duration]

        def carrier(times: np.ndarray) -> np.ndarray:
            return np.asarray(np.exp(1j * sweep(chirp, frequency[:, None], times)))

    burst = scene.drive.burst
    turn = 2 * math.pi * (highest + (0.5 / burst.ramp if burst is not None and burst.ramp else 0.0))
    loads = []
    for envelope in envelopes(burst, delay, end, cuts):
        times = _sample_times(envelope.start, envelope.end, turn, longest)
        flat = times.ravel()
        values = (envelope.values(flat) * carrier(flat)).reshape(1, delay.size, *times.shape)
        loads.append(SampledLoads(envelope.start, envelope.end, values @ TO_POWERS.T))
    return loads


def moving_loads(plate: ModalPlate, end: float) -> list[SampledLoads]:
    """Return the modal forces [N/√kg] of a scene's moving load, as one column, from t = 0 to ``end`` [s]."""
    scene = plate.scene
    load = scene.effects.travelling
    assert load is not None
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
    turn, loads = 2 * math.pi * (load.frequency or 0.0), []
    for low, high in pairwise(moments):
        acting = load.from_time <= (low + high) / 2 <= last and _touches(scene, (low + high) / 2)
        times = _sample_times(low, high, turn if acting else 0.0, min(spans, default=math.inf) if acting else math.inf)
        flat = times.ravel()
        forces = _moving_forces(plate, flat) if acting else np.zeros((1, flat.size))
        values = forces.reshape(len(forces), 1, *times.shape).astype(complex)
        loads.append(SampledLoads(low, high, values @ TO_POWERS.T))
    return loads


def _moving_forces(plate: ModalPlate, times: np.ndarray) -> np.ndarray:
    """Return (modes, times) modal forces [N/√kg] while the load is on the plate."""
    load, (width, height) = plate.scene.effects.travelling, plate.scene.plate.size
    assert load is not None
    x, y = _places(plate.scene, times)
    force = load.force * np.cos(2 * math.pi * (load.frequency or 0.0) * times)
    half = load.size / 2
    if load.size < POINT * min(width, height):
        return plate.at_points(np.stack([np.clip(x, 0, width), np.clip(y, 0, height)], axis=1)) * force
    sides = [np.clip(at + sign * half, 0, side) for at, side in ((x, width), (y, height)) for sign in (-1, 1)]
    return plate.patch_forces(np.stack(sides, axis=1)) * force / load.size**2


def _touches(scene: Scene, time: float) -> bool:
    """Return whether the moving load is on the plate at a time [s]."""
    load = scene.effects.travelling
    assert load is not None
    slack = load.size / 2 + 1e-12 * max(scene.plate.size)
    places = zip(_places(scene, np.array([time])), scene.plate.size, strict=True)
    return all(-slack <= at[0] <= side + slack for at, side in places)


def _places(scene: Scene, times: np.ndarray) -> Iterable[np.ndarray]:
    """Return x and y of the moving load's middle [m] at times [s]."""
    load = scene.effects.travelling
    assert load is not None
    return [start + speed * (times - load.from_time) for start, speed in zip(load.start, load.velocity, strict=True)]


def _sample_times(low: float, high: float, turn: float, longest: float) -> np.ndarray:
    """Return (blocks, DEGREE + 1) times [s] of loads that turn at most so fast [rad/s], of blocks up to a length."""
    a_block = 4 * (TOLERANCE * math.factorial(DEGREE + 1) / 2) ** (1 / (DEGREE + 1))
    count = max(1, math.ceil((high - low) * turn / a_block), math.ceil((high - low) / longest))
    length = (high - low) / count
    return np.asarray(low + length * (np.arange(count)[:, None] + NODES))
