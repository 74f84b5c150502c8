"""The largest displacement of a plate over its whole run, sampled beside the times that are recorded."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.weights import region_weights
from warp_plate.scene.fields import SMALLEST
from warp_plate.scene.model import Scene
from warp_plate.solve.run import PlateRunner, Progress, Run

# Samples in a period of the highest frequency (between two, a sine rises by 2 % at most), in a run at most and at
# least, and the bytes that they take at most.
SAMPLES_A_PERIOD, MOST_SAMPLES, FEWEST_SAMPLES, SAMPLES_BYTES = 16, 320, 2, 2**28
# Samples too few for every period are shifted by multiples of the golden ratio, so as never to keep in step with the
# motion.
GOLDEN = (math.sqrt(5) - 1) / 2


def run_with_peaks(
    solver: PlateRunner, phasors: np.ndarray, progress: Progress | None = None
) -> tuple[Run, np.ndarray]:
    """Run phasors (plates, actuators) with the scene's records.

    Returns:
        The run, and the largest displacements (plates, 2) [m] in the target and in the rest; 0 for an empty region.
    """
    scene = solver.scene
    recorded = record_times(scene)
    run = solver.run(phasors, (*recorded, *sample_times(scene, len(phasors))), scene.record.points, progress)
    kept, target = len(recorded), _target_nodes(scene)
    largest = np.maximum(run.displacement.max(axis=1), -run.displacement.min(axis=1))
    peaks = np.stack([largest[:, nodes].max(axis=1, initial=0.0) for nodes in (target, ~target)], axis=1)
    return replace(run, displacement=run.displacement[:, :kept], times=run.times[:kept]), peaks


def _target_nodes(scene: Scene) -> np.ndarray:
    """Return (ny, nx) true for nodes with half of their cell in the target, or if there are none, with any of it."""
    plate, target = region_weights(scene)
    nodes = np.asarray(2 * target >= np.maximum(plate, SMALLEST))
    return nodes if nodes.any() else np.asarray(target > 0)


def record_times(scene: Scene) -> tuple[float, ...]:
    """Return the times [s] that the scene records (default: the middle of the run and its end)."""
    return scene.record.times or (scene.window.end / 2, scene.window.end)


def sample_times(scene: Scene, plates: int = 1) -> tuple[float, ...]:
    """Return the times [s] at which to sample the displacement of ``plates`` plates for their peak.

    If all periods of the run take too many samples, the first burst and a moving load's passage get as many samples as
    the whole run.
    """
    end, (nx, ny) = scene.window.end, scene.grid.nodes
    wanted = math.ceil(SAMPLES_A_PERIOD * highest_frequency(scene) * end)
    most = min(MOST_SAMPLES, max(FEWEST_SAMPLES, SAMPLES_BYTES // (8 * nx * ny * plates)))
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


def peak_of(displacement: np.ndarray) -> float:
    """Return the largest magnitude; NaN if some displacement is."""
    return float(np.maximum(displacement.max(), -displacement.min()))
