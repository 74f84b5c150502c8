"""Plates seen from above in Matplotlib: fields of motions side by side, and the layout of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.result.targets import outlines
from warp_plate.scene.model import Area, Scene
from warp_plate.viz.annotations import INK, TARGET
from warp_plate.viz.captions import frame_caption
from warp_plate.viz.edge_styles import EDGE_STYLES, edge_kind, edges_by_kind
from warp_plate.viz.fields import DrawingScale, common_scale, field_of
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.side_by_side import rows_and_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D

# Longer side of a plate [inch].
LENGTH = 2.3
LAYER, OSCILLATOR = "#8c6bb1", "#e6820e"


def draw_plan(scene: Scene, motions: Sequence[Motion], path: Path, quantity: str, frame: int) -> None:
    """Draw one frame of all motions from above with common colours.

    Args:
        quantity: field in colour, a key of FIELDS.
    """
    from matplotlib.cm import ScalarMappable

    shown = field_of(motions, quantity)
    scale = common_scale(scene, motions, shown)
    rows, columns = rows_and_columns(len(motions))
    width, height = drawn_size(scene, LENGTH)
    size = (max(columns * (width + 0.45), 3.2) + 0.9, rows * (height + 0.75) + 0.3)
    with figure(path, size, font_size=8) as made:
        panels = made.subplots(rows, columns, squeeze=False)
        for axes, motion in zip(panels.flat, motions, strict=False):
            values = shown.values(motion)
            placed = motion.scene or scene
            draw_field(axes, scene, values[frame % len(values)], scale)
            _draw_patches(axes, placed)
            draw_edges(axes, placed)
            _label_sides(axes, scene)
            caption = frame_caption(motion, frame, scene)
            # A field without time dependence belongs to no moment.
            axes.set_title(caption if len(values) > 1 else _without_time(caption), fontsize=8, pad=6)
        for axes in panels.flat[len(motions) :]:
            axes.set_axis_off()
        for axes in panels[:, 0]:
            axes.set_ylabel("y [m]")
        for column in panels.T:
            [axes for axes in column if axes.axison][-1].set_xlabel("x [m]")
        bar = made.colorbar(ScalarMappable(_norm(scale), shown.cmap), ax=panels, aspect=22, pad=0.02)
        bar.set_label(scale.title.replace("\n", " "))
        if shown.kind == "cyclic":
            bar.set_ticks([-180, -90, 0, 90, 180])
        made.legend(handles=_patch_handles(scene), loc="outside lower center", ncols=6, fontsize=7)


def draw_layout(scene: Scene, path: Path) -> None:
    """Draw edges, targets, actuators, layers and oscillators of a scene."""
    width, height = drawn_size(scene, LENGTH)
    with figure(path, (max(width, 2.6) + 0.7, height + 0.9), font_size=8, dpi=110) as made:
        axes = made.subplots()
        for layer in scene.effects.layers:
            x0, x1, y0, y1 = layer.area
            axes.fill([x0, x1, x1, x0], [y0, y0, y1, y1], color=LAYER, alpha=0.3)
        for oscillator in scene.effects.oscillators:
            draw_outline(axes, oscillator.area, OSCILLATOR)
        _draw_patches(axes, scene)
        draw_edges(axes, scene)
        _label_sides(axes, scene)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        handles = _patch_handles(scene)
        if scene.effects.layers:
            handles.append(_handle(LAYER, "layer", linewidth=4, alpha=0.3))
        if scene.effects.oscillators:
            handles.append(_handle(OSCILLATOR, "oscillator", linewidth=0.9))
        made.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=7)


def drawn_size(scene: Scene, length: float) -> tuple[float, float]:
    """Return the width and height of a plate whose longer side is drawn with this length."""
    width, height = (length * side / max(scene.plate.size) for side in scene.plate.size)
    return width, height


def draw_edges(axes: Axes, scene: Scene) -> None:
    """Draw the edges by their support, and fit the axes to the plate without ticks."""
    width, height = scene.plate.size
    ends = {
        "left": ((0, 0), (0, height)),
        "bottom": ((0, width), (0, 0)),
        "right": ((width, width), (0, height)),
        "top": ((0, width), (height, height)),
    }
    for edge, (x, y) in ends.items():
        axes.plot(x, y, clip_on=False, zorder=3, **EDGE_STYLES[edge_kind(getattr(scene.edges, edge))].matplotlib)
    axes.set_aspect("equal")
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def draw_outline(axes: Axes, area: Area, colour: str, style: str = "-") -> None:
    """Draw the outline of a rectangle."""
    x0, x1, y0, y1 = area
    corners = [x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0]
    axes.plot(*corners, color=colour, linewidth=0.9, linestyle=style, clip_on=False, zorder=2)


def edge_handles(scene: Scene) -> list[Line2D]:
    """Return legend handles of the kinds of edges in the scene."""
    from matplotlib.lines import Line2D

    styles = [EDGE_STYLES[kind] for kind in edges_by_kind(scene)]
    return [Line2D([], [], **style.matplotlib, label=style.label) for style in styles]


def draw_field(axes: Axes, scene: Scene, values: np.ndarray, scale: DrawingScale) -> None:
    """Draw (ny, nx) values as colours; the colour of a node reaches half a cell beyond the edge."""
    from matplotlib import colormaps

    (width, height), (ny, nx) = scene.plate.size, values.shape
    half_x, half_y = width / (nx - 1) / 2, height / (ny - 1) / 2
    cmap = colormaps[scale.field.cmap].with_extremes(bad=scale.field.nan_colour)
    # Interpolate colours, not values: halfway between 179° and −179° lies 180°, not 0°.
    colours = cmap(_norm(scale)(np.ma.masked_invalid(values * scale.unit_factor)))
    extent = (-half_x, width + half_x, -half_y, height + half_y)
    axes.imshow(colours, origin="lower", extent=extent, interpolation="bilinear")


def _draw_patches(axes: Axes, scene: Scene) -> None:
    for actuator in scene.actuators:
        draw_outline(axes, actuator.area, INK)
    for outline in outlines(scene):
        axes.plot(*outline.T, color=TARGET, linewidth=1.4, clip_on=False, zorder=4)


def _label_sides(axes: Axes, scene: Scene) -> None:
    width, height = scene.plate.size
    axes.set_xticks([0, width / 2, width])
    axes.set_yticks([0, height / 2, height])


def _patch_handles(scene: Scene) -> list[Line2D]:
    target, actuator = _handle(TARGET, "target", linewidth=1.4), _handle(INK, "actuator", linewidth=0.9)
    return [target, actuator, *edge_handles(scene)]


def _handle(colour: str, label: str, **style: float) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, label=label, **style)


def _norm(scale: DrawingScale) -> Normalize:
    from matplotlib.colors import Normalize

    return Normalize(*scale.clim)


def _without_time(caption: str) -> str:
    return "\n".join(line.split(", t = ")[0] for line in caption.split("\n"))
