"""Natural shapes seen from above: displacement in colour, nodal lines, how each side is held."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.viz.plots.plan import frame, outline, side_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = "RdBu_r"
INK, PATCH = "#1a1a1a", "#1b7837"
# In inches: the longer side of a plate, and of a row or column of them at most.
PICTURE, WIDEST = 1.9, 6
# Of the peak: what is rounding, and the height of a spot of the other sign, as in clamped corners, that means nothing.
ROUNDING, FLAT = 1e-9, 3e-3
# Nodal lines are drawn through a spline with at least so many points a side.
FINE = 150


def draw_modes(scene: Scene, frequencies: np.ndarray, shapes: np.ndarray, path: str | Path) -> Path:
    """Draw one small picture a mode, with its frequency above; PNG, SVG or PDF by ending.

    Args:
        frequencies: (count,) [Hz].
        shapes: (count, ny, nx), edges included, of which the largest displacement is 1.

    Raises:
        ValueError: no shapes, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    count = len(shapes)
    if count == 0:
        raise ValueError("there are no shapes to draw")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = layout(count, scene.plate.size)
    width, height = (PICTURE * side / max(scene.plate.size) for side in scene.plate.size)
    with rc_context({"font.size": 8, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        size = (max(columns * (width + 0.15), 3.2) + 0.9, rows * (height + 0.35) + 0.45)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(rows, columns, squeeze=False)
        for number, (axes, frequency, shape) in enumerate(zip(panels.flat, frequencies, shapes, strict=False), 1):
            drawn = _draw_shape(axes, scene, shape)
            axes.set_title(f"{number}: {frequency_text(frequency)}", fontsize=8, pad=4)
        for axes in panels.flat[count:]:
            axes.set_axis_off()
        bar = figure.colorbar(drawn, ax=panels, shrink=min(1.0, 1.2 / rows + 0.2), aspect=18, pad=0.02)
        bar.set_label("displacement over its largest")
        _key(figure, scene)
        figure.savefig(path, dpi=200)
    return Path(path)


def layout(count: int, size: Sequence[float]) -> tuple[int, int]:
    """Rows and columns: near a page's shape, for plates of this size, with as few empty places as fit in that."""
    ideal = math.sqrt(1.5 * count * size[1] / size[0])
    columns = min(count, WIDEST, max(1, round(ideal)))
    rows = math.ceil(count / columns)
    return rows, math.ceil(count / rows)


def frequency_text(frequency: float) -> str:
    """Four digits; a rigid motion by name."""
    if frequency == 0:
        return "rigid, 0 Hz"
    digits = max(0, 3 - math.floor(math.log10(frequency)))
    return f"{frequency:.{digits}f} Hz"


def _draw_shape(axes: Axes, scene: Scene, shape: np.ndarray) -> object:
    width, height = scene.plate.size
    ny, nx = shape.shape
    x, y = np.linspace(0, width, nx), np.linspace(0, height, ny)
    drawn = axes.pcolormesh(x, y, shape, cmap=COLOURS, vmin=-1, vmax=1, shading="gouraud", rasterized=True)
    fine_x, fine_y, field = nodal_field(scene, shape)
    if np.nanmin(field) < 0 < np.nanmax(field):
        axes.contour(fine_x, fine_y, field, levels=[0.0], colors=INK, linewidths=0.9)
    for one in scene.effects.layers:
        outline(axes, one.area, PATCH)
    for one in scene.effects.oscillators:
        outline(axes, one.area, PATCH, ":")
    frame(axes, scene)
    return drawn


def nodal_field(scene: Scene, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x and y [m], and (y, x) the shape between its nodes; NaN where a line of its zeros would be none of its nodes'.

    That is beside held sides, where it is zero anyway, and in spots of one sign that hardly rise.
    """
    from scipy.interpolate import RectBivariateSpline
    from scipy.ndimage import label, maximum

    ny, nx = shape.shape
    parts_x, parts_y = (math.ceil(FINE / (nodes - 1)) for nodes in (nx, ny))
    x, y = (np.linspace(0, side, nodes) for side, nodes in zip(scene.plate.size, (nx, ny), strict=True))
    fine_x = np.linspace(0, scene.plate.size[0], (nx - 1) * parts_x + 1)
    fine_y = np.linspace(0, scene.plate.size[1], (ny - 1) * parts_y + 1)
    # Rounding on a line that runs along nodes would make it jump from one side of them to the other.
    clean = np.where(np.abs(shape) < ROUNDING, 0.0, shape)
    field = RectBivariateSpline(y, x, clean)(fine_y, fine_x)
    field[np.abs(field) < ROUNDING] = 0.0
    for sign in (1, -1):
        spots, count = label(sign * field > 0)
        heights = maximum(sign * field, spots, range(1, count + 1))
        field[np.isin(spots, 1 + np.flatnonzero(np.asarray(heights) < FLAT))] = math.nan
    beside = {
        "left": np.s_[:, :parts_x],
        "right": np.s_[:, -parts_x:],
        "bottom": np.s_[:parts_y],
        "top": np.s_[-parts_y:],
    }
    for side, strip in beside.items():
        if getattr(scene.edges, side) in ("clamped", "supported"):
            field[strip] = math.nan
    return fine_x, fine_y, field


def _key(figure: object, scene: Scene) -> None:
    from matplotlib.lines import Line2D

    lines = side_lines(scene)
    lines.append(Line2D([], [], color=INK, linewidth=0.9, label="nodal line"))
    if scene.effects.layers:
        lines.append(Line2D([], [], color=PATCH, linewidth=0.9, label="layer"))
    if scene.effects.oscillators:
        lines.append(Line2D([], [], color=PATCH, linewidth=0.9, linestyle=":", label="oscillator"))
    figure.legend(handles=lines, loc="outside lower center", ncols=4, frameon=False, fontsize=7)  # type: ignore[attr-defined]
