"""Plates seen from above in Matplotlib: fields of motions side by side, and the layout of a scene."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.result.targets import outlines
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.viz.captions import frame_caption
from warp_plate.viz.fields import DrawingScale, common_scale
from warp_plate.viz.plots.frame import add_panels, figure
from warp_plate.viz.scene3d import rows_and_columns
from warp_plate.viz.styles import EDGE_STYLES, INK, TARGET, edges_by_kind, rectangle

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

# Longer side of a plate [inch].
LENGTH = 2.3
LAYER, OSCILLATOR = "#8c6bb1", "#e6820e"


def draw_plan(scene: Scene, motions: Sequence[Motion], path: Path, quantity: str, frame: int) -> None:
    """Draw one frame of all motions from above, the quantity (a key of FIELDS) in common colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale, fields = common_scale(scene, motions, quantity)
    rows, columns = rows_and_columns(len(motions))
    width, height = drawn_size(scene, LENGTH)
    size = (max(columns * (width + 0.45), 3.2) + 0.9, rows * (height + 0.75) + 0.3)
    with figure(path, size, font_size=8) as made:
        panels = add_panels(made, len(motions), columns)
        for index, (axes, motion, values) in enumerate(zip(panels, motions, fields, strict=True)):
            caption = frame_caption(motion, frame, scene)
            draw_field(axes, scene, values[frame % len(values)], scale)
            _draw_outlines(axes, motion.scene or scene)
            # A field without time dependence belongs to no moment.
            axes.set_title(caption if len(values) > 1 else re.sub(", t = .*", "", caption), fontsize=8, pad=6)
            axes.set_xlabel("x [m]" if index + columns >= len(motions) else "")
            axes.set_ylabel("y [m]" if index % columns == 0 else "")
        bar = made.colorbar(ScalarMappable(Normalize(*scale.clim), scale.field.cmap), ax=panels, aspect=22, pad=0.02)
        bar.set_label(scale.title.replace("\n", " "))
        if scale.field.kind == "cyclic":
            bar.set_ticks([-180, -90, 0, 90, 180])
        made.legend(handles=_outline_handles(scene), loc="outside lower center", ncols=6, fontsize=7)


def draw_layout(scene: Scene, path: Path) -> None:
    """Draw edges, targets, actuators, layers and oscillators of a scene."""
    width, height = drawn_size(scene, LENGTH)
    with figure(path, (max(width, 2.6) + 0.7, height + 0.9), font_size=8, dpi=110) as made:
        axes, handles = made.subplots(), _outline_handles(scene)
        layers = [
            axes.fill(*zip(*rectangle(layer.area), strict=True), color=LAYER, alpha=0.3, label="layer")[0]
            for layer in scene.layers
        ]
        handles += layers[:1]
        for oscillator in scene.effects.oscillators:
            draw_outline(axes, oscillator.area, OSCILLATOR)
        if scene.effects.oscillators:
            handles.append(line_handle("oscillator", color=OSCILLATOR, linewidth=0.9))
        _draw_outlines(axes, scene)
        axes.set(xlabel="x [m]", ylabel="y [m]")
        made.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=7)


def drawn_size(scene: Scene, length: float) -> tuple[float, float]:
    """Return the width and height of a plate whose longer side is drawn with this length."""
    width, height = (length * side / max(scene.plate.size) for side in scene.plate.size)
    return width, height


def draw_edges(axes: Axes, scene: Scene) -> None:
    """Draw the edges by their support, and fit the axes to the plate without ticks."""
    for kind, edges in edges_by_kind(scene).items():
        for ends in edges.values():
            axes.plot(*zip(*ends, strict=True), clip_on=False, zorder=3, **EDGE_STYLES[kind].matplotlib)
    width, height = scene.plate.size
    axes.set(aspect="equal", xlim=(0, width), ylim=(0, height), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def draw_outline(axes: Axes, area: Area, colour: str, style: str = "-") -> None:
    """Draw the outline of a rectangle."""
    corners = zip(*rectangle(area), strict=True)
    axes.plot(*corners, color=colour, linewidth=0.9, linestyle=style, clip_on=False, zorder=2)


def edge_handles(scene: Scene) -> list[Line2D]:
    """Return legend handles of the kinds of edges in the scene."""
    styles = [EDGE_STYLES[kind] for kind in edges_by_kind(scene)]
    return [line_handle(style.label, **style.matplotlib) for style in styles]


def line_handle(label: str, **style: Any) -> Line2D:
    """Return a legend handle of a line."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def draw_field(axes: Axes, scene: Scene, values: np.ndarray, scale: DrawingScale) -> None:
    """Draw (ny, nx) values as colours; the colour of a node reaches half a cell beyond the edge."""
    from matplotlib import colormaps
    from matplotlib.colors import Normalize

    (width, height), (ny, nx) = scene.plate.size, values.shape
    half_x, half_y = width / (nx - 1) / 2, height / (ny - 1) / 2
    cmap = colormaps[scale.field.cmap].with_extremes(bad=scale.field.nan_colour)
    # Interpolate colours, not values: halfway between 179° and −179° lies 180°, not 0°.
    colours = cmap(Normalize(*scale.clim)(np.ma.masked_invalid(values * scale.unit_factor)))
    extent = (-half_x, width + half_x, -half_y, height + half_y)
    axes.imshow(colours, origin="lower", extent=extent, interpolation="bilinear")


def _draw_outlines(axes: Axes, scene: Scene) -> None:
    """Draw actuators, targets and edges, with ticks at the ends and in the middle."""
    for actuator in scene.actuators:
        draw_outline(axes, actuator.area, INK)
    for outline in outlines(scene):
        axes.plot(*outline.T, color=TARGET, linewidth=1.4, clip_on=False, zorder=4)
    draw_edges(axes, scene)
    axes.set(xticks=np.linspace(0, scene.plate.size[0], 3), yticks=np.linspace(0, scene.plate.size[1], 3))


def _outline_handles(scene: Scene) -> list[Artist]:
    target = line_handle("target", color=TARGET, linewidth=1.4)
    return [target, line_handle("actuator", color=INK, linewidth=0.9), *edge_handles(scene)]
