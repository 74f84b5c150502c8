"""Pictures of a sweep: lines over one key, maps over two, small maps over more, points of samples."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.sweep import REFUSED, Sweep
from warp_plate.scene.errors import printable
from warp_plate.scene.keys import label_of, unit_of
from warp_plate.scene.vary import counted, value_text
from warp_plate.viz.fields import colour_map
from warp_plate.viz.plots.frame import add_panels, figure, label_axis, number_log_axis, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

LINE_COLOURS = ("#08519c", "#b2182b", "#6baed6", "#8a8a8a", "#1b7837", "#762a83", "#d95f02", "#4d4d4d")
REFUSED_GREY, CMAP = "#d9d9d9", "viridis"
# Most modes with a line or map of their own; most small maps, of which some are left out evenly; contour lines.
MOST_MODES, MOST_MAPS, CONTOURS = 8, 20, 8
# Values whose relative range is smaller are the same.
CONSTANT = 1e-6
# Most texts of a key that are written along its axis.
MOST_TEXTS = 8
# Marker and size of samples by rank: the first is filled, and coinciding neighbours can both be seen.
MARKERS = (("o", 3), ("o", 6), ("x", 4), ("+", 6), ("s", 5), ("D", 7), ("^", 5), ("v", 6))


def draw_sweep(sweep: Sweep, path: str | Path, colormap: str | None = None) -> None:
    """Draw the outputs of a sweep, with refused points in grey.

    Over one key all outputs are lines; over two each output is a map; over more the first output is a map over the two
    longest keys for each combination of the others; for samples all outputs are points over each key. The colour map is
    that of maps (default: viridis).
    """
    keys, sampled = len(sweep.plan.keys), sweep.plan.sampled
    cmap = colormap or CMAP
    draw: Callable[[Figure, Sweep], str | None] = _draw_points
    if not sampled:
        draw = _draw_lines if keys == 1 else partial(_draw_maps if keys == 2 else _draw_small_maps, cmap=cmap)
    with figure(path, box=keys > 1 and not sampled) as fig:
        notes, title = [draw(fig, sweep)], sweep.scene.title or sweep.source
        if refused := np.count_nonzero(sweep.status == REFUSED):
            notes.append(f"{counted(refused, 'point')} refused ({'ticks' if sampled else 'grey'})")
        fig.suptitle(": ".join(filter(None, (title, "; ".join(filter(None, notes))))), fontsize=9, wrap=True)


def curves(sweep: Sweep) -> dict[str, tuple[str, np.ndarray]]:
    """Return the unit and the (points,) values of every scalar output by its label; NaN where not finite."""
    scalars = {}
    for name, output in sweep.outputs.items():
        for end, values in list(sweep.columns(name).items())[:MOST_MODES]:
            scalars[output.meaning + end] = (output.unit, np.where(np.isfinite(values), values, np.nan))
    return scalars


def positions(values: np.ndarray) -> np.ndarray:
    """Return where the values of a key lie on its axis: numbers as they are, texts at 0, 1, ... in the given order."""
    if values.dtype.kind == "f":
        return values
    places = {text: place for place, text in enumerate(dict.fromkeys(values.tolist()))}
    return np.array([places[text] for text in values.tolist()], dtype=float)


def cell_edges(values: np.ndarray, logarithmic: bool) -> np.ndarray:
    """Return the (n + 1,) edges of the cells around (n,) monotonic values, halfway between them."""
    at = np.log(values) if logarithmic else values
    if len(at) > 1:
        middle = (at[1:] + at[:-1]) / 2
        edges = np.array([2 * at[0] - middle[0], *middle, 2 * at[-1] - middle[-1]])
    else:
        edges = at[0] + np.array([-1, 1]) * (0.5 if logarithmic else 0.5 * abs(at[0]) or 0.5)
    return np.exp(edges) if logarithmic else edges


def _draw_lines(figure: Figure, sweep: Sweep) -> None:
    groups, logarithmic = _by_unit(sweep), sweep.plan.logarithmic[0]
    figure.set_size_inches(6.4, 0.8 + 2.6 * len(groups))
    rows = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
    places = positions(sweep.plan.coordinates[0])
    order = np.argsort(places)
    x, refused = places[order], (sweep.status == REFUSED)[order]
    edges = cell_edges(x, logarithmic)
    for axes, (unit, lines) in zip(rows, groups.items(), strict=True):
        label, names = _common_words(list(lines))
        for rank, (name, values) in enumerate(zip(names, lines.values(), strict=True)):
            # Every other line is dashed and on top, so that both of two coinciding neighbours can be seen.
            dashed = {"linewidth": 1.6, "zorder": 3.5 - 0.1 * rank, "linestyle": (0, (3, 2))}
            style = dashed if rank % 2 else {"linewidth": 2.2 if rank else 1.2, "zorder": 3 - 0.1 * rank}
            colour, marker = LINE_COLOURS[rank % len(LINE_COLOURS)], "." if len(x) <= 30 else None
            axes.plot(x, values[order], label=name, color=colour, marker=marker, **style)
        for index in np.flatnonzero(refused):
            axes.axvspan(edges[index], edges[index + 1], color=REFUSED_GREY, linewidth=0, zorder=0)
        _set_axis(axes.yaxis, label, unit)
        axes.set_xscale("log" if logarithmic else "linear")
        if len(lines) > 1:
            axes.legend(fontsize=8, ncols=min(len(lines), 6), loc="lower center", bbox_to_anchor=(0.5, 1))
    _set_key_axis(rows[-1].xaxis, sweep, 0, 6)


def _draw_maps(figure: Figure, sweep: Sweep, cmap: str) -> None:
    maps = curves(sweep)
    columns = min(2, len(maps))
    figure.set_size_inches(3.9 * columns, 0.3 + 3.0 * math.ceil(len(maps) / columns))
    panels = add_panels(figure, len(maps), columns, sharex=True, sharey=True)
    # Maps whose labels differ only after a comma show one quantity, of several drives: their colours mean the same.
    quantities = {label: label.partition(",")[0] for label in maps}
    drawn: dict[str, list[Any]] = {}
    for axes, (label, (_, values)) in zip(panels, maps.items(), strict=True):
        alike = np.concatenate([maps[other][1] for other in maps if quantities[other] == quantities[label]])
        mesh = _draw_map(axes, sweep, values.reshape(sweep.plan.shape), (0, 1), alike, cmap)
        drawn.setdefault(quantities[label], []).append((mesh, axes, label))
        axes.set_title(
            label.partition(", ")[2] if len(set(quantities.values())) == 1 < len(maps) else label, fontsize=9
        )
    for quantity, meshes in drawn.items():
        bar = figure.colorbar(meshes[0][0], ax=[axes for _, axes, _ in meshes], aspect=20 * math.ceil(len(meshes) / 2))
        bar.set_label(with_unit(quantity if len(meshes) > 1 else "", maps[meshes[0][2]][0]))
    _label_maps(panels, sweep, columns, (0, 1), 5)


def _draw_small_maps(figure: Figure, sweep: Sweep, cmap: str) -> str:
    plan, (label, (unit, values)) = sweep.plan, next(iter(curves(sweep).items()))
    first, second = sorted(np.argsort([-length for length in plan.shape], kind="stable")[:2].tolist())
    others = [index for index in range(len(plan.keys)) if index not in (first, second)]
    field = np.moveaxis(values.reshape(plan.shape), (first, second), (-2, -1))
    places = list(np.ndindex(*field.shape[:-2]))
    shown = [places[index] for index in np.unique(np.linspace(0, len(places) - 1, MOST_MAPS).astype(int))]
    columns = field.shape[-3] if field.shape[-3] <= 5 and len(shown) == len(places) else min(5, len(shown))
    figure.set_size_inches(0.9 + 2.5 * columns, 0.6 + 2.2 * math.ceil(len(shown) / columns))
    panels = add_panels(figure, len(shown), columns, sharex=True, sharey=True)
    for axes, place in zip(panels, shown, strict=True):
        mesh = _draw_map(axes, sweep, field[place], (first, second), values, cmap)
        names = [f"{with_unit(*_label_and_unit(sweep, key))}: " for key in others]
        held = (value_text(plan.coordinates[key][step]) for key, step in zip(others, place, strict=True))
        axes.set_title("\n".join(map(str.__add__, names, held)), fontsize=7)
    _label_maps(panels, sweep, columns, (first, second), 4, size=8)
    figure.colorbar(mesh, ax=panels, shrink=0.8).set_label(with_unit(label, unit))
    return f"{len(shown)} of {len(places)} maps" if len(shown) < len(places) else ""


def _draw_points(figure: Figure, sweep: Sweep) -> str:
    groups, plan = _by_unit(sweep), sweep.plan
    rows, columns = len(groups), len(plan.keys)
    figure.set_size_inches(0.8 + 2.6 * columns, 0.9 + 2.4 * rows)
    grid = figure.subplots(rows, columns, sharex="col", sharey="row", squeeze=False)
    refused = sweep.status == REFUSED
    shrink = 1.0 if len(plan) <= 200 else 0.6
    for row, (unit, lines) in zip(grid, groups.items(), strict=True):
        label, names = _common_words(list(lines))
        for axes, x, logarithmic in zip(row, map(positions, plan.coordinates), plan.logarithmic, strict=True):
            for rank, (name, values) in enumerate(zip(names, lines.values(), strict=True)):
                marker, size = MARKERS[rank]
                style = {"marker": marker, "markersize": size * shrink, "color": LINE_COLOURS[rank], "linestyle": ""}
                axes.plot(x, values, label=name, fillstyle="none" if rank else "full", markeredgewidth=0.8, **style)
            # Refused points have no value: ticks at the lower edge.
            axes.plot(x[refused], np.zeros(refused.sum()), "|", color="#8a8a8a", transform=axes.get_xaxis_transform())
            axes.set_xscale("log" if logarithmic else "linear")
        _set_axis(row[0].yaxis, label, unit)
        if len(lines) > 1:
            row[-1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for key, axes in enumerate(grid[-1]):
        _set_key_axis(axes.xaxis, sweep, key, 4)
    return counted(len(plan), "sample")


def _label_maps(
    panels: Sequence[Axes], sweep: Sweep, columns: int, keys: tuple[int, int], most: int, size: float | None = None
) -> None:
    """Label drawn maps along their left and lower side, with at most ``most`` numbers along x."""
    for index, axes in enumerate(panels):
        if index + columns >= len(panels):
            _set_key_axis(axes.xaxis, sweep, keys[0], most, size)
            axes.tick_params(labelbottom=True)
        if index % columns == 0:
            _set_key_axis(axes.yaxis, sweep, keys[1], size=size)


def _draw_map(axes: Axes, sweep: Sweep, field: np.ndarray, keys: tuple[int, int], values: np.ndarray, cmap: str) -> Any:
    """Draw (first key, second key) values as colours, within the range of all values, with contour lines."""
    from matplotlib.patheffects import Normal, Stroke
    from matplotlib.ticker import MaxNLocator

    x, y = (positions(sweep.plan.coordinates[key]) for key in keys)
    log_x, log_y = (sweep.plan.logarithmic[key] for key in keys)
    axes.set(facecolor=REFUSED_GREY, xscale="log" if log_x else "linear", yscale="log" if log_y else "linear")
    edges = cell_edges(x, log_x), cell_edges(y, log_y)
    limits = (np.nanmin(values), np.nanmax(values)) if np.isfinite(values).any() else (0.0, 1.0)
    if limits[1] - limits[0] <= CONSTANT * max(map(abs, limits)):  # Matplotlib itself widens limits that coincide
        limits = (limits[0], limits[0])
    mesh = axes.pcolormesh(*edges, field.T, cmap=colour_map(cmap), vmin=limits[0], vmax=limits[1], rasterized=True)
    finite = field[np.isfinite(field)]
    constant = not finite.size or np.ptp(finite) <= CONSTANT * np.abs(finite).max()
    if constant and finite.size > 1:
        axes.text(0.5, 0.5, f"{finite[0]:.4g} everywhere", transform=axes.transAxes, ha="center", color="white")
    if not constant and min(field.shape) > 1 and all(sweep.plan.coordinates[key].dtype.kind == "f" for key in keys):
        levels = MaxNLocator(CONTOURS).tick_values(*limits)
        levels = levels[(levels > finite.min()) & (levels < finite.max())]
        if levels.size:
            lines = axes.contour(x, y, field.T, levels=levels, colors="white", linewidths=0.7)
            rim = [Stroke(linewidth=1.3, foreground="#00000090"), Normal()]
            for text in axes.clabel(lines, fontsize=6.5, fmt="%.3g"):
                text.set_path_effects(rim)
    return mesh


def _label_and_unit(sweep: Sweep, key: int) -> tuple[str, str]:
    name = sweep.plan.keys[key]
    return label_of(sweep.scene, name), unit_of(sweep.scene, name)


def _by_unit(sweep: Sweep) -> dict[str, dict[str, np.ndarray]]:
    groups: dict[str, dict[str, np.ndarray]] = {}
    for label, (unit, values) in curves(sweep).items():
        groups.setdefault(unit, {})[label] = values
    return groups


def _common_words(labels: Sequence[str]) -> tuple[str, list[str]]:
    """Split labels into their common first words, for an axis, and the remainders, for a legend."""
    if len(labels) == 1:
        return labels[0], list(labels)
    split = [label.split() for label in labels]
    columns = zip(*([word.strip(",") for word in words] for words in split), strict=False)
    common = [words[0] for words in itertools.takewhile(lambda words: len(set(words)) == 1, columns)]
    remainders = [" ".join(words[len(common) :]) for words in split]
    while common and common[-1] in ("of", "the", "a"):
        common.pop()
    return " ".join(common), remainders


def _set_key_axis(axis: Axis, sweep: Sweep, key: int, most: int | None = None, size: float | None = None) -> None:
    """Set label and tick labels of a varied key; those of texts are the texts, if there are few."""
    _set_axis(axis, *_label_and_unit(sweep, key), most, size)
    values = sweep.plan.coordinates[key]
    if values.dtype.kind != "f":
        texts = [printable(str(text)) for text in dict.fromkeys(values.tolist())]
        shown = texts if len(texts) <= MOST_TEXTS else []
        axis.set_ticks(range(len(shown)), shown)


def _set_axis(axis: Axis, label: str, unit: str, most: int | None = None, size: float | None = None) -> None:
    """Set label and at most ``most`` tick labels."""
    if axis.get_scale() == "log":
        number_log_axis(axis, 5 if most is None else most - 1)
        axis.set_label_text(with_unit(label, unit), fontsize=size)
        return
    if most is not None:
        axis.axes.locator_params(axis.axis_name, nbins=most)
    label_axis(axis, label, unit, size)
