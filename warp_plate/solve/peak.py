"""The largest displacement of a plate over its whole run, beside what is recorded of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from warp_plate.plate.signals import highest_frequency
from warp_plate.scene.model import Scene
from warp_plate.solve.run import Run
from warp_plate.solve.solver import PlateSolver, Progress

# Looks at a plate: so many in a period of the highest frequency (between two, a sine rises by 2 % at most), but no more
# than so many in a run, whose copies take so many bytes at most; and never fewer than so many.
LOOKS_A_PERIOD, MOST_LOOKS, LOOKS_BYTES, FEWEST_LOOKS = 16, 320, 2**28, 2
# Looks that are too few for every period are shifted by multiples of the golden ratio, so that they never keep in step
# with the motion.
GOLDEN = (math.sqrt(5) - 1) / 2


def run_and_look(solver: PlateSolver, drives: np.ndarray, progress: Progress | None = None) -> tuple[Run, float]:
    """Run drives (plates, actuators) with what the scene records, and the largest displacement [m] of the last one."""
    scene = solver.scene
    recorded = record_times(scene)
    run = solver.run(drives, (*recorded, *look_times(scene, len(drives))), scene.record.points, progress)
    kept, peak = len(recorded), largest(run.displacement[-1])
    return replace(run, displacement=run.displacement[:, :kept], times=run.times[:kept]), peak


def record_times(scene: Scene) -> tuple[float, ...]:
    """The times [s] that the scene names, else the middle of the run and its end."""
    return scene.record.times or (scene.window.end / 2, scene.window.end)


def look_times(scene: Scene, plates: int = 1) -> tuple[float, ...]:
    """The times [s] at which a run of so many plates is looked at for its largest displacement.

    Where looks are too few for the whole run, the first burst and a moving load's time on its way get as many as it.
    """
    end, (nx, ny) = scene.window.end, scene.grid.nodes
    wanted = math.ceil(LOOKS_A_PERIOD * highest_frequency(scene) * end)
    most = min(MOST_LOOKS, max(FEWEST_LOOKS, LOOKS_BYTES // (8 * nx * ny * plates)))
    if wanted <= most:
        return tuple((end * np.arange(1, wanted + 1) / wanted).tolist())
    spans = [(0.0, end)]
    burst, load = scene.drive.burst, scene.effects.moving_load
    if burst is not None:
        spans.append((burst.start, min(burst.start + burst.duration, end)))
    if load is not None and load.from_time < end:
        spans.append((load.from_time, min(load.to_time or end, end)))
    count = max(1, most // len(spans))
    place = np.arange(1, count + 1)
    share = (place - place * GOLDEN % 1) / count
    return tuple(start + (stop - start) * part for start, stop in spans for part in share.tolist())


def largest(displacement: np.ndarray) -> float:
    """Of any sign; NaN where some of it is no number."""
    return float(np.maximum(displacement.max(), -displacement.min()))
