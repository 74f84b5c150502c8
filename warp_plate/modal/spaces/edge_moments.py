"""Polynomials and waves along edges, with which moments of the displacement and slope vanish there.

An edge is divided into parts of a few intervals. Each has Legendre polynomials, one for each interval and a few more;
round holes about which functions are added have waves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.modal.spaces.chords import LocalSplines
from warp_plate.modal.spaces.singular import STRAIGHT
from warp_plate.modal.spaces.splines import gauss
from warp_plate.outline.outline import Outline
from warp_plate.outline.pieces import Arc, Piece

# An edge is divided into parts of about so many intervals; polynomials of a part beyond one for each interval. Where
# the curvature of an edge jumps, and at wide supported corners [rad], motions are not smooth along it, and so many
# polynomials would hold the plate: fewer are taken.
PART_INTERVALS, FURTHER, WIDE = 6, 2, 0.6 * np.pi
# Parts of a closed curve along which Gauss's rule resolves waves.
EIGHTHS = np.linspace(0, 1, 9)
# Singular values of the moments below this part of the largest are those of moments that depend on the others.
MOMENTS = 1e-4
# Points in which the intervals along a piece are counted.
SAMPLES = 2001


def moments(
    piece: Piece, local: tuple[LocalSplines, LocalSplines], further: int, orders: int | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the parameters (points,) of Gauss's rule along each part of a piece, and functions (points, n) times its
    weights: polynomials, ``further`` ones than intervals, or waves of at least so many ``orders``."""
    t = np.linspace(0, 1, SAMPLES)
    points = piece.points(t)
    middle, steps = (points[1:] + points[:-1]) / 2, np.abs(np.diff(points, axis=0))
    sizes = [np.diff(side.breaks)[side.interval(middle[:, axis])] for axis, side in enumerate(local)]
    passed = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0] / sizes[0], steps[:, 1] / sizes[1]))])
    if orders is not None:
        at, weights = edge_rule(piece, local, 0.0, 1.0)
        waves = 2 * np.pi * np.outer(at, np.arange(1, max(orders, math.ceil(passed[-1] / 2)) + 1))
        functions = np.hstack([np.ones((at.size, 1)), np.sqrt(2) * np.cos(waves), np.sqrt(2) * np.sin(waves)])
        yield at, functions * (weights / weights.sum())[:, None]
        return
    parts = max(1, int(np.ceil(passed[-1] / PART_INTERVALS)))
    count = max(1, int(np.ceil(passed[-1] / parts)) + further)
    ends = np.interp(np.linspace(0, passed[-1], parts + 1), passed, t)
    for low, high in pairwise(ends.tolist()):
        at, weights = edge_rule(piece, local, low, high)
        functions = legendre.legvander(2 * (at - low) / (high - low) - 1, count - 1)
        yield at, functions * np.sqrt(2 * np.arange(count) + 1) * (weights / weights.sum())[:, None]


def null_space(rows: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (functions, n) of what moments (moments, functions) do not see."""
    _, sizes, vectors = scipy.linalg.svd(rows, full_matrices=False)
    seen = vectors[sizes > MOMENTS * sizes[0]]
    return np.asarray(scipy.linalg.qr(seen.T)[0][:, len(seen) :])


def edge_rule(
    piece: Piece, local: tuple[LocalSplines, LocalSplines], low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters and weights [m] of Gauss's rule along a part of a piece, cut at the knots."""
    crossed = [piece.crossings(axis, side.breaks) for axis, side in enumerate(local)]
    cuts = np.unique(np.concatenate([[low, high], EIGHTHS if piece.closed else [], *crossed]))
    t, weights = gauss(cuts[(cuts >= low) & (cuts <= high)], local[0].splines.degree + 2)
    return t, weights * np.linalg.norm(piece.tangents(t), axis=1)


def further_polynomials(outline: Outline) -> Iterator[tuple[Piece, int]]:
    """Yield pieces of an outline that take other than ``FURTHER`` polynomials, and how many."""
    wide = {after for _, after, angle in outline.corners() if angle > WIDE}
    for loop in outline.loops:
        bent = any(_is_bent(*pair) for pair in zip(loop, (*loop[1:], *loop[:1]), strict=True))
        for piece in loop:
            if bent:
                yield piece, 0 if piece.condition == "clamped" and not isinstance(piece, Arc) else -1
            elif piece.condition == "supported" and not wide.isdisjoint(loop):
                yield piece, 0


def _is_bent(before: Piece, after: Piece) -> bool:
    """Return whether the curvature jumps between two pieces that join smoothly, one of which is an arc."""
    (x0, y0), (x1, y1) = before.tangents(1.0), after.tangents(0.0)
    if abs(math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)) > STRAIGHT:
        return False
    arcs = [piece for piece in (before, after) if isinstance(piece, Arc)]
    if len(arcs) == 2:
        (centre, form), (other, others) = ((arc.centre, arc.axes @ arc.axes.T) for arc in arcs)
        return not (np.allclose(centre, other) and np.allclose(form, others, atol=1e-9 * np.abs(form).max()))
    return bool(arcs)
