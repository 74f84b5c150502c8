"""Quantities of many scenes that differ in some of their values, and the files of unfinished sweeps."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.cluster.pool import WorkerPool
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.modal.continuous_modes import MOST_MODES
from warp_plate.modal.solver import MODAL
from warp_plate.plate.files import digests, read_beside
from warp_plate.resolve import Purpose, choose_engine, refuse_nonlinear_modes, resolve_for_sweep
from warp_plate.result.checkpoint import ENDING
from warp_plate.result.sweep import REFUSED, RUN, Sweep, load_sweep, save_sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import label_of
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.scene.vary import Plan, counted, make_plan, parse_vary, value_text
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.sweep_points import QUANTITIES, PointResult, run_here, run_on_pool, varied_files
from warp_plate.studies.unfinished import (
    SweepFile,
    changes,
    check_files,
    check_unchanged,
    merged_versions,
    same_device,
    versions,
)

# Called after each point with the points done, their total, and the values of the point.
OnPointProgress = Callable[[int, int, str], object]
# Numbers of a quantity at all points, 8 bytes each.
MOST_NUMBERS = 100_000_000
# Values of options that are left out; None: a new sweep chooses, another one keeps its own.
DEFAULTS = {"what": "localize", "count": 6, "path": "auto", "evaluator": None, "frequencies": ""}


@dataclass(frozen=True)
class SweepRequest:
    """What a user asks for, see :func:`sweep`; None for what is left out."""

    scene: Scene | None
    source: str = ""
    vary: Sequence[str] | Plan | None = None
    what: str | None = None
    samples: int | None = None
    seed: int | None = None
    count: int | None = None
    path: str | None = None
    evaluator: str | None = None
    frequencies: str | None = None

    def options(self, complete: bool) -> dict[str, Any]:
        """Return the options that a sweep keeps, by its attributes; those left out have their defaults if complete."""
        given = {name: getattr(self, name) for name in DEFAULTS}
        return {name: DEFAULTS[name] if complete and value is None else value for name, value in given.items()}

    def plan(self, scene: Scene) -> Plan:
        """Return the points asked for; ``scene`` has the numbers to vary."""
        if isinstance(self.vary, Plan):
            return self.vary
        return make_plan([parse_vary(scene, text) for text in self.vary or ()], self.samples, self.seed or 0)


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

    Values at refused points are NaN, and the reason is stored.

    Raises:
        SceneError: ``vary`` or ``what`` is invalid, or all points are refused.
    """
    request = SweepRequest(Scene.load(scene), source, vary, what, samples, seed, count, path, evaluator, frequencies)
    return run_sweep(start_sweep(request, device if pool is None else "auto"), on_progress, None, pool)


def start_sweep(request: SweepRequest, device: str = "auto") -> Sweep:
    """Return the sweep of a request, without any finished point."""
    scene, asked = request.scene, request.options(complete=True)
    assert scene is not None
    what, count, plan = asked["what"], asked["count"], request.plan(scene)
    if what not in QUANTITIES:
        raise SceneError(f"--what {what}: must be one of {', '.join(QUANTITIES)}")
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"--count {count}: must be from 1 to {MOST_MODES}")
    outputs, used = QUANTITIES[what].outputs, find_device(device)
    if what == "frf" and not asked["frequencies"]:
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
        **asked | {"evaluator": choose_evaluator(scene, plan.keys, what, asked["path"], asked["evaluator"])},
    )
    shapes = {name: (len(plan), *([len(start.along(o.axis))] if o.axis else [])) for name, o in outputs.items()}
    if (largest := max(map(math.prod, shapes.values()))) > MOST_NUMBERS:
        raise SceneError(f"--vary: {largest} numbers of each quantity; at most {MOST_NUMBERS} are kept")
    return replace(start, values={name: np.full(shape, np.nan) for name, shape in shapes.items()})


def file_digests(scene: Scene, plan: Plan) -> dict[str, str]:
    """Return the SHA-256 of each file that a sweep reads by key; of varied names, that of all files one after another.

    Raises:
        SceneError: A file cannot be read.
    """
    files = digests(scene)
    for key, names in varied_files(scene, plan).items():
        whole = hashlib.sha256()
        for name in names:
            whole.update(read_beside(key, name, scene.folder))
        files[key] = whole.hexdigest()
    return files


