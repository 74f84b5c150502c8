"""How a side of the plate is drawn, by what holds it; the same in plots and in 3-D."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warp_plate.scene.model import Scene

NAMES = ("left", "bottom", "right", "top")


@dataclass(frozen=True)
class Look:
    """colour; width in points; dashes: lengths of line and gap in widths, none for a solid line; words and sign: of
    the key."""

    colour: str
    width: float
    dashes: tuple[float, float] | None
    words: str
    sign: str

    @property
    def matplotlib(self) -> dict[str, Any]:
        """The look of a line in a plot."""
        dashes = "-" if self.dashes is None else (0, self.dashes)
        return {"color": self.colour, "linewidth": self.width, "linestyle": dashes, "solid_capstyle": "projecting"}


SIDES = {
    "clamped": Look("#1a1a1a", 3.2, None, "clamped", "━━"),
    "supported": Look("#1a1a1a", 1.2, None, "supported", "──"),
    "springs": Look("#e6820e", 2.2, (1.2, 0.8), "on springs", "╍╍"),
    "free": Look("#7a7a7a", 1.2, (4, 3), "free", "╌╌"),
}


def edge_kind(edge: object) -> str:
    """Which of SIDES a side is."""
    return edge if isinstance(edge, str) else "springs"


def kinds_of(scene: Scene) -> dict[str, list[str]]:
    """Of each kind that the scene has, in the order of SIDES, the names of its sides."""
    held = {name: edge_kind(getattr(scene.edges, name)) for name in NAMES}
    return {kind: sides for kind in SIDES if (sides := [name for name in NAMES if held[name] == kind])}
