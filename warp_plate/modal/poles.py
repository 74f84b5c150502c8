"""Poles of a plate's modes: free motions, responses from rest and in the steady state, and resonances.

The transfer matrix of damped modes is a sum over the poles s of free motions ψ exp(st),

    (σ² + σC + Λ + iH)⁻¹ = Σ_p ψ_p χ_p / (σ − s_p),     (s² + sC + Λ + iH) ψ = 0,

so that, for H = 0, a load f exp(σt) switched on at t = 0 at a plate at rest moves it by

    q(t) = Σ_p ψ_p (χ_p f) (exp(σt) − exp(s_p t)) / (σ − s_p).

Proportional damping leaves two poles to each mode, s = −γ ± √(γ² − ω²), and χ = ψᵀ with ψᵀ (2s + C) ψ = 1. Other
damping takes the eigenvectors of the reduced system [q, q̇], and the rows χ of their inverse (F. Tisseur and
K. Meerbergen, SIAM Rev. 43, 2001, pp. 235-286), of the lowest modes; all others are taken as uncoupled. In steady
responses the remainder is restored by iterative refinement with the full matrices (G. H. Golub and C. F. Van Loan,
Matrix Computations, 4th edition, section 3.5.3); frequencies at which it does not converge are solved directly.

Near a resonance of frequency f₀ and half-width δ the response is proportional to 1/(x − i), x = (f − f₀)/δ, a circle in
the complex plane. Frequencies f₀ + δ tan θ with evenly spaced θ lie evenly on it, and the response at one of them is
within 1 − cos(step/2) = 0.4 % of the peak, whatever δ. Beyond them x doubles from one to the next up to the spacing of
a plain grid, so the number of frequencies of a resonance depends only on the logarithm of its sharpness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

# Poles of one mode, and poles and exponents of a load, are kept apart by this part of one over the longest time: where
# they meet, exponentials cancel, and the error is about as large as this.
APART = 1e-5
# Part of the energies that free motions which are left out may change.
NEGLIGIBLE = 1e-6
# Modes that damping couples in responses from rest; that of higher ones is taken as proportional.
COUPLED = 700
# Modes that damping couples in steady responses, before refinement: those up to REACH times the highest frequency,
# within these limits.
REACH, FEWEST, MOST = 1.5, 80, 500
# Relative residual of the forces, and largest number of refinements.
RESIDUAL, REFINEMENTS = 1e-8, 12
# Matrices with fewer nonzero entries than this part are stored as sparse ones.
SPARSE = 0.05
# Rigid motions count as slower than the fastest mode by this factor.
SLOWEST = 1e-9
# Frequencies of the plain grid, evenly spaced on a logarithmic axis.
PLAIN = 400
# (points,) x on the circle, every 10 degrees.
CIRCLE = np.tan(np.radians(np.arange(-80, 81, 10)))
# Frequencies closer than this part of their distance from the nearest pole are merged, unless they are farther apart
# than half the spacing of the plain grid, which overdamped modes must not thin out.
CLOSE = 0.05
# Half-widths relative to the frequency: below SHARPEST a resonance counts as undamped, and is sampled as one of the
# half-width UNDAMPED, on either side of its peak.
SHARPEST, UNDAMPED = 1e-12, 5e-6


@dataclass(frozen=True)
class Poles:
    """Poles and their free motions."""

    values: np.ndarray  # (poles,) s [1/s]
    vectors: np.ndarray  # (modes, poles) free motions ψ
    inputs: np.ndarray  # (poles, modes) χ, by which forces excite them
    modes: np.ndarray | None  # (poles,) index of the only mode of each free motion; None if damping couples modes
    negligible: float = NEGLIGIBLE  # Free motions that change energies by less than about this part are left out

    @property
    def sizes(self) -> np.ndarray:
        """(poles,) the only number of each free motion, if damping does not couple modes."""
        assert self.modes is not None
        return self.vectors[self.modes, np.arange(self.values.size)]

    @property
    def norms(self) -> tuple[np.ndarray, np.ndarray]:
        """(poles,) ‖ψ‖, and ‖ψ‖ ‖χ‖, the response of each pole to a unit force."""
        if self.modes is not None:
            return np.abs(self.sizes), np.abs(self.sizes) ** 2
        sizes = np.linalg.norm(self.vectors, axis=0)
        return sizes, sizes * np.linalg.norm(self.inputs, axis=1)

    def part(self, indices: np.ndarray) -> Poles:
        """Return some of the poles."""
        modes = None if self.modes is None else self.modes[indices]
        values, vectors, inputs = self.values[indices], self.vectors[:, indices], self.inputs[indices]
        return replace(self, values=values, vectors=vectors, inputs=inputs, modes=modes)

    def restrict(self, modes: np.ndarray) -> tuple[Poles, np.ndarray]:
        """Return the motion of some modes alone, and the indices of the poles that move them."""
        if self.modes is None:
            return replace(self, vectors=self.vectors[modes]), np.arange(self.values.size)
        indices = np.flatnonzero(np.isin(self.modes, modes))
        part = self.part(indices)
        return replace(part, vectors=part.vectors[modes], modes=np.searchsorted(modes, self.modes[indices])), indices

    def observe(self, matrix: np.ndarray) -> np.ndarray:
        """Return the product of a real matrix (rows, modes) and the free motions."""
        if self.modes is None:
            return multiply_modes(matrix, self.vectors)
        return matrix[:, self.modes] * self.sizes

    def project(self, columns: np.ndarray, conjugate: bool = False) -> np.ndarray:
        """Return ψᵀ columns (..., poles, columns), or ψ̄ᵀ columns, of columns (..., modes, columns)."""
        if self.modes is None:
            return multiply_modes((self.vectors.conj() if conjugate else self.vectors).T, columns)
        sizes = self.sizes.conj() if conjugate else self.sizes
        return np.asarray(columns[..., self.modes, :] * sizes[:, None])

    def gains(self, forces: np.ndarray) -> np.ndarray:
        """Return χ forces (..., poles, loads) of modal forces (..., modes, loads)."""
        return multiply_modes(self.inputs, forces) if self.modes is None else self.project(forces)

    def forced(self, states: np.ndarray, forces: np.ndarray, gains: np.ndarray) -> np.ndarray:
        """Return the steady motion (..., modes, loads) Σ_p ψ_p χ_p f / (σ − s_p) of all poles, from 1 / (σ − s)
        (..., poles, loads or 1), f (..., modes, loads) and χ f (..., poles, loads)."""
        if self.modes is None:
            return multiply_modes(self.vectors, gains * states)
        both = self.sizes[:, None] ** 2 * states
        return np.asarray(forces * (both[..., : len(self.vectors), :] + both[..., len(self.vectors) :, :]))

    def superpose(self, states: np.ndarray) -> np.ndarray:
        """Return the motion Σ_p ψ_p states (modes, ...) of states (poles, ...) of all poles."""
        flat, count = states.reshape(len(states), -1), len(self.vectors)
        if self.modes is None:
            motion = self.vectors @ flat
        else:
            scaled = self.sizes[:, None] * flat
            motion = scaled[:count] + scaled[count:]
        return np.asarray(motion.reshape(-1, *states.shape[1:]))

    def apart_from(self, rates: np.ndarray, longest: float) -> Poles:
        """Return the poles, with those that meet exponents ``rates`` [1/s] of a load shifted by the same small
        amount: an undamped mode at resonance grows with time, as the difference of two exponentials that are nearly
        the same."""
        least, values = APART / longest, self.values.copy()
        for rate in np.unique(rates):
            values[np.abs(values - rate) < least] -= least
        return replace(self, values=values)

    def shift_rates(self, rates: np.ndarray, longest: float) -> np.ndarray:
        """Return exponents (designs, loads) of loads, with those that meet a pole shifted; see :meth:`apart_from`."""
        least = APART / longest
        undamped = self.values[np.abs(self.values.real) < least]
        distance = np.abs(rates[..., None] - undamped).min(axis=-1, initial=math.inf)
        return np.asarray(rates + np.where(distance < least, least, 0))


def make_poles(omega: np.ndarray, damping: np.ndarray, proportional: bool, longest: float) -> Poles:
    """Return the poles of modes of rising frequencies [rad/s] and viscous damping C (modes, modes) [1/s], which
    does not couple them if ``proportional``, for times up to ``longest`` [s]."""
    least = APART / longest
    square, loss = np.maximum(omega, least) ** 2, np.diag(damping) / 2
    coupled = 0 if proportional else min(COUPLED, square.size)
    split = np.sqrt(loss**2 - square + 0j)
    split = np.where(np.abs(split) < least, least, split)
    fast = -loss - split
    slow = np.where(np.abs(fast) > 0, square / np.where(fast == 0, 1, fast), 0)  # −γ + μ would cancel
    values = np.concatenate([slow[coupled:], fast[coupled:]])
    vectors = np.zeros((square.size, values.size), dtype=complex)
    rest = np.arange(coupled, square.size)
    for column, sign in enumerate((1, -1)):
        vectors[rest, column * rest.size + rest - coupled] = 1 / np.sqrt(sign * 2 * split[coupled:])
    inputs = vectors.T
    if not coupled:
        return Poles(values, vectors, inputs, np.tile(rest, 2))
    lowest = square[:coupled]
    more, shapes, gains = coupled_poles(np.diag(lowest), damping[:coupled, :coupled], np.sqrt(lowest))
    vectors = np.hstack([vectors, np.vstack([shapes, np.zeros((rest.size, more.size))])])
    inputs = np.vstack([inputs, np.hstack([gains, np.zeros((more.size, rest.size))])])
    return Poles(np.concatenate([values, more]), vectors, inputs, None)


@dataclass(frozen=True)
class CoupledModes:
    """Modes that damping couples."""

    squares: np.ndarray  # (modes,) ω² of the undamped modes, rising [1/s²]
    damping: np.ndarray  # (modes, modes) C [1/s]
    hysteretic: np.ndarray  # (modes, modes) H [1/s²]
    highest: float  # Highest frequency of the responses [Hz]
    fewest: int = FEWEST  # Number of modes, from the lowest, that are coupled beforehand at least

    @property
    def resonances(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies and half-widths [Hz] of the resonances of the lowest modes."""
        poles = self._poles[0]
        oscillating = poles[poles.imag > 0] / (2 * math.pi)
        return oscillating.imag, np.maximum(-oscillating.real, 0)

    def respond(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (n, modes, loads) amplitudes under forces (n, modes, loads) that vary as exp(iωt), ω (n,) [rad/s]."""
        amplitudes, left = self.approximate(omega, forces), np.arange(len(omega))
        limit = RESIDUAL * np.linalg.norm(forces, axis=1)
        for _ in range(REFINEMENTS):
            residual = forces[left] - self.balanced(omega[left], amplitudes[left])
            converged = (np.linalg.norm(residual, axis=1) <= limit[left]).all(axis=1)
            left, residual = left[~converged], residual[~converged]
            if not left.size:
                return amplitudes
            amplitudes[left] += self.approximate(omega[left], residual)
        for row in left:
            matrix = 1j * (omega[row] * self.damping + self.hysteretic)
            matrix[np.diag_indices_from(matrix)] += self.squares - omega[row] ** 2
            amplitudes[row] = scipy.linalg.solve(matrix, forces[row], assume_a="sym")
        return amplitudes

    def approximate(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the amplitudes of :meth:`respond` without the coupling of the highest modes."""
        poles, vectors, inputs = self._poles
        count, column = len(vectors), omega[:, None]
        losses = column * np.diag(self.damping) + np.diag(self.hysteretic)
        amplitudes = forces / (self.squares - column**2 + 1j * losses)[:, :, None]
        shares = multiply_modes(inputs, forces[:, :count]) / (1j * column - poles)[:, :, None]
        amplitudes[:, :count] = multiply_modes(vectors, shares)
        return np.asarray(amplitudes)

    def balanced(self, omega: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Return the forces that amplitudes (n, modes, loads) balance."""
        rate = 1j * omega[:, None, None]
        balanced = (self.squares[:, None] + rate**2) * amplitudes + rate * multiply_modes(self.damping, amplitudes)
        return balanced + 1j * multiply_modes(self.hysteretic, amplitudes) if self.hysteretic.any() else balanced

    @cached_property
    def _poles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poles, motions and inputs of the lowest modes, see :func:`coupled_poles`."""
        count = int(np.clip((self.squares <= (2 * math.pi * REACH * self.highest) ** 2).sum(), self.fewest, MOST))
        square = self.squares[:count]
        unit = np.sqrt(np.maximum(square, SLOWEST**2 * square[-1]))
        hysteretic = self.hysteretic[:count, :count]
        stiffness = np.diag(square) + (1j * hysteretic if hysteretic.any() else 0)
        return coupled_poles(stiffness, self.damping[:count, :count], unit)


def coupled_poles(
    stiffness: np.ndarray, damping: np.ndarray, unit: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return all poles (2 modes,), their motions (modes, 2 modes) and inputs of modes that damping couples, from
    Λ + iH [1/s²], C [1/s] and the sizes of the modes' frequencies (modes,), above zero [rad/s]."""
    count = unit.size
    # Unknowns ω q and q̇, which are of one size.
    system = np.block([[np.zeros_like(stiffness), np.diag(unit)], [-stiffness / unit, -damping]])
    values, vectors = scipy.linalg.eig(system)
    # Motions of poles that coincide, as on a square plate, are not orthogonal in pairs; the inverse is right for them.
    inputs = np.linalg.inv(vectors)[:, count:]
    return values, vectors[:count] / unit[:, None], inputs


def as_sparse(matrix: np.ndarray) -> np.ndarray | scipy.sparse.csr_array:
    """Return a matrix as a sparse one if few of its entries are not zero, as in that of the whole plate."""
    return scipy.sparse.csr_array(matrix) if np.count_nonzero(matrix) < SPARSE * matrix.size else matrix


def multiply_modes(matrix: np.ndarray | scipy.sparse.csr_array, columns: np.ndarray) -> np.ndarray:
    """Return a matrix (rows, modes) times complex columns (..., modes, columns), a real one in real arithmetic."""
    first = np.moveaxis(columns, -2, 0)
    flat = np.ascontiguousarray(first.reshape(len(first), math.prod(first.shape[1:])), dtype=complex)
    real = not np.iscomplexobj(matrix)
    product = (matrix @ flat.view(float)).view(complex) if real else matrix @ flat
    return np.moveaxis(product.reshape(matrix.shape[0], *first.shape[1:]), 0, -2)


def adaptive_frequencies(centres: np.ndarray, widths: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return rising frequencies [Hz] from ``low`` to ``high`` that follow every resonance between them, with centres
    (resonances,) [Hz], 0 for rigid motions, and half-widths (resonances,) [Hz], 0 without damping."""
    undamped = widths <= SHARPEST * centres
    widths = np.where(undamped, UNDAMPED * centres, widths)
    reach = CIRCLE[-1] * widths
    near = (centres > 0) & (centres + reach > low) & (centres - reach < high)
    centres, widths, undamped = centres[near], widths[near], undamped[near]
    plain = np.geomspace(low, high, PLAIN)
    groups = [plain]
    for centre, width in zip(centres, widths, strict=True):
        spacing = centre * (plain[1] / plain[0] - 1)
        doublings = max(0, math.ceil(math.log2(spacing / width / CIRCLE[-1])))
        skirt = CIRCLE[-1] * 2.0 ** np.arange(1, doublings + 1)
        groups.append(centre + width * np.concatenate([-skirt, CIRCLE, skirt]))
    frequencies = np.unique(np.concatenate(groups))
    frequencies = frequencies[(frequencies >= low) & (frequencies <= high)]
    frequencies = _thin_out(frequencies, plain[1] / plain[0] - 1, centres, widths)
    for centre, width in zip(centres[undamped], widths[undamped], strict=True):
        ends = (frequencies == low) | (frequencies == high)
        frequencies = frequencies[np.abs(frequencies - centre) > np.where(ends, SHARPEST * centre, width / 10)]
    return frequencies


def _thin_out(frequencies: np.ndarray, spacing: float, centres: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Drop frequencies, but for the last, that are too close to the one before, as measured by the distance from the
    nearest pole and by the plain grid's relative ``spacing``."""
    near = 0.5 * spacing * frequencies
    for centre, width in zip(centres, widths, strict=True):
        near = np.minimum(near, CLOSE * np.hypot(frequencies - centre, width))
    selected = [0]
    for index in range(1, len(frequencies) - 1):
        if frequencies[index] - frequencies[selected[-1]] > near[index]:
            selected.append(index)
    return frequencies[[*selected, len(frequencies) - 1]]
