"""Plates seen from above: motions side by side, the layout of a scene, and the crosstalk of several targets."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.effects.effect import attachments
from warp_plate.plate.designs import patch_ends
from warp_plate.plate.shapes import outlines
from warp_plate.result.motion import Motion
from warp_plate.scene.errors import printable
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion
from warp_plate.viz.annotations import (
    EDGE_STYLES,
    INK,
    TARGET,
    edges_by_kind,
    frame_caption,
    length_unit,
    only_points,
    shortened,
)
from warp_plate.viz.fields import DrawingScale, PictureStyle, colour_map, motion_scales
from warp_plate.viz.outlined import clip, continued, on_plate
from warp_plate.viz.plots.frame import add_panels, figure
from warp_plate.viz.scene3d import rows_and_columns

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from warp_plate.result.model import Result

# Longer side of a plate [inch].
LENGTH = 2.3
# Size of actuators' names [pt].
NAME_SIZE = 6
LAYER, OSCILLATOR, PLATE = "#8c6bb1", "#e6820e", "#eef1f4"
# Most letters of a line of a target's name.
NAME_WIDTH = 13


def draw_plan(scene: Scene, motions: Sequence[Motion], path: Path, style: PictureStyle, frame: int) -> None:
    """Draw one frame of all motions from above."""
    scales, fields = motion_scales(scene, motions, style.quantity, style.colours)
    rows, columns = rows_and_columns(len(motions))
    width, height = drawn_size(scene, LENGTH)
    wide, lines = width + 0.45 + 0.6 * style.colours.separate, 1 + (len(fields[0]) > 1)
    size = (max(columns * wide, 3.2) + 0.9 - 0.6 * style.colours.separate, rows * (height + 0.75 + 0.15 * lines) + 0.3)
    with figure(path, size, font_size=8) as fig:
        panels = add_panels(fig, len(motions), columns)
        for index, (axes, motion, scale, values) in enumerate(zip(panels, motions, scales, fields, strict=True)):
            caption = frame_caption(motion, frame, scene)
            draw_field(axes, scene, values[frame % len(values)], scale)
            draw_parts(axes, motion.scene or scene)
            # Captions of constant fields have no time.
            time = r"\n\1" if len(values) > 1 else ""
            axes.set_title(re.sub(", (t = .*)", time, caption), fontsize=8, pad=6)
            label_sides(axes, scene, index + columns >= len(motions), index % columns == 0)
            if style.colours.separate:
                _add_bar(fig, scale, axes)
        if not style.colours.separate:
            _add_bar(fig, scales[0], panels)
        fig.legend(handles=outline_handles(scene), loc="outside lower center", ncols=6, fontsize=7)


def draw_layout(scene: Scene, path: Path) -> None:
    """Draw edges, targets, actuators, layers and attached masses of a scene."""
    width, height = drawn_size(scene, LENGTH)
    with figure(path, (max(width, 2.6) + 0.7, height + 0.9), font_size=8, dpi=110) as fig:
        axes, handles = fig.subplots(), outline_handles(scene)
        if scene.plate.outline is not None:
            x, y = scene.plate.size
            clip(axes.fill([0, x, x, 0], [0, 0, y, y], color=PLATE, zorder=0)[0], axes, scene)
        layers = [axes.fill(*layer.flattened().T, color=LAYER, alpha=0.3, label="layer")[0] for layer in scene.layers]
        for layer in layers:
            clip(layer, axes, scene)
        handles += layers[:1]
        for attachment in attachments(scene.terms):
            draw_outline(axes, scene, attachment.region, OSCILLATOR)
        if attachments(scene.terms):
            handles.append(line_handle("oscillator", color=OSCILLATOR, linewidth=0.9))
        draw_parts(axes, scene)
        label_sides(axes, scene)
        fig.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=7)


def drawn_size(scene: Scene, length: float) -> tuple[float, float]:
    """Return the width and height of a plate whose longer side is drawn with this length."""
    width, height = (length * side / max(scene.plate.size) for side in scene.plate.size)
    return width, height


def place_names(names: Sequence[str], patches: np.ndarray, plate: np.ndarray, letter: float) -> np.ndarray:
    """Return the middles (names, 2) of names beside patches (names, axis, 2) of a plate (axis, 2), with this width of a
    letter; none if they do not all fit.

    A name stands above a patch of the lower half and below others, or where that is taken on another side.
    """
    middles, taken = np.empty((0, 2)), patches
    for name, patch in zip(names, patches, strict=True):
        half = letter * np.array([len(name) / 2, 1.0])
        if (2 * half > np.ptp(plate, axis=1)).any():
            return middles[:0]
        inwards = 1 if patch[1].mean() < plate[1].mean() else -1
        sides = np.array([(0, inwards), (0, -inwards), (1, 0), (-1, 0)])
        places = patch.mean(axis=1) + sides * (np.ptp(patch, axis=1) / 2 + half)
        places = np.clip(places, plate[:, 0] + half, plate[:, 1] - half)
        boxes = np.stack([places - half, places + half], axis=2)
        shared = np.minimum(boxes[:, None, :, 1], taken[:, :, 1]) - np.maximum(boxes[:, None, :, 0], taken[:, :, 0])
        free = np.flatnonzero(~(shared > 1e-9 * np.ptp(plate)).all(axis=2).any(axis=1))
        if not free.size:
            return middles[:0]
        middles = np.append(middles, places[free[:1]], axis=0)
        taken = np.append(taken, boxes[free[:1]], axis=0)
    return middles


def draw_edges(axes: Axes, scene: Scene) -> None:
    """Draw the edges by their support, and fit the axes to the plate without ticks."""
    for kind, edges in edges_by_kind(scene).items():
        for ends in edges:
            axes.plot(*zip(*ends, strict=True), clip_on=False, zorder=3, **EDGE_STYLES[kind].matplotlib)
    width, height = scene.plate.size
    axes.set(aspect="equal", xlim=(0, width), ylim=(0, height), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def draw_outline(axes: Axes, scene: Scene, region: PlateRegion, colour: str, style: str = "-") -> None:
    """Draw the outline of the part of a region that is on the plate."""
    look = {"linewidth": 0.9, "linestyle": style, "path_effects": light_rim(0.9)}
    for path in on_plate(scene, [region.closed_path()]):
        axes.plot(*path.T, color=colour, clip_on=False, zorder=2, **look)


def light_rim(width: float) -> list[Any]:
    """Return the path effects that set a line of this width [pt] off against dark colours."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width + 1.4, foreground="white", alpha=0.6), Normal()]


