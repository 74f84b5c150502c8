"""Colours and line styles of the parts of a plate, the same in plots, in 3-D and in legends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warp_plate.scene.model import Scene

INK, TARGET, GRID = "#1a1a1a", "#1b7837", "#8a8a8a"
EDGE_NAMES = ("left", "bottom", "right", "top")


@dataclass(frozen=True)
class EdgeStyle:
    """Line style of one kind of edge.

    Attributes:
        colour: #rrggbb.
        width: line width [pt].
        dashes: Matplotlib line style of plots; lines in 3-D are solid.
        label: text of the legend.
        symbol: sample of the line as text.
    """

    colour: str
    width: float
    dashes: str
    label: str
    symbol: str

    @property
    def matplotlib(self) -> dict[str, Any]:
        """Keyword arguments of a Matplotlib line."""
        line = {"color": self.colour, "linewidth": self.width, "linestyle": self.dashes}
        return {**line, "solid_capstyle": "projecting"}


EDGE_STYLES = {
    "clamped": EdgeStyle(INK, 3.2, "-", "clamped", "━━"),
    "supported": EdgeStyle(INK, 1.2, "-", "supported", "──"),
    "springs": EdgeStyle("#e6820e", 2.2, ":", "on springs", "━━"),
    "free": EdgeStyle(GRID, 1.2, "--", "free", "──"),
}


def edge_kind(scene: Scene, name: str) -> str:
    """Return the key of EDGE_STYLES for an edge of a scene."""
    edge = getattr(scene.edges, name)
    return edge if isinstance(edge, str) else "springs"


def edges_by_kind(scene: Scene) -> dict[str, list[str]]:
    """Return the names of the edges of every kind in the scene, in the order of EDGE_STYLES."""
    kinds = {name: edge_kind(scene, name) for name in EDGE_NAMES}
    return {kind: names for kind in EDGE_STYLES if (names := [name for name in EDGE_NAMES if kinds[name] == kind])}


def legend_entries(scene: Scene) -> list[tuple[str, str]]:
    """Return text and colour of every kind of outline."""
    styles = [EDGE_STYLES[kind] for kind in edges_by_kind(scene)]
    edges = [(f"{style.symbol} {style.label}", style.colour) for style in styles]
    return [("□ target", TARGET), ("□ actuator", INK), *edges]
