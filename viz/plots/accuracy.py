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
# Families whose grids are written beside their marks.
NUMBERED = ((2, "overlap"), (4, "moments"), (7, "modal"))
FRONT_COLOUR, TOLERANCE_COLOUR, REFUSED_COLOUR = "#a6d9a0", "#b0b0b0", "#b2182b"
DRAWN_TOLERANCES = (0.1, 0.03, 0.01, 0.003, 0.001)
REFUSED_HEIGHT = 2.2  # of the marks of refused configurations over the largest error

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
        for family in families(rows):
            _plot_family(axes, [row for row in rows if not row["as_written"] and _family(row) == family], front)
        as_written = [row for row in rows if row["as_written"]]
        if as_written:
            star = {"marker": "*", "markersize": 13, "color": "#111111", "markeredgecolor": "white"}
            axes.plot(*_points(as_written), linestyle="", **star, zorder=4, label="the scene as written")
        refused = refused_points(record["rows"], rows)
        if refused:
            height = REFUSED_HEIGHT * max(row["error"] for row in rows)
            axes.axhline(height, color=REFUSED_COLOUR, linewidth=0.6, alpha=0.4)
            cross = {"marker": "x", "color": REFUSED_COLOUR, "markersize": 6, "zorder": 4}
            axes.plot(refused, [height] * len(refused), linestyle="", label="refused: Δt above the limit", **cross)
        _annotate(axes, record, rows)
        fig.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)


def families(rows: Sequence[Row]) -> list[tuple[tuple[int, str], str]]:
    """Return the measured ((order, load), precision), in the order of FAMILIES."""
    order = [*FAMILIES]
    measured = {_family(row) for row in rows if not row["as_written"]}
    return sorted(measured, key=lambda family: (order.index(family[0]) if family[0] in order else len(order), family))


def longest_steps(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Split rows into those with the longest time step of their grid, from coarse to fine, and the others."""
    longest = {tuple(row["nodes"]): row for row in sorted(rows, key=lambda row: row["time_step"] or 0.0)}
    line = sorted(longest.values(), key=lambda row: -float(row["spacing"]))
    return line, [row for row in rows if not any(row is other for other in line)]


def refused_points(all_rows: Sequence[Row], measured: Sequence[Row]) -> list[float]:
    """Return the seconds per plate that each refused or unstable row would take, from its grid's measured row."""
    timed = {(_family(row), *row["nodes"]): row for row in reversed(measured) if not row["as_written"]}
    points = []
    for row in all_rows:
        same = timed.get((_family(row), *row["nodes"]))
        if same and row["status"].partition(":")[0] in ("refused", "unstable") and row["time_step"]:
            points.append(same["seconds_per_plate"] * same["time_step"] / row["time_step"])
    return points


def _family(row: Row) -> tuple[tuple[int, str], str]:
    return (row["order"], row["load"]), row["precision"]


def _points(rows: Sequence[Row]) -> tuple[list[float], list[float]]:
    return [row["seconds_per_plate"] for row in rows], [row["error"] for row in rows]


def _plot_family(axes: Axes, rows: Sequence[Row], front: Sequence[Row]) -> None:
    """Plot one family; write the nodes beside its marks, of high order those on the front, else errors below 10 %."""
    line, others = longest_steps(rows)
    (order, load), precision = _family(rows[0])
    colour, marker, name = FAMILIES.get((order, load), (*OTHER, f"order {order}, {load}"))
    single = precision == "float32" or load == "modal"
    look = {"color": colour, "marker": marker, "markerfacecolor": colour if single else "white", "zorder": 3}
    style, label = ("-", name) if single else (":", f"{name}, float64")
    axes.plot(*_points(line), linestyle=style, linewidth=1.2, markersize=5, label=label, **look)
    if others:
        axes.plot(*_points(others), linestyle="", markersize=3, label=f"{name}, ½ and ¼ of Δt", **look)
    text = {"textcoords": "offset points", "fontsize": 6.5, "color": colour, "ha": "right", "va": "top"}
    for row in line if single and (order, load) in NUMBERED else ():
        if row in front if order > 2 else row["error"] < 0.1:
            below = (-5, -12 if load == "modal" else -5)  # [pt]; the first modes often lie beside a grid of order 4
            axes.annotate("×".join(map(str, row["nodes"])), (row["seconds_per_plate"], row["error"]), below, **text)


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
