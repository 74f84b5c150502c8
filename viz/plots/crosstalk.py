"""Drives for several targets: the table of their crosstalk, and what the plate does under each, seen from above."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.crosstalk import crosstalk, decibels, target_cases
from warp_plate.result.model import Result
from warp_plate.result.outlines import target_outlines
from warp_plate.viz.lettering import INK, TARGET
from warp_plate.viz.plots.plan import frame, outline, paint
from warp_plate.viz.quantity import scale_over

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

# Inches: width and height of a cell of the table, the longer side of a plate, and how many of these stand in a row.
CELL, PLATE, IN_A_ROW = (0.9, 0.42), 1.9, 4
# Inches that the words below the plates take: width, and height of their two lines.
WORDS = (3.0, 0.4)
# Inches of a letter, and of a further line of a name that is broken.
LETTER, LINE = 0.07, 0.13


def draw_crosstalk(result: Result, path: str | Path, form: str | None = None) -> Path:
    """The table and the plates as PNG, SVG or PDF, by ``form`` or the path's ending.

    A plate is drawn at the recorded time at which it moves most, in colours up to its own largest displacement.

    Raises:
        ValueError: the result's scene has one target only, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    names = target_cases(result.scene)
    if not names:
        raise ValueError("the result has no crosstalk: its scene has one target only")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = {target: case for target, case in names.items() if case in result.cases and result.times.size}
    rows, columns = math.ceil(len(drawn) / IN_A_ROW), min(len(drawn), IN_A_ROW)
    width, height = (PLATE * side / max(result.scene.plate.size) for side in result.scene.plate.size)
    (wide, table), plates = (side * len(names) for side in CELL), rows * (height + 0.3) + WORDS[1]
    wide = max(wide + 1.5, columns * (width + 0.2), WORDS[0])
    words = [_broken(name, CELL[0]) for name in names]
    titles = {case: _broken(f"drive for {target}", wide / columns) for target, case in drawn.items()}
    table += 0.6 + LINE * max(name.count("\n") for name in words)
    plates += LINE * rows * max((title.count("\n") for title in titles.values()), default=0)
    with rc_context({"font.size": 8, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(wide, table + plates), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subfigures(2, 1, height_ratios=[table, plates or 1e-3])
        _table(above.subplots(), words, crosstalk(result))
        if drawn:
            _plates(below, result, drawn, titles, rows, columns)
        figure.savefig(path, dpi=200, format=form)
    return Path(path)


def _table(axes: Axes, names: list[str], shares: np.ndarray) -> None:
    axes.imshow(np.nan_to_num(shares), cmap="Greens", vmin=0, vmax=1, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        against = decibels(shares)[row, column]
        text = f"{100 * share:.1f} %" if math.isfinite(share) else "not\nsearched"
        if row != column and math.isfinite(against):
            text += f"\n{against:+.1f} dB".replace("-", "−")
        weight, colour = "bold" if row == column else "normal", "white" if share > 0.55 else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=colour, fontweight=weight)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    axes.set_xlabel("share of the plate's kinetic energy in")
    axes.set_ylabel("under the drive for")
    axes.spines[:].set_visible(False)


def _broken(words: str, width: float) -> str:
    """In lines of at most this width in inches."""
    return textwrap.fill(words, int(width / LETTER))


def _plates(
    figure: SubFigure, result: Result, drawn: dict[str, str], titles: dict[str, str], rows: int, columns: int
) -> None:
    panels = figure.subplots(rows, columns, squeeze=False)
    targets = {target.name: (key, target) for key, target in zip(
        result.scene.targets_by_key, result.scene.targets, strict=True
    )}  # fmt: skip
    for axes, (name, case) in zip(panels.flat, drawn.items(), strict=False):
        fields = np.nan_to_num(result.cases[case].displacement, posinf=0, neginf=0)
        field = fields[np.abs(fields).max(axis=(1, 2)).argmax()]
        paint(axes, result.scene, field, scale_over([field], result.scene.plate.size))
        for actuator in result.case_scene(result.cases[case]).actuators:
            outline(axes, actuator.area, INK)
        for other, (key, target) in targets.items():
            for way in target_outlines(result.scene, key, target):
                look = {"linewidth": 2.2} if other == name else {"linewidth": 0.8, "linestyle": "--"}
                axes.plot(*way.T, color=TARGET, clip_on=False, zorder=4, **look)
        frame(axes, result.scene)
        axes.set_title(titles[case], fontsize=8)
    width, height = result.scene.plate.size
    words = f"displacement of the plate, {width:g} m × {height:g} m:\nred up, blue down, each in its own scale"
    figure.supxlabel(words, fontsize=8)
    for axes in list(panels.flat)[len(drawn) :]:
        axes.set_axis_off()
