"""Functions that are added to splines where the motion of a plate is singular.

Each is a product of two functions, in polar coordinates about a place or in Cartesian ones along a line: r² log r at
the point of a force; r^α F(θ) at a corner (M. L. Williams, J. Appl. Mech. 19, 1952, pp. 526-528); biharmonic functions
about a line support, across which the shear force jumps; and the terms of Laurent's series of biharmonic functions
about a round hole. They are those of an isotropic plate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeGuard

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.outline.outline import Outline
from warp_plate.outline.pieces import Arc, Piece

# Exponents between these are taken at corners: smaller ones are those of rigid motions, and splines follow larger ones,
# but for those at notches, both sides of which they tie to each other: corners with at least an angle [rad].
LEAST_EXPONENT, LARGEST_EXPONENT, LARGEST_AT_NOTCH, NOTCH = 1.01, 3.6, 10.6, 1.53 * math.pi
# Polynomials of the angle for the exponents, also at notches, and part of a function by which they may miss it.
POLYNOMIALS, POLYNOMIALS_AT_NOTCH, MISSED = 18, 48, 1e-5
# By so much more the values at one side of a corner count where a function has its sign, for both sides may be equal.
LOPSIDED = 0.1
# Exponents nearer to a whole number than this are those of polynomials.
WHOLE = 1e-6
# Part of the distance within which a function is cut off over which it is whole.
WHOLE_PART = 0.2
# Corners with an angle above π by less than this are straight [rad].
STRAIGHT = 1e-3
# Largest distance of a point from an edge that it lies on [m].
ON_EDGE = 1e-9
# Half axes of a circle differ by less than this part.
SAME = 1e-9
# Orders of Laurent's series: at least so many, so many more for a radius of an interval, and at most so many.
FEWEST_ORDERS, FURTHER_ORDERS, MOST_ORDERS = 3, 3, 8
# Distances from a place at which Gauss's rule is cut, as parts of an interval; their ratio for holes.
NEAR, HOLE_RATIO = (0.3, 0.09, 0.0225, 0.005, 0.001, 1e-4), 1.7
# Points whose values are computed at once.
BLOCK = 4096
# A ray meets its own place again nearer than this part of the plate; distances are at least so large.
AWAY, TINY = 1e-6, 1e-9
Derivatives = Callable[[np.ndarray], list[np.ndarray]]
# The direction of a local axis, as exp(i angle), and there derivatives of order 0, 1 (along and across it), and 2.
Local = tuple[np.ndarray, tuple[np.ndarray, ...], tuple[np.ndarray, ...], tuple[np.ndarray, ...]]


@dataclass(frozen=True, eq=False)
class Singular:
    """Functions of x + iy from an origin, turned."""

    origin: np.ndarray  # (2,) [m]
    turn: float  # direction of the first axis [rad]
    functions: int
    local: Callable[[np.ndarray], Local]  # (functions, points), of which the real parts count
    reach: float = math.inf  # They vanish at larger distances from the origin [m]
    places: tuple[tuple[float, float], ...] = ()  # near which Gauss's rule is cut [m]
    cuts: tuple[float, ...] = ()  # distances along x and y from these at which it is [m]

    def values(self, x: np.ndarray, y: np.ndarray, orders: Sequence[tuple[int, int]]) -> np.ndarray:
        """Return (orders, functions, points) derivatives, by their orders along x and y, at points (points,) [m]."""
        values = np.zeros((len(orders), self.functions, x.size))
        for start in range(0, x.size, BLOCK):
            some = slice(start, start + BLOCK)
            place = (x[some] - self.origin[0] + 1j * (y[some] - self.origin[1])) * np.exp(-1j * self.turn)
            near = slice(None) if math.isinf(self.reach) else np.flatnonzero(np.abs(place) < self.reach)
            axis, *derivatives = self.local(place[near])
            axis = axis * np.exp(1j * self.turn)
            c, s = axis.real, axis.imag
            factors = {(0, 0): (1.0,), (1, 0): (c, -s), (0, 1): (s, c), (2, 0): (c * c, -2 * c * s, s * s),
                       (1, 1): (c * s, c * c - s * s, -c * s), (0, 2): (s * s, 2 * c * s, c * c)}  # fmt: skip
            for result, order in zip(values[:, :, some], orders, strict=True):
                parts = zip(factors[order], derivatives[sum(order)], strict=True)
                result[:, near] = sum(factor * part.real for factor, part in parts)
        return values

    def near(self) -> list[tuple[float, float, float]]:
        """Return squares at whose sides Gauss's rule is cut: middle x, y and half of a side [m]."""
        return [(x, y, cut) for x, y in self.places for cut in self.cuts]


