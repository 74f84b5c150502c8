"""Time warp-plate beside other tools that do the same work: python benchmarks/peers.py [--help].

The work is in peer_codes/problem.py, each tool's way of doing it in a file beside that. Every peer is first
checked against a plain float64 reference, then all are timed in turn. A peer whose package, compiler or GPU
is absent is listed as such; a slow one takes fewer steps, so times are for each interior node and step.
"""

from __future__ import annotations

import argparse
import datetime
import json
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path

from peer_codes.contest import Peer, Timing, prepare_all, time_in_turn
from peer_codes.machine import machine, usable_cores, versions
from peer_codes.problem import Problem

PEERS = (
    Peer("warp-plate", "warp_plate_peer", ("cpu", "cuda"), threaded=True, orders=(2, 4)),
    Peer("numpy", "numpy_slices", ("cpu",)),
    Peer("numpy-plates-last", "numpy_slices", ("cpu",), function="make_plates_last"),
    Peer("scipy", "scipy_sparse", ("cpu",)),
    Peer("numba", "numba_loops", ("cpu",), threaded=True),
    Peer("numba-lanes", "numba_lanes", ("cpu",), threaded=True),
    Peer("c", "c_plate", ("cpu",), threaded=True),
    Peer("jax", "jax_loop", ("cuda",), orders=(2, 4)),
    Peer("cupy", "cupy_raw", ("cuda",), orders=(2, 4)),
    Peer("torch", "torch_compiled", ("cuda",)),
)
CASES = {"cpu": "20x27,256x27,1x257", "cuda": "20x27,1024x27,8192x27,65536x27,1x513,1x1025"}
COLUMNS = ("peer", "threads", "steps", "ns", "least", "most", "10^9/s", "x warp-plate", "error")


def main() -> int:
    """Run the contest that the command line asks for; 1 if no peer could run or one failed."""
    options = parse()
    record = {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "device": options.device,
        "seed": options.seed,
        "rounds": options.rounds,
        "machine": machine(),
        "versions": versions(),
    }
    print(", ".join(f"{key} {value}" for key, value in {**record["machine"], **record["versions"]}.items()))
    cases = []
    for precision in options.precision:
        for plates, nodes in options.cases:
            steps = options.steps or default_steps(nodes)
            problem = Problem(plates, nodes, steps, precision, options.seed, options.device, options.order)
            entries, absent = prepare_all(options.only, problem, options.threads, options.seconds)
            timings = time_in_turn(entries, options.rounds)
            cases.append(as_record(problem, timings, absent))
            show(problem, timings, absent)
    if options.json:
        options.json.write_text(json.dumps({**record, "cases": cases}, indent=1) + "\n")
    sound = all(case["results"] for case in cases)
    wrong = any(reason.startswith(("wrong", "failed")) for case in cases for reason in case["absent"].values())
    return 0 if sound and not wrong else 1


