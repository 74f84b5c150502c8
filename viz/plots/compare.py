"""Plot of a comparison of search methods: best loss against evaluations and against seconds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.vary import counted
from warp_plate.viz.plots.frame import figure, number_log_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from warp_plate.result.comparison import MethodComparison, Trial

COLOURS = {"pso": "#4d4d4d", "constriction": "#d95f02", "ring": "#1b7837"}
COLOURS |= {"cma": "#762a83", "gradient": "#08519c", "exact": "#b2182b"}
BOUND_LABELS = {"attained": "bound of these searches", "bound only": "upper bound (may be out of reach)"}
SMALLEST_DISTANCE = 1e-12  # from the bound; smaller ones are rounding errors


def draw_comparison(comparison: MethodComparison, path: str | Path) -> None:
    """Plot median (lines) and worst to best seed (bands), and if a bound is known, the distances from it below."""
    rows = 1 if comparison.bound is None else 2
    with figure(path, (9.0, 0.9 + 2.7 * rows)) as made:
        grid = made.subplots(rows, 2, sharex="col", sharey="row", squeeze=False)
        for column, clock in zip(grid.T, ("evaluations", "seconds"), strict=True):
            _plot(column, comparison, clock)
            column[-1].set_xlabel(clock)
            number_log_axis(column[-1].xaxis)
        grid[0, 0].set_ylabel("largest localization factor" if comparison.localization else "smallest loss")
        if comparison.bound is not None:
            grid[1, 0].set_ylabel(f"distance from the bound (≥ $10^{{{np.log10(SMALLEST_DISTANCE):.0f}}}$)")
            number_log_axis(grid[1, 0].yaxis)
        made.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
        seeds = len({trial.seed for trial in comparison.trials})
        title = f"{comparison.scene.title or comparison.source}: median, best and worst of {counted(seeds, 'seed')}"
        made.suptitle(title, fontsize=9)


def loss_statistics(trials: Sequence[Trial], clock: str, budget: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the (iterations,) median of a clock, "evaluations" or "seconds", over trials, and their (3, iterations)
    smallest, median and largest loss so far, with the last loss of trials that have ended.
    """
    count = max(len(trial.loss) for trial in trials)
    times, losses = (
        np.array([np.pad(getattr(trial, name), (0, count - len(trial.loss)), mode="edge") for trial in trials], float)
        for name in (clock, "loss")
    )
    clocks = np.median(times, axis=0)
    statistics = np.stack([losses.min(axis=0), np.median(losses, axis=0), losses.max(axis=0)])
    if clock == "evaluations" and clocks[-1] < budget:
        clocks, statistics = np.append(clocks, budget), np.pad(statistics, ((0, 0), (0, 1)), mode="edge")
    return clocks, statistics


def _plot(column: Sequence[Axes], comparison: MethodComparison, clock: str) -> None:
    sign, offset = (-1, 1) if comparison.localization else (1, 0)
    for method in comparison.methods:
        clocks, losses = loss_statistics(comparison.trials_of(method), clock, comparison.budget)
        _plot_method(column[0], method, clocks, offset + sign * losses)
        if comparison.bound is not None:
            _plot_method(column[1], method, clocks, np.maximum(losses - comparison.bound, SMALLEST_DISTANCE))
    if comparison.bound is not None:
        bound, label = offset + sign * comparison.bound, BOUND_LABELS[comparison.bound_kind]
        column[0].axhline(bound, color="#111111", linewidth=1.0, linestyle="--", label=label)
        column[1].set_yscale("log")
    for axes in column:
        axes.set_xscale("log")


def _plot_method(axes: Axes, method: str, clocks: np.ndarray, values: np.ndarray) -> None:
    colour = COLOURS.get(method, "#666666")
    axes.fill_between(clocks, values[0], values[2], step="post", color=colour, alpha=0.13, linewidth=0)
    marker = {"marker": "D", "markevery": [0], "markersize": 4} if method == "exact" else {}
    axes.plot(clocks, values[1], drawstyle="steps-post", color=colour, linewidth=1.4, label=method, **marker)
