"""Motion of a plate under its scene's drive, exact in time: from rest, or steady.

In the poles of :mod:`warp_plate.modal.poles` the motion from rest is q = Σ_p ψ_p (χ_p f_k) z_pk(t) with

    ż_pk = s_p z_pk + w_k(t),     z_pk(0) = 0,     q̇ = Σ_p s_p ψ_p (χ_p f_k) z_pk(t)

and w_k the unit load of actuator k. Exponentials w = Σ_j a_j exp(σ_j t) from t = 0 on add to the decaying motion of
before

    z(t) = exp(st) z(0) + Σ_j a_j (exp(σ_j t) − exp(st)) / (σ_j − s).

Steady motion is that of scenes with hysteretic damping, see ``Scene.steady``.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.loads import (
    DEGREE,
    ExponentialLoads,
    SampledLoads,
    exponential_loads,
    has_exponential_loads,
    moving_loads,
    sampled_loads,
)
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles
from warp_plate.plate.shapes import target_outlines
from warp_plate.plate.signals import actuator_delays, actuator_frequencies

# Numbers of an array of poles and times, and of displacements that are computed at once, to limit memory.
VALUES_AT_ONCE, DISPLACEMENTS_AT_ONCE = 2**18, 2**22
# Integrals J(x) come from a series with this many terms up to this |x|.
SERIES, SERIES_TERMS = 8.0, 40
# Points along each side of the plate at which its largest displacement is sought.
SIDE = 101


def trace(
    plate: ModalPlate, drives: np.ndarray, points: Sequence[tuple[float, float]] | np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return (drives, points, times) displacement [m] under phasors (drives, actuators) at points (x, y) [m] and times
    from 0 on [s]."""
    return modal_motion(plate, drives, times, outputs=plate.at_points(points).T).swapaxes(0, 1)


