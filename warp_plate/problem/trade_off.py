"""Contrast of target and rest against the fidelity of the target's motion, from contrast control to pressure matching.

With B and D the forms of the mean squares in the target and in the rest, d the wanted motion of the target and
b = ⟨H, d⟩, both forms are diagonal in the vectors u of B u = λ (B + D) u, uᴴ B u = λ, uᴴ D u = δ = 1 − λ. The variable
span trade-off takes V of them, those of the largest λ (J. K. Nielsen, T. Lee, J. R. Jensen, M. G. Christensen, Proc.
EUSIPCO 2018, pp. 757-761),

    z = Σ_v (uᵥᴴ b) / (λᵥ + µ δᵥ) uᵥ,

which is acoustic contrast control for V = 1 and pressure matching with the weight µ of the rest for all of them. How
much fidelity a contrast γ = zᴴBz / zᴴDz must cost is a convex problem in disguise: one quadratic inequality has no
duality gap (S. Boyd, L. Vandenberghe, Convex Optimization, appendix B), so that with m ≥ 0

    min |H z − d|²  under  zᴴBz ≥ γ zᴴDz     =     max over m of  |d|² − Σ_v |uᵥᴴ b|² / (λᵥ + m (γ δᵥ − λᵥ))

and z has the components uᵥᴴ b / (λᵥ + m (γ δᵥ − λᵥ)). Any m for which all denominators are positive proves a bound.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.solve.response import unit_energy_basis

# Largest contrast: more is rounding.
MOST_CONTRAST = 1e10
ALIKE = 1e-9  # relative difference of contrasts that is rounding
HALVINGS = 200
POINTS = 25  # on the curve


@dataclass(frozen=True, eq=False)
class Compromise:
    """A drive between contrast and fidelity."""

    drive: np.ndarray  # (actuators,) complex amplitudes for the wanted motion
    contrast_db: float  # mean square of the target over that of the rest [dB]
    misfit: float  # root of |H z − d|² / |d|² over the target
    bound: float = math.nan  # no drive of this contrast, or a larger one, has a smaller misfit; NaN where not computed


class TradeOffCurve:
    """Drives for a wanted motion of the target.

    Args:
        target: (actuators, actuators) form of the mean square motion of the target.
        rest: The same of the rest.
        product: (actuators,) means of the conjugate responses times the wanted motion, b.
        size: Mean square of the wanted motion, |d|².
    """

    def __init__(self, target: np.ndarray, rest: np.ndarray, product: np.ndarray, size: float) -> None:
        basis = unit_energy_basis(target + rest)
        vectors = basis @ np.linalg.eigh(basis.conj().T @ target @ basis)[1][:, ::-1]
        self._inside, self._outside = (
            np.einsum("ij,ik,kj->j", vectors.conj(), form, vectors).real.clip(0.0) for form in (target, rest)
        )
        self._vectors, self._parts, self._size = vectors, vectors.conj().T @ product, size

    def spans(self, weight: float) -> list[Compromise]:
        """Return the drives of the variable span trade-off for 1 to all vectors, with the weight µ."""
        both = self._inside + weight * self._outside
        parts = np.divide(self._parts, both, out=np.zeros_like(self._parts), where=both > 0)
        return [
            self._compromise(np.where(np.arange(len(parts)) < count, parts, 0)) for count in range(1, len(parts) + 1)
        ]

    def curve(self, points: int = POINTS) -> list[Compromise]:
        """Return drives of the least misfit for contrasts from that of the best fit to nearly the largest one."""
        fitting = self._least(0.0)
        low, high = self._contrast(fitting), max(map(self._contrast, np.eye(len(fitting))))
        if not 0 < low < high * (1 - ALIKE):
            best = self._compromise(fitting)
            return [replace(best, bound=best.misfit)]
        return [self.at(contrast) for contrast in np.geomspace(low, high, points + 1)[:-1]]

    def at(self, contrast: float) -> Compromise:
        """Return the drive of the least misfit of all with at least a contrast γ, below the largest."""
        short, low = contrast * self._outside - self._inside, 0.0
        over = short < 0
        high = float((self._inside[over] / -short[over]).min())
        if self._contrast(self._least(0.0)) < contrast and not over.all():
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                below = self._contrast(self._least(middle, contrast)) < contrast
                low, high = (middle, high) if below else (low, middle)
                if high - low <= np.spacing(high):
                    break
        parts = self._least(low, contrast)
        found = self._compromise(parts)
        gain = float((parts.conj() * self._parts).real.sum())
        bound = math.sqrt(max(0.0, 1 - gain / self._size))
        return Compromise(found.drive, found.contrast_db, found.misfit, min(bound, found.misfit))

    def _least(self, multiplier: float, contrast: float = 0.0) -> np.ndarray:
        """Return the components of the least Lagrangian."""
        below = self._inside + multiplier * (contrast * self._outside - self._inside)
        return np.divide(self._parts, below, out=np.zeros_like(self._parts), where=below > 0)

    def _contrast(self, parts: np.ndarray) -> float:
        squares = np.abs(parts) ** 2
        inside, outside = float((self._inside * squares).sum()), float((self._outside * squares).sum())
        return inside / max(outside, inside / MOST_CONTRAST, 1e-300)

    def _compromise(self, parts: np.ndarray) -> Compromise:
        square = self._size - 2 * float((self._parts.conj() * parts).real.sum())
        square += float((self._inside * np.abs(parts) ** 2).sum())
        contrast, misfit = self._contrast(parts), math.sqrt(max(square, 0.0) / self._size)
        return Compromise(self._vectors @ parts, 10 * math.log10(max(contrast, 1e-300)), misfit)
