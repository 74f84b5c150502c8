"""Upper bounds of quadratic forms under quadratic limits: the dual of the semidefinite relaxation, by a barrier.

The bounded quantity is the largest zᵀA z of all z with zᵀC_i z ≤ c_i. Any multipliers μ with

    S(μ) = Σ μ_i C_i − A ⪰ 0,    μ_i ≥ 0 (of any sign where the limit is an equation)

give zᵀA z ≤ Σ μ_i zᵀC_i z ≤ Σ μ_i c_i, so Σ μ_i c_i bounds it, whether or not these μ are the best ones: an
early end makes the bound wider, never wrong. The best ones are found by Newton's method on

    φ(μ) = t Σ μ_i c_i − log det S(μ) − Σ log μ_i,    t → ∞,

whose points all keep S ≻ 0 (S. Boyd, L. Vandenberghe: Convex Optimization, 2004, sections 5.9 and 11.6; the relaxation
itself: N. Z. Shor, Sov. J. Comput. Syst. Sci. 25, 1987).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# The barrier's weight t grows by this factor, until what it hides, (size + limits)/t, is below GAP of the bound.
GROWTH, GAP = 8.0, 1e-10
# Newton steps at one t, and the decrement at which they end.
MOST_STEPS, SETTLED = 60, 1e-8
# Roundings that an entry of a small symmetric matrix and its eigenvalues may gather.
ROUNDINGS = 64


@dataclass(frozen=True)
class QuadraticLimits:
    """Limits of quadratic forms, zᵀC_i z ≤ c_i.

    Attributes:
        matrices: (limits, n, n) symmetric C_i.
        values: (limits,) c_i.
        equation: (limits,) whether zᵀC_i z = c_i.
    """

    matrices: np.ndarray
    values: np.ndarray
    equation: np.ndarray


def least_majorant(objective: np.ndarray, limits: QuadraticLimits) -> tuple[float, np.ndarray]:
    """Return the bound Σ μ_i c_i and the slack S(μ), (n, n), whose smallest eigenvector is near the z of the maximum.

    They are infinity and empty where no multipliers are found. The value lies above the exact one of its μ by the
    largest rounding error.
    """
    size = float(np.abs(objective).max())
    if size == 0:
        return 0.0, np.zeros_like(objective)
    norms = np.abs(limits.matrices).max(axis=(1, 2))
    norms = np.where(norms > 0, norms, 1.0)
    scaled = replace(limits, matrices=limits.matrices / norms[:, None, None], values=limits.values / norms)
    start = _inside(objective / size, scaled)
    if start is None:
        return np.inf, np.empty((0, 0))
    multipliers = _follow(objective / size, scaled, start)
    slack = _slack(objective / size, scaled, multipliers)
    value = float(scaled.values @ multipliers)
    value += ROUNDINGS * np.finfo(float).eps * float(np.abs(scaled.values) @ np.abs(multipliers))
    return float(size * value), slack


def _follow(objective: np.ndarray, limits: QuadraticLimits, multipliers: np.ndarray) -> np.ndarray:
    """Return the multipliers at the end of the central path, or the last ones that rounding leaves inside."""
    count = len(objective) + np.count_nonzero(~limits.equation)
    weight = count / max(abs(float(limits.values @ multipliers)), 1e-3)
    least = multipliers
    while True:
        multipliers, settled = _centre(objective, limits, multipliers, weight)
        value = float(limits.values @ multipliers)
        if not _surely_inside(_slack(objective, limits, multipliers), multipliers):
            return _between(objective, limits, least, multipliers)
        if value < float(limits.values @ least):
            least = multipliers
        if not settled or count / weight < GAP * abs(value):
            return least
        weight *= GROWTH


def _between(objective: np.ndarray, limits: QuadraticLimits, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Return the last multipliers between two that are surely inside."""
    low, high = 0.0, 1.0
    for _ in range(20):
        middle = (low + high) / 2
        tried = inside + middle * (outside - inside)
        if _surely_inside(_slack(objective, limits, tried), tried):
            low = middle
        else:
            high = middle
    return inside + low * (outside - inside)


def _surely_inside(slack: np.ndarray, multipliers: np.ndarray) -> bool:
    """Return whether S is positive definite by more than the errors with which it is computed."""
    error = ROUNDINGS * np.finfo(float).eps * (1 + np.abs(multipliers).sum()) * len(slack)
    return bool(np.linalg.eigvalsh(slack)[0] > error)


