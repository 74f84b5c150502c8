"""Mean kinetic energies over a window as quadratic forms of the drives, exactly in time.

Actuator k presses with Re(Z_k exp(iω_k t)) from t = 0 on. A unit phasor moves the modes by a forced motion A_k
exp(iω_k t) and free motions Σ_p ψ_p c_pk exp(s_p t), see :mod:`warp_plate.modal.poles`. With ⟨σ⟩ the mean of exp(σt)
over the window and G the mass matrix of a region, two complex rates v_k, v_l have the mean product

    ⟨v_kᵀ G v_l⟩ = A_kᵀ G A_l ⟨iω_k + iω_l⟩ + A_kᵀ G Σ_p ψ_p c_pl ⟨iω_k + s_p⟩ + (k ↔ l)
                   + Σ_pq c_pk ψ_pᵀ G ψ_q c_ql ⟨s_p + s_q⟩

and likewise that of v̄_k and v_l. From both follow the means of Re v_k Re v_l and so on: with z = (Re Z, −Im Z) the
energy of the region is zᵀ matrix z. A plate with a loss factor has no free motion, and means over its periods. Bursts
are exponentials between their corners, see :mod:`warp_plate.modal.loads`; the products of each interval that the window
meets add up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.modal.loads import ExponentialLoads, has_exponential_loads
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.motion import Excitation, make_excitation, with_moving_load
from warp_plate.modal.poles import Poles
from warp_plate.modal.quadrature import by_quadrature
from warp_plate.modal.steady import as_sparse, multiply_modes
from warp_plate.modal.transient import forced_states, next_state
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.scene.model import Window

# Free motions that change energies by less than about this part of them are left out.
NEGLIGIBLE = 1e-6
# Means of exponentials whose exponent changes by less than SLOW over the window are computed by series.
SLOW = 1e-2
# Rows of matrices between all poles that are in memory at a time: the whole ones of 7000 poles take gigabytes.
ROWS = 1024


def gram_matrices(
    plate: ModalPlate,
    regions: Sequence[np.ndarray],
    forces: np.ndarray,
    frequency: np.ndarray,
    window: Window | None,
    quantity: str = "velocity",
    delay: np.ndarray | None = None,
) -> np.ndarray:
    """Return (designs, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²].

    Args:
        plate: Modes.
        regions: Mass matrices (modes, modes) of the regions, see :meth:`ModalPlate.kinetic_matrix`.
        forces: (designs or 1, modes, M) modal forces of the actuators' unit pressures.
        frequency: (designs, M) frequencies of the actuators [Hz].
        window: Window of a plate that starts from rest; None for the steady state, in which actuators of different
            frequencies do not interfere.
        quantity: "velocity", or "displacement" for ½ ∫ ρH u² dA [J s² per (N/m²)²].
        delay: (designs, M) starts of the scene's bursts [s] (default: the scene's).
    """
    if window is None:
        rate = 2j * math.pi * frequency[:, None, :] if quantity == "velocity" else 1
        forced = plate.respond_each(frequency, forces) * rate
        same = frequency[:, :, None] == frequency[:, None, :]
        mixed = [(forced.conj().mT @ multiply_modes(region, forced)) * same for region in regions]
        return np.stack([real_form(np.zeros_like(product), product) for product in mixed], axis=1)
    if plate.scene.drive.burst is None and has_exponential_loads(plate.scene):
        motion = _tone_motion(plate, forces, frequency, quantity, window)
        return np.stack([real_form(*pair) for pair in motion.products(regions, window)], axis=1)
    delay = actuator_delays(plate.scene)[None] if delay is None else delay
    designs = max(len(forces), len(frequency), len(delay))
    rows = [np.broadcast_to(array, (designs, *array.shape[1:])) for array in (forces, frequency, delay)]
    excitations = (make_excitation(plate, window.end, *row) for row in zip(*rows, strict=True))
    return np.stack([_excitation_matrices(each, regions, window, quantity) for each in excitations])


def _tone_motion(
    plate: ModalPlate, forces: np.ndarray, frequency: np.ndarray, quantity: str, window: Window
) -> _Motion:
    """Return the motion under tones from t = 0 on."""
    if (frequency == frequency[:, :1]).all():
        frequency = frequency[:, :1]
    poles = plate.poles(window.end)
    drive, gains = poles.shift_rates(2j * math.pi * frequency, window.end), poles.gains(forces)
    states = 1 / (drive[:, None, :] - poles.values[:, None])
    forced, free, velocity = poles.forced(states, forces, gains), -states, quantity == "velocity"
    if velocity:
        forced, states, free = forced * drive[:, None, :], states * drive[:, None, :], free * poles.values[:, None]
    kept = lasting_poles(poles, gains, free, states[..., None], drive[..., None], window, window.end, velocity)
    return _Motion(forced, drive, poles.part(kept), gains[:, kept] * free[:, kept])


def energies(
    plate: ModalPlate, regions: Sequence[np.ndarray], drives: np.ndarray, quantity: str = "velocity"
) -> np.ndarray:
    """Return mean energies (drives, regions) [J] under phasors (drives, actuators), over the scene's window or steady.

    A moving load presses beside the actuators. See :func:`gram_matrices`.
    """
    scene, window = plate.scene, plate.scene.window
    if scene.effects.travelling is None:
        forces, frequency = plate.actuator_forces()[None], actuator_frequencies(scene)[None]
        matrices = gram_matrices(plate, regions, forces, frequency, None if scene.steady else window, quantity)[0]
    else:
        matrices = by_quadrature(make_excitation(plate, window.end), regions, window, quantity)
    return quadratic_forms(matrices, with_moving_load(plate, drives))


def _excitation_matrices(
    excitation: Excitation, regions: Sequence[np.ndarray], window: Window, quantity: str
) -> np.ndarray:
    """Return (regions, 2M, 2M) matrices of one design, by the intervals of its loads."""
    poles, gains = excitation.poles, excitation.gains
    state = np.zeros(gains.shape, dtype=complex)
    sums: list[np.ndarray] = [np.zeros((2, *2 * gains.shape[1:])) for _ in regions]
    for load in excitation.loads:
        if not isinstance(load, ExponentialLoads):
            return by_quadrature(replace(excitation, moving=()), regions, window, quantity)
        follow = forced_states(poles, load)
        if load.end > window.start:
            part = Window(start=max(window.start - load.start, 0.0), end=min(load.end, window.end) - load.start)
            free, forced, velocity = state - follow.sum(axis=2), follow, quantity == "velocity"
            if velocity:
                free, forced = free * poles.values[:, None], forced * load.rates
            kept = lasting_poles(
                poles, gains[None], free[None], forced[None], load.rates[None], part, window.end, velocity
            )
            forced = gains[:, :, None] * forced
            forced = (poles.vectors @ forced.reshape(len(gains), -1))[None]
            motion = _Motion(forced, load.rates.reshape(1, -1), poles.part(kept), (gains * free)[None, kept])
            share = (part.end - part.start) / (window.end - window.start)
            parts = motion.products(regions, part)
            sums = [total + share * np.concatenate(pair) for total, pair in zip(sums, parts, strict=True)]
        state = next_state(poles, load, state, follow)
    return np.stack([real_form(*pair) for pair in sums])


@dataclass(frozen=True)
class _Motion:
    """Rates of the modes under unit phasors."""

    forced: np.ndarray  # (designs, modes, M · terms) amplitudes A
    drive: np.ndarray  # (designs, M · terms) exponents iω [1/s]
    poles: Poles  # those that count
    free: np.ndarray  # (designs, poles, M) amplitudes c

    def products(self, regions: Sequence[np.ndarray], window: Window) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return (designs, M, M) means of v_kᵀ G v_l and of v̄_kᵀ G v_l for each region."""
        poles, turn = self.poles, self.drive[:, None, :]
        moved = [multiply_modes(as_sparse(region), self.forced) for region in regions]
        shapes, sides = [poles.observe(region) for region in regions], []
        for conjugate in (False, True):
            decay = (poles.values.conj() if conjugate else poles.values)[:, None]
            forced, free, rates = self.forced, self.free.mT, turn
            if conjugate:
                forced, free, rates = forced.conj(), free.conj(), rates.conj()
            of_forced, across = (mean_exponential(first, turn, window) for first in (rates.mT, decay))
            products = self._of_free(shapes, conjugate, np.ascontiguousarray(free), decay, window)
            for index, each in enumerate(moved):
                both = self._by_actuator(self._by_actuator((forced.mT @ each) * of_forced).mT).mT
                mixed = self._by_actuator((free @ (poles.project(each, conjugate) * across)).mT).mT
                products[index] += both + mixed + (mixed.conj() if conjugate else mixed).mT
            sides.append(products)
        return list(zip(*sides, strict=True))

    def _of_free(
        self, shapes: Sequence[np.ndarray], conjugate: bool, free: np.ndarray, decay: np.ndarray, window: Window
    ) -> list[np.ndarray]:
        """Return (designs, M, M) products of the free motions for each region, by rows of the matrices of all poles."""
        count = self.poles.values.size
        sums = [np.zeros((*free.shape[:2], self.free.shape[2]), dtype=complex) for _ in shapes]
        for rows in np.split(np.arange(count), range(ROWS, count, ROWS)):
            part, columns = self.poles.part(rows), free[..., rows].reshape(math.prod(free.shape[:2]), rows.size)
            means = mean_exponential(decay[rows], self.poles.values, window)
            for total, each in zip(sums, shapes, strict=True):
                inner = as_sparse(part.project(each, conjugate) * means)
                total += (columns @ inner).reshape(*free.shape[:2], count) @ self.free
        return sums

    def _by_actuator(self, rows: np.ndarray) -> np.ndarray:
        """Return (designs, M, columns) sums of rows over the terms of each actuator."""
        designs, _, columns = rows.shape
        return np.asarray(rows.reshape(designs, self.free.shape[2], -1, columns).sum(axis=2))


