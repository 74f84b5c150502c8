"""The complete search: choose engine and grid, search for each target, and compose the result."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from numbers import Integral
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from warp_plate.analysis.result_warnings import result_warnings
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import MODAL
from warp_plate.plate.files import digests
from warp_plate.problem.evaluate_cases import EvaluatedCases, evaluate_cases, evaluate_objectives
from warp_plate.problem.methods import resolve_search
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.problem.uncertainty import draw_scenarios, simulate_scenarios
from warp_plate.resolve import EvaluatorName, resolve
from warp_plate.result.atomic_io import write_atomically
from warp_plate.result.case import Case, target_cases
from warp_plate.result.checkpoint import Checkpoint, load_checkpoint
from warp_plate.result.model import Result, RobustComparison, TargetSearch, best_drive_scenes
from warp_plate.scene.errors import SceneError, check_function, check_type, toml_comment
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.solve.devices import processor_of
from warp_plate.studies.baselines import baseline_cases, check_baselines
from warp_plate.studies.more_functions import accuracy_may_change, search_by_more_functions
from warp_plate.studies.searches import OnProgress, SearchOutcome, initial_state, search_targets, with_target
from warp_plate.studies.simulate import estimate_error, optional_part
from warp_plate.studies.spectrum import has_spectrum, make_spectrum
from warp_plate.studies.unfinished import (
    CheckpointFile,
    changes,
    device_like,
    devices_text,
    merged_versions,
    run_fields,
    versions,
)

EVALUATORS = ("direct", "response", "modal")


def localize(
    scene: SceneSource,
    *,
    source: str = "",
    device: str = "auto",
    seed: int | None = None,
    evaluator: EvaluatorName | None = None,
    path: str = "auto",
    on_progress: OnProgress | None = None,
    estimate: bool = True,
    checkpoints: CheckpointFile | None = None,
    spectrum: bool = True,
    pool: WorkerPool | None = None,
    baselines: bool = False,
) -> Result:
    """Search for the drive with the largest share of the plate's kinetic energy in the target.

    With several targets, there is a search and a best drive for each (see ``result.case``).
    The engine and grid of a scene with ``grid.accuracy`` are chosen first, for the first target. Ctrl-C ends the search
    early; the result then holds the best drive so far and is marked as interrupted.

    Args:
        scene: scene to search; ``source`` is its name, kept in the result.
        device, path: see :class:`PlateSolver`.
        seed: random seed of the search (default: the scene's).
        evaluator: "direct" simulates a plate for each candidate, "response" uses Gram matrices of unit responses,
            "modal" the modes of the plate (default: "modal" with ``grid.accuracy`` if they are accurate enough;
            otherwise "direct", and for robust searches "response" if it applies).
        on_progress: called after each iteration.
        estimate: whether to estimate the errors of the localization factors.
        checkpoints: file that :func:`resume` can continue from.
        spectrum: whether to compute the localization factors over the range of a searched common frequency.
        pool: workers that run the plates of the search, see ``cluster.opening.open_pool`` (default: this process).
        baselines: whether to compare with drives that need no search; see :mod:`warp_plate.studies.baselines`.

    Raises:
        SceneError: see :class:`PlateSolver`; or the scene has no baselines.
    """
    written = Scene.load(scene)
    check_type("source", source, str)
    _check_arguments(on_progress, checkpoints, pool, estimate=estimate, spectrum=spectrum, baselines=baselines)
    if evaluator is not None and (not isinstance(evaluator, str) or evaluator not in EVALUATORS):
        raise SceneError(f"evaluator = {evaluator!r}: must be 'direct', 'response' or 'modal'")
    if baselines:
        check_baselines(written)
    seed = written.search.seed if seed is None else seed
    if not isinstance(seed, Integral) or not 0 <= int(seed) < 2**63:
        raise SceneError(f"seed = {seed!r}: must be an integer from 0 to 2^63 - 1")
    files = digests(written.named_files, written.folder)
    resolved = resolve_search(written, device, path, evaluator)
    started = time.perf_counter()
    problem = make_problem(resolved, pool=pool)
    initial, compiling = initial_state(problem, seed), problem.compile_seconds
    start = Checkpoint(
        scene_as_written=written,
        source=source,
        files=files,
        device=problem.drive_solver.device.alias,
        processor=processor_of(problem.drive_solver.device),
        earlier_devices="",
        path=path,
        evaluator=problem.evaluator_name,
        seed=seed,
        accuracy=resolved.accuracy,
        seconds={**resolved.seconds, "compile": compiling, "solve": time.perf_counter() - started - compiling},
        versions=versions(),
        node_steps=problem.node_steps,
        **initial,
    )
    return _run(start, problem, on_progress, checkpoints, estimate=estimate, spectrum=spectrum, baselines=baselines)


def _check_arguments(on_progress: object, checkpoints: object, pool: object, **flags: object) -> None:
    """Raise a SceneError, before the search, if one of these is of another type."""
    check_function("on_progress", on_progress)
    check_type("checkpoints", checkpoints, CheckpointFile, NoneType)
    check_type("pool", pool, WorkerPool, NoneType)
    for key, flag in flags.items():
        check_type(key, flag, bool)


def resume(
    checkpoint: Checkpoint,
    device: str | None = None,
    on_progress: OnProgress | None = None,
    estimate: bool = True,
    checkpoints: CheckpointFile | None = None,
    spectrum: bool = True,
    pool: WorkerPool | None = None,
    baselines: bool = False,
) -> Result:
    """Continue a search to the result that it would have had without the interruption.

    The result is bit-identical on the same kind of device with the same versions, except ``seconds`` and the error
    estimate, which depends on them.

    Args:
        device: device, which may round differently than the one before (default: one of the same kind, if any).
        on_progress, estimate, checkpoints, spectrum, pool, baselines: see :func:`localize`.

    Raises:
        SceneError: the device does not exist, a file that the scene names is missing or has changed, or the checkpoint
            does not fit its scene.
    """
    check_type("checkpoint", checkpoint, Checkpoint)
    _check_arguments(on_progress, checkpoints, pool, estimate=estimate, spectrum=spectrum, baselines=baselines)
    if baselines:
        check_baselines(checkpoint.scene)
    started, matrices, earlier = time.perf_counter(), checkpoint.matrices, checkpoint.earlier_devices
    for key, digest in digests(checkpoint.scene.named_files, checkpoint.scene.folder).items():
        if checkpoint.files.get(key) != digest:
            raise SceneError(f"{key}: the file has changed since the search began")
    device = device or device_like(checkpoint)
    resolved = resolve(checkpoint.scene, device, purpose="search", path=checkpoint.path, evaluator=checkpoint.evaluator)
    problem = make_problem(resolved, matrices, pool)
    if problem.parametrization.quadratic and matrices is None:
        raise SceneError("checkpoint: the matrices of its scene's response are missing")
    for search in checkpoint.finished_searches:
        if search.position is not None and len(search.position) != problem.space.dimension:
            raise SceneError(f"checkpoint: a finished search has {len(search.position)} numbers in its position")
    used = problem.drive_solver.device
    if processor_of(used) != checkpoint.processor:
        earlier += f"{checkpoint.device} ({checkpoint.processor}), then "
    compiling = checkpoint.seconds.get("compile", 0.0) + time.perf_counter() - started
    start = replace(
        checkpoint,
        device=used.alias,
        processor=processor_of(used),
        earlier_devices=earlier,
        seconds={**checkpoint.seconds, "compile": compiling},
        versions=merged_versions(checkpoint.versions),
    )
    return _run(start, problem, on_progress, checkpoints, estimate=estimate, spectrum=spectrum, baselines=baselines)


def load_to_resume(
    file: Path, scene: Scene | None, device: str | None, log: Callable[[str], object], **options: object
) -> Checkpoint:
    """Load a checkpoint for :func:`resume`, and log what may change the last digits of the result.

    The scene and ``options`` are those given again, or None; files that the scene names are looked for in its folder.
    """
    checkpoint = load_checkpoint(file)
    written = checkpoint.scene_as_written
    for option, value in options.items():
        before = getattr(checkpoint, option)
        if value not in (None, before):
            raise SceneError(f"--{option} {value}: the search in {file} began with {before}; leave it out")
    if scene is not None:
        if scene.model_dump() != written.model_dump():
            raise SceneError(f"the scene is not that of the search in {file}; start again without --resume")
        gridded = checkpoint.scene.in_folder(scene.folder)
        checkpoint = replace(checkpoint, scene_as_written=written.in_folder(scene.folder), scene=gridded)
    for line in changes(checkpoint, device or device_like(checkpoint)):
        log(f"{file}: {line}")
    return checkpoint


def save_best_scenes(result: Result, path: Path) -> list[Path]:
    """Write the scene of the best drive, PATH.toml; of several targets one each, PATH.2.toml, PATH.3.toml, ..."""
    files = []
    for number, scene in enumerate(best_drive_scenes(result).values(), 1):
        file = path if number == 1 else path.with_suffix(f".{number}.toml")
        command = f"warp-plate simulate {file.name}" + (" --path modal" if result.evaluator == MODAL else "")
        head = [f"Found by: warp-plate localize {result.source}", f"Run it by: {command}"]
        if result.evaluator == MODAL:
            head.append("By modes, [grid] only says at which points results are given.")
        write_atomically((toml_comment(*head) + scene.to_toml()).encode(), file)
        files.append(file)
    return files


def _run(
    start: Checkpoint,
    problem: Problem,
    on_progress: OnProgress | None,
    checkpoints: CheckpointFile | None,
    estimate: bool,
    **parts_asked: bool,
) -> Result:
    """Run a search from a checkpoint, which may be that of iteration 0, and make its result."""
    compiled = problem.compile_seconds
    outcome = search_targets(start, problem, on_progress, checkpoints)
    seconds, before, unsure = dict(outcome.checkpoint.seconds), outcome.problem.node_steps, accuracy_may_change(outcome)
    late = outcome.problem.compile_seconds - compiled  # Kernels compiled when the search needed them
    seconds["compile"], seconds["solve"] = seconds["compile"] + late, seconds["solve"] - late
    evaluated, estimated = _evaluate(outcome, seconds, estimate or unsure)
    if unsure:
        searched, error = outcome, estimated.get("estimate", {}).get("error", math.nan)
        with optional_part(seconds, "accuracy"):
            outcome = search_by_more_functions(searched, evaluated, error)
        if outcome is not searched:
            evaluated, estimated = _evaluate(outcome, seconds, estimate)
    end, problem = outcome.checkpoint, outcome.problem
    first, accuracy = end.finished_searches[0], {**end.accuracy, **(estimated if estimate else {})}
    parts = _optional_parts(outcome, evaluated, seconds, **parts_asked)
    node_steps = end.node_steps + problem.node_steps - before + evaluated.node_steps + parts.pop("node_steps")
    result = Result(
        command="localize",
        source=end.source,
        scene=problem.scene,
        device=end.earlier_devices + devices_text(problem),
        seed=end.seed,
        seconds=seconds,
        bound=first.bound,
        bound_kind=first.bound_kind,
        history=first.history,
        objective_values=first.objective_values,
        evaluator=end.evaluator,
        interrupted=outcome.interrupted,
        versions=end.versions,
        node_steps=node_steps,
        evaluations=sum(search.evaluations for search in end.finished_searches),
        peak_displacement=evaluated.peak,
        target_searches=end.finished_searches if problem.scene.targets else (),
        lost_plates=end.lost_plates,
        accuracy=accuracy,
        **run_fields(problem.plates.designs.solver, evaluated.run),
        **parts,
    )
    return replace(result, warnings=result_warnings(result))


def _evaluate(
    outcome: SearchOutcome, seconds: dict[str, float], estimate: bool
) -> tuple[EvaluatedCases, dict[str, Any]]:
    """Return the cases of an outcome and the estimate of their errors, if asked for, and add their seconds."""
    problem, searches, started = outcome.problem, outcome.checkpoint.finished_searches, time.perf_counter()
    evaluated, estimated = evaluate_targets(problem, searches), {}
    seconds["solve"] += time.perf_counter() - started
    if estimate:
        with optional_part(seconds, "estimate"):
            simulated = problem.resolved.with_scene(evaluated.scene)
            run, bound = evaluated.run, searches[0].bound
            estimated = estimate_error(simulated, evaluated.phasors, run, bound, problem.bound_by)
    return evaluated, estimated


def _optional_parts(
    outcome: SearchOutcome,
    evaluated: EvaluatedCases,
    seconds: dict[str, float],
    spectrum: bool,
    baselines: bool,
) -> dict[str, Any]:
    """Compute the optional fields of a result and their node-steps, and add their seconds."""
    end, problem, cases, node_steps = outcome.checkpoint, outcome.problem, evaluated.cases, 0
    fields: dict[str, Any] = {"robust": None, "spectrum": {}}
    nominal: dict[str, Case] = {}
    unsearched: dict[str, Case] = {}
    position = end.finished_searches[0].position
    if outcome.nominal_position is not None and position is not None:
        with optional_part(seconds, "robust"):
            compared = compare_with_nominal(problem, end.single_actuator, position, outcome.nominal_position)
            fields["robust"], nominal, node_steps = compared
    if baselines:
        with optional_part(seconds, "baselines"):
            unsearched, steps = baseline_cases(problem, evaluated.run.times.tolist())
            node_steps += steps
    references = {name: cases[name] for name in ("equal", "single")} | unsearched
    fields["objective_values_by_case"], steps = evaluate_objectives(problem, references)
    if spectrum and not outcome.interrupted and has_spectrum(problem):
        with optional_part(seconds, "spectrum"):
            fields["spectrum"] = make_spectrum(problem, cases["best"])
    return {**fields, "cases": {**cases, **nominal, **unsearched}, "node_steps": node_steps + steps}


def evaluate_targets(problem: Problem, searches: tuple[TargetSearch, ...]) -> EvaluatedCases:
    """Simulate the cases of the first target, and the best drive of every other one."""
    first, *others = searches
    evaluated = evaluate_cases(problem, first.single_actuator, first.position)
    cases, node_steps = dict(evaluated.cases), evaluated.node_steps
    names = list(target_cases(problem.scene.targets).values())[1:]
    for index, (name, search) in enumerate(zip(names, others, strict=False), 1):  # fewer after Ctrl-C
        other = with_target(problem, index)
        more = evaluate_cases(other, search.single_actuator, search.position)
        best = more.cases["best"]
        # Copies, because those of a run are parts of one array.
        cases[name] = replace(best, displacement=best.displacement.copy(), trace=best.trace.copy())
        node_steps += other.drive_solver.node_steps + more.node_steps
    return replace(evaluated, cases=cases, node_steps=node_steps)


def compare_with_nominal(
    problem: Problem, single_actuator: int, position: np.ndarray, nominal_position: np.ndarray
) -> tuple[RobustComparison, dict[str, Case], int]:
    """Compare the position (dimension,) of a robust search with the best one of the nominal plate in new scenarios.

    Return the comparison, the nominal drive as the case "nominal", and the node-steps besides those of the problem.
    """
    nominal, table = problem.nominal, problem.robust
    evaluated = evaluate_cases(nominal, single_actuator, nominal_position)
    designs = problem.parametrization.designs(np.stack([position, nominal_position]))
    losses, node_steps = [], evaluated.node_steps
    stepped = not problem.resolved.by_modes
    for scenario in draw_scenarios(problem.scene, table.fresh, table.seed, validation=True, stepped=stepped):
        panel = simulate_scenarios([scenario], problem.resolved)
        losses.append(panel.losses(designs)[:, 0])
        node_steps += sum(evaluator.node_steps for evaluator in panel.evaluators)
    bound = problem.loss_bound
    comparison = RobustComparison(
        measure=f"quantile {table.quantile:g}" if table.measure == "quantile" else table.measure,
        scenarios=table.scenarios,
        localization=problem.objectives.only_localization,
        bound=None if bound is None else float(problem.value_from_loss(bound.value)),
        searched=np.asarray(problem.value_from_loss(problem.design_losses(designs))),
        nominal_plate=np.asarray(problem.value_from_loss(nominal.design_losses(designs))),
        validation=np.asarray(problem.value_from_loss(np.stack(losses, axis=1))),
    )
    return comparison, {"nominal": evaluated.cases["best"]}, node_steps
