"""Several methods on one problem: each from several seeds, with the same number of evaluations, on one clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.cluster.pool import Pool, WorkersGone
from warp_plate.interrupts import check_interrupt, deferred_interrupts
from warp_plate.optimize.optimizer import Optimizer
from warp_plate.problem.design_variables import at_highest_frequency
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.problem import EvaluatorName, Problem
from warp_plate.problem.robust import make_problem
from warp_plate.result.comparison import MethodComparison, Trial
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.studies.localize import device_name, of_pool, resolve, versions

METHODS = ("pso", "constriction", "ring", "cma", "gradient", "exact")
# Methods that find the same from every seed.
SEEDLESS = ("exact",)
# Told during a trial: evaluations done, in all, and what is tried.
OnProgress = Callable[[int, int, str], object]


def compare(
    scene: Scene,
    source: str = "",
    methods: Sequence[str] | None = None,
    seeds: int = 10,
    device: str = "auto",
    path: str = "auto",
    evaluator: EvaluatorName | None = None,
    evaluations: int | None = None,
    on_progress: OnProgress | None = None,
    pool: Pool | None = None,
) -> MethodComparison:
    """Run every method from every seed, in turn, so that a disturbance of the machine meets all alike.

    Args:
        methods: of METHODS; left out: all that fit the scene. seeds: how many, from the scene's own on.
        device, path: see :class:`PlateSolver`.
        evaluator: left out: "response" where energies are quadratic forms of the drives, else "direct".
        evaluations: that each trial may make; left out: the scene's particles × iterations.
        on_progress: called after each iteration.
        pool: see ``localize``.

    Ctrl-C ends it, and so does a pool whose workers are gone; the trials that are done are kept. Seconds are those of
    the method's beginning, ``ask``, losses and ``tell``, after each method was warmed by one iteration that does not
    count; what the Gram matrices took, which all share, is kept apart.

    Raises:
        SceneError: a method that was named does not fit the scene; fewer evaluations than particles; see
            :func:`make_problem`.
        KeyboardInterrupt: Ctrl-C before the first trial was done.
    """
    particles = scene.search.particles
    if evaluations is not None and evaluations < particles:
        raise SceneError(
            f"--evaluations {evaluations}: fewer than search.particles = {particles}, which are tried at once; give "
            f"{particles} or more"
        )
    scene = resolve(at_highest_frequency(scene), device)[0].model_copy(update={"actuators": scene.actuators})
    search = scene.search
    if evaluations is not None:
        search = search.model_copy(update={"iterations": evaluations // search.particles})
        scene = scene.model_copy(update={"search": search})
    started = time.perf_counter()
    problem = make_problem(scene, device, path, evaluator, pool=pool)
    prepared = time.perf_counter() - started - problem.compile_seconds
    if evaluator is None and problem.response is not None:
        problem = replace(problem, evaluator_name="response")
    if not problem.space.dimension:
        raise SceneError("actuators: one alone leaves nothing to search, so there is nothing to compare")
    budget = search.particles * search.iterations

    def begin(method: str, seed: int) -> Optimizer:
        named = search.model_copy(update={"method": method})
        return make_optimizer(named, problem.space, seed, problem.quadratic)

    fitting, skipped = _fitting(methods, begin, search.seed)
    trials, interrupted, gone = [], False, dict[str, int]()
    pairs = [
        (method, search.seed + index)
        for index in range(seeds)
        for method in fitting
        if index == 0 or method not in SEEDLESS
    ]
    try:
        for method in fitting:
            _warm(begin(method, search.seed), problem)
        for index, (method, seed) in enumerate(pairs):

            def tell(done: int, before: int = index * budget, note: str = f"{method}, seed {seed}") -> None:
                if on_progress is not None:
                    on_progress(before + done, len(pairs) * budget, note)

            trials.append(_trial(begin, method, seed, problem, budget, tell))
    except (KeyboardInterrupt, WorkersGone) as reason:
        if not trials:
            raise
        interrupted = True
        gone = {str(reason): search.particles} if isinstance(reason, WorkersGone) else {}
    bound = problem.loss_bound
    return MethodComparison(
        source=source,
        scene=problem.scene,
        device=device_name(problem.drive_solver.device) + of_pool(problem),
        evaluator=problem.evaluator_name,
        budget=budget,
        seconds={"prepare": prepared},
        localization=problem.only_localization,
        trials=tuple(sorted(trials, key=lambda trial: (fitting.index(trial.method), trial.seed))),
        bound=None if bound is None else bound.value,
        bound_kind="" if bound is None else bound.kind,
        bound_sentence="" if bound is None else bound.sentence,
        skipped=skipped,
        interrupted=interrupted,
        versions=versions(),
        lost_plates=dict(problem.lost) | gone,
    )


def _fitting(
    methods: Sequence[str] | None, begin: Callable[[str, int], Optimizer], seed: int
) -> tuple[list[str], dict[str, str]]:
    """The methods to try, and by name why others are not."""
    fitting, skipped = [], {}
    for method in methods or METHODS:
        if method not in METHODS:
            raise SceneError(f"--methods {method}: there is no such method; there are {', '.join(METHODS)}")
        try:
            begin(method, seed)
        except SceneError as error:
            if methods:
                raise
            skipped[method] = str(error)
        else:
            fitting.append(method)
    return list(dict.fromkeys(fitting)), skipped


def _warm(searcher: Optimizer, problem: Problem) -> None:
    """One iteration, so that what is compiled, loaded or allocated once costs no method its first."""
    positions = searcher.ask()
    searcher.tell(positions, problem.losses(positions))


def _trial(
    begin: Callable[[str, int], Optimizer],
    method: str,
    seed: int,
    problem: Problem,
    budget: int,
    tell: Callable[[int], None],
) -> Trial:
    evaluated, rows, best = 0, [], np.inf
    started = time.perf_counter()
    searcher = begin(method, seed)
    spent = time.perf_counter() - started
    with deferred_interrupts():
        while not searcher.stop() and evaluated < budget:
            started = time.perf_counter()
            positions = searcher.ask()
            losses = problem.losses(positions)
            searcher.tell(positions, losses)
            spent += time.perf_counter() - started
            evaluated += len(positions)
            best = min(best, float(np.min(losses, initial=np.inf, where=np.isfinite(losses))))
            rows.append((evaluated, spent, best))
            tell(evaluated)
            check_interrupt()
    counts, seconds, found = np.array(rows, dtype=float).T
    return Trial(method, seed, counts.astype(int), seconds, found)
