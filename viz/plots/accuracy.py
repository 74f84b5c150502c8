"""Work-precision plot: error of a plate against run time, one mark for each configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.viz.plots.frame import figure, number_log_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colour, marker and label by order and load; float64 has open marks and a dotted line.
FAMILIES = {
    (2, "nodes"): ("#7f7f7f", "s", "order 2, node masks"),
    (2, "overlap"): ("#d95f02", "o", "order 2, overlap"),
    (4, "moments"): ("#08519c", "D", "order 4, moments"),
    (7, "modal"): ("#1b9e77", "^", "modes"),
}
OTHER = ("#762a83", "v")
FRONT_COLOUR, TOLERANCE_COLOUR = "#a6d9a0", "#b0b0b0"
DRAWN_TOLERANCES = (0.1, 0.03, 0.01, 0.003, 0.001)

Row = Mapping[str, Any]


def draw_accuracy(record: Mapping[str, Any], path: str | Path) -> None:
    """Plot the object that ``warp-plate accuracy --json`` prints."""
    rows = [row for row in record["rows"] if row["status"] == "ok" and row["error"]]
    if not rows:
        raise ValueError("nothing was measured")
    front = [record["rows"][index] for index in record["front"]]
    with figure(path, (7.0, 5.2)) as fig:
        axes = fig.subplots()
        axes.set(xscale="log", yscale="log", xmargin=0.12)  # grids are written to the left of their marks
        look = {"drawstyle": "steps-post", "color": FRONT_COLOUR, "linewidth": 4.5, "solid_capstyle": "round"}
        axes.plot(*_points(front), **look, zorder=1, label="best for its time")
        as_written, others = ([row for row in rows if row["as_written"] == written] for written in (True, False))
        for family in sorted(set(map(_family, others))):
            _plot_family(axes, [row for row in others if _family(row) == family], front)
        if as_written:
            star = {"marker": "*", "markersize": 13, "color": "#111111", "markeredgecolor": "white"}
            axes.plot(*_points(as_written), linestyle="", **star, zorder=4, label="the scene as written")
        _annotate(axes, record, rows)
        fig.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)


def _family(row: Row) -> tuple[tuple[int, str], str]:
    return (row["order"], row["load"]), row["precision"]


def _points(rows: Sequence[Row]) -> tuple[list[float], list[float]]:
    return [row["seconds_per_plate"] for row in rows], [row["error"] for row in rows]


def _plot_family(axes: Axes, rows: Sequence[Row], front: Sequence[Row]) -> None:
    """Plot a line over the longest time step of each grid, and small marks for others; write the nodes beside marks of
    high order on the front."""
    longest = {tuple(row["nodes"]): row for row in sorted(rows, key=lambda row: row["time_step"] or 0.0)}
    line = sorted(longest.values(), key=lambda row: -float(row["spacing"]))
    others = [row for row in rows if not any(row is other for other in line)]
    (order, load), precision = _family(rows[0])
    colour, marker, name = FAMILIES.get((order, load), (*OTHER, f"order {order}, {load}"))
    single = precision == "float32" or load == "modal"
    look = {"color": colour, "marker": marker, "markerfacecolor": colour if single else "white", "zorder": 3}
    style, label = ("-", name) if single else (":", f"{name}, float64")
    axes.plot(*_points(line), linestyle=style, linewidth=1.2, markersize=5, label=label, **look)
    if others:
        axes.plot(*_points(others), linestyle="", markersize=3, label=f"{name}, ½ and ¼ of Δt", **look)
    text = {"textcoords": "offset points", "fontsize": 6.5, "color": colour, "ha": "right", "va": "top"}
    for row in (row for row in line if single and order > 2 and row in front):
        nodes, below = "×".join(map(str, row["nodes"])), (-5, -12 if load == "modal" else -5)  # [pt]
        axes.annotate(nodes, (row["seconds_per_plate"], row["error"]), below, **text)


def _annotate(axes: Axes, record: Mapping[str, Any], rows: Sequence[Row]) -> None:
    from matplotlib.ticker import NullFormatter

    smallest = min(row["error"] for row in rows)
    for tolerance in DRAWN_TOLERANCES:
        if tolerance > smallest:
            axes.axhline(tolerance, color=TOLERANCE_COLOUR, linewidth=0.5, zorder=0)
            place = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "va": "center"}
            axes.annotate(f"{100 * tolerance:g} %", (1, tolerance), (3, 0), **place, fontsize=7, color="#808080")
    uncertainty = record["reference"]["uncertainty"]
    if uncertainty > smallest / 3:
        axes.axhspan(smallest / 3, uncertainty, color="#eeeeee", zorder=0, label="uncertainty of the reference")
    axes.set(xlabel="seconds per plate", ylabel="relative error of localization factors")
    axes.yaxis.set_minor_formatter(NullFormatter())
    number_log_axis(axes.xaxis)
