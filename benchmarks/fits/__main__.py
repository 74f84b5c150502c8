"""Fits random panels to frequency responses by time stepping, with noise, and holds the numbers against the truth.

    python benchmarks/fits --panels 100 --out benchmarks/results/fits-cpu.json      # about an hour on two cores
    python benchmarks/fits --first 37 --panels 1

Panels that the file of ``--out`` has already are not computed again.
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
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from fits.campaign import measured, summary


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--panels", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1, help="processes, each with a thread")
    parser.add_argument("--device", default="cpu", help="device of the time steps, such as cuda:0")
    parser.add_argument("--out", type=Path, help="summary and rows as JSON, written after every panel")
    parser.add_argument("--responses", type=Path, help="folder that keeps the stepped responses, to fit them again")
    asked = parser.parse_args()
    if asked.responses:
        asked.responses.mkdir(parents=True, exist_ok=True)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "WARP_PLATE_THREADS"):
        os.environ.setdefault(name, "1")  # for the processes
    rows = json.loads(asked.out.read_text())["rows"] if asked.out and asked.out.exists() else []
    known = {row["panel"] for row in rows}
    numbers = [number for number in range(asked.first, asked.first + asked.panels) if number not in known]
    with ProcessPoolExecutor(asked.jobs, get_context("spawn")) as pool:
        panels = [
            pool.submit(partial(measured, device=asked.device, folder=asked.responses), number) for number in numbers
        ]
        for panel in as_completed(panels):
            rows = sorted([*rows, panel.result()], key=lambda row: row["panel"])
            print(line(panel.result()), flush=True)
            if asked.out:
                asked.out.write_text(json.dumps({"summary": summary(rows), "rows": rows}, indent=1) + "\n")
    print(json.dumps(summary(rows), indent=1))


def line(row: dict) -> str:
    """Return a panel's errors in percent, those outside their intervals marked."""
    numbers = []
    for key, entry in row["numbers"].items():
        outside = "" if entry["low"] <= entry["truth"] <= entry["high"] else "!"
        half = 50 * (entry["high"] - entry["low"]) / entry["value"]
        numbers.append(
            f"{key.split('.', 1)[1]} {100 * (entry['value'] / entry['truth'] - 1):+.3f} ± {half:.3f}{outside}"
        )
    seconds = f"{row['stepping_seconds']:.0f} + {row['fit_seconds']:.0f} s"
    return f"{row['panel']:4d} {row['frequencies']:3d} frequencies, {seconds}: {', '.join(numbers)}"


if __name__ == "__main__":
    main()
