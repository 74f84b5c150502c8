"""Line styles of the plate's edges by their support, the same in plots and in 3-D."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warp_plate.scene.model import Scene

EDGE_NAMES = ("left", "bottom", "right", "top")


@dataclass(frozen=True)
class EdgeStyle:
    """Line style of one kind of edge.

    Attributes:
        colour: #rrggbb.
        width: line width [pt].
        dashes: lengths of dash and gap in line widths; None for a solid line.
        label: text of the legend.
        symbol: sample of the line as text.
    """

    colour: str
    width: float
    dashes: tuple[float, float] | None
    label: str
    symbol: str

    @property
    def matplotlib(self) -> dict[str, Any]:
        """Keyword arguments of a Matplotlib line."""
        style = "-" if self.dashes is None else (0, self.dashes)
        return {"color": self.colour, "linewidth": self.width, "linestyle": style, "solid_capstyle": "projecting"}


EDGE_STYLES = {
    "clamped": EdgeStyle("#1a1a1a", 3.2, None, "clamped", "━━"),
    "supported": EdgeStyle("#1a1a1a", 1.2, None, "supported", "──"),
    "springs": EdgeStyle("#e6820e", 2.2, (1.2, 0.8), "on springs", "╍╍"),
    "free": EdgeStyle("#7a7a7a", 1.2, (4, 3), "free", "╌╌"),
}


def edge_kind(edge: object) -> str:
    """Return the key of EDGE_STYLES for an edge of a scene."""
    return edge if isinstance(edge, str) else "springs"


def edges_by_kind(scene: Scene) -> dict[str, list[str]]:
    """Return the names of the edges of every kind in the scene, in the order of EDGE_STYLES."""
    kinds = {name: edge_kind(getattr(scene.edges, name)) for name in EDGE_NAMES}
    return {kind: names for kind in EDGE_STYLES if (names := [name for name in EDGE_NAMES if kinds[name] == kind])}
