"""Functions that are added about free holes with corners, whose sides move apart: slots, slits, squares, ellipses.

The motion near a hole is Re Σ z̄ʲ φⱼ(z) with functions φⱼ that are analytic on the plate (E. Goursat, Bull. Soc. Math.
France 26, 1898, pp. 236-237). They are sums of powers of 1/ζ, where z = (ζ + 1/ζ)/2 is a place from -1 to 1 along the
hole's middle line, and of poles inside the hole that crowd towards its corners (A. Gopal, L. N. Trefethen, SIAM J.
Numer. Anal. 57, 2019, pp. 2074-2094).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from warp_plate.modal.spaces.singular import TINY, Local, Singular, clear, is_round
from warp_plate.outline.outline import Outline, inner_line
from warp_plate.outline.pieces import Arc, Piece

# Distance of the middle line's ends from those of the hole, as a part of its half width, and at most of its length.
TIP, SHORT = 0.5, 0.25
# Orders of 1/ζ: so many, and so many more for each interval of the line. Powers of z̄: at least so many, and one for so
# many intervals.
ORDERS, FURTHER_ORDERS, POWERS, INTERVALS_OF_POWER = 4, 0.6, 2, 4.0
# Distance of a corner's first pole from the corner as a part of that of the hole's other side, ratio of the distances
# of one pole and the next, and the distance of those of an arc as a part of its radius, at least.
FIRST, RATIO, OFF_ARC = 0.4, 0.5, 0.5
# Poles of a corner: twice the logarithm to base 2 of the intervals along the plate but so many.
FEWER_POLES = 2
# Distances at which Gauss's rule is cut: the first as a part of that of the last pole, their ratio.
FIRST_CUT, CUT_RATIO = 0.9, 2.0
# Convex holes turn to one side by at least this angle [rad] at corners.
TURN = 1e-6
# Direction along which the ends of a middle line are in order: across few lines.
ASLANT = np.array([1.0, 0.3])
# About so many functions a slot and each of its corners take.
SLOT_FUNCTIONS, POLE_FUNCTIONS = 48, 24


@lru_cache
def middle_line(hole: tuple[Piece, ...]) -> np.ndarray | None:
    """Return the ends (2, 2) [m] of the middle line of a free convex hole that is no circle, in the same order for a
    hole a little changed; None of other holes."""
    if is_round(hole) or any(piece.condition != "free" for piece in hole):
        return None
    if any(isinstance(piece, Arc) and not piece.hollow for piece in hole):
        return None
    if any(angle < math.pi + TURN for *_, angle in Outline((hole,)).corners()):
        return None
    if len(hole) == 1 and isinstance(hole[0], Arc):
        vectors, (longer, shorter), _ = np.linalg.svd(hole[0].axes)
        along = vectors[:, 0] * math.sqrt(longer**2 - shorter**2)
        ends = np.array([hole[0].centre - along, hole[0].centre + along])
    else:
        ends, width = inner_line(hole)
        inward = min(TIP * width / 2 / math.dist(*ends), SHORT) * (ends[1] - ends[0])
        ends = np.array([ends[0] + inward, ends[1] - inward])
    return ends[np.argsort(ends @ ASLANT)]


def functions_of(hole: tuple[Piece, ...]) -> int:
    """Return about the number of functions that are added about a hole with a middle line."""
    return SLOT_FUNCTIONS + POLE_FUNCTIONS * sum(1 for _ in _apexes(hole))


def around_slot(outline: Outline, hole: tuple[Piece, ...], interval: float) -> Iterator[Singular]:
    """Yield the functions about a hole of an outline with a middle line, for splines of an interval [m]."""
    ends = middle_line(hole)
    assert ends is not None
    spread = math.dist(*ends) / interval
    orders = ORDERS + math.ceil(FURTHER_ORDERS * spread)
    apexes = list(_apexes(hole))
    tip = min(piece.nearest(end)[1] for piece in hole for end in ends)
    yield along_middle(ends, orders, max(POWERS, math.ceil(spread / INTERVALS_OF_POWER)), _cuts(tip, interval))
    width = 2 * max(min(piece.nearest(ends.mean(axis=0))[1] for piece in hole), tip)
    count = math.ceil(2 * math.log2(max(outline.bounds) / interval)) - FEWER_POLES
    for apex, inward, least in apexes:
        across = min(clear(outline, complex(*apex), complex(*inward)), math.sqrt(2) * width)
        away = FIRST * across * RATIO ** np.arange(count)
        away = away[(away >= OFF_ARC * least) | (away == away[0])]
        yield at_poles(apex, inward * away[:, None], _cuts(float(away[-1]), interval))


def _apexes(hole: tuple[Piece, ...]) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Yield corners and middles of arcs (2,) [m], unit vectors from there into the hole, and radii of the arcs [m]."""
    if len(hole) == 1:
        return
    for _, after, angle in Outline((hole,)).corners():
        turn = math.atan2(*after.tangents(0.0)[::-1]) + angle / 2
        yield after.start, -np.array([math.cos(turn), math.sin(turn)]), 0.0
    for piece in hole:
        if isinstance(piece, Arc):
            yield piece.points(0.5), piece.normals(0.5), piece.least_radius


