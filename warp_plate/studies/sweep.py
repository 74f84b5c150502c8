"""Quantities of many scenes that differ in some of their values, and the files of unfinished sweeps."""

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from warp_plate.cluster.pool import WorkerPool
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.modal.continuous_modes import MOST_MODES
from warp_plate.modal.solver import MODAL
from warp_plate.plate.files import digests
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.resolve import Purpose, choose_engine, refuse_nonlinear_modes, resolve_for_sweep
from warp_plate.result.checkpoint import ENDING
from warp_plate.result.sweep import REFUSED, RUN, Sweep, load_sweep, save_sweep
from warp_plate.scene.errors import SceneError, check_function, check_type
from warp_plate.scene.keys import label_of
from warp_plate.scene.load import read_beside
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.scene.vary import Plan, counted, make_plan, parse_vary, value_text
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.sweep_points import QUANTITIES, PointResult, run_here, run_on_pool, varied_files
from warp_plate.studies.unfinished import CheckpointFile, changes, device_like, merged_versions, versions

# Called after each point with the points done, their total, and the values of the point.
OnPointProgress = Callable[[int, int, str], object]
# Numbers of a quantity at all points, and bytes for each number while a sweep runs and its file is composed.
MOST_NUMBERS, BYTES_A_NUMBER = 100_000_000, 56.0
# Options that a sweep keeps, and their values in a new sweep where they are left out.
DEFAULTS = {"what": "localize", "count": 6, "path": "auto", "evaluator": None, "frequencies": ""}


@dataclass(frozen=True)
class SweepRequest:
    """Arguments of :func:`sweep`; None for those left out."""

    scene: Scene
    source: str = ""
    vary: Sequence[str] | Plan = ()
    what: str | None = None
    samples: int | None = None
    seed: int | None = None
    count: int | None = None
    path: str | None = None
    evaluator: str | None = None
    frequencies: str | None = None


def sweep(
    scene: SceneSource,
    vary: Sequence[str] | Plan,
    what: str = "localize",
    samples: int | None = None,
    seed: int = 0,
    device: str = "auto",
    path: str = "auto",
    source: str = "",
    count: int = 6,
    on_progress: OnPointProgress | None = None,
    pool: WorkerPool | None = None,
    evaluator: str | None = None,
    frequencies: str = "",
) -> Sweep:
    """Compute the quantities of a command at every point of a plan.

        >>> result = sweep(Scene.load("paper"), ["drive.frequency=200:400:21"])
        >>> result.plan.coordinates[0], result.shaped("best")      # (21,) Hz, (21,) localization factors

    Args:
        scene: scene with values to vary; ``source`` is its name, kept in the result.
        vary: strings as for ``--vary``: KEY=START:STOP:COUNT, KEY=log:START:STOP:COUNT or KEY=a,b,c.
        what: a key of QUANTITIES; ``count`` is the number of modes.
        samples, seed: number of points of a Latin hypercube in place of the full grid, and its random seed.
        device, path: see :class:`PlateSolver`; the workers of a pool have separate devices.
        on_progress: called after each point.
        pool: workers that run the points (default: this process).
        evaluator: "modal" for the modes of the plate, "direct" for time steps (default: see :func:`choose_evaluator`).
        frequencies: range of frequencies [Hz] of frequency responses, written as in ``vary``.

    Values at refused points are NaN, and the reason is stored. Ctrl-C ends the sweep early; the result then has the
    points that are done, and NaN at those that are ``pending``.

    Raises:
        SceneError: ``vary`` or ``what`` is invalid, or all points are refused.
    """
    for key, text in {"source": source, "frequencies": frequencies}.items():
        check_type(key, text, str)
    for key, name in {"what": what, "path": path, "evaluator": evaluator}.items():
        check_type(key, name, str, NoneType)
    for key, number in {"samples": samples, "seed": seed, "count": count}.items():
        if not isinstance(number, Integral | None):
            raise SceneError(f"{key} = {number!r}: must be a whole number")
    check_type("pool", pool, WorkerPool, NoneType)
    check_function("on_progress", on_progress)
    request = SweepRequest(Scene.load(scene), source, vary, what, samples, seed, count, path, evaluator, frequencies)
    return run_sweep(start_sweep(request, device if pool is None else "auto"), on_progress, None, pool)


