"""Crosstalk of the drives for several targets: a table of energy shares, and the plate under each drive."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.model import Result
from warp_plate.result.targets import crosstalk, decibels, target_cases, target_outlines
from warp_plate.scene.errors import printable
from warp_plate.viz.colours import DEFAULT_COLOURS, ColourOptions
from warp_plate.viz.fields import DrawingScale, drawing_scale
from warp_plate.viz.plots.frame import add_panels, figure
from warp_plate.viz.plots.plan import draw_edges, draw_field, draw_outline, drawn_size
from warp_plate.viz.styles import INK, TARGET, size_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# All lengths in inches: cell of the table, longer side of a plate, note below the plates, letter, line of text.
CELL, PLATE, NOTE, LETTER, LINE = (0.9, 0.42), 1.9, (3.0, 0.4), 0.07, 0.13
PLATES_PER_ROW = 4


def draw_crosstalk(result: Result, path: str | Path, colours: ColourOptions = DEFAULT_COLOURS) -> None:
    """Draw the table, and each plate at the recorded time of its largest displacement, by default within limits of its
    own."""
    cases = target_cases(result.scene)
    drawn = {target: case for target, case in cases.items() if case in result.cases and result.times.size}
    rows, columns = math.ceil(len(drawn) / PLATES_PER_ROW), min(len(drawn), PLATES_PER_ROW)
    width, height = drawn_size(result.scene, PLATE)
    total_width = max(CELL[0] * len(cases) + 1.5, columns * (width + 0.2), NOTE[0])
    names = [_wrapped(printable(name), CELL[0]) for name in cases]
    titles = {target: _wrapped(f"drive for {target}", total_width / columns) for target in drawn}
    table_height = CELL[1] * len(cases) + 0.6 + LINE * max(name.count("\n") for name in names)
    title_lines = max((title.count("\n") for title in titles.values()), default=0)
    plates_height = rows * (height + 0.3 + LINE * title_lines) + NOTE[1]
    with figure(path, (total_width, table_height + plates_height), font_size=8) as made:
        above, below = made.subfigures(2, 1, height_ratios=[table_height, plates_height])
        _draw_table(above.subplots(), names, crosstalk(result))
        if drawn:
            fields = {target: _largest_field(result, case) for target, case in drawn.items()}
            scales = _scales(result, fields, colours)
            for axes, (target, case) in zip(add_panels(below, len(drawn), columns), drawn.items(), strict=True):
                _draw_plate(axes, result, target, case, fields[target], scales[target])
                axes.set_title(titles[target], fontsize=8)
            below.supxlabel(_note(result, list(scales.values())), fontsize=8)


def _draw_table(axes: Axes, names: list[str], shares: np.ndarray) -> None:
    levels = decibels(shares)
    axes.imshow(np.nan_to_num(shares), cmap="Greens", vmin=0, vmax=1, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        text = f"{100 * share:.1f} %" if math.isfinite(share) else "not\nsearched"
        if row != column and math.isfinite(levels[row, column]):
            text += f"\n{levels[row, column]:+.1f} dB".replace("-", "−")
        weight, colour = "bold" if row == column else "normal", "white" if share > 0.55 else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=colour, fontweight=weight)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    axes.set(xlabel="share of the plate's kinetic energy in", ylabel="under the drive for")
    axes.spines[:].set_visible(False)


def _largest_field(result: Result, case: str) -> np.ndarray:
    """Return the (ny, nx) displacement [m] of a case at the recorded time when it is largest."""
    displacements = np.nan_to_num(result.cases[case].displacement, posinf=0, neginf=0)
    return np.asarray(displacements[np.abs(displacements).max(axis=(1, 2)).argmax()])


def _scales(result: Result, fields: dict[str, np.ndarray], colours: ColourOptions) -> dict[str, DrawingScale]:
    """Return the scale of each field, by default its own."""
    together = list(fields.values()) if colours.limits == "common" else None
    size = result.scene.plate.size
    return {name: drawing_scale(together or [field], size, colours=colours) for name, field in fields.items()}


def _note(result: Result, scales: list[DrawingScale]) -> str:
    """Return what the colours of the plates mean."""
    limits = [f"{scale.clim[1]:.4g} {scale.unit}" for scale in scales]
    ends = limits[0] if len(set(limits)) == 1 else f"{', '.join(limits[:-1])} and {limits[-1]}"
    words = "red up, blue down" if scales[0].colormap is None else "the ends of the colour map are"
    return f"displacement of the plate, {size_text(result.scene.plate.size)}:\n{words} to ±{ends}"


def _draw_plate(axes: Axes, result: Result, name: str, case: str, field: np.ndarray, scale: DrawingScale) -> None:
    scene = result.scene
    draw_field(axes, scene, field, scale)
    for actuator in result.case_scene(result.cases[case]).actuators:
        draw_outline(axes, actuator.area, INK)
    for key, target in zip(scene.targets_by_key, scene.targets, strict=True):
        style = {"linewidth": 2.2} if target.name == name else {"linewidth": 0.8, "linestyle": "--"}
        for outline in target_outlines(scene, key, target):
            axes.plot(*outline.T, color=TARGET, clip_on=False, zorder=4, **style)
    draw_edges(axes, scene)


def _wrapped(text: str, width: float) -> str:
    """Wrap text to a width [inch]."""
    return textwrap.fill(text, int(width / LETTER))
