"""The processor time of a panel's value with all its slopes, over that of the value alone.

    OMP_NUM_THREADS=1 python benchmarks/design_cost.py [--repeats 9]

Panels are the paper's plate with a map of 25 and of 5184 numbers, with no, one and two limits on its motion, an
exciter's panel in air with limits on sound and power, two ribs, the paper's four patches, whose places are free, and a
hole whose place and radius are free.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from warp_plate import Scene
from warp_plate.designing.panel import FreePanel

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
LIMITS = ({}, {"energy_target": 1e-9}, {"energy_target": 1e-9, "least_velocity": 1e-3})
# Length scales of maps of 25 and of 5184 numbers [m].
LENGTHS = (0.133, 0.00567)
# Middle and radius of a hole [m].
HOLE = (0.11, 0.09, 0.02)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=9)
    repeats = parser.parse_args().repeats
    for length in LENGTHS:
        for limited in LIMITS:
            table = {"thickness": {"range": [3.5e-4, 7.5e-4], "length_scale": length}, "limits": limited}
            report("a map", Scene.load("paper").replace("design", table), repeats)
    for name in ("design-exciter", "design-ribs"):
        report(name, Scene.load(EXAMPLES / f"{name}.toml"), repeats)
    paper = Scene.load("paper")
    places = {f"actuators[{index}]": (0.0, 0.2, 0.0, 0.2) for index in range(4)}
    report("four patches", paper.replace("design", {"places": places}), repeats)
    material = paper.plate.model_dump(exclude={"size", "outline", "holes"}, exclude_none=True)
    plate = {**material, "outline": {"rectangle": paper.plate.size}, "holes": [{"disc": HOLE}]}
    free = {f"plate.holes[0].disc[{index}]": [0.9 * value, 1.1 * value] for index, value in enumerate(HOLE)}
    for count in (1, 3):
        design = {"free": dict(list(free.items())[:count])}
        report("a hole", paper.with_tables(plate=plate, edges={"outline": "clamped"}, design=design), repeats)


def report(name: str, scene: Scene, repeats: int) -> None:
    """Print the cost of a value and of its slopes."""
    panel = FreePanel(scene)
    numbers = 0.3 + 0.4 * np.random.default_rng(0).random(panel.count)
    found = panel.evaluate(numbers)
    alone, whole = (
        median(lambda: panel.evaluate(numbers, sloped=False), repeats),
        median(lambda: panel.evaluate(numbers), repeats),
    )
    shown = f"{name}: {panel.count} numbers, {found.excess.size} limits"
    print(f"{shown}: a value {alone:.3f} s, with all slopes {whole:.3f} s: {whole / alone:.2f} times", flush=True)


def median(task: Callable[[], object], repeats: int) -> float:
    """Return the median of the processor times of a task [s]."""
    seconds = []
    for _ in range(repeats):
        began = time.process_time()
        task()
        seconds.append(time.process_time() - began)
    return float(np.median(seconds))


if __name__ == "__main__":
    main()
