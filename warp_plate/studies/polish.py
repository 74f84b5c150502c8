"""The end of a search: local refinement by modes; for robust searches, a comparison with the nominal plate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from warp_plate.modal.solver import MODAL
from warp_plate.optimize.optimizer import MethodError, Optimizer, minimize
from warp_plate.optimize.quadratic import best_position
from warp_plate.problem.evaluate_cases import evaluate_cases
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.objectives import loss_scale
from warp_plate.problem.problem import Problem
from warp_plate.problem.scenario_losses import simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.case import Case
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import RobustComparison
from warp_plate.scene.errors import SceneError
from warp_plate.studies.spectrum import spectrum_frequencies

# Differences for slopes, in initial ranges.
STEP = 1e-6
# A descent ends where a step gains less, and the search where a round of descents does, as a part of the loss's scale.
TOLERANCE, GAIN = 1e-10, 1e-7
MOST_STEPS, MOST_ROUNDS = 40, 5


class Polished(NamedTuple):
    """A position, its loss, and the number of evaluations that they took."""

    position: np.ndarray
    loss: float
    evaluations: int


def search_optimizer(problem: Problem, seed: int, state: Mapping[str, Any] | None = None) -> Optimizer | None:
    """Return the optimizer of a problem, at its start or in a saved state; None if there is nothing to search."""
    if not problem.space.dimension:
        return None
    try:
        return make_optimizer(problem.scene.search, problem.space, seed, problem.quadratic, state, problem.slopes)
    except SceneError:
        raise
    except ValueError as error:
        raise SceneError(f"checkpoint: {error}") from None


def history_of(optimizer: Optimizer | None, problem: Problem) -> dict[str, np.ndarray]:
    """Return the evaluations, and the best and mean values, after each iteration; empty without a search."""
    if optimizer is None:
        return {}
    history = optimizer.history
    values = {name: np.asarray(problem.value_from_loss(history[name])) for name in ("best", "mean")}
    return {"evaluations": history["evaluations"], **values}


def finish_search(
    optimizer: Optimizer | None, nominal: NominalSearch, interrupted: bool = False
) -> tuple[np.ndarray | None, int, dict[str, np.ndarray]]:
    """Return the position of all design variables, the evaluations and the history of a search that has ended.

    A search of places, frequencies or delays by modes is followed by a descent; a robust search also tries the nominal
    optimum.
    """
    problem = nominal.problem
    history = history_of(optimizer, problem)
    if optimizer is None or optimizer.result.xbest is None:
        return None, 0 if optimizer is None else optimizer.result.evaluations, history
    position, evaluations = optimizer.result.xbest, optimizer.result.evaluations
    complete = problem.complete(position)
    by_modes = problem.evaluator_name == MODAL and problem.scenario_losses is None
    polished = None
    if by_modes and not problem.parametrization.only_drives and not interrupted:
        polished = polish(problem, position, optimizer.result.fbest)
    elif problem.scenario_losses is not None and not interrupted and nominal.position is not None:
        loss = float(problem.losses(nominal.position[None])[0])
        if loss < optimizer.result.fbest:
            polished = Polished(nominal.position, loss, 1)
    if polished is not None:
        evaluations += polished.evaluations
        value = problem.value_from_loss(polished.loss)
        row = {"evaluations": evaluations, "best": value, "mean": value}
        history = {name: np.append(column, row[name]) for name, column in history.items()}
        complete = problem.complete(polished.position)
    return complete, evaluations, history


@dataclass(frozen=True, eq=False)
class NominalSearch:
    """Search for the best position of a robust problem's nominal plate, which runs once if it is needed."""

    problem: Problem
    seed: int

    @cached_property
    def position(self) -> np.ndarray | None:
        """Best position (dimension,): the exact one if it is known, else that of the same search without uncertainty;
        None if that search has no result, is refused or is interrupted."""
        with suppress(KeyboardInterrupt, SceneError):
            return _search_nominal(self.problem.nominal, self.seed)
        return None


def _search_nominal(nominal: Problem, seed: int) -> np.ndarray | None:
    with suppress(MethodError):  # it is not known exactly
        return best_position(nominal.space, nominal.quadratic)
    optimizer = search_optimizer(nominal, seed)
    if optimizer is not None:
        minimize(optimizer, nominal.losses)
    return finish_search(optimizer, NominalSearch(nominal, seed))[0]


def polish(problem: Problem, position: np.ndarray, loss: float) -> Polished:
    """Return the minimum to which a descent from a position of ``problem.space`` leads.

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


def compare_with_nominal(
    problem: Problem, start: Checkpoint, position: np.ndarray, nominal_search: NominalSearch
) -> tuple[RobustComparison, dict[str, Case], int] | None:
    """Compare the position (dimension,) of a robust search with the best one of the nominal plate.

    Both drives are then simulated, as two plates of one launch, in
    each of ``search.robust.fresh`` new scenarios.

    Returns:
        The comparison, the nominal drive as the case "nominal", and the node-steps besides those of the problem; None
        without a nominal position.
    """
    nominal, table = problem.nominal, problem.robust
    best = nominal_search.position
    if best is None:
        return None
    evaluated = evaluate_cases(nominal, start.single_actuator, best)
    designs = problem.parametrization.designs(np.stack([position, best]))
    losses, node_steps = [], evaluated.node_steps
    stepped = not problem.resolved.by_modes
    for scenario in draw_scenarios(problem.scene, table.fresh, table.seed, validation=True, stepped=stepped):
        panel = simulate_scenarios([scenario], problem.resolved)
        losses.append(panel.losses(designs)[:, 0])
        node_steps += sum(evaluator.node_steps for evaluator in panel.evaluators)
    bound = problem.loss_bound
    comparison = RobustComparison(
        measure=f"quantile {table.quantile:g}" if table.measure == "quantile" else table.measure,
        scenarios=table.scenarios,
        localization=problem.objectives.only_localization,
        bound=None if bound is None else float(problem.value_from_loss(bound.value)),
        searched=np.asarray(problem.value_from_loss(problem.design_losses(designs))),
        nominal_plate=np.asarray(problem.value_from_loss(nominal.design_losses(designs))),
        validation=np.asarray(problem.value_from_loss(np.stack(losses, axis=1))),
    )
    return comparison, {"nominal": evaluated.cases["best"]}, node_steps
