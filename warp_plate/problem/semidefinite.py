"""Upper bounds of quadratic forms under quadratic limits, by the semidefinite relaxation, and local maxima.

The bounded quantity is the largest zᵀA z of all z with zᵀC_i z ≤ c_i. Any multipliers μ with

    S(μ) = Σ μ_i C_i − A ⪰ 0,    μ_i ≥ 0 (of any sign where the limit is an equation)

give zᵀA z ≤ Σ μ_i zᵀC_i z ≤ Σ μ_i c_i, so Σ μ_i c_i bounds it, whether or not these μ are the best ones: an
early end makes the bound wider, never wrong. The best ones are found by Newton's method on

    φ(μ) = t Σ μ_i c_i − log det S(μ) − Σ log μ_i,    t → ∞,

whose points all keep S ≻ 0 (S. Boyd, L. Vandenberghe: Convex Optimization, 2004, sections 5.9 and 11.6; the relaxation
itself: N. Z. Shor, Sov. J. Comput. Syst. Sci. 25, 1987).

The relaxation points at drives that may be a little off, or violate a limit where it is not tight. From there SLSQP
leads to a drive that keeps all limits (D. Kraft, DFVLR-FB 88-28, 1988; J. Nocedal and S. Wright, Numerical
Optimization, 2006, section 18).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

# The barrier's weight t grows by this factor until the duality gap (size + limits)/t is below GAP of the bound.
GROWTH, GAP = 8.0, 1e-10
# Newton steps at one t, and the decrement at which they end.
MOST_STEPS, SETTLED = 60, 1e-8
# Rounding error that an entry of a small symmetric matrix and its eigenvalues may gather.
EIGEN_ERROR = 64 * np.finfo(float).eps
# Steps and tolerance of an ascent to a local maximum; and a limit xᵀ matrix x + entry ≤ 0, or = 0, there: matrix,
# entry, whether it is an equation.
MOST_ASCENT_STEPS, TOLERANCE = 100, 1e-13
Limit = tuple[np.ndarray, float, bool]


def least_majorant(
    objective: np.ndarray, matrices: np.ndarray, values: np.ndarray, equation: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the bound Σ μ_i c_i and the slack S(μ), (n, n), whose smallest eigenvector is near the z of the maximum.

    They are infinity and empty where no multipliers are found. The value lies above the exact one of its μ by the
    largest rounding error. Arguments: symmetric A (n, n) and C_i (limits, n, n), c_i (limits,), and (limits,) whether
    zᵀC_i z = c_i.
    """
    size = float(np.abs(objective).max())
    if size == 0:
        return 0.0, np.zeros_like(objective)
    largest = np.abs(matrices).max(axis=(1, 2))
    norms = np.where(largest > 0, largest, 1.0)
    values = values / norms
    unit = float(np.abs(values).max(initial=0.0)) or 1.0
    dual = _Dual(objective / size, matrices / norms[:, None, None], values / unit, equation)
    start = dual.inside()
    if start is None:
        return np.inf, np.empty((0, 0))
    multipliers = dual.follow(start)
    value = float(dual.values @ multipliers)
    value += EIGEN_ERROR * float(np.abs(dual.values) @ np.abs(multipliers))
    return float(size * unit * value), dual.slack(multipliers)


