"""Plot of the sound of a plate: power and localization factor, pressure levels, directivity."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.sound import Sound
from warp_plate.viz.annotations import GRID, INK
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.responses import BOUND, CURVE_COLOURS, FACTOR, MOST_COLOURED, set_frequency_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Levels this far below the highest are not shown, and circles of the polar plot are this far apart [dB].
RANGE, STEP = 70.0, 10.0
# Lowest level of the polar plot [dB].
LOWEST = -40.0


def draw_sound(sound: Sound, path: str | Path) -> None:
    """Draw the power level above the localization factor and the levels at the points, and the directivity beside."""
    x = sound.frequencies
    with figure(path, (8.6, 5.6), font_size=9) as fig:
        grid = fig.add_gridspec(3, 2, width_ratios=[1.9, 1], height_ratios=[1.5, 1, 1.2])
        power, pressure = fig.add_subplot(grid[0, 0]), fig.add_subplot(grid[2, 0])
        factor = fig.add_subplot(grid[1, 0], sharex=power)
        pressure.sharex(power)
        power.plot(x, sound.power_level, color=FACTOR, linewidth=1.2, label="sound power")
        weighted = sound.power_level + sound.weighting
        power.plot(x, weighted, color=BOUND, linewidth=1.0, linestyle="--", label="A-weighted")
        power.set_ylabel("sound power level\n[dB re 1 pW]")
        _limit(power, [sound.power_level, weighted])
        power.legend(loc="upper left", ncols=2, fontsize=8)
        factor.plot(x, sound.localization_factor, color=FACTOR, linewidth=1.2)
        factor.set(ylabel="localization\nfactor", ylim=(0, 1))
        shown = np.argsort(-sound.pressure_levels.max(axis=1), kind="stable")[:MOST_COLOURED]
        for index in sorted(shown.tolist()):
            label = f"({sound.labels[index].replace(',', ', ').replace('-', '−')}) m"
            pressure.plot(x, sound.pressure_levels[index], color=CURVE_COLOURS[index % len(CURVE_COLOURS)],
                          linewidth=1.0, label=label)  # fmt: skip
        pressure.set_ylabel("pressure level\n[dB re 20 µPa]")
        _limit(pressure, list(sound.pressure_levels))
        pressure.legend(loc="upper left", fontsize=8)
        panels = [power, factor, pressure]
        set_frequency_axes(x, sound.natural_frequencies, panels)
        for axes in panels:
            axes.axvline(sound.drive_frequency, color=INK, linewidth=0.7, linestyle=":")
        right = sound.drive_frequency > np.sqrt(x[0] * x[-1])
        look = {"ha": "right" if right else "left", "va": "top", "fontsize": 8, "color": INK}
        text = "drive " if right else " drive"
        factor.text(sound.drive_frequency, 0.97, text, transform=factor.get_xaxis_transform(), **look)
        for axes in panels[:-1]:
            axes.tick_params(labelbottom=False)
        _draw_directivity(sound, fig.add_subplot(grid[:, 1], projection="polar"))
        fig.suptitle(sound.title or "Sound of the plate", fontsize=10, wrap=True)
        fig.align_ylabels(panels)


def _limit(axes: Axes, curves: Sequence[np.ndarray]) -> None:
    """Set the limits of an axis of levels [dB]."""
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    if values.size:
        high = float(values.max())
        axes.set_ylim(max(float(values.min()), high - RANGE) - 3, high + 12)


def _draw_directivity(sound: Sound, axes: Any) -> None:
    """Draw the directivity in both planes over the upper half-space, the normal up."""
    angles = np.radians(sound.angles)
    for levels, plane, style in zip(sound.directivity, "xy", ("-", "--"), strict=True):
        colour = FACTOR if plane == "x" else BOUND
        axes.plot(angles, np.maximum(levels, LOWEST), style, color=colour, linewidth=1.2, label=f"along {plane}")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set(thetamin=-90, thetamax=90, rlim=(LOWEST, 0))
    axes.set_rgrids(np.arange(LOWEST, 1, STEP), [f"{level:g}" for level in np.arange(LOWEST, 1, STEP)], fontsize=7)
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.5)
    axes.set_title(f"directivity at {sound.drive_frequency:.4g} Hz [dB]", fontsize=9)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.02), ncols=2, fontsize=8)
