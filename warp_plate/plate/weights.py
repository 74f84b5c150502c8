"""Weights of the nodes in an area, for loads and for the regions of the energy.

By overlap, a node's weight is the part of its cell (half a spacing to each side) that the area covers, so that
errors fall as h² and a node on a mid-line counts half to each side. By moments, it is the integral over the area of
the node's Lagrange polynomial through four nodes: the weights keep the area's moments up to the third, and errors fall
as h⁴. By nodes, as in the source paper, it is one for the nodes inside the area and zero for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from warp_plate.plate.outline_grid import OutlineGrid, outline_grid
from warp_plate.plate.shapes import lagrange, region_cells, shape_weights
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.search import CoilQuantity
from warp_plate.scene.target import PlateRegion, Target

REGIONS = ("plate", "target")


class ToneRegion:
    """What steady tones have in place of the energy of a region, without a mass."""


@dataclass(frozen=True)
class SoundRegion(ToneRegion):
    """The sound of the plate in place of the energy of a region, A-weighted: power [W], or at a point the mean square
    of the pressure [Pa²]."""

    point: tuple[float, float, float] | None = None  # [m], in front of the plate


@dataclass(frozen=True)
class CoilRegion(ToneRegion):
    """The square of the amplitude of a coil's voltage [V²], current [A²] or stroke [m²], or its mean heat [W]."""

    coil: int  # index among the coils
    quantity: CoilQuantity


# x0, x1, y0, y1 [m] of a rectangle; another region; weights (ny, nx) in cells; sound; or a quantity of a coil.
RegionLike = Area | PlateRegion | np.ndarray | ToneRegion
NO_AREAS: Mapping[str, RegionLike] = MappingProxyType({})
# The nodes of each side in an array (ny, nx).
EDGE_LINES: dict[str, Any] = {"left": np.s_[:, 0], "bottom": np.s_[0], "right": np.s_[:, -1], "top": np.s_[-1]}


