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
# most entries of a legend.
COLOURS = ("#08519c", "#d94801", "#1b7837", "#762a83", "#8c6d31", "#c51b7d", "#4d4d4d", "#3288bd")
DASHES, COVERED = ("-", (0, (4, 4)), (0, (2, 6)), (0, (1, 7))), 0.1
MOST_LABELS = 9
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
        styles = _styles(np.abs(response.responses))
        extent = np.abs(np.concatenate([response.points, response.input_places])).max(initial=0)
        names = [_input_label(response, index, extent) for index in range(len(response.inputs))]
        places = [f"({point_text(point, [extent])})" for point in response.points]
        unit = length_unit([extent])[0]
        labels = _shown([f"{name} → {place} {unit}" for name in names for place in places])
        for label, values, style in zip(labels, response.responses, styles, strict=True):
            magnitude.plot(x, np.abs(values), label=label, **style)
            phase.plot(x, _unbroken(np.degrees(np.angle(values))), **style)
        velocities, styles = response.mean_square_velocity, _styles(response.mean_square_velocity)
        for name, values, style in zip(_shown(names), velocities, styles, strict=True):
            velocity.plot(x, values, label=name, **style)
        localization.plot(x, response.bound, color=BOUND, linewidth=1.0, linestyle="--", label="bound")
        localization.plot(x, response.localization_factor, color=FACTOR, linewidth=1.2, label="drive of the scene")
        _set_axes(response, magnitude, phase, localization, velocity)
        for axes in (magnitude, localization, velocity):
            _add_legend(axes, len(response.responses) if axes is magnitude else len(response.inputs))
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
        label = "natural frequency" if axes is localization else None
        axes.vlines(response.natural_frequencies, 0, 0.05, color=MARK, linewidth=0.8, transform=ticks, label=label)


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


def _styles(curves: np.ndarray) -> list[dict[str, Any]]:
    """Return the line styles of curves (curves, frequencies)."""
    styles = []
    for index, curve in enumerate(curves):
        covered = sum(np.allclose(curve, earlier, rtol=COVERED, atol=0) for earlier in curves[:index])
        colour = COLOURS[index % len(COLOURS)]
        styles.append({"color": colour, "linestyle": DASHES[min(covered, len(DASHES) - 1)], "linewidth": 1.0})
    return styles


def _input_label(response: FrequencyResponse, index: int, extent: float) -> str:
    """Return the name of an actuator, or the place of a point whose name is "X,Y" [m]."""
    name, place = response.inputs[index], response.input_places[index]
    is_point = name == "{:g},{:g}".format(*place)
    return f"({point_text(place, [extent])}) {length_unit([extent])[0]}" if is_point else shortened(name)


def _shown(labels: list[str]) -> list[str | None]:
    """Return labels with None for those that have no room in a legend."""
    return [label if index < MOST_LABELS else None for index, label in enumerate(labels)]


def _add_legend(axes: Axes, count: int) -> None:
    """Add a legend beside the axes, which says if it leaves out curves."""
    more = f"the first {MOST_LABELS} of {count}" if count > MOST_LABELS else None
    legend = axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=7.5, title=more, title_fontsize=7.5)
    legend.set_in_layout(True)
