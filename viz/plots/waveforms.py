"""Plots of waveforms that focus, with the plate at that moment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.viz.annotations import GRID, INK, length_unit, point_text, shortened
from warp_plate.viz.fields import (
    DEFAULT_COLOURS,
    FIELDS,
    ColourOptions,
    DrawingScale,
    colour_map,
    drawing_scale,
    short_number,
    unit_with_prefix,
)
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.frequency_response import CURVE_COLOURS
from warp_plate.viz.plots.plan import draw_edges, draw_outline, drawn_size, light_rim

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LENGTH = 2.0  # longer side of a plate [inch]
# Most waveforms that are drawn; periods of a burst, or of the highest frequency of a pulse, whose waves can be seen.
MOST_WAVEFORMS, BURST_PERIODS, PULSE_PERIODS = 8, 16, 50


def draw_focus(result: FocusResult, path: str | Path, colours: ColourOptions = DEFAULT_COLOURS) -> None:
    """Draw a row of panels for each method, of the waveforms for the first focus; by default each plate has its own
    limits."""
    table, height = result.scene.focus, max(drawn_size(result.scene, LENGTH)[1], 1.4) + 0.65
    assert table is not None
    fields = [method.fields[0] for method in result.methods.values()]
    with figure(path, (9.0, len(result.methods) * height + 0.7), font_size=8) as fig:
        rows = fig.subplots(len(result.methods), 3, squeeze=False, width_ratios=[1, 1.3, 1.3])
        for row, field, (name, method) in zip(rows, fields, result.methods.items(), strict=True):
            shown = fields if colours.limits == "common" else [field]
            scale = drawing_scale(shown, result.scene.plate.size, FIELDS[table.quantity], colours=colours)
            _draw_plate(row[0], result, field, scale)
            area = f"{short_number(1e6 * method.focus_area[0])} mm² at −6 dB"
            row[0].set_title(
                f"{name.replace('_', ' ')}: {area}\ncolours to ±{scale.clim[1]:.4g} {scale.unit}", fontsize=8
            )
            _draw_waveforms(row[1], result, method)
            _draw_foci(row[2], result, method)
        rows[0][1].set_title("waveforms of the actuators", fontsize=8)
        rows[0][2].set_title("motion at the points", fontsize=8)
        rows[-1][1].set_xlabel("time [ms]")
        rows[-1][2].set_xlabel("time [ms]")
        fig.legend(*rows[0][2].get_legend_handles_labels(), loc="outside lower right", ncols=4, fontsize=8)
        fig.suptitle(result.scene.title or "focus", fontsize=10)


def _draw_plate(axes: Axes, result: FocusResult, field: np.ndarray, scale: DrawingScale) -> None:
    (width, height), table = result.scene.plate.size, result.scene.focus
    assert table is not None
    (low, high), cmap = scale.clim, colour_map(scale.cmap)
    look = {"origin": "lower", "extent": (0.0, width, 0.0, height), "interpolation": "bilinear"}
    axes.imshow(field * scale.unit_factor, cmap=cmap, vmin=low, vmax=high, **look)
    for actuator in result.scene.actuators:
        draw_outline(axes, actuator.area, INK)
    axes.plot(*table.points[0], "+", color="black", markersize=7, path_effects=light_rim(1.0))
    draw_edges(axes, result.scene)


def _draw_waveforms(axes: Axes, result: FocusResult, method: FocusedWaveforms) -> None:
    """Draw waveforms in strips of their own, all in one scale: around the moment of a burst, before that of a pulse."""
    waveforms, table = method.waveforms[0], result.scene.focus
    assert table is not None
    largest = np.abs(waveforms).max() or 1.0
    times = 1e3 * np.arange(waveforms.shape[1]) / table.rate
    chosen = np.unique(np.linspace(0, len(waveforms) - 1, MOST_WAVEFORMS).round().astype(int))
    for place, index in enumerate(chosen):
        axes.plot(times, place + 0.45 * waveforms[index] / largest, color=INK, linewidth=0.5)
    axes.set_yticks(range(len(chosen)), [shortened(result.scene.actuators[index].name) for index in chosen], fontsize=7)
    if result.wished is not None:
        first, last = 0.0, times[-1]
    elif table.burst is not None:
        first, last = (1e3 * (table.time + side * BURST_PERIODS / 2 / table.burst.frequency) for side in (-1, 1))
    else:
        first, last = 1e3 * (table.time - PULSE_PERIODS / table.highest), times[-1]
    axes.set(xlim=(max(0.0, first), min(last, times[-1])))
    axes.text(1, 1.01, f"±{largest:.3g} {result.scene.drive_unit}", transform=axes.transAxes, ha="right", fontsize=7)


def _draw_foci(axes: Axes, result: FocusResult, method: FocusedWaveforms) -> None:
    table, size = result.scene.focus, result.scene.plate.size
    assert table is not None
    unit, factor = unit_with_prefix(float(np.abs(method.responses[0]).max()) or 1.0, result.unit)
    for index, (motion, point) in enumerate(zip(method.responses[0], table.points, strict=True)):
        label = f"({point_text(point, size)}) {length_unit(size)[0]}"
        look = {"color": CURVE_COLOURS[index % len(CURVE_COLOURS)], "linewidth": 0.7, "zorder": 3 - min(index, 1)}
        axes.plot(1e3 * result.times, factor * motion, label=label, **look)
    if result.wished is not None:
        wish, motion = result.wished[0], method.responses[0, 0, : result.wished.shape[1]]
        nearest = factor * wish * (motion @ wish) / (wish @ wish)
        axes.plot(1e3 * result.times[: wish.size], nearest, "--", color=INK, linewidth=0.5, label="wish", zorder=4)
    axes.set(xlim=(0, 1e3 * result.times[-1]), ylabel=f"{table.quantity} [{unit}]")
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
