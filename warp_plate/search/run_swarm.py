"""A problem's search, run from a checkpoint (that of iteration 0 is the beginning) to its end or to Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.search.checkpoints import CheckpointFile
from warp_plate.search.interrupts import interrupts_held
from warp_plate.search.problem import Problem
from warp_plate.search.pso import Swarm, SwarmSettings, optimize
from warp_plate.search.space import Space

# Told after each iteration: iterations done, iterations in all, best localization factor so far.
Told = Callable[[int, int, float], object]


def settings_of(scene: Scene, space: Space, seed: int) -> SwarmSettings:
    """What the swarm of a scene and its space is told.

    Raises:
        SceneError: it takes more memory than there is.
    """
    search = scene.search
    refuse_beyond_memory(
        # positions, velocities, own bests, random numbers, drives and what makes them, energies
        search.particles * (120.0 * space.dimension + 100.0),
        f"search.particles = {search.particles} with {space.dimension} numbers to search",
    )
    half = (space.first_high - space.first_low) / 2
    limited = bool(np.isfinite([space.lower, space.upper]).any())
    return SwarmSettings(
        dimension=space.dimension,
        particles=search.particles,
        iterations=search.iterations,
        inertia=search.inertia,
        decay=search.decay,
        cognitive=search.cognitive,
        social=search.social,
        velocity_limit=search.velocity_limit,
        stall=search.stall,
        seed=seed,
        position_range=(space.first_low, space.first_high),
        velocity_range=(-half, half),
        bounds=(space.lower, space.upper) if limited else None,
        period=space.period if np.isfinite(space.period).any() else None,
    )


def searcher_of(problem: Problem, seed: int, state: Mapping[str, Any] | None = None) -> Swarm | None:
    """What searches the problem, from its beginning or from a state; None where one actuator leaves no choice.

    Raises:
        SceneError: see ``settings_of``; the state does not fit the problem.
    """
    if not problem.space.dimension:
        return None
    settings = settings_of(problem.scene, problem.space, seed)
    try:
        return Swarm(settings) if state is None else Swarm.from_state({**state, "settings": asdict(settings)})
    except ValueError as error:
        raise SceneError(f"checkpoint: {error}") from None


def run_search(
    begun: Checkpoint, problem: Problem, told: Told | None, checkpoints: CheckpointFile | None
) -> tuple[Swarm | None, bool]:
    """The searcher after its search, and whether Ctrl-C ended it; none where one actuator leaves no choice.

    Args:
        begun: the search until now; problem: made from its scene.
        told: called after each iteration; checkpoints: written when due, and when Ctrl-C ends the search.

    Raises:
        SceneError: the checkpoint does not fit its scene.
        KeyboardInterrupt: Ctrl-C came once more while the checkpoint was written.
    """
    if begun.swarm is None:
        return None, False
    swarm = searcher_of(problem, begun.seed, begun.swarm)
    if swarm is None:
        raise SceneError("checkpoint: has the state of a search, and its scene leaves nothing to search")
    started, first_steps = time.perf_counter(), problem.node_steps
    counted = first_steps  # of an iteration that Ctrl-C cuts short nothing is kept, nor are its steps

    def save() -> None:
        if checkpoints is None:
            return
        spent = begun.seconds.get("solve", 0.0) + time.perf_counter() - started
        checkpoints.save(
            replace(
                begun,
                swarm=swarm.state(plain=False),
                seconds={**begun.seconds, "solve": spent},
                node_steps=begun.node_steps + counted - first_steps,
            )
        )

    def after(swarm: Swarm) -> None:
        nonlocal counted
        counted = problem.node_steps
        if checkpoints is not None and checkpoints.due():
            save()
        if told is not None:
            told(swarm.iterations, begun.scene.search.iterations, 1 - swarm.result.fbest)

    with interrupts_held() as let_through:

        def losses(positions: np.ndarray) -> np.ndarray:
            with let_through():
                return problem.losses(positions)

        try:
            if checkpoints is not None and checkpoints.due():
                save()
            optimize(swarm, losses, after)
        except KeyboardInterrupt:
            save()
            return swarm, True
    return swarm, False


def history_of(swarm: Swarm | None) -> dict[str, np.ndarray]:
    """Localization factors after each iteration; nothing without a swarm."""
    if swarm is None:
        return {}
    history = swarm.history
    return {
        "evaluations": history["evaluations"],
        "best": 1 - history["best"],
        "mean": 1 - history["mean"],
    }