def _centre(
    objective: np.ndarray, limits: QuadraticLimits, multipliers: np.ndarray, weight: float, stop_below: float = -np.inf
) -> tuple[np.ndarray, bool]:
    """Apply Newton's method at one t, or until the last multiplier falls below a value; return whether it settled."""
    level = _barrier(objective, limits, multipliers, weight)
    for _ in range(MOST_STEPS):
        step, decrement = _newton(objective, limits, multipliers, weight)
        # Below what rounding leaves of φ no descent can be seen.
        if not decrement >= max(SETTLED, ROUNDINGS * np.finfo(float).eps * abs(level)):
            return multipliers, bool(np.isfinite(decrement))
        length = 1.0
        while True:
            tried = multipliers + length * step
            found = _barrier(objective, limits, tried, weight)
            if found <= level - 0.1 * length * decrement:
                break
            length /= 2
            if length < 1e-10:
                return multipliers, decrement < 1e-2
        multipliers, level = tried, found
        if multipliers[-1] < stop_below:
            return multipliers, True
    return multipliers, decrement < 1e-2


def _newton(
    objective: np.ndarray, limits: QuadraticLimits, multipliers: np.ndarray, weight: float
) -> tuple[np.ndarray, float]:
    """Return Newton's step for φ, and the decrease of φ along it to first order."""
    try:
        inverse = np.linalg.inv(_slack(objective, limits, multipliers))
    except np.linalg.LinAlgError:  # at the edge, as far as numbers tell
        return np.zeros_like(multipliers), np.nan
    turned = inverse @ limits.matrices
    bent = np.where(limits.equation, 0.0, 1 / np.where(limits.equation, 1.0, multipliers))
    slope = weight * limits.values - np.trace(turned, axis1=1, axis2=2) - bent
    curvature = np.einsum("iab,jba->ij", turned, turned) + np.diag(bent**2)
    if not np.isfinite(curvature).all():  # where nothing bounds the objective, S runs off
        return np.zeros_like(multipliers), np.nan
    size = np.sqrt(np.maximum(np.diag(curvature), 1e-30 * curvature.max()))
    step = -np.linalg.lstsq(curvature / np.outer(size, size), slope / size, rcond=None)[0] / size
    return step, float(-slope @ step)


def _barrier(objective: np.ndarray, limits: QuadraticLimits, multipliers: np.ndarray, weight: float) -> float:
    """Return φ; infinity outside."""
    bounded = multipliers[~limits.equation]
    if (bounded <= 0).any():
        return np.inf
    try:
        root = np.linalg.cholesky(_slack(objective, limits, multipliers))
    except np.linalg.LinAlgError:
        return np.inf
    logs = 2 * np.log(np.diag(root)).sum() + np.log(bounded).sum()
    return float(weight * limits.values @ multipliers - logs)


def _inside(objective: np.ndarray, limits: QuadraticLimits) -> np.ndarray | None:
    """Return multipliers with S ≻ 0, by lowering s with S + s·1 ⪰ 0 until it is negative; None if it never is."""
    count, size = len(limits.values), len(objective)
    wider = QuadraticLimits(
        np.concatenate([limits.matrices, np.eye(size)[None]]),
        np.append(np.zeros(count), 1.0),
        np.append(limits.equation, True),
    )
    multipliers = np.append(np.where(limits.equation, 0.0, 1.0), 0.0)
    multipliers[-1] = 1 - np.linalg.eigvalsh(_slack(objective, wider, multipliers))[0]
    weight = size / multipliers[-1]
    for _ in range(20):
        multipliers, _ = _centre(objective, wider, multipliers, weight, stop_below=-1e-9)
        # What counts is S without s, as a Cholesky factor finds it.
        if multipliers[-1] < -1e-9 and np.isfinite(_barrier(objective, limits, multipliers[:-1], 1.0)):
            return multipliers[:-1]
        weight *= GROWTH
    return None


def _slack(objective: np.ndarray, limits: QuadraticLimits, multipliers: np.ndarray) -> np.ndarray:
    """Return S(μ), shape (n, n)."""
    slack: np.ndarray = np.tensordot(multipliers, limits.matrices, 1) - objective
    return slack
