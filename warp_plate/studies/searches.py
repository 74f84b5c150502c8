"""Searches for the targets of a scene, from a checkpoint to the end or until Ctrl-C, and the cases of their drives."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.optimize.optimizer import Optimizer, minimize
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.evaluate_cases import EvaluatedCases, evaluate_cases, reference_phasors
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import TargetSearch
from warp_plate.result.targets import target_cases, target_regions
from warp_plate.scene.errors import SceneError
from warp_plate.studies.polish import NominalSearch, finish_search, search_optimizer
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
    """The end of the searches for all targets of a scene.

    Attributes:
        checkpoint: Last checkpoint.
        problem: Problem of the first target.
        nominal: Search for its nominal plate's best position.
        interrupted: True if Ctrl-C ended the last search.
    """

    checkpoint: Checkpoint
    problem: Problem
    nominal: NominalSearch
    interrupted: bool


def search_targets(
    start: Checkpoint, problem: Problem, on_progress: OnProgress | None, checkpoints: CheckpointFile | None
) -> SearchOutcome:
    """Search the remaining targets."""
    count, first, interrupted = max(len(problem.scene.targets), 1), len(start.finished_searches), False
    nominal = NominalSearch(problem, start.seed)
    for index in range(first, count):
        started = time.perf_counter()
        if index > first:
            problem = _next_problem(problem, index, start)
            nominal = NominalSearch(problem, start.seed)
            start = replace(start, **initial_state(problem, start.seed))
            start = replace(start, node_steps=start.node_steps + problem.node_steps)
        first_steps = problem.node_steps

        def on_iteration(iterations: int, total: int, best: float, before: int = index) -> None:
            if on_progress is not None:
                on_progress(before * total + iterations, count * total, best)

        optimizer, interrupted = run_search(start, problem, on_iteration, checkpoints)
        position, evaluations, history = finish_search(optimizer, nominal, interrupted)
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
        nominal = NominalSearch(problem, start.seed)
    return SearchOutcome(start, problem, nominal, interrupted)


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
