"""Searches for the targets of a scene, from a checkpoint to the end or until Ctrl-C, and descents from their ends."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.modal.solver import MODAL
from warp_plate.optimize.optimizer import MethodError, Optimizer, minimize, minimum_near
from warp_plate.optimize.quadratic import ExactSearch, best_position
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.design_variables import single_drives
from warp_plate.problem.evaluate_cases import reference_phasors
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.objectives import loss_scale
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.problem.starts import BRENT_STEPS, candidate_frequencies
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import TargetSearch
from warp_plate.scene.errors import SceneError
from warp_plate.scene.search import SWARMS
from warp_plate.studies.spectrum import spectrum_frequencies
from warp_plate.studies.unfinished import CheckpointFile

# Called after each iteration with the iterations done, their total, and the best localization factor so far, or the
# best weighted sum of the objectives.
OnProgress = Callable[[int, int, float], object]
# Differences for slopes of descents, in initial ranges.
STEP = 1e-6
# A descent ends where a step gains less, and the search where a round of descents does, as a part of the loss's scale.
TOLERANCE, GAIN = 1e-10, 1e-7
MOST_STEPS, MOST_ROUNDS = 40, 5
# Error of the best frequency, as a part of it.
FREQUENCY_TOLERANCE = 1e-8


def run_search(
    start: Checkpoint,
    problem: Problem,
    on_progress: OnProgress | None = None,
    checkpoints: CheckpointFile | None = None,
) -> tuple[Optimizer | None, np.ndarray | None, bool]:
    """Run a search; return its optimizer, None if there is nothing to search, the best position of a robust problem's
    nominal plate, and whether Ctrl-C ended it."""
    if start.search_state is None:
        return None, None, False
    optimizer = search_optimizer(problem, start.seed, start.search_state)
    if optimizer is None:
        raise SceneError("checkpoint: holds the state of a search, but its scene leaves nothing to search")
    started, first_steps = time.perf_counter(), problem.node_steps
    # Costs up to the last complete iteration: an interrupted one is repeated when the search is resumed.
    node_steps, lost = first_steps, problem.lost

    def save() -> None:
        if checkpoints is None:
            return
        seconds = start.seconds.get("solve", 0.0) + time.perf_counter() - started
        checkpoints.save(
            replace(
                start,
                search_state=optimizer.state(),
                seconds={**start.seconds, "solve": seconds},
                node_steps=start.node_steps + node_steps - first_steps,
                lost_plates=dict(Counter(start.lost_plates) + lost),
            )
        )

    def after_iteration(optimizer: Optimizer) -> None:
        nonlocal node_steps, lost
        node_steps, lost = problem.node_steps, problem.lost
        if checkpoints is not None and checkpoints.due():
            save()
        if on_progress is not None:
            best = float(problem.value_from_loss(optimizer.result.fbest))
            on_progress(optimizer.iterations, start.scene.search.iterations, best)
        check_interrupt()

    try:
        with deferred_interrupts():
            if checkpoints is not None and checkpoints.due():
                save()
            minimize(optimizer, problem.losses, after_iteration)
        return optimizer, find_nominal_position(problem, start.seed), False
    except SecondInterrupt:  # the optimizer may be half updated, so only an earlier checkpoint is valid
        raise
    except KeyboardInterrupt:
        save()
        return optimizer, None, True
    except Exception:  # such as WorkersGone
        save()
        raise


def search_optimizer(problem: Problem, seed: int, state: Mapping[str, Any] | None = None) -> Optimizer | None:
    """Return the optimizer of a problem, at its start or in a saved state; None if there is nothing to search."""
    if not problem.space.dimension:
        return None
    try:
        search, slopes = problem.scene.search, problem.slopes
        frequencies = candidate_frequencies(problem.parametrization, problem.plates.designs.solver)
        candidates = None if frequencies is None else frequencies[:, None]
        start = problem.start if candidates is None and not _starts_anywhere(problem) else None
        return make_optimizer(search, problem.space, seed, problem.quadratic, state, slopes, start, candidates)
    except SceneError:
        raise
    except ValueError as error:
        raise SceneError(f"checkpoint: {error}") from None


def _starts_anywhere(problem: Problem) -> bool:
    """Return whether a search is of a swarm that a particle at the scene's own places would hold there: each place has
    its best drive. Those places are then compared at the end."""
    return problem.projected and (problem.scene.search.method or "pso") in SWARMS


def find_position(problem: Problem, seed: int) -> np.ndarray | None:
    """Return the best position (dimension,), exactly where it is known, or by a search; None if there is none."""
    if not problem.space.dimension:
        return None
    with suppress(MethodError):  # a limit or a fixed number keeps the search from the eigenvector
        return best_position(problem.space, problem.quadratic)
    optimizer = search_optimizer(problem, seed)
    if optimizer is not None:
        minimize(optimizer, problem.losses)
    return finish_search(optimizer, problem, find_nominal_position(problem, seed))[0]


def find_nominal_position(problem: Problem, seed: int) -> np.ndarray | None:
    """Return the best position (dimension,) of a robust problem's nominal plate; None if there is none."""
    if problem.scenario_losses is None:
        return None
    with suppress(SceneError):
        return find_position(problem.nominal, seed)
    return None