def start_sweep(request: SweepRequest, device: str = "auto") -> Sweep:
    """Return the sweep of a request, without any finished point."""
    asked = {name: getattr(request, name) for name in DEFAULTS}
    kept: dict[str, Any] = DEFAULTS | {name: value for name, value in asked.items() if value is not None}
    scene, plan, what, count = request.scene, request.vary, kept["what"], kept["count"]
    if not isinstance(plan, Plan):
        check_type("vary", plan, list, tuple, np.ndarray, Plan)
        for index, text in enumerate(plan):
            check_type(f"vary[{index}]", text, str)
        plan = make_plan([parse_vary(scene, text) for text in plan], request.samples, request.seed or 0)
    if what not in QUANTITIES:
        raise SceneError(f"--what {what}: must be one of {', '.join(QUANTITIES)}")
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"--count {count}: must be from 1 to {MOST_MODES}")
    outputs, used = QUANTITIES[what].outputs, find_device(device)
    if what == "frf" and not kept["frequencies"]:
        raise SceneError("--what frf: at which frequencies? write --frequencies LOW:HIGH:COUNT (hertz)")
    start = Sweep(
        source=request.source,
        scene=scene,
        files=file_digests(scene, plan),
        plan=plan,
        device=used.alias,
        processor=processor_of(used),
        earlier_devices="",
        outputs=outputs,
        values={},
        status=np.zeros(len(plan), dtype="i1"),
        reasons={},
        seconds=0.0,
        versions=versions(),
        **kept | {"evaluator": choose_evaluator(scene, plan.keys, what, kept["path"], kept["evaluator"])},
    )
    shapes = {name: (len(plan), *([len(start.along(o.axis))] if o.axis else [])) for name, o in outputs.items()}
    if (largest := max(map(math.prod, shapes.values()))) > MOST_NUMBERS:
        raise SceneError(f"--vary: {largest} numbers of each quantity; at most {MOST_NUMBERS} are kept")
    numbers = sum(map(math.prod, shapes.values()))
    refuse_beyond_memory(BYTES_A_NUMBER * numbers, f"--vary: {numbers} numbers at {counted(len(plan), 'point')}")
    return replace(start, values={name: np.full(shape, np.nan) for name, shape in shapes.items()})


def file_digests(scene: Scene, plan: Plan) -> dict[str, str]:
    """Return the SHA-256 of each file that a sweep reads by key; of varied names, that of all one after another."""
    files = digests(scene.named_files, scene.folder)
    for key, names in varied_files(scene, plan).items():
        whole = hashlib.sha256()
        for name in names:
            whole.update(read_beside(key, name, scene.folder))
        files[key] = whole.hexdigest()
    return files


def choose_evaluator(scene: Scene, keys: Sequence[str], what: str, path: str, asked: str | None = None) -> str:
    """Return the evaluator of a sweep over ``keys`` of a scene: the one asked for, or "modal" for scenes with modes,
    unless a path of time steps is asked for or a key of the grid is varied."""
    evaluators = QUANTITIES[what].evaluators
    if asked not in (None, *evaluators):
        raise SceneError(f"--evaluator {asked}: --what {what} is always {evaluators[0]}; leave it out")
    if asked == MODAL and len(evaluators) > 1:
        refuse_nonlinear_modes(scene)
        if path != "auto":
            raise SceneError(f"--evaluator modal: takes no steps, which --path {path} asks for; leave one of them out")
    if asked is not None or len(evaluators) == 1:
        return asked or evaluators[0]
    purpose: Purpose = "replay" if any(key.startswith("grid.") for key in keys) else "survey"
    return MODAL if choose_engine(scene, purpose, path) == "modes" else "direct"


def run_sweep(
    start: Sweep,
    on_progress: OnPointProgress | None = None,
    file: CheckpointFile | None = None,
    pool: WorkerPool | None = None,
) -> Sweep:
    """Run the points that are pending, with one grid for all if the scene asks for an accuracy.

    The result at a point depends only on its scene and the kind of device, so that a resumed or distributed sweep is
    bit-identical.

    Args:
        file: written at intervals, and when Ctrl-C or an error ends the sweep; without one, Ctrl-C returns the points
            that are done.
        on_progress, pool: see :func:`sweep`.
    """
    started, total, pending = time.perf_counter(), len(start.plan), start.pending.tolist()
    values = {name: array.copy() for name, array in start.values.items()}
    status, reasons = start.status.copy(), dict(start.reasons)
    current = replace(start, values=values, status=status, reasons=reasons)
    if pool is not None and len(pending) == total:
        current = replace(current, device="", processor="")  # the workers report theirs

    def now() -> Sweep:
        arrays = {name: array.copy() for name, array in values.items()}
        seconds = start.seconds + time.perf_counter() - started
        return replace(current, values=arrays, status=status.copy(), reasons=dict(reasons), seconds=seconds)

    chosen = start
    if pending and (start.evaluator != MODAL or len(QUANTITIES[start.what].evaluators) > 1):
        chosen = replace(start, scene=resolve_for_sweep(start.scene, start.plan, start.device, start.evaluator))
    try:
        with deferred_interrupts():
            points = run_here(chosen, pending) if pool is None else run_on_pool(chosen, pending, pool)
            for done, result in enumerate(points, total - len(pending) + 1):
                if result.processor:
                    current = current.moved_to(result.device, result.processor)
                status[result.point] = REFUSED if result.values is None else RUN
                if result.values is None:
                    reasons[result.point] = result.reason
                for name, value in (result.values or {}).items():
                    values[name][result.point] = value
                if on_progress is not None:
                    on_progress(done, total, _describe(result, start))
                if file is not None and file.due():
                    file.save(now())
                check_interrupt()
    except BaseException as error:
        if not current.status.any() or isinstance(error, SecondInterrupt):
            raise
        if file is None and isinstance(error, KeyboardInterrupt):
            return now()
        if file is not None:
            file.save(now())
        raise
    if (current.status == REFUSED).all():
        more = f" (and {counted(total - 1, 'point')} more)" if total > 1 else ""
        raise SceneError(f"all points are refused; {current.refusal(0)}{more}")
    return now()