@dataclass(frozen=True)
class _Dual:
    """The dual problem, in the arrays of :func:`least_majorant`; all methods take multipliers (limits,)."""

    objective: np.ndarray
    matrices: np.ndarray
    values: np.ndarray
    equation: np.ndarray
    damping: float = 0.0  # of |μ|²/2 in φ, where nothing else bounds the multipliers

    def slack(self, multipliers: np.ndarray) -> np.ndarray:
        """Return S(μ), shape (n, n)."""
        return np.asarray(np.tensordot(multipliers, self.matrices, 1) - self.objective)

    def barrier(self, multipliers: np.ndarray, weight: float) -> float:
        """Return φ; infinity outside."""
        bounded = multipliers[~self.equation]
        if (bounded <= 0).any():
            return np.inf
        try:
            root = np.linalg.cholesky(self.slack(multipliers))
        except np.linalg.LinAlgError:
            return np.inf
        logs = 2 * np.log(np.diag(root)).sum() + np.log(bounded).sum()
        return float(weight * self.values @ multipliers - logs + self.damping / 2 * multipliers @ multipliers)

    def surely_inside(self, multipliers: np.ndarray) -> bool:
        """Return whether S is positive definite by more than the errors with which it is computed."""
        slack = self.slack(multipliers)
        return bool(np.linalg.eigvalsh(slack)[0] > EIGEN_ERROR * (1 + np.abs(multipliers).sum()) * len(slack))

    def inside(self) -> np.ndarray | None:
        """Return multipliers with S ≻ 0, by lowering s with S + s·1 ⪰ 0 until it is not needed; None if it is."""
        count, size = len(self.values), len(self.objective)
        unit, last = np.eye(size)[None], np.append(np.zeros(count), 1.0)
        matrices, equation = np.concatenate([self.matrices, unit]), np.append(self.equation, True)
        wider = _Dual(self.objective, matrices, last, equation, damping=1e-3)
        multipliers = np.append(np.where(self.equation, 0.0, 1.0), 0.0)
        multipliers[-1] = 1 - np.linalg.eigvalsh(wider.slack(multipliers))[0]
        if multipliers[-1] <= 0:  # S ⪰ 1 from the start
            return multipliers[:-1]
        weight = size / multipliers[-1]
        for _ in range(20):
            multipliers, _ = wider.centre(multipliers, weight, inner=self)
            if np.isfinite(self.barrier(multipliers[:-1], 1.0)):
                return multipliers[:-1]
            weight *= GROWTH
        return None

    def follow(self, multipliers: np.ndarray) -> np.ndarray:
        """Return the multipliers at the end of the central path, or the last ones that rounding leaves inside."""
        count = len(self.objective) + np.count_nonzero(~self.equation)
        weight = count / max(abs(float(self.values @ multipliers)), 1e-3)
        least = multipliers
        while True:
            multipliers, settled = self.centre(multipliers, weight)
            value = float(self.values @ multipliers)
            if not self.surely_inside(multipliers):
                break
            if value < float(self.values @ least):
                least = multipliers
            if not settled or count / weight < GAP * abs(value):
                return least
            weight *= GROWTH
        low, high = 0.0, 1.0
        for _ in range(20):
            middle = (low + high) / 2
            inside = self.surely_inside(least + middle * (multipliers - least))
            low, high = (middle, high) if inside else (low, middle)
        return least + low * (multipliers - least)

    def centre(self, multipliers: np.ndarray, weight: float, inner: _Dual | None = None) -> tuple[np.ndarray, bool]:
        """Apply Newton's method at one t, or until all but the last multiplier are inside another dual; return whether
        it settled."""
        level = self.barrier(multipliers, weight)
        for _ in range(MOST_STEPS):
            step, decrement = self.newton(multipliers, weight)
            # A descent below the rounding error of φ cannot be detected.
            if not decrement >= max(SETTLED, EIGEN_ERROR * abs(level)):
                return multipliers, bool(np.isfinite(decrement))
            length = 1.0
            while not (lower := self.barrier(multipliers + length * step, weight)) <= level - 0.1 * length * decrement:
                length /= 2
                if length < 1e-10:
                    return multipliers, decrement < 1e-2
            multipliers, level = multipliers + length * step, lower
            if inner is not None and np.isfinite(inner.barrier(multipliers[:-1], 1.0)):
                return multipliers, True
        return multipliers, decrement < 1e-2

    def newton(self, multipliers: np.ndarray, weight: float) -> tuple[np.ndarray, float]:
        """Return Newton's step for φ, and the decrease of φ along it to first order."""
        try:
            inverse = np.linalg.inv(self.slack(multipliers))
        except np.linalg.LinAlgError:  # at the boundary, up to rounding
            return np.zeros_like(multipliers), np.nan
        products = inverse @ self.matrices
        inverses = np.where(self.equation, 0.0, 1 / np.where(self.equation, 1.0, multipliers))
        slope = weight * self.values - np.trace(products, axis1=1, axis2=2) - inverses + self.damping * multipliers
        curvature = np.einsum("iab,jba->ij", products, products) + np.diag(inverses**2 + self.damping)
        if not np.isfinite(curvature).all():  # where nothing bounds the objective, S runs off
            return np.zeros_like(multipliers), np.nan
        size = np.sqrt(np.maximum(np.diag(curvature), 1e-30 * curvature.max()))
        step = -np.linalg.lstsq(curvature / np.outer(size, size), slope / size, rcond=None)[0] / size
        return step, float(-slope @ step)


def local_maximum(
    numerator: np.ndarray, denominator: np.ndarray | None, limits: Sequence[Limit], least: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Return the x (n,) to which an ascent from ``start`` leads, up to rounding within the limits and above ``least``.

    The maximised value is xᵀ numerator x, divided by xᵀ denominator x if there is one; matrices are (n, n).
    """
    x = start * _scale(limits, start)
    size = float(np.linalg.norm(x))
    below = 1.0 if denominator is None else float(x @ denominator @ x)
    typical = float(x @ numerator @ x) / below if below > 0 else 0.0
    if not (size > 0 and 0 < typical < np.inf):
        return start
    top = numerator * (size**2 / typical)
    bottom = None if denominator is None else denominator * size**2

    def fall(y: np.ndarray) -> tuple[float, np.ndarray]:
        slope, above = 2 * top @ y, float(y @ top @ y)
        if bottom is None:
            return -above, -slope
        below = max(float(y @ bottom @ y), 1e-300)
        return -above / below, -(slope - above / below * 2 * bottom @ y) / below

    result = scipy.optimize.minimize(
        fall,
        x / size,
        jac=True,
        method="SLSQP",
        bounds=scipy.optimize.Bounds(least / size),
        constraints=_constraints(limits, size),
        options={"maxiter": MOST_ASCENT_STEPS, "ftol": TOLERANCE},
    )
    return np.asarray(result.x * size) if np.isfinite(result.x).all() else start


def _scale(limits: Sequence[Limit], x: np.ndarray) -> float:
    """Return the largest factor on x (n,) with which no limit from above is passed; 1 if there is none."""
    ratios = [-entry / form for matrix, entry, _ in limits if entry < 0 and (form := float(x @ matrix @ x)) > 0]
    return float(np.sqrt(min(ratios, default=1.0)))


def _constraints(limits: Sequence[Limit], size: float) -> list[dict[str, object]]:
    """Return the limits as SLSQP takes them, equations first, of x / size and in units of their own size."""
    constraints: list[dict[str, object]] = []
    for kind in ("eq", "ineq"):
        chosen = [(matrix * size**2, entry) for matrix, entry, equation in limits if equation == (kind == "eq")]
        if not chosen:
            continue
        units = np.array([abs(entry) or float(np.abs(matrix).max()) or 1.0 for matrix, entry in chosen])
        matrices = np.array([matrix for matrix, _ in chosen]) / units[:, None, None]
        entries = np.array([entry for _, entry in chosen]) / units
        constraints.append(
            {
                "type": kind,
                "fun": lambda y, matrices=matrices, entries=entries: -(matrices @ y @ y + entries),
                "jac": lambda y, matrices=matrices: -2 * matrices @ y,
            }
        )
    return constraints
