"""Mean energies over a window by Gauss's rule in time, for loads that are no tones from the start on.

Batches share work: plates that differ only in drives and places share the states of the poles under unit loads. Only
modes that move enough, wherever actuators are, take part; they follow from the scene, so that no plate depends on its
neighbours.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.modal.loads import ExponentialLoads, SampledLoads, trial_forces, trial_frequencies
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.motion import Excitation, make_excitation
from warp_plate.plate.signals import actuator_delays
from warp_plate.scene.grid import Window

# PANEL_POINTS Gauss points per PANEL_PHASE radians of the fastest v², oscillating or decaying.
PANEL_PHASE, PANEL_POINTS = 12.0, 10
# Modes with a total energy below this fraction are left out, judged at TRIALS times: of one plate, and of a batch.
NEGLIGIBLE, TRIALS = 1e-7, 48
BATCH_NEGLIGIBLE, BATCH_TRIALS = 1e-6, 200
# Motions with less than this part of the largest energy in a region are left out of a batch.
RANK_TOLERANCE = 1e-8
# Numbers of an array of modes and times, to limit memory.
VALUES_AT_ONCE = 2**18


def quadrature_matrices(
    excitation: Excitation, drives: np.ndarray, regions: Sequence[np.ndarray], window: Window, velocity: bool
) -> np.ndarray:
    """Return (regions, C, C) mean energies of the products of motions under drives (C, M)."""
    modes = _moving_modes(excitation, window, velocity)
    poles, indices = excitation.poles.restrict(modes)
    moving = [load.part(indices) for load in excitation.moving]
    excitation = replace(excitation, poles=poles, gains=excitation.gains[indices], moving=moving)
    some = [region[np.ix_(modes, modes)] for region in regions]
    times, weights = time_rule(excitation, window)
    matrices = np.zeros((len(regions), *2 * drives.shape[:1]))
    for part in np.array_split(np.arange(times.size), math.ceil(times.size * max(modes.size, 1) / VALUES_AT_ONCE)):
        rates = excitation.motion(drives, times[part], velocity)
        for matrix, region in zip(matrices, some, strict=True):
            momenta = (region @ (rates * weights[part]).reshape(len(rates), -1)).reshape(rates.shape)
            matrix += np.tensordot(rates, momenta, axes=([0, 2], [0, 2])) / 2
    return matrices


def _moving_modes(excitation: Excitation, window: Window, velocity: bool) -> np.ndarray:
    """Return the modes that any actuator, or the moving load, moves enough."""
    trials, actuators = np.linspace(window.start, window.end, TRIALS), excitation.gains.shape[1]
    one = np.eye(actuators)
    unit = replace(excitation, moving=()).motion(np.concatenate([one, -1j * one]), trials, velocity)
    sizes = (unit.reshape(len(unit), 2, actuators, -1) ** 2).sum(axis=(1, 3))
    if excitation.moving:
        alone = excitation.motion(np.zeros((1, actuators)), trials, velocity)
        sizes = np.concatenate([sizes, (alone**2).sum(axis=2)], axis=1)
    total = sizes.sum(axis=0)
    return _largest((sizes / np.where(total > 0, total, 1)).max(axis=1), NEGLIGIBLE)


def _largest(shares: np.ndarray, negligible: float) -> np.ndarray:
    """Return the indices of all but the smallest shares, whose sum is negligible."""
    order = np.argsort(shares)
    return np.sort(order[np.cumsum(shares[order]) > negligible])


def time_rule(excitation: Excitation, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and weights of a mean over the window."""
    loads = (*excitation.loads, *excitation.moving)
    rates = [np.abs(load.rates).max() for load in loads if isinstance(load, ExponentialLoads)]
    sampled = [load for load in loads if isinstance(load, SampledLoads)]
    cuts = {window.start, window.end, *(load.end for load in loads)}
    moments = sorted(cut for cut in cuts if window.start <= cut <= window.end)
    poles = excitation.poles
    values = poles.values[np.abs(poles.vectors).any(axis=0)]
    fastest = 2 * float(np.abs(values.imag).max(initial=max(rates, default=0.0)))
    decay = 2 * float(np.abs(values.real).max(initial=0.0))
    shortest = min((load.length for load in sampled if load.coefficients.any()), default=math.inf)
    s, shares = legendre.leggauss(PANEL_POINTS)
    times, weights = [], []
    for low, high in pairwise(moments):
        panels = max(1, math.ceil((high - low) * max(fastest / PANEL_PHASE, 1 / shortest)))
        length = (high - low) / panels
        # Motion that decays within a panel does so after a corner of the load.
        finer = max(0, math.ceil(math.log2(max(length * decay / PANEL_PHASE, 1)) / 2))
        ends = low + length * np.concatenate([[0], 4.0 ** np.arange(-finer, 0), np.arange(1, panels + 1)])
        half = np.diff(ends)[:, None] / 2
        times.append((ends[:-1, None] + half * (1 + s)).ravel())
        weights.append((half * shares).ravel())
    return np.concatenate(times), np.concatenate(weights) / (window.end - window.start)


