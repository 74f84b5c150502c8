"""Weighted least squares within ranges, from several starts, and what the result is worth.

With residuals r and their Jacobian J at the optimum, the covariance of the unknowns is s² (JᵀJ)⁻¹, in which
s² = rᵀr / (n − rank J), and intervals follow from Student's t. Directions in which J, its columns scaled to length 1,
has no singular value are combinations of unknowns that the data do not tell apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

# Step of central differences and the number of best starts that are followed to the end.
STEP, FOLLOWED = 1e-4, 3
# Residuals that change by less over a whole range do not depend on an unknown; smaller singular values are zero.
NO_INFLUENCE, RANK = 1e-6, 1e-4
# Parts of a direction above MEMBER belong to it.
MEMBER = 0.02
# Rounds that estimate the weights of the kinds of residuals, and the smallest and largest of them.
ROUNDS, WEIGHTS = 3, (1e-4, 1e4)
LEVEL = 0.95
Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """The optimum of a least-squares problem with p unknowns.

    Attributes:
        unknowns: (p,) values within 0 ... 1.
        deviations: (p,) standard deviations, NaN for unknowns that the data do not tell.
        correlations: (p, p) correlations, NaN for the same.
        inseparable: Indices of unknowns that cannot be told apart, group by group; alone if it has no influence.
        student: Half-width of 95 % intervals in standard deviations.
        evaluations: Number of evaluations of the residuals.
    """

    unknowns: np.ndarray
    deviations: np.ndarray
    correlations: np.ndarray
    inseparable: tuple[tuple[int, ...], ...]
    student: float
    evaluations: int


def fit_least_squares(residuals: Function, starts: np.ndarray, kinds: Sequence[np.ndarray]) -> LeastSquaresFit:
    """Return the unknowns within 0 ... 1 that minimise the squares of residuals.

    Args:
        residuals: Function of (p,) unknowns that returns (n,) residuals.
        starts: (starts, p) unknowns; the best of them are followed.
        kinds: Indices of the residuals of each kind; errors are estimated for each kind, from the residuals.
    """
    kept = lru_cache(maxsize=None)(lambda point: residuals(np.array(point)))

    def function(unknowns: np.ndarray) -> np.ndarray:
        return kept(tuple(unknowns.tolist()))

    costs = [np.sum(function(start) ** 2) for start in starts]
    weights = np.ones(len(function(starts[0])))
    best = starts[np.argsort(costs, kind="stable")[:FOLLOWED]]
    solved = [_solve(function, weights, start) for start in best]
    unknowns = min(solved, key=lambda found: np.sum(function(found) ** 2))
    for _ in range(ROUNDS if len(kinds) > 1 else 0):
        weights = _weights(function(unknowns), weights[:, None] * _jacobian(function, unknowns), kinds)
        unknowns = _solve(function, weights, unknowns)
    jacobian = weights[:, None] * _jacobian(function, unknowns)
    return _judge(unknowns, weights * function(unknowns), jacobian, kept.cache_info().misses)


def _solve(function: Function, weights: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the (p,) unknowns of a local optimum."""
    found = scipy.optimize.least_squares(
        lambda point: weights * function(point),
        start,
        lambda point: weights[:, None] * _jacobian(function, point),
        bounds=(0, 1),
        xtol=1e-7,
        ftol=1e-10,
        gtol=1e-12,
    )
    return np.asarray(found.x)


def _jacobian(function: Function, unknowns: np.ndarray) -> np.ndarray:
    """Return the (n, p) Jacobian by central differences within 0 ... 1."""
    columns = []
    for step in STEP * np.eye(len(unknowns)):
        above, below = np.minimum(unknowns + step, 1), np.maximum(unknowns - step, 0)
        columns.append((function(above) - function(below)) / np.sum(above - below))
    return np.stack(columns, axis=1)


def _weights(residuals: np.ndarray, jacobian: np.ndarray, kinds: Sequence[np.ndarray]) -> np.ndarray:
    """Return (n,) weights that make all kinds of residuals as large as the first, by their degrees of freedom."""
    directions, values, _ = np.linalg.svd(jacobian, full_matrices=False)
    leverage = np.sum(directions[:, values > RANK * values[0]] ** 2, axis=1)
    freedom = [max(1.0, len(rows) - leverage[rows].sum()) for rows in kinds]
    sizes = [np.sqrt(np.sum(residuals[rows] ** 2) / free) for rows, free in zip(kinds, freedom, strict=True)]
    weights = np.ones(len(residuals))
    for rows, size in zip(kinds, sizes, strict=True):
        weights[rows] = np.clip(sizes[0] / size if size else 1.0, *WEIGHTS)
    return weights


def _judge(unknowns: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray, evaluations: int) -> LeastSquaresFit:
    """Return the estimate with its deviations, from weighted residuals (n,) and Jacobian (n, p)."""
    lengths = np.linalg.norm(jacobian, axis=0)
    lengths[lengths < NO_INFLUENCE] = np.inf
    _, values, directions = np.linalg.svd(jacobian / lengths, full_matrices=False)
    kept = values > RANK
    freedom = len(residuals) - int(kept.sum())
    scaled = directions[kept] / values[kept, None]
    covariance = (residuals @ residuals / freedom) * (scaled.T @ scaled)
    lost = np.eye(len(unknowns)) - directions[kept].T @ directions[kept]
    told = np.diag(lost) < MEMBER
    deviations = np.where(told, np.sqrt(np.diag(covariance)), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlations = covariance / np.outer(deviations, deviations)
    count, labels = scipy.sparse.csgraph.connected_components(np.abs(lost) > MEMBER)
    groups = (tuple(np.flatnonzero((labels == label) & ~told).tolist()) for label in range(count))
    student = float(scipy.special.stdtrit(freedom, (1 + LEVEL) / 2))
    inseparable = tuple(group for group in groups if group)
    return LeastSquaresFit(unknowns, deviations / lengths, correlations, inseparable, student, evaluations)
