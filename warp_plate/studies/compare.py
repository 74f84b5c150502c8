"""Several search methods on one problem: each from several seeds, with the same number of evaluations."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from warp_plate.cluster.pool import WorkerPool, WorkersGone
from warp_plate.interrupts import check_interrupt, deferred_interrupts
from warp_plate.optimize.optimizer import Optimizer
from warp_plate.problem.bounds import NEAR, Bound
from warp_plate.problem.methods import make_optimizer, with_method
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.resolve import EvaluatorName, resolve
from warp_plate.result.comparison import MethodComparison, Trial
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.studies.unfinished import devices_text, versions

METHODS = ("pso", "constriction", "ring", "cma", "gradient", "exact")
# Methods that find the same from every seed.
SEEDLESS = ("exact",)
# Called during a trial with the evaluations done, their total, and the method and seed.
OnTrialProgress = Callable[[int, int, str], object]


def compare(
    scene: SceneSource,
    *,
    source: str = "",
    methods: Sequence[str] | None = None,
    seeds: int = 10,
    device: str = "auto",
    path: str = "auto",
    evaluator: EvaluatorName | None = None,
    evaluations: int | None = None,
    on_progress: OnTrialProgress | None = None,
    pool: WorkerPool | None = None,
) -> MethodComparison:
    """Run every method from every seed, in alternation so that disturbances of the machine affect all methods.

    Ctrl-C and the loss of all workers keep the finished trials. The seconds of a trial are those of its optimizer and
    its losses, after one iteration of each method that does not count. The time of the Gram matrices is stored
    separately.

    Args:
        methods: some of METHODS (default: all that fit the scene).
        seeds: number of seeds, from the scene's own on.
        evaluator: see ``localize`` (default: "modal" as there, otherwise "response" if it applies, or "direct").
        evaluations: evaluations of each trial (default: the scene's particles × iterations).
        device, path, on_progress, pool: see ``localize``.

    Raises:
        SceneError: a named method does not fit the scene, or the scene cannot be searched with this number of
            evaluations.
        KeyboardInterrupt: Ctrl-C came before the first trial was finished.
    """
    scene = Scene.load(scene)
    if evaluations is not None:
        particles = scene.search.particles
        if evaluations < particles:
            at_once = f"search.particles = {particles}, which are evaluated at once"
            raise SceneError(f"--evaluations {evaluations}: must be at least {at_once}")
        search = scene.search.model_copy(update={"iterations": evaluations // particles})
        scene = scene.model_copy(update={"search": search})
    resolved = resolve(with_method(scene), device, purpose="search", path=path, evaluator=evaluator)
    started = time.perf_counter()
    problem = make_problem(resolved, pool=pool)
    prepared = time.perf_counter() - started - problem.compile_seconds
    if evaluator is None and problem.evaluator_name == "direct" and problem.response is not None:
        problem = problem.by_matrices
    if not problem.space.dimension:
        raise SceneError("actuators: a single one leaves nothing to search, so there is nothing to compare")
    fitting, skipped = _fitting_methods(methods, problem)
    fields = _run_trials(fitting, seeds, problem, on_progress)
    if (bound := problem.loss_bound) is not None:
        sentence = bound.sentence + _of_common_phase(problem, bound)
        fields |= {"bound": bound.value, "bound_kind": bound.kind, "bound_sentence": sentence}
    return MethodComparison(
        source=source,
        scene=problem.scene,
        device=devices_text(problem),
        evaluator=problem.evaluator_name,
        seconds={"prepare": prepared},
        localization=problem.objectives.only_localization,
        skipped=skipped,
        versions=versions(),
        **fields,
    )


def _of_common_phase(problem: Problem, bound: Bound) -> str:
    """Return the value for drives with a free first phase, if the searches fix it and lose by it."""
    if problem.bound is None or problem.bound_kind != "attained" or problem.bound <= 1 - bound.value + NEAR:
        return ""
    return f". They hold the first phase at 0; free, it reaches {problem.bound:.6f} (localize, method = 'exact')"


def _fitting_methods(methods: Sequence[str] | None, problem: Problem) -> tuple[list[str], dict[str, str]]:
    """Return the methods to try, and why others are left out, by their names."""
    fitting, skipped = [], {}
    for method in dict.fromkeys(methods or METHODS):
        if method not in METHODS:
            raise SceneError(f"--methods {method}: no such method; choose from {', '.join(METHODS)}")
        try:
            _optimizer(method, problem.scene.search.seed, problem)
            fitting.append(method)
        except SceneError as error:
            if methods:
                raise
            skipped[method] = str(error)
    return fitting, skipped


def _run_trials(
    methods: Sequence[str], seeds: int, problem: Problem, on_progress: OnTrialProgress | None
) -> dict[str, Any]:
    """Run all trials; return the budget, the finished ones, whether they were interrupted, and the plates lost."""
    search, trials, interrupted, lost = problem.scene.search, list[Trial](), False, dict[str, int]()
    budget = search.particles * search.iterations
    pairs = [(method, index) for index in range(seeds) for method in methods if index == 0 or method not in SEEDLESS]
    try:
        for method in methods:  # one-time compilation and allocation are not counted for the first trial
            _run_trial(method, search.seed, problem, 1)
        for number, (method, index) in enumerate(pairs):
            seed = search.seed + index

            def report(done: int, before: int = number * budget, note: str = f"{method}, seed {seed}") -> None:
                if on_progress is not None:
                    on_progress(before + done, len(pairs) * budget, note)

            trials.append(_run_trial(method, seed, problem, budget, report))
    except (KeyboardInterrupt, WorkersGone) as reason:
        if not trials:
            raise
        interrupted, lost = True, {str(reason): search.particles} if isinstance(reason, WorkersGone) else {}
    return {
        "budget": budget,
        "trials": tuple(sorted(trials, key=lambda trial: (methods.index(trial.method), trial.seed))),
        "interrupted": interrupted,
        "lost_plates": dict(problem.lost) | lost,
    }


def _run_trial(
    method: str, seed: int, problem: Problem, budget: int, on_progress: Callable[[int], None] = lambda done: None
) -> Trial:
    """Run one method from one seed until it stops or has used up its evaluations."""
    evaluated, rows, best = 0, [], np.inf
    started = time.perf_counter()
    optimizer = _optimizer(method, seed, problem)
    spent = time.perf_counter() - started
    with deferred_interrupts():
        while not optimizer.stop() and evaluated < budget:
            started = time.perf_counter()
            positions = optimizer.ask()
            losses = problem.losses(positions)
            optimizer.tell(positions, losses)
            spent += time.perf_counter() - started
            evaluated += len(positions)
            best = min(best, float(np.min(losses, initial=np.inf, where=np.isfinite(losses))))
            rows.append((evaluated, spent, best))
            on_progress(evaluated)
            check_interrupt()
    evaluations, seconds, losses = np.array(rows, dtype=float).T
    return Trial(method, seed, evaluations.astype(int), seconds, losses)


def _optimizer(method: str, seed: int, problem: Problem) -> Optimizer:
    search = problem.scene.search.model_copy(update={"method": method})
    return make_optimizer(search, problem.space, seed, problem.quadratic, slopes=problem.slopes)
