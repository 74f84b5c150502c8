"""Picture of a sweep: lines over one key, maps over two, small maps over more, points of samples."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.sweep import REFUSED, Sweep
from warp_plate.scene.keys import label_of, unit_of
from warp_plate.scene.vary import counted
from warp_plate.viz.availability import plot_beside
from warp_plate.viz.plots.axes import number_logarithmic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

COLOURS = ("#08519c", "#b2182b", "#6baed6", "#8a8a8a", "#1b7837", "#762a83", "#d95f02", "#4d4d4d")
REFUSED_COLOUR = "#d9d9d9"
MAP_COLOURS = "viridis"
# Modes that have a line or a map of their own; small maps, of more some that lie evenly.
MOST_MODES, MOST_MAPS = 8, 20
LEVELS = 8
# Of samples, by rank, and their sizes: the first is filled, and neighbours that lie on each other are both seen.
MARKERS = (("o", 3), ("o", 6), ("x", 4), ("+", 6), ("s", 5), ("D", 7), ("^", 5), ("v", 6))
# Powers of ten that numbers on an axis have; of others the power stands once, with the unit.
PLAIN_POWERS = range(-1, 4)
# Of a map, and of a panel of points, in inches.
MAP_SIZE, SMALL_SIZE, POINTS_SIZE = (3.9, 3.0), (2.5, 2.2), (2.6, 2.4)


def draw_sweep_beside(sweep: Sweep, path: Path) -> tuple[list[Path], str | None]:
    """See :func:`plot_beside`."""

    def draw(_: Mapping[str, Any], file: Path) -> Path:
        return draw_sweep(sweep, file)

    return plot_beside(draw, {}, path)


def draw_sweep(sweep: Sweep, path: str | Path) -> Path:
    """PNG, SVG or PDF by ending. Refused points are grey.

    Over one key all outputs are lines; over two each is a map; over three or more the first output is a map over the
    two keys with most values, one for each combination of the others; of samples all outputs are points over each key.

    Raises:
        ValueError: Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(layout="constrained")
        FigureCanvasAgg(figure)
        keys = len(sweep.plan.keys)
        if sweep.plan.sampled:
            note = _draw_points(figure, sweep)
        elif keys == 1:
            note = _draw_lines(figure, sweep)
        elif keys == 2:
            note = _draw_maps(figure, sweep)
        else:
            note = _draw_small_maps(figure, sweep)
        title = f"{sweep.scene.title or sweep.source}: {note}" if note else sweep.scene.title or sweep.source
        figure.suptitle(title, fontsize=9)
        figure.savefig(path, dpi=200)
    return Path(path)


def curves(sweep: Sweep) -> dict[str, tuple[str, np.ndarray]]:
    """By its words, the unit and (points,) values of every number that the outputs have; not finite ones as NaN."""
    made = {}
    for name, one in sweep.outputs.items():
        values = sweep.values[name].reshape(len(sweep.plan), -1)
        shown = np.where(np.isfinite(values), values, np.nan).T
        for index, row in enumerate(shown[:MOST_MODES], 1):
            made[f"{one.meaning} {index}" if one.axis else one.meaning] = (one.unit, row)
    return made


def edges_of(values: np.ndarray, logarithmic: bool) -> np.ndarray:
    """(n + 1,) ends of the cells around (n,) rising or falling values, half-way between them."""
    at = np.log(values) if logarithmic else values
    if len(at) == 1:
        half = 0.5 if logarithmic else 0.5 * abs(float(at[0])) or 0.5
        ends = np.array([at[0] - half, at[0] + half])
    else:
        middle = (at[1:] + at[:-1]) / 2
        ends = np.concatenate([[2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]])
    return np.exp(ends) if logarithmic else ends


def _key(sweep: Sweep, key: str) -> tuple[str, str]:
    """In words, and its unit."""
    return label_of(sweep.scene, key), unit_of(sweep.scene, key)


def _with_unit(words: str, unit: str) -> str:
    return f"{words} [{unit}]".strip() if unit != "1" else words


def _by_unit(sweep: Sweep) -> dict[str, dict[str, np.ndarray]]:
    found: dict[str, dict[str, np.ndarray]] = {}
    for words, (unit, values) in curves(sweep).items():
        found.setdefault(unit, {})[words] = values
    return found


def _shared(words: Sequence[str]) -> tuple[str, list[str]]:
    """The first words that outputs of a unit share, for an axis, and what is left of each, for a legend."""
    if len(words) == 1:
        return words[0], list(words)
    split = [one.split() for one in words]
    columns = zip(*([word.strip(",") for word in one] for one in split), strict=False)
    count = len(list(itertools.takewhile(lambda column: len(set(column)) == 1, columns)))
    head = [word.strip(",") for word in split[0][:count]]
    while head and head[-1] in ("of", "the", "a"):
        head.pop()
    return " ".join(head), [" ".join(one[count:]) for one in split]