def overlap(positions: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (nodes,) covered part of each node's cell along one axis, in spacings; ends in m."""
    half = (positions[1] - positions[0]) / 2
    left = np.maximum(positions - half, max(low, positions[0]))
    right = np.minimum(positions + half, min(high, positions[-1]))
    return np.maximum(right - left, 0) / (2 * half)


def inside(positions: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (nodes,) one for the nodes from ``low`` to ``high`` [m], both included up to rounding, otherwise zero."""
    slack = 1e-9 * (positions[-1] - positions[0])
    return ((positions >= low - slack) & (positions <= high + slack)).astype(float)


def moments(positions: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (nodes,) integrals from ``low`` to ``high`` [m] of the nodes' Lagrange polynomials, in spacings.

    Between two nodes the polynomials are the cubics through these and the next on each side; in the first and last
    interval through the four outermost. So Σ weights · g(node) · spacing is the integral of g, exactly for cubics.
    """
    spacing, axis = positions[1] - positions[0], lagrange(positions.size, 4)
    start, stop = np.clip((np.array([low, high]) - positions[0]) / spacing, 0, positions.size - 1)
    every = np.arange(int(start), min(int(np.ceil(stop)), positions.size - 1))
    integrals = axis.integrals(every, np.minimum(every + 1, stop)) - axis.integrals(every, np.maximum(every, start))
    weights: np.ndarray = axis.spread(every, integrals).sum(axis=0)
    return weights


def slopes(positions: np.ndarray, at: float) -> np.ndarray:
    """Return (nodes,) weights of the derivative at a place [m] of the cubic through the four nodes around it [1/m]."""
    spacing, axis = positions[1] - positions[0], lagrange(positions.size, 4)
    place = np.array([(at - positions[0]) / spacing])
    interval = axis.interval(place)
    since = place[0] - axis.middle[interval[0]]
    slopes = axis.powers @ [0.0, 1.0, 2 * since, 3 * since**2] / spacing
    return np.asarray(axis.spread(interval, slopes[None])[0])


def curvatures(x: np.ndarray, y: np.ndarray, area: Area) -> np.ndarray:
    """Return (ny, nx) weights of ∫∇²u dA over a rectangle, in cells: zero for every u linear in x and y."""
    x0, x1, y0, y1 = area
    along_x = np.outer(moments(y, y0, y1), slopes(x, x1) - slopes(x, x0)) / (x[1] - x[0])
    along_y = np.outer(slopes(y, y1) - slopes(y, y0), moments(x, x0, x1)) / (y[1] - y[0])
    return along_x + along_y


def patches(scene: Scene) -> np.ndarray:
    """Return (actuators, ny, nx) load of each node's cell per unit of each actuator's drive; held nodes take none.

    That is the share of the cell which a patch presses on, or the load per volt of a piezo patch, −M ∇² of its area in
    the weak sense [N/m² per V]; and zero of coils, see ``plate.coils``. SceneError: an actuator touches no node that
    can move.
    """
    weigh = {"overlap": overlap, "nodes": inside, "moments": moments}[scene.grid.load]
    x, y = node_positions(scene)
    if scene.piezo:  # no load in all, near an outline as elsewhere
        pairs = zip(scene.piezo_moments, scene.actuators, strict=True)
        fields = np.stack([-(moment or 1.0) * curvatures(x, y, actuator.box) for moment, actuator in pairs])
    else:
        fields = np.stack([on_plate(scene, covered_cells(scene, actuator, weigh)) for actuator in scene.actuators])
    fields[:, ~moving_nodes(scene)] = 0
    for index, field in enumerate(fields):
        if not field.any():
            raise SceneError(
                f"actuators[{index}].{scene.actuators[index].description}: covers no node that can move on "
                f'a grid of {x.size} x {y.size} nodes; enlarge it, use more nodes, or load = "overlap"'
            )
    fields[scene.coil_indices] = 0
    return fields


def reachable_nodes(scene: Scene, areas: np.ndarray) -> np.ndarray:
    """Return (ny, nx), true for moving nodes that a patch within one of the areas (areas, 4) [m] may load."""
    beyond = 2 if scene.grid.load == "moments" else 0  # nodes on each side of the area

    def span(axis: int, low: float, high: float) -> np.ndarray:
        spacing, node = scene.plate.size[axis] / (scene.grid.nodes[axis] - 1), np.arange(scene.grid.nodes[axis])
        return (node >= np.floor(low / spacing) - beyond) & (node <= np.ceil(high / spacing) + beyond)

    loaded = [np.outer(span(1, y0, y1), span(0, x0, x1)) for x0, x1, y0, y1 in areas]
    return np.any(loaded, axis=0) & moving_nodes(scene)


def grid_of(scene: Scene) -> OutlineGrid | None:
    """Return the grid of a plate with an outline; None for a rectangle."""
    if scene.plate.outline is None or scene.outline is None:
        return None
    return outline_grid(scene.outline, scene.plate.size, scene.grid.nodes)


def cell_shares(shape: tuple[int, ...]) -> np.ndarray:
    """Return (ny, nx) the part of each node's cell within the grid: 1, on edges ½ and in corners ¼."""
    along_y, along_x = (np.array([0.5, *[1.0] * (count - 2), 0.5]) for count in shape)
    return np.outer(along_y, along_x)


def moving_nodes(scene: Scene) -> np.ndarray:
    """Return (ny, nx), true for nodes that move: all but those on clamped and supported edges, or off the plate."""
    if (grid := grid_of(scene)) is not None:
        return grid.moves
    moves = np.ones(scene.grid.nodes[::-1], dtype=bool)
    for side, line in EDGE_LINES.items():
        if getattr(scene.edges, side) in ("clamped", "supported"):
            moves[line] = False
    return moves


def on_plate(scene: Scene, cells: np.ndarray) -> np.ndarray:
    """Return the parts (..., ny, nx) of regions that count at the nodes, from the covered parts of the nodes' cells.

    These are the same for a rectangle; within an outline they are the parts on the plate.
    """
    if (grid := grid_of(scene)) is None:
        return cells
    x, y = node_positions(scene)
    return grid.count(cells / _rectangle(overlap, x, y, (x[0], x[-1], y[0], y[-1])))


def region_weights(scene: Scene, areas: Mapping[str, RegionLike] = NO_AREAS) -> np.ndarray:
    """Return (regions, ny, nx) weights of the REGIONS and of further ``areas`` by name, in cells.

    They are by moments if loads are, otherwise by overlap. SceneError: a target covers no moving node, or has no mask.
    """
    regions: dict[str, RegionLike] = {"plate": scene.plate.box, "target": scene.target, **areas}
    return np.stack([weigh_region(scene, name, region) for name, region in regions.items()])


def localization_factor(energy: np.ndarray) -> np.ndarray:
    """Return (plates,) target's share of the energy (plates, regions), equation (5); NaN for a plate at rest."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return energy[:, REGIONS.index("target")] / energy[:, REGIONS.index("plate")]


def bilinear(
    points: Sequence[tuple[float, float]], nodes: tuple[int, int], size: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (points, 4, 2) row and column of the nodes around points (x, y) [m], and (points, 4) their shares."""
    place = np.asarray(points, dtype=float).reshape(-1, 2) / size * (np.array(nodes) - 1)
    low = np.clip(np.floor(place).astype(int), 0, np.array(nodes) - 2)
    part = place - low
    steps = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # (row, column)
    corners = low[:, None, ::-1] + steps
    across = np.where(steps[:, 1] == 1, part[:, None, 0], 1 - part[:, None, 0])
    along = np.where(steps[:, 0] == 1, part[:, None, 1], 1 - part[:, None, 1])
    return corners.astype(np.int32), across * along


def node_positions(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return x (nx,) and y (ny,) of the nodes [m]."""
    (width, height), (nx, ny) = scene.plate.size, scene.grid.nodes
    return np.linspace(0, width, nx), np.linspace(0, height, ny)


def weigh_region(scene: Scene, name: str, region: RegionLike) -> np.ndarray:
    """Return the weights (ny, nx) of one region, in cells; its name is for errors. See :func:`region_weights`."""
    if isinstance(region, np.ndarray):
        return region
    if isinstance(region, ToneRegion):
        return np.zeros(scene.grid.nodes[::-1])
    weigh = moments if scene.grid.load == "moments" else overlap
    if not isinstance(region, PlateRegion):
        return on_plate(scene, _rectangle(weigh, *node_positions(scene), region))
    if not isinstance(region, Target):
        return on_plate(scene, covered_cells(scene, region, weigh))
    key = name if name == "target" else f"targets ({name!r})"
    if region.area is None:
        field = on_plate(scene, shape_weights(scene, key, region))
    else:
        field = weigh_region(scene, name, region.area)
    if not field[moving_nodes(scene)].any():
        nx, ny = scene.grid.nodes
        raise SceneError(
            f"{key}.{region.description}: covers no node that can move on a grid of {nx} x {ny} nodes; enlarge it, or "
            "use more nodes"
        )
    return field


def covered_cells(scene: Scene, region: PlateRegion, weigh: Callable[..., np.ndarray] = overlap) -> np.ndarray:
    """Return (ny, nx) parts of the nodes' cells that a region covers, by ``overlap``, ``moments`` or ``inside``."""
    x, y = node_positions(scene)
    if region.area is not None:
        return _rectangle(weigh, x, y, region.area)
    if weigh is inside:
        return region.contains(np.stack(np.meshgrid(x, y), axis=-1)).astype(float)
    return region_cells(scene, region, weigh is moments)


def _rectangle(weigh: Callable[..., np.ndarray], x: np.ndarray, y: np.ndarray, area: Area) -> np.ndarray:
    x0, x1, y0, y1 = area
    return np.outer(weigh(y, y0, y1), weigh(x, x0, x1))
