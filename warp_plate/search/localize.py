"""The whole search: reference drives, the bound, the swarm, and the best drive run once more for its pictures."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import warp as wp

import warp_plate
from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.estimate import estimate as estimate_errors
from warp_plate.accuracy.truth import Stage
from warp_plate.plate.files import digests
from warp_plate.plate.weights import localization_factor
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import Case, Result
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Record, Scene
from warp_plate.search.checkpoints import CheckpointFile
from warp_plate.search.objective import drives_of, unit_of_drives
from warp_plate.search.peak import run_and_look
from warp_plate.search.pso import Swarm
from warp_plate.search.run_swarm import Energies, Told, history_of, run_swarm, settings_of
from warp_plate.solve.devices import device_aliases, find_device, processor_of
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver, Run

Evaluator = Literal["direct", "response"]


def localize(
    scene: Scene,
    source: str = "",
    device: str = "auto",
    seed: int | None = None,
    evaluator: Evaluator = "direct",
    path: str = "auto",
    told: Told | None = None,
    estimate: bool = True,
    checkpoints: CheckpointFile | None = None,
) -> Result:
    """Search the drive with the largest share of the plate's kinetic energy in the target.

    Args:
        scene: what to search; ``source``: its name, kept in the result.
        device, path: see :class:`PlateSolver`.
        seed: of the swarm; left out: the scene's.
        evaluator: "direct" simulates a plate for each particle; "response" uses the Gram matrices instead.
        told: called after each iteration.
        estimate: whether to estimate the errors of the localization factors at the end.
        checkpoints: where to keep what :func:`resume` goes on from.

    A scene with ``grid.accuracy`` gets the grid that keeps it first. Ctrl-C ends the search early; the result then
    holds the best so far and says that it was interrupted.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    seed = scene.search.seed if seed is None else seed
    if not 0 <= seed < 2**63:
        raise SceneError(f"seed = {seed}: must be a whole number from 0 to 2^63 - 1")
    if evaluator == "response" and not scene.linear:
        raise SceneError(f"evaluator = 'response': {scene.not_linear} is not linear in the drives; write 'direct'")
    asked, files = scene, digests(scene)
    scene, accuracy, seconds, stage = resolve(scene, device)
    solver = PlateSolver(scene, device, path)
    needs_exact = scene.linear and scene.grid.precision != "float64"
    exact = PlateSolver(_in_float64(scene), device, path) if needs_exact else solver
    started = time.perf_counter()
    response = measure_response(exact) if scene.linear else None
    drives = reference_drives(scene, _energies(solver, response, evaluator))
    swarm = Swarm(settings_of(scene, seed)) if len(scene.actuators) > 1 else None
    compiling = sum(one.compile_seconds for one in {solver, exact})
    begun = Checkpoint(
        asked=asked,
        scene=scene,
        source=source,
        files=files,
        device=solver.device.alias,
        processor=processor_of(solver.device),
        earlier="",
        path=path,
        evaluator=evaluator,
        seed=seed,
        accuracy=accuracy,
        seconds=seconds | {"compile": compiling, "solve": time.perf_counter() - started},
        versions=versions(),
        node_steps=sum(one.node_steps for one in {solver, exact}),
        single=int(np.argmax(np.abs(drives["single"]))),
        matrices=None if response is None else response.matrices,
        swarm=None if swarm is None else swarm.state(plain=False),
    )
    return _finish(begun, solver, told, estimate, checkpoints, stage)


def resume(
    checkpoint: Checkpoint,
    device: str | None = None,
    told: Told | None = None,
    estimate: bool = True,
    checkpoints: CheckpointFile | None = None,
) -> Result:
    """Go on with a search, to the result that it would have had without a stop.

    All that it finds is the same to the last bit on the same kind of device with the same versions; ``seconds``, and
    the estimate of the errors, which has its time, are not.

    Args:
        device: another one than the search began on: its rounding may be another; left out: the same.
        told, estimate, checkpoints: see :func:`localize`.

    Raises:
        SceneError: there is no such device any more; a file that the scene names is missing or another; or the
            checkpoint does not fit its scene.
    """
    started = time.perf_counter()
    for key, digest in digests(checkpoint.scene).items():
        if checkpoint.files.get(key) != digest:
            raise SceneError(f"{key}: the file holds something else than when the search began")
    solver = PlateSolver(checkpoint.scene, device or same_device(checkpoint), checkpoint.path)
    spent = dict(checkpoint.seconds)
    spent["compile"] = spent.get("compile", 0.0) + time.perf_counter() - started
    processor, earlier = processor_of(solver.device), checkpoint.earlier
    if processor != checkpoint.processor:
        earlier += f"{checkpoint.device} ({checkpoint.processor}), then "
    begun = replace(
        checkpoint,
        device=solver.device.alias,
        processor=processor,
        earlier=earlier,
        seconds=spent,
        versions=_with_earlier(checkpoint.versions),
    )
    return _finish(begun, solver, told, estimate, checkpoints)


