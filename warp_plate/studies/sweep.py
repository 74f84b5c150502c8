"""One command's figures over many scenes that differ in some of their numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.cluster.pool import Pool
from warp_plate.interrupts import check_interrupt, deferred_interrupts
from warp_plate.plate.files import digests
from warp_plate.result.sweep import REFUSED, RUN, Sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import label_of
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import Plan, counted, make_plan, parse_vary
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.localize import versions
from warp_plate.studies.quantities_of_interest import QUANTITIES
from warp_plate.studies.sweep_point import Found, run_here, run_there

# Told after each point: points done, in all, and what was found or refused, in a word.
OnProgress = Callable[[int, int, str], object]
# Told in one line that points go on on another processor.
Elsewhere = Callable[[str], object]
# Takes what there is so far; whether the sweep is at its end or was interrupted.
Keep = Callable[[Sweep, bool], object]
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
    on_progress: OnProgress | None = None,
    pool: Pool | None = None,
) -> Sweep:
    """The figures of a command at every point of what is varied.

        >>> found = sweep(Scene.load("paper"), ["drive.frequency=200:400:21"])
        >>> found.plan.coordinates[0], found.shaped("best")      # (21,) Hz, (21,) localization factors

    Args:
        scene: where nothing is varied; source: its name, kept in the result.
        vary: KEY=START:STOP:COUNT, KEY=log:START:STOP:COUNT or KEY=a,b,c each, in the words of ``--vary``.
        what: of ``search.figures.QUANTITIES``; count: how many modes.
        samples, seed: draw so many points from a Latin hypercube instead of the full grid.
        device, path: see :class:`PlateSolver`; a pool's workers have its device, and this one is not read.
        on_progress: called after each point.
        pool: whose workers run the points, see ``cluster.pool``; left out: this process.

    A point whose scene is refused is NaN in all outputs, and its reason is kept.

    Raises:
        SceneError: ``--vary`` or ``what`` is wrong; or all points are refused.
    """
    plan = vary if isinstance(vary, Plan) else make_plan([parse_vary(scene, one) for one in vary], samples, seed)
    here = device if pool is None else "auto"
    return run_sweep(begin_sweep(scene, plan, what, here, path, source, count), on_progress, None, pool)


def begin_sweep(
    scene: Scene, plan: Plan, what: str, device: str = "auto", path: str = "auto", source: str = "", count: int = 6
) -> Sweep:
    """A sweep of which no point is run yet; for the arguments see :func:`sweep`. device: "auto" where a pool's workers
    will run its points, who say on what.

    Raises:
        SceneError: no such figures or device, or a file that the scene names is missing.
    """
    if what not in QUANTITIES:
        raise SceneError(f"--what {what}: must be one of {', '.join(QUANTITIES)}")
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"--count {count}: must be from 1 to {MOST_MODES}")
    outputs, found = QUANTITIES[what].outputs, find_device(device)
    return Sweep(
        source=source,
        scene=scene,
        files=digests(scene),
        plan=plan,
        what=what,
        count=count,
        device=found.alias,
        processor=processor_of(found),
        earlier_devices="",
        path=path,
        outputs=outputs,
        values={name: np.full((len(plan), *((count,) if one.axis else ())), np.nan) for name, one in outputs.items()},
        status=np.zeros(len(plan), dtype="i1"),
        reasons={},
        seconds=0.0,
        versions=versions(),
    )


def run_sweep(
    begun: Sweep,
    on_progress: OnProgress | None = None,
    keep: Keep | None = None,
    pool: Pool | None = None,
    elsewhere: Elsewhere | None = None,
) -> Sweep:
    """Run the points that are left. What is found at a point depends on nothing but its scene and the kind of device,
    so that a sweep that goes on, or whose points are run elsewhere, gives the same to the last bit.

    Args:
        on_progress: called after each point.
        keep: after each point too, and with True where Ctrl-C or an error ends the run.
        pool: see :func:`sweep`.
        elsewhere: called where its workers have another processor than the points that are done
            were run on; left out: that is refused.

    Raises:
        SceneError: all points are refused; the first one's reason. Or workers are not alike, or have another processor.
        WorkersGone: see there, after ``keep`` was called.
        KeyboardInterrupt: Ctrl-C, after ``keep`` was called.
    """
    values = {name: one.copy() for name, one in begun.values.items()}
    status, reasons, started = begun.status.copy(), dict(begun.reasons), time.perf_counter()
    if pool is not None and len(begun.pending) == len(begun.plan):
        begun = replace(begun, device="", processor="")  # which the workers say

    def now() -> Sweep:
        spent = begun.seconds + time.perf_counter() - started
        return replace(begun, values=values, status=status, reasons=reasons, seconds=spent)

    total, left = len(begun.plan), begun.pending.tolist()
    with deferred_interrupts():
        points = run_here(begun, left) if pool is None else run_there(begun, left, pool)
        try:
            for done in range(total - len(left) + 1, total + 1):
                found = next(points)
                if found.processor:
                    _refuse_elsewhere(begun, found, elsewhere)
                    begun = begun.moved_to(found.device, found.processor)
                if found.values is None:
                    reasons[found.point] = found.reason
                else:
                    for name, value in found.values.items():
                        values[name][found.point] = value
                status[found.point] = REFUSED if found.values is None else RUN
                if on_progress is not None:
                    on_progress(done, total, _note(found, begun))
                if keep is not None:
                    keep(now(), False)
                check_interrupt()
        except BaseException:
            if keep is not None:
                keep(now(), True)
            raise
    if (status == REFUSED).all():
        raise SceneError(all_refused(now()))
    return now()


def _refuse_elsewhere(begun: Sweep, found: Found, elsewhere: Elsewhere | None) -> None:
    """Nothing where a point was run on the processor of those before it; else a line, or refused."""
    if begun.processor in ("", found.processor):
        return
    before, now = f"{begun.device} ({begun.processor})", f"{found.device} ({found.processor})"
    words = f"began on {before} and goes on on {now}, which rounds in another way"
    if elsewhere is None:
        kind = found.device.partition(":")[0]
        raise SceneError(
            f"the sweep {words}, so the result would not be the same to the last bit: take workers of the first kind, "
            f"or name theirs to go on all the same, --device {kind}"
        )
    elsewhere(f"the sweep {words}: the result may differ")


def all_refused(found: Sweep) -> str:
    """One line for a sweep without any figure."""
    more = f" (and {counted(len(found.plan) - 1, 'point')} more)" if len(found.plan) > 1 else ""
    return f"all points are refused; {found.refusal(0)}{more}"


def _note(found: Found, begun: Sweep) -> str:
    """In a word."""
    at = ", ".join(
        f"{label_of(begun.scene, key)} {value:.4g}" for key, value in begun.plan.numbers(found.point).items()
    )
    return f"{at}: refused" if found.values is None else at
