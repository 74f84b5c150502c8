"""The whole search: reference drives, the bound, the swarm, and the best drive run once more for its pictures."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

import warp_plate
from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.estimate import estimate as estimate_errors
from warp_plate.accuracy.reference_solution import ReferenceStage
from warp_plate.cluster.pool import Pool
from warp_plate.plate.files import digests
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import at_highest_frequency
from warp_plate.problem.evaluate_cases import evaluate_objectives, reference_phasors
from warp_plate.problem.problem import EvaluatorName, Problem
from warp_plate.problem.robust import RobustProblem, make_problem
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import Result
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import device_aliases, find_device, processor_of
from warp_plate.solve.run import Run
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.studies.driver import OnProgress, searcher_of
from warp_plate.studies.several_targets import run_searches, runs_of_all
from warp_plate.studies.spectrum import make_spectrum
from warp_plate.studies.validation import against_nominal


def localize(
    scene: Scene,
    source: str = "",
    device: str = "auto",
    seed: int | None = None,
    evaluator: EvaluatorName | None = None,
    path: str = "auto",
    on_progress: OnProgress | None = None,
    estimate: bool = True,
    checkpoints: CheckpointFile | None = None,
    spectrum: bool = True,
    pool: Pool | None = None,
) -> Result:
    """Search the drive with the largest share of the plate's kinetic energy in the target.

    Args:
        scene: what to search; ``source``: its name, kept in the result.
        device, path: see :class:`PlateSolver`.
        seed: of the swarm; left out: the scene's.
        evaluator: "direct" simulates a plate for each particle; "response" uses the Gram matrices instead; left out:
            "direct", and "response" for a robust search where these hold.
        on_progress: called after each iteration.
        estimate: whether to estimate the errors of the localization factors at the end.
        checkpoints: where to keep what :func:`resume` goes on from.
        spectrum: whether a search for one frequency of all actuators ends with the factors over its range.
        pool: runs the plates of the search, see ``cluster.opening.open_pool``; left out: this process.

    A scene with several targets has one search after the other, and a best drive for each (see ``result.crosstalk``).
    A scene with ``grid.accuracy`` gets the grid that keeps it first, for its first target. Ctrl-C ends the search
    early; the result then holds the best so far and says that it was interrupted.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    seed = scene.search.seed if seed is None else seed
    if not 0 <= seed < 2**63:
        raise SceneError(f"seed = {seed}: must be a whole number from 0 to 2^63 - 1")
    asked, files = scene, digests(scene)
    # A frequency that is searched is judged where it asks most of a grid.
    hardest = at_highest_frequency(asked)
    chosen, accuracy, seconds, stage = resolve(hardest, device)
    scene = chosen.model_copy(update={"actuators": asked.actuators})
    started = time.perf_counter()
    problem = make_problem(scene, device, path, evaluator, pool=pool)
    drives = reference_phasors(problem.scene, problem.energies_of_phasors)
    searcher = searcher_of(problem, seed)
    compiling = problem.compile_seconds
    begun = Checkpoint(
        scene_as_written=asked,
        scene=problem.scene,
        source=source,
        files=files,
        device=problem.drive_solver.device.alias,
        processor=processor_of(problem.drive_solver.device),
        earlier_devices="",
        path=path,
        evaluator=problem.evaluator_name,
        seed=seed,
        accuracy=accuracy,
        seconds=seconds | {"compile": compiling, "solve": time.perf_counter() - started - compiling},
        versions=versions(),
        node_steps=problem.node_steps,
        single_actuator=int(np.argmax(np.abs(drives["single"]))),
        matrices=problem.matrices,
        search_state=None if searcher is None else searcher.state(),
    )
    return _finish(begun, problem, on_progress, estimate, checkpoints, stage, spectrum)


def resume(
    checkpoint: Checkpoint,
    device: str | None = None,
    on_progress: OnProgress | None = None,
    estimate: bool = True,
    checkpoints: CheckpointFile | None = None,
    spectrum: bool = True,
    pool: Pool | None = None,
) -> Result:
    """Go on with a search, to the result that it would have had without a stop.

    All that it finds is the same to the last bit on the same kind of device with the same versions; ``seconds``, and
    the estimate of the errors, which has its time, are not.

    Args:
        device: another one than the search began on: its rounding may be another; left out: the same.
        on_progress, estimate, checkpoints, spectrum, pool: see :func:`localize`.

    Raises:
        SceneError: there is no such device any more; a file that the scene names is missing or another; or the
            checkpoint does not fit its scene.
    """
    started = time.perf_counter()
    for key, digest in digests(checkpoint.scene).items():
        if checkpoint.files.get(key) != digest:
            raise SceneError(f"{key}: the file holds something else than when the search began")
    on, matrices = device or same_device(checkpoint.device, checkpoint.processor), checkpoint.matrices
    problem = make_problem(checkpoint.scene, on, checkpoint.path, checkpoint.evaluator, matrices, pool)
    if problem.parametrization.quadratic and matrices is None:
        raise SceneError("checkpoint: the matrices of its scene's response are missing")
    solver, spent = problem.drive_solver, dict(checkpoint.seconds)
    spent["compile"] = spent.get("compile", 0.0) + time.perf_counter() - started
    processor, earlier = processor_of(solver.device), checkpoint.earlier_devices
    if processor != checkpoint.processor:
        earlier += f"{checkpoint.device} ({checkpoint.processor}), then "
    begun = replace(
        checkpoint,
        device=solver.device.alias,
        processor=processor,
        earlier_devices=earlier,
        seconds=spent,
        versions=with_earlier(checkpoint.versions),
    )
    return _finish(begun, problem, on_progress, estimate, checkpoints, None, spectrum)


