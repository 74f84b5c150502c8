"""Mean kinetic energies over a window as quadratic forms of the drives, exactly in time.

Actuator k presses with Re(Z_k w_k(t)) from t = 0 on. In an interval of time in which w_k is a sum of exponentials, see
:mod:`warp_plate.modal.loads`, a unit phasor moves the modes by a forced motion Σ_j A_kj exp(σ_kj t) and free motions
Σ_p ψ_p c_pk exp(s_p t), see :mod:`warp_plate.modal.poles`. With ⟨σ⟩ the mean of exp(σt) over the window and G the mass
matrix of a region, two complex rates v_k, v_l under tones have the mean product

    ⟨v_kᵀ G v_l⟩ = A_kᵀ G A_l ⟨iω_k + iω_l⟩ + A_kᵀ G Σ_p ψ_p c_pl ⟨iω_k + s_p⟩ + (k ↔ l)
                   + Σ_pq c_pk ψ_pᵀ G ψ_q c_ql ⟨s_p + s_q⟩

and likewise that of v̄_k and v_l. From both follow the means of Re v_k Re v_l and so on: with z = (Re Z, −Im Z) the
energy of the region is zᵀ matrix z. The products of all intervals that the window meets add up. A plate with a loss
factor has no free motion, and means over its periods.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy

from warp_plate.modal.loads import ExponentialLoads, has_exponential_loads, trial_forces, trial_frequencies
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.motion import Excitation, exponential_states, make_excitation
from warp_plate.modal.poles import Poles, as_sparse, multiply_modes
from warp_plate.modal.quadrature import quadrature_matrices
from warp_plate.modal.radiation import WeightedSound
from warp_plate.plate.signals import actuator_delays
from warp_plate.plate.weights import CoilRegion
from warp_plate.scene.grid import Window

Matrix: TypeAlias = np.ndarray | scipy.sparse.csr_array
# Means of exponentials whose exponent changes by less than SLOW over the window are computed by series.
SLOW = 1e-2
# Rows of matrices between all poles that are in memory at a time: the whole ones of 7000 poles take gigabytes.
ROWS = 1024


@dataclass(frozen=True)
class Means:
    """Regions of a plate and the time over which mean energies are computed."""

    plate: ModalPlate  # Modes
    regions: Sequence[np.ndarray]  # Mass matrices (modes, modes), see :meth:`ModalPlate.kinetic_matrix`
    # Window of a plate that starts from rest; None for the steady state, in which actuators of different frequencies do
    # not interfere
    window: Window | None
    velocity: bool = True  # False for ½ ∫ ρH u² dA of displacements [J s² per (N/m²)²]
    # Sounds of steady velocities, which follow the regions; those of displacements count as 0
    sounds: Sequence[WeightedSound] = ()
    coils: Sequence[CoilRegion] = ()  # Quantities of coils in a steady state, which follow the sounds likewise

    def momenta(self, frequency: np.ndarray, motion: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the product (designs, modes, M) of each matrix, those of the sounds last, and a steady motion."""
        yield from (multiply_modes(region, motion) for region in self.regions)
        for sound in self.sounds:
            yield sound.multiply(frequency, motion) if self.velocity else np.zeros_like(motion)

    def coil_rows(self, frequency: np.ndarray, amplitudes: np.ndarray) -> list[np.ndarray]:
        """Return the numbers (designs, M) of each quantity of a coil, see :meth:`Coils.rows`."""
        if not self.coils:
            return []
        assert self.plate.coils is not None
        return [row * self.velocity for row in self.plate.coils.rows(frequency, amplitudes, self.coils)]


