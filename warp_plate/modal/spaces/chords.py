"""Gauss's rule on the chords of a plate of any outline, with positive weights and all points on the plate.

Chords run along x. They are cut where they meet knots of the splines along x, and lie at Gauss's ordinates between the
knots along y, corners, extreme ordinates of the edges, and the points at which edges cross a knot along x: between
these the chords' ends are smooth in y. At extreme ordinates they end as a square root does, which a rule in the square
root of the distance resolves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.modal.spaces.splines import Splines, overlapping_pairs
from warp_plate.outline.outline import Outline
from warp_plate.outline.pieces import Arc, Monotone, Piece
from warp_plate.scene.fields import Area
from warp_plate.scene.target import PlateRegion

Curve = Sequence[Piece]
Square = tuple[float, float, float]  # Middle x, y and half of a side [m]

# Distances from extreme ordinates at which the rule is cut as well, as parts of an interval.
GRADED = (0.15, 0.0225, 0.003375)
# Ordinates nearer to each other than this part of the height are one.
SAME = 1e-12
# An extreme ordinate nearer to a cell than this part of its height counts, and on its side but for rounding [m].
NEAR, ROUNDING = 0.1, 1e-14
# Segments of several fields that are multiplied at once.
BLOCK = 256
# Cells that meet a square enlarged so many times are cut at its sides too: those behind a knot would otherwise be wide
# compared with their distance from its middle.
ENLARGED = 3.0
# Slope of the end of an arc that counts as extreme.
LEVEL = 1e-9
# Samples in which two curves are searched for a crossing, and halvings that find it.
SAMPLES, HALVINGS = 65, 50


class LocalSplines:
    """The splines along a side as polynomials on the intervals between knots, fast at many points."""

    def __init__(self, splines: Splines) -> None:
        self.splines, self.breaks, count = splines, splines.breaks, splines.degree + 1
        starts = splines.breaks[:-1]
        # The first spline that is not zero on each interval.
        self.first = np.searchsorted(splines.knots, starts, side="right") - count
        s, weights = legendre.leggauss(count)
        middle, half = (self.breaks[1:] + starts) / 2, np.diff(self.breaks) / 2
        values = splines.values((middle[:, None] + half[:, None] * s).ravel()).reshape(-1, starts.size, count)
        local = np.stack([values[first : first + count, index] for index, first in enumerate(self.first)])
        transform = legendre.legvander(s, count - 1) * weights[:, None] * (np.arange(count) + 0.5)
        self._powers = [local @ transform]
        for _ in range(2):
            slopes = legendre.legder(self._powers[-1], axis=2)
            slopes = np.concatenate([slopes, np.zeros((*slopes.shape[:2], count - slopes.shape[2]))], axis=2)
            self._powers.append(slopes / half[:, None, None])
        self._middle, self._half = middle, half
        coefficients = (legendre.leg2poly(row)[::-1] for row in np.eye(count))  # highest power first
        monomials = np.stack([np.pad(row, (count - row.size, 0)) for row in coefficients])
        # (degree + 1, degree + 1, intervals) splines that are not zero in powers of s, by derivative
        self._monomials = [np.ascontiguousarray((powers @ monomials).T) for powers in self._powers]

    def interval(self, x: np.ndarray) -> np.ndarray:
        """Return the interval that holds each point."""
        return np.clip(np.searchsorted(self.breaks, x, side="right") - 1, 0, self.first.size - 1)

    def local(self, interval: np.ndarray, x: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return (n, points, degree + 1) values of the splines that are not zero on intervals (n,) at x (n, points)."""
        s = (x - self._middle[interval, None]) / self._half[interval, None]
        vander = legendre.legvander(s, self.splines.degree)
        return np.asarray(vander @ self._powers[derivative][interval].transpose(0, 2, 1))

    def dense(self, x: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return (points, functions) values."""
        interval = self.interval(x)
        s = (x - self._middle[interval]) / self._half[interval]
        local, *others = np.take(self._monomials[derivative], interval, axis=2)
        for part in others:
            local *= s
            local += part
        values = np.zeros((x.size, self.splines.functions))
        values[np.arange(x.size), self.first[interval] + np.arange(len(local))[:, None]] = local
        return values


@dataclass(frozen=True, eq=False)
class Chords:
    """Gauss's points on segments of chords, each between two knots."""

    along: tuple[LocalSplines, LocalSplines]
    x: np.ndarray  # (segments, points) [m]
    weights: np.ndarray  # (segments, points) [m²]
    chord: np.ndarray  # (segments,) index of the ordinate
    ordinates: np.ndarray  # (ordinates,) y [m]
    block: int = 2**14  # segments whose products are in memory at once

    @property
    def y(self) -> np.ndarray:
        """(segments, points) ordinates [m] of the points."""
        return np.broadcast_to(self.ordinates[self.chord][:, None], self.x.shape)

    @cached_property
    def _intervals(self) -> tuple[np.ndarray, np.ndarray]:
        """Intervals of the segments along x, and of the ordinates along y."""
        return self.along[0].interval(self.x.mean(axis=1)), self.along[1].interval(self.ordinates)

    @cached_property
    def _columns(self) -> np.ndarray:
        """(segments, degree + 1) indices of the splines along x that are not zero on the segments."""
        return self.along[0].first[self._intervals[0]][:, None] + np.arange(self.along[0].splines.degree + 1)

    @cached_property
    def _values(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Values of the splines along x on the segments (segments, points, degree + 1), and of those along y
        (ordinates, functions), by derivative."""
        along_x = [self.along[0].local(self._intervals[0], self.x, derivative) for derivative in range(3)]
        return along_x, [self.along[1].dense(self.ordinates, derivative) for derivative in range(3)]

    def blocks(self, size: int = BLOCK) -> list[slice]:
        """Return slices of a number of segments that are all segments, each of neighbouring chords."""
        return [slice(first, first + size) for first in range(0, len(self.chord), size)]

    def sampled(self, fields: Callable[[np.ndarray, np.ndarray], Sequence[np.ndarray]]) -> np.ndarray:
        """Return (n, segments, points) of n ``fields`` (y, x) by their function of x (nx,) and y (ny,) [m]."""
        sampled = np.empty((len(fields(self.x.ravel()[:1], self.ordinates[:1])), *self.x.shape))
        for number, y in enumerate(self.ordinates):
            some = np.flatnonzero(self.chord == number)
            if not some.size:
                continue
            values = np.stack(fields(self.x[some].ravel(), np.array([y])))
            sampled[:, some] = values.reshape(len(values), some.size, -1)
        return sampled

    def form(self, field: np.ndarray | float, x: tuple[int, int], y: tuple[int, int]) -> np.ndarray:
        """Return (pairs of y, pairs of x) ∫ field · u^(x₀, y₀) u^(x₁, y₁) dA of a number or of values at the points,
        with derivatives along x and y of the first factor and of the second."""
        along_x, along_y = self._values
        rows, columns = overlapping_pairs(self.along[0].splines)
        pair = np.zeros((self.along[0].splines.functions,) * 2, dtype=int)
        pair[rows, columns] = np.arange(rows.size)
        index, weighted, over_x = self._columns, self.weights * field, np.zeros((self.ordinates.size, rows.size))
        for some in self.blocks(self.block):
            local = (along_x[x[0]][some] * weighted[some, :, None]).transpose(0, 2, 1) @ along_x[x[1]][some]
            low, high = self.chord[some].min(), self.chord[some].max() + 1
            places = (self.chord[some] - low)[:, None, None] * rows.size
            places = places + pair[index[some, :, None], index[some, None, :]]
            sums = np.bincount(places.ravel(), local.ravel(), (high - low) * rows.size)
            over_x[low:high] += sums.reshape(-1, rows.size)
        rows_y, columns_y = overlapping_pairs(self.along[1].splines)
        products = along_y[y[0]][:, rows_y] * along_y[y[1]][:, columns_y]
        return np.asarray(products.T @ over_x)

    def squares(self) -> np.ndarray:
        """Return (functions of y, functions of x) integrals of the products' squares."""
        along_x, along_y = self._values
        local = (along_x[0] ** 2 * self.weights[:, :, None]).sum(axis=1)
        sums = np.zeros((self.ordinates.size, self.along[0].splines.functions))
        np.add.at(sums, (self.chord[:, None], self._columns), local)
        return np.asarray((along_y[0] ** 2).T @ sums)

    def integrals(self, values: np.ndarray | float = 1.0, x: int = 0, y: int = 0) -> np.ndarray:
        """Return (..., functions of y, functions of x) ∫ values · u^(x, y) dA of values (..., segments, points)."""
        values = np.broadcast_to(values, np.broadcast_shapes(np.shape(values), self.x.shape))
        over_x = np.zeros((self.ordinates.size, self.along[0].splines.functions, math.prod(values.shape[:-2])))
        flat = values.reshape(math.prod(values.shape[:-2]), *self.x.shape)
        for some in self.blocks(BLOCK if len(flat) > 1 else self.block):
            self.add_along_x(over_x, some, flat[:, some] * self.weights[some], x)
        integrals = self.along_y(over_x, y)
        return integrals.reshape(*values.shape[:-2], *integrals.shape[1:])

    def add_along_x(self, sums: np.ndarray, some: slice, values: np.ndarray, x: int) -> None:
        """Add to (ordinates, functions of x, n) the sums of (n, some segments, points) times derivatives along x."""
        chords, over_x = self._along_x(some, values, x)
        sums[chords] += over_x

    def _along_x(self, some: slice, values: np.ndarray, x: int) -> tuple[slice, np.ndarray]:
        """Return some of the ordinates, and there (ordinates, functions of x, n) sums as in :meth:`add_along_x`."""
        along_x, columns = self._values[0][x][some], self._columns[some]
        if len(values) == 1:
            local = np.einsum("sp,spi->si", values[0], along_x)
        else:
            local = along_x.transpose(0, 2, 1) @ values.transpose(1, 2, 0)
        low, high, functions = self.chord[some].min(), self.chord[some].max() + 1, self.along[0].splines.functions
        places = ((self.chord[some, None] - low) * functions + columns).ravel()
        ones = (np.ones(places.size), (places, np.arange(places.size)))
        sparse = scipy.sparse.csr_array(ones, ((high - low) * functions, places.size))
        return slice(low, high), (sparse @ local.reshape(places.size, -1)).reshape(high - low, functions, -1)

    def add_integrals(self, sums: np.ndarray, some: slice, values: np.ndarray, x: int, y: int) -> None:
        """Add to (functions of y, functions of x, n) integrals of (n, some segments, points) times derivatives."""
        chords, over_x = self._along_x(some, values, x)
        sums += np.tensordot(self._values[1][y][chords], over_x, axes=(0, 0))

    def along_y(self, sums: np.ndarray, y: int) -> np.ndarray:
        """Return (n, functions of y, functions of x) integrals of sums by :meth:`add_along_x`."""
        return np.asarray(np.tensordot(sums, self._values[1][y], axes=(0, 0)).transpose(1, 2, 0))

    def sums(
        self, coefficients: np.ndarray, orders: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[slice, list[np.ndarray]]]:
        """Yield blocks of segments, and there (n, points) values of derivatives of sums (n, functions of y, functions
        of x), by their ``orders`` along x and y."""
        (along_x, along_y), columns = self._values, self._columns
        for some in self.blocks(self.block):
            low, high = self.chord[some].min(), self.chord[some].max() + 1
            values = []
            for x, y in orders:
                of_chord = np.einsum("lj,nji->nli", along_y[y][low:high], coefficients, optimize=True)
                local = of_chord[:, self.chord[some, None] - low, columns[some]]
                value = np.einsum("spi,nsi->nsp", along_x[x][some], local, optimize=True)
                values.append(value.reshape(len(coefficients), -1))
            yield some, values


def make_chords(
    outline: Outline,
    along: tuple[LocalSplines, LocalSplines],
    points: tuple[int, int],
    cuts: tuple[Sequence[float], Sequence[float]] = ((), ()),
    curves: Sequence[Curve] = (),
    folds: Sequence[Piece] = (),
    near: Sequence[Square] = (),
) -> Chords:
    """Return the rule of a plate with numbers of ``points`` between breaks along x and y.

    ``cuts`` are further breaks along x and y [m]; only what closed ``curves`` hold counts. Chords are cut where they
    meet ``folds``, and at the sides of squares ``near`` places where functions bend without bound.
    """
    breaks = [np.unique([*side.breaks, *cut]) for side, cut in zip(along, cuts, strict=True)]
    groups = [outline.monotone[1], *(tuple(part for piece in curve for part in piece.monotone(1)) for curve in curves)]
    if not all(groups):
        return _empty(along, points[0])
    pieces = [*outline.pieces, *(piece for curve in curves for piece in curve), *folds]
    folded = [part for fold in folds for part in fold.monotone(1)]
    ordinates, extremes = _cuts(pieces, groups, breaks, min(np.diff(side.breaks).max() for side in along))
    (s_x, w_x), (s_y, w_y) = (legendre.leggauss(count) for count in points)
    s_x, w_x, s_y, w_y = (s_x + 1) / 2, w_x / 2, (s_y + 1) / 2, w_y / 2
    x, weights, chord, lines = [], [], [], [np.empty(0)]
    count = 0
    for (low, high), across in _cells(pieces, ordinates, near).items():
        middle = (low + high) / 2
        edges = [(group, part) for group, parts in enumerate(groups) for part in parts if part.low < middle < part.high]
        if {group for group, _ in edges} != set(range(len(groups))):
            continue
        below, above = (gaps[gaps >= -ROUNDING].clip(0) / (high - low) for gaps in (low - extremes, extremes - high))
        part, share = _towards(s_y, w_y, below.min(initial=1.0), above.min(initial=1.0))
        y = low + (high - low) * part
        ends = np.array([part.across(y) for _, part in edges])
        order = np.argsort(ends[:, y.size // 2], kind="stable")
        owner, ends = np.array([group for group, _ in edges])[order], ends[order]
        inside = np.all([np.cumsum(owner == group) % 2 == 1 for group in range(len(groups))], axis=0)
        met = [part.across(y) for part in folded if part.low < middle < part.high]
        for number, (first, last) in product(np.flatnonzero(inside[:-1]).tolist(), across):
            left, right = np.clip(ends[number], first, last), np.clip(ends[number + 1], first, last)
            if not (left < right).any():
                continue
            inner = breaks[0][(breaks[0] > left.mean()) & (breaks[0] < right.mean())]
            stops = np.concatenate([[left], np.tile(inner[:, None], y.size), *([at] for at in met), [right]])
            stops = np.sort(np.clip(stops, left, right), axis=0)
            width = np.diff(stops, axis=0)
            x.append((stops[:-1, :, None] + width[:, :, None] * s_x).reshape(-1, s_x.size))
            weights.append((width[:, :, None] * w_x * (share * (high - low))[:, None]).reshape(-1, s_x.size))
            chord.append(np.tile(np.arange(count, count + y.size), len(width)))
        lines.append(y)
        count += y.size
    if not x:
        return _empty(along, s_x.size)
    return Chords(along, np.concatenate(x), np.concatenate(weights), np.concatenate(chord), np.concatenate(lines))


def _cells(
    pieces: Sequence[Piece], ordinates: np.ndarray, near: Sequence[Square]
) -> dict[tuple[float, float], list[tuple[float, float]]]:
    """Return rising ordinates y0, y1 and the parts x0, x1 [m] of the plate between them within which chords' ends are
    smooth: cells are the smaller the nearer they are to the middles of squares, at whose sides they are cut."""
    cells = np.array([[-math.inf, math.inf, low, high] for low, high in pairwise(ordinates.tolist())])
    for x, y, size in sorted(near, key=lambda square: -square[2]):
        about = np.array([x, x, y, y]) + ENLARGED * size * np.array([-1, 1, -1, 1])
        met = (cells[:, ::2] < about[1::2]).all(axis=1) & (cells[:, 1::2] > about[::2]).all(axis=1)
        parts = [
            [*across, *up]
            for first, last, low, high in cells[met].tolist()
            for across in pairwise(sorted({first, last, *(min(max(at, first), last) for at in (x - size, x + size))}))
            for up in pairwise(sorted({low, high, *(min(max(at, low), high) for at in (y - size, y + size))}))
        ]
        cells = np.concatenate([cells[~met], np.reshape(parts, (-1, 4))])
    sides = np.unique(cells[:, :2])[1:-1].tolist() if near else []
    crossed = {x: [y for piece in pieces for y in piece.points(piece.crossings(0, np.array([x])))[:, 1]] for x in sides}
    parts_of: dict[tuple[float, float], list[tuple[float, float]]] = {}
    for x0, x1, low, high in cells.tolist():
        cuts = {y for x in (x0, x1) for y in crossed.get(x, ()) if low < y < high}
        for up in pairwise(sorted({low, high, *cuts})):
            parts_of.setdefault(up, []).append((x0, x1))
    return dict(sorted(parts_of.items()))


def curves_of(region: PlateRegion, within: Area | None = None) -> list[Curve]:
    """Return the curves that hold a region, or its part in a rectangle x0, x1, y0, y1 [m]."""
    inner = [] if within is None else [PlateRegion.model_construct(area=within)]
    return [part.loop() for part in (region, *inner)]


def _empty(along: tuple[LocalSplines, LocalSplines], points: int) -> Chords:
    nothing = np.empty((0, points))
    return Chords(along, nothing, nothing, np.empty(0, dtype=int), np.empty(0))


def _cuts(
    pieces: Sequence[Piece], groups: Sequence[Sequence[Monotone]], breaks: Sequence[np.ndarray], interval: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ordinates between which chords' ends are smooth, and those that are extreme."""
    low = max(min(part.low for part in parts) for parts in groups)
    high = min(max(part.high for part in parts) for parts in groups)
    size = max(part.high for part in groups[0])
    ends = np.concatenate([piece.points(np.array([0.0, 1.0]))[:, 1] for piece in pieces])
    crossed = np.concatenate([piece.points(piece.crossings(0, breaks[0]))[:, 1] for piece in pieces])
    extremes = np.concatenate([piece.points(piece.extremes(1))[:, 1] for piece in pieces])
    # Arcs may begin or end at an extreme.
    arcs = [(piece, end) for piece in pieces for end in (0.0, 1.0) if isinstance(piece, Arc)]
    level = [piece.points(end)[1] for piece, end in arcs if abs(piece.tangents(end)[1]) < LEVEL * piece.length]
    extremes = np.concatenate([extremes, level])
    graded = [extremes + sign * part * interval for part in GRADED for sign in (-1, 1)]
    met = [place for first, parts in enumerate(groups) for others in groups[first + 1 :]
           for one in parts for two in others for place in _meetings(one, two)]  # fmt: skip
    places = np.sort(np.concatenate([breaks[1], ends, crossed, *graded, extremes, met]))
    places = places[(places >= low) & (places <= high)]
    # Of nearly equal ordinates an extreme one stays, or the first.
    kept: list[float] = []
    for place in places.tolist():
        if not kept or place - kept[-1] > SAME * size:
            kept.append(place)
    ordinates = np.array(kept)
    for extreme in extremes[(extremes >= low) & (extremes <= high)]:
        ordinates[np.abs(ordinates - extreme).argmin()] = extreme
    return ordinates, extremes


def _towards(s: np.ndarray, weights: np.ndarray, below: float, above: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss's rule from 0 to 1, in the square root of the distance from an extreme ordinate that is near, a part
    ``below`` 0 or ``above`` 1, or of those from both ends where these are extreme."""
    if max(below, above) == 0:
        return s * s * (3 - 2 * s), 6 * s * (1 - s) * weights
    near = min(below, above)
    if near > NEAR:
        return s, weights
    first, last = math.sqrt(near), math.sqrt(1 + near)
    root = first + (last - first) * (s if below < above else 1 - s)
    part, share = root**2 - near, 2 * (last - first) * root * weights
    return part if below < above else 1 - part, share


def _meetings(one: Monotone, two: Monotone) -> list[float]:
    """Return the ordinates [m] at which two edges cross."""
    low, high = max(one.low, two.low), min(one.high, two.high)
    if high <= low:
        return []
    y = np.linspace(low, high, SAMPLES)
    apart = one.across(y) - two.across(y)
    places = []
    for index in np.flatnonzero(apart[:-1] * apart[1:] < 0):
        start, end, sign = y[index], y[index + 1], np.sign(apart[index])
        for _ in range(HALVINGS):
            middle = np.array([(start + end) / 2])
            before = sign * (one.across(middle) - two.across(middle))[0] > 0
            start, end = (middle[0], end) if before else (start, middle[0])
        places.append(float((start + end) / 2))
    return places