def finish_search(
    optimizer: Optimizer | None, problem: Problem, nominal_position: np.ndarray | None, interrupted: bool = False
) -> tuple[np.ndarray | None, int, dict[str, np.ndarray]]:
    """Return the position of all design variables, the evaluations and the history of a search that has ended.

    A descent follows one of places, frequencies or delays by modes; a robust search also tries the nominal optimum, and
    one under a ``rest_limit``, at which losses jump, the best drive that is known.
    """
    if optimizer is None:
        return None, 0, {}
    position, evaluations = optimizer.result.xbest, optimizer.result.evaluations
    history = {"evaluations": optimizer.history["evaluations"]}
    history |= {name: np.asarray(problem.value_from_loss(optimizer.history[name])) for name in ("best", "mean")}
    if position is None:
        return None, evaluations, history
    best, further = optimizer.result.fbest, 0
    if _starts_anywhere(problem) and problem.start is not None:
        at_start, further = float(problem.losses(problem.start[None])[0]), 1
        position, best = (problem.start, at_start) if at_start < best else (position, best)
    problem.complete(position)  # refuse places without clearance before the descent
    by_modes = problem.evaluator_name == MODAL and problem.scenario_losses is None
    if by_modes and not problem.parametrization.only_drives and not interrupted:
        if isinstance(optimizer, ExactSearch):
            position, best, more = _refine(problem, position, best, optimizer.positions[:, 0])
        else:
            position, best, more = polish(problem, position, best)
        further += more
    elif nominal_position is not None or problem.objectives.limits or problem.objectives.region_limits:
        other = problem.with_best_drive(position) if nominal_position is None else nominal_position
        loss = float(problem.losses(other[None])[0])
        if loss < best:
            position, best, further = other, loss, further + 1
    history = with_further_evaluations(problem, history, further, best)
    return problem.complete(position), evaluations + further, history


def with_further_evaluations(
    problem: Problem, history: Mapping[str, np.ndarray], further: int, loss: float
) -> dict[str, np.ndarray]:
    """Return a history with a row for further evaluations, if there were any, and the loss that they ended with."""
    value = problem.value_from_loss(loss)
    row = {"evaluations": further + int(history["evaluations"][-1]), "best": value, "mean": value}
    return {name: np.append(column, row[name]) if further else column for name, column in history.items()}


def initial_state(problem: Problem, seed: int) -> dict[str, Any]:
    """Return the fields of a checkpoint that differ from target to target, before the first iteration."""
    phasors = reference_phasors(single_drives(problem.scene), problem.plates.energies_of_phasors)
    optimizer = search_optimizer(problem, seed)
    return {
        "scene": problem.scene,
        "single_actuator": int(np.argmax(np.abs(phasors["single"]))),
        "matrices": problem.plates.matrices,
        "search_state": None if optimizer is None else optimizer.state(),
    }


@dataclass(frozen=True)
class SearchOutcome:
    """The end of the searches for all targets of a scene."""

    checkpoint: Checkpoint  # last one
    problem: Problem  # of the first target
    nominal_position: np.ndarray | None  # best position of a robust problem's nominal plate
    interrupted: bool  # True if Ctrl-C ended the last search


