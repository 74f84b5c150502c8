"""The grid of a plate of any outline: which nodes move, and where the plate's area counts.

Next to a clamped or supported piece the three-point curvature reaches to the outline, where u = 0, instead of to the
next node: with arms of a and b spacings to both sides,

    u_xx ≈ s (u₁ + u₂ − (1/a + 1/b) u₀)/hx²,   s = 2/(a + b)

(G. H. Shortley and R. Weller, J. Appl. Phys. 9, 1938), u₁ and u₂ being the neighbours, zero where the outline is
nearer. Along a clamped piece, a strip of half the distance d of the nearest nodes has the curvature 2u₀/d². At a free
piece only nodes and cells whose stencils are complete store energy; other parts of the area count at the nearest ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from warp_plate.outline.outline import Outline
from warp_plate.row_blocks import read_only
from warp_plate.scene.errors import SceneError

# In spacings: a node nearer to a held piece is held, and a node as far beyond a free piece still moves.
NEAR, BEYOND = 0.05, 0.3
# Points a side by which the area of a cell is counted that is not wholly on the plate.
SAMPLES = 8
# Near a free piece such a point counts at so many complete stencils, each weighted by the inverse of its distance, at
# least LEAST spacings. None may be farther than FAR.
SHARED_BY, LEAST, FAR = 6, 0.3, 3.0
FREE, SUPPORTED, CLAMPED = range(3)
KINDS = ("free", "supported", "clamped")
# Axis of a node's neighbours and their distance in nodes: west, east, south, north.
WAYS = ((1, -1), (1, 1), (0, -1), (0, 1))


@dataclass(frozen=True)
class OutlineGrid:
    """A plate on a grid (ny, nx); areas are in cells."""

    moves: np.ndarray  # (ny, nx) true for nodes that move
    shares: scipy.sparse.csr_array  # (nodes, nodes) part of each cell (column) that counts at each node (row)
    centres: tuple[np.ndarray, np.ndarray]  # (ny, nx) 1/a + 1/b along x and y
    squares: tuple[np.ndarray, np.ndarray]  # (ny, nx) area × s² along x and y
    products: np.ndarray  # (ny, nx) area × the product of both s; no energy is negative up to √(product of squares)
    twist: np.ndarray  # (ny − 1, nx − 1) area of each cell's twist
    strips: np.ndarray  # (ny, nx) area of a node's clamped strip × (2/d²)² [1/m⁴]
    normals: np.ndarray  # (ny, nx, 2) unit normal of the nearest piece
    held: np.ndarray  # (ny, nx) true for moving nodes next to a held piece
    deep: np.ndarray  # (ny, nx) true for nodes whose stencils the outline does not touch
    narrow: tuple[float, float] | None  # A point [m] where the plate is too narrow for the grid; None if nowhere

    def count(self, covered: np.ndarray) -> np.ndarray:
        """Return (..., ny, nx) the nodes' shares of regions that cover parts (..., ny, nx) of the cells."""
        flat = covered.reshape(-1, self.moves.size)
        return np.asarray((self.shares @ flat.T).T).reshape(covered.shape)


