"""Measure how much of a generation's time the host takes: everything around the plates' own steps.

    python benchmarks/host_share.py [--device cuda:0] [--plates 20 1024 16384 131072] [--generations 9] [--out FILE]

Searches the paper's scene and prints, for swarms of each size, the time of a whole generation, in which the device
computes; and the parts of the time in which the device does not compute: the swarm's ask and tell, and the work around
the device: designs made of positions, loads, copies, statuses. Large swarms are cut into parts, and the host prepares
one while the device steps another.
Prints medians; the first two generations, which allocate memory and compile, do not count.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import warp as wp

from warp_plate import Scene, SceneError
from warp_plate.accuracy.measure import describe_machine, describe_versions
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.resolve import resolve

PLATES = (20, 1024, 16384, 131072)
GENERATIONS, FIRST = 9, 2
PARTS = ("ask", "around the device", "tell")


class DeviceTime:
    """The time that a device computes for a problem's plates; on a CPU that of the steps."""

    def __init__(self, problem: Problem) -> None:
        compiled, self._device = problem.drive_solver.compiled, problem.drive_solver.device
        self._seconds = 0.0
        if self._device.is_cuda:
            wp.timing_begin(wp.TIMING_ALL & ~wp.TIMING_MEMCPY)
        else:
            self._step, compiled.advance = compiled.advance, self._advance

    def _advance(self, state: object, plates: int, start: int, stop: int) -> None:
        began = time.perf_counter()
        self._step(state, plates, start, stop)
        self._seconds += time.perf_counter() - began

    def taken(self) -> float:
        """Return the seconds computed since the last call."""
        if self._device.is_cuda:
            self._seconds = sum(one.elapsed for one in wp.timing_end()) / 1e3
            wp.timing_begin(wp.TIMING_ALL & ~wp.TIMING_MEMCPY)
        seconds, self._seconds = self._seconds, 0.0
        return seconds


def generations(problem: Problem, device: DeviceTime, plates: int, count: int) -> dict[str, object]:
    """Return medians over ``count`` generations of a swarm of ``plates`` particles [s]."""
    search = problem.scene.search.model_copy(update={"particles": plates, "iterations": count + FIRST})
    searcher = make_optimizer(search, problem.space, 0)
    taken: dict[str, list[float]] = {name: [] for name in ("whole", "device", *PARTS)}
    device.taken()
    for _ in range(count + FIRST):
        marks = [time.perf_counter()]
        positions = searcher.ask()
        marks.append(time.perf_counter())
        losses = problem.losses(positions)
        marks.append(time.perf_counter())
        searcher.tell(positions, losses)
        best = searcher.result.fbest  # looked at after each generation, for the progress bar
        marks.append(time.perf_counter())
        computed, parts = device.taken(), np.diff(marks)
        parts[1] -= computed
        for name, seconds in zip(taken, (marks[-1] - marks[0], computed, *parts.tolist()), strict=True):
            taken[name].append(seconds)
    assert np.isfinite(best)
    medians = {name: float(np.median(seconds[FIRST:])) for name, seconds in taken.items()}
    share = np.array(taken["device"][FIRST:]) / np.array(taken["whole"][FIRST:])
    return {"plates": plates, "host_share": float(1 - np.median(share)), "seconds": medians}


def measure(
    scene: Scene, device: str, plates: tuple[int, ...] = PLATES, count: int = GENERATIONS
) -> list[dict[str, object]]:
    """Return the rows of the table."""
    problem = make_problem(resolve(scene, device))
    device_time = DeviceTime(problem)
    return [generations(problem, device_time, each, count) for each in plates]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--plates", type=int, nargs="+", default=PLATES)
    parser.add_argument("--generations", type=int, default=GENERATIONS)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    try:
        rows = measure(Scene.load("paper"), given.device, tuple(given.plates), given.generations)
        machine = describe_machine(given.device)
    except SceneError as error:
        parser.error(str(error))
    names = "".join(f"{name:>19}" for name in PARTS)
    print(f"{'plates':>8}{'generation':>13}{'device':>11}{'host':>8}{names}")
    for row in rows:
        seconds = row["seconds"]
        parts = "".join(f"{1e3 * seconds[name]:16.3f} ms" for name in PARTS)
        whole, device = (1e3 * seconds[name] for name in ("whole", "device"))
        share = 100 * row["host_share"]
        print(f"{row['plates']:8}{whole:10.2f} ms{device:8.2f} ms{share:6.1f} %{parts}")
    if given.out is not None:
        record = {"machine": machine, "versions": describe_versions(), "rows": rows}
        given.out.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