def _describe(result: PointResult, sweep: Sweep) -> str:
    """Return the values of a point as one line of text."""
    values = sweep.plan.values(result.point).items()
    text = ", ".join(f"{label_of(sweep.scene, key)} {value_text(value)}" for key, value in values)
    return f"{text}: refused" if result.values is None else text


def open_sweep(
    request: SweepRequest,
    target: Path,
    device: str | None = None,
    on_workers: bool = False,
    log: Callable[[str], object] = lambda line: None,
    force: bool = False,
) -> Sweep:
    """Return the sweep to run for a request: the unfinished one of the same request beside ``target``, or a new one.

    Workers report their devices. ``log`` is called with each line to know, and ``force`` lets the result replace any
    file.
    """
    file = target.with_suffix(ENDING)
    sweep = start_sweep(request, "auto" if on_workers or device is None or file.exists() else device)
    axes = {output.axis for output in sweep.outputs.values()}
    if request.count is not None and "mode" not in axes:
        raise SceneError(f"--count {request.count}: --what {sweep.what} has no modes to count; leave it out")
    if request.frequencies is not None and "frequency" not in axes:
        raise SceneError(f"--frequencies {request.frequencies}: are those of --what frf; leave it out")
    if not force:
        check_replaceable(target, sweep)
    if not file.exists():
        return sweep
    advice = f"name another file by --out, or delete {file}"
    unfinished = _load(file, advice)
    check_same_sweep(file, unfinished, sweep, advice)
    sweep = replace(unfinished, scene=sweep.scene)  # files that it names are beside the scene, not beside the sweep
    log(f"{file}: {sweep.progress} done; {'nothing is left' if sweep.finished else 'continuing'}")
    for line in changes(sweep, None if on_workers or not sweep.processor else device or device_like(sweep)):
        log(f"{file}: {line}")
    return resume_sweep(sweep, device, on_workers)


def _load(path: Path, advice: str) -> Sweep:
    """Load a sweep; an error says what to do."""
    try:
        return load_sweep(path)
    except SceneError as error:
        raise SceneError(f"{error}; {advice}") from None


def check_replaceable(target: Path, sweep: Sweep) -> None:
    """Check that a result replaces no file other than an earlier result of the same sweep."""
    advice = "name another file by --out, or give --force"
    if target.exists():
        check_same_sweep(target, _load(target, advice), sweep, advice)


def check_same_sweep(path: Path, existing: Sweep, sweep: Sweep, advice: str) -> None:
    """Check that a file holds an earlier run of a sweep; an error says what to do."""
    differences = [] if existing.scene.model_dump() == sweep.scene.model_dump() else ["another scene"]
    differences += [f"another {key}" for key, digest in existing.files.items() if digest != sweep.files.get(key)]
    for name in DEFAULTS:
        if getattr(existing, name) != getattr(sweep, name):
            differences.append(f"--{name} {getattr(existing, name)}")
    if not existing.plan.same(sweep.plan):
        differences.append(f"other points ({existing.plan.description})")
    if differences:
        raise SceneError(f"{path}: holds a sweep of {differences[0]}; {advice}")


def resume_sweep(sweep: Sweep, device: str | None = None, on_workers: bool = False) -> Sweep:
    """Return an unfinished sweep as it continues on workers of a pool, or on a device (default: one of its kind)."""
    if sweep.finished:
        return sweep
    sweep = replace(sweep, versions=merged_versions(sweep.versions))
    if on_workers:
        return sweep
    used = find_device(device or device_like(sweep))
    return sweep.moved_to(used.alias, processor_of(used))


def save_finished(sweep: Sweep, path: Path, file: CheckpointFile, force: bool = False) -> None:
    """Save a finished sweep as its result and remove the unfinished file; on failure all points are in that file."""
    try:
        if not force:  # checked again, because another program may have written the file meanwhile
            check_replaceable(path, sweep)
        save_sweep(sweep, path)
    except SceneError:
        file.save(sweep)
        raise
    file.remove()