def lasting_poles(
    poles: Poles,
    gains: np.ndarray,
    free: np.ndarray,
    forced: np.ndarray,
    rates: np.ndarray,
    window: Window,
    end: float,
    velocity: bool,
) -> np.ndarray:
    """Return the indices of the poles whose free motion matters in a window, for relative errors of about NEGLIGIBLE.

    The motion left out has energy of its own, and cross energy with the forced motion as far as both stay in phase over
    the window. Two poles that nearly meet have large residues, of which all but a part bounded by time cancels.

    Args:
        poles: Poles.
        gains: (..., designs or 1, poles, M) inputs of the actuators.
        free: (designs, poles, M or 1) states z of the free motion at t = 0, or their rates sz.
        forced: (designs, poles, M or 1, terms) states that follow the load, or their rates.
        rates: (designs, M or 1, terms) exponents of the load [1/s].
        window: Window, counted from t = 0.
        end: End of the run [s].
        velocity: True for rates.
    """
    norm, residue = poles.norms
    speed = np.abs(poles.values) if velocity else np.ones(norm.shape)
    bound = 1.0 if velocity else 1 / np.maximum(np.abs(poles.values.real), 1 / end)
    cancelled = np.minimum(1, bound / np.maximum(residue * speed, np.finfo(float).tiny))[:, None]
    left = np.abs(free) * np.exp(poles.values.real * window.start)[:, None]
    size = np.abs(gains) * norm[:, None]
    moved = np.minimum(left + np.abs(forced).sum(axis=-1), end * speed[:, None])
    total = ((size * cancelled * moved) ** 2).sum(axis=-2, keepdims=True)
    length, turns = Window(start=0.0, end=window.end - window.start), rates.reshape(len(rates), 1, -1)
    decays = poles.values[:, None]
    step = np.maximum(*(np.abs(mean_exponential(decays, turn, length)) for turn in (turns, turns.conj())))
    weight = NEGLIGIBLE + step.max(axis=-1, keepdims=True) ** 2
    shares = weight * (size * left) ** 2 / np.where(total > 0, total, 1)
    shares = np.moveaxis(shares, -2, 0).reshape(poles.values.size, -1)
    order = np.argsort(shares.max(axis=1))
    return np.sort(order[(np.cumsum(shares[order], axis=0) > NEGLIGIBLE**2).any(axis=1)])