def _draw_lines(figure: Figure, sweep: Sweep) -> str:
    groups, (key,) = _by_unit(sweep), sweep.plan.keys
    figure.set_size_inches(6.4, 0.8 + 2.6 * len(groups))
    rows = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
    order = np.argsort(sweep.plan.coordinates[0])
    at, refused = sweep.plan.coordinates[0][order], (sweep.status == REFUSED)[order]
    for axes, (unit, lines) in zip(rows, groups.items(), strict=True):
        marker = "." if len(at) <= 30 else None
        label, names = _shared(list(lines))
        for rank, (colour, name, values) in enumerate(zip(COLOURS, names, lines.values(), strict=False)):
            # Every other line is dashed and lies on top, so that of two neighbours that are alike both are seen.
            drawn = {"color": colour, "linewidth": 2.2 if rank else 1.2, "marker": marker, "zorder": 3 - 0.1 * rank}
            if rank % 2:
                drawn |= {"linestyle": (0, (3, 2)), "linewidth": 1.6, "zorder": 3.5 - 0.1 * rank}
            axes.plot(at, values[order], label=name, **drawn)
        edges = edges_of(at, sweep.plan.logarithmic[0])
        for index in np.flatnonzero(refused):
            axes.axvspan(edges[index], edges[index + 1], color=REFUSED_COLOUR, linewidth=0, zorder=0)
        _set_axis(axes.yaxis, label, unit)
        axes.spines[["top", "right"]].set_visible(False)
        if sweep.plan.logarithmic[0]:
            axes.set_xscale("log")
        if len(lines) > 1:
            axes.legend(
                frameon=False, fontsize=8, ncols=min(len(lines), 6), loc="lower center", bbox_to_anchor=(0.5, 1)
            )
    _set_axis(rows[-1].xaxis, *_key(sweep, key), 6)
    return f"{counted(np.count_nonzero(refused), 'point')} refused (grey)" if refused.any() else ""


def _draw_maps(figure: Figure, sweep: Sweep) -> str:
    found = curves(sweep)
    columns = min(2, len(found))
    rows = math.ceil(len(found) / columns)
    figure.set_size_inches(MAP_SIZE[0] * columns, 0.3 + MAP_SIZE[1] * rows)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (words, (unit, values)) in zip(grid, found.items(), strict=False):
        field = values.reshape(sweep.plan.shape)
        drawn = _draw_map(axes, sweep, field, (0, 1), _limits(field))
        bar = figure.colorbar(drawn, ax=axes)
        bar.set_label(_with_unit("", unit))
        axes.set_title(words, fontsize=9)
    for axes in grid[len(found) :]:
        axes.set_visible(False)
    for index, axes in enumerate(grid[: len(found)]):
        if index + columns >= len(found):
            _set_axis(axes.xaxis, *_key(sweep, sweep.plan.keys[0]), 5)
            axes.tick_params(labelbottom=True)
        if index % columns == 0:
            _set_axis(axes.yaxis, *_key(sweep, sweep.plan.keys[1]))
    return "refused points are grey" if (sweep.status == REFUSED).any() else ""


