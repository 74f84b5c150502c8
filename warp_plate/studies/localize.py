"""The complete search: choose engine and grid, search for each target, and compose the result."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from warp_plate.accuracy.more_functions import MoreFunctions
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import MODAL, has_modes
from warp_plate.plate.files import digests
from warp_plate.problem.evaluate_cases import EvaluatedCases, evaluate_objectives
from warp_plate.problem.methods import with_method
from warp_plate.problem.problem import EvaluatorName, Problem, default_evaluator, make_problem
from warp_plate.result.atomic_io import write_atomically
from warp_plate.result.checkpoint import Checkpoint, load_newest
from warp_plate.result.model import Result, best_drive_scenes
from warp_plate.scene.errors import SceneError, printable
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.solve.devices import processor_of
from warp_plate.studies import provenance
from warp_plate.studies.baselines import baseline_cases, check_baselines
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.studies.driver import OnProgress
from warp_plate.studies.grid_choice import estimate_error, resolve_search_grid
from warp_plate.studies.spectrum import make_spectrum
from warp_plate.studies.target_searches import evaluate_targets, initial_state, search_targets
from warp_plate.studies.validation import compare_with_nominal

T = TypeVar("T")


@dataclass(frozen=True)
class _Options:
    """Options for reports, checkpoints and further results of a search; see :func:`localize`."""

    on_progress: OnProgress | None
    checkpoints: CheckpointFile | None
    estimate: bool
    spectrum: bool
    baselines: bool


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

    With several targets, there is a search and a best drive for each (see ``result.targets``).
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
    scene = Scene.load(scene)
    if baselines:
        check_baselines(scene)
    start, problem, reference = _new_search(scene, source, device, seed, evaluator, path, pool)
    return _run(start, problem, _Options(on_progress, checkpoints, estimate, spectrum, baselines), reference)


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
        device: another device than the search began on, which may round differently (default: one of the same kind).
        on_progress, estimate, checkpoints, spectrum, pool, baselines: see :func:`localize`.

    Raises:
        SceneError: the device does not exist, a file that the scene names is missing or has changed, or the checkpoint
            does not fit its scene.
    """
    if baselines:
        check_baselines(checkpoint.scene)
    started, matrices, earlier = time.perf_counter(), checkpoint.matrices, checkpoint.earlier_devices
    provenance.check_files(digests(checkpoint.scene), checkpoint, "search")
    device = device or provenance.same_device(checkpoint.device, checkpoint.processor, "search")
    problem = make_problem(checkpoint.scene, device, checkpoint.path, checkpoint.evaluator, matrices, pool)
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
        versions=provenance.merged_versions(checkpoint.versions),
    )
    return _run(start, problem, _Options(on_progress, checkpoints, estimate, spectrum, baselines))


def load_to_resume(
    file: Path, scene: Scene | None, device: str | None, log: Callable[[str], object], **options: object
) -> Checkpoint:
    """Load a checkpoint for :func:`resume`, or the one before it if it is damaged.

    Args:
        scene: scene as given again, or None; files that it names are looked for in its folder.
        log: called with a line for each thing that may change the last digits of the result.
        options: values given again by their names in :class:`Checkpoint`, or None.
    """
    checkpoint, remark = load_newest(file)
    if remark:
        log(remark)
    known = checkpoint.scene_as_written
    provenance.check_unchanged(checkpoint, f"search in {file}", options, (scene, known), "start again without --resume")
    if scene is not None:
        gridded = checkpoint.scene.in_folder(scene.folder)
        checkpoint = replace(checkpoint, scene_as_written=known.in_folder(scene.folder), scene=gridded)
    for line in provenance.changes(checkpoint, device):
        log(f"{file}: {line}")
    return checkpoint


def save_best_scenes(result: Result, path: Path) -> list[Path]:
    """Write the scene that ``simulate`` runs as the best drive found, PATH.toml; of several targets one each, the
    others as PATH.2.toml, PATH.3.toml, ..."""
    files = []
    for number, scene in enumerate(best_drive_scenes(result).values(), 1):
        file = path if number == 1 else path.with_suffix(f".{number}.toml")
        command = f"warp-plate simulate {file.name}" + (" --path modal" if result.evaluator == MODAL else "")
        head = f"# Found by: warp-plate localize {result.source}\n# Run it by: {command}\n"
        if result.evaluator == MODAL:
            head += "# By modes, [grid] only says at which points results are given.\n"
        write_atomically((printable(head) + scene.to_toml()).encode(), file)
        files.append(file)
    return files


