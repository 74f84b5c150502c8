"""Weighted least squares within ranges, from several starts, with intervals of the result.

With residuals r and their Jacobian J at the optimum, the covariance of the unknowns is s² (JᵀJ)⁻¹, in which
s² = rᵀr / (n − rank J), and intervals follow from Student's t. Residuals over frequency are correlated where the model
is not quite that of the panel: with their covariance C, that of the unknowns is (JᵀJ)⁻¹ JᵀCJ (JᵀJ)⁻¹. Directions in
which J, its columns scaled to length 1, has no singular value are combinations of unknowns that the data do not tell
apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import scipy

# Step of central differences and the number of best starts that are followed to the end.
STEP, FOLLOWED = 1e-4, 3
# Relative changes of the unknowns at which a stage and the whole end.
COARSE, FINE = 1e-2, 1e-6
# Residuals that change by less over a whole range do not depend on an unknown; smaller singular values are zero.
NO_INFLUENCE, RANK = 1e-6, 1e-4
# Parts of a direction without a singular value above MEMBER belong to it; unknowns whose parts change together by a
# cosine above LINKED form one group.
MEMBER, LINKED = 1e-3, 0.1
# Distance from 0 or 1 within which a value is there, and the autocorrelation of residuals that counts as none.
AT_LIMIT, VANISHED = 1e-6, 0.05
# Predictions that are cached.
MOST_CACHED = 128
# Rounds of reweighting the residuals.
ROUNDS = 3
LEVEL = 0.95
# Half the distance of exchanged unknowns, and the part of the residuals' change that differs for mirror images.
APART, ALIKE = 0.1, 1e-3
# Function that returns weights (n,) for residuals (n,) and the leverage (n,) of each.
Weigh = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Residuals(Protocol):
    """Residuals of predictions."""

    def __call__(self, predicted: np.ndarray) -> np.ndarray:
        """Return (n,) residuals."""

    def slopes(self, predicted: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """Return (p, n) derivatives of the residuals along (p, ...) derivatives of the predictions."""


class Prediction(Protocol):
    """Measured quantities as functions of unknowns within 0 ... 1."""

    evaluations: int

    def __call__(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the prediction for unknowns (p,)."""

    def slopes(self, unknowns: np.ndarray, central: bool) -> np.ndarray:
        """Return (p, ...) its derivatives; those that are differences are one-sided unless ``central``."""


class Differenced:
    """A prediction whose derivatives are differences."""

    def __init__(self, function: Callable[[np.ndarray], np.ndarray]) -> None:
        self.evaluations = 0
        self._function = function
        self._cached = lru_cache(MOST_CACHED)(self._predict)

    def __call__(self, unknowns: np.ndarray) -> np.ndarray:
        return self._cached(tuple(unknowns.tolist()))

    def slopes(self, unknowns: np.ndarray, central: bool) -> np.ndarray:
        """See :class:`Prediction`; differences stay within 0 ... 1."""
        rows = []
        for step in STEP * np.eye(len(unknowns)):
            above, below = np.minimum(unknowns + step, 1), np.maximum(unknowns - step, 0)
            if not central:
                above, below = (above, unknowns) if np.any(above > unknowns) else (unknowns, below)
            rows.append((self(above) - self(below)) / np.sum(above - below))
        return np.array(rows)

    def _predict(self, unknowns: tuple[float, ...]) -> np.ndarray:
        self.evaluations += 1
        return self._function(np.array(unknowns))


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """The optimum of a least-squares problem with p unknowns."""

    unknowns: np.ndarray  # (p,) values within 0 ... 1
    deviations: np.ndarray  # (p,) standard deviations, NaN for unknowns that the data do not determine
    correlations: np.ndarray  # (p, p) correlations, NaN for the same
    inseparable: tuple[tuple[int, ...], ...]  # groups that cannot be distinguished; a group of one has no influence
    at_limit: np.ndarray  # (p,) True where a value is an end of the range
    student: float  # half-width of 95 % intervals in standard deviations
    problem: LeastSquaresProblem  # the problem, with the weights at the optimum