def _draw_small_maps(figure: Figure, sweep: Sweep) -> str:
    plan, (words, (unit, values)) = sweep.plan, next(iter(curves(sweep).items()))
    first, second = sorted(np.argsort([-length for length in plan.shape], kind="stable")[:2].tolist())
    others = [index for index in range(len(plan.keys)) if index not in (first, second)]
    field = np.moveaxis(values.reshape(plan.shape), (first, second), (-2, -1))
    places = list(np.ndindex(*field.shape[:-2]))
    shown = [places[index] for index in np.unique(np.linspace(0, len(places) - 1, MOST_MAPS).astype(int))]
    columns = field.shape[-3] if field.shape[-3] <= 5 and len(shown) == len(places) else min(5, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure.set_size_inches(0.9 + SMALL_SIZE[0] * columns, 0.6 + SMALL_SIZE[1] * rows)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for index, (axes, place) in enumerate(zip(grid, shown, strict=False)):
        drawn = _draw_map(axes, sweep, field[place], (first, second), _limits(values))
        held = (
            f"{_with_unit(*_key(sweep, plan.keys[one]))}: {plan.coordinates[one][step]:.4g}"
            for one, step in zip(others, place, strict=True)
        )
        axes.set_title("\n".join(held), fontsize=7)
        if index % columns == 0:
            _set_axis(axes.yaxis, *_key(sweep, plan.keys[second]), size=8)
        if index + columns >= len(shown):
            _set_axis(axes.xaxis, *_key(sweep, plan.keys[first]), 4, size=8)
            axes.tick_params(labelbottom=True)
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    figure.colorbar(drawn, ax=list(grid[: len(shown)]), shrink=0.8).set_label(_with_unit(words, unit))
    some = f"{len(shown)} of {len(places)} maps; " if len(shown) < len(places) else ""
    return some + ("refused points are grey" if (sweep.status == REFUSED).any() else "") or words


def _draw_points(figure: Figure, sweep: Sweep) -> str:
    groups, plan = _by_unit(sweep), sweep.plan
    rows, columns = len(groups), len(plan.keys)
    figure.set_size_inches(0.8 + POINTS_SIZE[0] * columns, 0.9 + POINTS_SIZE[1] * rows)
    grid = figure.subplots(rows, columns, sharex="col", sharey="row", squeeze=False)
    refused = sweep.status == REFUSED
    scale = 1.0 if len(plan) <= 200 else 0.6
    for row, (unit, lines) in zip(grid, groups.items(), strict=True):
        label, names = _shared(list(lines))
        for axes, at, logarithmic in zip(row, plan.coordinates, plan.logarithmic, strict=True):
            for rank, (name, values) in enumerate(zip(names, lines.values(), strict=True)):
                marker, size = MARKERS[rank]
                drawn = {"marker": marker, "markersize": size * scale, "color": COLOURS[rank], "linestyle": ""}
                axes.plot(at, values, label=name, fillstyle="none" if rank else "full", markeredgewidth=0.8, **drawn)
            # Refused points have no height: ticks at the lower edge.
            axes.plot(at[refused], np.zeros(refused.sum()), "|", color="#8a8a8a", transform=axes.get_xaxis_transform())
            if logarithmic:
                axes.set_xscale("log")
            axes.spines[["top", "right"]].set_visible(False)
        _set_axis(row[0].yaxis, label, unit)
        if len(lines) > 1:
            row[-1].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axes, key in zip(grid[-1], plan.keys, strict=True):
        _set_axis(axes.xaxis, *_key(sweep, key), 4)
    return counted(len(plan), "sample") + (f", {refused.sum()} of them refused (ticks)" if refused.any() else "")


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Smallest and largest, apart from each other also where all are alike."""
    if not np.isfinite(values).any():
        return 0.0, 1.0
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    spare = 0.02 * max(abs(low), abs(high)) or 1.0
    return (low, high) if high - low > 1e-9 * max(abs(low), abs(high)) else (low - spare, high + spare)


def _draw_map(axes: Axes, sweep: Sweep, field: np.ndarray, keys: tuple[int, int], limits: tuple[float, float]) -> Any:
    """(values of the first key, of the second) as colours with contour lines; returns what a colour bar belongs to."""
    from matplotlib.ticker import MaxNLocator

    x, y = (sweep.plan.coordinates[index] for index in keys)
    logarithmic = [sweep.plan.logarithmic[index] for index in keys]
    axes.set_facecolor(REFUSED_COLOUR)
    corners = (edges_of(one, log) for one, log in zip((x, y), logarithmic, strict=True))
    drawn = axes.pcolormesh(*corners, field.T, cmap=MAP_COLOURS, vmin=limits[0], vmax=limits[1], rasterized=True)
    inside = field[np.isfinite(field)]
    if min(field.shape) > 1 and inside.size and np.ptp(inside) > 1e-6 * np.abs(inside).max():
        levels = MaxNLocator(LEVELS).tick_values(*limits)
        levels = levels[(levels > inside.min()) & (levels < inside.max())]
    else:
        levels = np.empty(0)
        if inside.size > 1 and np.ptp(inside) <= 1e-6 * np.abs(inside).max():
            axes.text(0.5, 0.5, f"{inside[0]:.4g} everywhere", transform=axes.transAxes, ha="center", color="white")
    if levels.size:
        lines = axes.contour(x, y, field.T, levels=levels, colors="white", linewidths=0.7)
        axes.clabel(lines, fontsize=6, fmt="%.3g")
    for log, scale in zip(logarithmic, (axes.set_xscale, axes.set_yscale), strict=True):
        if log:
            scale("log")
    return drawn


def _set_axis(axis: Axis, words: str, unit: str, most: int | None = None, size: float | None = None) -> None:
    """Its label and numbers, ``most`` of them; of small and large ones the power of ten stands with the unit."""
    if axis.get_scale() == "log":
        number_logarithmic(axis, 5 if most is None else most - 1)
    else:
        if most is not None:
            axis.axes.locator_params(axis.axis_name, nbins=most)
        power = math.floor(math.log10(np.abs(axis.get_view_interval()).max()))
        if power not in PLAIN_POWERS:
            axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.6g}")
            unit = f"$10^{{{power}}}$" + (f" {unit}" if unit != "1" else "")
    axis.set_label_text(_with_unit(words, unit), fontsize=size)