def _new_search(
    scene: Scene,
    source: str,
    device: str,
    seed: int | None,
    evaluator: EvaluatorName | None,
    path: str,
    pool: WorkerPool | None,
) -> tuple[Checkpoint, Problem, MoreFunctions | None]:
    """Return the checkpoint of iteration 0, its problem, and the reference solution if the grid was chosen by one."""
    seed = scene.search.seed if seed is None else seed
    if not 0 <= seed < 2**63:
        raise SceneError(f"seed = {seed}: must be an integer from 0 to 2^63 - 1")
    files, written = digests(scene), scene
    scene = with_method(scene)
    if evaluator is None and scene.grid.accuracy is None:
        exact = written.search.method is None and scene.search.method == "exact"
        evaluator = MODAL if exact and path == "auto" and has_modes(scene) else default_evaluator(scene, path)
    resolved, started = resolve_search_grid(scene, device, evaluator, path), time.perf_counter()
    problem = make_problem(resolved.scene, device, path, resolved.evaluator, pool=pool)
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
        versions=provenance.versions(),
        node_steps=problem.node_steps,
        **initial,
    )
    return start, problem, resolved.reference


def _run(
    start: Checkpoint,
    problem: Problem,
    options: _Options,
    reference: MoreFunctions | None = None,
) -> Result:
    """Run a search from a checkpoint, which may be that of iteration 0, and make its result."""
    end, problem, interrupted = search_targets(start, problem, options.on_progress, options.checkpoints)
    first, seconds, before = end.finished_searches[0], dict(end.seconds), problem.node_steps
    started = time.perf_counter()
    evaluated = evaluate_targets(problem, end.finished_searches)
    seconds["solve"] += time.perf_counter() - started
    known = reference if evaluated.scene is problem.scene else None  # that of another plate does not help
    parts = _optional_parts(end, problem, evaluated, options, seconds, interrupted, known)
    node_steps = end.node_steps + problem.node_steps - before + evaluated.node_steps + parts.pop("node_steps")
    return Result(
        command="localize",
        source=end.source,
        scene=problem.scene,
        device=end.earlier_devices + provenance.devices_text(problem),
        seed=end.seed,
        seconds=seconds,
        bound=first.bound,
        bound_kind=first.bound_kind,
        history=first.history,
        objective_values=first.objective_values,
        evaluator=end.evaluator,
        interrupted=interrupted,
        versions=end.versions,
        node_steps=node_steps,
        evaluations=sum(search.evaluations for search in end.finished_searches),
        peak_displacement=evaluated.peak,
        target_searches=end.finished_searches if problem.scene.targets else (),
        lost_plates=end.lost_plates,
        **provenance.run_fields(problem.plates.designs.solver, evaluated.run),
        **parts,
    )


def _optional_parts(
    end: Checkpoint,
    problem: Problem,
    evaluated: EvaluatedCases,
    options: _Options,
    seconds: dict[str, float],
    interrupted: bool,
    reference: MoreFunctions | None,
) -> dict[str, Any]:
    """Compute the optional fields of a result and their node-steps, and add their seconds; a part that is refused or
    interrupted is left out."""

    def attempt(name: str, wanted: bool, compute: Callable[..., T | None], *arguments: Any) -> T | None:
        started = time.perf_counter()
        try:
            value = compute(*arguments) if wanted else None
        except (KeyboardInterrupt, SceneError):
            return None
        if value:
            seconds[name] = time.perf_counter() - started
        return value

    position, best, run = end.finished_searches[0].position, evaluated.cases["best"], evaluated.run
    is_robust = problem.scenario_losses is not None and position is not None and not interrupted
    robust, nominal, steps = attempt("robust", is_robust, compare_with_nominal, problem, end, position) or (None, {}, 0)
    device, by_modes = problem.drive_solver.device.alias, end.evaluator == MODAL
    of_run = evaluated.scene, evaluated.phasors, run, device, reference, by_modes
    estimated = attempt("estimate", options.estimate, estimate_error, *of_run) or {}
    baselines, more_steps = attempt("baselines", options.baselines, baseline_cases, problem) or ({}, 0)
    references = {name: evaluated.cases[name] for name in ("equal", "single")} | baselines
    values, last_steps = evaluate_objectives(problem, references)
    spectrum = attempt("spectrum", options.spectrum and not interrupted, make_spectrum, problem, best) or {}
    return {
        "cases": {**evaluated.cases, **nominal, **baselines},
        "accuracy": {**end.accuracy, **estimated},
        "robust": robust,
        "objective_values_by_case": values,
        "spectrum": spectrum,
        "node_steps": steps + more_steps + last_steps,
    }
