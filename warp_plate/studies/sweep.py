"""Quantities of interest of many scenes that differ in some of their values, here or on the workers of a pool."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.cluster.pool import WorkerPool
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.modal.continuous_modes import MOST_MODES
from warp_plate.modal.solver import MODAL, has_modes, refuse_no_modes
from warp_plate.plate.files import digests, read_beside
from warp_plate.result.sweep import REFUSED, RUN, Sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import label_of
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.scene.vary import Plan, counted, make_plan, parse_vary, value_text
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.checkpointing import SweepFile
from warp_plate.studies.grid_choice import resolve_for_sweep
from warp_plate.studies.provenance import versions
from warp_plate.studies.quantities_of_interest import QUANTITIES
from warp_plate.studies.sweep_points import PointResult, run_here, run_on_pool, varied_files

# Called after each point with the points done, their total, and the values of the point.
OnPointProgress = Callable[[int, int, str], object]
# Numbers of a quantity at all points, 8 bytes each.
MOST_NUMBERS = 100_000_000


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

        >>> found = sweep(Scene.load("paper"), ["drive.frequency=200:400:21"])
        >>> found.plan.coordinates[0], found.shaped("best")      # (21,) Hz, (21,) localization factors

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
    scene = Scene.load(scene)
    plan = vary if isinstance(vary, Plan) else make_plan([parse_vary(scene, text) for text in vary], samples, seed)
    device = device if pool is None else "auto"
    start = start_sweep(scene, plan, what, device, path, source, count, evaluator, frequencies)
    return run_sweep(start, on_progress, None, pool)


def start_sweep(
    scene: Scene,
    plan: Plan,
    what: str,
    device: str = "auto",
    path: str = "auto",
    source: str = "",
    count: int = 6,
    evaluator: str | None = None,
    frequencies: str = "",
) -> Sweep:
    """Return a sweep without any finished point; see :func:`sweep` for the arguments."""
    if what not in QUANTITIES:
        raise SceneError(f"--what {what}: must be one of {', '.join(QUANTITIES)}")
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"--count {count}: must be from 1 to {MOST_MODES}")
    outputs, used = QUANTITIES[what].outputs, find_device(device)
    if what == "frf" and not frequencies:
        raise SceneError("--what frf: at which frequencies? write --frequencies LOW:HIGH:COUNT (hertz)")
    start = Sweep(
        source=source,
        scene=scene,
        files=file_digests(scene, plan),
        plan=plan,
        what=what,
        count=count,
        frequencies=frequencies,
        device=used.alias,
        processor=processor_of(used),
        earlier_devices="",
        path=path,
        evaluator=choose_evaluator(scene, plan.keys, what, path, evaluator),
        outputs=outputs,
        values={},
        status=np.zeros(len(plan), dtype="i1"),
        reasons={},
        seconds=0.0,
        versions=versions(),
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
        refuse_no_modes(scene)
        if path != "auto":
            raise SceneError(f"--evaluator modal: takes no steps, which --path {path} asks for; leave one of them out")
    if asked is not None or len(evaluators) == 1:
        return asked or evaluators[0]
    for_steps = path != "auto" or any(key.startswith("grid.") for key in keys)
    return MODAL if scene.modal_only_key is not None or (has_modes(scene) and not for_steps) else "direct"


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
