"""Further fits around an optimum: intervals by the bootstrap, and profile likelihoods; and mirror images of it.

The bootstrap (B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, 1993, section 9.4) draws the residuals of a
fit with replacement, adds them to the prediction at the optimum and fits these data, many times; it makes no assumption
of normal errors, and follows the unknowns where they are not linear in the data. A profile likelihood fixes one unknown
at a time and fits the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warp_plate.fitting.least_squares import LeastSquaresFit, LeastSquaresProblem, Weigh, leverage

# Relative changes of the unknowns at which a fit ends; half-width of profiles in standard deviations.
TOLERANCE, REACH = 1e-4, 3.0
# Half the distance of exchanged unknowns, and the part of the residuals' change that differs for mirror images.
APART, ALIKE = 0.1, 1e-3


def bootstrap(
    found: LeastSquaresFit, kinds: Sequence[np.ndarray], weigh: Weigh | None, count: int, seed: int
) -> np.ndarray:
    """Return (count, p) unknowns that were fitted to resampled data.

    Args:
        found: Optimum.
        kinds: Indices (m, parts) of residuals that are drawn together, a row at a time, from the rows of their kind.
        weigh: Weights, see :func:`fit_least_squares`.
        count: Number of data sets.
        seed: Random seed.
    """
    problem, random = found.problem, np.random.default_rng(seed)
    residuals, jacobian = problem.residuals(found.unknowns), problem.jacobian(found.unknowns)
    slopes = (jacobian.T / problem.weights).T
    # Residuals of a fit are smaller than the errors of the data.
    errors = residuals * np.sqrt(len(residuals) / max(1, len(residuals) - len(found.unknowns)))
    samples = []
    for _ in range(count):
        drawn = errors.copy()
        for rows in kinds:
            drawn[rows] = errors[rows[random.integers(len(rows), size=len(rows))]]
        weights = problem.weights if weigh is None else weigh(drawn, leverage(jacobian))
        made = replace(problem, shift=drawn - residuals, weights=weights, slopes=slopes)
        samples.append(made.solve(found.unknowns, TOLERANCE))
    return np.array(samples)


def profile(found: LeastSquaresFit, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (p, points) values of each unknown, and by how much χ² rises if it is fixed there.

    χ² is the sum of squared residuals over its estimated variance; a 95 % interval ends where it rises by the square of
    ``found.student``. Values reach three standard deviations to either side, or over the range of an unknown that the
    data do not determine.
    """
    best = _squares(found.problem, found.unknowns)
    variance = best / max(1, found.freedom)
    grids, rises = [], []
    for index, (own, deviation) in enumerate(zip(found.unknowns, found.deviations, strict=True)):
        width = REACH * deviation if np.isfinite(deviation) else 1.0
        grid = np.linspace(max(own - width, 0.0), min(own + width, 1.0), points)
        squares = np.empty(points)
        for order in (np.flatnonzero(grid >= own), np.flatnonzero(grid < own)[::-1]):  # outwards
            unknowns = found.unknowns
            for place in order:
                start = np.where(np.arange(len(unknowns)) == index, grid[place], unknowns)
                unknowns = found.problem.solve(start, TOLERANCE, fixed=index)
                squares[place] = _squares(found.problem, unknowns)
        grids.append(grid)
        rises.append((squares - best) / variance if variance else squares * 0)
    return np.array(grids), np.array(rises)


def exchangeable(found: LeastSquaresFit, pairs: Sequence[tuple[int, int]]) -> bool:
    """Return whether the data stay as they are if the unknowns of all pairs change places."""
    first, second = np.array(pairs).T
    middle = np.clip((found.unknowns[first] + found.unknowns[second]) / 2, APART, 1 - APART)
    moved = [found.unknowns.copy(), found.unknowns.copy()]
    for point, sign in zip(moved, (1, -1), strict=True):
        point[first], point[second] = middle + sign * APART, middle - sign * APART
    one, other = (found.problem.residuals(point) for point in moved)
    equal = found.unknowns.copy()
    equal[first] = equal[second] = middle
    change = np.linalg.norm(one - found.problem.residuals(equal))
    return bool(np.linalg.norm(one - other) < ALIKE * change)


def _squares(problem: LeastSquaresProblem, unknowns: np.ndarray) -> float:
    return float(np.sum((problem.weights * problem.residuals(unknowns)) ** 2))
