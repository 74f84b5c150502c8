"""One search after the other for the several targets of a scene; a single one where it has one target.

All targets are regions of every solver, so that the Gram matrices of one search hold for all; only where an objective
has regions of its own (uniformity) the next search measures them again.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.evaluate_cases import EvaluatedCases, evaluate_cases, reference_phasors
from warp_plate.problem.problem import Problem, make_nominal_problem
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.crosstalk import target_cases, target_regions
from warp_plate.result.model import Case, TargetSearch
from warp_plate.solve.solver import PlateSolver
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.studies.driver import OnProgress, history_of, run_search, searcher_of


@dataclass(frozen=True)
class Searched:
    """found: of each target that was come to; problem: aimed at the first target; interrupted: whether Ctrl-C ended the
    last; node_steps, seconds, lost: of all, with those of the checkpoint that it began from."""

    found: tuple[TargetSearch, ...]
    problem: Problem
    interrupted: bool
    node_steps: int
    seconds: Mapping[str, float]
    lost: Mapping[str, int]


def run_searches(
    begun: Checkpoint, problem: Problem, on_progress: OnProgress | None, checkpoints: CheckpointFile | None
) -> Searched:
    """From a checkpoint, which says which targets were searched before, to the end of the last or to Ctrl-C.

    Args and errors: see :func:`run_search`; ``problem`` is aimed at the target that is searched first here.
    """
    count = max(len(problem.scene.targets), 1)
    while True:
        started, first_steps = time.perf_counter(), problem.node_steps
        searcher, interrupted = run_search(
            begun, problem, _of_all(on_progress, len(begun.finished_searches), count), checkpoints
        )
        position = None if searcher is None else searcher.result.xbest
        one = TargetSearch(
            position=position,
            single_actuator=begun.single_actuator,
            bound=problem.bound,
            bound_kind=problem.bound_kind,
            evaluations=0 if searcher is None else searcher.result.evaluations,
            history=history_of(searcher, problem),
            objective_values={} if position is None else problem.objective_values(position),
        )
        found = (*begun.finished_searches, one)
        node_steps = begun.node_steps + problem.node_steps - first_steps
        lost = dict(Counter(begun.lost_plates) + problem.lost)
        last = interrupted or len(found) == count
        if not last:
            problem = _next(problem, len(found), begun)
            drives = reference_phasors(problem.scene, problem.energies_of_phasors)
            searcher = searcher_of(problem, begun.seed)
        spent = begun.seconds.get("solve", 0.0) + time.perf_counter() - started
        seconds = {**begun.seconds, "solve": spent}
        if last:
            aimed = _aimed(problem, 0) if count > 1 else problem
            return Searched(found, aimed, interrupted, node_steps, seconds, lost)
        begun = replace(
            begun,
            scene=problem.scene,
            single_actuator=int(np.argmax(np.abs(drives["single"]))),
            matrices=problem.matrices,
            search_state=None if searcher is None else searcher.state(),
            finished_searches=found,
            seconds=seconds,
            node_steps=node_steps + problem.node_steps,
            lost_plates=lost,
        )


def runs_of_all(searched: Searched) -> EvaluatedCases:
    """The last runs of the first target, with the cases of the best drives for the others."""
    problem, (first, *others) = searched.problem, searched.found
    runs, node_steps = evaluate_cases(problem, first.single_actuator, first.position), 0
    cases: dict[str, Case] = {}
    for index, (one, name) in enumerate(zip(others, list(target_cases(problem.scene).values())[1:], strict=False)):
        aimed = _aimed(problem, index + 1)
        before = aimed.drive_solver.node_steps
        more = evaluate_cases(aimed, one.single_actuator, one.position)
        cases[name] = more.cases["best"]
        node_steps += aimed.drive_solver.node_steps - before + more.node_steps
    return replace(runs, cases={**runs.cases, **cases}, node_steps=runs.node_steps + node_steps)


def _next(problem: Problem, index: int, begun: Checkpoint) -> Problem:
    """The problem of another target."""
    scene, matrices = problem.scene.aimed_at(index), None
    if problem.matrices is not None and not problem.objectives.cells.size:
        regions = problem.drive_solver.specialized.regions
        matrices = problem.matrices.reshape(-1, len(regions), *problem.matrices.shape[1:]).copy()
        matrices[:, REGIONS.index("target")] = matrices[:, regions.index(list(target_regions(scene))[index])]
        matrices = matrices.reshape(problem.matrices.shape)
    return make_nominal_problem(
        scene, problem.drive_solver.device.alias, begun.path, begun.evaluator, matrices, problem.pool
    )


def _aimed(problem: Problem, index: int) -> Problem:
    """For last runs: what is searched and its plates, with another target."""
    scene = problem.scene.aimed_at(index)
    solver = PlateSolver(scene, problem.drive_solver.device.alias, problem.path, areas=target_regions(scene))
    aimed = replace(problem.parametrization, scene=scene)
    return replace(problem, parametrization=aimed, drive_evaluator=Evaluator(solver))


def _of_all(on_progress: OnProgress | None, before: int, count: int) -> OnProgress | None:
    """Told of one search, as a part of all."""
    if on_progress is None or count == 1:
        return on_progress

    def of_all(done: int, total: int, best: float) -> None:
        on_progress(before * total + done, count * total, best)

    return of_all
