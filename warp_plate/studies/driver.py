"""Run a search from a checkpoint, which may be that of iteration 0, to its end or until Ctrl-C."""

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

# Called after each iteration with the iterations done, their total, and the best localization factor so far, or the
# best weighted sum of the objectives.
OnProgress = Callable[[int, int, float], object]


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


def history_of(optimizer: Optimizer | None, problem: Problem) -> dict[str, np.ndarray]:
    """Return the evaluations, and the best and mean values, after each iteration; empty without a search."""
    if optimizer is None:
        return {}
    history = optimizer.history
    values = {name: np.asarray(problem.value_from_loss(history[name])) for name in ("best", "mean")}
    return {"evaluations": history["evaluations"], **values}