def search_targets(
    start: Checkpoint, problem: Problem, on_progress: OnProgress | None, checkpoints: CheckpointFile | None
) -> SearchOutcome:
    """Search the remaining targets."""
    count, first, interrupted = max(len(problem.scene.targets), 1), len(start.finished_searches), False
    nominal_position = None
    for index in range(first, count):
        started = time.perf_counter()
        if index > first:
            problem = _next_problem(problem, index, start)
            start = replace(start, **initial_state(problem, start.seed))
            start = replace(start, node_steps=start.node_steps + problem.node_steps)
        first_steps = problem.node_steps

        def on_iteration(iterations: int, total: int, best: float, before: int = index) -> None:
            if on_progress is not None:
                on_progress(before * total + iterations, count * total, best)

        optimizer, nominal_position, interrupted = run_search(start, problem, on_iteration, checkpoints)
        position, evaluations, history = finish_search(optimizer, problem, nominal_position, interrupted)
        search = TargetSearch(
            position=position,
            single_actuator=start.single_actuator,
            bound=problem.bound,
            bound_kind=problem.bound_kind,
            evaluations=evaluations,
            history=history,
            objective_values={} if position is None else problem.objective_values(position),
        )
        solve = start.seconds.get("solve", 0.0) + time.perf_counter() - started
        start = replace(
            start,
            finished_searches=(*start.finished_searches, search),
            node_steps=start.node_steps + problem.node_steps - first_steps,
            seconds={**start.seconds, "solve": solve},
            lost_plates=dict(Counter(start.lost_plates) + problem.lost),
        )
        if interrupted:
            break
    if count > 1:
        problem = with_target(problem, 0)
    return SearchOutcome(start, problem, nominal_position, interrupted)


def _next_problem(problem: Problem, index: int, start: Checkpoint) -> Problem:
    """Return the problem of another target. All targets are regions of every solver, so that Gram matrices hold for
    all, unless an objective needs further regions."""
    scene, matrices = problem.scene.aimed_at(index), None
    if problem.plates.matrices is not None and not problem.objectives.sizes.cells.size:
        regions = problem.drive_solver.regions
        matrices = problem.plates.matrices.reshape(-1, len(regions), *problem.plates.matrices.shape[1:]).copy()
        matrices[:, REGIONS.index("target")] = matrices[:, regions.index(list(scene.target_regions)[index])]
        matrices = matrices.reshape(problem.plates.matrices.shape)
    return make_problem(replace(problem.resolved.with_scene(scene), evaluator=start.evaluator), matrices, problem.pool)


def with_target(problem: Problem, index: int) -> Problem:
    """Return a problem with another target, for simulating cases only."""
    scene = problem.scene.aimed_at(index)
    resolved, parametrization = problem.resolved.with_scene(scene), replace(problem.parametrization, scene=scene)
    plates = replace(problem.plates, drives=Evaluator(resolved.solver(areas=scene.target_regions)))
    return replace(problem, resolved=resolved, parametrization=parametrization, plates=plates)


def _refine(problem: Problem, position: np.ndarray, loss: float, tried: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Return the best frequency (1,) near the best of those tried (n,), its loss, and the number of evaluations."""
    at = min(int(np.searchsorted(tried, position[0])), len(tried) - 1)
    place, least, evaluations = minimum_near(
        lambda frequency: float(problem.losses(np.array([[frequency]]))[0]), tried, at, FREQUENCY_TOLERANCE, BRENT_STEPS
    )
    return (np.array([place]), least, evaluations) if least < loss else (position, loss, evaluations)


def polish(
    problem: Problem, position: np.ndarray, loss: float, rounds: int = MOST_ROUNDS
) -> tuple[np.ndarray, float, int]:
    """Return the minimum to which descents from a position of ``problem.space`` lead, its loss, and the evaluations."""
    evaluations, space = 0, problem.space

    def losses(points: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        evaluations += len(points)
        return problem.losses_without_clearance(space.from_unit(points))

    point = space.to_unit(position)
    for _ in range(rounds):
        before = loss
        descended = _descend(losses, problem, point)
        driven = space.to_unit(problem.with_best_drive(space.from_unit(descended[None])[0]))
        for tried in (descended, driven, _best_frequency(losses, problem, descended)):
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
