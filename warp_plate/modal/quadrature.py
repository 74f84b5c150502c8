"""Mean energies over a window by Gauss's rule in time, for loads that are no sums of exponentials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre

from warp_plate.modal.loads import ExponentialLoads
from warp_plate.modal.motion import Excitation
from warp_plate.modal.sampled import SampledLoads
from warp_plate.scene.model import Window

# A span of time in which the fastest v² turns or decays by PANEL_TURN [rad] takes PANEL_POINTS of Gauss's points.
PANEL_TURN, PANEL_POINTS = 12.0, 10
# Modes with a total energy below this fraction are left out, judged at a number of times.
NEGLIGIBLE, TRIALS = 1e-7, 48


def by_quadrature(
    excitation: Excitation, regions: Sequence[np.ndarray], window: Window, quantity: str = "velocity"
) -> np.ndarray:
    """Return (regions, 2C, 2C) matrices of mean energies, C the actuators and the moving load."""
    count = excitation.poles.vectors.shape[0]
    velocity = quantity == "velocity"
    trials = np.linspace(window.start, window.end, TRIALS)
    sizes = (np.abs(excitation.motion(np.eye(count), trials, velocity)) ** 2).sum(axis=2)
    total = sizes.sum(axis=0)
    shares = (sizes / np.where(total > 0, total, 1)).max(axis=1)
    order = np.argsort(shares)
    modes = np.sort(order[np.cumsum(shares[order]) > NEGLIGIBLE])
    some = excitation.restrict(modes)
    times, weights = time_rule(some, window, modes)
    columns = 2 * (excitation.gains.shape[1] + bool(excitation.moving))
    matrices = np.zeros((len(regions), columns, columns))
    for part in np.array_split(np.arange(times.size), math.ceil(times.size * max(modes.size, 1) / 2**18)):
        motion = some.motion(np.eye(count)[modes], times[part], velocity)
        rates = np.concatenate([motion.real, motion.imag], axis=1).transpose(1, 0, 2)
        for matrix, region in zip(matrices, regions, strict=True):
            moved = region[np.ix_(modes, modes)] @ (rates * weights[part])
            matrix += np.tensordot(rates, moved, axes=([1, 2], [1, 2])) / 2
    return matrices


def time_rule(excitation: Excitation, window: Window, modes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and weights of a mean over the window, for the motion of some modes."""
    loads = (*excitation.loads, *excitation.moving)
    sampled = [load for load in loads if isinstance(load, SampledLoads)]
    turns = [np.abs(load.rates).max() for load in loads if isinstance(load, ExponentialLoads)]
    cuts = {window.start, window.end, *(load.end for load in loads)}
    moments = sorted(cut for cut in cuts if window.start <= cut <= window.end)
    poles = excitation.poles
    moving = np.abs(poles.vectors[modes]).any(axis=0)
    fastest = 2 * float(np.abs(poles.values[moving].imag).max(initial=max(turns, default=0.0)))
    decay = 2 * float(np.abs(poles.values[moving].real).max(initial=0.0))
    shortest = min((load.length for load in sampled if load.coefficients.any()), default=math.inf)
    s, shares = legendre.leggauss(PANEL_POINTS)
    times, weights = [], []
    for low, high in pairwise(moments):
        panels = max(1, math.ceil((high - low) * max(fastest / PANEL_TURN, 1 / shortest)))
        length = (high - low) / panels
        # Motion that decays within a panel does so after a corner of the load.
        finer = max(0, math.ceil(math.log2(max(length * decay / PANEL_TURN, 1)) / 2))
        ends = low + length * np.concatenate([[0], 4.0 ** np.arange(-finer, 0), np.arange(1, panels + 1)])
        half = np.diff(ends)[:, None] / 2
        times.append((ends[:-1, None] + half * (1 + s)).ravel())
        weights.append((half * shares).ravel())
    return np.concatenate(times), np.concatenate(weights) / (window.end - window.start)
