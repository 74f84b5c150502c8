"""Slopes of modal energies with respect to drives, frequencies, places and delays, by formula.

In an interval between two corners of the loads (:mod:`warp_plate.modal.loads`) the complex rates of the modes are a sum
of exponentials v = Σ_j A_j exp(σ_j t) + Σ_p ψ_p c_p exp(s_p t), forced and free, and E = ½ ⟨Re vᵀ G Re v⟩. Its slope
by a parameter θ is

    ∂E/∂θ = Re ⟨Re vᵀ G ∂v/∂θ⟩ = Re (Σ_j λ_jᵀ ∂A_j/∂θ + Σ_j λ'_jᵀ A_j ∂σ_j/∂θ + Σ_p μ_p ∂c_p/∂θ)

    λ_j = ⟨G Re v exp(σ_j t)⟩,     λ'_j = ⟨G Re v t exp(σ_j t)⟩,     μ_p = ψ_pᵀ ⟨G Re v exp(s_p t)⟩

whose means are closed formulas, and which all parameters share. Amplitudes are those of the states z of
:mod:`warp_plate.modal.motion`, which are carried from one interval to the next with their derivatives: a frequency
changes an exponent, a delay d a load w by −(σ − iω) w and, where it jumps, the state by that jump; a place the modal
force, by the difference of the line integrals along the two sides that move.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.modal.assemble import load_integrals, load_slopes
from warp_plate.modal.gram import Means, lasting_poles, mean_exponential, mean_exponential_with_time
from warp_plate.modal.loads import ExponentialLoads, exponential_loads
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles, multiply_modes
from warp_plate.plate.signals import actuator_delays
from warp_plate.scene.grid import Window

# Relative step of the difference quotients by the frequency of plates with coils.
DIFFERENCE = 1e-6
# Numbers of the arrays of a block of designs.
SLOPES_AT_ONCE = 2**22


@dataclass(frozen=True)
class EnergySlopes:
    """Energies of designs and their slopes."""

    energy: np.ndarray  # (designs, regions) E [J]
    drives: np.ndarray  # (designs, regions, 2M) ∂E/∂z, z = (Re Z, −Im Z) of the phasors Z
    frequency: np.ndarray  # (designs, regions, M) ∂E by the frequency of each actuator [J/Hz]
    centre: np.ndarray  # (designs, regions, M, 2) ∂E by x and y of its centre [J/m]
    delay: np.ndarray  # (designs, regions, M) ∂E by the start of its burst [J/s]; 0 without bursts


def energy_slopes(
    means: Means, phasors: np.ndarray, frequency: np.ndarray, areas: np.ndarray, delay: np.ndarray | None = None
) -> EnergySlopes:
    """Return energies of tones or bursts under phasors (designs, M) [N/m²], and their slopes.

    The actuators have rectangles (designs or 1, M, 4) x0, x1, y0, y1 [m]; for all else see
    :func:`warp_plate.modal.gram.gram_matrices`.
    """
    plate = means.plate
    block = max(1, SLOPES_AT_ONCE // (8 * len(plate.frequencies) * phasors.shape[1]))
    if plate.scene.drive.burst is None:
        delay = None
    else:
        block = 1  # the corners of each design cut other intervals
        delay = np.broadcast_to(actuator_delays(plate.scene), phasors.shape) if delay is None else delay
    parts = []
    for first in range(0, len(phasors), block):
        rows = slice(first, first + block)
        forces = _patch_forces(plate, areas[rows] if len(areas) > 1 else areas)
        if means.window is None:
            parts.append(_steady(means, phasors[rows], frequency[rows], forces))
        else:
            delays = None if delay is None else delay[rows]
            parts.append(_from_rest(means, means.window, phasors[rows], frequency[rows], delays, forces))
    return EnergySlopes(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _patch_forces(plate: ModalPlate, areas: np.ndarray) -> np.ndarray:
    """Return (3, designs, modes, M) modal forces over areas (designs, M, 4) and their slopes by x and y."""
    if plate.scene.coil_indices:  # which stay in their places, as do all actuators beside them
        forces = np.moveaxis(plate.drive_forces(areas).reshape(-1, *areas.shape[:2]), 0, 1)
        return np.stack([forces, 0 * forces, 0 * forces])
    integrals = np.stack([load_integrals(plate.galerkin, areas), *load_slopes(plate.galerkin, areas)])
    forces = integrals @ plate.vectors[: integrals.shape[2]]
    return np.asarray(forces.reshape(3, *areas.shape[:2], -1).swapaxes(2, 3))


def _steady(means: Means, phasors: np.ndarray, frequency: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the arrays of :class:`EnergySlopes` in the steady state."""
    plate = means.plate
    rate = 2j * math.pi * frequency[:, None, :]
    unit, by_x, by_y = (plate.respond_to_drives(frequency, force) for force in forces)
    if plate.coils is None and plate.air is None:
        # By iω of the dynamic stiffness, times the amplitudes.
        by_rate = -plate.respond_each(frequency, 2 * rate * unit + multiply_modes(plate.damping, unit))
    else:
        ends = (plate.respond_to_drives(frequency * (1 + side), forces[0]) for side in (DIFFERENCE, -DIFFERENCE))
        by_rate = np.subtract(*ends) / (2 * DIFFERENCE * rate)
    if means.velocity:
        by_rate = rate * by_rate + unit
        unit, by_x, by_y = rate * unit, rate * by_x, rate * by_y
    same = frequency[:, :, None] == frequency[:, None, :]
    motion = (unit * phasors[:, None, :]) @ same
    values = []
    for momenta in means.momenta(frequency, motion):
        values.append(np.stack([(momenta.conj() / 2 * by).sum(axis=1) for by in (unit, by_rate, by_x, by_y)]))
    by_drive, by_rate, *by_centre = np.stack(values, axis=2)
    zero = np.zeros(by_drive.shape, dtype=complex)
    return _assemble(phasors, by_drive, 2j * math.pi * by_rate, np.stack(by_centre, axis=-1), zero)