@lru_cache(8)
def outline_grid(outline: Outline, size: tuple[float, float], counts: tuple[int, int]) -> OutlineGrid:
    """Return the grid (ny, nx) of a plate with ``counts`` = (nx, ny) nodes over its size [m].

    Pieces on springs, which have no time steps, count as free. SceneError: no node lies on the plate.
    """
    x, y = (np.linspace(0, side, count) for side, count in zip(size, counts, strict=True))
    geometry, nodes = _Geometry.of(outline, (x[1] - x[0], y[1] - y[0])), np.stack(np.meshgrid(x, y), axis=-1)
    near, inside = geometry.nearest(nodes), geometry.contains(nodes)
    if not inside.any():
        raise SceneError(f"grid.nodes = [{x.size}, {y.size}]: no node lies on the plate; use more")
    arms = {way: geometry.arms(x, y, way) for way in WAYS}
    to_held = np.min([np.where(kind == FREE, np.inf, length) for length, kind in arms.values()], axis=0)
    beyond = ~inside & (near.kind == FREE) & (near.distance <= BEYOND * min(geometry.spacing))
    moves = inside & (to_held >= NEAR) | beyond
    complete, held, clamped = moves.copy(), np.zeros_like(moves), np.zeros_like(moves)
    lengths = {}
    for way, (length, kind) in arms.items():
        ends, reaches = moves & ~_neighbour(moves, way, False), length < 1.5
        kind = np.where(reaches, kind, _neighbour(near.kind, way, FREE))
        lengths[way] = np.where(ends & reaches, np.maximum(length, NEAR), 1.0)
        complete &= ~ends | (kind != FREE)
        held |= ends & (kind != FREE)
        clamped |= ends & (kind == CLAMPED)
    cells = moves[:-1, :-1] & moves[1:, :-1] & moves[:-1, 1:] & moves[1:, 1:]
    corners = np.pad(cells, 1)
    moves &= (
        complete
        | np.any([_neighbour(complete, way, False) for way in WAYS], axis=0)
        | (corners[:-1, :-1] | corners[1:, :-1] | corners[:-1, 1:] | corners[1:, 1:])
    )
    held &= complete
    if not (complete.any() and cells.any()):
        raise SceneError(f"grid.nodes = [{x.size}, {y.size}]: the plate is too narrow for these; use more")

    shares, narrow = geometry.share(nodes, moves)
    bent, narrow_when_bent = geometry.share(nodes, complete)
    twisted, narrow_when_twisted = geometry.share(nodes[:-1, :-1] + np.array(geometry.spacing) / 2, cells)
    both_ways = (WAYS[:2], WAYS[2:])
    factors = [2 / (lengths[low] + lengths[high]) for low, high in both_ways]
    # To a supported piece the moment falls to zero: there a node has the whole arm, to a neighbour half of it.
    parts = {way: np.where(_neighbour(moves, way, False), 0.5, length) for way, length in lengths.items()}
    along = [parts[low] + parts[high] for low, high in both_ways]
    area = _total(shares, moves)
    distance = np.maximum(near.distance, NEAR * min(geometry.spacing))
    across = np.abs(near.normal * geometry.spacing).max(axis=-1)
    strip = np.where(held & clamped, np.minimum(distance / 2 / across, area / 2), 0.0)
    supported = held & ~clamped
    own = np.where(held, area - strip, _total(bent, complete))
    weights = [np.where(supported, one, own) * complete for one in along]
    both = np.where(supported, area, weights[0]) * complete
    grid = OutlineGrid(
        moves=moves,
        shares=shares,
        centres=(1 / lengths[WAYS[0]] + 1 / lengths[WAYS[1]], 1 / lengths[WAYS[2]] + 1 / lengths[WAYS[3]]),
        squares=(weights[0] * factors[0] ** 2, weights[1] * factors[1] ** 2),
        products=both * factors[0] * factors[1],
        twist=_total(twisted, cells),
        strips=strip * 4 / distance**4,
        normals=near.normal,
        held=held,
        deep=inside & (near.distance > 3 * max(geometry.spacing)),
        narrow=narrow or narrow_when_bent or narrow_when_twisted,
    )
    read_only(grid.moves, *grid.centres, *grid.squares, grid.products, grid.twist, grid.strips, grid.normals)
    read_only(grid.held, grid.deep, grid.shares.data, grid.shares.indices, grid.shares.indptr)
    return grid


class _Nearest(NamedTuple):
    """Nearest places of the outline to points (...)."""

    kind: np.ndarray  # (...) its kind
    distance: np.ndarray  # (...) [m]
    normal: np.ndarray  # (..., 2) unit vector from there, or normal of the piece


