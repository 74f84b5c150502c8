"""Plot of focused waveforms: for each method the plate at the moment of the focus, the waveforms, and the foci."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.frequency_response import COLOURS
from warp_plate.viz.plots.plan import draw_edges, draw_outline, drawn_size
from warp_plate.viz.styles import GRID, TARGET

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CMAP, LENGTH = "RdBu_r", 2.0


def draw_focus(found: FocusResult, path: str | Path) -> None:
    """Draw a row of panels for each method, of the waveforms for the first focus."""
    height = max(drawn_size(found.scene, LENGTH)[1], 1.4) + 0.5
    with figure(path, (9.0, len(found.methods) * height + 0.5), font_size=8) as made:
        rows = made.subplots(len(found.methods), 3, squeeze=False, width_ratios=[1, 1.3, 1.3])
        for (plate, waveforms, foci), (name, method) in zip(rows, found.methods.items(), strict=True):
            _draw_plate(plate, found, method)
            plate.set_title(f"{name.replace('_', ' ')}, −6 dB: {1e6 * method.focus_area[0]:.3g} mm²", fontsize=8)
            _draw_waveforms(waveforms, found, method)
            _draw_foci(foci, found, method)
        rows[-1][1].set_xlabel("time [ms]")
        rows[-1][2].set_xlabel("time [ms]")
        made.suptitle(found.scene.title or "focus", fontsize=10)


def _draw_plate(axes: Axes, found: FocusResult, method: FocusedWaveforms) -> None:
    (width, height), values, table = found.scene.plate.size, method.fields[0], found.scene.focus
    assert table is not None
    largest = np.abs(values).max() or 1.0
    extent = (0.0, width, 0.0, height)
    axes.imshow(values, origin="lower", extent=extent, cmap=CMAP, vmin=-largest, vmax=largest, interpolation="none")
    for actuator in found.scene.actuators:
        draw_outline(axes, actuator.area, TARGET)
    axes.plot(*table.points[0], "+", color="black", markersize=5)
    draw_edges(axes, found.scene)


def _draw_waveforms(axes: Axes, found: FocusResult, method: FocusedWaveforms) -> None:
    """Draw each actuator's waveform in a strip of its own, all in one scale."""
    waveforms, table = method.waveforms[0], found.scene.focus
    assert table is not None
    largest = np.abs(waveforms).max() or 1.0
    times = 1e3 * np.arange(table.samples) / table.rate
    for index, waveform in enumerate(waveforms):
        axes.plot(times, index + 0.5 * waveform / largest, color="black", linewidth=0.4, rasterized=True)
    axes.set(xlim=(0, 1e3 * found.times[-1]), ylabel=f"actuator, ±{largest:.3g} {found.scene.drive_unit}")


def _draw_foci(axes: Axes, found: FocusResult, method: FocusedWaveforms) -> None:
    table = found.scene.focus
    assert table is not None
    for index, (motion, (x, y)) in enumerate(zip(method.responses[0], table.points, strict=True)):
        colour = COLOURS[index % len(COLOURS)]
        axes.plot(
            1e3 * found.times, motion, color=colour, linewidth=0.7, label=f"{x:g},{y:g}", zorder=3 - min(index, 1)
        )
    axes.set(xlim=(0, 1e3 * found.times[-1]), ylabel=f"{table.quantity} [{found.unit}]")
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
    axes.legend(fontsize=6, loc="upper left")