def _assemble(
    phasors: np.ndarray, drives: np.ndarray, frequency: np.ndarray, centre: np.ndarray, delay: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return the arrays of :class:`EnergySlopes` from ⟨Re vᵀ G ∂v⟩ under unit phasors."""
    energy = (drives * phasors[:, None, :]).sum(axis=2).real / 2
    by_z = np.concatenate([drives.real, drives.imag], axis=2)
    by_frequency, by_delay = ((values * phasors[:, None, :]).real for values in (frequency, delay))
    return energy, by_z, by_frequency, (centre * phasors[:, None, :, None]).real, by_delay


def _from_rest(
    means: Means,
    window: Window,
    phasors: np.ndarray,
    frequency: np.ndarray,
    delay: np.ndarray | None,
    forces: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Return the arrays of :class:`EnergySlopes` over a window; under bursts, of a single design."""
    poles, regions, velocity = means.plate.poles(window.end), means.regions, means.velocity
    alike = bool((frequency == frequency[:, :1]).all() and (delay is None or (delay == delay[:, :1]).all()))
    gains = poles.gains(forces[0])
    pushed, inputs = forces[0] * phasors[:, None, :], gains * phasors[:, None, :]
    if alike:  # all actuators press as the first does
        frequency, delay = frequency[:, :1], None if delay is None else delay[:, :1]
        pushed, inputs = pushed.sum(axis=2, keepdims=True), inputs.sum(axis=2, keepdims=True)
    if delay is None:
        rates = poles.shift_rates(2j * math.pi * frequency, window.end)[..., None]
        loads = [ExponentialLoads(0.0, window.end, rates, np.ones_like(rates))]
    else:
        loads = exponential_loads(means.plate.scene.drive.burst, frequency[0], delay[0], window.end)
        poles = poles.apart_from(np.concatenate([load.rates.ravel() for load in loads]), window.end)
        loads = [replace(load, rates=load.rates[None], weights=load.weights[None]) for load in loads]
    total = np.zeros((3, len(phasors), len(regions), *inputs.shape[1:]), dtype=complex)
    # Poles that a place does not excite count too, if a neighbouring place excites them.
    excited = np.stack([gains, *(poles.gains(force) for force in forces[1:])])
    for load, forced, free in _motions(poles, loads, frequency, velocity):
        if load.end > window.start:
            part = Window(start=max(window.start - load.start, 0.0), end=min(load.end, window.end) - load.start)
            share = (part.end - part.start) / (window.end - window.start)
            lasting = lasting_poles(poles, excited, free[0], forced[0], load.rates, part, window.end, velocity)
            total += share * _mean_slopes(poles, lasting, regions, load.rates, (forced, free), pushed, inputs, part)
    by_drive, by_frequency, by_delay = (total * gains[:, None]).sum(axis=3)
    of_forces = poles.inputs.T @ total[0]
    by_centre = [(of_forces * slope[:, None]).sum(axis=2) for slope in forces[1:]]
    return _assemble(phasors, by_drive, by_frequency, np.stack(by_centre, axis=-1), by_delay)


def _mean_slopes(
    poles: Poles,
    lasting: np.ndarray,
    regions: Sequence[np.ndarray],
    exponents: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray],
    pushed: np.ndarray,
    inputs: np.ndarray,
    part: Window,
) -> np.ndarray:
    """Return (3, designs, regions, poles, K) ⟨Re vᵀ G ∂v⟩ of unit inputs, by the drive, frequency and delay.

    ``lasting`` are the poles whose free motion matters, ``exponents`` (designs, K, terms) those of the load, ``motion``
    as of :func:`_motions`, ``pushed`` (designs, modes, K) modal forces times phasors, ``inputs`` (designs, poles, K)
    the same for the poles; the window counts from the start of the interval.
    """
    forced_states, free_states = motion
    designs, count, _, terms = forced_states.shape[1:]
    rates, states = exponents.reshape(designs, -1), forced_states[0].reshape(designs, count, -1)
    forced = poles.forced(states, np.repeat(pushed, terms, axis=2), np.repeat(inputs, terms, axis=2))
    some, free = poles.part(lasting), (inputs * free_states[0]).sum(axis=2)[:, lasting]
    sides = [_side_means(rates, some.values, conjugate, part) for conjugate in (False, True)]
    slopes = np.empty((3, designs, len(regions), count, exponents.shape[1]), dtype=complex)
    for number, region in enumerate(regions):
        momenta = multiply_modes(region, forced), some.observe(region)
        rising = np.zeros((2, *forced.shape), dtype=complex)
        inner = np.zeros_like(free)
        for conjugate, (of_forced, of_free, crossed, decayed) in enumerate(sides):
            side = [values.conj() if conjugate else values for values in (*momenta, free)]
            columns, across, amplitudes = side
            for target, mean, other in zip(rising, of_forced, of_free, strict=True):
                target += columns @ mean / 2 + multiply_modes(across, amplitudes[:, :, None] * other) / 2
            inner += (some.project(columns) * crossed).sum(axis=2) / 2
            inner += amplitudes @ (some.project(across) * decayed).T / 2
        by_amplitude, by_exponent = poles.project(rising).reshape(2, *forced_states.shape[1:3], *exponents.shape[1:])
        values = (forced_states * by_amplitude).sum(axis=4)
        values[1] += 2j * math.pi * (forced_states[0] * by_exponent).sum(axis=3)
        values[:, :, lasting] += free_states[:, :, lasting] * inner[:, :, None]
        slopes[:, :, number] = values
    return slopes


