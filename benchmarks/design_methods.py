"""Searches for the thickness of a designed panel by four methods from the same starts.

    python benchmarks/design_methods.py [--starts 6] [--iterations 40] [--processes 2]

prints, for L-BFGS-B, SLSQP and trust-constr of SciPy and for the method of moving asymptotes, the bound that each start
ends at, the panels solved for and processor seconds. The scene is docs/examples/design-thickness.toml.

The method of moving asymptotes replaces a loss by a convex sum of p/(U − x) + q/(x − L) of each number x from 0 to 1,
with its value and slopes at the present numbers; L and U move apart while a number goes on in one direction, and
together when it turns back (K. Svanberg, Int. J. Numer. Methods Eng. 24, 1987, pp. 359-373).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from multiprocessing import Pool
from pathlib import Path

import numpy as np
import scipy

from warp_plate.designing.panel import FreePanel
from warp_plate.scene.model import Scene

SCENE = Path(__file__).parents[1] / "docs" / "examples" / "design-thickness.toml"
OPTIONS = {
    "L-BFGS-B": {"maxcor": 20, "ftol": 1e-9, "gtol": 1e-7},
    "SLSQP": {"ftol": 1e-9},
    "trust-constr": {},
}
# Distances of the asymptotes at first, least and largest, and factors of them when a number goes on and turns back.
FIRST, LEAST, LARGEST, ONWARDS, BACK = 0.2, 0.01, 2.0, 1.2, 0.7
# Largest step, nearest approach to an asymptote as a part of its distance, and curvature besides that by slopes.
STEP, APPROACH, CURVATURE = 0.15, 0.1, 1e-3


def moving_asymptotes(at: Callable[[np.ndarray], tuple[float, np.ndarray]], now: np.ndarray, iterations: int) -> None:
    """Search from numbers ``now`` (n,) for the least loss, which ``at`` returns with its slopes (n,)."""
    earlier, distance = [now, now], np.full(now.size, FIRST)
    for _ in range(iterations):
        _, slopes = at(now)
        turns = (now - earlier[1]) * (earlier[1] - earlier[0])
        distance = np.clip(distance * np.where(turns > 0, ONWARDS, np.where(turns < 0, BACK, 1.0)), LEAST, LARGEST)
        low = np.maximum(np.maximum(0, now - STEP), now - (1 - APPROACH) * distance)
        high = np.minimum(np.minimum(1, now + STEP), now + (1 - APPROACH) * distance)
        besides = CURVATURE * (np.abs(slopes) + np.abs(slopes).mean())
        p, q = (np.sqrt(np.maximum(sign * slopes, 0) + besides) for sign in (1, -1))
        earlier = [earlier[1], now]
        now = np.clip(now + distance * (q - p) / (p + q), low, high)


def climb(iterations: int, task: tuple[str, int]) -> tuple[str, float, int, float]:
    """Return the method, the bound that it reaches from a start, panels solved for, and processor seconds."""
    method, index = task
    panel, values, began = FreePanel(Scene.load(SCENE)), list[float](), time.process_time()

    def loss(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        value = panel.evaluate(numbers)
        values.append(value.least)
        return -value.smooth, -value.slopes

    start = panel.draw(np.random.default_rng([0, index])) if index else panel.start()
    if method in OPTIONS:
        keys = {"method": method, "bounds": [(0.0, 1.0)] * panel.count}
        scipy.optimize.minimize(loss, start, jac=True, options={**OPTIONS[method], "maxiter": iterations}, **keys)
    else:
        moving_asymptotes(loss, start, iterations)
    return method, max(values), len(values), time.process_time() - began


def main() -> None:
    """Print a line for each method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--processes", type=int, default=2)
    taken = parser.parse_args()
    methods = [*OPTIONS, "moving asymptotes"]
    tasks = [(method, index) for index in range(taken.starts) for method in methods]
    with Pool(taken.processes) as pool:
        rows = pool.map(partial(climb, taken.iterations), tasks, chunksize=1)
    for method in methods:
        bounds, panels, seconds = zip(*(row[1:] for row in rows if row[0] == method), strict=True)
        ends = ", ".join(f"{100 * bound:.2f}" for bound in sorted(bounds))
        print(
            f"{method}: bounds {ends} %; {np.median(panels):.0f} panels, {np.median(seconds):.1f} s a start (medians)"
        )


if __name__ == "__main__":
    main()
