"""Work-precision plot: the error of a plate against the seconds that it takes, a mark for each configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.viz.availability import plot_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colour, marker and name of each family, by order and load; float64 has open marks and a broken line.
FAMILIES = {
    (2, "nodes"): ("#7f7f7f", "s", "order 2, node masks"),
    (2, "overlap"): ("#d95f02", "o", "order 2, overlap"),
    (4, "moments"): ("#08519c", "D", "order 4, moments"),
}
OTHER = ("#762a83", "v")
# The families whose grids are written beside the marks, by order.
LOADS = {2: "overlap", 4: "moments"}
FRONT_COLOUR, TOLERANCE_COLOUR, REFUSED_COLOUR = "#a6d9a0", "#b0b0b0", "#b2182b"
TOLERANCES = (0.1, 0.03, 0.01, 0.003, 0.001)
# The rail of what is refused lies above the largest error by this factor.
RAIL = 2.2

Row = Mapping[str, Any]


def draw_accuracy_beside(record: Mapping[str, Any], path: Path) -> tuple[list[Path], str | None]:
    """See :func:`plot_beside`."""
    return plot_beside(draw_accuracy, record, path)


def draw_accuracy(record: Mapping[str, Any], path: str | Path) -> Path:
    """Plot the object that ``warp-plate accuracy --json`` prints; PNG, SVG or PDF by ending.

    Raises:
        ValueError: nothing was measured, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    rows = [row for row in record["rows"] if row["status"] == "ok" and row["error"]]
    if not rows:
        raise ValueError("nothing was measured")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(7.0, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        axes.set_xscale("log")
        axes.set_yscale("log")
        _plot_front(axes, [record["rows"][index] for index in record["front"]])
        for (order, load), precision in families(rows):
            _plot_family(axes, rows, order, load, precision)
        _write_sizes(axes, rows, [record["rows"][index] for index in record["front"]])
        _plot_as_written(axes, rows)
        _plot_refused(axes, record["rows"], rows)
        _label(axes, record, rows)
        figure.legend(
            *axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8
        )
        figure.savefig(path, dpi=200)
    return Path(path)


def families(rows: Sequence[Row]) -> list[tuple[tuple[int, str], str]]:
    """((order, load), precision) of what was measured, in the order of FAMILIES."""
    known = list(FAMILIES)
    found = {((row["order"], row["load"]), row["precision"]) for row in rows if not row["as_written"]}
    return sorted(found, key=lambda one: (known.index(one[0]) if one[0] in known else len(known), one))


def longest_steps(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Of rows that differ in grid and step: those with each grid's longest step, from coarse to fine; the others."""
    longest: dict[tuple[int, ...], Row] = {}
    for row in sorted(rows, key=lambda row: -float(row["time_step"])):
        longest.setdefault(tuple(row["nodes"]), row)
    line = sorted(longest.values(), key=lambda row: -float(row["spacing"]))
    return line, [row for row in rows if not any(row is other for other in line)]


def refused_points(all_rows: Sequence[Row], measured: Sequence[Row]) -> list[float]:
    """Seconds that each refused or unstable row would take a plate, by its grid's measured rows."""
    points = []
    for row in all_rows:
        if row["status"].partition(":")[0] not in ("refused", "unstable") or not row["time_step"]:
            continue
        keys = ("order", "load", "precision")
        like = [one for one in measured if tuple(one["nodes"]) == tuple(row["nodes"]) and not one["as_written"]]
        like = [one for one in like if all(one[key] == row[key] for key in keys)]
        points += [one["seconds_per_plate"] * one["time_step"] / row["time_step"] for one in like[:1]]
    return points


def _plot_front(axes: Axes, front: Sequence[Row]) -> None:
    axes.plot(
        [row["seconds_per_plate"] for row in front],
        [row["error"] for row in front],
        drawstyle="steps-post",
        color=FRONT_COLOUR,
        linewidth=4.5,
        solid_capstyle="round",
        zorder=1,
        label="best for its time",
    )


def _plot_family(axes: Axes, rows: Sequence[Row], order: int, load: str, precision: str) -> None:
    mine = [
        row
        for row in rows
        if (row["order"], row["load"], row["precision"]) == (order, load, precision) and not row["as_written"]
    ]
    colour, marker, name = FAMILIES.get((order, load), (*OTHER, f"order {order}, {load}"))
    single = precision == "float32"
    looks = {"color": colour, "marker": marker, "markerfacecolor": colour if single else "white", "zorder": 3}
    line, others = longest_steps(mine)
    axes.plot(
        [row["seconds_per_plate"] for row in line],
        [row["error"] for row in line],
        linestyle="-" if single else ":",
        linewidth=1.2,
        markersize=5,
        label=name if single else f"{name}, float64",
        **looks,
    )
    if others:
        seconds, errors = ([row[key] for row in others] for key in ("seconds_per_plate", "error"))
        axes.plot(seconds, errors, linestyle="", markersize=3, label=f"{name}, ½ and ¼ of Δt", **looks)


def _write_sizes(axes: Axes, rows: Sequence[Row], front: Sequence[Row]) -> None:
    """Nodes beside the marks of fourth order on the front and of second order below a tenth, in float32."""
    for row in rows:
        order = row["order"]
        plain = row["precision"] == "float32" and not row["as_written"] and row["load"] == LOADS.get(order)
        longest = plain and any(row is one for one in longest_steps([r for r in rows if _alike(r, row)])[0])
        shown = row in front if order == 4 else row["error"] < 0.1
        if longest and shown:
            axes.annotate(
                "×".join(map(str, row["nodes"])),
                (row["seconds_per_plate"], row["error"]),
                (-5, -5),
                textcoords="offset points",
                fontsize=6.5,
                color=FAMILIES[order, row["load"]][0],
                ha="right",
                va="top",
            )


def _alike(one: Row, other: Row) -> bool:
    """Whether they are of one family."""
    return all(one[key] == other[key] for key in ("order", "load", "precision", "as_written"))


def _plot_as_written(axes: Axes, rows: Sequence[Row]) -> None:
    for row in rows:
        if row["as_written"]:
            axes.plot(
                row["seconds_per_plate"],
                row["error"],
                linestyle="",
                marker="*",
                markersize=13,
                color="#111111",
                markeredgecolor="white",
                zorder=4,
                label="the scene as written",
            )


def _plot_refused(axes: Axes, all_rows: Sequence[Row], rows: Sequence[Row]) -> None:
    height = RAIL * max(row["error"] for row in rows)
    points = refused_points(all_rows, rows)
    if points:
        axes.axhline(height, color=REFUSED_COLOUR, linewidth=0.6, alpha=0.4)
        looks = {"marker": "x", "color": REFUSED_COLOUR, "markersize": 6, "zorder": 4}
        axes.plot(points, [height] * len(points), linestyle="", label="refused: Δt above the limit", **looks)


def _label(axes: Axes, record: Mapping[str, Any], rows: Sequence[Row]) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    smallest = min(row["error"] for row in rows)
    for tolerance in TOLERANCES:
        if tolerance > smallest:
            axes.axhline(tolerance, color=TOLERANCE_COLOUR, linewidth=0.5, zorder=0)
            axes.annotate(f"{100 * tolerance:g} %", (1, tolerance), (3, 0), xycoords=("axes fraction", "data"),
                          textcoords="offset points", fontsize=7, color="#808080", va="center")  # fmt: skip
    uncertainty = record["reference"]["uncertainty"]
    if uncertainty > smallest / 3:
        axes.axhspan(smallest / 3, uncertainty, color="#eeeeee", zorder=0, label="not known by the reference")
    axes.set_xlabel("seconds a plate")
    axes.set_ylabel("relative error of localization factors")
    axes.xaxis.set_major_locator(LogLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.spines[["top", "right"]].set_visible(False)
