"""Speed of time stepping, compared with the limits of the hardware: python benchmarks/bench.py [--help].

Prints a table, and writes its figures as JSON with plots beside it. Ctrl-C keeps the measurements so far.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from step_rates.cases import Kind, all_devices, make_cases
from step_rates.measure import FULL, QUICK, BenchReport, BenchRow, measure_all
from step_rates.plots import draw_bench

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

PRECISIONS = ("float32", "float64")
HEADINGS = ("plate", "path", "nodes", "plates", "ns", "10⁹/s", "swarm (s)", "KiB", "of limit")
LEGEND = (
    "ns, 10⁹/s: nanoseconds per node-step, and node-steps per second. swarm: all plates over the paper's 1250 steps. "
    "KiB: device memory per plate. of limit: share of the copy bandwidth at the least number of bytes that one launch "
    "per step moves (several steps per launch may exceed it), or of the arithmetic rate at the fewest operations per "
    "node-step."
)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print and write."""
    parser = make_parser()
    given = parser.parse_args(arguments)
    try:
        target = output.output_file(given.out, "bench.json")
        devices = all_devices() if given.device == "all" else [name.strip() for name in given.device.split(",")]
        precisions = [given.precision] if given.precision else PRECISIONS[:1] if given.quick else PRECISIONS
        cases = make_cases(devices, precisions, given.plates, given.nodes, given.path, given.quick, given.kind)
        pace = QUICK if given.quick else FULL
        with output.progress_bar("measuring", shown=not given.json) as show:
            report = measure_all(cases, pace, lambda done, case: show(done, len(cases), str(case)))
    except SceneError as error:
        parser.error(str(error))
    record = asdict(report)
    output.report(
        given.json,
        lambda: record,
        lambda console: print_report(report, console),
        write=lambda: output.write_measurements(target, record, draw_bench, given.pictures),
    )


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0].partition(":")[0] + ".")
    parser.add_argument(
        "--plates",
        type=_integers(1, 10**7),
        help="numbers of plates, such as 1,20,256; without --nodes with the paper's 27 x 27 nodes",
    )
    parser.add_argument(
        "--nodes",
        type=_integers(5, 8193),
        help="nodes along a side, such as 27,105; without --plates with enough plates to keep the device busy",
    )
    parser.add_argument("--precision", choices=PRECISIONS, help="default: both; with --quick, float32")
    parser.add_argument("--device", default="all", help="such as cpu or cpu,cuda:0; all (the default): every device")
    parser.add_argument("--path", choices=("auto", "resident", "streaming"), default="auto")
    parser.add_argument(
        "--kind",
        choices=get_args(Kind),
        help="plates: plain, the paper's; order4, of fourth order; free, with two free edges under tension; stretching "
        "(default: plain with --plates, --nodes or --quick, else all, and one large plate)",
    )
    parser.add_argument("--quick", action="store_true", help="run a few short cases only")
    parser.add_argument("--out", type=Path, help="file of measurements (.json; default: bench.json in this folder)")
    parser.add_argument("--no-pictures", dest="pictures", action="store_false", help="write no plots beside the file")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    return parser


def _integers(least: int, most: int) -> Callable[[str], list[int]]:
    """Return a parser of comma-separated integers, '1,20' as [1, 20]."""

    def integers(text: str) -> list[int]:
        parts = [part.strip() for part in text.split(",")]
        if not all(part.isdecimal() and len(part) < 20 and least <= int(part) <= most for part in parts):
            raise argparse.ArgumentTypeError(f"{text}: must be integers from {least} to {most}, such as 27,105")
        return [int(part) for part in parts]

    return integers


def print_report(report: BenchReport, console: Console) -> None:
    """Print a table for each device and precision, and the cases that were skipped."""
    groups = dict.fromkeys((row.device, row.precision) for row in report.rows if row.measured)
    for device, precision in groups:
        limits = report.limits[device]
        copied, arithmetic = limits.copy_bytes_per_second / 1e9, limits.flops[precision] / 1e9
        rows = (row for row in report.rows if row.measured and (row.device, row.precision) == (device, precision))
        after = f"limits: copying {copied:.4g} GB/s, arithmetic {arithmetic:.4g} GFLOP/s\n"
        title = f"{report.machine['devices'][device]}, {precision}"
        output.print_rows(console, HEADINGS, list(map(_cells, rows)), after, title=title)
    if groups:
        console.print(LEGEND)
    for row in report.rows:
        if not row.measured:
            console.print(f"{row.device}, {row.precision}, {row.plates} × {row.nodes}², {row.kind}: {row.status}")
    if report.interrupted:
        console.print("Interrupted by Ctrl-C; measurements up to then are shown.")


def _cells(row: BenchRow) -> list[str]:
    """Return the texts of the columns of a measured row."""
    numbers = ((row.nanoseconds_per_node_step, ".3g"), ((row.node_steps_per_second or 0) / 1e9, ".4g"))
    numbers += ((row.swarm_seconds, ".3g"), ((row.bytes_per_plate or 0) / 1024, ".0f"))
    share = f"{100 * (row.share or 0):.0f} % {row.limit}"
    return [row.kind, row.path, f"{row.nodes}", f"{row.plates}", *(output.number_text(*n) for n in numbers), share]


if __name__ == "__main__":
    main()
