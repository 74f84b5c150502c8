"""The whole search: reference drives, the bound, the swarm, and the best drive run once more for its pictures."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import warp as wp

import warp_plate
from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.estimate import estimate as estimate_errors
from warp_plate.accuracy.truth import Stage
from warp_plate.plate.weights import localization_factor
from warp_plate.result.model import Case, Result
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Record, Scene
from warp_plate.search.objective import drives_of, loss
from warp_plate.search.pso import Swarm, SwarmSettings, optimize
from warp_plate.solve.response import measure_response
from warp_plate.solve.solver import PlateSolver, Run

Evaluator = Literal["direct", "response"]
Energies = Callable[[np.ndarray], np.ndarray]
# Told after each iteration: iterations done, iterations in all, best localization factor so far.
Told = Callable[[int, int, float], object]


def localize(
    scene: Scene,
    source: str = "",
    device: str = "auto",
    seed: int | None = None,
    evaluator: Evaluator = "direct",
    path: str = "auto",
    told: Told | None = None,
    estimate: bool = True,
) -> Result:
    """Search the drive with the largest share of the plate's kinetic energy in the target.

    Args:
        scene: what to search; ``source``: its name, kept in the result.
        device, path: see :class:`PlateSolver`.
        seed: of the swarm; left out: the scene's.
        evaluator: "direct" simulates a plate for each particle; "response" uses the Gram matrices instead.
        told: called after each iteration.
        estimate: whether to estimate the errors of the localization factors at the end.

    A scene with ``grid.accuracy`` gets the grid that keeps it first. Ctrl-C ends the search early; the result then
    holds the best so far and says that it was interrupted.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    seed = scene.search.seed if seed is None else seed
    if not 0 <= seed < 2**63:
        raise SceneError(f"seed = {seed}: must be a whole number from 0 to 2^63 - 1")
    if evaluator == "response" and not scene.linear:
        raise SceneError("evaluator = 'response': effects.stretching is not linear in the drives; write 'direct'")
    scene, accuracy, seconds, stage = resolve(scene, device)
    solver = PlateSolver(scene, device, path)
    needs_exact = scene.linear and scene.grid.precision != "float64"
    exact = PlateSolver(_in_float64(scene), device, path) if needs_exact else solver
    compile_seconds = sum(one.compile_seconds for one in {solver, exact})
    started = time.perf_counter()
    response = measure_response(exact) if scene.linear else None
    matrices = response if evaluator == "response" else None
    energies: Energies = matrices.energy if matrices is not None else lambda drives: solver.run(drives).energy
    drives = reference_drives(len(scene.actuators), energies)
    swarm, interrupted = _search(scene, seed, energies, told)
    found = swarm.result.xbest if swarm is not None else None
    drives["best"] = drives["single"] if found is None else drives_of(found[None])[0]
    run = solver.run(np.array(list(drives.values())), record_times(scene), scene.record.points)
    seconds |= {"compile": compile_seconds, "solve": time.perf_counter() - started}
    if estimate:
        accuracy |= estimated(scene, drives, run, seconds, device, stage)
    return Result(
        command="localize",
        source=source,
        scene=scene,
        device=device_name(solver.device),
        seed=seed,
        effects=solver.effects,
        cases=cases_of(drives, run),
        times=run.times,
        trace_times=run.trace_times,
        seconds=seconds,
        bound=response.bound() if response is not None else None,
        history=_history(swarm),
        evaluator=evaluator,
        interrupted=interrupted,
        versions=versions(),
        node_steps=sum(one.node_steps for one in {solver, exact}),
        evaluations=swarm.result.evaluations if swarm is not None else 0,
        accuracy=accuracy,
    )