def _polar(first: Derivatives, second: Derivatives) -> Callable[[np.ndarray], Local]:
    """Return the products of functions of the distance and of the angle from -π to π."""

    def local(place: np.ndarray) -> Local:
        r, angle = np.maximum(np.abs(place), TINY), np.angle(place)
        (a0, a1, a2), (b0, b1, b2) = first(r), second(angle)
        if not np.iscomplexobj(a0):
            b0, b1, b2 = b0.real, b1.real, b2.real
        bends = a2 * b0, (a1 / r - a0 / r**2) * b1, a1 / r * b0 + a0 / r**2 * b2
        return np.exp(1j * angle), (a0 * b0,), (a1 * b0, a0 / r * b1), bends

    return local


def _powers(exponents: np.ndarray, logs: np.ndarray, scale: float, reach: float = math.inf) -> Derivatives:
    """Return (r/scale)^α of exponents (functions,), times log(r/scale) where ``logs``, cut off at ``reach`` [m]."""
    pairs, places = np.unique([exponents, logs], axis=1, return_inverse=True)
    a, k = pairs[:, :, None]

    def derivatives(r: np.ndarray) -> list[np.ndarray]:
        log = np.log(r / scale)
        power = np.exp(a * log)
        value = power * np.where(k, log, 1.0)
        slope = (a * value + k * power) / r
        bend = (a * (a - 1) * value + k * (2 * a - 1) * power) / r**2
        return [part[places] for part in _product([value, slope, bend], _cut_off(r, reach))]

    return derivatives


