"""Natural shapes seen from above: displacement in colour, nodal lines, how each side is held."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = "RdBu_r"
INK, PATCH = "#1a1a1a", "#1b7837"
# Colour, width in points and dashes of a side, by what holds it; and the words of the key.
SIDES = {
    "clamped": ("#1a1a1a", 3.2, "-", "clamped"),
    "supported": ("#1a1a1a", 1.2, "-", "supported"),
    "springs": ("#e6820e", 2.2, (0, (1.2, 0.8)), "on springs"),
    "free": ("#9a9a9a", 1.0, (0, (4, 3)), "free"),
}
# In inches: the longer side of a plate, and of a row or column of them at most.
PICTURE, WIDEST = 1.9, 6
# A rigid motion has no nodal line but by rounding; below this part of the peak a shape is flat.
FLAT = 1e-9


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


def edge_kind(edge: object) -> str:
    """Which of SIDES a side is."""
    return edge if isinstance(edge, str) else "springs"


def _draw_shape(axes: Axes, scene: Scene, shape: np.ndarray) -> object:
    width, height = scene.plate.size
    ny, nx = shape.shape
    x, y = np.linspace(0, width, nx), np.linspace(0, height, ny)
    drawn = axes.pcolormesh(x, y, shape, cmap=COLOURS, vmin=-1, vmax=1, shading="gouraud", rasterized=True)
    # Held nodes are zero without being a nodal line, so the lines are drawn by what lies inside of them.
    inner = np.where(_held(scene, shape.shape), np.nan, shape)
    if np.nanmin(inner) < -FLAT and np.nanmax(inner) > FLAT:
        axes.contour(x, y, inner, levels=[0.0], colors=INK, linewidths=0.9)
    for one in scene.effects.layers:
        _outline(axes, one.area, "-")
    for one in scene.effects.oscillators:
        _outline(axes, one.area, ":")
    for side, ends in _ends(width, height).items():
        colour, thickness, dashes, _ = SIDES[edge_kind(getattr(scene.edges, side))]
        axes.plot(*ends, color=colour, linewidth=thickness, linestyle=dashes, clip_on=False, solid_capstyle="projecting")
    axes.set_aspect("equal")
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    return drawn


def _held(scene: Scene, nodes: tuple[int, ...]) -> np.ndarray:
    """(ny, nx) whether a node lies on a clamped or supported side."""
    held = np.zeros(nodes, dtype=bool)
    lines = {"left": np.s_[:, 0], "right": np.s_[:, -1], "bottom": np.s_[0], "top": np.s_[-1]}
    for side, line in lines.items():
        held[line] |= getattr(scene.edges, side) in ("clamped", "supported")
    return held


def _ends(width: float, height: float) -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
    """x and y of both ends of each side."""
    return {
        "left": ((0, 0), (0, height)),
        "bottom": ((0, width), (0, 0)),
        "right": ((width, width), (0, height)),
        "top": ((0, width), (height, height)),
    }


def _outline(axes: Axes, area: Sequence[float], dashes: str) -> None:
    x0, x1, y0, y1 = area
    axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=PATCH, linewidth=0.9, linestyle=dashes)


def _key(figure: object, scene: Scene) -> None:
    from matplotlib.lines import Line2D

    kinds = {edge_kind(edge) for _, edge in scene.edges}
    lines = [
        Line2D([], [], color=colour, linewidth=width, linestyle=dashes, label=words)
        for kind, (colour, width, dashes, words) in SIDES.items()
        if kind in kinds
    ]
    lines.append(Line2D([], [], color=INK, linewidth=0.9, label="nodal line"))
    if scene.effects.layers:
        lines.append(Line2D([], [], color=PATCH, linewidth=0.9, label="layer"))
    if scene.effects.oscillators:
        lines.append(Line2D([], [], color=PATCH, linewidth=0.9, linestyle=":", label="oscillator"))
    figure.legend(handles=lines, loc="outside lower center", ncols=4, frameon=False, fontsize=7)  # type: ignore[attr-defined]