def same_device(device: str, processor: str, what: str = "search") -> str:
    """A device here of the kind that a search began on.

    Raises:
        SceneError: there is none; names a way out.
    """
    here = [device, *(alias for alias in device_aliases() if alias != device)]
    for alias in here:
        if alias in device_aliases() and processor_of(find_device(alias)) == processor:
            return alias
    raise SceneError(
        f"the {what} began on {device} ({processor}), which is not here; another device rounds in another way, so the "
        f"result would not be the same to the last bit: name one to go on, --device {find_device('auto').alias}"
    )


def _finish(
    begun: Checkpoint,
    problem: Problem,
    on_progress: OnProgress | None,
    estimate: bool,
    checkpoints: CheckpointFile | None,
    stage: ReferenceStage | None,
    spectrum: bool,
) -> Result:
    """From a checkpoint, which may be that of iteration 0, to the result: a search knows nothing else of its past."""
    searched = run_searches(begun, problem, on_progress, checkpoints)
    problem, seconds, first = searched.problem, dict(searched.seconds), searched.found[0]
    scene = problem.scene
    started, stepped = time.perf_counter(), problem.node_steps
    found = runs_of_all(searched)
    seconds["solve"] += time.perf_counter() - started
    cases, compared, beside = found.cases, None, found.node_steps
    if isinstance(problem, RobustProblem) and first.position is not None and not searched.interrupted:
        compared, nominal, more = against_nominal(problem, begun, first.position, seconds)
        cases, beside = {**cases, **nominal}, beside + more
    accuracy = dict(begun.accuracy)
    if estimate:
        known = stage if found.scene is scene else None  # the reference of another plate tells nothing
        accuracy |= estimated(found.scene, found.phasors, found.run, seconds, problem.drive_solver.device.alias, known)
    best = found.cases["best"]
    beside_best = {name: found.cases[name] for name in ("equal", "single")}
    worth, more = evaluate_objectives(scene, beside_best, problem.drive_solver.device.alias, begun.path)
    made = make_spectrum(problem, best, seconds) if spectrum and not searched.interrupted else {}
    return Result(
        command="localize",
        source=begun.source,
        scene=scene,
        device=begun.earlier_devices + device_name(problem.drive_solver.device) + of_pool(problem),
        seed=begun.seed,
        effects=problem.design_solver.effects,
        path=problem.design_solver.describe_path(bool(scene.record.points)),
        cases=cases,
        times=found.run.times,
        trace_times=found.run.trace_times,
        seconds=seconds,
        bound=first.bound,
        bound_kind=first.bound_kind,
        history=first.history,
        objective_values=first.objective_values,
        objective_values_by_case=worth,
        evaluator=begun.evaluator,
        interrupted=searched.interrupted,
        versions=begun.versions,
        node_steps=searched.node_steps + problem.node_steps + beside + more - stepped,
        evaluations=sum(one.evaluations for one in searched.found),
        accuracy=accuracy,
        peak_displacement=found.peak,
        spectrum=made,
        target_searches=searched.found if scene.targets else (),
        robust=compared,
        lost_plates=searched.lost,
    )


def resolve(
    scene: Scene, device: str, drives: np.ndarray | None = None
) -> tuple[Scene, dict[str, Any], dict[str, float], ReferenceStage | None]:
    """The scene with a grid, what is to be kept of its choice, the seconds that it took, and its reference.

    Raises:
        SceneError: no grid keeps the accuracy asked for.
    """
    if scene.grid.accuracy is None:
        return scene, {}, {}, None
    started = time.perf_counter()
    choice = choose(scene, scene.grid.accuracy, device, drives)
    kept = {"asked": choice.asked, "expected": choice.error, "reason": choice.reason}
    return choice.scene, kept, {"choose": time.perf_counter() - started}, choice.reference.stage


def estimated(
    scene: Scene,
    drives: dict[str, np.ndarray],
    run: Run,
    seconds: dict[str, float],
    device: str,
    stage: ReferenceStage | None = None,
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


def device_name(device: wp.Device) -> str:
    """For people: Warp's name for the device, and the processor's."""
    return f"{device.alias} ({device.name or platform.machine()})"


def of_pool(problem: Problem) -> str:
    """For people, behind ``device_name``: where the plates of the search ran, if not there."""
    if problem.pool is None:
        return ""
    if problem.evaluator_name == "response":
        return f"; {problem.pool.words}: nothing to do, for Gram matrices run no plates of the search"
    return f", plates of the search on {problem.pool.words}"


def versions() -> dict[str, str]:
    """Of everything that the numbers depend on."""
    return {
        "warp_plate": warp_plate.__version__,
        "warp": wp.config.version,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def with_earlier(earlier: Mapping[str, str]) -> dict[str, str]:
    """The versions of now; where a search began with another, both."""
    return {
        name: earlier[name] if earlier.get(name, now).split(", then ")[-1] == now else f"{earlier[name]}, then {now}"
        for name, now in versions().items()
        if name in earlier
    }
