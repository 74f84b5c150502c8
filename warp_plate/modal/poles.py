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
from weakref import WeakKeyDictionary

import numpy as np

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.steady import coupled_poles, multiply_modes

# Two poles of one mode are kept apart by this part of one over the longest time: where they meet, as at critical
# damping or of a rigid motion, exponentials cancel, and the error is about as large as this.
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

    def part(self, indices: np.ndarray) -> Poles:
        """Return some of the poles."""
        modes = None if self.modes is None else self.modes[indices]
        return Poles(self.values[indices], self.vectors[:, indices], self.inputs[indices], modes)

    def moved(self, matrix: np.ndarray) -> np.ndarray:
        """Return the product of a real matrix (rows, modes) and the free motions."""
        if self.modes is None:
            return multiply_modes(matrix, self.vectors)
        return matrix[:, self.modes] * self.sizes

    def pressed(self, columns: np.ndarray, conjugate: bool = False) -> np.ndarray:
        """Return ψᵀ columns (..., poles, columns), or ψ̄ᵀ columns, of columns (..., modes, columns)."""
        if self.modes is None:
            return multiply_modes((self.vectors.conj() if conjugate else self.vectors).T, columns)
        sizes = self.sizes.conj() if conjugate else self.sizes
        return np.asarray(columns[..., self.modes, :] * sizes[:, None])

    def gains(self, forces: np.ndarray) -> np.ndarray:
        """Return χ forces (..., poles, loads) of modal forces (..., modes, loads)."""
        return multiply_modes(self.inputs, forces) if self.modes is None else self.pressed(forces)

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

    @property
    def norms(self) -> tuple[np.ndarray, np.ndarray]:
        """(poles,) ‖ψ‖, and ‖ψ‖ ‖χ‖, the response of each pole to a unit force."""
        if self.modes is not None:
            return np.abs(self.sizes), np.abs(self.sizes) ** 2
        sizes = np.linalg.norm(self.vectors, axis=0)
        return sizes, sizes * np.linalg.norm(self.inputs, axis=1)

    @property
    def sizes(self) -> np.ndarray:
        """(poles,) the only number of each free motion, if damping does not couple modes."""
        assert self.modes is not None
        return self.vectors[self.modes, np.arange(self.values.size)]


# Poles of the plates in use, by the longest time [s].
_known: WeakKeyDictionary[ModalPlate, dict[float, Poles]] = WeakKeyDictionary()


def make_poles(plate: ModalPlate, longest: float) -> Poles:
    """Return the poles of a plate with viscous damping, for times up to ``longest`` [s].

    They are computed once and kept as long as the plate is in use.
    """
    known = _known.setdefault(plate, {})
    if longest not in known:
        known[longest] = _compute_poles(plate, longest)
    return known[longest]


def _compute_poles(plate: ModalPlate, longest: float) -> Poles:
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
    inputs = vectors.T
    if coupled:
        lowest = square[:coupled]
        more, shapes, gains = coupled_poles(np.diag(lowest), plate.damping[:coupled, :coupled], np.sqrt(lowest))
        values = np.concatenate([values, more])
        vectors = np.hstack([vectors, np.vstack([shapes, np.zeros((rest.size, more.size))])])
        inputs = np.vstack([inputs, np.hstack([gains, np.zeros((more.size, rest.size))])])
    modes = None if coupled else np.tile(rest, 2)
    return Poles(values, vectors, inputs, modes)


def poles_apart(poles: Poles, rates: np.ndarray, longest: float) -> Poles:
    """Return the poles with those that meet exponents ``rates`` [1/s] of the load moved by the same small amount.

    An undamped mode that is driven at its natural frequency grows with time, as the difference of two exponentials
    that are nearly the same.
    """
    least, values = APART / longest, poles.values.copy()
    for rate in np.unique(rates):
        values[np.abs(values - rate) < least] -= least
    return replace(poles, values=values)


def rates_apart(poles: Poles, rates: np.ndarray, longest: float) -> np.ndarray:
    """Return exponents (designs, loads) of loads with those that meet a pole moved; see :func:`poles_apart`."""
    undamped = poles.values[np.abs(poles.values.real) < APART / longest]
    distance = np.abs(rates[..., None] - undamped).min(axis=-1, initial=math.inf)
    return np.asarray(rates + np.where(distance < APART / longest, APART / longest, 0))