def gram_matrices(
    means: Means, forces: np.ndarray, frequency: np.ndarray, delay: np.ndarray | None = None
) -> np.ndarray:
    """Return (designs, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²].

    The actuators have modal forces (designs or 1, modes, M) of unit pressures, frequencies (designs, M) [Hz] and, under
    bursts, starts (designs, M) [s] (default: the scene's).
    """
    plate, window, regions = means.plate, means.window, means.regions
    if window is None:
        rate = 2j * math.pi * frequency[:, None, :] if means.velocity else 1
        amplitudes = plate.respond_to_drives(frequency, forces)
        forced = amplitudes * rate
        same = frequency[:, :, None] == frequency[:, None, :]
        mixed = [(forced.conj().mT @ momenta) * same for momenta in means.momenta(frequency, forced)]
        rows = means.coil_rows(frequency, amplitudes)
        mixed += [4 * row.conj()[:, :, None] * row[:, None, :] * same for row in rows]
        return np.stack([real_form(np.zeros_like(product), product) for product in mixed], axis=1)
    if plate.scene.drive.burst is None and has_exponential_loads(plate.scene.drive):
        shared = ToneMatrices(means, trials=(forces, frequency))
        forms = free_forms(shared._lasting_poles, regions, window)
        return shared.motion(frequency, forces).matrices(shared.regions, window, forms)
    delay = actuator_delays(plate.scene)[None] if delay is None else delay
    designs = max(len(forces), len(frequency), len(delay))
    rows = [np.broadcast_to(array, (designs, *array.shape[1:])) for array in (forces, frequency, delay)]
    matrices = []
    for force, tones, starts in zip(*rows, strict=True):
        excitation = make_excitation(plate, window.end, force, tones, starts, moving=False)
        matrices.append(_excitation_matrices(excitation, regions, window, means.velocity))
    return np.stack(matrices)


def _excitation_matrices(
    excitation: Excitation, regions: Sequence[np.ndarray], window: Window, velocity: bool
) -> np.ndarray:
    """Return (regions, 2M, 2M) matrices of one design."""
    poles, gains = excitation.poles, excitation.gains
    loads = [load for load in excitation.loads if isinstance(load, ExponentialLoads)]
    if not loads:
        one = np.eye(gains.shape[1])
        return quadrature_matrices(excitation, np.concatenate([one, -1j * one]), regions, window, velocity)
    total, sparse_regions = 0.0, [as_sparse(region) for region in regions]
    for load, forced, free in exponential_states(poles, loads):
        if load.end <= window.start:
            continue
        part = Window(start=max(window.start - load.start, 0.0), end=min(load.end, window.end) - load.start)
        if velocity:
            free, forced = free * poles.values[:, None], forced * load.rates
        lasting = lasting_poles(
            poles, gains[None], free[None], forced[None], load.rates[None], part, window.end, velocity
        )
        amplitudes = poles.superpose(gains[:, :, None] * forced).reshape(1, len(poles.vectors), -1)
        motion = ExponentialMotion(
            amplitudes, load.rates.reshape(1, -1), poles.part(lasting), (gains * free)[None, lasting]
        )
        matrices = motion.matrices(sparse_regions, part, free_forms(motion.poles, regions, part))[0]
        total = total + (part.end - part.start) / (window.end - window.start) * matrices
    return np.asarray(total)