def fields(plate: ModalPlate, drives: np.ndarray, times: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (drives, times, ny, nx) displacement [m] on the grid of x and y [m]; see :func:`trace`."""
    return plate.displacement(modal_motion(plate, drives, times).transpose(1, 2, 0), x, y)


def largest_displacements(plate: ModalPlate, phasors: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest magnitudes (plates, SIDE, SIDE) [m] over the plate, and (plates,) on its target's outline.

    The maximum of a region often lies on its outline, where the displacement has a slope: there a grid alone would miss
    several per cent. Steady motion of one frequency has the amplitude of its parts in phase and a quarter of a period
    later, whatever the times; any other motion is sampled at them.
    """
    scene = plate.scene
    x, y = (np.linspace(0, side, SIDE) for side in scene.plate.size)
    points = _points_along(target_outlines(scene, "target", scene.target), max(scene.plate.size) / SIDE)
    at_points = plate.at_points(points)
    over_plate, on_outline = np.zeros((len(phasors), SIDE, SIDE)), np.zeros((len(phasors), len(points)))
    frequencies = set(actuator_frequencies(scene).tolist())
    steady = scene.steady and len(frequencies) == 1
    if steady:
        times = np.array([0.0, 0.25 / frequencies.pop()])
    block = max(2, DISPLACEMENTS_AT_ONCE // max(1, over_plate.size + on_outline.size))
    for first in range(0, times.size, block):
        amplitudes = modal_motion(plate, phasors, times[first : first + block]).transpose(1, 2, 0)
        on_grid, on_points = plate.displacement(amplitudes, x, y), amplitudes @ at_points
        for largest, displacement in ((over_plate, on_grid), (on_outline, on_points)):
            size = np.hypot(displacement[:, 0], displacement[:, 1]) if steady else np.abs(displacement).max(axis=1)
            np.maximum(largest, size, out=largest)
    return over_plate, on_outline.max(axis=1, initial=0.0)


def _points_along(outlines: Sequence[np.ndarray], spacing: float) -> np.ndarray:
    """Return points (points, 2) along closed outlines, their corners and others at most ``spacing`` [m] apart."""
    points = [np.empty((0, 2))]
    for outline in outlines:
        length = np.concatenate([[0.0], np.hypot(*np.diff(outline, axis=0).T).cumsum()])
        at = np.union1d(length, np.linspace(0, length[-1], math.ceil(length[-1] / spacing) + 1))
        points.append(np.column_stack([np.interp(at, length, column) for column in outline.T]))
    return np.concatenate(points)


def modal_motion(
    plate: ModalPlate,
    drives: np.ndarray,
    times: np.ndarray,
    velocity: bool = False,
    outputs: np.ndarray | None = None,
) -> np.ndarray:
    """Return (modes, drives, times) amplitudes of the modes, or their rates, or (outputs, drives, times) products with
    ``outputs`` (outputs, modes), at times from 0 on [s] in any order."""
    drives, times = np.asarray(drives), np.asarray(times, dtype=float)
    if plate.scene.steady:
        return _steady_motion(plate, drives, times, velocity, outputs)
    end, order = max(float(times.max(initial=0.0)), plate.scene.window.end), np.argsort(times, kind="stable")
    motion = make_excitation(plate, end).motion(drives, times[order], velocity, outputs)
    return motion[:, :, np.argsort(order, kind="stable")]


def _steady_motion(
    plate: ModalPlate, drives: np.ndarray, times: np.ndarray, velocity: bool, outputs: np.ndarray | None
) -> np.ndarray:
    forces, frequency = plate.actuator_forces(), actuator_frequencies(plate.scene)
    rates = 2j * math.pi * frequency
    responses = [plate.respond(tone, forces[:, [k]])[0, :, 0] for k, tone in enumerate(frequency[:, None])]
    columns = np.stack(responses, axis=1) * plate.drive_gains(frequency[None]) * (rates if velocity else 1)
    rotation = np.exp(rates[:, None] * times)
    return np.asarray(((columns if outputs is None else outputs @ columns)[:, None] * drives @ rotation).real)


@dataclass(frozen=True)
class Excitation:
    """Loads of a plate that begins at rest, and how they excite its poles."""

    poles: Poles  # Poles, apart from the exponents of the loads
    gains: np.ndarray  # (poles, actuators) inputs of the actuators' unit pressures
    loads: Sequence[ExponentialLoads] | Sequence[SampledLoads]  # Unit loads of the actuators in time
    moving: Sequence[SampledLoads] = ()  # Inputs of a moving load in time; empty if there is none

    def motion(
        self,
        drives: np.ndarray,
        times: np.ndarray,
        velocity: bool = False,
        outputs: np.ndarray | None = None,
        states: Iterable[tuple[np.ndarray, np.ndarray]] | None = None,
    ) -> np.ndarray:
        """Return the motion of :func:`modal_motion` at rising times [s]; ``states`` are those of
        :meth:`sampled_states`, where several excitations share them."""
        rows = len(self.poles.vectors) if outputs is None else len(outputs)
        motion, speed = np.empty((rows, len(drives), times.size)), self.poles.values[:, None] ** int(velocity)
        gains, exponential = self.gains * speed, [load for load in self.loads if isinstance(load, ExponentialLoads)]
        driven: Iterable[tuple[np.ndarray | slice, np.ndarray]]
        if exponential:
            driven = self._exponential_amplitudes(exponential, drives, times, gains)
        else:
            states = self.sampled_states(times) if states is None else states
            driven = ((at, self.poles.superpose((gains[:, None, :] * drives) @ some).real) for at, some in states)
        for where, amplitudes in driven:
            motion[:, :, where] = amplitudes if outputs is None else np.tensordot(outputs, amplitudes, 1)
        for where, some in sampled_states(self.poles, self.moving, 1, times):
            amplitudes = self.poles.superpose(some * speed[:, :, None]).real
            motion[:, :, where] += amplitudes if outputs is None else np.tensordot(outputs, amplitudes, 1)
        return motion

    def sampled_states(self, times: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield indices of rising times [s], and states z (poles, actuators, times) under sampled unit inputs."""
        sampled = [load for load in self.loads if isinstance(load, SampledLoads)]
        return sampled_states(self.poles, sampled, self.gains.shape[1], times)

    def _exponential_amplitudes(
        self, loads: Sequence[ExponentialLoads], drives: np.ndarray, times: np.ndarray, gains: np.ndarray
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield indices of times, and amplitudes (modes, drives, times) there, or rates, by ``gains``."""
        poles, count = self.poles, len(self.poles.vectors)
        pairs = poles.modes is not None and np.array_equal(poles.values[count:], poles.values[:count].conj())
        block, first = max(1, 4 * VALUES_AT_ONCE // poles.values.size), 0
        for load, forced, free in exponential_states(poles, loads):
            last = times.size if load is loads[-1] else int(np.searchsorted(times, load.end, side="right"))
            if last > first:
                following = poles.superpose(gains[:, :, None] * forced).reshape(count, -1)
                decaying = (gains * free) @ drives.T
                if pairs:  # the real part of a motion is that of its conjugate
                    decaying = poles.sizes[:, None] * decaying
                    decaying = decaying[:count] + decaying[count:].conj()
            for low in range(first, last, block):
                since = times[low : min(low + block, last)] - load.start
                tones = drives[:, :, None, None] * np.exp(load.rates[:, :, None] * since)
                part = (following @ np.moveaxis(tones, 0, 2).reshape(following.shape[1], -1)).real
                part = part.reshape(count, len(drives), -1)
                decays = np.exp(poles.values[: len(decaying), None] * since)
                free_part = decaying[:, :, None] * decays[:, None]
                part += free_part.real if pairs else poles.superpose(free_part).real
                yield slice(low, low + since.size), part
            first = last


def make_excitation(
    plate: ModalPlate,
    end: float,
    forces: np.ndarray | None = None,
    frequency: np.ndarray | None = None,
    delay: np.ndarray | None = None,
    moving: bool = True,
) -> Excitation:
    """Return the excitation of a plate from t = 0 to ``end`` [s], with the scene's moving load if it is to be added.

    Modal forces (modes, actuators) of unit pressures, frequencies (actuators,) at t = 0 [Hz] and starts of bursts
    (actuators,) [s] are by default the scene's.
    """
    scene, poles = plate.scene, plate.poles(end)
    forces = plate.actuator_forces() if forces is None else forces
    frequency = actuator_frequencies(scene) if frequency is None else frequency
    delay = actuator_delays(scene) if delay is None else delay
    loads: list[ExponentialLoads] | list[SampledLoads]
    if has_exponential_loads(scene.drive):
        loads = exponential_loads(scene.drive.burst, frequency, delay, end)
        poles = poles.apart_from(np.concatenate([load.rates.ravel() for load in loads]), end)
    else:
        loads = sampled_loads(scene, frequency, delay, end)
    others = [load.times_inputs(poles.inputs) for load in moving_loads(plate, end)] if moving else []
    return Excitation(poles, poles.gains(forces), loads, others)


def exponential_states(
    poles: Poles, loads: Sequence[ExponentialLoads]
) -> Iterator[tuple[ExponentialLoads, np.ndarray, np.ndarray]]:
    """Yield loads with the states z under unit inputs at the start of their intervals: (poles, actuators, terms)
    a/(σ − s) that follow a load as exp(σ(t − start)), and free ones (poles, actuators) that decay as exp(s(t − start)).
    """
    state: np.ndarray | float = 0.0
    for load in loads:
        forced = load.weights / (load.rates - poles.values[:, None, None])
        one, since = np.ones(forced.shape[2]), load.end - load.start
        free = state - forced @ one
        yield load, forced, free
        state = np.exp(poles.values * since)[:, None] * free + (forced * np.exp(load.rates * since)) @ one


def sampled_states(
    poles: Poles, loads: Sequence[SampledLoads], columns: int, times: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield indices of rising times [s], and states z (poles, columns, times) there, under unit inputs."""
    state, count = np.zeros((poles.values.size, columns), dtype=complex), poles.values.size
    bounds = np.searchsorted(times, [load.end for load in loads], side="right")
    bounds[-1:] = times.size
    for load, first, last in zip(loads, [0, *bounds], bounds, strict=False):
        block_of = ((times[first:last] - load.start) / load.length).astype(int)
        block_of = np.minimum(block_of, load.coefficients.shape[2] - 1)
        for low, starts in _block_starts(poles, load, state):
            inside = first + np.arange(*np.searchsorted(block_of, [low, low + len(starts)]))
            for part in np.array_split(inside, math.ceil(inside.size * count / VALUES_AT_ONCE)) if inside.size else ():
                blocks = block_of[part - first]
                since = times[part] - load.start - blocks * load.length
                decays, weights = _response_to_powers(poles.values, since, load.length)
                states = decays[:, :, None] * starts[blocks - low]
                states += np.einsum("tpd,pktd->tpk", weights, load.rows(count, blocks), optimize=True)
                yield part, states.transpose(1, 2, 0)


def _block_starts(poles: Poles, load: SampledLoads, state: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the first of some blocks, and the states (blocks, poles, columns) at their starts; ``state`` is updated."""
    decay, weights = (values[0] for values in _response_to_powers(poles.values, np.array([load.length]), load.length))
    blocks = load.coefficients.shape[2]
    size = max(1, VALUES_AT_ONCE // state.size)
    for low in range(0, blocks, size):
        starts = np.empty((min(size, blocks - low), *state.shape), dtype=complex)
        for block, start in enumerate(starts, low):
            start[:] = state
            state *= decay[:, None]
            state += (weights[:, None] * load.coefficients[:, :, block]).sum(axis=2)
        yield low, starts


def _response_to_powers(poles: np.ndarray, since: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return exp(sθ) (times, poles) and ∫ exp(s(θ − τ)) (τ/length)^k dτ from 0 to θ (times, poles, DEGREE + 1).

    The integrals are θ (θ/length)^k J_k(sθ) with J_k(x) = ∫ exp(x(1 − v)) v^k dv from 0 to 1, for which
    x J_k = k J_{k−1} − 1: upwards where x is large, downwards from a series where it is small.
    """
    x = poles * since[:, None]
    decay = np.exp(x)
    integrals = np.empty((*x.shape, DEGREE + 1), dtype=complex)
    small = np.abs(x) < SERIES
    divisor = np.where(small, 1, x)
    integrals[..., 0] = (decay - 1) / divisor
    for k in range(1, DEGREE + 1):
        integrals[..., k] = (k * integrals[..., k - 1] - 1) / divisor
    near = x[small]
    total = np.zeros_like(near)
    for m in range(SERIES_TERMS, -1, -1):  # Σ_m x^m n!/(n + m + 1)!, n the degree
        total = (1 + near * total) / (DEGREE + m + 1)
    integrals[small, DEGREE] = total
    for k in range(DEGREE, 0, -1):
        total = (1 + near * total) / k
        integrals[small, k - 1] = total
    return decay, integrals * (since[:, None] * (since[:, None] / length) ** np.arange(DEGREE + 1))[:, None]
