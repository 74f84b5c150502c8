"""Searches for the targets of a scene, one after the other, and the cases of the drives found."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.modal.solver import make_solver
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.evaluate_cases import EvaluatedCases, evaluate_cases, reference_phasors
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import TargetSearch
from warp_plate.result.targets import target_cases, target_regions
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.studies.driver import OnProgress, run_search, search_optimizer
from warp_plate.studies.polish import finish_search


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


def search_targets(
    start: Checkpoint, problem: Problem, on_progress: OnProgress | None, checkpoints: CheckpointFile | None
) -> tuple[Checkpoint, Problem, bool]:
    """Search the remaining targets; return the last checkpoint, the first target's problem, and whether Ctrl-C came."""
    count, first, interrupted = max(len(problem.scene.targets), 1), len(start.finished_searches), False
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
        position, evaluations, history = finish_search(optimizer, problem, start.seed, interrupted)
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
    return start, _with_target(problem, 0) if count > 1 else problem, interrupted


def _next_problem(problem: Problem, index: int, start: Checkpoint) -> Problem:
    """Return the problem of another target. All targets are regions of every solver, so that Gram matrices hold for
    all, unless an objective needs further regions."""
    scene, matrices = problem.scene.aimed_at(index), None
    if problem.plates.matrices is not None and not problem.objectives.sizes.cells.size:
        regions = problem.drive_solver.regions
        matrices = problem.plates.matrices.reshape(-1, len(regions), *problem.plates.matrices.shape[1:]).copy()
        matrices[:, REGIONS.index("target")] = matrices[:, regions.index(list(target_regions(scene))[index])]
        matrices = matrices.reshape(problem.plates.matrices.shape)
    device = problem.drive_solver.device.alias
    return make_problem(scene, device, start.path, start.evaluator, matrices, problem.pool)


def _with_target(problem: Problem, index: int) -> Problem:
    """Return a problem with another target, for simulating cases only."""
    scene = problem.scene.aimed_at(index)
    solver = make_solver(scene, problem.drive_solver.device.alias, problem.path, areas=target_regions(scene))
    parametrization = replace(problem.parametrization, scene=scene)
    return replace(problem, parametrization=parametrization, plates=replace(problem.plates, drives=Evaluator(solver)))


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
