"""Polynomials and waves along edges, with which moments of the displacement and slope vanish there, and the independent
functions that have such moments or none.

An edge is divided into parts of a few intervals. Each has Legendre polynomials, one for each interval and a few more;
round holes about which functions are added have waves. Line supports that end on the plate have their own forces, those
of the functions that are added about them: more conditions would hold what splines cannot follow, and polynomials miss
forces that grow without bound at an end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.modal.spaces.added import line_functions
from warp_plate.modal.spaces.chords import LocalSplines
from warp_plate.modal.spaces.singular import STRAIGHT, is_round, laurent_orders, on_edge
from warp_plate.modal.spaces.splines import gauss
from warp_plate.outline.outline import Outline
from warp_plate.outline.pieces import Arc, Piece, Straight
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# An edge is divided into parts of about so many intervals; polynomials of a part beyond one for each interval. Where
# the curvature of an edge jumps, and at wide supported corners [rad], motions are not smooth along it, and so many
# polynomials would hold the plate: fewer are taken.
PART_INTERVALS, FURTHER, WIDE = 6, 2, 0.6 * np.pi
# Parts of a closed curve along which Gauss's rule resolves waves.
EIGHTHS = np.linspace(0, 1, 9)
# Eigenvalues of the energy below the first part of the largest are those of functions that depend on the others, and
# singular values of the moments below the second part those of moments that do.
RANK, MOMENTS = 1e-13, 3e-4
# Points of Gauss's rule between crossings of knots along lines that end on the plate, beyond the splines' degree.
TIP_POINTS = 6
# Points in which the intervals along a piece are counted, and part of an interval that rounding may add to them.
SAMPLES, SLACK = 2001, 1e-6
# Points (points, 2) [m], or their parameters (points,) along a piece; functions (points, n) times weights; and vectors
# (points, 2) along which the slope is taken, None for the displacement.
Moments = tuple[np.ndarray, np.ndarray, np.ndarray | None]


class Unlike(SceneError):
    """A space has functions or conditions of other kinds than the space that it is to follow."""

    def __init__(self) -> None:
        super().__init__(
            "plate.outline: its functions are of other kinds on either side of a panel, which has no slopes therefore; "
            "change the ranges of design.free"
        )


def conditions(
    scene: Scene, pieces: Sequence[Piece], local: tuple[LocalSplines, LocalSplines], interval: float, added: bool
) -> Iterator[Moments]:
    """Yield what vanishes along the pieces of a scene's outline and its supports, for splines of an interval [m] with
    or without ``added`` functions."""
    outline = scene.outline
    assert outline is not None
    further = dict(further_polynomials(outline))
    for piece in pieces:
        inner = [added and not on_edge(outline, end) for end in (piece.start, piece.end)] if _is_line(piece) else []
        if any(inner):
            moments = tip_moments(piece, local, inner, line_functions(piece.length, interval))
        else:
            hole, orders = (piece,), None
            if added and hole in outline.loops[1:] and is_round(hole):
                orders = laurent_orders(hole[0].least_radius, interval)
            moments = edge_moments(piece, local, further.get(piece, FURTHER), orders)
        for at, functions, along in moments:
            yield piece.points(at), functions, along
    for support in scene.supports:
        if support.point is not None and support.stiffness is None:
            yield np.array([support.point]), np.ones((1, 1)), None


def _is_line(piece: Piece) -> bool:
    """Return whether a piece is a rigid line support."""
    return isinstance(piece, Straight) and piece.edge.startswith("supports") and piece.condition == "supported"


def edge_moments(
    piece: Piece, local: tuple[LocalSplines, LocalSplines], further: int, orders: int | None = None
) -> Iterator[Moments]:
    """Yield what vanishes along a clamped or supported piece: moments with polynomials on each part of it, ``further``
    ones than intervals, or with waves of at least so many ``orders``, and the displacement of its ends."""
    if piece.condition not in ("clamped", "supported"):
        return
    if not piece.closed:
        yield np.array([0.0, 1.0]), np.eye(2), None
    crossed = [piece.crossings(axis, side.breaks) for axis, side in enumerate(local)]
    t = np.unique(np.concatenate([np.linspace(0, 1, SAMPLES), *crossed]))
    points = piece.points(t)
    middle, steps = (points[1:] + points[:-1]) / 2, np.abs(np.diff(points, axis=0))
    sizes = [np.diff(side.breaks)[side.interval(middle[:, axis])] for axis, side in enumerate(local)]
    passed = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0] / sizes[0], steps[:, 1] / sizes[1]))])
    whole = passed[-1] - SLACK
    parts = 1 if orders is not None else max(1, math.ceil(whole / PART_INTERVALS))
    count = max(1, math.ceil(whole / parts) + further)
    ends = np.interp(np.linspace(0, passed[-1], parts + 1), passed, t)
    for low, high in pairwise(ends.tolist()):
        at, weights = edge_rule(piece, local, low, high)
        if orders is not None:
            waves = 2 * np.pi * np.outer(at, np.arange(1, max(orders, math.ceil(passed[-1] / 2)) + 1))
            functions = np.hstack([np.ones((at.size, 1)), np.sqrt(2) * np.cos(waves), np.sqrt(2) * np.sin(waves)])
        else:
            functions = legendre.legvander(2 * (at - low) / (high - low) - 1, count - 1)
            functions = functions * np.sqrt(2 * np.arange(count) + 1)
        functions = functions * (weights / weights.sum())[:, None]
        yield at, functions, None
        if piece.condition == "clamped":
            size = max(float(np.diff(side.breaks).mean()) for side in local)
            yield at, size * functions, piece.normals(at)


def tip_moments(
    line: Piece, local: tuple[LocalSplines, LocalSplines], inner: Sequence[bool], count: int
) -> Iterator[Moments]:
    """Yield what vanishes along a line support, of whose ends some are ``inner`` ones, on the plate: the work of about
    ``count`` forces per length p″, where p vanishes as the root of the distance from these ends, by ∫ p″u = −∫ p′u′.

    Between two inner ends p = sin nθ with the place cos θ, and p″ is 1/sin θ and cos θ/sin θ besides; from one, p is an
    odd polynomial of the root.
    """
    crossed = [line.crossings(axis, side.breaks) for axis, side in enumerate(local)]
    cuts, points = np.unique(np.concatenate([[0.0, 1.0], *crossed])), local[0].splines.degree + TIP_POINTS
    if all(inner):
        angle, weights = gauss(np.arccos(1 - 2 * cuts), points)
        at, waves = (1 - np.cos(angle)) / 2, np.cos(np.outer(angle, np.arange(count + 1))) * weights[:, None]
        yield at, waves[:, :2], None
        functions = waves[:, 1:]
    else:
        root, weights = gauss(np.sqrt(1 - cuts)[::-1] if inner[1] else np.sqrt(cuts), points)
        at = 1 - root**2 if inner[1] else root**2
        yield np.array([0.0 if inner[1] else 1.0]), np.ones((1, 1)), None
        sizes = np.sqrt(4 * np.arange(count + 1) + 1)
        functions = legendre.legvander(root, 2 * count)[:, ::2] * np.outer(weights, sizes)
    yield at, functions, np.broadcast_to(line.tangents(0.0), (at.size, 2))


def independent_functions(energy: np.ndarray, rank: float, count: int | None) -> np.ndarray:
    """Return functions (all, n) of unit energy: those whose scaled energies are above a part ``rank`` of the largest,
    or a ``count`` with the largest, less those that have none."""
    used = np.flatnonzero(np.diag(energy) > 0)
    unit = 1 / np.sqrt(np.diag(energy)[used])
    values, vectors = scipy.linalg.eigh(energy[np.ix_(used, used)] * np.outer(unit, unit), driver="evd")
    least = values.size - (count or 0) + len(energy) - used.size
    some = values > rank * values[-1] if count is None else np.arange(values.size) >= least
    basis = np.zeros((len(energy), int(some.sum())))
    basis[used] = unit[:, None] * vectors[:, some] / np.sqrt(values[some])
    return basis


def null_space(rows: np.ndarray, count: int | None) -> np.ndarray:
    """Return an orthonormal basis (functions, n) of what moments (moments, functions), of which a ``count`` are
    independent, do not see."""
    if count is None and len(rows) > rows.shape[1]:  # of many pieces: five times as fast
        squares, vectors = scipy.linalg.eigh(rows.T @ rows, driver="evd")
        return np.asarray(vectors[:, squares <= MOMENTS**2 * squares[-1]])
    _, sizes, vectors = scipy.linalg.svd(rows, full_matrices=False)
    seen = vectors[sizes > MOMENTS * sizes[0]] if count is None else vectors[:count]
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
