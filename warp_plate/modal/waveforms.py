"""Energies of many plates under bursts, sweeps and files, which differ in drives, frequencies, places and delays.

The rates of the modes are computed at the points of Gauss's rule over the window: v = Σ_p ψ_p s_p (χ_p f) z_p(t), with
the states z of :mod:`warp_plate.modal.transient` under unit loads. Plates that differ only in drives and places share
these states. Only modes that move enough under such loads, wherever actuators are, take part; they follow from the
scene, so that no plate depends on its neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from warp_plate.modal.loads import ExponentialLoads
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.motion import Excitation, unit_loads
from warp_plate.modal.poles import Poles
from warp_plate.modal.quadrature import time_rule
from warp_plate.modal.sampled import SampledLoads
from warp_plate.modal.tones import trial_forces
from warp_plate.modal.transient import forced_states, motion_of_samples, next_state
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.scene.model import Scene

# Modes with a total energy below this fraction are left out, judged at TRIALS times.
NEGLIGIBLE, TRIALS = 1e-6, 200
# Motions with less than this part of the largest energy in a region are left out.
RANK_TOLERANCE = 1e-8


class WaveformEnergies:
    """Energies of the regions of a plate from rest, for loads that are no tones from the start on.

    Args:
        plate: Modes.
        regions: Mass matrices (modes, modes) of the regions.
        quantity: "velocity" or "displacement".
    """

    def __init__(self, plate: ModalPlate, regions: Sequence[np.ndarray], quantity: str = "velocity") -> None:
        self._velocity, self._window = quantity == "velocity", plate.scene.window
        self._modes = modes = self._moving_modes(plate, np.sqrt((trial_forces(plate) ** 2).mean(axis=1)))
        both = np.ix_(modes, modes)
        self._plate = plate.part(modes)
        self._poles = self._plate.poles(self._window.end)
        self._factors = [_factor(region[both]) for region in regions]

    def matrices(self, frequency: np.ndarray, forces: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Return (plates, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²].

        Args:
            frequency: (plates, M) [Hz].
            forces: (plates or 1, modes, M) modal forces of the actuators' unit pressures.
            delay: (plates, M) starts of the bursts [s].
        """
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
        loads, known, states = np.concatenate([frequency, delay], axis=1), None, None
        for plate, product in enumerate(products):
            if known is None or (loads[plate] != known).any():
                some, known = (frequency[plate], delay[plate]), loads[plate]
                excitation = _excitation(self._plate.scene, self._poles, forces[plate], *some)
                times, weights = time_rule(excitation, self._window, np.arange(self._modes.size))
                states = _states(excitation, times, self._velocity)
            gains = self._poles.gains(forces[plate])
            rates = _rates(excitation, gains, drives[plate], times, self._velocity, states)
            rates *= np.sqrt(weights / 2)
            for matrix, factor in zip(product, self._factors, strict=True):
                parts = (factor @ rates.reshape(len(rates), -1)).reshape(factor.shape[0], *rates.shape[1:])
                matrix[:] = np.tensordot(parts, parts, axes=([0, 2], [0, 2]))
        return products

    def _moving_modes(self, plate: ModalPlate, forces: np.ndarray) -> np.ndarray:
        """Return the modes that move under forces (modes,), at the scene's frequencies and the ends of the search's."""
        scene = plate.scene
        searched = scene.search.frequency
        tones = {*actuator_frequencies(scene).tolist(), *(searched.range if searched is not None else ())}
        end, energy = scene.window.end, np.zeros(len(forces))
        poles, delay = plate.poles(end), actuator_delays(scene)
        columns = delay.size if scene.drive.signal is not None and scene.drive.signal.per_actuator else 1
        shared, drives = np.repeat(forces[:, None], columns, axis=1), np.eye(columns)
        for tone in tones:
            excitation = _excitation(scene, poles, shared, np.full(columns, tone), delay[:columns])
            times, gains = np.linspace(0, end, TRIALS), excitation.gains
            states = _states(excitation, times, self._velocity)
            size = (_rates(excitation, gains, drives, times, self._velocity, states) ** 2).sum(axis=(1, 2))
            energy = np.maximum(energy, size / (size.sum() or 1.0))
        order = np.argsort(energy)
        return np.sort(order[np.cumsum(energy[order]) > NEGLIGIBLE])


