"""``warp-plate bench``: speed of time stepping on this machine, compared with the limits of its hardware."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.bench.measure import BenchReport, BenchRow

HEADINGS = ("plate", "path", "nodes", "plates", "ns", "10⁹/s", "swarm (s)", "KiB", "of limit")
LEGEND = (
    "ns, 10⁹/s: nanoseconds a node-step, and node-steps a second. swarm: all plates over the paper's 1250 steps. KiB: "
    "device memory a plate. of limit: share of the copy bandwidth at the least number of bytes that one launch a step "
    "moves (several steps a launch may exceed it), or of the arithmetic rate at the fewest operations a node-step."
)


def bench(
    *,
    plates: str | None = None,
    nodes: str | None = None,
    precision: Literal["float32", "float64"] | None = None,
    device: Annotated[str, Parameter(help="Such as cpu or cpu,cuda:0; all: every device of this machine.")] = "all",
    path: options.Stepping = "auto",
    kind: Literal["plain", "order4", "free", "stretching"] | None = None,
    quick: options.Flag = False,
    out: Path | None = None,
    force: options.Force = False,
    pictures: options.Pictures = True,
    json: options.Json = False,
) -> None:
    """Measure the speed of this machine for different numbers and sizes of plates.

    Parameters
    ----------
    plates
        Numbers of plates, such as 1,20,256; without --nodes with the paper's 27 x 27 nodes.
    nodes
        Nodes of a side, such as 27,105; without --plates with enough plates to keep the device busy.
    precision
        float32 or float64 (default: both; with --quick, float32).
    kind
        Plates: plain, the paper's; order4, of fourth order; free, with two free edges under tension; stretching
        (default: plain with --plates, --nodes or --quick, else all, and one large plate).
    quick
        Run a few short cases only.
    out
        The file of measurements (.json; default: bench.json in this folder).
    """
    target = output.output_file(out, "bench.json", holds="measurements with limits", force=force)
    counts, sizes = _integers("--plates", plates, 1, 10**7), _integers("--nodes", nodes, 5, 8193)
    from warp_plate.bench.cases import all_devices, make_cases
    from warp_plate.bench.machine import busy
    from warp_plate.bench.measure import FULL, QUICK, measure_all
    from warp_plate.viz.plots.bench import draw_bench

    devices = all_devices() if device == "all" else [name.strip() for name in device.split(",")]
    precisions = [precision] if precision else ["float32"] if quick else ["float32", "float64"]
    cases = make_cases(devices, precisions, counts, sizes, path, quick, kind)
    if warning := busy():
        output.log(warning)
    with output.progress_bar("measuring", shown=not json) as show:
        report = measure_all(cases, QUICK if quick else FULL, lambda done, case: show(done, len(cases), str(case)))
    record = asdict(report)
    written = output.write_measurements(target, record, draw_bench, pictures)
    output.report(json, lambda: record, lambda console: _print(report, console), written)


def _integers(option: str, text: str | None, least: int, most: int) -> list[int] | None:
    """Parse a comma-separated list of integers, '1,20' as [1, 20]."""
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and len(part) < 20 and least <= int(part) <= most for part in parts):
        raise SceneError(f"{option} {text}: must be integers from {least} to {most}, such as 27,105")
    return [int(part) for part in parts]


def _print(report: BenchReport, console: Console) -> None:
    groups = dict.fromkeys((row.device, row.precision) for row in report.rows if row.measured)
    for device, precision in groups:
        limits = report.limits[device]
        copied, arithmetic = limits.copy_bytes_per_second / 1e9, limits.flops[precision] / 1e9
        made = output.table(*HEADINGS, title=f"{report.machine.devices[device]}, {precision}")
        for row in report.rows:
            if row.measured and (row.device, row.precision) == (device, precision):
                made.add_row(*_cells(row))
        console.print(made, f"limits: copying {copied:.4g} GB/s, arithmetic {arithmetic:.4g} GFLOP/s\n")
    if groups:
        console.print(LEGEND)
    for row in report.rows:
        if not row.measured:
            console.print(f"{row.device}, {row.precision}, {row.plates} × {row.nodes}², {row.kind}: {row.status}")
    if report.interrupted:
        console.print("Interrupted by Ctrl-C; measurements up to then are shown.")


def _cells(row: BenchRow) -> list[str]:
    """Return the cells of a measured row."""
    rate = (row.node_steps_per_second or 0) / 1e9
    head = [row.kind, str(row.path), str(row.nodes), str(row.plates)]
    figures = [f"{row.nanoseconds_per_node_step:.3g}", f"{rate:.4g}", f"{row.swarm_seconds:.3g}"]
    return [*head, *figures, f"{(row.bytes_per_plate or 0) / 1024:.0f}", f"{100 * (row.share or 0):.0f} % {row.limit}"]
