"""Plots of fits: measured and fitted responses with their coherence, errors of natural frequencies with the MAC, and
profile likelihoods."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.frequency_response import UNITS
from warp_plate.scene.keys import unit_of
from warp_plate.viz.plots.frame import figure, label_axis, number_log_axis
from warp_plate.viz.styles import GRID, length_unit, point_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from warp_plate.fitting.fit_modes import ModeFit
    from warp_plate.fitting.fit_responses import ResponseFit
    from warp_plate.fitting.fitted_panel import FittedPanel

MEASURED, FITTED = "#d94801", "#08519c"
MOST_RESPONSES, PROFILES_IN_A_ROW = 4, 4
# Rise of χ² at the top of profiles, relative to that at the ends of 95 % intervals.
PROFILE_TOP = 2.4
# Phases further apart than this are drawn without a line between them [°].
JUMP = 270


def draw_response_fit(found: ResponseFit, path: str | Path) -> None:
    """Draw magnitude, phase and, where it was measured, coherence of the first responses, a column for each."""
    count, coherence = min(len(found.responses), MOST_RESPONSES), found.measured.coherence
    heights = [2.2, 1] if coherence is None else [2.2, 1, 0.7]
    with figure(path, (max(4.6, 2.9 * count), 1.2 + 1.3 * sum(heights))) as made:
        rows = made.subplots(len(heights), count, sharex=True, sharey="row", squeeze=False, height_ratios=heights)
        for index, column in enumerate(rows.T):
            _draw_response(found, index, column)
            if coherence is not None:
                column[2].plot(found.measured.frequencies, coherence[index], color=MEASURED, linewidth=0.8)
                column[2].set(ylim=(0, 1.05))
        for axes, label in zip(rows[:, 0], ("", "phase [°]", "coherence"), strict=False):
            axes.set_ylabel(label)
        first = found.scene.measurement[0].quantity
        alike = all(each.quantity == first for each in found.scene.measurement[:count])
        rows[0, 0].set_ylabel(f"{first} [{UNITS[first]}]" if alike else "response [SI units]")
        rows[0, 0].set_yscale("log")
        number_log_axis(rows[0, 0].yaxis)
        for axes in rows[-1]:
            axes.set_xlabel("frequency [Hz]")
        more = f", the first {count} of {len(found.responses)}" if len(found.responses) > count else ""
        made.suptitle(f"{found.scene.title or 'Frequency responses'}{more}", fontsize=10)
        made.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)


def _draw_response(found: ResponseFit, index: int, column: np.ndarray) -> None:
    """Draw magnitude and phase of a response, measured and fitted."""
    row, frequencies = found.scene.measurement[index], found.measured.frequencies
    size = found.scene.plate.size
    driven = row.actuator or f"({point_text(row.force_at or (), size)})"
    column[0].set_title(f"{driven} → ({point_text(row.point, size)}) {length_unit(size)[0]}", fontsize=8)
    looks = {"linestyle": "", "marker": ".", "markersize": 3, "color": MEASURED}, {"linewidth": 1, "color": FITTED}
    curves = (found.measured.responses[index], found.responses[index])
    for values, look, label in zip(curves, looks, ("measured", "fitted"), strict=True):
        column[0].plot(frequencies, np.abs(values), label=label, **look)
        degrees = np.degrees(np.angle(values))
        jumps = (np.abs(np.diff(degrees, prepend=degrees[0])) > JUMP) & (label == "fitted")
        column[1].plot(frequencies, np.where(jumps, np.nan, degrees), **look)
    column[1].set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    for axes in column:
        axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)


def draw_mode_fit(found: ModeFit, path: str | Path, mac: np.ndarray | None = None) -> None:
    """Draw the errors of natural frequencies and, where shapes were measured, the MAC (measured, fitted)."""
    count = len(found.numbers)
    with figure(path, (4.6 if mac is None else 8.6, 3.6)) as made:
        errors, *others = made.subplots(1, 1 if mac is None else 2, squeeze=False)[0]
        places = np.arange(count)
        errors.bar(places, 100 * found.errors, color=FITTED, width=0.7)
        errors.axhline(0, color="black", linewidth=0.8)
        shown = places[:: -(-count // 12)]
        labels = [f"{found.numbers[i]}\n{found.measured.frequencies[i]:.4g}" for i in shown]
        errors.set_xticks(shown, labels, fontsize=7)
        errors.set(xlabel="mode, and measured frequency [Hz]", ylabel="fitted over measured frequency − 1 [%]")
        errors.grid(True, axis="y", color=GRID, linewidth=0.4, alpha=0.4)
        if mac is not None:
            _draw_mac(made, others[0], mac, found.numbers)
        made.suptitle(found.scene.title or "Natural frequencies", fontsize=10)


def draw_profiles(found: FittedPanel, path: str | Path) -> None:
    """Draw the profile likelihood of each number, and the parabola that its interval assumes."""
    assert found.profiles is not None
    columns = min(len(found.keys), PROFILES_IN_A_ROW)
    rows = -(-len(found.keys) // columns)
    with figure(path, (max(4.6, 2.6 * columns), 0.9 + 2.1 * rows)) as made:
        panels = made.subplots(rows, columns, squeeze=False, sharey=True)
        for axes in panels.ravel()[len(found.keys) :]:
            axes.set_visible(False)
        for index, axes in enumerate(panels.ravel()[: len(found.keys)]):
            _draw_profile(found, index, axes)
        for axes in panels[:, 0]:
            axes.set_ylabel("rise of χ²")
        panels[0, 0].set_ylim(-0.1 * found.rise, PROFILE_TOP * found.rise)
        made.suptitle(found.scene.title or "Profile likelihoods", fontsize=10)
        made.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)


def _draw_profile(found: FittedPanel, index: int, axes: Axes) -> None:
    assert found.profiles is not None
    (values, rise), own = found.profiles[:, index], found.values[index]
    axes.plot(values, rise, color=FITTED, marker=".", markersize=4, linewidth=1, label="others fitted")
    axes.axhline(found.rise, color="black", linewidth=0.8, linestyle=":", label="95 %")
    half = (found.high[index] - found.low[index]) / 2
    label = "parabola of the interval"
    axes.plot(
        values, found.rise * ((values - own) / half) ** 2, color=MEASURED, linewidth=1.2, linestyle="--", label=label
    )
    label_axis(axes.xaxis, found.keys[index], unit_of(found.scene, found.keys[index]), 7)
    axes.locator_params(axis="x", nbins=3)
    axes.tick_params(labelsize=7)
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)


def _draw_mac(made: Figure, axes: Axes, mac: np.ndarray, numbers: np.ndarray) -> None:
    """Draw a matrix of modal assurance criteria, with numbers where there is room."""
    image = axes.imshow(mac, vmin=0, vmax=1, cmap="Blues", origin="lower")
    shown = np.arange(0, len(mac), -(-len(mac) // 12))
    axes.set_xticks(shown, [str(numbers[i]) for i in shown])
    axes.set_yticks(shown, [str(numbers[i]) for i in shown])
    axes.set(xlabel="fitted mode", ylabel="measured mode")
    for row, column in np.ndindex(mac.shape) if len(mac) <= 12 else ():
        colour = "white" if mac[row, column] > 0.6 else "black"
        axes.text(column, row, f"{mac[row, column]:.2f}", ha="center", va="center", fontsize=6, color=colour)
    made.colorbar(image, ax=axes, label="modal assurance criterion", shrink=0.85)
