"""Local refinement after a search by modes: from the best position down to the nearest minimum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from warp_plate.problem.objectives import loss_scale
from warp_plate.problem.problem import Problem
from warp_plate.studies.spectrum import spectrum_frequencies

# Differences for slopes, in initial ranges.
STEP = 1e-6
# A descent ends where a step gains less, and the search where a round of descents does, as a part of the loss's scale.
TOLERANCE, GAIN = 1e-10, 1e-7
MOST_STEPS, MOST_ROUNDS = 40, 5


def polish(problem: Problem, position: np.ndarray, loss: float) -> tuple[np.ndarray, float, int]:
    """Return the minimum to which a descent from a position of ``problem.space`` leads, its loss, and the evaluations.

    A shared frequency may jump to a better peak of the result's spectrum.
    """
    evaluations, space = 0, problem.space

    def losses(points: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        evaluations += len(points)
        return problem.losses_without_clearance(space.from_unit(points))

    point = space.to_unit(position)
    for _ in range(MOST_ROUNDS):
        before = loss
        descended = _descend(losses, problem, point)
        for tried in (descended, _best_frequency(losses, problem, descended)):
            value = float(problem.losses(space.from_unit(tried[None]))[0])
            if value < loss:
                point, loss = tried, value
        if not loss < before - GAIN * _scale(problem, before):
            break
    return space.from_unit(point[None])[0], loss, evaluations


def _descend(losses: Callable[[np.ndarray], np.ndarray], problem: Problem, point: np.ndarray) -> np.ndarray:
    """Return the nearest minimum within the space's limits and the actuators' clearance, by SLSQP."""
    space = problem.space
    limits = np.stack([space.to_unit(space.lower), space.to_unit(space.upper)], axis=1)
    scale = _scale(problem, float(losses(point[None])[0]))

    def loss_and_slope(at: np.ndarray) -> tuple[float, np.ndarray]:
        steps = np.where(at + STEP <= limits[:, 1], STEP, -STEP)
        values = losses(at + np.concatenate([np.zeros((1, at.size)), np.diag(steps)])) / scale
        return float(values[0]), (values[1:] - values[0]) / steps

    result = scipy.optimize.minimize(
        loss_and_slope,
        point,
        jac=True,
        method="SLSQP",
        bounds=limits,
        constraints=_clearance(problem, point),
        options={"maxiter": MOST_STEPS, "ftol": TOLERANCE},
    )
    return np.asarray(np.clip(result.x, *limits.T))


def _scale(problem: Problem, loss: float) -> float:
    """Return the size to which tolerances of a loss refer."""
    return max(abs(loss), loss_scale(problem.objectives.terms), 1e-300)


def _clearance(problem: Problem, point: np.ndarray) -> list[scipy.optimize.LinearConstraint]:
    """Return the clearance of the actuators, each on the side of the others where it is now; none if none moves."""
    centre = problem.searched.designs(problem.space.from_unit(point[None])).centre
    if centre is None:
        return []
    matrix, least = problem.clearance.constraints(centre[0])
    of_point = np.zeros((len(matrix), len(point)))
    for column, variable in enumerate(problem.searched.variables):
        if variable.kind in ("x", "y"):
            of_centre = matrix[:, 2 * variable.actuators[0] + (variable.kind == "y")]
            of_point[:, column] = of_centre * problem.space.span[column]
    return [scipy.optimize.LinearConstraint(of_point, least - matrix @ centre[0].ravel() + of_point @ point)]


def _best_frequency(losses: Callable[[np.ndarray], np.ndarray], problem: Problem, point: np.ndarray) -> np.ndarray:
    """Return the point with the best frequency of the result's spectrum; unchanged if it has none."""
    frequencies = spectrum_frequencies(problem)
    kinds = [variable.kind for variable in problem.searched.variables]
    if not frequencies.size:
        return point
    points = np.tile(problem.space.from_unit(point[None]), (frequencies.size, 1))
    points[:, kinds.index("frequency")] = frequencies
    points = problem.space.to_unit(points)
    return np.asarray(points[int(np.nanargmin(losses(points)))])
