"""Plots of frequency responses and modes, computed and fitted to measurements, and of waveforms that focus."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.result.frequency_response import IMPEDANCE, UNITS, FrequencyResponse
from warp_plate.viz.annotations import GRID, INK, length_unit, point_text, shortened
from warp_plate.viz.fields import (
    DEFAULT_COLOURS,
    FIELDS,
    ColourOptions,
    DrawingScale,
    colour_map,
    drawing_scale,
    short_number,
    unit_with_prefix,
)
from warp_plate.viz.outlined import clip, continued
from warp_plate.viz.plots.frame import figure, number_log_axis
from warp_plate.viz.plots.plan import draw_actuators, draw_edges, drawn_size, light_rim

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from warp_plate.fitting.fit import ModeFit, ResponseFit

# Colours of responses, which repeat; the dashes of curves that cover earlier ones to the relative distance COVERED;
# most curves in colour and in the legend: the largest ones, the others are grey.
CURVE_COLOURS = ("#08519c", "#d94801", "#1b7837", "#762a83", "#8c6d31", "#c51b7d", "#4d4d4d", "#3288bd")
DASHES, COVERED = ("-", (0, (4, 4)), (0, (2, 6)), (0, (1, 7))), 0.1
MOST_COLOURED = 5
FACTOR, BOUND, MARK = "#08519c", "#b2182b", "#b2182b"
# Decades of an axis of squares, twice those of magnitudes; undamped responses have no upper limit.
MOST_DECADES = 8.0
# Factor between the ends of a range from which its axis is logarithmic.
LOGARITHMIC = 4.0
MEASURED, FITTED = "#d94801", "#08519c"
MOST_RESPONSES = 4
# Phases further apart than this are drawn without a line between them [°].
JUMP = 270
# Of waveforms: longer side of a plate [inch]; most that are drawn; periods of a burst, or of the highest frequency of a
# pulse, whose waves can be seen.
LENGTH, MOST_WAVEFORMS, BURST_PERIODS, PULSE_PERIODS = 2.0, 8, 16, 50


def draw_frequency_response(response: FrequencyResponse, path: str | Path) -> None:
    """Draw the responses of all pairs, with ticks at natural frequencies; those of several inputs above the
    localization factor of the scene's drive and the mean square velocity that each input causes."""
    x, several, real = response.frequencies, len(response.inputs) > 1, response.of_plate
    heights = [2.2, *[1] * (not real), *[1.2, 1.4] * several]
    with figure(path, (7.2, (8.0 if several else 4.9) - 1.2 * real), font_size=9) as fig:
        panels = fig.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        magnitude, *others = panels
        phase = None if real else others.pop(0)
        extent = np.abs(np.concatenate([response.points[:, :2], response.input_places])).max(initial=0)
        names = [_input_label(response, index, extent) for index in range(len(response.inputs))]
        places = [f" → ({point_text(point, [extent])}) {length_unit([extent])[0]}" for point in response.points]
        of_coils = response.quantity == IMPEDANCE
        labels = [name + place for name in names for place in places or [""]]
        labels = [shortened(label) for label in response.labels] if of_coils else labels
        drawn, bands = response.responses[response.distinct], response.band("responses")
        magnitudes = curves = np.abs(drawn)
        if response.level_unit:
            curves, bands = response.level(curves), (response.level(bands[0]), response.level(bands[1]))
        labels = [labels[index] for index in response.distinct]
        for index, look in _plot(magnitude, x, curves, labels, magnitudes).items():
            _draw_band(magnitude, x, bands, response.distinct[index], look["color"])
            if phase is not None:
                phase.plot(x, _unbroken(drawn[index]), **look)
        if phase is not None:
            phase.set(ylabel="phase [°]", ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
            if of_coils and not several:  # which is passive
                phase.set(ylim=(-95, 95), yticks=(-90, -45, 0, 45, 90))
        set_frequency_axes(x, response.natural_frequencies, panels)
        _set_magnitude_axis(magnitude, response, curves)
        if several:
            _draw_localization(response, others[0])
            for index, look in _plot(others[1], x, response.mean_square_velocity, names).items():
                _draw_band(others[1], x, response.band("mean_square_velocity"), index, look["color"])
            label = f"mean square\nvelocity [{response.velocity_unit}]"
            _set_log_axis(others[1], response.mean_square_velocity, 2 * MOST_DECADES, label)
            _add_legend(others[1], len(names))
        _add_legend(magnitude, len(drawn), marked=response.natural_frequencies.size > 0)
        what = "coils" if of_coils else "the plate"
        fig.suptitle(response.title or f"{response.quantity} of {what}", fontsize=10, wrap=True)
        fig.align_ylabels()


def _set_magnitude_axis(axes: Axes, response: FrequencyResponse, curves: np.ndarray) -> None:
    """Set and label the axis of magnitudes, logarithmic, or of levels of sound [dB]."""
    quantity = response.quantity.replace("_", " ")
    if response.level_unit:
        high = float(np.nanmax(curves))
        axes.set_ylim(max(float(np.nanmin(curves)), high - 10 * MOST_DECADES) - 3, high + 3)
        axes.set_ylabel(f"{quantity} level\nunder 1 N [{response.level_unit}]")
    else:
        _set_log_axis(axes, curves, MOST_DECADES, f"{quantity} [{response.unit}]")


def _draw_localization(response: FrequencyResponse, axes: Axes) -> None:
    """Draw the localization factor of the scene's drive, and the largest one of any drive."""
    axes.plot(response.frequencies, response.bound, color=BOUND, linewidth=1.0, linestyle="--", label="bound")
    factor = response.localization_factor
    axes.plot(response.frequencies, factor, color=FACTOR, linewidth=1.2, label="drive of the scene")
    for curve, colour in (("bound", BOUND), ("localization_factor", FACTOR)):
        _draw_band(axes, response.frequencies, response.band(curve), ..., colour)
    largest = np.nanmax([response.bound, factor], initial=0.01)
    axes.set(ylabel="localization\nfactor", ylim=(0, 1.05 * min(largest, 1)))
    _add_legend(axes, 0)


def _draw_band(axes: Axes, x: np.ndarray, band: tuple[np.ndarray, np.ndarray], index: Any, colour: str) -> None:
    """Draw the values that one of the true curves can have, with their numerical errors."""
    axes.fill_between(x, band[0][index], band[1][index], color=colour, alpha=0.2, linewidth=0)


def set_frequency_axes(x: np.ndarray, natural: np.ndarray, panels: Sequence[Axes]) -> None:
    """Set and label the shared axis of frequencies [Hz], and mark the natural ones at the lower end of every panel."""
    last = panels[-1]
    if x[-1] >= LOGARITHMIC * x[0]:
        last.set_xscale("log")
    last.set(xlim=x[[0, -1]], xlabel="frequency [Hz]")
    if last.get_xscale() == "log":
        number_log_axis(last.xaxis)
    for axes in panels:
        axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
        ticks = axes.get_xaxis_transform()
        axes.vlines(natural, 0, 0.05, color=MARK, linewidth=0.8, transform=ticks)


def _set_log_axis(axes: Axes, values: np.ndarray, decades: float, label: str) -> None:
    """Make the vertical axis logarithmic, with limits for these values, numbers and a label."""
    axes.set_yscale("log")
    axes.set_ylim(*_limits(values, decades))
    axes.set_ylabel(label)
    number_log_axis(axes.yaxis)


def _limits(values: np.ndarray, decades: float) -> tuple[float, float]:
    """Return limits of a logarithmic axis of at most so many decades around the largest values."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 1.0
    high = positive.max()
    return max(positive.min(), high / 10**decades) / 1.5, high * 1.5


def _unbroken(values: np.ndarray) -> np.ndarray:
    """Return the phase of a response [°], with gaps where it jumps from one end of the axis to the other."""
    degrees = np.degrees(np.angle(values))
    return np.where(np.abs(np.diff(degrees, prepend=degrees[0])) > JUMP, np.nan, degrees)


def _plot(
    axes: Axes, x: np.ndarray, curves: np.ndarray, labels: list[str], magnitudes: np.ndarray | None = None
) -> dict[int, dict[str, Any]]:
    """Plot curves (curves, frequencies), of magnitudes or their levels, the largest in colours and the others in grey;
    return the former's looks."""
    magnitudes = curves if magnitudes is None else magnitudes
    peaks = np.nan_to_num(curves).max(axis=1)
    chosen = sorted(np.argsort(-peaks, kind="stable")[:MOST_COLOURED].tolist())
    for index in sorted(set(range(len(curves))) - set(chosen)):
        axes.plot(x, curves[index], color=GRID, linewidth=0.6, alpha=0.6)
    looks: dict[int, dict[str, Any]] = {}
    for rank, index in enumerate(chosen):
        covered = sum(
            np.allclose(magnitudes[index], magnitudes[earlier], rtol=COVERED, atol=0) for earlier in chosen[:rank]
        )
        dashes = DASHES[min(covered + index // len(CURVE_COLOURS), len(DASHES) - 1)]
        looks[index] = {"color": CURVE_COLOURS[index % len(CURVE_COLOURS)], "linestyle": dashes, "linewidth": 1.0}
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


def draw_response_fit(fitted: ResponseFit, *paths: str | Path) -> None:
    """Draw magnitude, phase and, where it was measured, coherence of the first responses, a column for each."""
    count, coherence = min(len(fitted.responses), MOST_RESPONSES), fitted.measured.coherence
    heights = [2.2, 1] if coherence is None else [2.2, 1, 0.7]
    with figure(paths, (max(4.6, 2.9 * count), 1.2 + 1.3 * sum(heights))) as fig:
        rows = fig.subplots(len(heights), count, sharex=True, sharey="row", squeeze=False, height_ratios=heights)
        for index, column in enumerate(rows.T):
            _draw_response(fitted, index, column)
            if coherence is not None:
                column[2].plot(fitted.measured.frequencies, coherence[index], color=MEASURED, linewidth=0.8)
                column[2].set(ylim=(0, 1.05))
        for axes, label in zip(rows[:, 0], ("", "phase [°]", "coherence"), strict=False):
            axes.set_ylabel(label)
        first = fitted.scene.measurement[0].quantity
        alike = all(row.quantity == first for row in fitted.scene.measurement[:count])
        rows[0, 0].set_ylabel(f"{first} [{UNITS[first]}]" if alike else "response [SI units]")
        rows[0, 0].set_yscale("log")
        number_log_axis(rows[0, 0].yaxis)
        for axes in rows[-1]:
            axes.set_xlabel("frequency [Hz]")
        more = f", the first {count} of {len(fitted.responses)}" if len(fitted.responses) > count else ""
        fig.suptitle(f"{fitted.scene.title or 'Frequency responses'}{more}", fontsize=10, wrap=True)
        fig.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)


def _draw_response(fitted: ResponseFit, index: int, column: np.ndarray) -> None:
    """Draw magnitude and phase of a response, measured and fitted."""
    row, frequencies = fitted.scene.measurement[index], fitted.measured.frequencies
    size = fitted.scene.plate.size
    driven = row.actuator or f"({point_text(row.force_at or (), size)})"
    column[0].set_title(f"{driven} → ({point_text(row.point, size)}) {length_unit(size)[0]}", fontsize=8)
    looks = {"linestyle": "", "marker": ".", "markersize": 3, "color": MEASURED}, {"linewidth": 1, "color": FITTED}
    curves = (fitted.measured.responses[index], fitted.responses[index])
    for values, look, label in zip(curves, looks, ("measured", "fitted"), strict=True):
        column[0].plot(frequencies, np.abs(values), label=label, **look)
        column[1].plot(frequencies, _unbroken(values) if label == "fitted" else np.degrees(np.angle(values)), **look)
    column[1].set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    for axes in column:
        axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)


def draw_mode_fit(fitted: ModeFit, *paths: str | Path, mac: np.ndarray | None = None) -> None:
    """Draw the errors of natural frequencies and, where shapes were measured, the MAC (measured, fitted)."""
    count = len(fitted.numbers)
    with figure(paths, (4.6 if mac is None else 8.6, 3.6)) as fig:
        errors, *others = fig.subplots(1, 1 if mac is None else 2, squeeze=False)[0]
        places = np.arange(count)
        errors.bar(places, 100 * fitted.errors, color=FITTED, width=0.7)
        errors.axhline(0, color="black", linewidth=0.8)
        shown = places[:: -(-count // 12)]
        labels = [f"{fitted.numbers[i]}\n{fitted.measured.frequencies[i]:.4g}" for i in shown]
        errors.set_xticks(shown, labels, fontsize=7)
        errors.set(xlabel="mode, and measured frequency [Hz]", ylabel="fitted over measured frequency − 1 [%]")
        errors.grid(True, axis="y", color=GRID, linewidth=0.4, alpha=0.4)
        if mac is not None:
            _draw_mac(fig, others[0], mac, fitted.numbers)
        fig.suptitle(fitted.scene.title or "Natural frequencies", fontsize=10, wrap=True)


def _draw_mac(fig: Figure, axes: Axes, mac: np.ndarray, numbers: np.ndarray) -> None:
    """Draw a matrix of modal assurance criteria, with numbers where there is room."""
    image = axes.imshow(mac, vmin=0, vmax=1, cmap="Blues", origin="lower")
    shown = np.arange(0, len(mac), -(-len(mac) // 12))
    axes.set_xticks(shown, [str(numbers[i]) for i in shown])
    axes.set_yticks(shown, [str(numbers[i]) for i in shown])
    axes.set(xlabel="fitted mode", ylabel="measured mode")
    for row, column in np.ndindex(mac.shape) if len(mac) <= 12 else ():
        colour = "white" if mac[row, column] > 0.6 else "black"
        axes.text(column, row, f"{mac[row, column]:.2f}", ha="center", va="center", fontsize=6, color=colour)
    fig.colorbar(image, ax=axes, label="modal assurance criterion", shrink=0.85)


def draw_focus(result: FocusResult, path: str | Path, colours: ColourOptions = DEFAULT_COLOURS) -> None:
    """Draw a row of panels for each method, of the waveforms for the first focus; by default each plate has its own
    limits."""
    table, height = result.scene.focus, max(drawn_size(result.scene, LENGTH)[1], 1.4) + 0.65
    assert table is not None
    fields = [method.fields[0] for method in result.methods.values()]
    with figure(path, (9.0, len(result.methods) * height + 0.7), font_size=8) as fig:
        rows = fig.subplots(len(result.methods), 3, squeeze=False, width_ratios=[1, 1.3, 1.3])
        for row, field, (name, method) in zip(rows, fields, result.methods.items(), strict=True):
            shown = fields if colours.limits == "common" else [field]
            scale = drawing_scale(shown, result.scene.plate.size, FIELDS[table.quantity], colours=colours)
            _draw_plate(row[0], result, field, scale)
            area = f"{short_number(1e6 * method.focus_area[0])} mm² at −6 dB"
            ends = f"colours to ±{scale.clim[1]:.4g} {scale.unit}"
            if result.wished is None:
                ends = f"t = {1e3 * table.time:.4g} ms, {ends}"
            row[0].set_title(f"{name.replace('_', ' ')}: {area}\n{ends}", fontsize=8)
            _draw_waveforms(row[1], result, method)
            _draw_foci(row[2], result, method)
        rows[0][1].set_title("waveforms of the actuators", fontsize=8)
        rows[0][2].set_title("motion at the points", fontsize=8)
        rows[-1][1].set_xlabel("time [ms]")
        rows[-1][2].set_xlabel("time [ms]")
        fig.legend(*rows[0][2].get_legend_handles_labels(), loc="outside lower right", ncols=4, fontsize=8)
        fig.suptitle(result.scene.title or "focus", fontsize=10, wrap=True)


def _draw_plate(axes: Axes, result: FocusResult, field: np.ndarray, scale: DrawingScale) -> None:
    plate, table = result.scene.plate, result.scene.focus
    assert table is not None
    (low, high), cmap = scale.clim, colour_map(scale.cmap)
    look = {"origin": "lower", "extent": plate.box, "interpolation": "bilinear"}
    values = continued(result.scene, field * scale.unit_factor)
    clip(axes.imshow(values, cmap=cmap, vmin=low, vmax=high, **look), axes, result.scene)
    draw_actuators(axes, result.scene, LENGTH)
    axes.plot(*table.points[0], "+", color="black", markersize=7, path_effects=light_rim(1.0))
    draw_edges(axes, result.scene)


def _draw_waveforms(axes: Axes, result: FocusResult, method: FocusedWaveforms) -> None:
    """Draw waveforms in strips of their own, all in one scale: around the moment of a burst, before that of a pulse."""
    waveforms, table = method.waveforms[0], result.scene.focus
    assert table is not None
    largest = np.abs(waveforms).max() or 1.0
    times = 1e3 * np.arange(waveforms.shape[1]) / table.rate
    chosen = np.unique(np.linspace(0, len(waveforms) - 1, MOST_WAVEFORMS).round().astype(int))
    for place, index in enumerate(chosen):
        axes.plot(times, place + 0.45 * waveforms[index] / largest, color=INK, linewidth=0.5)
    axes.set_yticks(range(len(chosen)), [shortened(result.scene.actuators[index].name) for index in chosen], fontsize=7)
    if result.wished is not None:
        first, last = 0.0, times[-1]
    elif table.burst is not None:
        first, last = (1e3 * (table.time + side * BURST_PERIODS / 2 / table.burst.frequency) for side in (-1, 1))
    else:
        first, last = 1e3 * (table.time - PULSE_PERIODS / table.highest), times[-1]
    axes.set(xlim=(max(0.0, first), min(last, times[-1])))
    axes.text(1, 1.01, f"±{largest:.3g} {result.scene.drive_unit}", transform=axes.transAxes, ha="right", fontsize=7)


def _draw_foci(axes: Axes, result: FocusResult, method: FocusedWaveforms) -> None:
    table, size = result.scene.focus, result.scene.plate.size
    assert table is not None
    unit, factor = unit_with_prefix(float(np.abs(method.responses[0]).max()) or 1.0, result.unit)
    for index, (motion, point) in enumerate(zip(method.responses[0], table.points, strict=True)):
        label = f"({point_text(point, size)}) {length_unit(size)[0]}"
        look = {"color": CURVE_COLOURS[index % len(CURVE_COLOURS)], "linewidth": 0.7, "zorder": 3 - min(index, 1)}
        axes.plot(1e3 * result.times, factor * motion, label=label, **look)
    if result.wished is not None:
        wish, motion = result.wished[0], method.responses[0, 0, : result.wished.shape[1]]
        nearest = factor * wish * (motion @ wish) / (wish @ wish)
        axes.plot(1e3 * result.times[: wish.size], nearest, "--", color=INK, linewidth=0.5, label="wish", zorder=4)
    axes.set(xlim=(0, 1e3 * result.times[-1]), ylabel=f"{table.quantity} [{unit}]")
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