class ToneMatrices:
    """Gram matrices of the regions of a plate under tones that start from rest, with shared work for all designs.

    What depends on free motions alone is computed once, with those that last into the window wherever actuators are: so
    no design depends on its neighbours. Free motions are judged by ``trials``, modal forces (designs or 1, modes, M)
    and frequencies (designs, M), which are by default those of the scene and of its search.
    """

    def __init__(self, means: Means, trials: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        assert means.window is not None
        self.window, self.poles, self._velocity = means.window, means.plate.poles(means.window.end), means.velocity
        self.regions: list[Matrix] = [as_sparse(region) for region in means.regions]
        self._dense, plate = means.regions, means.plate
        self._trials = trials or (trial_forces(plate)[None], trial_frequencies(plate.scene)[:, None])

    def matrices(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (plates, regions, 2M, 2M) matrices for frequencies (plates, M) [Hz] and modal forces of unit pressures
        (plates or 1, modes, M)."""
        matrices = self.motion(frequency, forces).matrices(self.regions, self.window, self._stored_forms)
        return np.broadcast_to(matrices, (max(len(frequency), len(forces)), *matrices.shape[1:]))

    def motion(self, frequency: np.ndarray, forces: np.ndarray) -> ExponentialMotion:
        """Return the motion under unit phasors, of one design if all are the same."""
        rates, states = self._states(frequency)
        gains, poles = self.poles.gains(forces), self._lasting_poles
        forced, free = self.poles.forced(states, forces, gains), -(gains * states)[:, self.lasting]
        if self._velocity:
            forced, free = forced * rates[:, None, :], free * poles.values[:, None]
        return ExponentialMotion(forced, rates, poles, free)

    @cached_property
    def _stored_forms(self) -> list[tuple[np.ndarray, list[list[Matrix]]]]:
        return list(free_forms(self._lasting_poles, self._dense, self.window))

    @cached_property
    def _lasting_poles(self) -> Poles:
        return self.poles.part(self.lasting)

    @cached_property
    def lasting(self) -> np.ndarray:
        """Indices of the poles whose free motions matter in the window."""
        forces, frequency = self._trials
        rates, forced = self._states(frequency)
        free, end = -forced, self.window.end
        if self._velocity:
            forced, free = forced * rates[:, None, :], free * self.poles.values[:, None]
        gains, terms = self.poles.gains(forces), (forced[..., None], rates[..., None])
        return lasting_poles(self.poles, gains, free, *terms, self.window, end, self._velocity)

    def _states(self, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return exponents (designs, M) and states 1/(σ − s) (designs, poles, M), of one tone or design if all are."""
        if (frequency == frequency[:, :1]).all():  # means of one tone serve all actuators, and all designs
            frequency = frequency[:, :1] if (frequency != frequency[0]).any() else frequency[:1, :1]
        rates = self.poles.shift_rates(2j * math.pi * frequency, self.window.end)
        return rates, 1 / (rates[:, None, :] - self.poles.values[:, None])


@dataclass(frozen=True)
class ExponentialMotion:
    """Rates or displacements of the modes under unit phasors, Σ_j A_j exp(σ_j t) + Σ_p ψ_p c_p exp(s_p t)."""

    forced: np.ndarray  # (designs, modes, M · terms) amplitudes A
    rates: np.ndarray  # (designs or 1, M · terms or 1) exponents σ [1/s]
    poles: Poles  # Poles whose free motions matter
    free: np.ndarray  # (designs, poles, M) amplitudes c

    def matrices(
        self,
        regions: Sequence[Matrix],
        window: Window,
        forms: Iterable[tuple[np.ndarray, list[list[Matrix]]]],
    ) -> np.ndarray:
        """Return (designs, regions, 2M, 2M) matrices of mean energies; ``forms`` by :func:`free_forms`."""
        alone = np.zeros((len(regions), 2, len(self.free), *2 * self.free.shape[2:]), dtype=complex)
        left = self.free, self.free.conj()
        for rows, of_regions in forms:
            for total, of_sides in zip(alone, of_regions, strict=True):
                for side, form in enumerate(of_sides):
                    total[side] += left[side][:, rows].mT @ multiply_modes(form, self.free)
        sides = self.rates, self.rates.conj()
        of_forced = [mean_exponential(side[:, :, None], self.rates[:, None, :], window) for side in sides]
        across = [mean_exponential(side[:, None, :], self.poles.values[:, None], window) for side in sides]
        matrices = []
        for region, (plain, mixed) in zip(regions, alone, strict=True):
            inertia = multiply_modes(region, self.forced)
            projected = self.poles.project(inertia), self.poles.project(inertia, conjugate=True).conj()
            crossed = [
                self._by_actuator((inner * mean).mT) @ self.free for inner, mean in zip(projected, across, strict=True)
            ]
            both = [
                self._by_actuator(self._by_actuator((first.mT @ inertia) * mean).mT).mT
                for first, mean in zip((self.forced, self.forced.conj()), of_forced, strict=True)
            ]
            plain = both[0] + crossed[0] + crossed[0].mT + plain
            mixed = both[1] + crossed[1] + crossed[1].conj().mT + mixed
            matrices.append(real_form(plain, mixed))
        return np.stack(matrices, axis=1)

    def _by_actuator(self, rows: np.ndarray) -> np.ndarray:
        """Return (designs, M, columns) sums of rows over the terms of each actuator."""
        designs, count, columns = rows.shape
        actuators = self.free.shape[2]
        if count == actuators:
            return rows
        return np.asarray(rows.reshape(designs, actuators, count // actuators, columns).sum(axis=2))


def free_forms(
    poles: Poles, regions: Sequence[np.ndarray], window: Window
) -> Iterator[tuple[np.ndarray, list[list[Matrix]]]]:
    """Yield indices (rows,) of poles and, for each region G, the rows of ψᵀGψ and of ψ̄ᵀGψ times the means of the free
    motions' products, for at most ROWS rows at a time."""
    motions, count = [poles.observe(region) for region in regions], poles.values.size
    for rows in np.split(np.arange(count), range(ROWS, count, ROWS)):
        part = poles if rows.size == count else poles.part(rows)
        sides = part.values[:, None], part.values[:, None].conj()
        means = [mean_exponential(side, poles.values, window) for side in sides]
        products = [[part.project(motion, conjugate) for conjugate in (False, True)] for motion in motions]
        yield rows, [[as_sparse(side * mean) for side, mean in zip(both, means, strict=True)] for both in products]


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
    """Return the indices of the poles whose free motion matters in a window, for relative errors of ``negligible``.

    Free motion that is left out has energy of its own, and cross energy with the forced motion as far as both stay in
    phase over the window. Residues of nearly coincident poles almost cancel; the remainder is bounded by the time.
    Shapes: inputs (..., designs or 1, poles, M), free motion at t = 0 (designs, poles, M or 1), forced motion (designs,
    poles, M or 1, terms), exponents of the load (designs, M or 1, terms) [1/s].
    """
    norm, residue = poles.norms
    speed = np.abs(poles.values) if velocity else np.ones(norm.shape)
    bound = 1.0 if velocity else 1 / np.maximum(np.abs(poles.values.real), 1 / end)
    cancelled = np.minimum(1, bound / np.maximum(residue * speed, np.finfo(float).tiny))[:, None]
    left = np.abs(free) * np.exp(poles.values.real * window.start)[:, None]
    size = np.abs(gains) * norm[:, None]
    largest = np.minimum(left + np.abs(forced).sum(axis=-1), end * speed[:, None])
    total = ((size * cancelled * largest) ** 2).sum(axis=-2, keepdims=True)
    length, columns = Window(start=0.0, end=window.end - window.start), rates.reshape(len(rates), 1, -1)
    decays = poles.values[:, None]
    step = np.maximum(*(np.abs(mean_exponential(decays, column, length)) for column in (columns, columns.conj())))
    weight = poles.negligible + step.max(axis=-1, keepdims=True) ** 2
    shares = weight * (size * left) ** 2 / np.where(total > 0, total, 1)
    shares = np.moveaxis(shares, -2, 0).reshape(poles.values.size, -1)
    order = np.argsort(shares.max(axis=1))
    return np.sort(order[(np.cumsum(shares[order], axis=0) > poles.negligible**2).any(axis=1)])


def mean_exponential(first: np.ndarray, second: np.ndarray, window: Window) -> np.ndarray:
    """Return the means of exp(σt), σ = first + second [1/s], over the window, broadcast: (exp(σ end) − exp(σ start)) /
    x, x = σ(end − start), or exp(σ start) Σ xⁿ/(n + 1)!."""
    x = (first + second) * (window.end - window.start)
    early, late = (_exponential(first, second, time) for time in (window.start, window.end))
    slow = np.abs(x) < SLOW
    mean = (late - early) / np.where(slow, 1, x)
    if slow.any():
        x = x[slow]
        mean[slow] = early[slow] * (1 + x / 2 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5 * (1 + x / 6)))))
    return np.asarray(mean)


def mean_exponential_with_time(first: np.ndarray, second: np.ndarray, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return the means ⟨exp(σt)⟩ and ⟨t exp(σt)⟩ [s] over the window; see :func:`mean_exponential`.

    The latter is start ⟨exp(σt)⟩ + (end − start) s, s = (exp(σ end) − ⟨exp(σt)⟩) / x or exp(σ start) Σ xⁿ/(n! (n + 2)).
    """
    length, mean = window.end - window.start, mean_exponential(first, second, window)
    x = (first + second) * length
    slow = np.abs(x) < SLOW
    share = (_exponential(first, second, window.end) - mean) / np.where(slow, 1, x)
    if slow.any():
        x, early = x[slow], _exponential(first, second, window.start)[slow]
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
