"""Localization factors against frequency, with the resonances of the plate."""

from __future__ import annotations

from pathlib import Path

from warp_plate.result.model import BOUND_DESCRIPTIONS, Result
from warp_plate.scene.search import Search
from warp_plate.viz.plots.frame import figure, first_target_note

# Colour and line width by name in the result.
CURVES = {"best": ("#08519c", 1.6), "single": ("#6baed6", 1.1), "equal": ("#8a8a8a", 1.1)}
RESONANCE, BEST = "#b2182b", "#e6820e"


def draw_spectrum(result: Result, path: str | Path) -> Path:
    """Plot the curves over the searched range, a tick for each resonance, and the best drive as a point.

    Raises:
        ValueError: the result holds no spectrum.
    """
    spectrum, case = result.spectrum, result.main_case
    if not spectrum:
        raise ValueError("the result holds no spectrum: only a search for one frequency of all actuators makes one")
    labels = curve_labels(result.scene.search)
    with figure(path, (6.4, 3.4)) as made:
        axes = made.add_subplot()
        for name, (colour, width) in CURVES.items():
            axes.plot(spectrum["frequency"], spectrum[name], color=colour, linewidth=width, label=labels[name])
        axes.set_title(first_target_note(result.scene), fontsize=9, wrap=True)
        axes.set(ylim=(0, 1.05), xlim=spectrum["frequency"][[0, -1]])
        # Short ticks, so that many of them hide no curve.
        axes.vlines(spectrum["resonances"], 0, 0.05, color=RESONANCE, linewidth=0.9, label="natural frequency")
        if case.frequency is not None:
            point = (case.frequency[0], case.localization_factor)
            axes.plot(*point, "o", color=BEST, markersize=5, clip_on=False, label="best of the search", zorder=4)
        axes.set(xlabel="frequency [Hz]", ylabel="localization factor")
        made.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    return Path(path)


def curve_labels(search: Search) -> dict[str, str]:
    """Return the labels of the curves by their names in a result.

    If the search may choose every phase, and every magnitude from zero on, the best drive at each frequency is an
    eigenvector. Otherwise that curve is only a bound, and a single actuator may not be among the allowed drives.
    """
    magnitude, phase = search.magnitude, search.phase
    if magnitude is None and phase is None:
        best = "the scene's drive"
    elif phase is None or phase.actuators is not None or not _any_magnitude(search):
        best = BOUND_DESCRIPTIONS["attained within limits"]
    else:
        best = "best drive at each frequency"
    single = "best single actuator" if _any_magnitude(search) else "best single actuator (cannot be chosen)"
    return {"best": best, "single": single, "equal": "equal drive"}


def _any_magnitude(search: Search) -> bool:
    """Return whether the magnitudes of all actuators may be chosen independently, down to zero."""
    magnitude = search.magnitude
    return not (
        magnitude is None or magnitude.actuators is not None or magnitude.range[0] > 0 or search.limits.equal_magnitudes
    )
