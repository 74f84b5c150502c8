"""Weights of discs, polygons and masks: integrals of the nodes' basis functions over a shape.

The basis function of a node is φ_i(x) φ_j(y), φ being one in the node's cell and zero elsewhere (overlap) or the
Lagrange polynomial through four nodes (moments), see ``plate.weights``. Over a polygon, by Green's theorem,

    ∫∫ φ_i(x) φ_j(y) dx dy = ∮ Φ_i(x) φ_j(y) dy,   Φ_i(x) = ∫ φ_i from the plate's left side to x,

counterclockwise. Each side of the polygon is cut where φ changes its formula, along x and along y, and Gauss's rule is
exact on every part of it. Left of a part, Φ_i is the whole integral of φ_i over each interval, so that these are added
by one sum along x. This is exact to rounding for simple polygons, and the work grows with the nodes near the outline.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from numpy.polynomial import legendre, polynomial

from warp_plate.plate.files import read_table
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene, Target
from warp_plate.scene.target import PlateRegion, area_within

# Corners of the polygon for a disc, which has its area and an outline off by at most 2e-7 of the radius.
DISC_CORNERS = 4096
# Rounding of a sum that is zero, relative to the polygon's height.
ZERO = 1e-13


@dataclass(frozen=True)
class Axis:
    """Basis functions φ of the nodes along one axis, as polynomials on intervals; lengths in spacings."""

    nodes: int  # Number of nodes
    breaks: np.ndarray  # (intervals + 1,) ends of the intervals
    first: np.ndarray  # (intervals,) first node whose φ is not zero on the interval
    middle: np.ndarray  # (intervals,) origin of the polynomials
    powers: np.ndarray  # (nodes of an interval, degree + 1) their coefficients

    def interval(self, at: np.ndarray) -> np.ndarray:
        """Return the interval that holds each point."""
        return np.clip(np.searchsorted(self.breaks, at, side="right") - 1, 0, self.first.size - 1)

    def values(self, interval: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return (..., nodes of an interval) φ at points."""
        return _polynomials(self.powers, at - self.middle[interval])

    def integrals(self, interval: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return (..., nodes of an interval) ∫ φ from the beginning of the interval to points."""
        raised = polynomial.polyint(self.powers, axis=1)
        start, middle = self.breaks[interval], self.middle[interval]
        return _polynomials(raised, at - middle) - _polynomials(raised, start - middle)

    def spread(self, interval: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return (points, nodes) values (points, nodes of an interval) in the places of their nodes."""
        spread = np.zeros((len(interval), self.nodes))
        np.put_along_axis(spread, self.first[interval][:, None] + np.arange(values.shape[1]), values, axis=1)
        return spread


def cells(nodes: int) -> Axis:
    """Return functions that are one in the node's cell, half a spacing to each side, and zero elsewhere."""
    breaks = np.concatenate([[0.0], np.arange(nodes - 1) + 0.5, [nodes - 1.0]])
    index = np.arange(nodes)
    return Axis(nodes, breaks, index, index.astype(float), np.ones((1, 1)))


def lagrange(nodes: int, points: int) -> Axis:
    """Return Lagrange polynomials through the 2 or 4 nodes nearest to a place."""
    first = np.clip(np.arange(nodes - 1) - (points // 2 - 1), 0, nodes - points)
    middle = (points - 1) / 2
    vandermonde = np.vander(np.arange(points) - middle, points, increasing=True).T
    return Axis(nodes, np.arange(nodes, dtype=float), first, first + middle, np.linalg.inv(vandermonde))


def shape_weights(scene: Scene, key: str, target: Target, within: Area | None = None) -> np.ndarray:
    """Return (ny, nx) weights of a target in cells, by moments if loads are, otherwise by overlap.

    ``key`` is the target's in the scene, for errors of its mask, which is bilinear between its numbers; outside the
    rectangle ``within`` x0, x1, y0, y1 [m] the target does not count (default: everywhere).
    """
    moments = scene.grid.load == "moments"
    if target.mask is None:
        return region_cells(scene, target, moments, within)
    across, up = _axes(scene, moments)
    spacing = _spacing(scene)
    values = read_mask(scene.folder, key, target)
    x0, x1, y0, y1 = within or scene.plate.box
    along_x = _mask_matrix(across, values.shape[1], x0 / spacing[0], x1 / spacing[0])
    along_y = _mask_matrix(up, values.shape[0], y0 / spacing[1], y1 / spacing[1])
    weights: np.ndarray = (along_x @ (along_y @ values).T).T
    return weights


def region_cells(scene: Scene, region: PlateRegion, moments: bool, within: Area | None = None) -> np.ndarray:
    """Return (ny, nx) weights of a region in cells, by moments or by overlap; see :func:`shape_weights`."""
    corners = clipped(region.flattened(DISC_CORNERS), within or scene.plate.box)
    return polygon_weights(corners / _spacing(scene), *_axes(scene, moments))


def _axes(scene: Scene, moments: bool) -> tuple[Axis, Axis]:
    across, up = (lagrange(count, 4) if moments else cells(count) for count in scene.grid.nodes)
    return across, up


def _spacing(scene: Scene) -> np.ndarray:
    return np.array(scene.plate.size) / (np.array(scene.grid.nodes) - 1)


def bounds(scene: Scene, key: str, target: Target) -> Area:
    """Return x0, x1, y0, y1 [m] of the smallest rectangle that holds a target."""
    corners = target.corners(DISC_CORNERS)
    if corners is None:
        values = read_mask(scene.folder, key, target)
        ends = []
        for side, some in zip(scene.plate.size, (values.any(axis=0), values.any(axis=1)), strict=True):
            first, last = np.flatnonzero(some)[[0, -1]]
            ends.append(np.clip(np.array([first - 1, last + 1]) / max(some.size - 1, 1), 0, 1) * side)
        corners = np.column_stack(ends)
    (x0, y0), (x1, y1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return x0, x1, y0, y1


def polygon_weights(corners: np.ndarray, across: Axis, up: Axis) -> np.ndarray:
    """Return (nodes of up, nodes of across) weights of the part on the plate of a polygon (corners, 2), in spacings."""
    weights = np.zeros((up.nodes, across.nodes))
    if len(corners) < 3:
        return weights
    corners = np.clip(corners, 0, [across.breaks[-1], up.breaks[-1]])
    start, end = _parts(corners, np.roll(corners, -1, axis=0), across, up)
    middle = (start + end) / 2
    column, row = across.interval(middle[:, 0]), up.interval(middle[:, 1])
    nodes, shares = legendre.leggauss(4)  # exact up to the power of seven: four of Φ and three of φ
    at = start[:, None] + (nodes[:, None] + 1) / 2 * (end - start)[:, None]
    rise = shares / 2 * (end - start)[:, 1:]
    behind = rise[:, :, None] * up.values(row[:, None], at[:, :, 1])
    partial = np.einsum("pgj,pgi->pji", behind, across.integrals(column[:, None], at[:, :, 0]))
    lines = up.first[row][:, None] + np.arange(partial.shape[1])
    columns = across.first[column][:, None, None] + np.arange(partial.shape[2])
    np.add.at(weights, (lines[:, :, None], columns), partial)
    # For each interval, the factor of its whole integral from the parts to the right of it.
    passed = np.zeros((up.nodes, across.first.size))
    np.add.at(passed, (lines, column[:, None]), behind.sum(axis=1))
    passed = passed[:, ::-1].cumsum(axis=1)[:, ::-1] - passed
    every = np.arange(across.first.size)
    whole = across.integrals(every, across.breaks[1:])
    for node in range(whole.shape[1]):
        integrals = scipy.sparse.csr_array((whole[:, node], (across.first + node, every)), (across.nodes, every.size))
        weights += (integrals @ passed.T).T
    weights[np.abs(weights) < ZERO * np.ptp(corners[:, 1])] = 0
    return weights if area_within(corners) > 0 else -weights


def clipped(corners: np.ndarray, area: Area) -> np.ndarray:
    """Return (corners, 2) the part of a polygon in a rectangle x0, x1, y0, y1 (Sutherland and Hodgman 1974).

    Parts that do not touch are joined by sides there and back, which hold no area.
    """
    for axis, limit, sign in ((0, area[0], 1), (0, area[1], -1), (1, area[2], 1), (1, area[3], -1)):
        if not len(corners):
            break
        before, now = np.roll(corners, 1, axis=0), corners
        depth, depth_before = sign * (now[:, axis] - limit), sign * (before[:, axis] - limit)
        inside, crosses = depth >= 0, (depth >= 0) != (depth_before >= 0)
        fall = np.where(crosses, depth_before - depth, 1)
        cut = before + (depth_before / fall)[:, None] * (now - before)
        cut[:, axis] = limit
        both = np.stack([cut, now], axis=1).reshape(-1, 2)
        corners = both[np.stack([crosses, inside], axis=1).ravel()]
    return corners


def read_mask(folder: Path | None, key: str, target: Target) -> np.ndarray:
    """Return (rows, columns) numbers of a target's mask."""
    values = read_table(f"{key}.mask", target.mask or "", folder, 0, 1)
    if not values.any():
        raise SceneError(f"{key}.mask = {target.mask!r}: holds no number above 0, so that the target has no inside")
    return values


def _polynomials(powers: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return (..., polynomials) values of polynomials with coefficients (polynomials, degree + 1)."""
    return np.ascontiguousarray(np.moveaxis(polynomial.polyval(at, powers.T), 0, -1))


def _parts(start: np.ndarray, end: np.ndarray, across: Axis, up: Axis) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends (parts, 2) of the sides' parts, each in one interval along x and in one along y."""
    sides, shares = [np.repeat(np.arange(len(start)), 2)], [np.tile([0.0, 1.0], len(start))]
    for axis, breaks in enumerate((across.breaks, up.breaks)):
        low, high = np.minimum(start[:, axis], end[:, axis]), np.maximum(start[:, axis], end[:, axis])
        first, after = np.searchsorted(breaks, low, side="right"), np.searchsorted(breaks, high, side="left")
        counts = np.maximum(after - first, 0)
        side = np.repeat(np.arange(len(start)), counts)
        index = np.arange(side.size) - np.repeat(np.cumsum(counts) - counts, counts) + first[side]
        sides.append(side)
        shares.append((breaks[index] - start[side, axis]) / (end - start)[side, axis])
    side, share = np.concatenate(sides), np.concatenate(shares)
    order = np.lexsort((share, side))
    side, share = side[order], share[order]
    point = start[side] + share[:, None] * (end - start)[side]
    last = np.flatnonzero(share == 1)
    point[last] = end[side[last]]
    together = side[1:] == side[:-1]
    return point[:-1][together], point[1:][together]


def _mask_matrix(axis: Axis, count: int, low: float, high: float) -> scipy.sparse.csr_array:
    """Return (nodes, count) ∫ φ_i(s) · hat_k(s) ds from ``low`` to ``high`` [spacings] for samples edge to edge."""
    samples = np.linspace(0, axis.breaks[-1], count) if count > 1 else np.zeros(1)
    low, high = (float(np.clip(end, 0, axis.breaks[-1])) for end in (low, high))
    cuts = np.unique(np.concatenate([axis.breaks, samples, [low, high]]))
    cuts = cuts[(cuts >= low) & (cuts <= high)]
    if cuts.size < 2:
        return scipy.sparse.csr_array((axis.nodes, count))
    nodes, shares = legendre.leggauss(3)  # exact up to the power of five: three of φ and one of the hat
    length, middle = np.diff(cuts)[:, None], (cuts[:-1] + cuts[1:])[:, None] / 2
    at = middle + nodes / 2 * length
    interval = axis.interval(middle)
    values = shares / 2 * length * axis.values(interval, at).transpose(2, 0, 1)
    lower = np.clip(np.searchsorted(samples, middle, side="right") - 1, 0, max(count - 2, 0))
    upper = np.minimum(lower + 1, count - 1)
    part = (at - samples[lower]) / np.where(upper > lower, samples[upper] - samples[lower], 1)
    part = np.where(upper > lower, part, 0.0)
    rows = axis.first[interval][:, 0] + np.arange(len(values))[:, None]
    matrix = scipy.sparse.csr_array((axis.nodes, count))
    for share, sample in ((1 - part, lower), (part, upper)):
        columns = np.broadcast_to(sample[:, 0], rows.shape)
        entries = (values * share).sum(axis=2).ravel()
        matrix = matrix + scipy.sparse.csr_array((entries, (rows.ravel(), columns.ravel())), matrix.shape)
    return matrix


def outlines(scene: Scene) -> list[np.ndarray]:
    """Return closed outlines (points, 2) [m] of all targets of a scene."""
    return [outline for key, target in scene.targets_by_key.items() for outline in target_outlines(scene, key, target)]


def target_outlines(scene: Scene, key: str, target: Target) -> list[np.ndarray]:
    """Return closed outlines (points, 2) [m] of one target.

    Those of a mask are its contours at ½; none if its file is gone, as of a result that was moved.
    """
    if target.mask is None:
        return [target.closed_path()]
    from contourpy import contour_generator

    try:
        values = read_mask(scene.folder, key, target)
    except SceneError:
        return []
    values = np.broadcast_to(values, (max(len(values), 2), max(values.shape[1], 2)))
    x, y = (np.linspace(0, side, count) for side, count in zip(scene.plate.size, values.shape[::-1], strict=True))
    # A rim of zeros at the place of the edge closes the contours that meet the edge.
    padded = np.pad(x, 1, mode="edge"), np.pad(y, 1, mode="edge"), np.pad(values, 1)
    return [np.asarray(line) for line in contour_generator(*padded).lines(0.5)]
