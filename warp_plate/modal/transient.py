"""Motion of a plate from rest under unit phasors, exact in time.

In the poles of :mod:`warp_plate.modal.poles` the motion is q = Σ_p ψ_p (χ_p f_k) z_pk(t) with

    ż_pk = s_p z_pk + w_k(t),     z_pk(0) = 0,     q̇ = Σ_p s_p ψ_p (χ_p f_k) z_pk(t)

and w_k the unit load of actuator k. Exponentials w = Σ_j a_j exp(σ_j t) from t = 0 on add to the decaying motion of
before

    z(t) = exp(st) z(0) + Σ_j a_j (exp(σ_j t) − exp(st)) / (σ_j − s).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from warp_plate.modal.loads import ExponentialLoads
from warp_plate.modal.poles import Poles
from warp_plate.modal.sampled import DEGREE, SampledLoads
from warp_plate.modal.steady import as_sparse

# Numbers of an array of poles and times, to limit memory.
BLOCK = 2**18
# Integrals J(x) come from a series with this many terms up to this |x|.
SERIES, SERIES_TERMS = 8.0, 40


def motion_from_rest(
    poles: Poles, gains: np.ndarray, loads: Sequence[ExponentialLoads], shapes: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return (outputs, actuators, times) complex motion under unit phasors.

    Args:
        poles: Poles, apart from the loads' exponents.
        gains: (poles, actuators) χ f.
        loads: Unit loads, one interval after the other from t = 0 on.
        shapes: (outputs, poles) outputs of the free motions; times s for velocities.
        times: (times,) rising times within the loads' intervals [s].
    """
    motion = np.zeros((len(shapes), gains.shape[1], times.size), dtype=complex)
    state = np.zeros(gains.shape, dtype=complex)
    bounds = np.searchsorted(times, [load.end for load in loads], side="right")
    bounds[-1] = times.size
    block, outputs = max(1, BLOCK // poles.values.size), as_sparse(shapes)
    for load, first, last in zip(loads, [0, *bounds], bounds, strict=False):
        forced = forced_states(poles, load)
        free = gains * (state - forced.sum(axis=2))
        amplitudes = outputs @ (gains[:, :, None] * forced).reshape(len(gains), -1)
        amplitudes = amplitudes.reshape(len(shapes), *forced.shape[1:])
        for low in range(first, last, block):
            since = times[low : min(low + block, last)] - load.start
            decays = np.exp(poles.values[:, None] * since)
            for actuator, column in enumerate(free.T):
                turns = np.exp(load.rates[actuator][:, None] * since)
                moved = outputs @ (column[:, None] * decays) + amplitudes[:, actuator] @ turns
                motion[:, actuator, low : low + since.size] = moved
        state = next_state(poles, load, state, forced)
    return motion


def forced_states(poles: Poles, load: ExponentialLoads) -> np.ndarray:
    """Return (poles, actuators, terms) a/(σ − s), the states that follow the load, at the start of its interval."""
    return np.asarray(load.weights / (load.rates - poles.values[:, None, None]))


def next_state(poles: Poles, load: ExponentialLoads, state: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """Return the states (poles, actuators) z at the end of a load's interval."""
    since = load.end - load.start
    decay, one = np.exp(poles.values * since)[:, None], np.ones(forced.shape[2])
    return np.asarray(decay * (state - forced @ one) + (forced * np.exp(load.rates * since)) @ one)


def motion_of_samples(
    poles: Poles, gains: np.ndarray, loads: Sequence[SampledLoads], shapes: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return the same as :func:`motion_from_rest` for polynomials on blocks; their rows are 1 or poles."""
    motion = np.zeros((len(shapes), gains.shape[1], times.size), dtype=complex)
    state = np.zeros(gains.shape, dtype=complex)
    bounds = np.searchsorted(times, [load.end for load in loads], side="right")
    bounds[-1] = times.size
    for load, first, last in zip(loads, [0, *bounds], bounds, strict=False):
        block_of = ((times[first:last] - load.start) / load.length).astype(int)
        block_of = np.minimum(block_of, load.coefficients.shape[2] - 1)
        for low, starts in _block_starts(poles, load, state):
            inside = first + np.arange(*np.searchsorted(block_of, [low, low + len(starts)]))
            for part in np.array_split(inside, math.ceil(inside.size * poles.values.size / BLOCK) or 1):
                blocks = block_of[part - first]
                since = times[part] - load.start - blocks * load.length
                decays, weights = _held(poles.values, since, load.length)
                states = decays[:, :, None] * starts[blocks - low]
                states += np.einsum("tpd,pktd->tpk", weights, load.rows(poles.values.size, blocks), optimize=True)
                motion[:, :, part] = np.einsum("op,tpk->okt", shapes, states * gains, optimize=True)
    return motion


def _block_starts(poles: Poles, load: SampledLoads, state: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the first of some blocks, and the states (blocks, poles, columns) at their starts; ``state`` is updated."""
    decay, weights = (held[0] for held in _held(poles.values, np.array([load.length]), load.length))
    blocks = load.coefficients.shape[2]
    size = max(1, BLOCK // state.size)
    for low in range(0, blocks, size):
        starts = np.empty((min(size, blocks - low), *state.shape), dtype=complex)
        for block, start in enumerate(starts, low):
            start[:] = state
            state *= decay[:, None]
            state += (weights[:, None] * load.coefficients[:, :, block]).sum(axis=2)
        yield low, starts


def _held(poles: np.ndarray, since: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
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
