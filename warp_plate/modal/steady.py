"""Steady responses of modes that damping couples, at many frequencies.

The lowest modes are those of their own reduced system, whose transfer matrix is a sum over its poles,

    (−ω² + iωC + Λ + iH)⁻¹ = Σ_p ψ_p χ_p / (iω − s_p),   (s² + sC + Λ + iH) ψ = 0

and all others are taken as uncoupled. The remainder is restored by iterative refinement with the full matrices
(G. H. Golub and C. F. Van Loan, Matrix Computations, 4th edition, section 3.5.3); frequencies at which it does not
converge are solved directly.
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
# Matrices with fewer nonzero entries than this part are kept as sparse ones.
SPARSE = 0.05
# Rigid motions count as slower than the fastest mode by this factor.
SLOWEST = 1e-9


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
        turning = poles[poles.imag > 0] / (2 * math.pi)
        return turning.imag, np.maximum(-turning.real, 0)

    def respond(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (n, modes, loads) amplitudes under forces (n, modes, loads) that turn at omega (n,) [rad/s]."""
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
        count, turn = len(vectors), omega[:, None]
        losses = turn * np.diag(self.damping) + np.diag(self.hysteretic)
        amplitudes = forces / (self.squares - turn**2 + 1j * losses)[:, :, None]
        shares = multiply_modes(inputs, forces[:, :count]) / (1j * turn - poles)[:, :, None]
        amplitudes[:, :count] = multiply_modes(vectors, shares)
        return np.asarray(amplitudes)

    def _forces(self, omega: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Return the forces that amplitudes (n, modes, loads) balance."""
        turn = 1j * omega[:, None, None]
        balanced = (self.squares[:, None] + turn**2) * amplitudes + turn * multiply_modes(self.damping, amplitudes)
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
