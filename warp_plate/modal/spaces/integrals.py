"""Integrals of a scene's fields times products of two functions, over the products of splines, and over regions.

Every entry is an integral ∫ C(x, y) X_i X_k Y_j Y_l dA of a field and of derivatives of functions. Gauss's rule makes
it a product of three matrices: pairs of functions of y, the field at Gauss's points, pairs of functions of x. Pairs
that never overlap are left out, so that the same product yields small dense matrices and large sparse ones.

The sides of a rectangular region and the lines of a mask are further breaks of Gauss's rule. A disc or polygon is cut
into chords along x, with Gauss's rule along each chord, and along y for the integrals over the chords. These are smooth
in y between knots, corners, and the points of the outline where a chord ends on a line across which the mass or the
splines are not smooth. On a disc the rule is in the angle θ, y = y₀ + r sin θ, as the chords' length r cos θ is smooth
in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

from warp_plate.effects.effect import Term
from warp_plate.modal.spaces.knots import lines
from warp_plate.modal.spaces.splines import (
    Pairs,
    Splines,
    gauss,
    make_splines,
    overlapping_pairs,
    side_products,
    weighted_products,
)
from warp_plate.plate.section import bilinear, factors_at, laminates
from warp_plate.plate.shapes import clipped, read_mask
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# With this many breaks between two knots (fine maps), this many Gauss points between two breaks suffice.
FINE, FINE_RULE = 4, 3
# Gauss points between two lines of the plate for its mean wave.
POINTS_OF_MEAN = 2
# Corners of the polygon for the part of a disc in a rectangle.
DISC_CORNERS = 512
Field: TypeAlias = "np.ndarray | float"


class SplineProducts:
    """What the function spaces of products of splines X_i(x) Y_j(y) share; x is fastest."""

    along: tuple[Splines, Splines]  # splines of x and of y

    @property
    def degree(self) -> int:
        return self.along[0].degree

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of splines along y and along x."""
        return self.along[1].functions, self.along[0].functions

    @property
    def interval_sizes(self) -> tuple[float, float]:
        """Mean distances between knots along x and along y [m]."""
        x, y = (float(np.diff(splines.breaks).mean()) for splines in self.along)
        return x, y


def bending_terms(fields: Sequence[Field]) -> Iterator[Term]:
    """Yield the terms of bending, Dx u_xx² + Dy u_yy² + 4 Dxy u_xy² + 2 D1 u_xx u_yy, from :meth:`Integrals.fields`."""
    bend_xx, bend_xy, bend_yy, twist, _ = fields
    yield Term("stiffness", bend_xx, ("xx", "xx"))
    yield Term("stiffness", bend_yy, ("yy", "yy"))
    yield Term("stiffness", 4 * twist, ("xy", "xy"))
    yield Term("stiffness", bend_xy, ("xx", "yy"))
    yield Term("stiffness", bend_xy, ("yy", "xx"))


