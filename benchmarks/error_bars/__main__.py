"""Holds printed error bars against the truth, on random scenes.

    python benchmarks/error_bars                    # 60 scenes
    python benchmarks/error_bars --scenes 500 --out benchmarks/results/error-bars.json
    python benchmarks/error_bars --first 37 --scenes 1
    python benchmarks/error_bars --nonlinear --scenes 120 --jobs 8

Each linear scene runs on a random grid and by modes, and with --promise 0.01 as an accuracy of 1 % chooses; the others,
of stretching, electrostatic force and moving loads, run on a random grid. Finite elements judge.
"""

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from error_bars.campaign import measured, measured_nonlinear, report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument(
        "--promise", type=float, nargs="*", default=(), help="accuracies to ask for as well, such as 0.01"
    )
    parser.add_argument("--nonlinear", action="store_true", help="scenes that are not linear in their drives")
    parser.add_argument("--jobs", type=int, default=1, help="processes, each with a thread")
    parser.add_argument("--out", type=Path, help="rows as JSON, written after every scene")
    asked = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "WARP_PLATE_THREADS"):
        os.environ.setdefault(name, "1")  # for the processes
    rows = []
    measure = measured_nonlinear if asked.nonlinear else partial(measured, promises=asked.promise)
    with ProcessPoolExecutor(asked.jobs, get_context("spawn")) as pool:
        scenes = [pool.submit(measure, number) for number in range(asked.first, asked.first + asked.scenes)]
        for scene in as_completed(scenes):
            rows = sorted([*rows, *scene.result()], key=lambda row: (row["scene"], row["engine"]))
            if asked.out:
                asked.out.write_text(json.dumps(rows, indent=1) + "\n")
    report(rows)


if __name__ == "__main__":
    main()
