"""Localization factors against frequency, with the plate's resonances: what a search for a frequency looked through."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.result.model import BOUND_DESCRIPTIONS, Result
from warp_plate.scene.search import Search
from warp_plate.viz.plots.axes import first_of_several

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Name in the result: colour, width.
CURVES = {"best": ("#08519c", 1.6), "single": ("#6baed6", 1.1), "equal": ("#8a8a8a", 1.1)}
RESONANCE, FOUND = "#b2182b", "#e6820e"


def draw_spectrum(result: Result, path: str | Path, form: str | None = None) -> Path:
    """The curves over the range, a tick for each resonance, and the best drive that was found as a point; PNG, SVG or
    PDF by ``form`` or ending.

    Raises:
        ValueError: the result holds no spectrum, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    if not result.spectrum:
        raise ValueError("the result holds no spectrum: only a search for one frequency of all actuators makes one")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(6.4, 3.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        _plot(axes, result)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False, fontsize=8)
        figure.savefig(path, dpi=200, format=form)
    return Path(path)


def words_of(search: Search) -> dict[str, str]:
    """What the curves show, by their names in a result.

    Where the search may choose every phase, and every magnitude from zero on, its best drive at each frequency is an
    eigenvector. Elsewhere the line is what no drive that it may choose passes, and a single actuator is none of these.
    """
    magnitude, phase, single = search.magnitude, search.phase, "best single actuator"
    if magnitude is None and phase is None:
        best = "the scene's drive"
    elif phase is None or phase.actuators is not None or not _any_size(search):
        best = BOUND_DESCRIPTIONS["attained within limits"]
    else:
        best = "best drive at each frequency"
    return {
        "best": best,
        "single": single if _any_size(search) else f"{single} (cannot be chosen)",
        "equal": "equal drive",
    }


def _any_size(search: Search) -> bool:
    """Whether the actuators may have any magnitudes beside each other's."""
    magnitude = search.magnitude
    return not (
        magnitude is None or magnitude.actuators is not None or magnitude.range[0] > 0 or search.limits.equal_magnitudes
    )


def _plot(axes: Axes, result: Result) -> None:
    spectrum, case = result.spectrum, result.main_case
    words = words_of(result.scene.search)
    for name, (colour, width) in CURVES.items():
        axes.plot(spectrum["frequency"], spectrum[name], color=colour, linewidth=width, label=words[name])
    axes.set_title(first_of_several(result.scene), fontsize=9, wrap=True)
    axes.set_ylim(0, 1.05)
    axes.set_xlim(spectrum["frequency"][0], spectrum["frequency"][-1])
    # Short, so that many of them hide no curve.
    axes.vlines(spectrum["resonances"], 0, 0.05, color=RESONANCE, linewidth=0.9, label="natural frequency")
    if case.frequency is not None:
        found = (case.frequency[0], case.localization_factor)
        axes.plot(*found, "o", color=FOUND, markersize=5, clip_on=False, label="found by the search", zorder=4)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("localization factor")
    axes.spines[["top", "right"]].set_visible(False)
