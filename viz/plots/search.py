"""Plots of searches (history, robustness, spectrum), and of error against run time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.case import only_actuator
from warp_plate.result.model import BOUND_DESCRIPTIONS, DRIVES, TAIL, Result, mean_of_worst
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import case_label
from warp_plate.viz.plots.frame import figure, label_axis, number_log_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PUBLISHED = 0.72  # final localization factor of the swarm in the source paper
# Line styles of drives that need no search.
CASE_LINES = {
    "single": {"color": "#6baed6", "linestyle": "-."},
    "inverse_filter": {"color": "#1b7837", "linestyle": "-."},
    "time_reversal": {"color": "#d95f02", "linestyle": "-."},
    "equal": {"color": "#8a8a8a", "linestyle": "-"},
}
# Colour, line width and label of the curves of a spectrum by name in the result.
CURVES = {
    "best": ("#08519c", 1.6, BOUND_DESCRIPTIONS["attained within limits"]),
    "single": ("#6baed6", 1.1, "best single actuator"),
    "equal": ("#8a8a8a", 1.1, "equal drive"),
}
DRIVE_COLOURS = {"robust": "#08519c", "nominal": "#d94801"}
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


def draw_history(result: Result, path: str | Path) -> None:
    """Plot localization factor or weighted sum of the objectives against the iteration, for the first of several
    targets.

    Horizontal lines show the bound, drives that need no search and, for the preset "paper", the published factor.
    """
    if not result.history:
        raise ValueError("the result holds no history: only a search leaves one")
    with figure(path, (5, 3.6), dpi=320) as fig:
        plot_history(axes := fig.add_subplot(), result)
        fig.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=7)


def plot_history(axes: Axes, result: Result) -> None:
    """Plot the history of a search into Matplotlib axes; see :func:`draw_history`."""
    from matplotlib.ticker import MaxNLocator

    # Matplotlib cannot scale an axis to infinity.
    values = {name: np.where(np.isfinite(array), array, np.nan) for name, array in result.history.items()}
    best = np.fmax.accumulate(values["best"])
    iteration = np.arange(1, best.size + 1)
    marker = "." if best.size < 10 else None
    # Overlapping places have huge losses, which would dominate the mean; "exact" tries one drive only.
    if "mean" in values and result.scene.search.method != "exact" and result.scene.search.position is None:
        axes.plot(iteration, values["mean"], color="#9ecae1", linewidth=1.0, marker=marker, label="mean")
    axes.plot(iteration, best, color="#08519c", linewidth=1.8, marker=marker, label=f"best so far: {_number(best[-1])}")
    levels = _levels(result)
    for name, (level, look) in levels.items():
        axes.axhline(level, linewidth=1.0, label=f"{name}: {_number(level)}", **look)
    _write_target(axes, result.scene)
    beside = 0.0 if marker is None else 0.02 * best.size  # room for whole markers
    axes.set(xlabel="iteration", xlim=(1 - beside, best.size + beside) if best.size > 1 else (0, 2))
    _fit_limits(axes, [*best, *(level for level, _ in levels.values())])
    label_axis(axes.yaxis, "localization factor" if result.only_localization else "weighted sum of objectives", "1")
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True))


def _levels(result: Result) -> dict[str, tuple[float, dict[str, str]]]:
    """Return value and line style of the levels that a history is compared with, by their labels."""
    localization, levels = result.only_localization, {}
    bound, kind = result.bound if localization else result.objective_values.get("bound"), result.bound_kind
    if result.scene.search.robust is not None:  # a robust search maximises a measure with a bound of its own
        bound, kind = getattr(result.robust, "bound", None), "bound only"
    if bound is not None:
        levels["bound only" if kind == "bound only" else "bound"] = bound, {"color": "#b2182b", "linestyle": "--"}
    if result.source == "paper":
        levels["published"] = PUBLISHED, {"color": "#762a83", "linestyle": ":"}
    if result.scene.search.robust is None and localization:  # of other objectives they may break limits
        for name, look in CASE_LINES.items():
            case = result.cases.get(name)
            if case is not None and np.isfinite(case.localization_factor):
                label = case_label(name, result.scene, only_actuator(case, result.scene))
                levels[label] = case.localization_factor, look
    return levels


def _number(value: float) -> str:
    text = f"{value:.4f}" if 0.01 <= abs(value) < 1000 else f"{value:.4g}"
    return text.replace("-", "−")


def _fit_limits(axes: Axes, values: Sequence[float]) -> None:
    """Fit the axis to these values; a mean far below may lie outside."""
    finite = np.array(values)[np.isfinite(values)]
    if finite.size and np.ptp(finite) > 0:
        margin = 0.06 * np.ptp(finite)
        axes.set_ylim(finite.min() - margin, finite.max() + margin)


def draw_spectrum(result: Result, path: str | Path) -> None:
    """Plot localization factors against frequency, a tick for each resonance, and the best drive as a point."""
    spectrum, case = result.spectrum, result.main_case
    with figure(path, (6.4, 3.4)) as fig:
        axes = fig.add_subplot()
        for name, (colour, width, label) in CURVES.items():
            axes.plot(spectrum["frequency"], spectrum[name], color=colour, linewidth=width, label=label)
        _write_target(axes, result.scene)
        axes.set(xlabel="frequency [Hz]", ylabel="localization factor")
        axes.set(ylim=(0, None), xlim=spectrum["frequency"][[0, -1]])
        # Short ticks, so that many of them hide no curve.
        ticks = {"color": "#b2182b", "linewidth": 0.9, "transform": axes.get_xaxis_transform()}
        axes.vlines(spectrum["resonances"], 0, 0.05, **ticks)
        axes.plot([], [], "|", color=ticks["color"], markersize=7, label="natural frequency")
        if case.frequency is not None:
            point = (case.frequency[0], case.localization_factor)
            axes.plot(*point, "o", color="#e6820e", markersize=5, clip_on=False, label="best of the search", zorder=4)
        fig.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)


def draw_robust(result: Result, path: str | Path) -> None:
    """Plot cumulative distributions of the robust and the nominal drive over the validation panels."""
    compared = result.robust
    count = compared.validation.shape[1]
    fraction = np.arange(1, count + 1) / count
    with figure(path, (5.4, 3.6), dpi=320) as fig:
        axes = fig.add_subplot()
        for name, values, tail in zip(DRIVES, compared.validation, mean_of_worst(compared.validation), strict=True):
            colour = DRIVE_COLOURS[name]
            # Failed plates count as worst, so the curve starts at their share.
            ordered = np.sort(np.where(np.isfinite(values), values, -np.inf))
            finite = np.isfinite(ordered)
            dashes = "--" if name == "nominal" else "-"  # shows the other one below
            curve = {"where": "post", "color": colour, "linewidth": 1.4, "linestyle": dashes}
            axes.step(ordered[finite], fraction[finite], label=f"{name} drive", **curve)
            if np.isfinite(tail):
                label = f"{name}, mean of worst 5 %: {tail:.4f}"
                axes.axvline(tail, 0, 0.12, color=colour, linewidth=2.2, label=label)
        for level, label in ((TAIL, "worst 5 %"), (0.5, "half")):
            axes.axhline(level, color="#b0b0b0", linewidth=0.6, zorder=0)
            place = {"transform": axes.get_yaxis_transform(), "ha": "right", "color": "#808080"}
            axes.text(0.99, level + 0.01, label, fontsize=7, **place)
        quantity = "localization factor" if compared.localization else "weighted sum of the objectives"
        axes.set(ylim=(0, 1.02), ylabel=f"fraction of {count} panels below", xlabel=quantity)
        axes.legend(fontsize=8, loc="upper left")
        axes.set_title(result.scene.title or result.source, fontsize=9, wrap=True)


def _write_target(axes: Axes, scene: Scene) -> None:
    targets = scene.targets
    if len(targets) > 1:
        axes.set_title(f"search for target {targets[0].name}, the first of {len(targets)}", fontsize=9, wrap=True)


def draw_accuracy(record: Mapping[str, Any], *paths: str | Path) -> None:
    """Plot the object that ``warp-plate accuracy --json`` prints."""
    rows = [row for row in record["rows"] if row["status"] == "ok" and row["error"]]
    if not rows:
        raise ValueError("nothing was measured")
    front = [record["rows"][index] for index in record["front"]]
    with figure(paths, (7.0, 5.2)) as fig:
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
        _add_tolerances(axes, record, rows)
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


def _add_tolerances(axes: Axes, record: Mapping[str, Any], rows: Sequence[Row]) -> None:
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
