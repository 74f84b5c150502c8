"""Steady responses of modes that damping couples, and frequencies at which to compute responses.

The lowest modes are those of their own reduced system, whose transfer matrix is a sum over its poles,

    (−ω² + iωC + Λ + iH)⁻¹ = Σ_p ψ_p χ_p / (iω − s_p),   (s² + sC + Λ + iH) ψ = 0

and all others are taken as uncoupled. The remainder is restored by iterative refinement with the full matrices
(G. H. Golub and C. F. Van Loan, Matrix Computations, 4th edition, section 3.5.3); frequencies at which it does not
converge are solved directly.

Near a resonance of frequency f₀ and half-width δ the response is proportional to 1/(x − i), x = (f − f₀)/δ, a circle in
the complex plane. Frequencies f₀ + δ tan θ with evenly spaced θ lie evenly on it, and the response at one of them is
within 1 − cos(step/2) = 0.4 % of the peak, whatever δ. Beyond them x doubles from one to the next up to the spacing of
a plain grid, so the number of frequencies of a resonance depends only on the logarithm of its sharpness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

# Modes that are coupled beforehand: those up to REACH times the highest frequency, within these limits.
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
class CoupledModes:
    """Modes that damping couples.

    Attributes:
        squares: (modes,) ω² of the undamped modes, rising [1/s²].
        damping: (modes, modes) C [1/s].
        hysteretic: (modes, modes) H [1/s²].
        highest: Highest frequency of the responses [Hz].
        fewest: Number of modes, from the lowest, that are coupled beforehand at least.
    """

    squares: np.ndarray
    damping: np.ndarray
    hysteretic: np.ndarray
    highest: float
    fewest: int = FEWEST

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
            residual = forces[left] - self._forces(omega[left], amplitudes[left])
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

    def _forces(self, omega: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
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
    """Return all poles (2 modes,), their motions (modes, 2 modes) and inputs of modes that damping couples.

    Args:
        stiffness: (modes, modes) Λ + iH [1/s²].
        damping: (modes, modes) C [1/s].
        unit: (modes,) sizes of the modes' frequencies, above zero [rad/s].
    """
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
    """Return rising frequencies [Hz] from ``low`` to ``high`` that follow every resonance between them.

    Args:
        centres: (resonances,) [Hz], 0 for rigid motions.
        widths: (resonances,) half-widths [Hz], 0 without damping.
    """
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
    """Drop frequencies, but for the last, that are too close to the one before.

    Too close is measured by the distance from the nearest pole and by the plain grid's relative ``spacing``.
    """
    near = 0.5 * spacing * frequencies
    for centre, width in zip(centres, widths, strict=True):
        near = np.minimum(near, CLOSE * np.hypot(frequencies - centre, width))
    selected = [0]
    for index in range(1, len(frequencies) - 1):
        if frequencies[index] - frequencies[selected[-1]] > near[index]:
            selected.append(index)
    return frequencies[[*selected, len(frequencies) - 1]]
