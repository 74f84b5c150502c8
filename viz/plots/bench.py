"""Plot of a benchmark's figures: nanoseconds a node-step against plates, and against the size of a plate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.viz.availability import plot_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# One for each device, in the order of the figures; a line is solid for float32 and dashed for float64.
COLOURS = ("#08519c", "#b2182b", "#1b7837", "#762a83", "#b35806", "#4d4d4d")
STYLES = {"float32": "-", "float64": "--"}
MARKERS = {"float32": "o", "float64": "s"}
# Displacement and rate in float32, read and written: the least that one launch a step moves.
BYTES_A_LAUNCH = 16


def draw_bench_beside(record: Mapping[str, Any], path: Path) -> tuple[list[Path], str | None]:
    """See :func:`plot_beside`."""
    return plot_beside(draw_bench, record, path)


def draw_bench(record: Mapping[str, Any], path: str | Path) -> Path:
    """Both plots of the object that ``warp-plate bench --json`` prints; PNG, SVG or PDF by ending.

    Left: against plates, at the size that was measured with most numbers of plates. Right: against nodes of a side, at
    the number of plates that was fastest for each size; dotted, what no path with one launch a step gets below, by
    the device's copy bandwidth, in float32.

    Raises:
        ValueError: nothing was measured, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    rows = [row for row in record["rows"] if row["status"] == "measured"]
    if not rows:
        raise ValueError("nothing was measured")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        FigureCanvasAgg(figure)
        against_plates, against_nodes = figure.subplots(1, 2, sharey=True)
        size = commonest_size(rows)
        devices = sorted({row["device"] for row in rows})
        _plot(against_plates, [row for row in rows if row["nodes"] == size], "plates", devices)
        against_plates.set_xlabel(f"plates of {size} × {size} nodes")
        against_plates.set_ylabel("ns for a node and a step")
        _plot(against_nodes, fastest_of_each_size(rows), "nodes", devices)
        against_nodes.set_xlabel("nodes of a side")
        _plot_copy_limits(against_nodes, record["limits"], devices)
        # The right-hand plot has every line of the left-hand one, and the limits.
        figure.legend(*against_nodes.get_legend_handles_labels(), loc="outside right upper", frameon=False)
        figure.savefig(path, dpi=200)
    return Path(path)


def commonest_size(rows: Sequence[Mapping[str, Any]]) -> int:
    """Nodes of a side that were measured with most numbers of plates; of equals, the smallest."""
    counted = Counter(nodes for nodes, _ in {(row["nodes"], row["plates"]) for row in rows})
    return max(sorted(counted), key=lambda nodes: counted[nodes])


def fastest_of_each_size(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """For each device, precision and size, the row with the least time a node-step."""
    found: dict[tuple[str, str, int], Mapping[str, Any]] = {}
    for row in sorted(rows, key=lambda row: float(row["nanoseconds_per_node_step"])):
        found.setdefault((row["device"], row["precision"], row["nodes"]), row)
    return list(found.values())


def _plot(axes: Axes, rows: Sequence[Mapping[str, Any]], along: str, devices: Sequence[str]) -> None:
    """A line for each device and precision; ``along`` is "plates" or "nodes"."""
    from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

    for index, device in enumerate(devices):
        for precision, style in STYLES.items():
            points = sorted(
                (row[along], row["nanoseconds_per_node_step"])
                for row in rows
                if (row["device"], row["precision"]) == (device, precision)
            )
            if points:
                axes.plot(
                    *zip(*points, strict=True),
                    style,
                    color=COLOURS[index % len(COLOURS)],
                    marker=MARKERS[precision],
                    markersize=3.5,
                    linewidth=1.3,
                    label=f"{device}, {precision}",
                )
    axes.set_xscale("log")
    axes.set_yscale("log")
    # Ticks along x at what was measured; all of them written out in full.
    measured = sorted({row[along] for row in rows})
    for axis, ticks in ((axes.xaxis, FixedLocator(measured)), (axes.yaxis, LogLocator(subs=(1, 2, 5)))):
        axis.set_major_locator(ticks)
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter("{x:g}")
    axes.tick_params(axis="x", labelrotation=45)
    axes.grid(True, axis="y", linewidth=0.3, color="#cccccc")
    axes.spines[["top", "right"]].set_visible(False)


def _plot_copy_limits(axes: Axes, limits: Mapping[str, Mapping[str, Any]], devices: Sequence[str]) -> None:
    for index, device in enumerate(devices):
        least = 1e9 * BYTES_A_LAUNCH / limits[device]["copy_bytes_per_second"]
        label = f"{device}, {BYTES_A_LAUNCH} B at copy bandwidth"
        axes.axhline(least, color=COLOURS[index % len(COLOURS)], linewidth=1.0, linestyle=":", label=label)
