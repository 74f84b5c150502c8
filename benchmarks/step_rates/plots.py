"""Plots of a benchmark: time of a node-step against the number of plates and against their size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.viz.plots.frame import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# One colour for each device and one marker for each kind of plate; float32 lines are solid, float64 lines dashed.
COLOURS = ("#08519c", "#b2182b", "#1b7837", "#762a83", "#b35806", "#4d4d4d")
STYLES = {"float32": "-", "float64": "--"}
MARKERS = {"plain": "o", "order4": "D", "free": "^", "stretching": "v"}
# Least memory traffic of a node and step with one launch a step: displacement and rate in float32, read and written.
BYTES_PER_NODE_STEP = 16


def draw_bench(record: Mapping[str, Any], *paths: str | Path) -> None:
    """Plot the object that ``bench.py --json`` prints.

    Left: over the number of plates, for the size with most measurements and its first kind. Right: over the nodes per
    side, at the fastest number of plates, with the limit of methods with one launch a step (dotted).
    """
    rows = [row for row in record["rows"] if row["status"] == "measured"]
    if not rows:
        raise ValueError("nothing was measured")
    with figure(paths, (9, 3.6)) as made:
        left, right = made.subplots(1, 2, sharey=True)
        size = commonest_size(rows)
        devices = sorted({row["device"] for row in rows})
        first = next(_kind(row) for row in rows if row["nodes"] == size)
        _plot(left, [row for row in rows if (row["nodes"], _kind(row)) == (size, first)], "plates", devices)
        left.set(xlabel=f"plates of {size} × {size} nodes", ylabel="ns per node and step")
        _plot(right, fastest_of_each_size(rows), "nodes", devices)
        right.set_xlabel("nodes per side")
        for index, device in enumerate(devices):
            limit = 1e9 * BYTES_PER_NODE_STEP / record["limits"][device]["copy_bytes_per_second"]
            label = f"{device}, {BYTES_PER_NODE_STEP} B at copy bandwidth"
            right.axhline(limit, color=COLOURS[index % len(COLOURS)], linewidth=1.0, linestyle=":", label=label)
        made.legend(*right.get_legend_handles_labels(), loc="outside right upper")


def commonest_size(rows: Sequence[Mapping[str, Any]]) -> int:
    """Return the nodes per side measured with most numbers of plates; the smallest of equals."""
    counted = Counter(nodes for nodes, _ in {(row["nodes"], row["plates"]) for row in rows})
    return max(sorted(counted), key=lambda nodes: counted[nodes])


def fastest_of_each_size(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the row with the least time of a node-step for each device, precision, kind and size."""
    slow_first = sorted(rows, key=lambda row: -float(row["nanoseconds_per_node_step"]))
    return list({(row["device"], row["precision"], _kind(row), row["nodes"]): row for row in slow_first}.values())


def _kind(row: Mapping[str, Any]) -> str:
    return str(row.get("kind", "plain"))


def _plot(axes: Axes, rows: Sequence[Mapping[str, Any]], key: str, devices: Sequence[str]) -> None:
    """Plot a line over ``key`` ("plates" or "nodes") for each device, kind and precision."""
    from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

    lines: dict[tuple[str, str, str], list[tuple[int, float]]] = {}
    for row in rows:
        line = (row["device"], _kind(row), row["precision"])
        lines.setdefault(line, []).append((row[key], row["nanoseconds_per_node_step"]))
    for (device, kind, precision), points in sorted(lines.items()):
        look = {"color": COLOURS[devices.index(device) % len(COLOURS)], "markersize": 3.5, "linewidth": 1.3}
        label = f"{device}, {precision}" + (f", {kind}" if kind != "plain" else "")
        axes.plot(*zip(*sorted(points), strict=True), MARKERS[kind] + STYLES[precision], **look, label=label)
    axes.set(xscale="log", yscale="log")
    measured = FixedLocator(sorted({row[key] for row in rows}))
    for axis, locator in ((axes.xaxis, measured), (axes.yaxis, LogLocator(subs=(1, 2, 5)))):
        axis.set_major_locator(locator)
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter("{x:g}")
    axes.tick_params(axis="x", labelrotation=45)
    axes.grid(True, axis="y", linewidth=0.3, color="#cccccc")
