"""Cost of effects that are off: time each one switched on, and left out again, relative to the bare plate.

    python benchmarks/effects_off.py [--device cuda:0] [--nodes 27] [--rounds 21] [--out figures.json]

Prints a table and writes the figures as JSON. All are timed in turn; "off" has been on, with its typical value, and
left out again, so that it goes the whole way from the scene to the kernel. Against the bare plate it should differ by
noise alone, which two equal solvers of the bare plate show.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.accuracy.measure import describe_machine, describe_versions
from warp_plate.analysis.influence import bare_scene, names, seconds_a_step, toggle

EFFECTS = names()


def bare_plate(nodes: int) -> Scene:
    """The paper's plate with so many nodes a side, clamped, without any effect."""
    scene = bare_scene(Scene.load("paper"))
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"nodes": (nodes, nodes)})})


def measure(bare: Scene, device: str, rounds: int) -> dict[str, dict[str, float]]:
    """Return median and quartiles of the time of each effect, and of a second bare plate, over the bare plate's."""
    solvers = {"": PlateSolver(bare, device), "again": PlateSolver(bare, device)}
    for name in EFFECTS:
        on = toggle(bare, name)[0]
        solvers[f"{name} off"] = PlateSolver(toggle(on, name)[0], device)
        solvers[f"{name} on"] = PlateSolver(on, device)
    seconds = seconds_a_step(solvers, device, rounds)
    figures = {}
    for name, taken in seconds.items():
        low, median, high = np.percentile(taken / seconds[""], [25, 50, 75])
        figures[name] = {"ratio": float(median), "quartiles": [float(low), float(high)]}
        figures[name]["seconds"] = float(np.median(taken))
    return figures


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--nodes", type=int, default=27)
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    try:
        figures = measure(bare_plate(given.nodes), given.device, given.rounds)
    except SceneError as error:
        parser.error(str(error))
    bare = figures.pop("")
    print(f"a step of the bare plate of {given.nodes} x {given.nodes} nodes: {bare['seconds']:.3g} s")
    print(f"{'':20}{'off':>8}{'quartiles':>16}{'on':>8}")
    again = figures.pop("again")
    rows = {"the bare plate again": (again, None)}
    rows |= {name: (figures[f"{name} off"], figures[f"{name} on"]) for name in EFFECTS}
    for name, (off, on) in rows.items():
        low, high = off["quartiles"]
        text = f"{name:20}{off['ratio']:8.3f}{f'{low:.3f} to {high:.3f}':>16}"
        print(text + (f"{on['ratio']:8.2f}" if on else ""))
    if given.out is not None:
        record = {"machine": describe_machine(given.device), "versions": describe_versions()}
        record |= {"nodes": given.nodes, "rounds": given.rounds, "bare": bare, "again": again, "effects": figures}
        given.out.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
