"""Time a sweep over plates with random beads and edges, of the size of a data set for machine learning.

    python benchmarks/beaded_plates.py [--plates 150] [--points 300] [--devices cpu,cpu] [--folder FOLDER]

writes maps of thickness (81 × 121 numbers: 4 to 8 beads 80 mm wide, up to half as thick again as the plate) and a
steel plate of 0.9 × 0.6 m beside them, and runs ``warp-plate sweep`` for their mean square velocities under a force.
Each plate has a map, four edges and a loss factor of its own. A second command over few of the plates takes the start
out of the rate, at which 12,000 plates would take what is printed at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIZE, SHAPE, HALF_WIDTH, HEIGHT, SEED = (0.9, 0.6), (81, 121), 0.04, 0.5, 0
FEW, ALL = 10, 12_000
SCENE = """\
title = "Beaded plate"

[plate]
size = [0.9, 0.6]
thickness = 0.003
young_modulus = 210e9
density = 7800
poisson_ratio = 0.3

[edges]
left = "supported"
bottom = "supported"
right = "supported"
top = "supported"

[drive]
frequency = 300

[[actuators]]
name = "shaker"
area = [0.25, 0.27, 0.2, 0.22]
force = 1.0

[target]
area = [0.0, 0.45, 0.0, 0.6]

[effects.variation]
thickness = "bead00000.csv"

[effects.loss_factor]
eta = 0.02
"""
VARY = ("effects.variation.thickness=bead*.csv", "effects.loss_factor.eta=log:0.005:0.05")
VARY += tuple(f"edges.{side}=clamped,supported,free" for side in ("left", "bottom", "right", "top"))


def main() -> None:
    """Parse the options, write the scene, run the sweep and print its time."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--plates", type=int, default=150)
    parser.add_argument("--points", type=int, default=300, help="frequencies from 1 to 300 Hz")
    parser.add_argument("--devices", default="cpu,cpu")
    parser.add_argument("--folder", type=Path, help="where the maps and the result are kept (default: nowhere)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(run(options.folder or Path(folder), options), indent=1))


def run(folder: Path, options: argparse.Namespace) -> dict[str, object]:
    """Write the plates to a folder, sweep them and return the times [s]."""
    folder.mkdir(parents=True, exist_ok=True)
    write_plates(folder, options.plates)
    few, many = (sweep(folder, plates, options) for plates in (FEW, options.plates))
    wall, used = ((last - first) / (options.plates - FEW) for first, last in zip(few, many, strict=True))
    return {
        "plates": options.plates,
        "wall of the command": round(many[0], 1),
        "processor time of the command": round(many[1], 1),
        "wall a plate": round(wall, 4),
        "processor time a plate": round(used, 4),
        "minutes for 12,000": round((few[0] + (ALL - FEW) * wall) / 60, 1),
    }


def sweep(folder: Path, plates: int, options: argparse.Namespace) -> tuple[float, float]:
    """Return the wall time and the processor time [s] of a sweep over some of the plates."""
    command = [sys.executable, "-m", "warp_plate", "sweep", "plate.toml", "--vary", *VARY, "--what", "frf"]
    command += ["--frequencies", f"1:300:{options.points}", "--samples", str(plates), "--seed", str(SEED)]
    command += ["--devices", options.devices, "--no-pictures", "--json", "--out", f"{plates}.h5"]
    started, before = time.perf_counter(), os.times()
    output = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
    wall, after = time.perf_counter() - started, os.times()
    if refused := json.loads(output)["refused"]:
        raise SystemExit(f"{len(refused)} plates refused: {refused[0]}")
    return wall, after.children_user + after.children_system - before.children_user - before.children_system


def write_plates(folder: Path, plates: int) -> None:
    """Write plate.toml and a map of thickness for each plate."""
    random = np.random.default_rng(SEED)
    (folder / "plate.toml").write_text(SCENE, encoding="utf-8")
    for number in range(plates):
        np.savetxt(folder / f"bead{number:05d}.csv", beads(random), fmt="%.4f", delimiter=",")


def beads(random: np.random.Generator) -> np.ndarray:
    """Return the factors of thickness (rows, columns) of a plate with straight beads in random places."""
    axes = zip(SIZE[::-1], SHAPE, strict=True)
    y, x = np.meshgrid(*(np.linspace(0, side, count) for side, count in axes), indexing="ij")
    height = np.zeros(SHAPE)
    for _ in range(random.integers(4, 9)):
        (x0, y0), (x1, y1) = random.random((2, 2)) * SIZE
        along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / ((x1 - x0) ** 2 + (y1 - y0) ** 2)
        along = np.clip(along, 0, 1)
        distance = np.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0))
        height = np.maximum(height, HEIGHT * np.cos(np.minimum(distance / HALF_WIDTH, 1) * np.pi / 2) ** 2)
    return 1 + height


if __name__ == "__main__":
    main()
