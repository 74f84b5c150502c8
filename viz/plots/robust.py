"""A robust drive and the nominal one over the same fresh scenarios: both distributions, with their quantiles."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.model import Result
from warp_plate.result.robust import DRIVES, TAIL, RobustComparison, mean_of_worst

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"robust": "#08519c", "nominal": "#d94801"}
BINS = 24


def draw_robust(result: Result, path: str | Path, form: str | None = None) -> Path:
    """Histograms above, and below the part of all scenarios in which a drive stays under a value; PNG, SVG or PDF.

    Raises:
        ValueError: the result holds no comparison, all plates failed, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    compared = result.robust
    if compared is None or not np.isfinite(compared.validation).any():
        raise ValueError("the result compares no robust drive with a nominal one")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(5.4, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.5])
        _plot_histograms(above, compared)
        _plot_parts(below, compared)
        figure.suptitle(result.scene.title or result.source, fontsize=9)
        figure.savefig(path, dpi=320, format=form)
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
    axes.set_ylabel(f"of {compared.validation.shape[1]} fresh scenarios")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, title="dashed: mean", title_fontsize=8)


def _plot_parts(axes: Axes, compared: RobustComparison) -> None:
    count = compared.validation.shape[1]
    part = np.arange(1, count + 1) / count
    for name, values, tail in zip(DRIVES, compared.validation, mean_of_worst(compared.validation), strict=True):
        # Plates that failed come first, left of everything.
        ordered = np.sort(np.where(np.isfinite(values), values, -np.inf))
        shown = np.isfinite(ordered)
        axes.step(ordered[shown], part[shown], where="post", color=COLOURS[name], linewidth=1.4)
        for at in (TAIL, 0.5):
            value = ordered[int(np.ceil(at * count)) - 1]
            if np.isfinite(value):
                axes.plot(value, at, marker="o", markersize=4, color=COLOURS[name])
        if np.isfinite(tail):
            axes.axvline(
                tail, 0, 0.12, color=COLOURS[name], linewidth=2.2, label=f"{name}, mean of worst 5 %: {tail:.4f}"
            )
    for at, label in ((TAIL, "worst 5 %"), (0.5, "half")):
        axes.axhline(at, color="#b0b0b0", linewidth=0.6, zorder=0)
        axes.annotate(label, (1, at), (-2, 2), xycoords=("axes fraction", "data"), textcoords="offset points",
                      fontsize=7, color="#808080", ha="right")  # fmt: skip
    axes.set_ylim(0, 1.02)
    axes.set_ylabel("part of scenarios below")
    axes.set_xlabel("localization factor" if compared.localization else "weighted sum of the objectives")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