def edge_handles(scene: Scene) -> list[Line2D]:
    """Return legend handles of the kinds of edges in the scene."""
    circle = {"linestyle": "", "marker": "o", "markerfacecolor": "none", "markersize": 4}
    looks = [(kind, EDGE_STYLES[kind]) for kind in edges_by_kind(scene)]
    as_circle = {"support": circle} if only_points(scene) else {}
    return [line_handle(style.label, **{**style.matplotlib, **as_circle.get(kind, {})}) for kind, style in looks]


def line_handle(label: str, **style: Any) -> Line2D:
    """Return a legend handle of a line."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def draw_field(axes: Axes, scene: Scene, values: np.ndarray, scale: DrawingScale) -> None:
    """Draw (ny, nx) values as colours; the colour of a node reaches half a cell beyond the edge."""
    from matplotlib.colors import Normalize

    (width, height), (ny, nx) = scene.plate.size, values.shape
    half_x, half_y = width / (nx - 1) / 2, height / (ny - 1) / 2
    cmap = colour_map(scale.cmap).with_extremes(bad=scale.field.nan_colour)
    # Interpolate colours, not values: halfway between 179° and −179° lies 180°, not 0°.
    values = continued(scene, values * scale.unit_factor, scale.field.kind != "cyclic")
    colours = cmap(Normalize(*scale.clim)(np.ma.masked_invalid(values)))
    extent = (-half_x, width + half_x, -half_y, height + half_y)
    clip(axes.imshow(colours, origin="lower", extent=extent, interpolation="bilinear"), axes, scene)


def draw_parts(axes: Axes, scene: Scene) -> None:
    """Draw actuators, targets and edges."""
    draw_actuators(axes, scene)
    for outline in on_plate(scene, outlines(scene)):
        axes.plot(*outline.T, color=TARGET, linewidth=1.4, clip_on=False, zorder=4, path_effects=light_rim(1.4))
    draw_edges(axes, scene)


def draw_actuators(axes: Axes, scene: Scene, length: float = LENGTH) -> None:
    """Draw the outlines of actuators; and their names and those of several targets, as many as fit on a plate of this
    longer side [inch]: all, those of actuators, or none."""
    for actuator in scene.actuators:
        draw_outline(axes, scene, actuator, INK)
    parts = (*scene.actuators, *scene.targets)
    names, boxes = [shortened(part.name) for part in parts], patch_ends(parts)
    plate = np.array([(0.0, side) for side in scene.plate.size])
    letter = 0.6 * NAME_SIZE / 72 / length * max(scene.plate.size)
    middles = place_names(names, boxes, plate, letter)
    if not middles.size:
        count = len(scene.actuators)
        middles = place_names(names[:count], boxes[:count], plate, letter)
    centred = {"ha": "center", "va": "center", "zorder": 5}
    for part, name, (x, y) in zip(parts, names, middles, strict=False):
        colour = INK if part in scene.actuators else TARGET
        axes.text(x, y, name, fontsize=NAME_SIZE, color=colour, path_effects=light_rim(0), **centred)


def label_sides(axes: Axes, scene: Scene, bottom: bool = True, left: bool = True) -> None:
    """Put round ticks on the lower and left sides, in mm for small plates; name the axes as asked."""
    from matplotlib.ticker import MaxNLocator

    unit, factor = length_unit(scene.plate.size)
    for axis, name, named in ((axes.xaxis, "x", bottom), (axes.yaxis, "y", left)):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(lambda value, _: f"{factor * value:.6g}")
        axis.set_label_text(f"{name} [{unit}]" if named else "")


def _add_bar(fig: Figure, scale: DrawingScale, axes: Axes | Sequence[Axes]) -> None:
    """Add the colour bar of a scale beside axes."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    look = {"aspect": 22, "pad": 0.02, "extend": "both" if scale.field.kind == "level" else "neither"}
    bar = fig.colorbar(ScalarMappable(Normalize(*scale.clim), colour_map(scale.cmap)), ax=axes, **look)
    bar.set_label(scale.title.replace("\n", " "))
    bar.set_ticks(scale.ticks, labels=[f"{tick:.4g}".replace("-", "−") for tick in scale.ticks])


