"""The swarm of a scene, run from a checkpoint (that of iteration 0 is the beginning) to its end or to Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np

from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.search.checkpoints import CheckpointFile
from warp_plate.search.interrupts import interrupts_held
from warp_plate.search.objective import drives_of, loss, unit_of_drives
from warp_plate.search.pso import Swarm, SwarmSettings, optimize

Energies = Callable[[np.ndarray], np.ndarray]
# Told after each iteration: iterations done, iterations in all, best localization factor so far.
Told = Callable[[int, int, float], object]


def settings_of(scene: Scene, seed: int) -> SwarmSettings:
    """What the scene's swarm is told.

    Raises:
        SceneError: it takes more memory than there is.
    """
    search, dimension = scene.search, 2 * (len(scene.actuators) - 1)
    refuse_beyond_memory(
        # positions, velocities, own bests, random numbers, drives and what makes them, energies
        search.particles * (120.0 * dimension + 100.0),
        f"search.particles = {search.particles} with {len(scene.actuators)} actuators",
    )
    return SwarmSettings(
        dimension=dimension,
        particles=search.particles,
        iterations=search.iterations,
        inertia=search.inertia,
        decay=search.decay,
        cognitive=search.cognitive,
        social=search.social,
        velocity_limit=search.velocity_limit,
        stall=search.stall,
        seed=seed,
    )


def run_swarm(
    begun: Checkpoint,
    energies: Energies,
    node_steps: Callable[[], int],
    told: Told | None,
    checkpoints: CheckpointFile | None,
) -> tuple[Swarm | None, bool]:
    """The swarm after its search, and whether Ctrl-C ended it; no swarm where one actuator leaves no choice.

    Args:
        begun: the search until now; energies: of drives, (plates, regions); node_steps: the count that they raise.
        told: called after each iteration; checkpoints: written when due, and when Ctrl-C ends the search.

    Raises:
        SceneError: the checkpoint does not fit its scene.
        KeyboardInterrupt: Ctrl-C came once more while the checkpoint was written.
    """
    if begun.swarm is None:
        return None, False
    try:
        swarm = Swarm.from_state({**begun.swarm, "settings": asdict(settings_of(begun.scene, begun.seed))})
    except ValueError as error:
        raise SceneError(f"checkpoint: {error}") from None
    unit = unit_of_drives(begun.scene)
    started, first_steps = time.perf_counter(), node_steps()
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
        counted = node_steps()
        if checkpoints is not None and checkpoints.due():
            save()
        if told is not None:
            told(swarm.iterations, begun.scene.search.iterations, 1 - swarm.result.fbest)

    with interrupts_held() as let_through:

        def losses(positions: np.ndarray) -> np.ndarray:
            drives = unit * drives_of(positions)
            with let_through():
                energy = energies(drives)
            return loss(energy)

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
