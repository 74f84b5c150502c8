"""``warp-plate bench``: how fast this machine steps plates, and how near that is to what it can do at most."""

from __future__ import annotations

import json as json_format
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.bench.measure import BenchReport, BenchRow

HEADINGS = ("path", "nodes", "plates", "steps", "ns", "10⁹/s", "swarm (s)", "KiB", "of limit")
LEGEND = (
    "ns, 10⁹/s: time for a node-step, and node-steps a second. swarm: all plates over the paper's 1250 steps. KiB: "
    "of device memory a plate. of limit: share of copy bandwidth at the least bytes that one launch a step moves "
    "(several steps a launch can pass it), or of arithmetic at the fewest operations that a node-step needs."
)


def bench(
    *,
    plates: str | None = None,
    nodes: str | None = None,
    precision: Literal["float32", "float64"] | None = None,
    device: str = "all",
    path: Literal["auto", "resident", "streaming"] = "auto",
    quick: Annotated[bool, cyclopts.Parameter(negative="")] = False,
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Measure the speed of this machine over numbers and sizes of plates.

    Parameters
    ----------
    plates
        Numbers of plates, such as 1,20,256; without --nodes at the paper's 27 x 27 nodes.
    nodes
        Nodes of a side, such as 27,105; without --plates with as many plates as keep the device busy.
    precision
        float32 or float64; both when left out (with --quick, float32).
    device
        Where to measure, such as cpu or cpu,cuda:0; all devices of this machine when left out.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch).
    quick
        A few cases and short runs.
    out
        The file of figures (.json); bench.json in this folder when left out. Pictures are written beside it.
    pictures
        Plot cost against plates and against nodes (needs the extra viz).
    json
        Print one JSON object instead of a table.
    """
    target = output.output_file(out, "", "bench", (".json",))
    counts, sizes = _whole_numbers("--plates", plates, 1, 10**7), _whole_numbers("--nodes", nodes, 5, 8193)
    from warp_plate.bench.cases import all_devices, make_cases
    from warp_plate.bench.machine import busy
    from warp_plate.bench.measure import FULL, QUICK, measure_all

    devices = all_devices() if device == "all" else [name.strip() for name in device.split(",")]
    precisions = [precision] if precision else ["float32"] if quick else ["float32", "float64"]
    cases = make_cases(devices, precisions, counts, sizes, path, quick)
    warning = busy()
    if warning:
        print(f"warp-plate: {warning}", file=sys.stderr)
    with output.progress_bar("measuring", shown=not json) as show:

        def on_progress(done: int, case: object) -> None:
            show(done, len(cases), str(case))

        report = measure_all(cases, QUICK if quick else FULL, on_progress)
    files, missing = _write(report, target, pictures)
    if json:
        output.print_json({**report.as_json(), "files": [str(file) for file in files]})
        return
    _print(report, output.console())
    output.print_files(files, missing)


def _whole_numbers(option: str, text: str | None, least: int, most: int) -> list[int] | None:
    """'1,20' as [1, 20].

    Raises:
        SceneError: something else than whole numbers from ``least`` to ``most`` with commas between.
    """
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and len(part) < 20 and least <= int(part) <= most for part in parts):
        raise SceneError(f"{option} {text}: must be whole numbers from {least} to {most}, such as 27,105")
    return [int(part) for part in parts]


def _write(report: BenchReport, path: Path, pictures: bool) -> tuple[list[Path], str | None]:
    """The figures as JSON and their pictures; returns the files, and why a picture is missing."""
    from warp_plate.result.atomic_io import write_atomically

    write_atomically(f"{json_format.dumps(report.as_json(), indent=1)}\n".encode(), path)
    if not pictures:
        return [path], None
    from warp_plate.viz.plots.bench import draw_bench
    from warp_plate.viz.plots.frame import save_plots

    drawn, missing = save_plots(draw_bench, report.as_json(), path)
    return [path, *drawn], missing


def _print(report: BenchReport, console: Console) -> None:
    groups = dict.fromkeys((row.device, row.precision) for row in report.rows if row.measured)
    for device, precision in groups:
        limits = report.limits[device]
        copied, arithmetic = limits.copy_bytes_per_second / 1e9, limits.flops[precision] / 1e9
        made = output.table(*HEADINGS, title=f"{report.machine.devices[device]}, {precision}")
        for row in report.rows:
            if row.measured and (row.device, row.precision) == (device, precision):
                made.add_row(*_cells(row))
        console.print(made)
        console.print(f"limits: copying {copied:.4g} GB/s, arithmetic {arithmetic:.4g} GFLOP/s\n")
    if groups:
        console.print(LEGEND)
    for row in report.rows:
        if not row.measured:
            console.print(f"{row.device}, {row.precision}, {row.plates} × {row.nodes}²: {row.status}")
    if report.interrupted:
        console.print("Interrupted by Ctrl-C: what was measured until then is shown.")


def _cells(row: BenchRow) -> list[str]:
    """A measured row as the table shows it."""
    rate = (row.node_steps_per_second or 0) / 1e9
    head = [str(row.path), str(row.nodes), str(row.plates), str(row.steps)]
    figures = [f"{row.nanoseconds_per_node_step:.3g}", f"{rate:.4g}", f"{row.swarm_seconds:.3g}"]
    return [*head, *figures, f"{(row.bytes_per_plate or 0) / 1024:.0f}", f"{100 * (row.share or 0):.0f} % {row.limit}"]
