"""Plots of drives from measured responses (the moving panel, the spectrum, contrast against misfit, the drive), and of
measured velocities beside the predicted ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import GRID, INK, shortened
from warp_plate.viz.fields import colour_map
from warp_plate.viz.plots.frame import figure, label_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from warp_plate.studies.measured_drives import MeasuredDrives
    from warp_plate.studies.verify import Verification

LEAST = -40.0
BEST, ROBUST, TARGET = "#08519c", "#d94801", "#b2182b"


def draw_measured(found: MeasuredDrives, *paths: str | Path) -> None:
    """Draw the drives of a measured panel."""
    with figure(paths, (9.0, 6.6)) as fig:
        fig.set_layout_engine("constrained", w_pad=0.12)  # or else labels beside the field of fixed shape are cut off
        (field, drive), (curve, spectrum) = fig.subplots(2, 2, width_ratios=[1.25, 1], height_ratios=[1.15, 1])
        _draw_field(found, field)
        _draw_drive(found, drive)
        _draw_curve(found, curve)
        _draw_spectrum(found, spectrum)
        low, high = (100 * end for end in found.localized.interval)
        words = f"{100 * found.localized.factor:.1f} % in the target at {found.frequency:.5g} Hz"
        words += f", true {low:.1f} to {high:.1f} %"
        fig.suptitle(f"{found.scene.title or 'Measured panel'}: {words}", fontsize=11, wrap=True)


def _draw_field(found: MeasuredDrives, axes: Axes) -> None:
    x0, y0, x1, y1 = found.plate.shape.bounds
    image = axes.imshow(
        _levels(found.field), cmap=colour_map("cividis"), vmin=LEAST, vmax=0, origin="lower", extent=(x0, x1, y0, y1),
        interpolation="bilinear",
    )  # fmt: skip
    axes.plot(*found.plate.matrix.points.T, ".", color="white", markersize=2, alpha=0.7)
    for shape in found.plate.targets.values():
        for part in shapely.get_parts(shape):
            axes.plot(*shapely.get_coordinates(part.exterior).T, color=TARGET, linewidth=1.4)
    axes.figure.colorbar(image, ax=axes, label="level over the largest [dB]", shrink=0.85)
    axes.set(xlim=(x0, x1), ylim=(y0, y1))
    label_axis(axes.xaxis, "x", "m")
    label_axis(axes.yaxis, "y", "m")
    axes.set_title("largest localization; dots: scanned points", fontsize=8)


def _levels(shares: np.ndarray) -> np.ndarray:
    """Return levels [dB] of shares of the largest magnitude, not below LEAST."""
    with np.errstate(divide="ignore"):
        return np.maximum(20 * np.log10(shares), LEAST)


def _draw_drive(found: MeasuredDrives, axes: Axes) -> None:
    places, largest = np.arange(len(found.names))[::-1], found.plate.largest
    drives = (found.localized.drive, BEST, "largest", 0.2), (found.localized.robust_drive, ROBUST, "robust", -0.2)
    for drive, colour, name, shift in drives:
        axes.barh(places + shift, np.abs(drive) * largest, height=0.36, color=colour, label=name)
        for place, phase in zip(places + shift, -np.angle(drive, deg=True), strict=True):
            text = f"{round(phase) or 0}°".replace("-", "−")
            axes.annotate(text, (1.02, place), xycoords=("axes fraction", "data"), va="center", fontsize=7, color=INK)
    axes.set(yticks=places, yticklabels=[shortened(name) for name in found.names])
    axes.set_xlabel(f"drive [{found.scene.measured.unit}], phase lag at the right")
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)


def _draw_curve(found: MeasuredDrives, axes: Axes) -> None:
    least, (contrast, misfit) = (
        np.array([[row.contrast_db, 100 * row.misfit] for row in rows]).T for rows in (found.curve, found.spans)
    )
    axes.plot(*least, color=BEST, linewidth=1.4, label="least misfit of all drives")
    axes.plot(contrast, misfit, "o", color=ROBUST, markersize=4, label="variable span, 1 to all vectors")
    for number in (1, len(contrast)):
        at = contrast[number - 1], misfit[number - 1]
        axes.annotate(str(number), at, (4, 4), textcoords="offset points", fontsize=7)
    axes.set(xlabel="contrast of target and rest [dB]", ylabel="misfit of the target's motion [%]", ylim=(0, None))
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
    axes.legend(fontsize=8, loc="lower right")


def _draw_spectrum(found: MeasuredDrives, axes: Axes) -> None:
    best, several = found.localized, len(found.frequencies) > 1
    axes.plot(found.frequencies, 100 * found.factors, color=BEST, linewidth=1.2, marker="" if several else ".")
    ends = 100 * np.abs(np.array(best.interval) - best.factor)[:, None]
    axes.errorbar(
        [found.frequency],
        [100 * best.factor],
        yerr=ends,
        fmt="o",
        color=INK,
        markersize=4,
        capsize=3,
        label="drive, true",
    )
    axes.plot([found.frequency], [100 * best.bound], "_", color=TARGET, markersize=12, label="bound of all drives")
    axes.set(xlabel="frequency [Hz]", ylabel="largest factor [%]", ylim=(0, 105))
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
    axes.legend(fontsize=8, loc="best")


def draw_verified(verified: Verification, scene: Scene, path: str | Path) -> None:
    """Draw measured and predicted velocities of a scene's panel."""
    measured, promised = verified.measured.velocity, verified.promised * verified.scale
    largest = max(float(measured.max()), float(promised.max()))
    with figure(path, (11.0, 4.2)) as fig:
        left, middle, right = fig.subplots(1, 3, width_ratios=[1, 1, 0.95])
        for axes, values, name in ((left, measured, "measured"), (middle, promised, "predicted")):
            look = {"cmap": colour_map("cividis"), "vmin": LEAST, "vmax": 0, "s": 22}
            dots = axes.scatter(*verified.measured.points.T, c=_levels(values / largest), **look)
            axes.set(xlim=(0, scene.plate.size[0]), ylim=(0, scene.plate.size[1]), aspect="equal", title=name)
            label_axis(axes.xaxis, "x", "m")
            label_axis(axes.yaxis, "y", "m")
            if scene.target.mask is None:
                axes.plot(*scene.target.closed_path().T, color=TARGET, linewidth=1.4)
        fig.colorbar(
            dots, ax=[left, middle], label="level over the largest [dB]", shrink=0.6, aspect=40, location="bottom"
        )
        right.plot([0, largest], [0, largest], color=INK, linewidth=0.8, linestyle=":")
        right.errorbar(
            promised, measured, yerr=verified.measured.uncertainty, fmt=".", color=BEST, markersize=4, elinewidth=0.7
        )
        right.set(
            xlim=(0, None), ylim=(0, None), xlabel="predicted, scaled as the measured", ylabel="measured velocity"
        )
        right.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
        right.set_title(f"cosine {verified.correlation:.4f}", fontsize=9)
        low, high = (100 * end for end in verified.interval)
        factor, promise = 100 * verified.localization_factor, 100 * verified.promised_factor
        words = f"{factor:.1f} % measured ({low:.1f} to {high:.1f} %), {promise:.1f} % predicted"
        fig.suptitle(f"{scene.title or verified.case}\nlocalization factor {words}", fontsize=11, wrap=True)