def mean_exponential(first: np.ndarray, second: np.ndarray, window: Window) -> np.ndarray:
    """Return the means ⟨exp(σt)⟩, σ = first + second [1/s], over the window, broadcast.

    With x = σ(end − start): (exp(σ end) − exp(σ start)) / x, or exp(σ start) Σ xⁿ/(n + 1)!.
    """
    turn = (first + second) * (window.end - window.start)
    early, late = (_exponential(first, second, time) for time in (window.start, window.end))
    slow = np.abs(turn) < SLOW
    mean = (late - early) / np.where(slow, 1, turn)
    if slow.any():
        x = turn[slow]
        mean[slow] = early[slow] * (1 + x / 2 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5 * (1 + x / 6)))))
    return np.asarray(mean)


def mean_exponential_with_time(first: np.ndarray, second: np.ndarray, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return the means ⟨exp(σt)⟩ and ⟨t exp(σt)⟩ [s] over the window; see :func:`mean_exponential`.

    The latter is start ⟨exp(σt)⟩ + (end − start) s, s = (exp(σ end) − ⟨exp(σt)⟩) / x or exp(σ start) Σ xⁿ/(n! (n + 2)).
    """
    length, mean = window.end - window.start, mean_exponential(first, second, window)
    turn = (first + second) * length
    slow = np.abs(turn) < SLOW
    share = (_exponential(first, second, window.end) - mean) / np.where(slow, 1, turn)
    if slow.any():
        x, early = turn[slow], _exponential(first, second, window.start)[slow]
        share[slow] = (
            early / 2 * (1 + 2 * x / 3 * (1 + 3 * x / 8 * (1 + 4 * x / 15 * (1 + 5 * x / 24 * (1 + 6 * x / 35)))))
        )
    return mean, window.start * mean + length * share


def _exponential(first: np.ndarray, second: np.ndarray, time: float) -> np.ndarray:
    """Return exp((first + second) time); the factors are fewer numbers than the sum."""
    return np.asarray(np.exp(first * time) * np.exp(second * time))


def real_form(plain: np.ndarray, mixed: np.ndarray) -> np.ndarray:
    """Return ½ of the means (..., 2M, 2M) of products of Re v and Im v, from means of v_k v_l and of v̄_k v_l."""
    real, imaginary = (mixed + plain).real / 4, (mixed - plain).real / 4
    cross = (mixed + plain).imag / 4
    rows = np.concatenate([real, cross], axis=-1), np.concatenate([cross.mT, imaginary], axis=-1)
    return np.concatenate(rows, axis=-2)