class _Geometry(NamedTuple):
    plate: Any  # shapely's polygon
    pieces: Any  # shapely's tree of all segments
    starts: np.ndarray  # (n, 2) of all segments [m]
    ends: np.ndarray  # (n, 2)
    kinds: np.ndarray  # (n,)
    spacing: tuple[float, float]  # of the nodes [m]

    @staticmethod
    def of(outline: Outline, spacing: tuple[float, float]) -> _Geometry:
        import shapely

        lines = [piece.polyline() for piece in outline.pieces]
        starts, ends = (np.concatenate([line[part] for line in lines]) for part in (slice(-1), slice(1, None)))
        conditions = [piece.condition if piece.condition in KINDS else "free" for piece in outline.pieces]
        kinds = np.repeat([KINDS.index(name) for name in conditions], [len(line) - 1 for line in lines])
        shell, *holes = outline.polygons()
        plate = shapely.Polygon(shell, holes)
        shapely.prepare(plate)
        pieces = shapely.STRtree(shapely.linestrings(np.stack([starts, ends], axis=1)))
        return _Geometry(plate, pieces, starts, ends, kinds, spacing)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return (...), true for points (..., 2) inside."""
        import shapely

        return np.asarray(shapely.contains_xy(self.plate, points[..., 0], points[..., 1]))

    def nearest(self, points: np.ndarray) -> _Nearest:
        """Return what is nearest to points (..., 2)."""
        import shapely

        index = self.pieces.nearest(shapely.points(points.reshape(-1, 2))).reshape(points.shape[:-1])
        start, along = self.starts[index], self.ends[index] - self.starts[index]
        part = np.clip(((points - start) * along).sum(axis=-1) / (along**2).sum(axis=-1), 0, 1)
        way = points - (start + part[..., None] * along)
        distance = np.hypot(way[..., 0], way[..., 1])
        upright = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        normal = np.where((distance > 1e-6 * self.spacing[0])[..., None], way, upright)
        return _Nearest(self.kinds[index], distance, normal / np.hypot(normal[..., 0], normal[..., 1])[..., None])

    def arms(self, x: np.ndarray, y: np.ndarray, way: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return (ny, nx) distance of the outline in a direction [spacings], and its kind there."""
        axis, step = way  # of the array (ny, nx): lines of nodes lie along coordinate 1 − axis
        lines, positions = (x, y) if axis == 0 else (y, x)
        across, length = (0, 1) if axis == 0 else (1, 0)
        first, spacing = positions[0], positions[1] - positions[0]
        low = np.searchsorted(lines, np.minimum(self.starts[:, across], self.ends[:, across]))
        high = np.searchsorted(lines, np.maximum(self.starts[:, across], self.ends[:, across]))
        segment = np.repeat(np.arange(len(low)), high - low)
        line = np.arange(len(segment)) - np.repeat(np.cumsum(high - low) - high, high - low)
        start, end = self.starts[segment], self.ends[segment]
        part = (lines[line] - start[:, across]) / (end[:, across] - start[:, across])
        place = (start[:, length] + part * (end[:, length] - start[:, length]) - first) / spacing
        kind = self.kinds[segment]
        # One sorted list for all lines, which lie so far apart that no node meets a place on another one.
        band = positions.size + 10.0
        keys = line * band + np.clip(place, -4, positions.size + 3)
        order = np.argsort(keys)
        keys, kind = keys[order], kind[order]
        at = np.arange(lines.size)[:, None] * band + np.arange(positions.size)
        index = np.searchsorted(keys, at, side="left") if step > 0 else np.searchsorted(keys, at, side="right") - 1
        known = np.clip(index, 0, len(keys) - 1)
        distance, kinds = np.where(index == known, np.abs(keys[known] - at), np.inf), kind[known]
        return (distance.T, kinds.T) if axis == 0 else (distance, kinds)

    def share(
        self, centres: np.ndarray, target: np.ndarray
    ) -> tuple[scipy.sparse.csr_array, tuple[float, float] | None]:
        """Return (targets, boxes) parts of boxes of a cell around centres (rows, columns, 2) that count at each, and a
        point that is too far from all of them, if any."""
        spacing, distance = np.array(self.spacing), self.nearest(centres).distance
        touches = distance <= np.hypot(*spacing) / 2
        own = self.contains(centres) & ~touches & target
        boxes = np.flatnonzero(~own & (touches | self.contains(centres)))
        offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        points = centres.reshape(-1, 1, 2)[boxes] + spacing * np.stack(np.meshgrid(offsets, offsets), -1).reshape(-1, 2)
        box = np.repeat(boxes, SAMPLES**2).reshape(points.shape[:-1])
        lies = self.contains(points)
        points, box = points[lies], box[lies]
        targets = np.flatnonzero(target)
        count = min(SHARED_BY, len(targets))
        tree = scipy.spatial.cKDTree(centres.reshape(-1, 2)[targets] / spacing)
        apart, index = (values.reshape(len(points), count) for values in tree.query(points / spacing, count))
        narrow = None
        if len(points) and apart[:, 0].max() > FAR:
            x, y = points[apart[:, 0].argmax()].tolist()
            narrow = (x, y)
        weight = 1 / np.maximum(apart, LEAST)
        weight[self.nearest(points).kind != FREE, 1:] = 0
        weight /= weight.sum(axis=1, keepdims=True) * SAMPLES**2
        counted = (weight.ravel(), (targets[index].ravel(), np.repeat(box, count)))
        cells = scipy.sparse.coo_array(counted, shape=(target.size, target.size)).tocsr()
        return scipy.sparse.csr_array(cells + scipy.sparse.diags_array(own.ravel().astype(float))), narrow


def _neighbour(values: np.ndarray, way: tuple[int, int], beyond: object) -> np.ndarray:
    """Return the values of each node's neighbour; ``beyond`` the grid."""
    axis, step = way
    moved = np.roll(values, -step, axis)
    moved[(slice(None),) * axis + (-1 if step > 0 else 0,)] = beyond
    return moved


def _total(shares: scipy.sparse.csr_array, like: np.ndarray) -> np.ndarray:
    return np.asarray(shares.sum(axis=1)).reshape(like.shape)
