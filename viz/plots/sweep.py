"""Pictures of a sweep: lines over one key, maps over two, points over more and of samples."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.sweep import REFUSED, Sweep
from warp_plate.scene.errors import printable
from warp_plate.scene.keys import label_of, unit_of
from warp_plate.scene.vary import counted
from warp_plate.viz.fields import colour_map
from warp_plate.viz.plots.frame import add_panels, figure, label_axis, number_log_axis, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

LINE_COLOURS = ("#08519c", "#b2182b", "#6baed6", "#8a8a8a", "#1b7837", "#762a83", "#d95f02", "#4d4d4d")
REFUSED_GREY, REFUSED_TICK, CMAP = "#d9d9d9", "#8a8a8a", "viridis"
# Most modes with a line or map; contour lines; most texts of a key that are written along its axis.
MOST_MODES, CONTOURS, MOST_TEXTS = 8, 8, 8
# Values whose relative range is smaller are the same.
CONSTANT = 1e-6
# Marker and size of points by rank: the first is filled, and coinciding neighbours can both be seen.
MARKERS = (("o", 3), ("o", 6), ("x", 4), ("+", 6), ("s", 5), ("D", 7), ("^", 5), ("v", 6))


def draw_sweep(sweep: Sweep, *paths: str | Path, colormap: str | None = None) -> None:
    """Draw the outputs of a sweep, with refused points in grey.

    Over one key all outputs are lines, over two each output is a map in this colour map (default: viridis); over more,
    and for samples, all outputs are points over each key.
    """
    keys, sampled = len(sweep.plan.keys), sweep.plan.sampled
    maps = keys == 2 and not sampled
    with figure(paths, box=maps) as fig:
        if maps:
            _draw_maps(fig, sweep, colormap or CMAP)
        else:
            _draw_curves(fig, sweep, lines=keys == 1 and not sampled)
        notes = [counted(len(sweep.plan), "sample")] * sampled
        if refused := np.count_nonzero(sweep.status == REFUSED):
            notes.append(f"{counted(refused, 'point')} refused ({'grey' if maps else 'ticks'})")
        title = sweep.scene.title or sweep.source
        fig.suptitle(": ".join(filter(None, (title, "; ".join(notes)))), fontsize=9, wrap=True)


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
    if len(at) == 1:
        padded = at + (1.0 if logarithmic else abs(at[0]) or 1.0) * np.array([-1, 0, 1])
    else:
        padded = np.pad(at, 1, mode="reflect", reflect_type="odd")
    edges = (padded[1:] + padded[:-1]) / 2
    return np.exp(edges) if logarithmic else edges


def _draw_curves(figure: Figure, sweep: Sweep, lines: bool) -> None:
    """Draw a row for each unit and a column for each key."""
    groups, plan = _by_unit(sweep), sweep.plan
    rows, columns = len(groups), len(plan.keys)
    figure.set_size_inches((6.4 if lines else 0.8 + 2.6 * columns), 0.9 + 2.4 * rows)
    grid = figure.subplots(rows, columns, sharex="col", sharey="row", squeeze=False)
    refused, small = sweep.status == REFUSED, len(plan) > (30 if lines else 200)
    places = [positions(values) for values in plan.coordinates]
    if not plan.sampled:
        places = [place.ravel() for place in np.meshgrid(*places, indexing="ij")]
    for row, (unit, curves_of_unit) in zip(grid, groups.items(), strict=True):
        label, names = _common_words(list(curves_of_unit))
        for axes, x, logarithmic in zip(row, places, plan.logarithmic, strict=True):
            order = np.argsort(x)
            for rank, (name, values) in enumerate(zip(names, curves_of_unit.values(), strict=True)):
                look = _line_look(rank, small) if lines else _point_look(rank, small)
                axes.plot(x[order], values[order], label=name, color=LINE_COLOURS[rank % len(LINE_COLOURS)], **look)
            # Refused points have no value: ticks at the lower edge.
            axes.plot(
                x[refused], np.zeros(refused.sum()), "|", color=REFUSED_TICK, transform=axes.get_xaxis_transform()
            )
            axes.set_xscale("log" if logarithmic else "linear")
        _set_axis(row[0].yaxis, label, unit)
        if len(names) > 1:
            title = "mode" if all(name.isdigit() for name in names) else None
            row[-1].legend(title=title, title_fontsize=8, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for key, axes in enumerate(grid[-1]):
        _set_key_axis(axes.xaxis, sweep, key, 6 if lines else 4)


def _line_look(rank: int, small: bool) -> dict[str, Any]:
    """Return a look of which every other line is dashed and on top, so that both of two that coincide can be seen."""
    look = {"marker": None if small else ".", "linewidth": 2.2 if rank else 1.2, "zorder": 3 - 0.1 * rank}
    return look | ({"linewidth": 1.6, "zorder": 3.5 - 0.1 * rank, "linestyle": (0, (3, 2))} if rank % 2 else {})


def _point_look(rank: int, small: bool) -> dict[str, Any]:
    marker, size = MARKERS[rank]
    look = {"marker": marker, "markersize": size * (0.6 if small else 1.0), "markeredgewidth": 0.8}
    return look | {"linestyle": "", "fillstyle": "none" if rank else "full"}


def _draw_maps(figure: Figure, sweep: Sweep, cmap: str) -> None:
    maps = curves(sweep)
    columns = min(2, len(maps))
    figure.set_size_inches(3.9 * columns, 0.3 + 3.0 * math.ceil(len(maps) / columns))
    panels = add_panels(figure, len(maps), columns, sharex=True, sharey=True)
    # Maps whose labels differ only after a comma show one quantity, of several drives: their colours mean the same.
    quantities = {label: label.partition(",")[0] for label in maps}
    single = len(set(quantities.values())) == 1 < len(maps)
    drawn: dict[str, list[Any]] = {}
    for index, (axes, (label, (_, values))) in enumerate(zip(panels, maps.items(), strict=True)):
        alike = np.concatenate([maps[other][1] for other in maps if quantities[other] == quantities[label]])
        mesh = _draw_map(axes, sweep, values.reshape(sweep.plan.shape), alike, cmap)
        drawn.setdefault(quantities[label], []).append((mesh, axes, label))
        axes.set_title(label.partition(", ")[2] if single else label, fontsize=9)
        if index + columns >= len(panels):
            _set_key_axis(axes.xaxis, sweep, 0, 5)
            axes.tick_params(labelbottom=True)
        if index % columns == 0:
            _set_key_axis(axes.yaxis, sweep, 1)
    for quantity, meshes in drawn.items():
        bar = figure.colorbar(meshes[0][0], ax=[axes for _, axes, _ in meshes], aspect=20 * math.ceil(len(meshes) / 2))
        bar.set_label(with_unit(quantity if len(meshes) > 1 else "", maps[meshes[0][2]][0]))


def _draw_map(axes: Axes, sweep: Sweep, field: np.ndarray, values: np.ndarray, cmap: str) -> Any:
    """Draw (first key, second key) values as colours, within the range of all values, with contour lines."""
    from matplotlib.patheffects import Normal, Stroke
    from matplotlib.ticker import MaxNLocator

    rim = [Stroke(linewidth=1.3, foreground="#00000090"), Normal()]
    x, y = map(positions, sweep.plan.coordinates)
    log_x, log_y = sweep.plan.logarithmic
    axes.set(facecolor=REFUSED_GREY, xscale="log" if log_x else "linear", yscale="log" if log_y else "linear")
    low, high = (np.nanmin(values), np.nanmax(values)) if np.isfinite(values).any() else (0.0, 1.0)
    if high - low <= CONSTANT * max(abs(low), abs(high)):  # Matplotlib itself widens limits that coincide
        high = low
    edges = cell_edges(x, log_x), cell_edges(y, log_y)
    mesh = axes.pcolormesh(*edges, field.T, cmap=colour_map(cmap), vmin=low, vmax=high, rasterized=True)
    if np.isfinite(field).all() and np.ptp(field) <= CONSTANT * np.abs(field).max():
        text = f"{field.flat[0]:.3g} everywhere"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="white", path_effects=rim)
    numbers = all(values.dtype.kind == "f" for values in sweep.plan.coordinates)
    if low < high and min(field.shape) > 1 and numbers and np.isfinite(field).any():
        levels = MaxNLocator(CONTOURS).tick_values(low, high)
        levels = levels[(levels > np.nanmin(field)) & (levels < np.nanmax(field))]
        if levels.size:
            lines = axes.contour(x, y, field.T, levels=levels, colors="white", linewidths=0.7)
            for text in axes.clabel(lines, fontsize=6.5, fmt="%.3g"):
                text.set_path_effects(rim)
    return mesh


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


def _set_key_axis(axis: Axis, sweep: Sweep, key: int, most: int | None = None) -> None:
    """Set label and tick labels of a varied key; those of texts are the texts, if there are few."""
    name, values = sweep.plan.keys[key], sweep.plan.coordinates[key]
    _set_axis(axis, label_of(sweep.scene, name), unit_of(sweep.scene, name), most)
    if values.dtype.kind != "f":
        texts = [printable(str(text)) for text in dict.fromkeys(values.tolist())]
        shown = texts if len(texts) <= MOST_TEXTS else []
        axis.set_ticks(range(len(shown)), shown)


def _set_axis(axis: Axis, label: str, unit: str, most: int | None = None) -> None:
    """Set label and at most ``most`` tick labels."""
    if axis.get_scale() == "log":
        number_log_axis(axis, 5 if most is None else most - 1)
        axis.set_label_text(with_unit(label, unit))
        return
    if most is not None:
        axis.axes.locator_params(axis.axis_name, nbins=most)
    label_axis(axis, label, unit)