def _motions(
    poles: Poles, loads: Sequence[ExponentialLoads], frequency: np.ndarray, velocity: bool
) -> Iterator[tuple[ExponentialLoads, np.ndarray, np.ndarray]]:
    """Yield the loads (designs, K, terms) of one interval after the other, and the states z of the poles and their
    slopes by frequency and delay: (3, designs, poles, K, terms) that follow the load as exp(σ (t − start)), and
    (3, designs, poles, K) that decay as exp(s (t − start)), for K actuators or one for all."""
    decays, omega = poles.values[:, None], 2j * math.pi
    state = np.zeros((3, len(frequency), poles.values.size, frequency.shape[1]), dtype=complex)
    before = np.zeros(frequency.shape, dtype=complex)
    for load in loads:
        rates, since = load.rates[:, None], load.end - load.start
        weights = load.weights[:, None]
        by_delay = -(rates - omega * frequency[:, None, :, None]) * weights
        state[2] -= (load.weights.sum(axis=2) - before)[:, None]
        gap = 1 / (rates - decays[..., None])
        forced = np.stack([weights * gap, omega * weights * gap * (load.start - gap), by_delay * gap])
        free = state - forced.sum(axis=4)
        following = forced * rates if velocity else forced
        if velocity:
            following[1] += omega * forced[0]
        yield load, following, free * decays if velocity else free
        grown = forced * np.exp(rates * since)
        grown[1] += omega * since * grown[0]
        state = free * np.exp(decays * since) + grown.sum(axis=4)
        before = (load.weights * np.exp(load.rates * since)).sum(axis=2)


def _side_means(rates: np.ndarray, decays: np.ndarray, conjugate: int, part: Window) -> tuple[Any, ...]:
    """Return the means of products of exponentials, the first one conjugate or not: forced with forced and free with
    forced motion, both also times t; free with forced and free with free."""
    first, free = (rates.conj(), decays.conj()) if conjugate else (rates, decays)
    of_forced = mean_exponential_with_time(first[:, :, None], rates[:, None, :], part)
    of_free = mean_exponential_with_time(free[:, None], rates[:, None, :], part)
    pairs = (decays[:, None], first[:, None, :]), (decays[:, None], free)
    return of_forced, of_free, *(mean_exponential(*pair, part) for pair in pairs)