class WaveformEnergies:
    """Energies of regions, by their mass matrices, from rest under bursts, sweeps and files, with work that all plates
    share."""

    def __init__(self, plate: ModalPlate, regions: Sequence[np.ndarray], quantity: str = "velocity") -> None:
        self._velocity, self._window = quantity == "velocity", plate.scene.window
        self._modes = modes = self._moving_modes(plate)
        self._plate = plate.part(modes)
        self._factors = [_factor(region[np.ix_(modes, modes)]) for region in regions]

    def matrices(self, frequency: np.ndarray, forces: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Return (plates, regions, 2M, 2M) matrices for frequencies (plates, M) [Hz], modal forces of unit pressures
        (plates or 1, modes, M) and starts of bursts (plates, M) [s]."""
        one = np.eye(frequency.shape[1])
        drives = np.concatenate([one, -1j * one])
        return self._products(np.broadcast_to(drives, (len(frequency), *drives.shape)), frequency, forces, delay)

    def energies(self, phasors: np.ndarray, frequency: np.ndarray, forces: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Return energies (plates, regions) [J] under phasors (plates, M); the others as in :meth:`matrices`."""
        return self._products(phasors[:, None, :], frequency, forces, delay)[:, :, 0, 0]

    def _products(self, drives: np.ndarray, frequency: np.ndarray, forces: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Return (plates, regions, C, C) mean energies of the products of motions under drives (plates, C, M)."""
        products = np.empty((len(drives), len(self._factors), *2 * drives.shape[1:2]))
        forces = np.broadcast_to(forces[:, self._modes], (len(drives), self._modes.size, forces.shape[2]))
        settings, excitation = np.concatenate([frequency, delay], axis=1), None
        for plate, product in enumerate(products):
            if excitation is None or (settings[plate] != settings[plate - 1]).any():
                loads = frequency[plate], delay[plate]
                excitation = make_excitation(self._plate, self._window.end, forces[plate], *loads, moving=False)
                times, weights = time_rule(excitation, self._window)
                states = list(excitation.sampled_states(times))
            excitation = replace(excitation, gains=excitation.poles.gains(forces[plate]))
            rates = excitation.motion(drives[plate], times, self._velocity, states=states)
            rates *= np.sqrt(weights / 2)
            for matrix, factor in zip(product, self._factors, strict=True):
                parts = (factor @ rates.reshape(len(rates), -1)).reshape(factor.shape[0], *rates.shape[1:])
                matrix[:] = np.tensordot(parts, parts, axes=([0, 2], [0, 2]))
        return products

    def _moving_modes(self, plate: ModalPlate) -> np.ndarray:
        """Return the modes that move under trial forces, at the scene's frequencies and the ends of the search's."""
        scene, end = plate.scene, self._window.end
        if scene.coil_indices:  # among whose modes are charges, which have no size to be compared with the others'
            return np.arange(len(plate.frequencies))
        delay, forces = actuator_delays(scene), np.sqrt((trial_forces(plate) ** 2).mean(axis=1))
        columns = delay.size if scene.drive.signal is not None and scene.drive.signal.per_actuator else 1
        shared, drives = np.repeat(forces[:, None], columns, axis=1), np.eye(columns)
        times, energy = np.linspace(0, end, BATCH_TRIALS), np.zeros(len(forces))
        for tone in trial_frequencies(scene):
            excitation = make_excitation(plate, end, shared, np.full(columns, tone), delay[:columns], moving=False)
            size = (excitation.motion(drives, times, self._velocity) ** 2).sum(axis=(1, 2))
            energy = np.maximum(energy, size / (size.sum() or 1.0))
        return _largest(energy, BATCH_NEGLIGIBLE)


def _factor(region: np.ndarray) -> np.ndarray | scipy.sparse.csr_array:
    """Return F (rank, modes) of a positive matrix FᵀF, sparse if it is diagonal."""
    values, vectors = np.linalg.eigh(region)
    significant = values > RANK_TOLERANCE * values[-1]
    factor = np.sqrt(values[significant])[:, None] * vectors[:, significant].T
    return scipy.sparse.csr_array(factor) if np.count_nonzero(factor) <= len(region) else factor