def default_steps(nodes: int) -> int:
    """The search's 1250 steps on small grids, fewer on large ones, where a run would take long."""
    return 1250 if nodes <= 65 else max(100, 81250 // nodes)


def slowdown(timing: Timing, timings: Sequence[Timing]) -> float | None:
    """Return the time relative to warp-plate on as many threads; None if that was not measured."""
    for other in timings:
        if other.entry.peer.name == "warp-plate" and other.entry.threads == timing.entry.threads:
            return timing.median / other.median
    return None


def as_record(problem: Problem, timings: Sequence[Timing], absent: dict[str, str]) -> dict:
    """Return a case for the JSON file."""
    return {
        "plates": problem.plates,
        "nodes": problem.nodes,
        "steps": problem.steps,
        "precision": problem.precision,
        "order": problem.order,
        "results": [
            {
                "peer": timing.entry.peer.name,
                "threads": timing.entry.threads,
                "steps": timing.entry.problem.steps,
                "nanoseconds": {"median": timing.median, "min": timing.least, "max": timing.most},
                "node_steps_per_second": 1e9 / timing.median,
                "times_warp_plate": slowdown(timing, timings),
                "largest_relative_error": timing.entry.error,
            }
            for timing in timings
        ],
        "absent": absent,
    }


def show(problem: Problem, timings: Sequence[Timing], absent: dict[str, str]) -> None:
    """Print one case as a table, with rich where it is installed, and the peers that are absent below it."""
    size = f"{problem.plates} x {problem.nodes}^2, {problem.steps} steps"
    work = f"{size}, order {problem.order}, {problem.precision}, {problem.device}"
    title = f"{work}; times in ns for an interior node and step"
    rows = [cells(timing, timings) for timing in sorted(timings, key=lambda timing: timing.median)]
    if not rows:
        print(f"{title}: none")
    elif not shown_by_rich(title, rows):
        print_plainly(title, rows)
    for label, reason in absent.items():
        print(f"  {label}: {reason}")
    sys.stdout.flush()


def shown_by_rich(title: str, rows: Sequence[Sequence[str]]) -> bool:
    """Print the table with rich; False where it is not installed."""
    try:
        from rich.console import Console
        from rich.table import Table
    except ImportError:
        return False
    table = Table(title=title)
    for index, column in enumerate(COLUMNS):
        table.add_column(column, justify="left" if index == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console(width=max(100, Console().width)).print(table)
    return True


def cells(timing: Timing, timings: Sequence[Timing]) -> list[str]:
    """Return a row of the table."""
    entry, ratio = timing.entry, slowdown(timing, timings)
    on_cpu = entry.problem.device == "cpu" and entry.peer.threaded
    times = [f"{value:.3g}" for value in (timing.median, timing.least, timing.most, 1 / timing.median)]
    counts = [str(entry.threads) if on_cpu else "-", str(entry.problem.steps)]
    return [entry.peer.name, *counts, *times, "-" if ratio is None else f"{ratio:.2f}", f"{entry.error:.0e}"]


def print_plainly(title: str, rows: Sequence[Sequence[str]]) -> None:
    """The table in plain text."""
    widths = [max(len(row[index]) for row in (COLUMNS, *rows)) for index in range(len(COLUMNS))]
    print(title)
    for row in (COLUMNS, *rows):
        print("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))


def parse() -> argparse.Namespace:
    """The command line; argparse ends the program with a message where it makes no sense."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    known = ", ".join(peer.name for peer in PEERS)
    option = parser.add_argument
    option("--device", choices=("cpu", "cuda"), default="cpu", help="where the work is done (cpu)")
    option("--cases", type=read_cases, metavar="PxN,...", help=f"plates x nodes a side (by device: {CASES})")
    option("--threads", type=read_counts, metavar="T,...", help="CPU threads (1,2 where there are two cores)")
    option("--precision", type=read_precisions, default=["float32"], metavar="P,...", help="float32, float64")
    option("--order", type=int, choices=(2, 4), default=2, help="of the differences (2)")
    option("--rounds", type=int, default=7, help="timed runs of each peer (7)")
    option("--seconds", type=float, default=0.3, help="of a run; slow peers take fewer steps (0.3)")
    option("--steps", type=int, help="of a full run (1250, fewer on large grids)")
    option("--only", type=read_names, metavar="NAME,...", help=f"peers to run, of {known}")
    option("--seed", type=int, help="of the random loads (a fresh one)")
    option("--json", type=Path, metavar="FILE", help="write the figures there too")
    options = parser.parse_args()
    if options.rounds < 1 or options.seconds <= 0 or (options.steps is not None and options.steps < 2):
        parser.error("need --rounds >= 1, --seconds > 0 and --steps >= 2")
    options.cases = options.cases or read_cases(CASES[options.device])
    options.threads = options.threads or ([1, 2] if usable_cores() > 1 else [1])
    options.only = options.only or [peer for peer in PEERS if options.device in peer.devices]
    options.only = [peer for peer in options.only if options.order in peer.orders]
    options.seed = secrets.randbelow(2**32) if options.seed is None else options.seed
    return options


def read_cases(text: str) -> list[tuple[int, int]]:
    """'20x27,1x257' as [(20, 27), (1, 257)]."""
    cases = []
    for case in text.split(","):
        plates, _, nodes = case.partition("x")
        if not plates.isdecimal() or not nodes.isdecimal() or int(plates) < 1 or int(nodes) < 5:
            raise argparse.ArgumentTypeError(f"{case!r} is not plates x nodes (5 or more), like 20x27")
        cases.append((int(plates), int(nodes)))
    return cases


def read_counts(text: str) -> list[int]:
    """'1,2' as [1, 2]."""
    if not all(count.isdecimal() and 1 <= int(count) <= 256 for count in text.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers from 1 to 256, like 1,2")
    return [int(count) for count in text.split(",")]


def read_precisions(text: str) -> list[str]:
    """'float32,float64' as a list."""
    for name in text.split(","):
        if name not in ("float32", "float64"):
            raise argparse.ArgumentTypeError(f"{name!r} is neither float32 nor float64")
    return text.split(",")


def read_names(text: str) -> list[Peer]:
    """Names as peers, in the order of PEERS."""
    names = set(text.split(","))
    unknown = names - {peer.name for peer in PEERS}
    if unknown:
        known = ", ".join(peer.name for peer in PEERS)
        raise argparse.ArgumentTypeError(f"unknown: {', '.join(sorted(unknown))}; known: {known}")
    return [peer for peer in PEERS if peer.name in names]


if __name__ == "__main__":
    sys.exit(main())
