"""Searches for the targets of a scene, from a checkpoint to the end or until Ctrl-C, and the cases of their drives."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.modal.solver import MODAL
from warp_plate.optimize.optimizer import MethodError, Optimizer, minimize
from warp_plate.optimize.quadratic import best_position
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.evaluate_cases import EvaluatedCases, evaluate_cases, reference_phasors
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.problem.uncertainty import draw_scenarios, simulate_scenarios
from warp_plate.result.case import Case, target_cases, target_regions
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import RobustComparison, TargetSearch
from warp_plate.scene.errors import SceneError
from warp_plate.studies.polish import polish
from warp_plate.studies.unfinished import CheckpointFile

# Called after each iteration with the iterations done, their total, and the best localization factor so far, or the
# best weighted sum of the objectives.
OnProgress = Callable[[int, int, float], object]


def run_search(
    start: Checkpoint,
    problem: Problem,
    on_progress: OnProgress | None = None,
    checkpoints: CheckpointFile | None = None,
) -> tuple[Optimizer | None, bool]:
    """Run a search; return its optimizer, None if there is nothing to search, and whether Ctrl-C ended it.

    ``problem`` is that of the checkpoint's scene. Checkpoints are written at intervals, and when Ctrl-C or an error
    ends the search.
    """
    if start.search_state is None:
        return None, False
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
    except SecondInterrupt:  # the optimizer may be half updated, so only an earlier checkpoint is valid
        raise
    except KeyboardInterrupt:
        save()
        return optimizer, True
    except Exception:  # such as WorkersGone
        save()
        raise
    return optimizer, False


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


def find_position(problem: Problem, seed: int) -> np.ndarray | None:
    """Return the position (dimension,) that a search finds; None if there is nothing to search or nothing is found."""
    optimizer = search_optimizer(problem, seed)
    if optimizer is not None:
        minimize(optimizer, problem.losses)
    return finish_search(optimizer, problem, find_nominal_position(problem, seed))[0]


def find_nominal_position(problem: Problem, seed: int) -> np.ndarray | None:
    """Return the best position (dimension,) of a robust problem's nominal plate, from the same search without
    uncertainty unless it is known exactly.

    None for other problems, and if that search has no result, is refused or is interrupted.
    """
    if problem.scenario_losses is None:
        return None
    with suppress(KeyboardInterrupt, SceneError):
        nominal = problem.nominal
        with suppress(MethodError):  # it is not known exactly
            return best_position(nominal.space, nominal.quadratic)
        return find_position(nominal, seed)
    return None


def finish_search(
    optimizer: Optimizer | None, problem: Problem, nominal_position: np.ndarray | None, interrupted: bool = False
) -> tuple[np.ndarray | None, int, dict[str, np.ndarray]]:
    """Return the position of all design variables, the evaluations and the history of a search that has ended.

    A search of places, frequencies or delays by modes is followed by a descent; a robust search also tries the nominal
    optimum.
    """
    if optimizer is None:
        return None, 0, {}
    position, evaluations = optimizer.result.xbest, optimizer.result.evaluations
    history = {"evaluations": optimizer.history["evaluations"]}
    history |= {name: np.asarray(problem.value_from_loss(optimizer.history[name])) for name in ("best", "mean")}
    if position is None:
        return None, evaluations, history
    best, further = optimizer.result.fbest, 0
    problem.complete(position)  # refuse places without clearance before the descent
    by_modes = problem.evaluator_name == MODAL and problem.scenario_losses is None
    if by_modes and not problem.parametrization.only_drives and not interrupted:
        position, best, further = polish(problem, position, best)
    elif nominal_position is not None:
        loss = float(problem.losses(nominal_position[None])[0])
        if loss < best:
            position, best, further = nominal_position, loss, 1
    if further:
        evaluations += further
        value = problem.value_from_loss(best)
        row = {"evaluations": evaluations, "best": value, "mean": value}
        history = {name: np.append(column, row[name]) for name, column in history.items()}
    return problem.complete(position), evaluations, history


def initial_state(problem: Problem, seed: int) -> dict[str, Any]:
    """Return the fields of a checkpoint that differ from target to target, before the first iteration."""
    phasors = reference_phasors(problem.scene, problem.plates.energies_of_phasors)
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

        optimizer, interrupted = run_search(start, problem, on_iteration, checkpoints)
        if optimizer is not None and not interrupted:
            nominal_position = find_nominal_position(problem, start.seed)
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
        problem = _with_target(problem, 0)
    return SearchOutcome(start, problem, nominal_position, interrupted)


def _next_problem(problem: Problem, index: int, start: Checkpoint) -> Problem:
    """Return the problem of another target. All targets are regions of every solver, so that Gram matrices hold for
    all, unless an objective needs further regions."""
    scene, matrices = problem.scene.aimed_at(index), None
    if problem.plates.matrices is not None and not problem.objectives.sizes.cells.size:
        regions = problem.drive_solver.regions
        matrices = problem.plates.matrices.reshape(-1, len(regions), *problem.plates.matrices.shape[1:]).copy()
        matrices[:, REGIONS.index("target")] = matrices[:, regions.index(list(target_regions(scene))[index])]
        matrices = matrices.reshape(problem.plates.matrices.shape)
    return make_problem(replace(problem.resolved.with_scene(scene), evaluator=start.evaluator), matrices, problem.pool)


def _with_target(problem: Problem, index: int) -> Problem:
    """Return a problem with another target, for simulating cases only."""
    scene = problem.scene.aimed_at(index)
    resolved, parametrization = problem.resolved.with_scene(scene), replace(problem.parametrization, scene=scene)
    plates = replace(problem.plates, drives=Evaluator(resolved.solver(areas=target_regions(scene))))
    return replace(problem, resolved=resolved, parametrization=parametrization, plates=plates)


def evaluate_targets(problem: Problem, searches: tuple[TargetSearch, ...]) -> EvaluatedCases:
    """Simulate the cases of the first target, and the best drive of every other one."""
    first, *others = searches
    evaluated = evaluate_cases(problem, first.single_actuator, first.position)
    cases, node_steps = dict(evaluated.cases), evaluated.node_steps
    names = list(target_cases(problem.scene).values())[1:]
    for index, (name, search) in enumerate(zip(names, others, strict=False), 1):  # fewer after Ctrl-C
        other = _with_target(problem, index)
        more = evaluate_cases(other, search.single_actuator, search.position)
        cases[name] = more.cases["best"]
        node_steps += other.drive_solver.node_steps + more.node_steps
    return replace(evaluated, cases=cases, node_steps=node_steps)


def compare_with_nominal(
    problem: Problem, single_actuator: int, position: np.ndarray, nominal_position: np.ndarray
) -> tuple[RobustComparison, dict[str, Case], int]:
    """Compare the position (dimension,) of a robust search with the best one of the nominal plate.

    Both drives are simulated, as two plates of one launch, in each of ``search.robust.fresh`` new scenarios.

    Returns:
        The comparison, the nominal drive as the case "nominal", and the node-steps besides those of the problem.
    """
    nominal, table = problem.nominal, problem.robust
    evaluated = evaluate_cases(nominal, single_actuator, nominal_position)
    designs = problem.parametrization.designs(np.stack([position, nominal_position]))
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