def fit_least_squares(
    predict: Prediction,
    residuals: Sequence[Residuals],
    starts: np.ndarray,
    weigh: Weigh | None = None,
    exact: Prediction | None = None,
    series: int | None = None,
) -> LeastSquaresFit:
    """Return the unknowns within 0 ... 1 that minimise the squares of residuals.

    The best of ``starts`` (starts, p) are followed; the optimum of each of ``residuals``, from the smoothest to those
    that count, is the start of the next. What ``predict`` lacks near the optimum compared with ``exact``, which takes
    more time, is added to it, and the deviations follow from the derivatives of ``exact``.
    """
    stages = [LeastSquaresProblem(predict, stage) for stage in residuals]
    costs = [np.sum(stages[0].residuals(start) ** 2) for start in starts]
    best = np.argsort(costs, kind="stable")[:FOLLOWED]
    solved = [stages[0].solve(starts[index], COARSE) for index in best]
    unknowns = min(solved, key=lambda point: np.sum(stages[0].residuals(point) ** 2))
    for stage in stages[1:-1]:
        unknowns = stage.solve(unknowns, COARSE)
    problem = stages[-1]
    unknowns = problem.solve(unknowns, COARSE if exact else FINE)
    for _ in range(ROUNDS if weigh or exact else 0):
        if exact is not None:
            problem.lacking = exact(unknowns) - predict(unknowns)
        if weigh is not None:
            problem.weights = weigh(problem.residuals(unknowns), leverage(problem.jacobian(unknowns)))
        unknowns = problem.solve(unknowns, FINE)
    judged = problem if exact is None else LeastSquaresProblem(exact, residuals[-1], problem.weights)
    return _judge(unknowns, problem, judged.jacobian(unknowns), series)


@dataclass(eq=False)
class LeastSquaresProblem:
    """Weighted residuals of a prediction."""

    predict: Prediction
    of: Residuals
    weights: np.ndarray | float = 1.0  # (n,)
    lacking: np.ndarray | float = 0.0  # addition to the prediction

    def residuals(self, unknowns: np.ndarray) -> np.ndarray:
        """Return (n,) residuals, not weighted."""
        return self.of(self.predict(unknowns) + self.lacking)

    def jacobian(self, unknowns: np.ndarray, central: bool = True) -> np.ndarray:
        """Return the (n, p) Jacobian of the weighted residuals."""
        changes = self.predict.slopes(unknowns, central)
        slopes = self.of.slopes(self.predict(unknowns) + self.lacking, changes)
        return np.asarray((self.weights * slopes).T)

    def solve(self, start: np.ndarray, tolerance: float) -> np.ndarray:
        """Return the (p,) unknowns of a local optimum."""
        optimum = scipy.optimize.least_squares(
            lambda unknowns: self.weights * self.residuals(unknowns),
            start,
            lambda unknowns: self.jacobian(unknowns, central=tolerance < COARSE),
            bounds=(0, 1),
            xtol=tolerance,
            ftol=tolerance**2,
            gtol=None,
        )
        return np.asarray(optimum.x)


def leverage(jacobian: np.ndarray) -> np.ndarray:
    """Return (n,) leverages, the diagonal of J J⁺."""
    directions, values, _ = np.linalg.svd(jacobian, full_matrices=False)
    return np.asarray(np.sum(directions[:, values > RANK * values[0]] ** 2, axis=1))


