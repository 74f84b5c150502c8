"""Integrals of a scene's fields times products of two functions, as matrices over the products of splines.

Every entry is an integral ∫ C(x, y) X_i X_k Y_j Y_l dA of a field and of derivatives of functions. Gauss's rule makes
it a product of three matrices: pairs of functions of y, the field at Gauss's points, pairs of functions of x. Pairs
that never overlap are left out, so that the same product yields small dense matrices and large sparse ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import scipy

from warp_plate.modal.galerkin.lines import lines
from warp_plate.modal.galerkin.splines import Splines, gauss
from warp_plate.plate.section import factor_arrays, interpolate, laminates
from warp_plate.scene.effects import Variation
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene

# With this many breaks between two knots (fine maps), this many Gauss points between two breaks suffice.
FINE, FINE_RULE = 4, 3
# What is kept for further plates: products along a side, places of the entries of matrices of so many unknowns at most.
PRODUCTS_KEPT, PLACES_KEPT, MOST_UNKNOWNS = 128, 4, 4096
Matrix: TypeAlias = scipy.sparse.csr_array
Field: TypeAlias = np.ndarray | float
Pairs: TypeAlias = tuple[np.ndarray, np.ndarray]


class Integrals:
    """Integrals of a scene's fields times products of two functions, by Gauss's rule between all lines of the plate.

    Attributes:
        breaks: (2,) positions along x and along y [m] between which fields and functions are smooth.
        rule: Number of Gauss's points between two breaks.
        points: (2,) positions of Gauss's points along x and along y [m].
    """

    def __init__(
        self,
        scene: Scene,
        along_x: Splines,
        along_y: Splines,
        cuts: tuple[Sequence[float], Sequence[float]] = ((), ()),
    ) -> None:
        """Prepare the rule; ``cuts`` are further breaks along x and y [m]."""
        self.scene, self.along = scene, (along_x, along_y)
        self._varied = bool(scene.layers or scene.effects.variation)
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
        factors = {key: np.ones((y.size, x.size)) for key in Variation.model_fields}
        width, height = self.scene.plate.size
        for key, array in factor_arrays(self.scene).items():
            rows, columns = y / height * (len(array) - 1), x / width * (array.shape[1] - 1)
            factors[key] = interpolate(interpolate(array, rows).T, columns).T
        (bend_xx, bend_xy, bend_yy), twist, mass, _ = laminates(self.scene, x, y, factors)
        return bend_xx, bend_xy, bend_yy, twist, mass

    def inside(self, area: Area) -> np.ndarray:
        """Return one at Gauss points (y, x) in a rectangle x0, x1, y0, y1 [m] with sides at breaks, otherwise zero."""
        x, y = self.points
        return np.outer((y > area[2]) & (y < area[3]), (x > area[0]) & (x < area[1])).astype(float)

    def integral(self, field: Field) -> float:
        """Return ∫ field dA of values at Gauss's points (y, x), or of a number."""
        return float((self.weights * field).sum())

    @property
    def weights(self) -> np.ndarray:
        """Weights [m²] of Gauss's points (y, x)."""
        return np.outer(self._weights[1], self._weights[0])

    def matrix(self, field: Field) -> Matrix:
        """Return ∫ field · u u dA as a sparse matrix, of values at Gauss's points (y, x) or a number."""
        return self.scatter(self.values(field))

    def values(self, field: Field, x: tuple[int, int] = (0, 0), y: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Return (pairs of y, pairs of x) ∫ field · u^(x₀, y₀) u^(x₁, y₁) dA, the first factor of the rows' functions.

        Args:
            field: Values at Gauss's points (y, x), or a number.
            x: Derivatives along x of the first and of the second factor.
            y: Derivatives along y.
        """
        if isinstance(field, float):
            return np.outer(side_products(self.along[1], *y), field * side_products(self.along[0], *x))
        (along_x, of_x), (along_y, of_y) = (
            _products(*each) for each in zip(self.along, (x, y), self.points, self._weights, strict=True)
        )
        return np.asarray((along_y @ field @ along_x.T)[of_y][:, of_x])

    def scatter(self, values: np.ndarray) -> Matrix:
        """Return the sparse matrix of values (pairs of y, pairs of x)."""
        unknowns = self.along[0].functions * self.along[1].functions
        places = (_places if unknowns <= MOST_UNKNOWNS else _places.__wrapped__)(*self.along)
        # SciPy sorts and prunes matrices in place, so that the places are copied.
        return Matrix((values.ravel()[places.data], places.indices, places.indptr), places.shape, copy=True)


@lru_cache(PRODUCTS_KEPT)
def side_products(splines: Splines, first: int, second: int) -> np.ndarray:
    """Return (pairs,) ∫ of two derivatives over a whole side, the first of the function in the row."""
    products, of_pairs = _products(splines, (first, second), *gauss(splines.breaks, splines.degree + 1))
    return np.asarray(products.sum(axis=1)[of_pairs])


@lru_cache(PRODUCTS_KEPT)
def end_products(splines: Splines, high: bool, derivative: int) -> np.ndarray:
    """Return (pairs,) products of a derivative at the low or the high end of a side."""
    place = splines.breaks[-1 if high else 0]
    values = splines.values(np.array([place]), derivative)[:, 0]
    rows, columns = overlapping_pairs(splines)
    return np.asarray(values[rows] * values[columns])


def _products(
    splines: Splines, derivatives: tuple[int, int], points: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray | slice]:
    """Return (products, points) weighted products of derivatives of two functions, and which of them is that of each
    pair; of equal derivatives those of (i, k) and (k, i) are the same."""
    equal = derivatives[0] == derivatives[1]
    (rows, columns), of_pairs = _unordered(splines) if equal else (overlapping_pairs(splines), slice(None))
    values = [splines.values(points, derivative) for derivative in derivatives]
    return values[0][rows] * values[1][columns] * weights, of_pairs


@lru_cache(PLACES_KEPT)
def _places(along_x: Splines, along_y: Splines) -> Matrix:
    """Return the sparse matrix of the places of its entries among the pairs."""
    (row_x, column_x), (row_y, column_y) = overlapping_pairs(along_x), overlapping_pairs(along_y)
    count, unknowns = along_x.functions, along_x.functions * along_y.functions
    rows, columns = row_y[:, None] * count + row_x, column_y[:, None] * count + column_x
    return Matrix((np.arange(rows.size), (rows.ravel(), columns.ravel())), (unknowns, unknowns))


@lru_cache(PRODUCTS_KEPT)
def _unordered(splines: Splines) -> tuple[Pairs, np.ndarray]:
    """Return the distinct unordered pairs, and the index of each pair among them."""
    ordered = np.sort(np.stack(overlapping_pairs(splines)), axis=0)
    (first, second), of_pairs = np.unique(ordered, axis=1, return_inverse=True)
    return (first, second), of_pairs.ravel()


@lru_cache(PRODUCTS_KEPT)
def overlapping_pairs(splines: Splines) -> Pairs:
    """Return rows and columns of all pairs of functions that are not zero in a common interval."""
    index = np.arange(splines.functions)
    near = np.abs(index[:, None] - index) <= splines.degree
    rows, columns = np.nonzero(near)
    return rows, columns
