"""Integrals of a scene's fields times products of two functions, over the products of splines, and over regions.

Every entry is an integral ∫ C(x, y) X_i X_k Y_j Y_l dA of a field and of derivatives of functions. Gauss's rule makes
it a product of three matrices: pairs of functions of y, the field at Gauss's points, pairs of functions of x. Pairs
that never overlap are left out, so that the same product yields small dense matrices and large sparse ones.

The sides of a rectangular region and the lines of a mask are further breaks of Gauss's rule. Regions of other shapes
are cut into chords, see :mod:`warp_plate.modal.spaces.chords`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np

from warp_plate.effects.effect import DISPLACEMENT, Factors, Term
from warp_plate.effects.layers import Layer
from warp_plate.modal.spaces.chords import Chords, Curve, curves_of
from warp_plate.modal.spaces.knots import lines
from warp_plate.modal.spaces.space import FunctionSpace, Matrix
from warp_plate.modal.spaces.splines import (
    Pairs,
    Splines,
    gauss,
    make_splines,
    overlapping_pairs,
    side_products,
    weighted_products,
)
from warp_plate.plate.section import Laminate, bilinear
from warp_plate.plate.shapes import read_mask
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import NamedTarget, PlateRegion, Target

# With this many breaks between two knots (fine maps), this many Gauss points between two breaks suffice.
FINE, FINE_RULE = 4, 3
# Eigenvalues of a matrix below this part of the largest are rounding.
ROUNDING = 1e-15
# Gauss points between two lines of the plate for its mean wave.
POINTS_OF_MEAN = 2
Field: TypeAlias = "np.ndarray | float | OnChords"


@dataclass(frozen=True, eq=False)
class OnChords:
    """A field on a part of the plate."""

    chords: Chords
    values: np.ndarray  # (segments, points) at the points of the rule

    def __rmul__(self, factor: float) -> OnChords:
        return OnChords(self.chords, factor * self.values)


Cuts: TypeAlias = "tuple[Sequence[float], Sequence[float]]"


class SplineProducts(FunctionSpace, ABC):
    """Base of the function spaces of products of splines X_i(x) Y_j(y); x is fastest."""

    scene: Scene
    integrals: Integrals  # the plate with its rectangular layers
    along: tuple[Splines, Splines]  # splines of x and of y
    rule: Integrals | Chords  # points of the plate at which fields count

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

    @abstractmethod
    def _fields(self) -> tuple[np.ndarray | float, ...]:
        """Return Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²] at the points of the plate's rule, or as numbers,
        without the layers of other shapes than rectangles."""

    @property
    @abstractmethod
    def _weights(self) -> np.ndarray:
        """Weights [m²] of the plate's rule."""

    @abstractmethod
    def region_rule(self, target: Target) -> tuple[Integrals | Chords, np.ndarray | float]:
        """Return the rule on a target, and what counts of its points, from 0 to 1."""

    @abstractmethod
    def _chords(self, curves: Sequence[Curve] = (), cuts: Cuts = ((), ())) -> Chords:
        """Return the rule on the part of the plate inside curves, with further breaks along x and y [m]."""

    @abstractmethod
    def _form_on(self, chords: Chords, coefficient: np.ndarray | float, factors: Factors) -> np.ndarray:
        """Return the integral of a term over the points of a rule, like ``form``."""

    @abstractmethod
    def _sums(
        self, chords: Chords, vectors: np.ndarray, orders: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[slice, list[np.ndarray]]]:
        """Yield blocks of segments, and there (n, points) derivatives of vectors (unknowns, n), by their ``orders``."""

    @abstractmethod
    def _on_chords(self, chords: Chords) -> np.ndarray:
        """Return (unknowns,) integrals of the functions over the points of a rule."""

    @property
    def plate_mass(self) -> float:
        added = (float((mass.chords.weights * mass.values).sum()) for *_, mass in self._layers)
        return sum(added, start=float((self._weights * self._fields()[-1]).sum()))

    def bending_terms(self) -> Iterator[Term]:
        for fields in (self._fields(), *self._layers):
            yield from bending_terms(fields)

    def mass_matrix(self) -> Matrix:
        first, *others = (self.form(fields[-1]) for fields in (self._fields(), *self._layers))
        return self.scatter(sum(others, start=first))

    def region_integrals(self, regions: Sequence[PlateRegion]) -> np.ndarray:
        areas = [region.area for region in regions if region.area is not None]
        rectangles = iter(self.patch_integrals(np.array(areas)) if areas else ())
        rows = [
            next(rectangles) if region.area is not None else self._on_chords(self._chords(curves_of(region)))
            for region in regions
        ]
        return np.array(rows).reshape(-1, self.unknowns)

    def region_areas(self, regions: Sequence[PlateRegion]) -> np.ndarray:
        whole = self.scene.outline is None
        areas = (region.patch_area if whole else self._chords(curves_of(region)).weights.sum() for region in regions)
        return np.array(list(areas), dtype=float)

    @cached_property
    def _layers(self) -> list[tuple[OnChords, ...]]:
        """Return what each layer of another shape than a rectangle adds to Dx, D1, Dy, Dxy and the mass per area."""
        return [tuple(self._added(layer, self._chords(curves_of(layer)))) for layer in self.laminate.shaped_layers]

    def _added(self, layer: Layer, chords: Chords) -> Iterator[OnChords]:
        bare = chords.sampled(self.integrals.fields_at)
        for values in chords.sampled(partial(self.integrals.fields_at, over=layer)) - bare:
            yield OnChords(chords, values)

    def layer_rules(
        self, target: Target | None = None, within: Area | None = None
    ) -> Iterator[tuple[Chords, np.ndarray | float]]:
        """Yield the rule on each such layer, or on its part in a region, and what counts of its points."""
        for index, layer in enumerate(self.laminate.shaped_layers):
            if target is None:
                yield self._layers[index][0].chords, 1.0
            elif target.mask is None:
                yield self._chords([*curves_of(target, within), *curves_of(layer)]), 1.0
            else:
                cuts, mask = mask_of(self.laminate, target)
                chords = self._chords(curves_of(layer, within), cuts)
                yield chords, chords.sampled(mask)[0]

    def _layer_masses(self, target: Target, within: Area | None) -> Iterator[np.ndarray]:
        """Yield the integrals of what such layers add to the mass of a region."""
        rules = self.layer_rules(target, within)
        for layer, (chords, share) in zip(self.laminate.shaped_layers, rules, strict=True):
            *_, mass = self._added(layer, chords)
            yield self._form_on(chords, mass.values * share, DISPLACEMENT)

    def _density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the mass per area [kg/m²] on the grid (y, x) of points [m]."""
        density = self.integrals.fields_at(x, y)[-1]
        for layer in self.laminate.shaped_layers:
            inside = layer.contains(np.stack(np.meshgrid(x, y), axis=-1))
            density = np.where(inside, self.integrals.fields_at(x, y, layer)[-1], density)
        return density

    def _bending_on(self, vectors: np.ndarray, chords: Chords, fields: Sequence[np.ndarray | float]) -> np.ndarray:
        """Return (n, n) bending energies of vectors (unknowns, n) on chords, from their curvatures."""
        energies = np.zeros((vectors.shape[1],) * 2)
        weighted = [np.broadcast_to(chords.weights * field, chords.weights.shape) for field in fields[:4]]
        for some, (xx, xy, yy) in self._sums(chords, vectors, ((2, 0), (1, 1), (0, 2))):
            bend_xx, bend_xy, bend_yy, twist = (values[some].ravel() for values in weighted)
            coupled = (bend_xy * xx) @ yy.T
            energies += (bend_xx * xx) @ xx.T + (bend_yy * yy) @ yy.T + 4 * (twist * xy) @ xy.T + coupled + coupled.T
        return energies

    def diagonals(
        self, chords: Chords, matrix: np.ndarray, orders: Sequence[tuple[tuple[int, int], tuple[int, int]]]
    ) -> list[np.ndarray]:
        """Return Σ_ij matrix_ij ∂ψ_i ∂'ψ_j (segments, points) of a symmetric matrix (unknowns, unknowns) at the points
        of a rule, for pairs of ``orders`` of derivatives along x and y."""
        values, vectors = np.linalg.eigh(matrix)
        counts = np.abs(values) > ROUNDING * np.abs(values).max()
        values, vectors = values[counts], vectors[:, counts]
        single = sorted({order for pair in orders for order in pair})
        totals = [np.zeros(chords.weights.shape) for _ in orders]
        for some, sums in self._sums(chords, vectors, single) if values.size else ():
            by_order = dict(zip(single, sums, strict=True))
            for total, (one, two) in zip(totals, orders, strict=True):
                total[some] = (values @ (by_order[one] * by_order[two])).reshape(total[some].shape)
        return totals

    def region_mass(self, region: Area | Target) -> float:
        """Return the mass [kg] of the part of a rectangle or target on the plate, without what is attached."""
        target = region if isinstance(region, Target) else Target.model_construct(area=region)
        rule, share = self.region_rule(target)
        mass = float((rule.weights * share * self._density_on(rule)).sum())
        for layer, (chords, part) in zip(self.laminate.shaped_layers, self.layer_rules(target), strict=True):
            *_, added = self._added(layer, chords)
            mass += float((chords.weights * part * added.values).sum())
        return mass

    def _density_on(self, rule: Integrals | Chords) -> np.ndarray | float:
        """Return the mass per area [kg/m²] at the points of a rule, a number where it is the same at all."""
        if self.laminate.even_mass:
            x, y = self.integrals.points
            return float(self.integrals.fields_at(x[:1], y[:1])[-1][0, 0])
        return rule.sampled(lambda x, y: self.integrals.fields_at(x, y)[-1:])[0]

    def _section(self, axis: int) -> list[float]:
        """Return where the fields of the section are not smooth along x (0) or y (1) [m]."""
        return [place for place, _ in lines(self.laminate, axis)]


def bending_terms(fields: Sequence[Field]) -> Iterator[Term]:
    """Yield the terms of bending, Dx u_xx² + Dy u_yy² + 4 Dxy u_xy² + 2 D1 u_xx u_yy, from :meth:`Integrals.fields`."""
    bend_xx, bend_xy, bend_yy, twist, _ = fields
    yield Term("stiffness", bend_xx, ("xx", "xx"))
    yield Term("stiffness", bend_yy, ("yy", "yy"))
    yield Term("stiffness", 4 * twist, ("xy", "xy"))
    yield Term("stiffness", bend_xy, ("xx", "yy"))
    yield Term("stiffness", bend_xy, ("yy", "xx"))


class Integrals:
    """Integrals of a plate's fields times products of two functions, by Gauss's rule, with ``rule`` points between two
    ``breaks`` along x and y [m], between which fields and functions are smooth."""

    def __init__(
        self,
        laminate: Laminate,
        along_x: Splines,
        along_y: Splines,
        cuts: tuple[Sequence[float], Sequence[float]] = ((), ()),
    ) -> None:
        """Prepare the rule; ``cuts`` are further breaks along x and y [m]."""
        self.laminate, self.along = laminate, (along_x, along_y)
        self.breaks = tuple(
            np.unique(np.clip([*splines.breaks, *(place for place, _ in lines(laminate, axis)), *cuts[axis]], 0, side))
            for axis, (splines, side) in enumerate(zip(self.along, laminate.size, strict=True))
        )
        self.rule = along_x.degree + (3 if laminate.varied else 1)
        cells = min(len(breaks) / len(splines.breaks) for breaks, splines in zip(self.breaks, self.along, strict=True))
        if cells >= FINE:
            self.rule = FINE_RULE
        rules = [gauss(breaks, self.rule) for breaks in self.breaks]
        self.points, self._weights = (rules[0][0], rules[1][0]), (rules[0][1], rules[1][1])

    def sampled(self, fields: Callable[[np.ndarray, np.ndarray], Sequence[np.ndarray]]) -> np.ndarray:
        """Return fields (n, y, x) at Gauss's points by their function of x and y [m]."""
        return np.stack(fields(*self.points))

    def on_lines(self, axis: int, places: np.ndarray, weights: np.ndarray, span: Sequence[float]) -> Integrals:
        """Return the rule on lines at places along x (0) or y (1) [m], within a span of breaks of the other side [m],
        for the sum of the integrals along them by weights."""
        lines, points = copy(self), self.points[1 - axis]
        within = (points > span[0]) & (points < span[1])
        across, along = (places, weights), (points[within], self._weights[1 - axis][within])
        (x, of_x), (y, of_y) = (across, along) if axis == 0 else (along, across)
        lines.points, lines._weights = (x, y), (of_x, of_y)
        return lines

    @property
    def pairs(self) -> tuple[Pairs, Pairs]:
        """(2,) rows and columns of the pairs of functions of x and of y that overlap."""
        return overlapping_pairs(self.along[0]), overlapping_pairs(self.along[1])

    def fields(self) -> tuple[np.ndarray | float, ...]:
        """Return Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²] at Gauss's points (y, x), or as numbers."""
        if self.laminate.varied:
            return self.fields_at(*self.points)
        return tuple(float(field[0, 0]) for field in self.fields_at(self.points[0][:1], self.points[1][:1]))

    def fields_at(self, x: np.ndarray, y: np.ndarray, over: Layer | None = None) -> tuple[np.ndarray, ...]:
        """Return the fields of :meth:`fields` at points (y, x) [m], with a layer of another shape ``over`` them all."""
        (bend_xx, bend_xy, bend_yy), twist, mass, _ = self.laminate.fields(x, y, over=over)
        return bend_xx, bend_xy, bend_yy, twist, mass

    def inside(self, area: Area) -> np.ndarray:
        """Return one at Gauss points (y, x) in a rectangle x0, x1, y0, y1 [m] with sides at breaks, otherwise zero."""
        x, y = self.points
        return np.outer((y > area[2]) & (y < area[3]), (x > area[0]) & (x < area[1])).astype(float)

    @property
    def weights(self) -> np.ndarray:
        """Weights [m²] of Gauss's points (y, x)."""
        return np.outer(self._weights[1], self._weights[0])

    def values(self, field: np.ndarray | float, x: tuple[int, int] = (0, 0), y: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Return (pairs of y, pairs of x) ∫ field · u^(x₀, y₀) u^(x₁, y₁) dA of a number or of values at Gauss's points
        (y, x), with derivatives along x and y of the first factor, of the rows' functions, and of the second."""
        if isinstance(field, float):
            return np.outer(side_products(self.along[1], *y), field * side_products(self.along[0], *x))
        (along_x, of_x), (along_y, of_y) = (
            weighted_products(*side) for side in zip(self.along, (x, y), self.points, self._weights, strict=True)
        )
        return np.asarray((along_y @ field @ along_x.T)[of_y][:, of_x])


def mean_wave_frequency(laminate: Laminate) -> float:
    """Return the frequency [Hz] of a bending wave with one half-wave per metre, by the mean of mass over rigidity."""
    along_x, along_y = (make_splines(side, ("free", "free"), 1, 2) for side in laminate.size)
    integrals = Integrals(laminate, along_x, along_y)
    (x, weights_x), (y, weights_y) = (gauss(breaks, POINTS_OF_MEAN) for breaks in integrals.breaks)
    bend_xx, _, bend_yy, _, mass = integrals.fields_at(x, y)
    total = weights_y @ (mass / np.minimum(bend_xx, bend_yy)) @ weights_x
    return math.pi / 2 * math.sqrt(math.prod(laminate.size) / total)


def region_values(
    laminate: Laminate, along: tuple[Splines, Splines], region: Area | Target, within: Area | None
) -> np.ndarray:
    """Return ∫ ρH u u dA over a rectangle or mask [kg], for each pair of functions of y and of x; see
    ``region_matrix``."""
    integrals, share = region_rule(laminate, along, region, within)
    return integrals.values(integrals.fields()[-1] * share)


def region_rule(
    laminate: Laminate, along: tuple[Splines, Splines], region: Area | Target, within: Area | None = None
) -> tuple[Integrals, np.ndarray]:
    """Return the rule for integrals over a rectangle or mask, and what counts of Gauss's points (y, x), from 0 to 1."""
    area = region.area if isinstance(region, Target) else region
    if area is not None:
        area = _common(area, within)
        integrals = Integrals(laminate, *along, (area[:2], area[2:]))
        return integrals, integrals.inside(area)
    assert isinstance(region, Target)
    return _over_mask(laminate, along, region, within)


def _common(first: Area, second: Area | None) -> Area:
    if second is None:
        return first
    return max(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), min(first[3], second[3])


def _over_mask(
    laminate: Laminate, along: tuple[Splines, Splines], target: Target, within: Area | None
) -> tuple[Integrals, np.ndarray]:
    """Return the rule of a mask, which is bilinear between its numbers, and these at Gauss's points."""
    cuts, share = mask_of(laminate, target)
    area = _common(laminate.plate.box, within)
    integrals = Integrals(laminate, *along, ([*cuts[0], *area[:2]], [*cuts[1], *area[2:]]))
    (shares,) = share(*integrals.points)
    return integrals, shares * integrals.inside(area)


def mask_of(laminate: Laminate, target: Target) -> tuple[Cuts, Callable[[np.ndarray, np.ndarray], list[np.ndarray]]]:
    """Return the lines of a target's mask along x and y [m], and the function of x and y [m] of its shares."""
    key = f"targets ({target.name!r})" if isinstance(target, NamedTarget) else "target"
    mask, (width, height) = read_mask(laminate.folder, key, target), laminate.size
    lines_x, lines_y = (
        np.linspace(0, side, max(count, 2)).tolist()
        for side, count in zip((width, height), mask.shape[::-1], strict=True)
    )
    return (lines_x, lines_y), lambda x, y: [bilinear(mask, x / width, y / height)]
