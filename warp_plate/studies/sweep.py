"""Quantities of interest of many scenes that differ in some of their numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.cluster.pool import WorkerPool
from warp_plate.interrupts import SecondInterrupt, check_interrupt, deferred_interrupts
from warp_plate.plate.files import digests
from warp_plate.result.sweep import REFUSED, RUN, Sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import label_of
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import Plan, counted, make_plan, parse_vary
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.checkpointing import SweepFile
from warp_plate.studies.provenance import versions
from warp_plate.studies.quantities_of_interest import QUANTITIES
from warp_plate.studies.sweep_point import PointResult, run_here, run_on_pool

# Called after each point with the points done, their total, and the numbers of the point.
OnPointProgress = Callable[[int, int, str], object]
MOST_MODES = 1000


def sweep(
    scene: Scene,
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
) -> Sweep:
    """Compute the quantities of a command at every point of a plan.

        >>> found = sweep(Scene.load("paper"), ["drive.frequency=200:400:21"])
        >>> found.plan.coordinates[0], found.shaped("best")      # (21,) Hz, (21,) localization factors

    Args:
        scene: scene whose numbers are varied; ``source`` is its name, kept in the result.
        vary: strings as for ``--vary``: KEY=START:STOP:COUNT, KEY=log:START:STOP:COUNT or KEY=a,b,c.
        what: a key of QUANTITIES; ``count`` is the number of modes.
        samples, seed: number of points of a Latin hypercube in place of the full grid, and its random seed.
        device, path: see :class:`PlateSolver`; the workers of a pool have devices of their own.
        on_progress: called after each point.
        pool: workers that run the points (default: this process).

    Values at points whose scene is refused are NaN, and the reason is kept.

    Raises:
        SceneError: ``vary`` or ``what`` is invalid, or all points are refused.
    """
    plan = vary if isinstance(vary, Plan) else make_plan([parse_vary(scene, text) for text in vary], samples, seed)
    start = start_sweep(scene, plan, what, device if pool is None else "auto", path, source, count)
    return run_sweep(start, on_progress, None, pool)


def start_sweep(
    scene: Scene, plan: Plan, what: str, device: str = "auto", path: str = "auto", source: str = "", count: int = 6
) -> Sweep:
    """Return a sweep without any finished point; see :func:`sweep` for the arguments."""
    if what not in QUANTITIES:
        raise SceneError(f"--what {what}: must be one of {', '.join(QUANTITIES)}")
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"--count {count}: must be from 1 to {MOST_MODES}")
    outputs, used = QUANTITIES[what].outputs, find_device(device)
    shapes = {name: (len(plan), count) if output.axis else (len(plan),) for name, output in outputs.items()}
    return Sweep(
        source=source,
        scene=scene,
        files=digests(scene),
        plan=plan,
        what=what,
        count=count,
        device=used.alias,
        processor=processor_of(used),
        earlier_devices="",
        path=path,
        outputs=outputs,
        values={name: np.full(shape, np.nan) for name, shape in shapes.items()},
        status=np.zeros(len(plan), dtype="i1"),
        reasons={},
        seconds=0.0,
        versions=versions(),
    )


def run_sweep(
    start: Sweep,
    on_progress: OnPointProgress | None = None,
    file: SweepFile | None = None,
    pool: WorkerPool | None = None,
    on_device_change: Callable[[str], object] | None = None,
) -> Sweep:
    """Run the points that are pending.

    The result at a point depends only on its scene and the kind of device, so that a resumed or distributed sweep is
    bit-identical.

    Args:
        on_progress: called after each point.
        file: written at intervals, and when Ctrl-C or an error ends the sweep.
        pool: see :func:`sweep`.
        on_device_change: called with one line if workers have another kind of processor than earlier points were run on
            (default: that is refused).
    """
    values = {name: array.copy() for name, array in start.values.items()}
    status, reasons, started = start.status.copy(), dict(start.reasons), time.perf_counter()
    total, pending = len(start.plan), start.pending.tolist()
    current = start
    if pool is not None and len(pending) == total:
        current = replace(start, device="", processor="")  # the workers report theirs

    def now() -> Sweep:
        seconds = start.seconds + time.perf_counter() - started
        return replace(current, values=values, status=status, reasons=reasons, seconds=seconds)

    def save() -> None:
        if file is not None and len(now().pending) < total:
            file.save(now())

    try:
        with deferred_interrupts():
            points = run_here(start, pending) if pool is None else run_on_pool(start, pending, pool)
            for done, result in enumerate(points, total - len(pending) + 1):
                if result.processor:
                    _check_processor(current, result, on_device_change)
                    current = current.moved_to(result.device, result.processor)
                if result.values is None:
                    reasons[result.point] = result.reason
                else:
                    for name, value in result.values.items():
                        values[name][result.point] = value
                status[result.point] = REFUSED if result.values is None else RUN
                if on_progress is not None:
                    on_progress(done, total, _describe(result, start))
                if file is not None and file.due():
                    save()
                check_interrupt()
    except SecondInterrupt:
        raise
    except BaseException:
        save()
        raise
    if (status == REFUSED).all():
        more = f" (and {counted(total - 1, 'point')} more)" if total > 1 else ""
        raise SceneError(f"all points are refused; {now().refusal(0)}{more}")
    return now()


def _check_processor(current: Sweep, result: PointResult, on_device_change: Callable[[str], object] | None) -> None:
    """Report that a point was run on another kind of processor than those before it."""
    if current.processor in ("", result.processor):
        return
    before, now = f"{current.device} ({current.processor})", f"{result.device} ({result.processor})"
    change = f"the sweep began on {before} and continues on {now}, which rounds differently"
    if on_device_change is None:
        kind = result.device.partition(":")[0]
        raise SceneError(
            f"{change}, so the result would not be bit-identical: take workers of the first kind, or name theirs to "
            f"continue anyway, --device {kind}"
        )
    on_device_change(f"{change}: the result may differ")


def _describe(result: PointResult, sweep: Sweep) -> str:
    """Return the numbers of a point as one line of text."""
    numbers = sweep.plan.numbers(result.point).items()
    text = ", ".join(f"{label_of(sweep.scene, key)} {value:.4g}" for key, value in numbers)
    return f"{text}: refused" if result.values is None else text
