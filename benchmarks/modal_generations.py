"""Seconds of a generation of designs by modes: python benchmarks/modal_generations.py [--device cuda:0] [--json FILE].

Each design of docs/examples/places.toml has actuators in random places. A generation is all their Gram matrices, from
places on the host to matrices on the host; what drives and swarm cost beyond is left out. Fastest of three rounds after
one that is not counted, with the scene's frequency for all plates, and with another for each.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np
from peer_codes.machine import machine, versions

from warp_plate import Scene
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import Designs, PerPlate

SCENE = Path(__file__).parents[1] / "docs" / "examples" / "places.toml"
FREQUENCIES = 150.0, 450.0
ROUNDS = 3
# Rounds that take longer are not repeated [s].
LONG = 20.0


def main() -> None:
    """Measure and print; with --json also into a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto", help="device (default: %(default)s)")
    parser.add_argument("--plates", default="40,4096,131072", help="sizes of generations (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    per_plate = PerPlate(frequency=True, centre=True)
    solver = ModalSolver(Scene.load(SCENE), options.device, per_plate=per_plate)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    record = {"device": str(solver.device), "machine": machine(), "versions": versions(), "load": load, "rows": []}
    print(f"{solver.device}, {solver.describe_path()}, load average {load}\n  plates  frequencies    seconds")
    for plates in map(int, options.plates.split(",")):
        for frequencies in ("one", "many"):
            seconds = measure(solver, designs(solver.scene, plates, frequencies == "many"))
            record["rows"].append({"plates": plates, "frequencies": frequencies, "seconds": seconds})
            print(f"{plates:8}  {frequencies:11} {seconds:10.4g}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def designs(scene: Scene, plates: int, many: bool) -> Designs:
    """Return designs with actuators in random places, and of random frequencies if ``many``."""
    random, shape = np.random.default_rng(0), (plates, len(scene.actuators))
    x0, x1, y0, y1 = scene.search.position.area
    centre = random.uniform((x0 + 0.01, y0 + 0.01), (x1 - 0.01, y1 - 0.01), (*shape, 2))
    frequency = random.uniform(*FREQUENCIES, (plates, 1)) if many else np.array(scene.drive.frequency)
    return Designs(np.ones(shape, dtype=complex), np.broadcast_to(frequency, shape), centre)


def measure(solver: ModalSolver, batch: Designs) -> float:
    """Return the least time of a generation [s]."""
    times = []
    while len(times) < ROUNDS + 1 and not (times and times[0] > LONG):
        started = time.perf_counter()
        solver.gram_matrices(batch)
        times.append(time.perf_counter() - started)
    return min(times[1:] or times)


if __name__ == "__main__":
    main()
