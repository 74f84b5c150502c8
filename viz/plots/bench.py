"""Plots of a benchmark: time of a node-step against the number of plates and against their size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.viz.plots.frame import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# One colour for each device; float32 lines are solid, float64 lines dashed.
COLOURS = ("#08519c", "#b2182b", "#1b7837", "#762a83", "#b35806", "#4d4d4d")
STYLES = {"float32": "o-", "float64": "s--"}
# Least memory traffic of a node and step with one launch a step: displacement and rate in float32, read and written.
BYTES_PER_NODE_STEP = 16


def draw_bench(record: Mapping[str, Any], path: str | Path) -> None:
    """Plot the object that ``warp-plate bench --json`` prints.

    Left: over the number of plates, for the size with most measurements. Right: over the nodes per side, at the fastest
    number of plates, with the limit of methods with one launch a step (dotted).
    """
    rows = [row for row in record["rows"] if row["status"] == "measured"]
    if not rows:
        raise ValueError("nothing was measured")
    with figure(path, (9, 3.6)) as made:
        left, right = made.subplots(1, 2, sharey=True)
        size = commonest_size(rows)
        devices = sorted({row["device"] for row in rows})
        _plot(left, [row for row in rows if row["nodes"] == size], "plates", devices)
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
    """Return the row with the least time of a node-step for each device, precision and size."""
    slow_first = sorted(rows, key=lambda row: -float(row["nanoseconds_per_node_step"]))
    return list({(row["device"], row["precision"], row["nodes"]): row for row in slow_first}.values())


def _plot(axes: Axes, rows: Sequence[Mapping[str, Any]], key: str, devices: Sequence[str]) -> None:
    """Plot a line over ``key`` ("plates" or "nodes") for each device and precision."""
    from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

    lines: dict[tuple[str, str], list[tuple[int, float]]] = {}
    for row in rows:
        lines.setdefault((row["device"], row["precision"]), []).append((row[key], row["nanoseconds_per_node_step"]))
    for (device, precision), points in sorted(lines.items()):
        look = {"color": COLOURS[devices.index(device) % len(COLOURS)], "markersize": 3.5, "linewidth": 1.3}
        axes.plot(*zip(*sorted(points), strict=True), STYLES[precision], **look, label=f"{device}, {precision}")
    axes.set(xscale="log", yscale="log")
    measured = FixedLocator(sorted({row[key] for row in rows}))
    for axis, locator in ((axes.xaxis, measured), (axes.yaxis, LogLocator(subs=(1, 2, 5)))):
        axis.set_major_locator(locator)
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter("{x:g}")
    axes.tick_params(axis="x", labelrotation=45)
    axes.grid(True, axis="y", linewidth=0.3, color="#cccccc")