def _excitation(scene: Scene, poles: Poles, forces: np.ndarray, frequency: np.ndarray, delay: np.ndarray) -> Excitation:
    """Return the excitation of a plate by actuators (M,) with modal forces (modes, M)."""
    apart, loads = unit_loads(scene, poles, frequency, delay, scene.window.end)
    return Excitation(apart, poles.gains(forces), loads, [])


def _factor(region: np.ndarray) -> np.ndarray | scipy.sparse.csr_array:
    """Return F (rank, modes) of a positive matrix FᵀF, sparse if it is diagonal."""
    values, vectors = np.linalg.eigh(region)
    kept = values > RANK_TOLERANCE * values[-1]
    factor = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    return scipy.sparse.csr_array(factor) if np.count_nonzero(factor) <= len(region) else factor


def _states(excitation: Excitation, times: np.ndarray, velocity: bool) -> np.ndarray | None:
    """Return (poles, M, times) states under unit inputs of loads that are no exponentials, at rising times [s]."""
    poles = excitation.poles
    sampled = [load for load in excitation.loads if isinstance(load, SampledLoads)]
    if not sampled:
        return None
    unit = np.ones((poles.values.size, excitation.gains.shape[1]))
    states = motion_of_samples(poles, unit, sampled, np.eye(poles.values.size), times)
    return states * poles.values[:, None, None] if velocity else states


def _rates(
    excitation: Excitation,
    gains: np.ndarray,
    drives: np.ndarray,
    times: np.ndarray,
    velocity: bool,
    states: np.ndarray | None,
) -> np.ndarray:
    """Return (modes, C, times) real motions under drives (C, M) with gains (poles, M), at rising times [s]."""
    if states is not None:
        return np.asarray(_sum_over_poles(excitation.poles, (gains[:, None, :] * drives) @ states).real)
    poles, count = excitation.poles, len(excitation.poles.vectors)
    pairs = poles.modes is not None and np.array_equal(poles.values[count:], poles.values[:count].conj())
    scaled = gains * poles.values[:, None] if velocity else gains
    rates = np.empty((count, len(drives), times.size))
    state, first = np.zeros(gains.shape, dtype=complex), 0
    for load in excitation.loads:
        assert isinstance(load, ExponentialLoads)
        last = times.size if load is excitation.loads[-1] else int(np.searchsorted(times, load.end, side="right"))
        forced = forced_states(poles, load)
        if last > first:
            since = times[first:last] - load.start
            turns = drives[:, :, None, None] * np.exp(load.rates[:, :, None] * since)
            amplitudes = _sum_over_poles(poles, scaled[:, :, None] * forced).reshape(count, -1)
            part = (amplitudes @ np.moveaxis(turns, 0, 2).reshape(amplitudes.shape[1], -1)).real
            free = (scaled * (state - forced @ np.ones(forced.shape[2]))) @ drives.T
            if pairs:  # the real part of a motion is that of its conjugate
                free = poles.vectors[poles.modes, np.arange(len(free))][:, None] * free
                free, decays = free[:count] + free[count:].conj(), np.exp(poles.values[:count, None] * since)
                part += (free[:, :, None] * decays[:, None]).real.reshape(count, -1)
            else:
                decays = np.exp(poles.values[:, None] * since)
                part += _sum_over_poles(poles, free[:, :, None] * decays[:, None]).real.reshape(count, -1)
            rates[:, :, first:last] = part.reshape(count, len(drives), -1)
        state, first = next_state(poles, load, state, forced), last
    return rates


def _sum_over_poles(poles: Poles, states: np.ndarray) -> np.ndarray:
    """Return Σ_p ψ_p states (modes, ...) of states (poles, ...)."""
    flat = states.reshape(len(states), -1)
    if poles.modes is None:
        moved = poles.vectors @ flat
    else:
        count = len(poles.vectors)
        scaled = poles.vectors[poles.modes, np.arange(len(states))][:, None] * flat
        moved = scaled[:count] + scaled[count:]
    return np.asarray(moved.reshape(-1, *states.shape[1:]))