def _cuts(least: float, interval: float) -> tuple[float, ...]:
    """Return distances from a place [m] at which Gauss's rule is cut, largest first."""
    count = max(1, math.ceil(math.log(interval / (FIRST_CUT * least), CUT_RATIO)))
    return tuple((FIRST_CUT * least * CUT_RATIO ** np.arange(count)[::-1]).tolist())


def along_middle(ends: np.ndarray, orders: int, powers: int, cuts: Sequence[float]) -> Singular:
    """Return z̄ʲ ζ⁻ⁿ for n from 1 to a number of orders and j from 0 to ``powers``, and log |ζ|, about a line of ends
    (2, 2) [m]."""
    low, high = (complex(*end) for end in ends)
    half, n = abs(high - low) / 2, np.arange(1, orders + 1)[:, None]

    def local(place: np.ndarray) -> Local:
        z = place / half
        root = np.sqrt(z - 1) * np.sqrt(z + 1)
        root = np.where(np.abs(root) < TINY, TINY, root)
        value = (z + root) ** -n
        slope = -n * value / root
        bend = (n**2 * value - slope * z) / root**2
        logarithm = np.log(z + root)[None], 1 / root[None] / half, -z[None] / root[None] ** 3 / half**2
        both = _bianalytic(z.conj(), (value, slope / half, bend / half**2), powers, half)
        return _local(np.concatenate([both, _bianalytic(z.conj(), logarithm, 0, half)[:, :1]], axis=1))

    places = tuple((end.real, end.imag) for end in (low, high))
    turn = float(np.angle(high - low))
    return Singular(ends.mean(axis=0), turn, 2 * orders * (powers + 1) + 1, local, places=places, cuts=tuple(cuts))


def at_poles(place: np.ndarray, away: np.ndarray, cuts: Sequence[float]) -> Singular:
    """Return 1/(z - p) and z̄/(z - p) of poles p at places ``away`` (poles, 2) [m] from a place, multiplied by their
    distances."""
    poles, count = (away @ [1, 1j])[:, None], 4 * len(away)
    size = np.abs(poles)

    def local(at: np.ndarray) -> Local:
        away = at - poles
        away = np.where(np.abs(away) < TINY * size, TINY * size, away)
        value = size / away
        slope = -value / away
        return _local(_bianalytic(away.conj() / size, (value, slope, -2 * slope / away), 1, size))

    return Singular(place, 0.0, count, local, places=(tuple(place),), cuts=tuple(cuts))


def _bianalytic(
    conjugate: np.ndarray, analytic: Sequence[np.ndarray], powers: int, size: np.ndarray | float
) -> np.ndarray:
    """Return values, two first and three second derivatives (6, 2 (powers + 1) n, points) of the real, then imaginary
    parts of a conjugate variable's powers from 0 on times functions (n, points), given by values and two derivatives
    [1/m]; the variable is the conjugate place over ``size`` [m]."""
    f0, f1, f2 = analytic
    values, along, up, bends, twists, bends_up = [], [], [], [], [], []
    for j in range(powers + 1):
        c0 = conjugate**j
        c1 = j * conjugate ** max(j - 1, 0) / size
        c2 = j * (j - 1) * conjugate ** max(j - 2, 0) / size**2
        values.append(c0 * f0)
        along.append(c0 * f1 + c1 * f0)
        up.append(1j * (c0 * f1 - c1 * f0))
        bends.append(c0 * f2 + 2 * c1 * f1 + c2 * f0)
        twists.append(1j * (c0 * f2 - c2 * f0))
        bends_up.append(-c0 * f2 + 2 * c1 * f1 - c2 * f0)
    return np.array(
        [
            np.concatenate([part(array) for part in (np.real, np.imag) for array in arrays])
            for arrays in (values, along, up, bends, twists, bends_up)
        ]
    )


def _local(parts: np.ndarray) -> Local:
    """Return values and derivatives along the local axes from those of :func:`_bianalytic`."""
    value, x, y, xx, xy, yy = parts
    return np.ones(1), (value,), (x, y), (xx, xy, yy)
