"""Supports of a plate on its grid: springs between points of the plate and the ground.

A line or ring is a row of points; what the plate moves between two of them falls as the third power of their distance.
The displacement of a point is that of the four nodes around it by bilinear interpolation or, next to an outline, that
of a linear function through the nearest nodes that move. The springs of a rigid support are stiffer than the plate is
from node to node, so that what they give falls as the square of the spacing.

Springs so stiff would shorten the time step. Therefore ``plate.bending`` raises the masses of their nodes: what springs
add to a row of K is, for the mass added, at most Λ, the median of the rows (Gershgorin's theorem). The force of that
mass is a part ω²/Λ of the spring's, which is as small as the grid's other errors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from warp_plate.effects.effect import Joint
from warp_plate.plate.weights import bilinear, grid_of
from warp_plate.scene.model import Scene
from warp_plate.scene.outline import Support

# Largest distance of the points of a line or ring [nodes], and their largest number.
APART, MOST_POINTS = 3.0, 64
# Stiffness of a rigid support's springs, in units of that of the plate at a node.
RIGID = 4.0
# Nodes whose linear function gives the displacement of a point next to an outline.
NEAREST = 6


class Springs(NamedTuple):
    """Springs of all supports."""

    attachments: list[Joint]
    shares: np.ndarray  # (springs, ny, nx) shares of the nodes in the displacement of each one's point
    added: np.ndarray  # (ny, nx) Σ|K| [N/m] that they add to the rows of K


def support_points(support: Support, spacing: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return (points, 2) places [m] of the springs of a support on nodes of a spacing [m], and (points,) the length [m]
    of a line or ring that each holds; 1 for a point."""
    curve = support.piece("")
    if curve is None:
        return np.array([support.point]), np.ones(1)
    count = min(math.ceil(curve.length / (APART * min(spacing))), MOST_POINTS)
    lengths = np.full(count + 1, curve.length / count)
    if curve.closed:
        return curve.points(np.arange(count) / count), lengths[1:]
    lengths[[0, -1]] /= 2
    return curve.points(np.linspace(0, 1, count + 1)), lengths


def springs_of_supports(scene: Scene, moves: np.ndarray, rows: np.ndarray) -> Springs:
    """Return the springs of a scene's supports, for nodes (ny, nx) that move and Σ|K| [N/m] of the rows of K."""
    attached, shares, added = [], [], np.zeros_like(rows)
    for support in scene.supports:
        points, lengths = support_points(support, scene.spacing)
        for share, length in zip(_shares(scene, moves, points), lengths.tolist(), strict=True):
            size = np.abs(share)
            if not size.any():  # on an edge that is held anyway
                continue
            stiffness = RIGID * float((size * rows).sum()) if support.stiffness is None else support.stiffness * length
            attached.append(Joint(0.0, stiffness, 0.0, "support"))
            shares.append(share)
            added += stiffness * size.sum() * size
    return Springs(attached, np.reshape(shares, (-1, *rows.shape)), added)


def _shares(scene: Scene, moves: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (points, ny, nx) shares of the nodes in the displacement of each point; held nodes have none."""
    corners, parts = bilinear([(x, y) for x, y in points.tolist()], scene.grid.nodes, scene.plate.size)
    shares = np.zeros((len(points), *moves.shape))
    shares[np.arange(len(points))[:, None], corners[..., 0], corners[..., 1]] = parts
    if grid_of(scene) is None:
        return shares * moves
    moving, cut = np.argwhere(moves), np.flatnonzero((shares * ~moves).any(axis=(1, 2)))
    _, nearest = scipy.spatial.cKDTree(moving).query(points[cut, ::-1] / scene.spacing[::-1], NEAREST)
    for index, near in zip(cut, nearest, strict=True):
        apart = moving[near] - points[index, ::-1] / scene.spacing[::-1]
        shares[index] = 0
        shares[index][tuple(moving[near].T)] = np.linalg.pinv(np.column_stack([np.ones(len(near)), apart]))[0]
    return shares
