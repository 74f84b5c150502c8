"""B-splines along one side of a plate, with the conditions of its two ends built in.

On an open knot vector only the first spline has a value at the low end, and only the first two have a slope there: a
supported end leaves out the first, a clamped one the first two, and likewise at the high end. Knots of multiplicity m
leave degree − m continuous derivatives. Gauss's rule between knots is exact for products of two splines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.polynomial import legendre

from warp_plate.row_blocks import read_only

# Number of splines that each end leaves out.
CONDITIONS = {"free": 0, "supported": 1, "clamped": 2}
# Corners closer to each other than this fraction of the side are replaced by the sharpest one.
MERGED = 5e-5
# Splines that are kept, with what is computed of them, for further plates.
SPLINES_KEPT = 32
# Products along a side that are kept for further plates.
PRODUCTS_KEPT = 128
Pairs: TypeAlias = "tuple[np.ndarray, np.ndarray]"


@dataclass(frozen=True, eq=False)
class Splines:
    """The splines of one direction; :func:`make_splines` returns the same object for the same arguments."""

    knots: np.ndarray  # (knots,) positions with repetitions [m], those of the ends ``degree + 1`` times
    degree: int  # Degree of the polynomials between knots
    left_out: tuple[int, int]  # Number of splines left out at the low and the high end

    @property
    def functions(self) -> int:
        """Number of functions."""
        return self.knots.size - self.degree - 1 - sum(self.left_out)

    @cached_property
    def breaks(self) -> np.ndarray:
        """(intervals + 1,) positions of the knots without repetitions [m]."""
        return read_only(np.unique(self.knots))[0]

    @property
    def symmetric(self) -> bool:
        """True if the knots are symmetric about the middle of the side."""
        return bool(np.abs(self.knots + self.knots[::-1] - self.knots[-1]).max() < MERGED * self.knots[-1])

    def scaled(self, length: float) -> Splines:
        """Return the splines stretched to a side of another length [m]."""
        return self if length == self.knots[-1] else replace(self, knots=self.knots * (length / self.knots[-1]))

    def values(self, x: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return (functions, points) values of a derivative at x [m], of discontinuous ones those to the right."""
        return self._kept(_bsplines(self.knots, self.degree, np.asarray(x, dtype=float), derivative))

    def integrals(self, low: np.ndarray, high: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return (functions, intervals) integrals of a derivative from ``low`` to ``high`` [m]."""
        if derivative:
            return self.values(high, derivative - 1) - self.values(low, derivative - 1)
        return self._from_start(high) - self._from_start(low)

    @cached_property
    def _pieces(self) -> np.ndarray:
        """(degree + 1, functions, intervals) values in powers of x − break, highest first."""
        powers = range(self.degree, -1, -1)
        return np.stack([self.values(self.breaks[:-1], power) / math.factorial(power) for power in powers])

    @property
    def integral_pieces(self) -> np.ndarray:
        """(intervals, functions, degree + 2) integrals from the low end in powers of x − break, highest first."""
        powers = np.arange(self.degree + 1, 0, -1)[:, None, None]
        return np.concatenate([self._pieces / powers, self._from_start(self.breaks[:-1])[None]]).T

    def _from_start(self, x: np.ndarray) -> np.ndarray:
        """Return (functions, points) integrals from the low end to x [m], sums of splines of one degree more."""
        knots = np.concatenate([self.knots[:1], self.knots, self.knots[-1:]])
        higher = _bsplines(knots, self.degree + 1, np.asarray(x, dtype=float))
        sums = np.cumsum(higher[:0:-1], axis=0)[::-1]
        widths = self.knots[self.degree + 1 :] - self.knots[: -self.degree - 1]
        return self._kept(widths[:, None] / (self.degree + 1) * sums)

    def _kept(self, splines: np.ndarray) -> np.ndarray:
        """Return the rows of the splines that the ends do not leave out."""
        first, last = self.left_out
        return splines[first : len(splines) - last]


@lru_cache(SPLINES_KEPT)
def make_splines(
    length: float, ends: tuple[str, str], intervals: int, degree: int, corners: tuple[tuple[float, int], ...] = ()
) -> Splines:
    """Return splines over 0 ... ``length`` [m] with at least ``intervals`` intervals between knots, of about one size,
    and ends "clamped", "supported" or "free"; at ``corners`` [m] fewer derivatives are continuous."""
    continuous: dict[float, int] = {}
    for position, derivatives in sorted(corners, key=lambda corner: corner[1]):
        if all(abs(position - other) > MERGED * length for other in (0.0, length, *continuous)):
            continuous[position] = derivatives
    positions = np.array(sorted({0.0, length, *continuous}))
    knots = [np.zeros(degree + 1)]
    for low, high in pairwise(positions):
        count = max(1, round(intervals * (high - low) / length))
        knots.append(np.linspace(low, high, count + 1)[1:-1])
        repeated = degree + 1 if high == length else degree - continuous[float(high)]
        knots.append(np.full(repeated, high))
    (all_knots,) = read_only(np.concatenate(knots))
    return Splines(all_knots, degree, (CONDITIONS[ends[0]], CONDITIONS[ends[1]]))


@lru_cache
def _leggauss(points: int) -> tuple[np.ndarray, ...]:
    """Return positions and weights of Gauss's rule from -1 to 1."""
    return read_only(*legendre.leggauss(points))


def gauss(breaks: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and weights of Gauss's rule with a number of points between each two breaks."""
    s, weights = _leggauss(points)
    half = np.diff(breaks)[:, None] / 2
    return (breaks[:-1, None] + half * (1 + s)).ravel(), (half * weights).ravel()


def _bsplines(knots: np.ndarray, degree: int, x: np.ndarray, derivative: int = 0) -> np.ndarray:
    """Return (splines, points) values of a derivative at x [m] by the recursion of Cox and de Boor, for the only
    splines that are not zero there."""
    interval = np.clip(np.searchsorted(knots, x, side="right") - 1, degree, knots.size - degree - 2)
    below, above = (knots[interval + shift[:, None]] for shift in np.arange(2 * degree).reshape(2, -1) - degree + 1)
    values = np.ones((1, x.size))
    for order in range(1, degree + 1):
        low, high = below[degree - order :], above[:order]
        scaled, values = values * (1 / (high - low)), np.zeros((order + 1, x.size))
        if order > degree - derivative:
            values[:-1] -= scaled
            values[1:] += scaled
            values *= order
        else:
            np.multiply(high - x, scaled, out=values[:-1])
            values[1:] += (x - low) * scaled
    splines = np.zeros((knots.size - degree - 1, x.size))
    splines[interval + np.arange(-degree, 1)[:, None], np.arange(x.size)] = values
    return splines


@lru_cache(PRODUCTS_KEPT)
def side_products(splines: Splines, first: int, second: int) -> np.ndarray:
    """Return (pairs,) ∫ of two derivatives over a whole side, the first of the function in the row."""
    products, of_pairs = weighted_products(splines, (first, second), *gauss(splines.breaks, splines.degree + 1))
    return read_only(np.asarray(products.sum(axis=1)[of_pairs]))[0]


@lru_cache(PRODUCTS_KEPT)
def end_products(splines: Splines, high: bool, derivative: int) -> np.ndarray:
    """Return (pairs,) products of a derivative at the low or the high end of a side."""
    place = splines.breaks[-1 if high else 0]
    values = splines.values(np.array([place]), derivative)[:, 0]
    rows, columns = overlapping_pairs(splines)
    return read_only(np.asarray(values[rows] * values[columns]))[0]


def weighted_products(
    splines: Splines, derivatives: tuple[int, int], points: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray | slice]:
    """Return (products, points) weighted products of derivatives of two functions, and which of them is that of each
    pair; of equal derivatives those of (i, k) and (k, i) are the same."""
    equal = derivatives[0] == derivatives[1]
    (rows, columns), of_pairs = _unordered(splines) if equal else (overlapping_pairs(splines), slice(None))
    values = [splines.values(points, derivative) for derivative in derivatives]
    return values[0][rows] * values[1][columns] * weights, of_pairs


@lru_cache(PRODUCTS_KEPT)
def _unordered(splines: Splines) -> tuple[Pairs, np.ndarray]:
    """Return the distinct unordered pairs, and the index of each pair among them."""
    ordered = np.sort(np.stack(overlapping_pairs(splines)), axis=0)
    (first, second), of_pairs = np.unique(ordered, axis=1, return_inverse=True)
    first, second, of_pairs = read_only(first, second, of_pairs.ravel())
    return (first, second), of_pairs


@lru_cache(PRODUCTS_KEPT)
def overlapping_pairs(splines: Splines) -> Pairs:
    """Return rows and columns of all pairs of functions that are not zero in a common interval."""
    index = np.arange(splines.functions)
    near = np.abs(index[:, None] - index) <= splines.degree
    rows, columns = read_only(*np.nonzero(near))
    return rows, columns
