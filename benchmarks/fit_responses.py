"""Seconds of a fit of eight numbers to responses: python benchmarks/fit_responses.py [--starts 64] [--json FILE].

A glass panel on springs, ten modes and a loss factor, hit by a hammer, with six accelerometers. Modulus, density, loss
factor, the springs of four edges and a gain are free; responses at 200 frequencies have 1 % noise. They are computed by
the modal engine, for this measures the time of a fit and not its errors. Another measure is processor seconds, which
other work on the machine changes less.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from peer_codes.machine import machine, versions

from warp_plate import Scene
from warp_plate.fitting.fit import fit_responses
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.panel_responses import PanelResponses

ROTATIONS = {"left": 8.0, "right": 15.0, "bottom": 30.0, "top": 5.0}
HIT = 0.07, 0.045
SENSORS = (0.05, 0.03), (0.16, 0.035), (0.10, 0.06), (0.045, 0.095), (0.125, 0.10), (0.17, 0.08)
FREQUENCIES = np.linspace(170.0, 1750.0, 200)
FREE = {
    "plate.young_modulus": (50e9, 90e9),
    "plate.density": (2000.0, 3000.0),
    "effects.loss_factor.eta": (0.002, 0.1),
    **{f"edges.{side}.rotation": (1.0, 100.0) for side in ROTATIONS},
    "measurement[0].gain": (0.5, 2.0),
}
NOISE = 0.01


def panel(starts: int) -> Scene:
    """Return the panel as it is."""
    return Scene.from_tables(
        {
            "plate": {
                "size": (0.2, 0.12),
                "thickness": 1e-3,
                "density": 2500.0,
                "young_modulus": 70e9,
                "poisson_ratio": 0.23,
            },
            "edges": {side: {"translation": 1e8, "rotation": value} for side, value in ROTATIONS.items()},
            "effects": {"loss_factor": {"eta": 0.02}},
            "drive": {"frequency": 300.0},
            "target": {"area": (0.0, 0.1, 0.0, 0.06)},
            "actuators": [{"name": "patch", "area": (0.03, 0.05, 0.03, 0.04)}],
            "measurement": [{"force_at": HIT, "point": point} for point in SENSORS],
            "fit": {"starts": starts, "free": FREE},
        }
    )


def measure(starts: int) -> dict[str, object]:
    """Return seconds, processor seconds, and the fitted values with their intervals."""
    random, scene = np.random.default_rng(1), panel(starts)
    exact = PanelResponses(scene, MeasuredResponses("", FREQUENCIES, np.empty(0))).values
    noise = random.normal(size=exact.shape) + 1j * random.normal(size=exact.shape)
    data = MeasuredResponses("made", FREQUENCIES, exact * (1 + NOISE / np.sqrt(2) * noise))
    wrong = scene.replace("plate.young_modulus", 60e9).replace("effects.loss_factor.eta", 0.05)
    for side in ROTATIONS:
        wrong = wrong.replace(f"edges.{side}.rotation", 10.0)
    wall, processor = time.perf_counter(), time.process_time()
    found = fit_responses(wrong, data)
    seconds = {"seconds": time.perf_counter() - wall, "processor_seconds": time.process_time() - processor}
    rows = zip(found.keys, found.values.tolist(), found.low.tolist(), found.high.tolist(), strict=True)
    return {**seconds, "plates": found.evaluations, "values": {key: row for key, *row in rows}}


def main() -> None:
    """Measure and print; with --json also into a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=64, help="points where the fit may begin (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    record = {"machine": machine(), "versions": versions(), **measure(options.starts)}
    print(
        f"{record['seconds']:.1f} s, {record['processor_seconds']:.1f} s of processor time, {record['plates']} plates"
    )
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