def choose_evaluator(scene: Scene, keys: Sequence[str], what: str, path: str, asked: str | None = None) -> str:
    """Return the evaluator of a sweep over ``keys`` of a scene: the one asked for, or "modal" where it applies.

    Time steps are taken by default for scenes without modes, and where a path of the steps is asked for or a key of the
    grid is varied.

    Raises:
        SceneError: The evaluator that is asked for cannot compute the quantities, or not of this scene.
    """
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
    file: SweepFile | None = None,
    pool: WorkerPool | None = None,
    on_device_change: Callable[[str], object] | None = None,
) -> Sweep:
    """Run the points that are pending, with one grid for all if the scene asks for an accuracy.

    The result at a point depends only on its scene and the kind of device, so that a resumed or distributed sweep is
    bit-identical.

    Args:
        file: written at intervals, and when Ctrl-C or an error ends the sweep.
        on_progress, pool: see :func:`sweep`.
        on_device_change: called with one line if workers have another kind of processor than earlier points were run on
            (default: that is refused).
    """
    started, total, pending = time.perf_counter(), len(start.plan), start.pending.tolist()
    values = {name: array.copy() for name, array in start.values.items()}
    current = replace(start, values=values, status=start.status.copy())
    if pool is not None and len(pending) == total:
        current = replace(current, device="", processor="")  # the workers report theirs

    def now() -> Sweep:
        return replace(current, seconds=start.seconds + time.perf_counter() - started)

    chosen = start
    if pending and (start.evaluator != MODAL or len(QUANTITIES[start.what].evaluators) > 1):
        chosen = replace(start, scene=resolve_for_sweep(start.scene, start.plan, start.device, start.evaluator))
    try:
        with deferred_interrupts():
            points = run_here(chosen, pending) if pool is None else run_on_pool(chosen, pending, pool)
            for done, result in enumerate(points, total - len(pending) + 1):
                current = _with_result(current, result, on_device_change)
                if on_progress is not None:
                    on_progress(done, total, _describe(result, start))
                if file is not None and file.due():
                    file.save(now())
                check_interrupt()
    except BaseException as error:
        if file is not None and current.status.any() and not isinstance(error, SecondInterrupt):
            file.save(now())
        raise
    if (current.status == REFUSED).all():
        more = f" (and {counted(total - 1, 'point')} more)" if total > 1 else ""
        raise SceneError(f"all points are refused; {current.refusal(0)}{more}")
    return now()


def _with_result(sweep: Sweep, result: PointResult, on_device_change: Callable[[str], object] | None) -> Sweep:
    """Return a sweep with the result at a point, which is written into its arrays, and with the device of the point."""
    if result.processor:
        if sweep.processor not in ("", result.processor):
            before, now = f"{sweep.device} ({sweep.processor})", f"{result.device} ({result.processor})"
            change = f"the sweep began on {before} and continues on {now}, which rounds differently"
            if on_device_change is None:
                raise SceneError(
                    f"{change}, so the result would not be bit-identical: take workers of the first kind, or name "
                    f"theirs to continue anyway, --device {result.device.partition(':')[0]}"
                )
            on_device_change(f"{change}: the result may differ")
        sweep = sweep.moved_to(result.device, result.processor)
    sweep.status[result.point] = REFUSED if result.values is None else RUN
    for name, value in (result.values or {}).items():
        sweep.values[name][result.point] = value
    return replace(sweep, reasons={**sweep.reasons, result.point: result.reason}) if result.values is None else sweep


def _describe(result: PointResult, sweep: Sweep) -> str:
    """Return the values of a point as one line of text."""
    values = sweep.plan.values(result.point).items()
    text = ", ".join(f"{label_of(sweep.scene, key)} {value_text(value)}" for key, value in values)
    return f"{text}: refused" if result.values is None else text


