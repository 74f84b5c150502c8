"""Distributions of the robust and the nominal drive over the same validation panels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.model import Result
from warp_plate.result.robust import DRIVES, TAIL, RobustComparison, mean_of_worst
from warp_plate.viz.plots.frame import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"robust": "#08519c", "nominal": "#d94801"}
BINS = 24


def draw_robust(result: Result, path: str | Path) -> Path:
    """Plot histograms and cumulative distributions of both drives, with the median and the worst 5 %.

    Raises:
        ValueError: the result holds no comparison, or all plates failed.
    """
    compared = result.robust
    if compared is None or not np.isfinite(compared.validation).any():
        raise ValueError("the result compares no robust drive with a nominal one")
    with figure(path, (5.4, 4.6), dpi=320) as made:
        above, below = made.subplots(2, 1, sharex=True, height_ratios=[1, 1.5])
        _plot_histograms(above, compared)
        _plot_cumulative(below, compared)
        made.suptitle(result.scene.title or result.source, fontsize=9)
    return Path(path)


def _plot_histograms(axes: Axes, compared: RobustComparison) -> None:
    finite = compared.validation[np.isfinite(compared.validation)]
    edges = np.histogram_bin_edges(finite, BINS)
    for name, values in zip(DRIVES, compared.validation, strict=True):
        shown = values[np.isfinite(values)]
        axes.hist(shown, edges, color=COLOURS[name], alpha=0.35)
        axes.hist(shown, edges, color=COLOURS[name], histtype="step", linewidth=1.2, label=f"{name} drive")
        if shown.size:
            axes.axvline(shown.mean(), color=COLOURS[name], linewidth=1.0, linestyle="--")
    axes.set_ylabel(f"of {compared.validation.shape[1]} validation panels")
    axes.legend(title="dashed: mean", title_fontsize=8)


def _plot_cumulative(axes: Axes, compared: RobustComparison) -> None:
    count, look = compared.validation.shape[1], {"fontsize": 7, "color": "#808080", "ha": "right"}
    fraction = np.arange(1, count + 1) / count
    for name, values, tail in zip(DRIVES, compared.validation, mean_of_worst(compared.validation), strict=True):
        colour = COLOURS[name]
        # Plates that failed count as worse than all others, so the curve starts at their share.
        ordered = np.sort(np.where(np.isfinite(values), values, -np.inf))
        finite = np.isfinite(ordered)
        axes.step(ordered[finite], fraction[finite], where="post", color=colour, linewidth=1.4)
        for level in (TAIL, 0.5):
            value = ordered[int(np.ceil(level * count)) - 1]
            if np.isfinite(value):
                axes.plot(value, level, marker="o", markersize=4, color=colour)
        if np.isfinite(tail):
            axes.axvline(tail, 0, 0.12, color=colour, linewidth=2.2, label=f"{name}, mean of worst 5 %: {tail:.4f}")
    for level, label in ((TAIL, "worst 5 %"), (0.5, "half")):
        axes.axhline(level, color="#b0b0b0", linewidth=0.6, zorder=0)
        axes.text(0.99, level + 0.01, label, transform=axes.get_yaxis_transform(), **look)
    quantity = "localization factor" if compared.localization else "weighted sum of the objectives"
    axes.set(ylim=(0, 1.02), ylabel="fraction of panels below", xlabel=quantity)
    axes.legend(fontsize=8, loc="upper left")
