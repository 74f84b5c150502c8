"""Plot of the answer to a specification: map of levels, drive against its limits, frequencies and trade-off."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.specified import SpecifiedDrive
from warp_plate.viz.annotations import GRID, INK, shortened
from warp_plate.viz.fields import colour_map
from warp_plate.viz.outlined import clip, continued
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.plan import draw_parts, drawn_size, label_sides, outline_handles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Longer side of the plate [inch]; lowest level of the map [dB]; colours.
LENGTH, LOWEST = 5.0, -40.0
LEAST_SPAN = 1.0  # of an axis of contrasts [dB]
MET, MISSED, LIMIT = "#1b7837", "#b2182b", "#b2182b"
DRIVE = "#3182bd"
# Marker of the drive for the nominal scene, beside that for all cases of the tolerances.
NOMINAL = {"color": INK, "marker": "x", "markersize": 5, "linestyle": "none"}


def draw_specified(answer: SpecifiedDrive, *paths: str | Path) -> None:
    """Draw the answer to a specification."""
    width, height = drawn_size(answer.scene, LENGTH)
    spectrum, pareto = len(answer.frequencies) > 1, answer.pareto_levels.size > 0
    plots = ((_draw_spectrum, spectrum), (_draw_pareto, pareto), (_draw_cases, len(answer.scatter) > 0))
    lower = [draw for draw, shown in plots if shown]
    with figure(paths, (max(width + 2.8, 7.2), height + 1.2 + 2.2 * bool(lower)), font_size=9) as fig:
        rows = fig.subfigures(1 + bool(lower), 1, height_ratios=[height + 1.0, 2.2][: 1 + bool(lower)], squeeze=False)
        field, drive = rows[0, 0].subplots(1, 2, width_ratios=[width, 1.9])
        _draw_map(answer, field)
        _draw_drive(answer, drive)
        rows[0, 0].legend(handles=outline_handles(answer.scene), loc="outside lower center", ncols=6, fontsize=7)
        if lower:
            for axes, draw in zip(np.atleast_1d(rows[1, 0].subplots(1, len(lower))), lower, strict=True):
                draw(answer, axes)
                axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
        words = "met" if answer.feasible else "not met" if not answer.proved else "cannot be met"
        colour = MET if answer.feasible else MISSED
        words = f"{words}, {answer.frequency:.5g} Hz"
        if answer.scatter:
            met, cases = sum(case.met for case in answer.scatter), len(answer.scatter)
            of = f"all {cases}" if met == cases else f"{met} of {cases}"
            words = f"one drive at {answer.robust_frequency:.5g} Hz meets {of} cases of the tolerances"
            colour = MET if met == cases else MISSED
        fig.suptitle(f"{answer.scene.title or 'Specification'}: {words}", fontsize=11, color=colour, wrap=True)


def _draw_map(answer: SpecifiedDrive, axes: Axes) -> None:
    levels = np.maximum(answer.field_db, LOWEST)
    image = axes.imshow(
        continued(answer.scene, levels), cmap=colour_map("cividis"), vmin=LOWEST, vmax=max(0.0, float(levels.max())),
        origin="lower", extent=answer.scene.plate.box, interpolation="bilinear",
    )  # fmt: skip
    clip(image, axes, answer.scene)
    for line in answer.guard:
        closed = np.concatenate([line, line[:1]])
        axes.plot(*closed.T, color="white", linewidth=1.0, linestyle="--")
    draw_parts(axes, answer.scene)
    label_sides(axes, answer.scene)
    bar = axes.figure.colorbar(image, ax=axes, orientation="horizontal", aspect=30, shrink=0.8)
    specification = answer.scene.specification
    assert specification is not None
    least = min(specification.levels, key=lambda level: level.peak_acceleration(answer.frequency))
    wanted = "the level wanted" if len(specification.levels) == 1 else "the least level wanted"
    bar.set_label(f"peak acceleration over {wanted}, {least.text} [dB]")
    frequency = answer.robust_frequency if answer.scatter else answer.frequency
    guard = specification.guard if answer.guard else 0.0
    areas = any(row.area for row in specification.allowances)
    if areas:
        dashed = f"; dashed: where levels elsewhere hold, {1e3 * guard:g} mm from targets"
    else:
        dashed = f"; dashed: guard of {1e3 * guard:g} mm, levels elsewhere hold beyond" if guard else ""
    axes.set_title(f"{frequency:.5g} Hz{dashed}", fontsize=8)


def _draw_drive(answer: SpecifiedDrive, axes: Axes) -> None:
    names = [shortened(name) for name in answer.peaks]
    drive, label = (answer.robust_drive, "for all cases") if answer.scatter else (answer.drive, "drive")
    places = np.arange(len(names))[::-1]
    limits, unit = answer.limits, f"peak [{answer.unit}]"
    sizes = np.ones_like(limits)
    if len(set(answer.units)) > 1:
        sizes, unit = limits, "peak over limit"
    axes.barh(places, limits / sizes, color="none", edgecolor=LIMIT, linewidth=0.9, label="limit")
    axes.barh(places, np.abs(drive) / sizes, color=DRIVE, height=0.55, label=label)
    if answer.scatter:
        axes.plot(np.abs(answer.drive) / sizes, places, **NOMINAL, label="nominal")
    rows = zip(places, np.abs(drive), -np.angle(drive, deg=True), answer.units, strict=True)
    for place, peak, phase, its_unit in rows:
        text = f"{peak:.3g} {its_unit}, {round(phase) or 0}°".replace("-", "−")
        axes.annotate(text, (1.02, place), xycoords=("axes fraction", "data"), va="center", fontsize=8, color=INK)
    axes.set(yticks=places, yticklabels=names, xlabel=f"{unit}; right: with phase lag")
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, columnspacing=1, handlelength=1.2)


def _draw_spectrum(answer: SpecifiedDrive, axes: Axes) -> None:
    """Draw the least contrast at each frequency, or the least limits without a contrast."""
    x = answer.frequencies
    if np.isfinite(answer.contrasts).any():
        axes.plot(x, answer.contrasts, color="#08519c", linewidth=1.4, marker=".", markersize=3)
        axes.set_ylabel("contrast [dB]")
        _draw_allowed(answer, axes, below=True)
        axes.margins(y=0.15)
        axes.plot(answer.frequency, answer.contrast_db, "o", color=INK, markersize=5, clip_on=False)
    else:
        axes.plot(x, 100 * answer.efforts, color="#08519c", linewidth=1.4)
        axes.set(yscale="log", ylabel="limits needed [%]")
    if answer.scatter:
        axes.axvline(answer.robust_frequency, color=DRIVE, linewidth=0.9, linestyle="--")
        axes.annotate(
            "for all cases", (answer.robust_frequency, 1.0), (0, 2), ("data", "axes fraction"), "offset points",
            ha="center", fontsize=8, color=DRIVE,
        )  # fmt: skip
    axes.set(xlim=x[[0, -1]], xlabel="frequency [Hz]")


def _draw_pareto(answer: SpecifiedDrive, axes: Axes) -> None:
    """Draw the least contrast for other levels, and at the right the least part of the limits for them."""
    contrast, effort = "#d94801", DRIVE
    x, curve = answer.pareto_levels, {"linewidth": 1.4, "marker": ".", "markersize": 4}
    axes.plot(x, answer.pareto_contrasts, color=contrast, **curve)
    _draw_allowed(answer, axes)
    low, high = axes.get_ylim()
    if high - low < LEAST_SPAN:  # the noise of a constant
        axes.set_ylim((low + high - LEAST_SPAN) / 2, (low + high + LEAST_SPAN) / 2)
    axes.axvline(1.0, color=INK, linewidth=0.8, linestyle=":")
    axes.set(xscale="log", xlabel="level in the target over that wanted")
    axes.set_ylabel(f"least contrast [dB]\nat {answer.frequency:.5g} Hz", color=contrast)
    axes.set_xticks([1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8], ["1/8", "1/4", "1/2", "1", "2", "4", "8"])
    axes.minorticks_off()
    if np.isfinite(answer.pareto_efforts).any():
        right = axes.twinx()
        right.plot(x, 100 * answer.pareto_efforts, color=effort, **curve)
        right.set_yscale("log", subs=[2, 5])
        right.set_ylabel("limits needed [%]", color=effort)
        for set_formatter in (right.yaxis.set_major_formatter, right.yaxis.set_minor_formatter):
            set_formatter("{x:g}")


def _draw_cases(answer: SpecifiedDrive, axes: Axes) -> None:
    """Draw level and contrast in all cases of the tolerances, under the nominal drive and the one for all."""
    numbers = np.arange(1.0, len(answer.scatter) + 1)
    contrasts = np.array([[case.nominal_db, case.robust_db] for case in answer.scatter])
    compared = bool(np.isfinite(contrasts).all())
    x_nominal, x_robust = contrasts.T if compared else (numbers, numbers)
    levels = np.array([[case.nominal_level, case.robust_level] for case in answer.scatter])
    met = np.array([case.met for case in answer.scatter])
    axes.plot(x_nominal, levels[:, 0], **NOMINAL)
    for colour, shown in ((DRIVE, met), (LIMIT, ~met)):
        axes.plot(x_robust[shown], levels[shown, 1], "o", color=colour, markersize=4)
    changes = [case.changes for case in answer.scatter]
    title = f"{len(changes)} cases of the tolerances"
    if len(changes[0]) == 1:
        ((key, least),) = changes[0].items()
        title = f"{shortened(key)} ± {100 * (1 - least):.3g} %"
        for case, sign in ((0, "−"), (-1, "+")):
            for x, y in zip((x_nominal[case], x_robust[case]), levels[case], strict=True):
                text = f"{sign}{100 * (1 - least):.3g} %"
                axes.annotate(text, (x, y), (5, -2), textcoords="offset points", va="top", fontsize=7, color=INK)
    axes.axhline(1.0, color=INK, linewidth=0.8, linestyle=":")
    if compared:
        _draw_allowed(answer, axes, upright=True)
    axes.margins(0.2)
    axes.set(xlabel="contrast [dB]" if compared else "case", ylabel="level in the target\nover that wanted")
    axes.set_title(title, fontsize=8)


def _draw_allowed(answer: SpecifiedDrive, axes: Axes, upright: bool = False, below: bool = False) -> None:
    """Draw the contrast that is allowed as a line, named above its start, below its end, or upright at the top."""
    if not np.isfinite(answer.allowed_db):
        return
    draw = axes.axvline if upright else axes.axhline
    draw(answer.allowed_db, color=LIMIT, linewidth=1.0, linestyle="--", label="allowed")
    place, along = (float(below), answer.allowed_db), ("axes fraction", "data")
    if upright:
        place, along = (answer.allowed_db, 1.0), ("data", "axes fraction")
    axes.annotate(
        "allowed", place, (-3 if below else 3, -3 if below or upright else 3), along, "offset points", color=LIMIT,
        ha="right" if below else "left", va="top" if below or upright else "bottom", rotation=90 * upright, fontsize=8,
    )  # fmt: skip
