"""Measure how much faster a swarm is on more workers, and what it costs to send them a block of plates.

    python benchmarks/scaling.py                                    # one and two workers on the CPU, 4096 plates
    python benchmarks/scaling.py --devices cuda:0,cuda:1 --nodes 53 --plates 32768   # a worker each, and one alone
    python benchmarks/scaling.py --cluster tcp://HOST1:8786 tcp://HOST2:8786 --plates 16384 --out FILE

Searches the paper's scene with a swarm of so many plates in this process and on each pool, a few generations of each in
turn, so that disturbances of the machine affect all alike. Prints medians. The first turns, in which workers start, do
not count, nor does the first generation of each turn, which finds caches cold and the GPU in use by another process.
The losses must be the same to the last bit everywhere, or the program ends with an error.
"""

from __future__ import annotations

import argparse
import json
import time
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path

import numpy as np

from warp_plate import Scene, SceneError
from warp_plate.accuracy.measure import describe_machine, describe_versions
from warp_plate.cluster.evaluator import block_size
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import BLOCK_NODE_STEPS, Task, WorkerPool, run_tasks
from warp_plate.problem.methods import make_optimizer
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.resolve import resolve

PLATES, GENERATIONS = 4096, 9
# Generations of a turn that count.
TURN = 3
HERE = "this process"
PARTS = ("ask", "losses", "tell")


class Search:
    """A problem's swarm, a generation at a time.

    Attributes:
        seconds: Durations of the PARTS of each generation that counts.
        losses: Hashes of the losses of all generations.
    """

    def __init__(self, problem: Problem, plates: int, generations: int) -> None:
        search = problem.scene.search.model_copy(update={"particles": plates, "iterations": generations})
        self.problem = problem
        self.seconds: list[list[float]] = []
        self.losses: list[str] = []
        self._searcher = make_optimizer(search, problem.space, 0)

    def generation(self, counts: bool) -> None:
        """Run one generation."""
        marks = [time.perf_counter()]
        positions = self._searcher.ask()
        marks.append(time.perf_counter())
        losses = self.problem.losses(positions)
        marks.append(time.perf_counter())
        self._searcher.tell(positions, losses)
        marks.append(time.perf_counter())
        self.losses.append(sha256(losses.tobytes()).hexdigest())
        if counts:
            self.seconds.append(np.diff(marks).tolist())

    def row(self) -> dict[str, object]:
        """Return medians over the generations that count [s]."""
        whole, parts = np.sum(self.seconds, axis=1), np.median(self.seconds, axis=0).tolist()
        return {
            "seconds": float(np.median(whole)), "each": whole.tolist(), "parts": dict(zip(PARTS, parts, strict=True))
        }  # fmt: skip


def shipping(pool: WorkerPool, problem: Problem) -> dict[str, object]:
    """Return what sending a block costs: bytes there and back, and milliseconds of a task that does nothing, without
    them and with them."""
    plates, actuators = 4096, len(problem.scene.actuators)
    there, back = 16 * actuators * plates, 8 * len(problem.drive_solver.specialized.regions) * plates
    found: dict[str, object] = {"plates": plates, "bytes_there": there, "bytes_back": back}
    for name, size in (
        ("milliseconds_empty", 0),
        ("milliseconds_with_bytes", there),
        ("milliseconds_of_16_MiB", 2**24),
    ):
        taken = []
        for _ in range(21):
            started = time.perf_counter()
            list(run_tasks(pool, [Task(len, np.zeros(size, np.uint8))]))
            taken.append(time.perf_counter() - started)
        found[name] = 1e3 * float(np.median(taken))
    return found


def measure(
    scene: Scene, device: str, pools: dict[str, WorkerPool], plates: int, generations: int
) -> dict[str, object]:
    """Return a row for this process and for each pool, and how much faster each pool is than the first.

    Raises:
        RuntimeError: their losses are not the same.
    """
    problems = {name: make_problem(resolve(scene, device), pool=pool) for name, pool in {HERE: None, **pools}.items()}
    turns = -(-generations // TURN)
    searches = {name: Search(problem, plates, (1 + turns) * (1 + TURN)) for name, problem in problems.items()}
    for turn in range(1 + turns):
        for name, search in searches.items():
            for index in range(1 + TURN):
                search.generation(counts=turn > 0 and index > 0)
            if search.losses != searches[HERE].losses:
                raise RuntimeError(f"{name}: other losses than {HERE}")
    rows = {name: search.row() for name, search in searches.items()}
    solver = problems[HERE].drive_solver
    kind = "cuda" if solver.device.is_cuda else "cpu"
    first = next(iter(pools))
    return {
        "plates": plates,
        "plates_of_block": block_size(plates, 1, solver.node_steps_per_plate, BLOCK_NODE_STEPS[kind]),
        "rows": rows,
        "speed_over_first": {name: float(rows[first]["seconds"]) / float(rows[name]["seconds"]) for name in pools},
        "shipping": {name: shipping(pool, problems[name]) for name, pool in pools.items()},
    }


def paper_scene(nodes: int) -> Scene:
    """Return the paper's scene on a finer grid, with the time step scaled by the square of the spacing."""
    scene = Scene.load("paper")
    ratio = (scene.grid.nodes[0] - 1) / (nodes - 1)
    update = {"nodes": (nodes, nodes), "time_step": scene.grid.time_step * ratio**2}
    return scene.model_copy(update={"grid": scene.grid.model_copy(update=update)})


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--devices", default="cpu,cpu", help="such as cuda:0,cuda:1: the first alone against all")
    parser.add_argument("--cluster", nargs="+", help="in their place, schedulers: the first against the others")
    parser.add_argument("--device", default="cpu", help="of this process and of the cluster's workers")
    parser.add_argument("--nodes", type=int, default=27, help="nodes along each side; 27 as in the paper")
    parser.add_argument("--plates", type=int, default=PLATES)
    parser.add_argument("--generations", type=int, default=GENERATIONS)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    device = given.device if given.cluster else given.devices.split(",")[0]
    try:
        with ExitStack() as opened:
            if given.cluster:
                asked = {where: (None, where) for where in given.cluster}
            else:
                asked = {"one": (device, None), "all": (given.devices, None)}
            pools = {
                name: opened.enter_context(open_pool(devices, cluster, given.device))
                for name, (devices, cluster) in asked.items()
            }
            found = measure(paper_scene(given.nodes), device, pools, given.plates, given.generations)
            words = {name: pool.description for name, pool in pools.items()}
        machine = describe_machine(device)
    except SceneError as error:
        parser.error(str(error))
    blocks = f"blocks of at most {found['plates_of_block']}"
    print(f"{given.plates} plates, {blocks}; medians of {len(found['rows'][HERE]['each'])} generations")
    for name, row in found["rows"].items():
        parts = ", ".join(f"{part} {1e3 * seconds:.1f}" for part, seconds in row["parts"].items())
        speed = found["speed_over_first"].get(name)
        times = "" if speed is None else f"{speed:6.2f} times the first"
        print(f"{words.get(name, name):40}{1e3 * row['seconds']:10.1f} ms ({parts}){times}")
    for name, cost in found["shipping"].items():
        print(f"{words[name]}: a task {cost['milliseconds_empty']:.2f} ms, {cost['bytes_there']} bytes of 4096 plates "
              f"{cost['milliseconds_with_bytes']:.2f} ms, 16 MiB {cost['milliseconds_of_16_MiB']:.1f} ms")  # fmt: skip
    if given.out is not None:
        record = {"machine": machine, "versions": describe_versions(), "pools": words, **found}
        given.out.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
