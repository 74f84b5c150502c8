"""Poles of a plate: free motions, and the response to loads that are switched on.

The transfer matrix of viscously damped modes is a sum over the poles s of free motions ψ exp(st),

    (σ² + σC + Λ)⁻¹ = Σ_p ψ_p χ_p / (σ − s_p),     (s² + sC + Λ) ψ = 0,

so that a load f exp(σt) switched on at t = 0 at a plate at rest moves it by

    q(t) = Σ_p ψ_p (χ_p f) (exp(σt) − exp(s_p t)) / (σ − s_p).

Proportional damping leaves two poles to each mode, s = −γ ± √(γ² − ω²), and χ = ψᵀ with ψᵀ (2s + C) ψ = 1. Other
damping takes the eigenvectors of the reduced system [q, q̇], and the rows χ of their inverse (F. Tisseur and
K. Meerbergen, SIAM Rev. 43, 2001, pp. 235-286).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.modal.steady import coupled_poles, multiply_modes

# Poles of one mode, and poles and exponents of a load, are kept apart by this part of one over the longest time: where
# they meet, exponentials cancel, and the error is about as large as this.
APART = 1e-5
# Modes that damping couples; that of higher ones is taken as proportional.
COUPLED = 700


@dataclass(frozen=True)
class Poles:
    """Poles and their free motions.

    Attributes:
        values: (poles,) s [1/s].
        vectors: (modes, poles) free motions ψ.
        inputs: (poles, modes) χ, by which forces excite them.
        modes: (poles,) index of the only mode of each free motion; None if damping couples modes.
    """

    values: np.ndarray
    vectors: np.ndarray
    inputs: np.ndarray
    modes: np.ndarray | None

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
        return Poles(self.values[indices], self.vectors[:, indices], self.inputs[indices], modes)

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
        """Return the steady motion (..., modes, loads) Σ_p ψ_p χ_p f / (σ − s_p) of all poles.

        Args:
            states: (..., poles, loads or 1) 1 / (σ − s).
            forces: (..., modes, loads) modal forces f.
            gains: (..., poles, loads) χ f.
        """
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
        """Return the poles, with those that meet exponents ``rates`` [1/s] of a load shifted by the same small amount.

        An undamped mode that is driven at its natural frequency grows with time, as the difference of two exponentials
        that are nearly the same.
        """
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
    """Return the poles of viscously damped modes, for times up to ``longest`` [s].

    Args:
        omega: (modes,) angular frequencies of the undamped modes [rad/s], rising.
        damping: (modes, modes) C [1/s].
        proportional: True if damping does not couple the modes.
        longest: Longest time [s].
    """
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
