"""Natural modes seen from above: displacement in colour, nodal lines, supports of the edges."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from warp_plate.effects.effect import attachments
from warp_plate.scene.errors import printable
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import INK, TARGET, size_text
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, colour_map
from warp_plate.viz.outlined import clip, continued
from warp_plate.viz.plots.frame import add_panels, figure
from warp_plate.viz.plots.plan import draw_edges, draw_outline, drawn_size, edge_handles, line_handle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Longer side of a plate [inch]; most plates in a row.
CMAP, LENGTH, MOST_COLUMNS = "RdBu_r", 1.9, 6
# Relative to the largest displacement: rounding errors, and the height of spots of the other sign without a meaning.
NOISE, FLAT = 1e-9, 3e-3
FINE = 120  # least cells along the longer side of the spline whose contours are nodal lines


def draw_modes(
    scene: Scene, frequencies: np.ndarray, shapes: np.ndarray, path: str | Path,
    colours: ColourOptions = DEFAULT_COLOURS,
) -> None:  # fmt: skip
    """Draw every mode with its frequency.

    Args:
        frequencies: (count,) [Hz].
        shapes: (count, ny, nx), edges included, with a largest displacement of 1.
        colours: colour map; the limits are −1 and 1.
    """
    colours.refuse_limit("a mode")
    count = len(shapes)
    if count == 0:
        raise ValueError("there are no shapes to draw")
    rows, columns = layout(count, scene.plate.size)
    width, height = drawn_size(scene, LENGTH)
    size = (max(columns * (width + 0.15), 3.2) + 0.9, rows * (height + 0.35) + 0.75)
    with figure(path, size, font_size=8) as fig:
        title = f"{scene.title or 'Natural modes'}, {size_text(scene.plate.size)}"
        fig.suptitle(textwrap.fill(printable(title), int(13 * size[0])), fontsize=9)
        panels = add_panels(fig, count, columns)
        for number, (axes, frequency, shape) in enumerate(zip(panels, frequencies, shapes, strict=True), 1):
            mesh = _draw_shape(axes, scene, shape, colours.colormap or CMAP)
            axes.set_title(f"{number}: {frequency_text(frequency)}", fontsize=8, pad=4)
        bar = fig.colorbar(mesh, ax=panels, shrink=min(1.0, 1.2 / rows + 0.2), aspect=18, pad=0.02)
        bar.set_label("displacement over\nits largest")
        handles = [*edge_handles(scene), line_handle("nodal line", color=INK, linewidth=0.9)]
        if scene.layers:
            handles.append(line_handle("layer", color=TARGET, linewidth=0.9))
        if attachments(scene.terms):
            handles.append(line_handle("oscillator", color=TARGET, linewidth=0.9, linestyle=":"))
        fig.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=7)


def layout(count: int, size: Sequence[float]) -> tuple[int, int]:
    """Return rows and columns that fill a landscape page with few empty places, for plates of this size [m]."""
    ideal = math.sqrt(1.5 * count * size[1] / size[0])
    columns = min(count, MOST_COLUMNS, max(1, round(ideal)))
    rows = math.ceil(count / columns)
    return rows, math.ceil(count / rows)


def frequency_text(frequency: float) -> str:
    """Return the frequency [Hz] with four digits, or the name of a rigid motion."""
    if frequency == 0:
        return "rigid, 0 Hz"
    digits = max(0, 3 - math.floor(math.log10(frequency)))
    return f"{frequency:.{digits}f} Hz"


def _draw_shape(axes: Axes, scene: Scene, shape: np.ndarray, cmap: str) -> object:
    fine_x, fine_y, fine = refined(scene, shape)
    look = {"cmap": colour_map(cmap), "vmin": -1, "vmax": 1, "origin": "lower", "interpolation": "bilinear"}
    mesh = axes.imshow(fine, extent=scene.plate.box, **look)
    clip(mesh, axes, scene)
    field = nodal_field(scene, fine, shape.shape)
    if np.nanmin(field) < 0 < np.nanmax(field):
        clip(axes.contour(fine_x, fine_y, field, levels=[0.0], colors=INK, linewidths=0.9), axes, scene)
    for layer in scene.layers:
        draw_outline(axes, scene, layer, TARGET)
    for attachment in attachments(scene.terms):
        draw_outline(axes, scene, attachment.region, TARGET, ":")
    draw_edges(axes, scene)
    axes.set_axis_off()  # which takes less time to lay out than axes without ticks and spines
    return mesh


def refined(scene: Scene, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x and y [m] and the shape (y, x) of a mode, interpolated between nodes."""
    nodes, refine = shape.shape[::-1], _refinement(shape.shape)
    x, y = map(np.linspace, (0, 0), scene.plate.size, nodes)
    # Rounding errors on a nodal line along grid nodes would make the contour jump from side to side.
    clean = continued(scene, np.where(np.abs(shape) < NOISE, 0.0, shape))
    if refine == 1:
        return x, y, clean
    from scipy.interpolate import RectBivariateSpline

    fine_x, fine_y = map(np.linspace, (0, 0), scene.plate.size, ((count - 1) * refine + 1 for count in nodes))
    order = 3 if scene.plate.outline is None else 1  # beyond the rim of an outline there is nothing to interpolate
    return fine_x, fine_y, RectBivariateSpline(y, x, clean, kx=order, ky=order)(fine_y, fine_x)


def _refinement(nodes: Sequence[int]) -> int:
    """Return the points of the spline for each cell of the grid."""
    return math.ceil(FINE / (max(nodes) - 1))


def nodal_field(scene: Scene, fine: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the refined shape (y, x) of a mode with (ny, nx) nodes, to be contoured for its nodal lines.

    It is NaN along held edges, where the shape vanishes anyway, and in spots of one sign that hardly rise.
    """
    refine = _refinement(shape)
    field = np.where(np.abs(fine) < NOISE, 0.0, fine)
    spots = _spots(np.sign(field))
    heights = np.zeros(spots.max() + 1)
    np.maximum.at(heights, spots, np.abs(field))
    field[(heights[spots] < FLAT) & (field != 0)] = math.nan
    strips = {"left": np.s_[:, :refine], "right": np.s_[:, -refine:]}
    strips |= {"bottom": np.s_[:refine], "top": np.s_[-refine:]}
    for edge, strip in strips.items():
        if getattr(scene.edges, edge) in ("clamped", "supported"):
            field[strip] = math.nan
    return field


def _spots(signs: np.ndarray) -> np.ndarray:
    """Return the number (ny, nx) of the connected spot of one sign that each point belongs to."""
    numbers = np.arange(signs.size).reshape(signs.shape)
    pairs = [(numbers[:-1], numbers[1:]), (numbers[:, :-1], numbers[:, 1:])]
    alike = [signs.flat[first] == signs.flat[second] for first, second in pairs]
    ends = [np.concatenate([pair[end][same] for pair, same in zip(pairs, alike, strict=True)]) for end in (0, 1)]
    # Not by scipy.ndimage, which takes as long to import as a picture to draw.
    graph = scipy.sparse.coo_array((np.ones(len(ends[0])), tuple(ends)), (signs.size, signs.size))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1]).reshape(signs.shape)
