"""Plot of frequency responses: magnitude, phase, localization factor and mean square velocity against frequency."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.frequency_response import FrequencyResponse
from warp_plate.viz.captions import shortened
from warp_plate.viz.plots.frame import figure, number_log_axis
from warp_plate.viz.styles import GRID, length_unit, point_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colours of responses, which repeat; the dashes of curves that cover earlier ones to the relative distance COVERED;
# most curves in colour and in the legend: the largest ones, the others are grey.
COLOURS = ("#08519c", "#d94801", "#1b7837", "#762a83", "#8c6d31", "#c51b7d", "#4d4d4d", "#3288bd")
DASHES, COVERED = ("-", (0, (4, 4)), (0, (2, 6)), (0, (1, 7))), 0.1
MOST_COLOURED = 5
FACTOR, BOUND, MARK = "#08519c", "#b2182b", "#b2182b"
# Decades of an axis of squares, twice those of magnitudes; undamped responses have no upper limit.
MOST_DECADES = 8.0
# Factor between the ends of a range from which its axis is logarithmic.
LOGARITHMIC = 4.0


def draw_frequency_response(response: FrequencyResponse, path: str | Path) -> None:
    """Draw the responses of all pairs, with ticks at natural frequencies, above what goes with their drives."""
    x = response.frequencies
    with figure(path, (7.2, 8.0), font_size=9) as made:
        magnitude, phase, localization, velocity = made.subplots(4, 1, sharex=True, height_ratios=[2.2, 1, 1.2, 1.4])
        extent = np.abs(np.concatenate([response.points, response.input_places])).max(initial=0)
        names = [_input_label(response, index, extent) for index in range(len(response.inputs))]
        places = [f"({point_text(point, [extent])})" for point in response.points]
        unit = length_unit([extent])[0]
        labels = [f"{name} → {place} {unit}" for name in names for place in places]
        for index, look in _plot(magnitude, x, np.abs(response.responses), labels).items():
            phase.plot(x, _unbroken(np.degrees(np.angle(response.responses[index]))), **look)
        _plot(velocity, x, response.mean_square_velocity, names)
        localization.plot(x, response.bound, color=BOUND, linewidth=1.0, linestyle="--", label="bound")
        localization.plot(x, response.localization_factor, color=FACTOR, linewidth=1.2, label="drive of the scene")
        _set_axes(response, magnitude, phase, localization, velocity)
        _add_legend(magnitude, len(response.responses), marked=response.natural_frequencies.size > 0)
        _add_legend(localization, 0)
        _add_legend(velocity, len(names))
        made.suptitle(response.title or f"{response.quantity} of the plate", fontsize=10)
        made.align_ylabels()


def _set_axes(response: FrequencyResponse, magnitude: Axes, phase: Axes, localization: Axes, velocity: Axes) -> None:
    """Set scales, limits and labels, and mark the natural frequencies at the lower end of every panel."""
    x = response.frequencies
    if x[-1] >= LOGARITHMIC * x[0]:
        velocity.set_xscale("log")
    velocity.set(xlim=x[[0, -1]], xlabel="frequency [Hz]", ylabel="mean square\nvelocity [(m/s)²/N²]")
    if velocity.get_xscale() == "log":
        number_log_axis(velocity.xaxis)
    magnitudes, squares = (magnitude, np.abs(response.responses), 1), (velocity, response.mean_square_velocity, 2)
    for axes, values, power in (magnitudes, squares):
        axes.set_yscale("log")
        axes.set_ylim(*_limits(values, power * MOST_DECADES))
        number_log_axis(axes.yaxis)
    magnitude.set_ylabel(f"{response.quantity} [{response.unit}]")
    phase.set(ylabel="phase [°]", ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    largest = np.nanmax([response.bound, response.localization_factor], initial=0.01)
    localization.set(ylabel="localization\nfactor", ylim=(0, 1.05 * min(largest, 1)))
    for axes in (magnitude, phase, localization, velocity):
        axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
        ticks = axes.get_xaxis_transform()
        axes.vlines(response.natural_frequencies, 0, 0.05, color=MARK, linewidth=0.8, transform=ticks)


def _limits(values: np.ndarray, decades: float) -> tuple[float, float]:
    """Return limits of a logarithmic axis of at most so many decades around the largest values."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 1.0
    high = positive.max()
    return max(positive.min(), high / 10**decades) / 1.5, high * 1.5


def _unbroken(degrees: np.ndarray) -> np.ndarray:
    """Return a phase with gaps where it jumps from one end of the axis to the other."""
    jumps = np.abs(np.diff(degrees, prepend=degrees[0])) > 270
    return np.where(jumps, np.nan, degrees)


def _plot(axes: Axes, x: np.ndarray, curves: np.ndarray, labels: list[str]) -> dict[int, dict[str, Any]]:
    """Plot curves (curves, frequencies), the largest in colours and the others in grey; return the former's looks."""
    peaks = np.nan_to_num(curves).max(axis=1)
    chosen = sorted(np.argsort(-peaks, kind="stable")[:MOST_COLOURED].tolist())
    for index in sorted(set(range(len(curves))) - set(chosen)):
        axes.plot(x, curves[index], color=GRID, linewidth=0.6, alpha=0.6)
    looks: dict[int, dict[str, Any]] = {}
    for rank, index in enumerate(chosen):
        covered = sum(np.allclose(curves[index], curves[earlier], rtol=COVERED, atol=0) for earlier in chosen[:rank])
        dashes = DASHES[min(covered + index // len(COLOURS), len(DASHES) - 1)]
        looks[index] = {"color": COLOURS[index % len(COLOURS)], "linestyle": dashes, "linewidth": 1.0}
        axes.plot(x, curves[index], label=labels[index], **looks[index])
    return looks


def _input_label(response: FrequencyResponse, index: int, extent: float) -> str:
    """Return the name of an actuator, or the place of a point whose name is "X,Y" [m]."""
    name, place = response.inputs[index], response.input_places[index]
    is_point = name == "{:g},{:g}".format(*place)
    return f"({point_text(place, [extent])}) {length_unit([extent])[0]}" if is_point else shortened(name)


def _add_legend(axes: Axes, count: int, marked: bool = False) -> None:
    """Add a legend beside the axes, which says that other curves are grey, and explains the natural frequencies."""
    from matplotlib.lines import Line2D

    handles = axes.get_legend_handles_labels()[0]
    if marked:
        handles.append(Line2D([], [], color=MARK, linestyle="", marker="|", markersize=7, label="natural frequency"))
    more = f"the {MOST_COLOURED} largest of {count}" if count > MOST_COLOURED else None
    place = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5)}
    axes.legend(handles=handles, fontsize=7.5, title=more, title_fontsize=7.5, **place).set_in_layout(True)