def _product(one: Sequence[np.ndarray], two: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return a product and its first two derivatives from those of its factors."""
    (a0, a1, a2), (b0, b1, b2) = one, two
    return [a0 * b0, a1 * b0 + a0 * b1, a2 * b0 + 2 * a1 * b1 + a0 * b2]


def _cut_off(distance: np.ndarray, reach: float) -> list[np.ndarray]:
    """Return 1 up to WHOLE_PART of the reach and 0 beyond it, with four continuous derivatives, and the first two."""
    if math.isinf(reach):
        return [np.ones_like(distance), np.zeros_like(distance), np.zeros_like(distance)]
    width = (1 - WHOLE_PART) * reach
    s = np.clip((reach - np.abs(distance)) / width, 0, 1)
    step = s**5 * (126 + s * (-420 + s * (540 + s * (-315 + 70 * s))))
    slope = 630 * (s * (1 - s)) ** 4 / width
    bend = 2520 * (s * (1 - s)) ** 3 * (1 - 2 * s) / width**2
    return [step, -np.sign(distance) * slope, bend]


def _waves(frequencies: np.ndarray, factors: np.ndarray) -> Derivatives:
    """Return sums of factors (functions, terms) times exp(i frequency θ)."""

    unique, places = np.unique(frequencies, return_inverse=True)
    places = places.reshape(frequencies.shape)

    def derivatives(angle: np.ndarray) -> list[np.ndarray]:
        waves = np.exp(1j * unique[:, None] * angle)
        values = []
        for power in range(3):
            terms = factors * (1j * frequencies) ** power
            values.append(sum(terms[:, index, None] * waves[places[:, index]] for index in range(terms.shape[1])))
        return values

    return derivatives


def at_point(point: np.ndarray, interval: float) -> Singular:
    """Return r² log r about a point."""
    one = np.ones((1, 1))
    local = _polar(_powers(np.array([2.0]), np.ones(1), interval), _waves(0 * one, one))
    return Singular(point, 0.0, 1, local, places=(tuple(point),), cuts=tuple(part * interval for part in NEAR[:-1]))


def at_corner(
    corner: np.ndarray, first: float, angle: float, kinds: tuple[str, str], ratio: float, interval: float, reach: float
) -> Singular | None:
    """Return r^α F(θ) at a corner that takes an ``angle`` from the direction ``first`` [rad], of edges of two kinds,
    the first at that direction, and of a plate with Poisson's ratio; None if there are none."""
    exponents, waves, factors = [], [], []
    for exponent, terms in _exponents(angle, kinds, ratio):
        frequency = np.array([exponent, -exponent, exponent - 2, 2 - exponent])
        for part in (1.0,) if exponent.imag == 0 else (1.0, -1j):
            exponents.append(exponent)
            waves.append(frequency)
            factors.append(part * terms * np.exp(1j * frequency * angle / 2))
    if not exponents:
        return None
    powers = _powers(np.array(exponents), np.zeros(len(exponents)), interval, reach)
    local = _polar(powers, _waves(np.array(waves), np.array(factors)))
    cuts = tuple(part * interval for part in NEAR)
    return Singular(corner, first + angle / 2, len(exponents), local, reach, (tuple(corner),), cuts)


def _exponents(angle: float, kinds: tuple[str, str], ratio: float) -> Iterator[tuple[complex, np.ndarray]]:
    """Yield exponents α of the motions r^α F(θ) of a corner, and factors (4,) of exp(iαθ), exp(-iαθ), exp(i(α - 2)θ)
    and exp(i(2 - α)θ) in F, θ from 0 to the angle.

    The energy of r^α F and r^(2-α) G vanishes for all G: α solves an eigenvalue problem of fourth order.
    """
    polynomials, largest = (
        (POLYNOMIALS, LARGEST_EXPONENT) if angle < NOTCH else (POLYNOMIALS_AT_NOTCH, LARGEST_AT_NOTCH)
    )
    s, weights = legendre.leggauss(polynomials + 2)
    tables = [np.eye(polynomials), *(legendre.legder(np.eye(polynomials), order) for order in (1, 2))]
    values = [legendre.legval(s, table).T * (2 / angle) ** order for order, table in enumerate(tables)]
    held = {"free": (), "supported": (0,), "clamped": (0, 1)}
    rows = [legendre.legval(side, tables[order]) for side, kind in zip((-1, 1), kinds, strict=True)
            for order in held[kind]]  # fmt: skip
    space = scipy.linalg.null_space(np.array(rows)) if rows else np.eye(polynomials)
    value, slope, bend = (table @ space for table in values)
    none = np.zeros_like(value)
    # Curvatures along r, along θ and the twist, as polynomials in α; those of the other function in 2 - α.
    one = [[none, -value, value], [bend, value, none], [-slope, slope, none]]
    two = [[2 * value, -3 * value, value], [2 * value + bend, -value, none], [slope, -slope, none]]
    energy = np.zeros((5, space.shape[1], space.shape[1]))
    for i, j, factor in ((0, 0, 1.0), (1, 1, 1.0), (0, 1, ratio), (1, 0, ratio), (2, 2, 2 * (1 - ratio))):
        for first in range(3):
            for second in range(3):
                energy[first + second] += factor * (two[i][first].T * weights) @ one[j][second]
    count = space.shape[1]
    companion = np.zeros((4 * count, 4 * count))
    companion[: 3 * count, count:] = np.eye(3 * count)
    companion[3 * count :] = np.hstack([-np.linalg.solve(energy[4], part) for part in energy[:4]])
    exponents, vectors = np.linalg.eig(companion)
    at = angle * (s + 1) / 2
    for index in np.argsort(exponents.real, kind="stable"):
        exponent = complex(exponents[index])
        if abs(exponent.imag) < WHOLE:
            exponent = complex(exponent.real)
        whole = abs(exponent - round(exponent.real)) < WHOLE
        if not LEAST_EXPONENT < exponent.real < largest or exponent.imag < 0 or whole:
            continue
        shape = value @ vectors[:count, index]
        frequency = np.array([exponent, -exponent, exponent - 2, 2 - exponent])
        waves = np.exp(1j * np.outer(at, frequency))
        factors = np.linalg.lstsq(waves, shape, rcond=None)[0]
        if np.abs(waves @ factors - shape).max() < MISSED * np.abs(shape).max():
            # Of the same sign or phase at a corner a little changed.
            largest_part = shape[np.argmax(np.abs(shape) * (1 + LOPSIDED * s))]
            yield exponent, factors * (largest_part.conj() / np.abs(largest_part) / np.abs(shape).max())


def along_line(ends: np.ndarray, inner: Sequence[bool], count: int, outline: Outline, interval: float) -> Singular:
    """Return biharmonic functions whose third derivative jumps across a line of ends (2, 2) [m] alone, and which bend
    without bound at its ``inner`` ends; others are moved off the plate.

    With z from -1 to 1 along the line and z = (ζ + 1/ζ)/2, |ζ| ≥ 1, they are Re ∫ F dz + Im z Im F: with F = ζ^-n for
    forces F″ that have no sum and no moment, n from 1 to a ``count``, and with F″ = 1/√(z² - 1) and z/√(z² - 1).
    """
    start, end = (complex(*point) for point in ends)
    length = abs(end - start)
    direction = (end - start) / length
    low, high = (
        point if inside else point + sign * direction / 2 * min(length, clear(outline, point, sign * direction))
        for point, inside, sign in ((start, inner[0], -1), (end, inner[1], 1))
    )
    middle, half, n = (low + high) / 2, abs(high - low) / 2, np.arange(1, count + 1)[:, None]
    below = np.where(n == 1, np.inf, n - 1)

    def local(place: np.ndarray) -> Local:
        z = place / half
        root = np.sqrt(z - 1) * np.sqrt(z + 1)
        root = np.where(np.abs(root) < TINY, TINY, root)
        less, inverse, log = 1 / root, 1 / (z + root), np.log(z + root)
        power = np.ones((count + 2, z.size), dtype=complex)
        for before, after in pairwise(power):
            np.multiply(before, inverse, out=after)
        integral, f, slope, bend = np.empty((4, count + 2, z.size), dtype=complex)
        f[:-2], f[-2:] = power[1:-1], (z * log - root, (z * root - log) / 2)
        slope[:-2], slope[-2:] = -n * (f[:-2] * less), (log, root)
        bend[:-2], bend[-2:] = slope[:-2] * (less * (-n - z * less)), (less, z * less)
        integral[:-2] = ((n == 1) * log - power[:-2] / below + power[2:] / (n + 1)) / 2
        integral[-2:] = ((2 * z**2 + 1) * log - 3 * z * root) / 4, (root**3 / 3 - z * log + root) / 2
        y = z.imag
        value = integral.real + y * f.imag
        slopes = (f.real + y * slope.imag) / half, y * slope.real / half
        bends = (slope.real + y * bend.imag) / half**2, y * bend.real / half**2, (slope.real - y * bend.imag) / half**2
        return np.ones(1), (value,), slopes, bends

    places = tuple((point.real, point.imag) for point, inside in zip((start, end), inner, strict=True) if inside)
    cuts, turn = tuple(part * interval for part in NEAR), float(np.angle(direction))
    return Singular(np.array([middle.real, middle.imag]), turn, count + 2, local, places=places, cuts=cuts)


def along_ring(ring: Arc, orders: int) -> Singular:
    """Return the biharmonic functions f(r) cos kθ and f(r) sin kθ inside and outside a ring, across which their third
    derivative jumps."""
    radius, waves = ring.least_radius, np.arange(orders + 1)
    # Outside, with logarithms for k of 0 and 1: r^-k or log r, and r^(2-k) or r^(2-k) log r; inside r^k and r^(k+2).
    terms = [(-waves, waves == 0), (2 - waves, waves <= 1), (waves, waves < 0), (waves + 2, waves < 0)]
    parts = [_powers(powers.astype(float), logs, radius) for powers, logs in terms]
    at = [np.array(part(np.array([radius]))) * radius ** np.arange(3)[:, None, None] for part in parts]
    thirds = [_third(powers, logs) for powers, logs in terms]
    rows = np.stack([np.concatenate([value[:, :, 0], third[None]]) for value, third in zip(at, thirds, strict=True)])
    rows[2:] *= -1
    factors = np.linalg.solve(rows.transpose(2, 1, 0), np.array([0.0, 0.0, 0.0, 1.0])[:, None])[:, :, 0]

    def along(r: np.ndarray) -> list[np.ndarray]:
        values = [np.array(part(r)) * factor[:, None] for part, factor in zip(parts, factors.T, strict=True)]
        sums = np.where(r > radius, values[0] + values[1], values[2] + values[3])
        return [*np.concatenate([sums, sums[:, 1:]], axis=1)]

    both = np.concatenate([waves, waves[1:]])[:, None]
    around = _waves(both, np.repeat([1.0, -1j], [waves.size, waves.size - 1])[:, None])
    return Singular(ring.centre, 0.0, both.size, _polar(along, around))


def _third(powers: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Return the third derivatives of r^a or r^a log r at 1."""
    a = powers.astype(float)
    return np.where(logs, 3 * a**2 - 6 * a + 2, a * (a - 1) * (a - 2))


def around_hole(hole: Arc, interval: float) -> Singular:
    """Return log r, r² log r, r log r cos θ and r^-n, r^(2-n) times waves about a round hole."""
    radius = hole.least_radius
    terms = [(0.0, 1, 0, 1.0), (2.0, 1, 0, 1.0)] + [(1.0, 1, 1, part) for part in (1.0, -1j)]
    for n in range(1, laurent_orders(radius, interval) + 1):
        powers = (-n, 2 - n) if n > 1 else (-n,)
        terms += [(float(power), 0, n, part) for power in powers for part in (1.0, -1j)]
    exponents, logs, waves, parts = (np.array(column) for column in zip(*terms, strict=True))
    cuts = radius * HOLE_RATIO ** np.arange(max(1, math.ceil(math.log(2 * interval / radius, HOLE_RATIO))))
    local = _polar(_powers(exponents, logs, radius), _waves(waves[:, None], parts[:, None]))
    return Singular(hole.centre, 0.0, len(terms), local, places=(tuple(hole.centre),), cuts=tuple(cuts[::-1].tolist()))


def sample(
    functions: Sequence[Singular], x: np.ndarray, y: np.ndarray, orders: Sequence[tuple[int, int]] = ((0, 0),)
) -> np.ndarray:
    """Return (orders, all functions, points) derivatives at points (points,) [m]."""
    return np.concatenate([function.values(x, y, orders) for function in functions], axis=1)


def is_singular(before: Piece, after: Piece, angle: float) -> bool:
    """Return whether moments are singular where two pieces meet at an angle [rad] of the plate."""
    return angle > math.pi + STRAIGHT or before.condition != after.condition


def is_round(loop: Sequence[Piece]) -> TypeGuard[tuple[Arc]]:
    """Return whether a loop is a circle."""
    if len(loop) > 1 or not isinstance(loop[0], Arc):
        return False
    longer, shorter = np.linalg.svd(loop[0].axes, compute_uv=False)
    return bool(longer - shorter < SAME * longer)


def on_edge(outline: Outline, point: np.ndarray) -> bool:
    """Return whether a point lies on an edge."""
    return min(piece.nearest(point)[1] for piece in outline.pieces) < ON_EDGE


def laurent_orders(radius: float, interval: float) -> int:
    """Return the number of waves about a round hole of a radius [m]."""
    return min(MOST_ORDERS, FEWEST_ORDERS + math.ceil(FURTHER_ORDERS * radius / interval))


def clear(outline: Outline, place: complex, direction: complex) -> float:
    """Return the distance [m] from a place in a direction, of size 1, at which a ray meets the outline again."""
    nearest = math.inf
    for polygon in outline.polygons():
        points = ((polygon @ [1, 1j]) - place) / direction
        ahead = np.roll(points, -1)
        crossed = np.flatnonzero((points.imag > 0) != (ahead.imag > 0))
        start, end = points[crossed], ahead[crossed]
        at = start.real - start.imag * (end.real - start.real) / (end.imag - start.imag)
        nearest = min([nearest, *at[at > AWAY * np.abs(points).max()].tolist()])
    return nearest