class Integrals:
    """Integrals of a scene's fields times products of two functions, by Gauss's rule, with ``rule`` points between two
    ``breaks`` along x and y [m], between which fields and functions are smooth."""

    def __init__(
        self,
        scene: Scene,
        along_x: Splines,
        along_y: Splines,
        cuts: tuple[Sequence[float], Sequence[float]] = ((), ()),
    ) -> None:
        """Prepare the rule; ``cuts`` are further breaks along x and y [m]."""
        self.scene, self.along = scene, (along_x, along_y)
        self._varied = bool(scene.layers or scene.effects.factor_maps)
        self.breaks = tuple(
            np.unique(np.clip([*splines.breaks, *(place for place, _ in lines(scene, axis)), *cuts[axis]], 0, side))
            for axis, (splines, side) in enumerate(zip(self.along, scene.plate.size, strict=True))
        )
        self.rule = along_x.degree + (3 if self._varied else 1)
        cells = min(len(breaks) / len(splines.breaks) for breaks, splines in zip(self.breaks, self.along, strict=True))
        if cells >= FINE:
            self.rule = FINE_RULE
        rules = [gauss(breaks, self.rule) for breaks in self.breaks]
        self.points, self._weights = (rules[0][0], rules[1][0]), (rules[0][1], rules[1][1])

    @property
    def pairs(self) -> tuple[Pairs, Pairs]:
        """(2,) rows and columns of the pairs of functions of x and of y that overlap."""
        return overlapping_pairs(self.along[0]), overlapping_pairs(self.along[1])

    def fields(self) -> tuple[Field, ...]:
        """Return Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²] at Gauss's points (y, x), or as numbers."""
        if self._varied:
            return self.fields_at(*self.points)
        return tuple(float(field[0, 0]) for field in self.fields_at(self.points[0][:1], self.points[1][:1]))

    def fields_at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the fields of :meth:`fields` at points (y, x) [m]."""
        (bend_xx, bend_xy, bend_yy), twist, mass, _ = laminates(self.scene, x, y, factors_at(self.scene, x, y))
        return bend_xx, bend_xy, bend_yy, twist, mass

    def inside(self, area: Area) -> np.ndarray:
        """Return one at Gauss points (y, x) in a rectangle x0, x1, y0, y1 [m] with sides at breaks, otherwise zero."""
        x, y = self.points
        return np.outer((y > area[2]) & (y < area[3]), (x > area[0]) & (x < area[1])).astype(float)

    @property
    def weights(self) -> np.ndarray:
        """Weights [m²] of Gauss's points (y, x)."""
        return np.outer(self._weights[1], self._weights[0])

    def values(self, field: Field, x: tuple[int, int] = (0, 0), y: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Return (pairs of y, pairs of x) ∫ field · u^(x₀, y₀) u^(x₁, y₁) dA of a number or of values at Gauss's points
        (y, x), with derivatives along x and y of the first factor, of the rows' functions, and of the second."""
        if isinstance(field, float):
            return np.outer(side_products(self.along[1], *y), field * side_products(self.along[0], *x))
        (along_x, of_x), (along_y, of_y) = (
            weighted_products(*side) for side in zip(self.along, (x, y), self.points, self._weights, strict=True)
        )
        return np.asarray((along_y @ field @ along_x.T)[of_y][:, of_x])


def mean_wave_frequency(scene: Scene) -> float:
    """Return the frequency [Hz] of a bending wave with one half-wave per metre, by the mean of mass over rigidity."""
    along_x, along_y = (make_splines(side, ("free", "free"), 1, 2) for side in scene.plate.size)
    integrals = Integrals(scene, along_x, along_y)
    (x, weights_x), (y, weights_y) = (gauss(breaks, POINTS_OF_MEAN) for breaks in integrals.breaks)
    bend_xx, _, bend_yy, _, mass = integrals.fields_at(x, y)
    total = weights_y @ (mass / np.minimum(bend_xx, bend_yy)) @ weights_x
    return math.pi / 2 * math.sqrt(math.prod(scene.plate.size) / total)


def region_values(
    scene: Scene, along: tuple[Splines, Splines], region: Area | Target, within: Area | None
) -> np.ndarray:
    """Return ∫ ρH u u dA over a region [kg], for each pair of functions of y and of x; see ``region_matrix``."""
    area = region.area if isinstance(region, Target) else region
    if area is not None:
        area = _common(area, within)
        integrals = Integrals(scene, *along, (area[:2], area[2:]))
        return integrals.values(integrals.fields()[-1] * integrals.inside(area))
    assert isinstance(region, Target)
    if region.mask is not None:
        return _over_mask(scene, along, region, within)
    return _over_chords(scene, along, region, within)


def _common(first: Area, second: Area | None) -> Area:
    if second is None:
        return first
    return max(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), min(first[3], second[3])


def _over_mask(scene: Scene, along: tuple[Splines, Splines], target: Target, within: Area | None) -> np.ndarray:
    """Return the values of a mask, which is bilinear between its numbers."""
    key = next((key for key, listed in scene.targets_by_key.items() if listed == target), "target")
    mask = read_mask(scene, key, target)
    (width, height), (rows, columns) = scene.plate.size, mask.shape
    area = _common((0.0, width, 0.0, height), within)
    cuts = [*np.linspace(0, width, max(columns, 2)), *area[:2]], [*np.linspace(0, height, max(rows, 2)), *area[2:]]
    integrals = Integrals(scene, *along, cuts)
    x, y = integrals.points
    share = bilinear(mask, x / width, y / height)
    return integrals.values(integrals.fields()[-1] * share * integrals.inside(area))


def _over_chords(scene: Scene, along: tuple[Splines, Splines], target: Target, within: Area | None) -> np.ndarray:
    """Return the values of a disc or polygon; part of a disc counts as part of a polygon of DISC_CORNERS corners."""
    integrals = Integrals(scene, *along)
    count, (breaks_x, breaks_y) = integrals.rule, integrals.breaks
    places = np.array([place for place, _ in lines(scene, 0)])
    if target.disc is not None and within is None:
        y, weights, chords = _disc_chords(target.disc, places, breaks_y, count)
    else:
        corners = target.corners(DISC_CORNERS)
        assert corners is not None
        corners = corners if within is None else clipped(corners, within)
        y, weights, chords = _polygon_chords(corners, places, breaks_y, count)
    rows, columns = integrals.pairs[0]
    along_x = np.empty((y.size, rows.size))
    for number, (low, high) in enumerate(chords):
        inside = breaks_x[(breaks_x > low) & (breaks_x < high)]
        x, shares = gauss(np.concatenate([[low], inside, [high]]), count)
        values = along[0].values(x)
        density = integrals.fields_at(x, y[number : number + 1])[-1][0]
        along_x[number] = (values[rows] * values[columns]) @ (shares * density * weights[number])
    rows, columns = integrals.pairs[1]
    values = along[1].values(y)
    return np.asarray((values[rows] * values[columns]) @ along_x)


def _disc_chords(
    disc: tuple[float, float, float], places: np.ndarray, breaks: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Return ordinates [m], weights and ends [m] of the chords of a disc x, y, radius [m], by ``count`` Gauss points
    between places along x at which integrals are not smooth in the chords' ends, and breaks along y [m]."""
    x, y, radius = disc
    half = np.abs(places - x) / radius
    ends = np.arccos(half[half < 1])
    cuts = np.arcsin(np.clip((breaks - y) / radius, -1, 1))
    angle, weight = gauss(np.unique(np.concatenate([[-math.pi / 2, 0, math.pi / 2], cuts, ends, -ends])), count)
    half = radius * np.cos(angle)
    return y + radius * np.sin(angle), weight * half, list(zip(x - half, x + half, strict=True))


def _polygon_chords(
    corners: np.ndarray, places: np.ndarray, breaks: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Return the same of a polygon (corners, 2) [m]; an ordinate returns for each chord at it."""
    if len(corners) < 3:
        return np.empty(0), np.empty(0), []
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    share = (places[:, None] - x0) / np.where(x1 == x0, math.inf, x1 - x0)
    ends = (y0 + share * (y1 - y0))[(share > 0) & (share < 1)]
    inside = breaks[(breaks > y0.min()) & (breaks < y0.max())]
    y, weights = gauss(np.unique(np.concatenate([y0, inside, ends])), count)
    ordinates, shares, chords = [], [], []
    for at, weight in zip(y, weights, strict=True):
        crossed = (y0 < at) != (y1 < at)
        x = np.sort((x0 + (x1 - x0) * (at - y0) / np.where(crossed, y1 - y0, 1))[crossed])
        for low, high in zip(x[::2], x[1::2], strict=True):
            if high > low:
                ordinates.append(at)
                shares.append(weight)
                chords.append((low, high))
    return np.array(ordinates), np.array(shares), chords