def same_device(checkpoint: Checkpoint) -> str:
    """A device here of the kind that the search began on.

    Raises:
        SceneError: there is none; names a way out.
    """
    here = [checkpoint.device, *(alias for alias in device_aliases() if alias != checkpoint.device)]
    for alias in here:
        if alias in device_aliases() and processor_of(find_device(alias)) == checkpoint.processor:
            return alias
    raise SceneError(
        f"the search began on {checkpoint.device} ({checkpoint.processor}), which is not here; another device rounds "
        f"in another way, so the result would not be the same to the last bit: name one to go on, --device "
        f"{find_device('auto').alias}"
    )


def _finish(
    begun: Checkpoint,
    solver: PlateSolver,
    told: Told | None,
    estimate: bool,
    checkpoints: CheckpointFile | None,
    stage: Stage | None = None,
) -> Result:
    """From a checkpoint, which may be that of iteration 0, to the result: a search knows nothing else of its past."""
    scene, seconds = begun.scene, dict(begun.seconds)
    started, stepped = time.perf_counter(), solver.node_steps
    response = None if begun.matrices is None else Response(begun.matrices)
    energies = _energies(solver, response, begun.evaluator)
    swarm, interrupted = run_swarm(begun, energies, lambda: solver.node_steps, told, checkpoints)
    found = swarm.result.xbest if swarm is not None else None
    singles = unit_of_drives(scene) * np.eye(len(scene.actuators), dtype=complex)
    drives = {"equal": singles.sum(axis=0), "single": singles[begun.single]}
    drives["best"] = drives["single"] if found is None else unit_of_drives(scene) * drives_of(found[None])[0]
    run, peak = run_and_look(solver, np.array(list(drives.values())))
    seconds["solve"] = seconds.get("solve", 0.0) + time.perf_counter() - started
    accuracy = dict(begun.accuracy)
    if estimate:
        accuracy |= estimated(scene, drives, run, seconds, solver.device.alias, stage)
    return Result(
        command="localize",
        source=begun.source,
        scene=scene,
        device=begun.earlier + device_name(solver.device),
        seed=begun.seed,
        effects=solver.effects,
        path=solver.path_words(bool(scene.record.points)),
        cases=cases_of(drives, run),
        times=run.times,
        trace_times=run.trace_times,
        seconds=seconds,
        bound=response.bound() if response is not None else None,
        history=history_of(swarm),
        evaluator=begun.evaluator,
        interrupted=interrupted,
        versions=begun.versions,
        node_steps=begun.node_steps + solver.node_steps - stepped,
        evaluations=swarm.result.evaluations if swarm is not None else 0,
        accuracy=accuracy,
        peak=peak,
    )


def _energies(solver: PlateSolver, response: Response | None, evaluator: str) -> Energies:
    if evaluator == "response" and response is not None:
        return response.energy
    return lambda drives: solver.run(drives).energy


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


def reference_drives(scene: Scene, energies: Energies) -> dict[str, np.ndarray]:
    """The drives that the search is compared with: all actuators alike, and the best single one."""
    singles = unit_of_drives(scene) * np.eye(len(scene.actuators), dtype=complex)
    best = int(np.argmax(np.nan_to_num(localization_factor(energies(singles)), nan=-1.0)))
    return {"equal": singles.sum(axis=0), "single": singles[best]}


def cases_of(drives: dict[str, np.ndarray], run: Run) -> dict[str, Case]:
    """The plates of a run by the names of their drives."""
    with np.errstate(over="ignore"):  # beyond float32's range a displacement becomes infinite
        displacement, trace = run.displacement.astype(np.float32), run.trace.astype(np.float32)
    return {
        name: Case(
            drive=drive,
            energy=dict(zip(run.regions, run.energy[index].tolist(), strict=True)),
            displacement=displacement[index],
            trace=trace[index],
            status=run.fault(index),
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


def _with_earlier(earlier: Mapping[str, str]) -> dict[str, str]:
    """The versions of now; where a search began with another, both."""
    return {
        name: earlier[name] if earlier.get(name, now).split(", then ")[-1] == now else f"{earlier[name]}, then {now}"
        for name, now in versions().items()
        if name in earlier
    }


def _in_float64(scene: Scene) -> Scene:
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": "float64"}), "record": Record()})