def resolve(
    scene: Scene, device: str, drives: np.ndarray | None = None
) -> tuple[Scene, dict[str, Any], dict[str, float], Stage | None]:
    """The scene with a grid, what is to be kept of its choice, the seconds that it took, and its reference.

    Raises:
        SceneError: no grid keeps the accuracy asked for.
    """
    if scene.grid.accuracy is None:
        return scene, {}, {}, None
    started = time.perf_counter()
    choice = choose(scene, scene.grid.accuracy, device, drives)
    kept = {"asked": choice.asked, "expected": choice.error, "reason": choice.reason}
    return choice.scene, kept, {"choose": time.perf_counter() - started}, choice.truth.stage


def estimated(
    scene: Scene,
    drives: dict[str, np.ndarray],
    run: Run,
    seconds: dict[str, float],
    device: str,
    stage: Stage | None = None,
) -> dict[str, Any]:
    """The estimate of a run's errors, with its line for people; nothing where Ctrl-C came first. Adds its seconds."""
    try:
        factors = localization_factor(run.energy)
        found = estimate_errors(
            scene,
            np.array(list(drives.values())),
            factors,
            seconds["solve"],
            device,
            run.times,
            run.displacement,
            stage,
        )
    except (KeyboardInterrupt, SceneError):  # a result is not lost for want of an error bar
        return {}
    seconds["estimate"] = found.seconds
    return {"estimate": {"cases": list(drives), **found.as_json(), "line": found.line()}}


def reference_drives(actuators: int, energies: Energies) -> dict[str, np.ndarray]:
    """The drives that the search is compared with: all actuators alike, and the best single one."""
    singles = np.eye(actuators, dtype=complex)
    best = int(np.argmax(np.nan_to_num(localization_factor(energies(singles)), nan=-1.0)))
    return {"equal": np.ones(actuators, dtype=complex), "single": singles[best]}


def record_times(scene: Scene) -> tuple[float, ...]:
    """The times [s] that the scene names, else the middle of the run and its end."""
    return scene.record.times or (scene.window.end / 2, scene.window.end)


def cases_of(drives: dict[str, np.ndarray], run: Run) -> dict[str, Case]:
    """The plates of a run by the names of their drives."""
    return {
        name: Case(
            drive=drive,
            energy=dict(zip(run.regions, run.energy[index].tolist(), strict=True)),
            displacement=run.displacement[index].astype(np.float32),
            trace=run.trace[index].astype(np.float32),
        )
        for index, (name, drive) in enumerate(drives.items())
    }


def device_name(device: wp.Device) -> str:
    """For people: Warp's name for the device, and the processor's."""
    return f"{device.alias} ({device.name or platform.machine()})"


def versions() -> dict[str, str]:
    """Of everything that the numbers depend on."""
    return {
        "warp_plate": warp_plate.__version__,
        "warp": wp.config.version,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def _in_float64(scene: Scene) -> Scene:
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": "float64"}), "record": Record()})


def make_swarm(scene: Scene, seed: int) -> Swarm:
    """The swarm that the scene asks for; it needs two actuators or more."""
    search = scene.search
    return Swarm(
        SwarmSettings(
            dimension=2 * (len(scene.actuators) - 1),
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
    )


def _search(
    scene: Scene, seed: int, energies: Energies, told: Told | None
) -> tuple[Swarm | None, bool]:
    """The swarm after its search, and whether Ctrl-C ended it; no swarm where one actuator leaves no choice."""
    if len(scene.actuators) == 1:
        return None, False
    swarm = make_swarm(scene, seed)

    def after(swarm: Swarm) -> None:
        if told is not None:
            told(swarm.iterations, scene.search.iterations, 1 - swarm.result.fbest)

    try:
        optimize(swarm, lambda positions: loss(energies(drives_of(positions))), after)
    except KeyboardInterrupt:
        return swarm, True
    return swarm, False


def _history(swarm: Swarm | None) -> dict[str, np.ndarray]:
    if swarm is None:
        return {}
    history = swarm.history
    return {
        "evaluations": history["evaluations"],
        "best": 1 - history["best"],
        "mean": 1 - history["mean"],
    }
