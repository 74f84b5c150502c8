"""Fields seen from above, in Matplotlib: what plots of them have in common, and the plot of motions side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.result.outlines import outlines
from warp_plate.scene.model import Area, Scene
from warp_plate.viz.comparison import common_scale, heading, quantity_of, rows_and_columns
from warp_plate.viz.edges import SIDES, edge_kind, kinds_of
from warp_plate.viz.lettering import INK, TARGET
from warp_plate.viz.quantity import Scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D

# Of the longer side of a plate, in inches.
PICTURE = 2.3


def draw_plan(
    scene: Scene, motions: Sequence[Motion], path: Path, quantity: str, frame_shown: int, form: str | None = None
) -> None:
    """One frame of all motions from above, with common colours; PNG, SVG or PDF by ``form`` or the path's ending.

    Args:
        quantity: in colour, a key of QUANTITIES.

    Raises:
        ValueError: Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    shown = quantity_of(motions, quantity)
    scale = common_scale(scene, motions, shown)
    rows, columns = rows_and_columns(len(motions))
    width, height = (PICTURE * side / max(scene.plate.size) for side in scene.plate.size)
    with rc_context({"font.size": 8, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        size = (max(columns * (width + 0.45), 3.2) + 0.9, rows * (height + 0.75) + 0.3)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(rows, columns, squeeze=False)
        for axes, motion in zip(panels.flat, motions, strict=False):
            fields = shown.values(motion)
            _draw(axes, motion.scene or scene, fields[frame_shown % len(fields)], scale)
            title = heading(motion, frame_shown, scene)
            # A field that is the same at all times has no moment.
            axes.set_title(title if len(fields) > 1 else _without_time(title), fontsize=8, pad=6)
        for axes in panels.flat[len(motions) :]:
            axes.set_axis_off()
        for axes in panels[:, 0]:
            axes.set_ylabel("y [m]")
        for column in panels.T:
            [axes for axes in column if axes.axison][-1].set_xlabel("x [m]")
        bar = figure.colorbar(ScalarMappable(_norm(scale), shown.colours), ax=panels, aspect=22, pad=0.02)
        bar.set_label(scale.title.replace("\n", " "))
        if shown.kind == "cyclic":
            bar.set_ticks([-180, -90, 0, 90, 180])
        lines = [
            Line2D([], [], color=TARGET, linewidth=1.4, label="target"),
            Line2D([], [], color=INK, linewidth=0.9, label="actuator"),
            *side_lines(scene),
        ]
        figure.legend(handles=lines, loc="outside lower center", ncols=6, frameon=False, fontsize=7)
        figure.savefig(path, dpi=200, format=form)


def frame(axes: Axes, scene: Scene) -> None:
    """The sides of the plate by what holds them, in axes of its size without ticks."""
    width, height = scene.plate.size
    ends = {
        "left": ((0, 0), (0, height)),
        "bottom": ((0, width), (0, 0)),
        "right": ((width, width), (0, height)),
        "top": ((0, width), (height, height)),
    }
    for side, (x, y) in ends.items():
        axes.plot(x, y, clip_on=False, zorder=3, **SIDES[edge_kind(getattr(scene.edges, side))].matplotlib)
    axes.set_aspect("equal")
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def outline(axes: Axes, area: Area, colour: str, dashes: str = "-", width: float = 0.9, above: int = 2) -> None:
    """The way round an area."""
    x0, x1, y0, y1 = area
    ways = [x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0]
    axes.plot(*ways, color=colour, linewidth=width, linestyle=dashes, clip_on=False, zorder=above)


def side_lines(scene: Scene) -> list[Line2D]:
    """What stands in a key for the sides."""
    from matplotlib.lines import Line2D

    return [Line2D([], [], **SIDES[kind].matplotlib, label=SIDES[kind].words) for kind in kinds_of(scene)]


def paint(axes: Axes, scene: Scene, field: np.ndarray, scale: Scale) -> None:
    """The field (ny, nx), a node's colour reaching half a cell beyond the plate's edge."""
    from matplotlib import colormaps

    (width, height), (ny, nx) = scene.plate.size, field.shape
    half_x, half_y = width / (nx - 1) / 2, height / (ny - 1) / 2
    colours = colormaps[scale.quantity.colours].with_extremes(bad=scale.quantity.no_number)
    # Colours are mixed between nodes, not values: between 179° and −179° lies 180°, not 0°.
    painted = colours(_norm(scale)(np.ma.masked_invalid(field * scale.per_base)))
    extent = (-half_x, width + half_x, -half_y, height + half_y)
    axes.imshow(painted, origin="lower", extent=extent, interpolation="bilinear")


def _draw(axes: Axes, scene: Scene, field: np.ndarray, scale: Scale) -> None:
    width, height = scene.plate.size
    paint(axes, scene, field, scale)
    for actuator in scene.actuators:
        outline(axes, actuator.area, INK)
    for way in outlines(scene):
        axes.plot(*way.T, color=TARGET, linewidth=1.4, clip_on=False, zorder=4)
    frame(axes, scene)
    axes.set_xticks([0, width / 2, width])
    axes.set_yticks([0, height / 2, height])


def _norm(scale: Scale) -> Normalize:
    from matplotlib.colors import Normalize

    return Normalize(*scale.limits)


def _without_time(title: str) -> str:
    return "\n".join(line.split(", t = ")[0] for line in title.split("\n"))