def outline_handles(scene: Scene) -> list[Artist]:
    target = line_handle("target", color=TARGET, linewidth=1.4)
    return [target, line_handle("actuator", color=INK, linewidth=0.9), *edge_handles(scene)]


def draw_crosstalk(result: Result, path: str | Path) -> None:
    """Draw the shares of the plate's kinetic energy in each target under the drive for each."""
    from warp_plate.result.case import relative_to_own, target_cases
    from warp_plate.result.model import crosstalk

    names = [textwrap.fill(printable(name), NAME_WIDTH) for name in target_cases(result.scene.targets)]
    shares = crosstalk(result)
    levels = relative_to_own(shares)
    with figure(path, (0.9 * len(names) + 2.0, 0.5 * len(names) + 1.2), font_size=8) as fig:
        axes = fig.subplots()
        axes.imshow(np.nan_to_num(shares), cmap="Greens", vmin=0, vmax=1, aspect="auto")
        for (row, column), share in np.ndenumerate(shares):
            text = f"{100 * share:.1f} %" if math.isfinite(share) else "not\nsearched"
            if row != column and math.isfinite(levels[row, column]):
                text += f"\n{levels[row, column]:+.1f} dB".replace("-", "−")
            weight, colour = "bold" if row == column else "normal", "white" if share > 0.55 else INK
            axes.text(column, row, text, ha="center", va="center", color=colour, fontweight=weight)
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(length=0)
        axes.xaxis.tick_top()
        axes.xaxis.set_label_position("top")
        axes.set(xlabel="share of the plate's kinetic energy in", ylabel="under the drive for")
        axes.spines[:].set_visible(False)
