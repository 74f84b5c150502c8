"""A problem's search, run from a checkpoint (that of iteration 0 is the beginning) to its end or to Ctrl-C."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.optimize.optimizer import Optimizer, minimize
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.problem import Problem
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.scene.errors import SceneError
from warp_plate.studies.checkpointing import CheckpointFile

# Told after each iteration: iterations done, iterations in all, best so far: the localization factor, or the weighted
# sum of the objectives.
OnProgress = Callable[[int, int, float], object]


def searcher_of(problem: Problem, seed: int, state: Mapping[str, Any] | None = None) -> Optimizer | None:
    """What searches the problem, from its beginning or from a state; None where one actuator leaves no choice.

    Raises:
        SceneError: see ``make_optimizer``; the state does not fit the problem.
    """
    search, space = problem.scene.search, problem.space
    if not space.dimension:
        return None
    try:
        return make_optimizer(search, space, seed, problem.quadratic, state)
    except SceneError:
        raise
    except ValueError as error:
        raise SceneError(f"checkpoint: {error}") from None


def run_search(
    begun: Checkpoint, problem: Problem, on_progress: OnProgress | None, checkpoints: CheckpointFile | None
) -> tuple[Optimizer | None, bool]:
    """The searcher after its search, and whether Ctrl-C ended it; none where one actuator leaves no choice.

    Args:
        begun: the search until now; problem: made from its scene.
        on_progress: called after each iteration.
        checkpoints: written when due, and when Ctrl-C or an error ends the search.

    Raises:
        SceneError: the checkpoint does not fit its scene. WorkersGone: see there.
        KeyboardInterrupt: Ctrl-C came once more while the checkpoint was written.
    """
    if begun.search_state is None:
        return None, False
    searcher = searcher_of(problem, begun.seed, begun.search_state)
    if searcher is None:
        raise SceneError("checkpoint: has the state of a search, and its scene leaves nothing to search")
    started, first_steps = time.perf_counter(), problem.node_steps
    counted, lost = first_steps, problem.lost  # of an iteration that is cut short nothing is kept, nor are its steps

    def save() -> None:
        if checkpoints is None:
            return
        spent = begun.seconds.get("solve", 0.0) + time.perf_counter() - started
        checkpoints.save(
            replace(
                begun,
                search_state=searcher.state(),
                seconds={**begun.seconds, "solve": spent},
                node_steps=begun.node_steps + counted - first_steps,
                lost_plates=dict(Counter(begun.lost_plates) + lost),
            )
        )

    def after(searcher: Optimizer) -> None:
        nonlocal counted, lost
        counted, lost = problem.node_steps, problem.lost
        if checkpoints is not None and checkpoints.due():
            save()
        if on_progress is not None:
            total = begun.scene.search.iterations
            on_progress(searcher.iterations, total, float(problem.value_from_loss(searcher.result.fbest)))
        check_interrupt()

    try:
        with deferred_interrupts():
            if checkpoints is not None and checkpoints.due():
                save()
            minimize(searcher, problem.losses, after)
    except SecondInterrupt:  # the searcher may be half updated: only an earlier checkpoint is whole
        raise
    except KeyboardInterrupt:
        save()
        return searcher, True
    except Exception:  # such as WorkersGone
        save()
        raise
    return searcher, False


def history_of(searcher: Optimizer | None, problem: Problem) -> dict[str, np.ndarray]:
    """What ``Problem.value_from_loss`` is after each iteration; nothing without a search."""
    if searcher is None:
        return {}
    history = searcher.history
    values = {name: np.asarray(problem.value_from_loss(history[name])) for name in ("best", "mean")}
    return {"evaluations": history["evaluations"], **values}
