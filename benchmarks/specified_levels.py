"""Random specifications: the extreme levels of answers against dense samples of the same motion.

    python benchmarks/specified_levels.py [--first 0] [--count 100] [--processes 2]

A number is a scene of ``error_bars/scenes.py`` with a random specification. The largest and the smallest level of each
region, which answers and programs rest on, are compared with those at points five times as dense as the samples and
twenty times along outlines: no level may lie beyond them. Printed are the largest errors, as parts of the largest
level of the region.
"""

from __future__ import annotations

import argparse
import os
import sys
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import shapely
from error_bars.scenes import random_scene

import warp_plate
from warp_plate import Scene, SceneError
from warp_plate.studies import specify

DENSER, ALONG = 5, 20


def specified_scene(number: int) -> Scene:
    """Return a random scene with a random specification."""
    scene, _ = random_scene(number)
    rng = np.random.default_rng([number, 44])
    level = {"acceleration_g": 10 ** rng.uniform(-6, -2.5), "measure": str(rng.choice(["weakest", "weakest", "mean"]))}
    if rng.random() < 0.3:
        level["phase"] = "free" if rng.random() < 0.6 else rng.uniform(-3, 3)
    specification = {"level": level, "guard": float(rng.choice([0, 0.15 * rng.random() * min(scene.plate.size)]))}
    if rng.random() < 0.85:
        measure = str(rng.choice(["worst", "worst", "mean"]))
        specification["elsewhere"] = {"relative_db": rng.uniform(-15, 6), "measure": measure}
    return scene.with_tables(specification=specification)


def beyond(number: int) -> tuple[int, str, list[float]]:
    """Return what becomes of a specification, and by how much levels at dense points lie beyond the extreme ones."""
    kept, answered = [], specify._answer
    with patch.object(specify, "_answer", lambda *given: kept.append(answered(*given)) or kept[-1]):
        try:
            warp_plate.specify(specified_scene(number), tolerances=False)
        except SceneError as error:
            return number, f"refused: {error}", []
    ((answer, tone),) = kept
    drive, parts = answer.drive / answer.limits, [*tone.requirements.aims, *tone.requirements.rests]
    errors = []
    for region in {part.name: part.region for part in parts}.values():
        grid = np.meshgrid(*(np.linspace(side[0], side[-1], DENSER * len(side)) for side in (region.x, region.y)))
        points = np.stack(grid, axis=-1).reshape(-1, 2)
        points = [points[shapely.contains_xy(region.shape, *points.T)]]
        for line in region.lines:
            ends = np.append(line.places, line.places[-1] + line.stride)
            lengths = np.interp(np.arange(ALONG * len(line.places)) / ALONG, np.arange(len(ends)), ends)
            points.append(line.at(lengths[:, None]))
        levels = np.abs(tone.rows(np.concatenate(points)) @ drive)
        highest, lowest = (tone._end(region, drive, sign)[0] for sign in (1.0, -1.0))
        errors += [float(levels.max() / highest - 1), float((lowest - levels.min()) / highest)]
    return number, "feasible" if answer.feasible else "proved" if answer.proved else "open", errors


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    with get_context("spawn").Pool(asked.processes) as pool:
        rows = list(pool.imap_unordered(beyond, range(asked.first, asked.first + asked.count)))
    ends = [end.split(":")[0] for _, end, _ in rows]
    print(", ".join(f"{ends.count(end)} {end}" for end in sorted(set(ends))))
    for error, number in sorted(((max(errors), number) for number, _, errors in rows if errors), reverse=True)[:5]:
        print(f"  scene {number}: {error:.1e}")


if __name__ == "__main__":
    main()
