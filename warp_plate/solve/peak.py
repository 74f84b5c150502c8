"""The largest displacement of a plate over its whole run, sampled besides the recorded times."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.weights import region_weights
from warp_plate.scene.fields import SMALLEST
from warp_plate.scene.model import Scene
from warp_plate.solve.run import PlateRunner, Progress, Run

# Samples in a period of the highest frequency (between two, a sine rises by 2 % at most), and in a run at most.
SAMPLES_A_PERIOD, MOST_SAMPLES = 16, 320
# Samples too few for every period are shifted by multiples of the golden ratio, so as never to keep in step with the
# motion.
GOLDEN = (math.sqrt(5) - 1) / 2


def run_with_peaks(
    solver: PlateRunner, phasors: np.ndarray, progress: Progress | None = None, recorded: Sequence[float] = ()
) -> tuple[Run, np.ndarray]:
    """Run phasors (plates, actuators) with the scene's records, or with displacements at other times ``recorded`` [s].

    Returns:
        The run, and the largest displacements (plates, 2) [m] in the target and in the rest.
    """
    scene = solver.scene
    recorded = recorded or record_times(scene)
    run = solver.run(phasors, recorded, scene.record.points, progress, (*recorded, *sample_times(scene)))
    target = _target_nodes(scene, run.peak.shape[:0:-1])
    peaks = np.stack([run.peak[:, nodes].max(axis=1, initial=0.0) for nodes in (target, ~target)], axis=1)
    return run, peaks if run.outline_peak is None else np.maximum(peaks, run.outline_peak[:, None])


def _target_nodes(scene: Scene, nodes: tuple[int, ...]) -> np.ndarray:
    """Return (ny, nx) true for those of nx, ny nodes with half of their cell in the target, or if there are none, with
    any of it."""
    plate, target = region_weights(scene.model_copy(update={"grid": scene.grid.model_copy(update={"nodes": nodes})}))
    within = np.asarray(2 * target >= np.maximum(plate, SMALLEST))
    return within if within.any() else np.asarray(target > 0)


def record_times(scene: Scene) -> tuple[float, ...]:
    """Return the times [s] that the scene records.

    The default is the end of the run and, of periodic drives, a quarter period of the highest frequency before, so that
    under a tone no node passes zero at both; of others the middle of the run.
    """
    end = scene.window.end
    earlier = end / 2 if scene.nonperiodic_key else max(end - 0.25 / highest_frequency(scene), 0.0)
    return scene.record.times or (earlier, end)


def sample_times(scene: Scene) -> tuple[float, ...]:
    """Return the times [s] at which to sample the displacement for its peak.

    If all periods of the run take too many samples, the first burst and a moving load's passage get as many samples as
    the whole run.
    """
    end = scene.window.end
    wanted = math.ceil(SAMPLES_A_PERIOD * highest_frequency(scene) * end)
    if wanted <= MOST_SAMPLES:
        return tuple((end * np.arange(1, wanted + 1) / wanted).tolist())
    spans = [(0.0, end)]
    burst, load = scene.drive.burst, scene.effects.travelling
    if burst is not None:
        spans.append((burst.start, min(burst.start + burst.duration, end)))
    if load is not None and load.from_time < end:
        spans.append((load.from_time, min(load.to_time or end, end)))
    count = MOST_SAMPLES // len(spans)
    place = np.arange(1, count + 1)
    share = (place - place * GOLDEN % 1) / count
    return tuple(start + (stop - start) * part for start, stop in spans for part in share.tolist())