def _judge(
    unknowns: np.ndarray, problem: LeastSquaresProblem, jacobian: np.ndarray, series: int | None
) -> LeastSquaresFit:
    """Return the estimate with its deviations, from the weighted residuals and their Jacobian (n, p).

    Unknowns at a limit count as given there.
    """
    residuals = problem.weights * problem.residuals(unknowns)
    at_limit = np.abs(unknowns - 0.5) > 0.5 - AT_LIMIT
    lengths = np.linalg.norm(jacobian, axis=0)
    lengths[(lengths < NO_INFLUENCE) | at_limit] = np.inf
    _, values, directions = np.linalg.svd(jacobian / lengths, full_matrices=False)
    determined = values > RANK
    freedom = len(residuals) - int(determined.sum())
    scaled = directions[determined] / values[determined, None]
    covariance = (residuals @ residuals / freedom) * (scaled.T @ scaled)
    if series is not None:
        seen = (jacobian / lengths) @ (scaled.T @ scaled)
        covariance = len(residuals) / freedom * correlated_products(residuals, seen, series)
    lost = np.eye(len(unknowns)) - directions[determined].T @ directions[determined]
    parts = np.sqrt(np.maximum(np.diag(lost), 0))
    identifiable = parts < MEMBER
    deviations = np.where(identifiable, np.sqrt(np.diag(covariance)), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlations = covariance / np.outer(deviations, deviations)
    linked = (np.abs(lost) > LINKED * np.outer(parts, parts)) & ~identifiable & ~identifiable[:, None]
    count, labels = scipy.sparse.csgraph.connected_components(linked)
    alone = ~identifiable & ~at_limit
    groups = (tuple(np.flatnonzero((labels == label) & alone).tolist()) for label in range(count))
    student = float(scipy.special.stdtrit(freedom, (1 + LEVEL) / 2))
    inseparable = tuple(group for group in groups if group)
    return LeastSquaresFit(unknowns, deviations / lengths, correlations, inseparable, at_limit, student, problem)


def correlated_products(residuals: np.ndarray, vectors: np.ndarray, series: int) -> np.ndarray:
    """Return (p, p) vᵀ C v of vectors (n, p) and the covariance C of residuals (n,), which are series of equal length.

    Within a series, C follows from the autocorrelation of the residuals, tapered to zero at twice the lag where it
    first vanishes (Newey, West, Econometrica 55, 1987); series are independent.
    """
    rows = residuals.reshape(series, -1)
    count = rows.shape[1]
    spectra = np.abs(np.fft.rfft(rows, 2 * count)) ** 2
    products = np.fft.irfft(spectra, 2 * count)[:, :count] / count
    shared = products.sum(axis=0)
    vanishing = np.flatnonzero(shared <= VANISHED * shared[0])
    reach = max(1, min(2 * int(vanishing[0]) if len(vanishing) else count, count // 2))
    products *= np.maximum(0, 1 - np.arange(count) / reach)
    kernel = np.fft.rfft(np.concatenate([products, np.zeros((series, 1)), products[:, :0:-1]], axis=1))
    parts = vectors.reshape(series, count, -1)
    spread = np.fft.irfft(kernel[:, :, None] * np.fft.rfft(parts, 2 * count, axis=1), 2 * count, axis=1)[:, :count]
    return np.asarray(np.einsum("snp,snq->pq", parts, spread))


def exchangeable(optimum: LeastSquaresFit, pairs: Sequence[tuple[int, int]]) -> bool:
    """Return whether the data stay as they are if the unknowns of all pairs change places."""
    first, second = np.array(pairs).T
    middle = np.clip((optimum.unknowns[first] + optimum.unknowns[second]) / 2, APART, 1 - APART)
    images = [optimum.unknowns.copy(), optimum.unknowns.copy()]
    for point, sign in zip(images, (1, -1), strict=True):
        point[first], point[second] = middle + sign * APART, middle - sign * APART
    one, other = (optimum.problem.residuals(point) for point in images)
    equal = optimum.unknowns.copy()
    equal[first] = equal[second] = middle
    change = np.linalg.norm(one - optimum.problem.residuals(equal))
    return bool(np.linalg.norm(one - other) < ALIKE * change)
