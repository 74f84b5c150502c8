"""Motion of a plate from rest under unit phasors, exact in time.

In the poles of :mod:`warp_plate.modal.poles` the motion is q = Σ_p ψ_p (χ_p f_k) z_pk(t) with

    ż_pk = s_p z_pk + w_k(t),     z_pk(0) = 0,     q̇ = Σ_p s_p ψ_p (χ_p f_k) z_pk(t)

and w_k the unit load of actuator k. Exponentials w = Σ_j a_j exp(σ_j t) from t = 0 on add to the decaying motion of
before

    z(t) = exp(st) z(0) + Σ_j a_j (exp(σ_j t) − exp(st)) / (σ_j − s).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_plate.modal.loads import ExponentialLoads
from warp_plate.modal.poles import Poles

# Numbers of an array of poles and times, to limit memory.
BLOCK = 2**20


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
    block = max(1, BLOCK // poles.values.size)
    for load, first, last in zip(loads, [0, *bounds], bounds, strict=False):
        forced = forced_states(poles, load)
        free = gains * (state - forced.sum(axis=2))
        amplitudes = np.einsum("op,pk,pkj->okj", shapes, gains, forced, optimize=True)
        for low in range(first, last, block):
            since = times[low : min(low + block, last)] - load.start
            decays = np.exp(poles.values[:, None] * since)
            for actuator, column in enumerate(free.T):
                turns = np.exp(load.rates[actuator][:, None] * since)
                moved = (shapes * column) @ decays + amplitudes[:, actuator] @ turns
                motion[:, actuator, low : low + since.size] = moved
        state = next_state(poles, load, state, forced)
    return motion


def forced_states(poles: Poles, load: ExponentialLoads) -> np.ndarray:
    """Return (poles, actuators, terms) a/(σ − s), the states that follow the load, at the start of its interval."""
    return np.asarray(load.weights / (load.rates - poles.values[:, None, None]))


def next_state(poles: Poles, load: ExponentialLoads, state: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """Return the states (poles, actuators) z at the end of a load's interval."""
    since = load.end - load.start
    decay = np.exp(poles.values * since)[:, None]
    return np.asarray(decay * (state - forced.sum(axis=2)) + (forced * np.exp(load.rates * since)).sum(axis=2))
