"""The end of a search: by modes, from the best position down to the nearest minimum; of a robust one, the best position
of the nominal plate if that is better."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import scipy

from warp_plate.modal.solver import MODAL
from warp_plate.optimize.optimizer import MethodError, Optimizer, minimize
from warp_plate.optimize.quadratic import best_position
from warp_plate.problem.objectives import loss_scale
from warp_plate.problem.problem import Problem
from warp_plate.scene.errors import SceneError
from warp_plate.studies.driver import history_of, search_optimizer
from warp_plate.studies.spectrum import spectrum_frequencies

# Differences for slopes, in initial ranges.
STEP = 1e-6
# A descent ends where a step gains less, and the search where a round of descents does, as a part of the loss's scale.
TOLERANCE, GAIN = 1e-10, 1e-7
MOST_STEPS, MOST_ROUNDS = 40, 5
# Nominal positions of the robust problems in use.
_known: WeakKeyDictionary[Problem, np.ndarray | None] = WeakKeyDictionary()


class Polished(NamedTuple):
    """A position, its loss, and the number of evaluations that they took."""

    position: np.ndarray
    loss: float
    evaluations: int


def finish_search(
    optimizer: Optimizer | None, problem: Problem, seed: int, interrupted: bool
) -> tuple[np.ndarray | None, int, dict[str, np.ndarray]]:
    """Return the position of all design variables, the evaluations and the history of a search that has ended.

    Where places, frequencies or delays are searched by modes, a descent follows it. A robust search tries the best
    position of the nominal plate, which takes another search from the same seed if it is not known exactly.
    """
    history = history_of(optimizer, problem)
    if optimizer is None or optimizer.result.xbest is None:
        return None, 0 if optimizer is None else optimizer.result.evaluations, history
    position, evaluations = optimizer.result.xbest, optimizer.result.evaluations
    complete = problem.complete(position)
    by_modes = problem.evaluator_name == MODAL and problem.scenario_losses is None
    polished = None
    if by_modes and not problem.parametrization.only_drives and not interrupted:
        polished = polish(problem, position, optimizer.result.fbest)
    elif problem.scenario_losses is not None and not interrupted:
        polished = _nominal_position(problem, seed, optimizer.result.fbest)
    if polished is not None:
        evaluations += polished.evaluations
        value = problem.value_from_loss(polished.loss)
        row = {"evaluations": evaluations, "best": value, "mean": value}
        history = {name: np.append(column, row[name]) for name, column in history.items()}
        complete = problem.complete(polished.position)
    return complete, evaluations, history


def _nominal_position(problem: Problem, seed: int, loss: float) -> Polished | None:
    """Return the best position of the nominal plate if its loss over the scenarios is less than ``loss``."""
    position = best_nominal(problem, seed)
    if position is None:
        return None
    tried = Polished(position, float(problem.losses(position[None])[0]), 1)
    return tried if tried.loss < loss else None


def best_nominal(problem: Problem, seed: int) -> np.ndarray | None:
    """Return the best position (dimension,) of a robust search's nominal plate: the exact one if it is known, else that
    of the same search without uncertainty.

    It is None if that search finds nothing, is refused or is interrupted, and is found once for a problem.
    """
    if problem not in _known:
        _known[problem] = None
        with suppress(KeyboardInterrupt, SceneError):
            _known[problem] = _search_nominal(problem.nominal, seed)
    return _known[problem]


def _search_nominal(nominal: Problem, seed: int) -> np.ndarray | None:
    with suppress(MethodError):  # it is not known exactly
        return best_position(nominal.space, nominal.quadratic)
    optimizer = search_optimizer(nominal, seed)
    if optimizer is not None:
        minimize(optimizer, nominal.losses)
    return finish_search(optimizer, nominal, seed, interrupted=False)[0]


def polish(problem: Problem, position: np.ndarray, loss: float) -> Polished:
    """Return the minimum to which a descent from a position of ``problem.space`` leads.

    A searched frequency that all actuators have in common also moves to the best of those of the result's spectrum, if
    that is better, so that no neighbouring resonance is missed.
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
    return Polished(space.from_unit(point[None])[0], loss, evaluations)


def _descend(losses: Callable[[np.ndarray], np.ndarray], problem: Problem, point: np.ndarray) -> np.ndarray:
    """Return the nearest minimum within the space's limits and the actuators' clearance, by SLSQP."""
    space = problem.space
    limits = np.stack([space.to_unit(space.lower), space.to_unit(space.upper)], axis=1)
    scale = _scale(problem, float(losses(point[None])[0]))

    def loss_and_slope(at: np.ndarray) -> tuple[float, np.ndarray]:
        steps = np.where(at + STEP <= limits[:, 1], STEP, -STEP)
        values = losses(at + np.concatenate([np.zeros((1, at.size)), np.diag(steps)])) / scale
        return float(values[0]), (values[1:] - values[0]) / steps

    found = scipy.optimize.minimize(
        loss_and_slope,
        point,
        jac=True,
        method="SLSQP",
        bounds=limits,
        constraints=_clearance(problem, point),
        options={"maxiter": MOST_STEPS, "ftol": TOLERANCE},
    )
    return np.asarray(np.clip(found.x, *limits.T))


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
