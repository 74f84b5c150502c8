"""Poles of a plate: free motions, and the response to loads that are switched on.

The transfer matrix of viscously damped modes is a sum over the poles s of free motions ψ exp(st),

    (σ² + σC + Λ)⁻¹ = Σ_p ψ_p ψ_pᵀ / (σ − s_p),     (s² + sC + Λ) ψ = 0,     ψᵀ (2s + C) ψ = 1,

so that a load f exp(σt) switched on at t = 0 at a plate at rest moves it by

    q(t) = Σ_p ψ_p (ψ_pᵀ f) (exp(σt) − exp(s_p t)) / (σ − s_p).

Proportional damping leaves two poles to each mode, s = −γ ± √(γ² − ω²). Other damping takes the eigenvectors of the
reduced system [q, q̇] (F. Tisseur and K. Meerbergen, SIAM Rev. 43, 2001, pp. 235-286).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.modal.modes import ModalPlate

# Two poles of one mode are kept apart by this part of one over the longest time: where they meet, as at critical
# damping or of a rigid motion, exponentials cancel, and the error is about as large as this.
APART = 1e-5
# Modes that damping couples; that of higher ones is taken as proportional.
COUPLED = 250


@dataclass(frozen=True)
class Poles:
    """Poles and their free motions.

    Attributes:
        values: (poles,) s [1/s].
        vectors: (modes, poles) ψ [√s], normalised as above.
    """

    values: np.ndarray
    vectors: np.ndarray


def make_poles(plate: ModalPlate, longest: float) -> Poles:
    """Return the poles of a plate with viscous damping, for times up to ``longest`` [s]."""
    least = APART / longest
    square, loss = np.maximum(plate.angular_frequencies, least) ** 2, np.diag(plate.damping) / 2
    coupled = 0 if plate.proportional else min(COUPLED, square.size)
    split = np.sqrt(loss**2 - square + 0j)
    split = np.where(np.abs(split) < least, least, split)
    fast = -loss - split
    slow = np.where(np.abs(fast) > 0, square / np.where(fast == 0, 1, fast), 0)  # −γ + μ would cancel
    values = np.concatenate([slow[coupled:], fast[coupled:]])
    vectors = np.zeros((square.size, values.size), dtype=complex)
    rest = np.arange(coupled, square.size)
    for column, sign in enumerate((1, -1)):
        vectors[rest, column * rest.size + rest - coupled] = 1 / np.sqrt(sign * 2 * split[coupled:])
    if coupled:
        more, shapes = _coupled_poles(square[:coupled], plate.damping[:coupled, :coupled])
        values = np.concatenate([values, more])
        shapes = np.concatenate([shapes, np.zeros((rest.size, more.size))])
        vectors = np.concatenate([vectors, shapes], axis=1)
    return Poles(values, vectors)


def _coupled_poles(square: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all poles (2 modes,) and their vectors (modes, 2 modes) of modes that damping couples."""
    count, unit = square.size, np.sqrt(square)
    # Unknowns ω q and q̇, which are of one size.
    system = np.block([[np.zeros((count, count)), np.diag(unit)], [-np.diag(unit), -damping]])
    values, vectors = scipy.linalg.eig(system)
    shapes = vectors[:count] / unit[:, None]
    norms = 2 * values * (shapes**2).sum(axis=0) + np.einsum("rp,rs,sp->p", shapes, damping, shapes, optimize=True)
    return values, shapes / np.sqrt(norms)
