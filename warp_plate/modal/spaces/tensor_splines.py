"""Products of splines X_i(x) Y_j(y) as a function space of a rectangular plate; x is fastest."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.effects.effect import DISPLACEMENT, SLOPE, Factors
from warp_plate.modal.spaces.chords import Chords, Curve, LocalSplines, curves_of, make_chords
from warp_plate.modal.spaces.integrals import (
    Cuts,
    Field,
    Integrals,
    OnChords,
    SplineProducts,
    region_rule,
    region_values,
)
from warp_plate.modal.spaces.knots import plate_splines
from warp_plate.modal.spaces.space import Matrix
from warp_plate.modal.spaces.splines import Splines, end_products, gauss, overlapping_pairs, side_products
from warp_plate.outline.outline import Outline
from warp_plate.plate.section import laminate_of
from warp_plate.row_blocks import read_only
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion, Target

# Derivatives along x and y of the factors of terms.
ORDERS = {"": (0, 0), "x": (1, 0), "y": (0, 1), "xx": (2, 0), "xy": (1, 1), "yy": (0, 2)}
# Matrices of so many unknowns at most keep the places of their entries for further plates, and of how many plates.
MOST_UNKNOWNS, PLACES_KEPT = 4096, 4
# Largest number of points with curvatures in memory.
POINTS = 1 << 18


class TensorSplines(SplineProducts):
    """Function space of a rectangular plate.

    The methods are described in :class:`warp_plate.modal.spaces.space.FunctionSpace`; pieces are the intervals between
    knots, and the points that resolve the functions are as many as these.
    """

    sparse = True

    def __init__(self, scene: Scene, intervals: tuple[int, int], along: tuple[Splines, Splines] | None = None) -> None:
        """Make the space, with about a number of intervals along x and y, or of given splines ``along`` both."""
        self.scene, self.laminate, self.intervals = scene, laminate_of(scene), intervals
        if along is None:
            x, y = (plate_splines(self.laminate, scene.edges, axis, intervals[axis]) for axis in (0, 1))
            along = x, y
        self.along = along
        self.rule = self.integrals = Integrals(self.laminate, *self.along)

    @property
    def unknowns(self) -> int:
        return self.along[0].functions * self.along[1].functions

    def density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self._density(x, y)

    def _fields(self) -> tuple[np.ndarray | float, ...]:
        return self.integrals.fields()

    @property
    def _weights(self) -> np.ndarray:
        return self.integrals.weights

    def form(self, coefficient: Field, factors: Factors = DISPLACEMENT) -> np.ndarray:
        if isinstance(coefficient, OnChords):
            return self._form_on(coefficient.chords, coefficient.values, factors)
        x, y = zip(*(ORDERS[factor] for factor in factors), strict=True)
        return self.integrals.values(coefficient, x=x, y=y)

    def edge_form(self, side: str, coefficients: Mapping[Factors, float]) -> np.ndarray:
        axis, high = 0 if side in ("left", "right") else 1, side in ("right", "top")
        products = (
            coefficient * end_products(self.along[axis], high, int(factors == SLOPE))
            for factors, coefficient in coefficients.items()
        )
        across = np.asarray(sum(products))
        along = side_products(self.along[1 - axis], 0, 0)
        return np.outer(along, across) if axis == 0 else np.outer(across, along)

    def scatter(self, values: np.ndarray) -> Matrix:
        places = (_places if self.unknowns <= MOST_UNKNOWNS else _places.__wrapped__)(*self.along)
        # SciPy sorts and prunes matrices in place, so that the places are copied.
        return Matrix((values.ravel()[places.data], places.indices, places.indptr), places.shape, copy=True)

    def bending_energies(self, vectors: np.ndarray) -> np.ndarray:
        """Return (n, n) Φᵀ B Φ of vectors Φ (unknowns, n), from their curvatures at Gauss's points."""
        integrals, (rows, columns) = self.integrals, self.shape
        bend_xx, bend_xy, bend_yy, twist, _ = (integrals.weights * field for field in integrals.fields())
        coefficients = vectors.reshape(rows, columns, -1)
        along_x, along_y = (
            [Matrix(splines.values(points, derivative).T) for derivative in (0, 1, 2)]
            for splines, points in zip(self.along, integrals.points, strict=True)
        )
        total = np.zeros((vectors.shape[1], vectors.shape[1]))
        step = max(1, POINTS // integrals.points[0].size)
        for part in (slice(start, start + step) for start in range(0, integrals.points[1].size, step)):
            xx, xy, yy = (_values(along_y[2 - i][part], along_x[i], coefficients) for i in (2, 1, 0))
            for field, first, second in ((bend_xx, xx, xx), (bend_yy, yy, yy), (4 * twist, xy, xy)):
                total += (field[part].ravel() * first) @ second.T
            coupled = (bend_xy[part].ravel() * xx) @ yy.T
            total += coupled + coupled.T
        for layer in self._layers:
            total += self._bending_on(vectors, layer[0].chords, [field.values for field in layer])
        return total

    def at_points(self, points: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
        x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
        return _products(self.along[1].values(y), self.along[0].values(x))

    def sums_at_points(self, coefficients: np.ndarray, points: np.ndarray) -> np.ndarray:
        # Many points share an ordinate: those of small grids and of lines.
        sides = (np.unique(side, return_inverse=True) for side in np.asarray(points, dtype=float).reshape(-1, 2).T)
        (x, at_x), (y, at_y) = sides
        used_x, used_y = map(_used, self.along)
        along_x = coefficients.reshape(-1, self.shape[1]) @ self._whole[1][0].dense(x)[:, used_x].T
        along_y = self._whole[1][1].dense(y)[:, used_y].T
        along_x = np.take(along_x.reshape(len(coefficients), self.shape[0], x.size), at_x, axis=2)
        return np.einsum("nyp,yp->np", along_x, np.take(along_y, at_y, axis=1))

    def on_grid(self, coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        tables = coefficients.reshape(*coefficients.shape[:-1], *self.shape)
        return np.asarray(self.along[1].values(y).T @ tables @ self.along[0].values(x))

    def patch_integrals(self, areas: np.ndarray) -> np.ndarray:
        x0, x1, y0, y1 = np.asarray(areas, dtype=float).reshape(-1, 4).T
        return _products(self.along[1].integrals(y0, y1), self.along[0].integrals(x0, x1))

    def patch_slopes(self, areas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along_x, along_y = self.along
        x0, x1, y0, y1 = areas.reshape(-1, 4).T
        across, up = along_x.values(x1) - along_x.values(x0), along_y.values(y1) - along_y.values(y0)
        return _products(along_y.integrals(y0, y1), across), _products(up, along_x.integrals(x0, x1))

    def curvature_integrals(self, areas: np.ndarray) -> np.ndarray:
        along_x, along_y = self.along
        x0, x1, y0, y1 = areas.T
        bent_x, bent_y = along_x.values(x1, 1) - along_x.values(x0, 1), along_y.values(y1, 1) - along_y.values(y0, 1)
        return _products(along_y.integrals(y0, y1), bent_x) + _products(bent_y, along_x.integrals(x0, x1))

    def moments(self, counts: tuple[int, int]) -> np.ndarray:
        sides = []
        for splines, side, count in zip(self.along, self.scene.plate.size, counts, strict=True):
            points, weights = gauss(splines.breaks, splines.degree + 1 + math.ceil(count / (splines.breaks.size - 1)))
            sides.append((splines.values(points) * weights) @ legendre.legvander(2 * points / side - 1, count - 1))
        return np.einsum("jb,ia->baji", sides[1], sides[0]).reshape(*counts[::-1], self.unknowns)

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        (x, across), (y, up) = (gauss(splines.breaks, splines.degree // 2 + 2) for splines in self.along)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), np.outer(up, across).ravel()

    def region_matrix(self, region: Area | Target, within: Area | None = None) -> Matrix:
        target = region if isinstance(region, Target) else Target.model_construct(area=region)
        if target.area is not None or target.mask is not None:
            values = region_values(self.laminate, self.along, target, within)
        else:
            chords = self._chords(curves_of(target, within))
            values = self._form_on(chords, self._density_on(chords), DISPLACEMENT)
        return self.scatter(sum(self._layer_masses(target, within), start=values))

    def region_rule(self, target: Target) -> tuple[Integrals | Chords, np.ndarray | float]:
        if target.area is not None or target.mask is not None:
            return region_rule(self.laminate, self.along, target)
        return self._chords(curves_of(target)), 1.0

    @cached_property
    def _whole(self) -> tuple[Outline, tuple[LocalSplines, LocalSplines]]:
        """The plate, and all splines on the knots, among them those that the conditions of the edges leave out."""
        x, y = (LocalSplines(replace(splines, left_out=(0, 0))) for splines in self.along)
        width, height = self.scene.plate.size
        return Outline((tuple(PlateRegion.model_construct(area=(0.0, width, 0.0, height)).loop()),)), (x, y)

    def _chords(self, curves: Sequence[Curve] = (), cuts: Cuts = ((), ())) -> Chords:
        outline, along = self._whole
        count = self.integrals.rule
        breaks = [*self._section(0), *cuts[0]], [*self._section(1), *cuts[1]]
        return make_chords(outline, along, (count, count + 1), breaks, curves)

    def _sums(
        self, chords: Chords, vectors: np.ndarray, orders: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[slice, list[np.ndarray]]]:
        left_out = (splines.left_out for splines in reversed(self.along))
        return chords.sums(np.pad(vectors.T.reshape(-1, *self.shape), [(0, 0), *left_out]), orders)

    def _on_chords(self, chords: Chords) -> np.ndarray:
        rows, columns = (_used(splines) for splines in reversed(self.along))
        return chords.integrals()[rows, columns].ravel()

    def _form_on(self, chords: Chords, coefficient: np.ndarray | float, factors: Factors) -> np.ndarray:
        x, y = zip(*(ORDERS[factor] for factor in factors), strict=True)
        values = chords.form(coefficient, (x[0], x[1]), (y[0], y[1]))
        used = []
        for splines, whole in zip(reversed(self.along), reversed(self._whole[1]), strict=True):
            some = np.arange(whole.splines.functions)[_used(splines)]
            used.append(np.isin(overlapping_pairs(whole.splines), some).all(axis=0))
        return np.asarray(values[np.ix_(*used)])

    def parity_bases(self) -> list[Matrix]:
        """Return bases (unknowns, n) of the motions that are even or odd about the middle of each side.

        The modes of a plate whose opposite edges are alike, and that is the same everywhere, are one or the other.
        """
        edges, (x, y) = self.scene.edges, self.along
        alike = edges.bottom == edges.top and y.symmetric, edges.left == edges.right and x.symmetric
        return _parity_bases(self.shape, alike)

    def of_scene(self, scene: Scene) -> TensorSplines:
        return TensorSplines(scene, self.intervals)

    def is_near(self, other: TensorSplines, share: float) -> bool:
        for splines, others in zip(self.along, other.along, strict=True):
            if splines.knots.size != others.knots.size or splines.left_out != others.left_out:
                return False
            if np.abs(splines.knots - others.knots).max() > share * np.diff(others.breaks).min():
                return False
        return True


def _products(along_y: np.ndarray, along_x: np.ndarray) -> np.ndarray:
    """Return (places, unknowns) products of functions of y (rows, places) and of functions of x (columns, places)."""
    products = along_y.T[:, :, None] * along_x.T[:, None, :]
    return products.reshape(len(products), len(along_y) * len(along_x))


def _values(along_y: Matrix, along_x: Matrix, coefficients: np.ndarray) -> np.ndarray:
    """Return (modes, points) from functions at y (ny, rows) and x (nx, columns) and (rows, columns, modes)."""
    rows, columns, modes = coefficients.shape
    strips = (along_y @ coefficients.reshape(rows, -1)).reshape(-1, columns, modes).transpose(1, 2, 0)
    values = (along_x @ strips.reshape(columns, -1)).reshape(along_x.shape[0], modes, -1)
    return np.ascontiguousarray(values.transpose(1, 2, 0)).reshape(modes, -1)


def _used(splines: Splines) -> slice:
    """Return which of all splines on the knots the conditions of the ends do not leave out."""
    return slice(splines.left_out[0], splines.left_out[0] + splines.functions)


@lru_cache(PLACES_KEPT)
def _parity_bases(shape: tuple[int, int], alike: tuple[bool, bool]) -> list[Matrix]:
    """Return the bases of sequences along y and x, whose ends are ``alike`` or not."""
    along_y, along_x = (_parities(count) if same else [np.eye(count)] for count, same in zip(shape, alike, strict=True))
    return [Matrix(scipy.sparse.kron(Matrix(y), Matrix(x))) for y in along_y for x in along_x]


def _parities(count: int) -> list[np.ndarray]:
    """Return orthonormal bases (count, n) of the even and the odd sequences."""
    identity = np.eye(count)
    even, odd = identity + identity[::-1], identity - identity[::-1]
    return [part / np.linalg.norm(part, axis=0) for part in (even[:, : (count + 1) // 2], odd[:, : count // 2])]


@lru_cache(PLACES_KEPT)
def _places(along_x: Splines, along_y: Splines) -> Matrix:
    """Return the sparse matrix of the places of its entries among the pairs."""
    (row_x, column_x), (row_y, column_y) = overlapping_pairs(along_x), overlapping_pairs(along_y)
    count, unknowns = along_x.functions, along_x.functions * along_y.functions
    rows, columns = row_y[:, None] * count + row_x, column_y[:, None] * count + column_x
    places = Matrix((np.arange(rows.size), (rows.ravel(), columns.ravel())), (unknowns, unknowns))
    read_only(places.data, places.indices, places.indptr)
    return places
