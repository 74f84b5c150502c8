"""Colours and line styles of the parts of a plate, the same in plots, in 3-D and in legends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene

INK, TARGET, GRID = "#1a1a1a", "#1b7837", "#8a8a8a"

# Corners (x, y) [m].
Path = list[tuple[float, float]]


@dataclass(frozen=True)
class EdgeStyle:
    """Line style of one kind of edge."""

    colour: str  # #rrggbb
    width: float  # line width [pt]
    dashes: str  # Matplotlib line style of plots; lines in 3-D are solid
    label: str  # text of the legend

    @property
    def matplotlib(self) -> dict[str, Any]:
        """Keyword arguments of a Matplotlib line."""
        line = {"color": self.colour, "linewidth": self.width, "linestyle": self.dashes}
        return {**line, "solid_capstyle": "projecting"}


EDGE_STYLES = {
    "clamped": EdgeStyle(INK, 3.2, "-", "clamped"),
    "supported": EdgeStyle(INK, 1.2, "-", "supported"),
    "springs": EdgeStyle("#e6820e", 2.2, ":", "on springs"),
    "free": EdgeStyle(GRID, 1.2, "--", "free"),
}


def edges_by_kind(scene: Scene) -> dict[str, dict[str, Path]]:
    """Return name and ends of the edges of every kind in the scene, in the order of EDGE_STYLES."""
    width, height = scene.plate.size
    ends: dict[str, Path] = {
        "left": [(0, 0), (0, height)],
        "bottom": [(0, 0), (width, 0)],
        "right": [(width, 0), (width, height)],
        "top": [(0, height), (width, height)],
    }
    kinds: dict[str, dict[str, Path]] = {kind: {} for kind in EDGE_STYLES}
    for name, edge in scene.edges:
        kinds[edge if isinstance(edge, str) else "springs"][name] = ends[name]
    return {kind: edges for kind, edges in kinds.items() if edges}


def length_unit(size: Sequence[float]) -> tuple[str, float]:
    """Return the unit of lengths of a plate of this size [m], and its number in a metre: mm below a metre."""
    return ("mm", 1000.0) if max(size) < 1 else ("m", 1.0)


def size_text(size: Sequence[float]) -> str:
    """Return the lengths [m] of a plate's sides with their unit."""
    unit, factor = length_unit(size)
    return f"{' × '.join(f'{side * factor:.5g}' for side in size)} {unit}"


def point_text(point: Sequence[float], size: Sequence[float]) -> str:
    """Return a point (x, y) [m] of a plate of this size, without its unit."""
    return ", ".join(f"{at * length_unit(size)[1]:.5g}" for at in point)


def rectangle(area: Area) -> Path:
    """Return the closed outline of an area."""
    x0, x1, y0, y1 = area
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]


def legend_entries(scene: Scene) -> list[tuple[str, str]]:
    """Return text and colour of every kind of outline."""
    styles = [EDGE_STYLES[kind] for kind in edges_by_kind(scene)]
    edges = [(f"{'━━' if style.width > 2 else '──'} {style.label}", style.colour) for style in styles]
    return [("□ target", TARGET), ("□ actuator", INK), *edges]
