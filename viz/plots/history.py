"""Loss of a search against its iterations: figure 3 of the source paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.model import Result
from warp_plate.viz.plots.frame import figure, first_target_note

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Label of the mean loss of an iteration by method; "exact" tries one drive only.
MEAN_LABELS = dict.fromkeys(("pso", "constriction", "ring"), "swarm mean")
MEAN_LABELS |= {"cma": "mean of the generation", "gradient": "mean of the descents"}
# Final loss of the swarm in the source paper: 1 − 0.72.
PUBLISHED_LOSS = 0.28


def draw_history(result: Result, path: str | Path) -> Path:
    """Plot 1 − localization factor, or the negative weighted sum of the objectives, against the iteration.

    With several targets the history is that of the first. A claimed bound is a line; the published final loss stands
    beside it for the preset "paper" only.

    Raises:
        ValueError: the result holds no history.
    """
    if not result.history:
        raise ValueError("the result holds no history: only a search leaves one")
    with figure(path, (5, 3.2), dpi=320) as made:
        plot_history(made.add_subplot(), result)
    return Path(path)


def plot_history(axes: Axes, result: Result) -> None:
    """Plot the history of a search into Matplotlib axes; see :func:`draw_history`."""
    from matplotlib.ticker import MaxNLocator

    localization = result.only_localization
    offset = 1 if localization else 0
    best = offset - np.fmax.accumulate(_gaps(result.history["best"]))
    iteration = np.arange(1, best.size + 1)
    marker = "." if best.size < 10 else None
    label = MEAN_LABELS.get(result.scene.search.method)
    if "mean" in result.history and label is not None:
        mean = offset - _gaps(result.history["mean"])
        axes.plot(iteration, mean, color="#9ecae1", linewidth=1.0, marker=marker, label=label)
    axes.plot(iteration, best, color="#08519c", linewidth=1.6, marker=marker, label="best so far")
    bound, kind = result.bound if localization else result.objective_values.get("bound"), result.bound_kind
    if result.scene.search.robust is not None:  # a robust search maximises a measure with a bound of its own
        bound, kind = getattr(result.robust, "bound", None), "bound only"
    if bound is not None:
        loss, words = offset - bound, "bound only" if kind == "bound only" else "bound"
        label = f"{words}: {loss:.4f}".replace("-", "−")
        axes.axhline(loss, color="#b2182b", linewidth=1.0, linestyle="--", label=label)
    if result.source == "paper":
        label = f"published: {PUBLISHED_LOSS:g}"
        axes.axhline(PUBLISHED_LOSS, color="#8a8a8a", linewidth=1.0, linestyle=":", label=label)
    axes.set_title(first_target_note(result.scene), fontsize=9, wrap=True)
    loss = "loss (1 − localization factor)" if localization else "loss (− weighted sum of objectives)"
    axes.set(xlabel="iteration", ylabel=loss, xlim=(1, best.size) if best.size > 1 else (0, 2))
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True))
    axes.legend()


def _gaps(values: np.ndarray) -> np.ndarray:
    """Replace values that are not finite by NaN: Matplotlib cannot scale an axis to infinity."""
    return np.where(np.isfinite(values), values, np.nan)