def open_sweep(
    request: SweepRequest,
    target: Path,
    resume: Path | None = None,
    device: str | None = None,
    on_workers: bool = False,
    log: Callable[[str], object] = lambda line: None,
    force: bool = False,
) -> Sweep:
    """Return the sweep to run for a request: the unfinished one of the same request, or a new one.

    Args:
        target: file of the result; unfinished sweeps are beside it.
        resume: unfinished sweep to continue, or the result that it will become; None: one left by the same request, if
            any.
        device: device of the points, or None for the default.
        on_workers: whether workers of a pool run the points, which then report their devices.
        log: called with one line for each thing to know about a sweep that is continued.
        force: whether the result may replace any file.
    """
    unfinished = target.with_suffix(ENDING)
    file = unfinished if unfinished.exists() else None
    if resume is not None:
        beside = resume.with_suffix(ENDING)
        file = beside if beside.exists() else resume
        if unfinished.exists() and not unfinished.samefile(file):
            raise SceneError(f"{unfinished}: holds another unfinished sweep; name another file by --out, or delete it")
    if file is not None:
        sweep = _load_unfinished(file, request, resume is not None)
    else:
        sweep = start_sweep(request, "auto" if on_workers or device is None else device)
    axes = {output.axis for output in sweep.outputs.values()}
    if request.count is not None and "mode" not in axes:
        raise SceneError(f"--count {request.count}: --what {sweep.what} has no modes to count; leave it out")
    if request.frequencies is not None and "frequency" not in axes:
        raise SceneError(f"--frequencies {request.frequencies}: are those of --what frf; leave it out")
    if not force:
        check_same_sweep(target, sweep)
    if file is None:
        return sweep
    log(f"{file}: {sweep.progress} done; {'nothing is left' if sweep.finished else 'continuing'}")
    for line in changes(sweep, None if on_workers or not sweep.processor else device):
        log(f"{file}: {line}")
    return resume_sweep(sweep, device, on_workers)


def resume_sweep(sweep: Sweep, device: str | None = None, on_workers: bool = False) -> Sweep:
    """Return an unfinished sweep as it continues on workers of a pool, on another device, which may round differently,
    or by default on one of the kind that it began on."""
    check_files(file_digests(sweep.scene, sweep.plan), sweep, "sweep")
    if sweep.finished:
        return sweep
    sweep = replace(sweep, versions=merged_versions(sweep.versions))
    if on_workers:
        return sweep
    if device is None:
        device = same_device(sweep.device, sweep.processor, "sweep") if sweep.processor else "auto"
    used = find_device(device)
    return sweep.moved_to(used.alias, processor_of(used))


def save_finished(sweep: Sweep, path: Path, file: SweepFile, force: bool = False) -> None:
    """Save a finished sweep as its result and remove the unfinished file; on failure all points are in that file."""
    try:
        if not force:
            check_same_sweep(path, sweep)
        save_sweep(sweep, path)
    except SceneError:
        file.save(sweep)
        raise
    file.remove()


def check_same_sweep(path: Path, sweep: Sweep) -> None:
    """Check that a result would replace no file other than an earlier result of the same sweep."""
    if not path.exists():
        return
    advice = "name another file by --out, or give --force"
    try:
        existing = load_sweep(path)
    except SceneError as error:
        raise SceneError(f"{error}; {advice}") from None
    same_scene = existing.scene.model_dump() == sweep.scene.model_dump() and existing.files == sweep.files
    for difference, same in (
        ("another scene", same_scene),
        (f"--what {existing.what}", existing.what == sweep.what),
        (f"--count {existing.count}", existing.count == sweep.count),
        (f"--frequencies {existing.frequencies}", existing.frequencies == sweep.frequencies),
        (f"--evaluator {existing.evaluator}", existing.evaluator == sweep.evaluator),
        (f"other points ({existing.plan.description})", existing.plan.same(sweep.plan)),
    ):
        if not same:
            raise SceneError(f"{path}: holds a sweep of {difference}; {advice}")


def _load_unfinished(file: Path, request: SweepRequest, resumed: bool) -> Sweep:
    """Load an unfinished sweep for a request, all of which must be the same if it was not named by ``--resume``."""
    advice = "start again without --resume" if resumed else f"name another file by --out, or delete {file}"
    try:
        sweep = load_sweep(file)
    except SceneError as error:
        raise error if resumed else SceneError(f"{error}; {advice}") from None
    options = request.options(complete=not resumed)
    check_unchanged(sweep, f"sweep in {file}", options, (request.scene, sweep.scene), advice)
    if (request.vary or not resumed) and not request.plan(sweep.scene).same(sweep.plan):
        raise SceneError(
            f"--vary: the sweep in {file} began with other points ({sweep.plan.description}) and continues with "
            f"nothing else; {'leave --vary out, or ' if resumed else ''}{advice}"
        )
    # Files that the scene names are beside the scene, not beside the sweep.
    return sweep if request.scene is None else replace(sweep, scene=sweep.scene.in_folder(request.scene.folder))
