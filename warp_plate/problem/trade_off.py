"""Contrast of target and rest against the fidelity of the target's motion, from contrast control to pressure matching.

With B and D the forms of the mean squares in the target and in the rest, d the wanted motion of the target and
b = ⟨H, d⟩, both forms are diagonal in the vectors u of B u = λ D u, uᴴ D u = 1. The variable span trade-off takes V of
them, those of the largest λ (J. K. Nielsen, T. Lee, J. R. Jensen, M. G. Christensen, Proc. EUSIPCO 2018, pp. 757-761),

    z = Σ_v (uᵥᴴ b) / (λᵥ + µ) uᵥ,

which is acoustic contrast control for V = 1 and pressure matching with the weight µ of the rest for all of them. How
much fidelity a contrast γ = zᴴBz / zᴴDz must cost is a convex problem in disguise: one quadratic inequality has no
duality gap (S. Boyd, L. Vandenberghe, Convex Optimization, appendix B), so that with m ≥ 0

    min |H z − d|²  under  zᴴBz ≥ γ zᴴDz     =     max over m of  |d|² − Σ_v |uᵥᴴ b|² / (λᵥ + m (γ − λᵥ))

and z has the components uᵥᴴ b / (λᵥ + m (γ − λᵥ)). Any m for which all denominators are positive proves a bound.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

# Relative eigenvalue of the rest's form that is added to all, so that drives that it does not feel are limited too.
LEAST = 1e-10
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
        floor = LEAST * float(np.trace(rest).real / len(rest)) or 1.0
        values, vectors = scipy.linalg.eigh(target, rest + floor * np.eye(len(rest)))
        self._values, self._vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
        self._parts, self._size = self._vectors.conj().T @ product, size

    def spans(self, weight: float) -> list[Compromise]:
        """Return the drives of the variable span trade-off for 1 to all vectors, with the weight µ."""
        parts = self._parts / (self._values + weight)
        return [
            self._compromise(np.where(np.arange(len(parts)) < count, parts, 0)) for count in range(1, len(parts) + 1)
        ]

    def curve(self, points: int = POINTS) -> list[Compromise]:
        """Return drives of the least misfit for contrasts from that of the best fit to nearly the largest one."""
        fitting = self._least(0.0)
        low, high = self._contrast(fitting), float(self._values[0])
        if not 0 < low < high * (1 - ALIKE):
            return [self._compromise(fitting)]
        return [self.at(contrast) for contrast in np.geomspace(low, high, points + 1)[:-1]]

    def at(self, contrast: float) -> Compromise:
        """Return the drive of the least misfit of all with at least a contrast γ, below the largest."""
        values, low = self._values, 0.0
        falling = values < contrast
        over = values > contrast
        high = float((values[over] / (values[over] - contrast)).min())
        if self._contrast(self._least(0.0)) < contrast and falling.any():
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                short = self._contrast(self._least(middle, contrast)) < contrast
                low, high = (middle, high) if short else (low, middle)
                if high - low <= np.spacing(high):
                    break
        multiplier = low
        parts = self._least(multiplier, contrast)
        found = self._compromise(parts)
        gain = float((np.abs(self._parts) ** 2 / (values + multiplier * (contrast - values)))[self._parts != 0].sum())
        bound = math.sqrt(max(0.0, 1 - gain / self._size))
        return Compromise(found.drive, found.contrast_db, found.misfit, min(bound, found.misfit))

    def _least(self, multiplier: float, contrast: float = 0.0) -> np.ndarray:
        """Return the components of the least Lagrangian."""
        below = self._values + multiplier * (contrast - self._values)
        return np.divide(self._parts, below, out=np.zeros_like(self._parts), where=below > 0)

    def _contrast(self, parts: np.ndarray) -> float:
        squares = np.abs(parts) ** 2
        return float((self._values * squares).sum() / max(squares.sum(), 1e-300))

    def _compromise(self, parts: np.ndarray) -> Compromise:
        square = self._size - 2 * float((self._parts.conj() * parts).real.sum())
        square += float((self._values * np.abs(parts) ** 2).sum())
        contrast, misfit = self._contrast(parts), math.sqrt(max(square, 0.0) / self._size)
        return Compromise(self._vectors @ parts, 10 * math.log10(max(contrast, 1e-300)), misfit)
