"""Plot of a comparison: what each method had found against evaluations and against seconds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.vary import counted
from warp_plate.viz.availability import plot_beside
from warp_plate.viz.plots.axes import number_logarithmic

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from matplotlib.axes import Axes

    from warp_plate.result.comparison import Comparison, Trial

COLOURS = {
    "pso": "#4d4d4d",
    "constriction": "#d95f02",
    "ring": "#1b7837",
    "cma": "#762a83",
    "gradient": "#08519c",
    "exact": "#b2182b",
}
BOUND_COLOUR = "#111111"
BOUND_DESCRIPTIONS = {"attained": "bound: no method can pass", "bound only": "bound only: may not be reached"}
# The smallest distance from the bound that is drawn: what is below is rounding.
NEAREST = 1e-12


def draw_comparison_beside(comparison: Comparison, path: Path) -> tuple[list[Path], str | None]:
    """See :func:`plot_beside`."""

    def draw(_: Mapping[str, Any], file: Path) -> Path:
        return draw_comparison(comparison, file)

    return plot_beside(draw, {}, path)


def draw_comparison(comparison: Comparison, path: str | Path) -> Path:
    """PNG, SVG or PDF by ending. Lines are medians over the seeds, bands go from the worst to the best seed.

    Where a bound is known, the lower row shows the distance from it.

    Raises:
        ValueError: Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = 1 if comparison.bound is None else 2
    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(9.0, 0.9 + 2.7 * rows), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(rows, 2, sharex="col", sharey="row", squeeze=False)
        for column, clock in enumerate(("evaluations", "seconds")):
            _plot_values(grid[0, column], comparison, clock)
            if comparison.bound is not None:
                _plot_distances(grid[1, column], comparison, clock)
            grid[-1, column].set_xlabel(clock)
            number_logarithmic(grid[-1, column].xaxis)
        grid[0, 0].set_ylabel("largest localization factor" if comparison.localization else "smallest loss")
        if comparison.bound is not None:
            grid[1, 0].set_ylabel(f"distance from the bound (≥ {NEAREST:g})")
            number_logarithmic(grid[1, 0].yaxis)
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
        seeds = len({trial.seed for trial in comparison.trials})
        title = f"{comparison.scene.title or comparison.source}: median, best and worst of {counted(seeds, 'seed')}"
        figure.suptitle(title, fontsize=9)
        figure.savefig(path, dpi=200)
    return Path(path)


def spread(trials: Sequence[Trial], clock: str, budget: int) -> tuple[np.ndarray, np.ndarray]:
    """(iterations,) medians of a clock, "evaluations" or "seconds", and (3, iterations) smallest, median and largest
    loss so far. A trial that has ended keeps what it found; evaluations go on to the budget."""
    count = max(len(trial.loss) for trial in trials)
    times, losses = (
        np.array([np.pad(getattr(trial, name), (0, count - len(trial.loss)), mode="edge") for trial in trials], float)
        for name in (clock, "loss")
    )
    clocks = np.median(times, axis=0)
    found = np.stack([losses.min(axis=0), np.median(losses, axis=0), losses.max(axis=0)])
    if clock == "evaluations" and clocks[-1] < budget:
        clocks, found = np.append(clocks, budget), np.pad(found, ((0, 0), (0, 1)), mode="edge")
    return clocks, found


def _plot_values(axes: Axes, comparison: Comparison, clock: str) -> None:
    sign, offset = (-1, 1) if comparison.localization else (1, 0)
    for method in comparison.methods:
        points, losses = spread(comparison.trials_of(method), clock, comparison.budget)
        _plot_line(axes, method, points, offset + sign * losses)
    if comparison.bound is not None:
        axes.axhline(
            offset + sign * comparison.bound,
            color=BOUND_COLOUR,
            linewidth=1.0,
            linestyle="--",
            label=BOUND_DESCRIPTIONS[comparison.bound_kind],
        )
    axes.set_xscale("log")
    axes.spines[["top", "right"]].set_visible(False)


def _plot_distances(axes: Axes, comparison: Comparison, clock: str) -> None:
    for method in comparison.methods:
        points, losses = spread(comparison.trials_of(method), clock, comparison.budget)
        _plot_line(axes, method, points, np.maximum(losses - comparison.bound, NEAREST))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.spines[["top", "right"]].set_visible(False)


def _plot_line(axes: Axes, method: str, points: np.ndarray, values: np.ndarray) -> None:
    colour = COLOURS.get(method, "#666666")
    axes.fill_between(points, values[0], values[2], step="post", color=colour, alpha=0.13, linewidth=0)
    marker = {"marker": "D", "markevery": [0], "markersize": 4} if method == "exact" else {}
    axes.plot(points, values[1], drawstyle="steps-post", color=colour, linewidth=1.4, label=method, **marker)
