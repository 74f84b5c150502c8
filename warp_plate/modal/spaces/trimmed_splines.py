"""Products of splines on the part of their rectangle that a plate of any outline covers.

All products that touch the plate take part, scaled to unit energy; those that touch little of it are nearly dependent
on the others, so that the rank is found by truncation of the eigenvalues of the energy. The displacement of supported
and clamped edges, and the slope across clamped ones, vanish in the mean with Legendre polynomials along parts of the
edge and at its ends: the functions of the space span the motions for which these moments, exact between crossings of
knots, are zero (K. Höllig, U. Reif, J. Wipper, SIAM J. Numer. Anal. 39, 2001, scale and extend instead).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.effects.effect import DISPLACEMENT, SLOPE, Factors
from warp_plate.modal.spaces.added import added_functions, parted
from warp_plate.modal.spaces.chords import Chords, Curve, LocalSplines, curves_of, make_chords
from warp_plate.modal.spaces.edge_moments import RANK, Unlike, conditions, edge_rule, independent_functions, null_space
from warp_plate.modal.spaces.integrals import (
    Cuts,
    Field,
    Integrals,
    OnChords,
    SplineProducts,
    mask_of,
    mean_wave_frequency,
)
from warp_plate.modal.spaces.knots import outline_splines
from warp_plate.modal.spaces.singular import Singular, sample
from warp_plate.modal.spaces.space import Matrix
from warp_plate.modal.spaces.splines import Splines, gauss, overlapping_pairs
from warp_plate.modal.spaces.tensor_splines import ORDERS
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.section import laminate_of
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion, Target

# Squared frequency by which the mass counts in the energy, over that of about the first mode: smooth motions, whose
# energy is small beside that of what bends between dense knots, must stay far above RANK.
LOWEST = 1e3
# Products with less of their mass on the plate than this part take no part.
UNTOUCHED = 1e-22
# Forms of a uniform plate.
FORMS: list[Factors] = [("", ""), ("xx", "xx"), ("yy", "yy"), ("xy", "xy"), ("xx", "yy"), ("yy", "xx")]
# Matrices of all products that are in memory at a time.
DENSE_MATRICES = 12


class TrimmedSplines(SplineProducts):
    """Function space of a plate with an outline.

    See :class:`warp_plate.modal.spaces.space.FunctionSpace`; an array by :meth:`form` is the full matrix of products.
    """

    sparse = False
    added: tuple[Singular, ...]  # functions beside the products
    chords: Chords  # rule of the plate
    basis: np.ndarray  # (functions, unknowns)
    independent: int  # number of independent functions, whether the edges allow them or not
    kinds: list[int]  # numbers of added functions, and of conditions, of each kind

    def __init__(
        self,
        scene: Scene,
        intervals: tuple[int, int],
        like: TrimmedSplines | None = None,
        fixed: TrimmedSplines | None = None,
        along: tuple[Splines, Splines] | None = None,
        rank: float = RANK,
        near: TrimmedSplines | None = None,
    ) -> None:
        """Make the space, with the functions of ``like`` where they would be the same, those of ``fixed``, or splines
        ``along`` x and y; functions with less of the largest energy than ``rank`` depend on the others. ``near`` is a
        space of almost the same outline whose basis is followed; Unlike: it has functions of other kinds."""
        assert scene.outline is not None
        self.scene, self.laminate, self.intervals, self.outline = scene, laminate_of(scene), intervals, scene.outline
        curves = (support.piece(f"supports[{index}]") for index, support in parted(tuple(scene.supports)))
        self._pieces = (*self.outline.pieces, *(curve for curve in curves if curve is not None))
        own = (outline_splines(scene, self.laminate, axis, intervals[axis]) for axis in (0, 1))
        x, y = along or (fixed.along if fixed else own)
        self.along, self._local = (x, y), (LocalSplines(x), LocalSplines(y))
        self.integrals = Integrals(self.laminate, *self.along)
        self._interval = max(side / count for side, count in zip(scene.plate.size, intervals, strict=True))
        self.added = fixed.added if fixed else added_functions(scene, self._interval)
        alike = fixed if fixed and fixed._lines == self._lines else None
        self._forms: dict[Factors, np.ndarray] = alike._forms if alike else {}
        self.rule = self.chords = alike.chords if alike else self._chords()
        if not fixed:
            knots = [(one.knots, one.degree) for one in reversed(self.along)]
            sizes = np.outer(*(places[degree + 1 :] - places[: -degree - 1] for places, degree in knots))
            touched = self.chords.squares() > UNTOUCHED * sizes
            self._used: np.ndarray = near._used if near else np.flatnonzero(touched)
            self.count = self._used.size + sum(function.functions for function in self.added)
            refuse_beyond_memory(8.0 * self.count**2 * DENSE_MATRICES, f"plate.outline: {self.count} functions")
            if like and like.outline is self.outline and like.along == self.along and like.added is self.added:
                fixed = like if like.scene.supports == scene.supports else None
        else:
            self._used, self.count = fixed._used, fixed.count
        of_basis = (fixed.basis, fixed.independent, fixed.kinds) if fixed else self._make_basis(rank, near)
        self.basis, self.independent, self.kinds = of_basis

    @property
    def unknowns(self) -> int:
        return self.basis.shape[1]

    def density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(self._covered(x, y), self._density(x, y), 0.0)

    def _fields(self) -> tuple[np.ndarray | float, ...]:
        return self._fields_on(self.chords)

    @property
    def _weights(self) -> np.ndarray:
        return self.chords.weights

    def form(self, coefficient: Field, factors: Factors = DISPLACEMENT) -> np.ndarray:
        if isinstance(coefficient, OnChords):
            return self._form_on(coefficient.chords, coefficient.values, factors)
        if isinstance(coefficient, np.ndarray):
            return self._form_on(self.chords, coefficient, factors)
        if factors not in self._forms:
            self._forms |= self._forms_on(self.chords, 1.0, FORMS if factors in FORMS else [factors])
        return coefficient * self._forms[factors]

    def edge_form(self, side: str, coefficients: Mapping[Factors, float]) -> np.ndarray:
        total = np.zeros((self.basis.shape[0],) * 2)
        for index, support in enumerate(self.scene.supports):
            if support.point is not None and side == f"supports[{index}]":
                row = self._rows(np.array([support.point]))
                total += coefficients[DISPLACEMENT] * row.T @ row
        for piece in self._pieces:
            if piece.edge == side:
                t, weights = edge_rule(piece, self._local, 0.0, 1.0)
                for factors, coefficient in coefficients.items():
                    rows = self._rows(piece.points(t), piece.normals(t) if factors == SLOPE else None)
                    total += (rows * (coefficient * weights)[:, None]).T @ rows
        return total

    def scatter(self, values: np.ndarray) -> Matrix:
        projected = self.basis.T @ values @ self.basis
        return Matrix((projected + projected.T) / 2)

    def bending_energies(self, vectors: np.ndarray) -> np.ndarray:
        """Return (n, n) Φᵀ B Φ of vectors Φ (unknowns, n), from their curvatures at Gauss's points."""
        total = self._bending_on(vectors, self.chords, self._fields())
        for layer in self._layers:
            total += self._bending_on(vectors, layer[0].chords, [field.values for field in layer])
        return total

    def at_points(self, points: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
        places = np.asarray(points, dtype=float).reshape(-1, 2)
        return np.asarray((self._rows(places) * self.outline.contains(places)[:, None]) @ self.basis)

    def sums_at_points(self, coefficients: np.ndarray, points: np.ndarray) -> np.ndarray:
        return np.asarray(coefficients @ self.at_points(points).T)

    def on_grid(self, coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        products, added = np.split(coefficients @ self.basis.T, [self._used.size], axis=-1)
        values = self._local[1].dense(y) @ self._tables(products) @ self._local[0].dense(x).T
        covered = self._covered(x, y)
        if self.added:
            rows, columns = np.nonzero(covered)
            values[..., rows, columns] += added @ sample(self.added, x[columns], y[rows])[0]
        return np.asarray(np.where(covered, values, 0.0))

    def patch_integrals(self, areas: np.ndarray) -> np.ndarray:
        return self._over_patches(areas, ((0, 0),))

    def curvature_integrals(self, areas: np.ndarray) -> np.ndarray:
        return self._over_patches(areas, ((2, 0), (0, 2)))

    def patch_slopes(self, areas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sides = []
        for axis in (0, 1):
            low, high = 2 * axis, 2 - 2 * axis
            rows = [self._over_line(axis, area[low + 1], area[high], area[high + 1])
                    - self._over_line(axis, area[low], area[high], area[high + 1])
                    for area in np.asarray(areas, dtype=float).reshape(-1, 4)]  # fmt: skip
            sides.append(np.array(rows) @ self.basis)
        return sides[0], sides[1]

    def moments(self, counts: tuple[int, int]) -> np.ndarray:
        (width, height), chords = self.scene.plate.size, self.chords
        along_x = legendre.legvander(2 * chords.x / width - 1, counts[0] - 1)
        along_y = legendre.legvander(2 * chords.ordinates / height - 1, counts[1] - 1)
        polynomials = np.moveaxis(along_x, -1, 0)
        rows = [self._integrals(chords, polynomials * up[:, None]) for up in along_y.T[:, chords.chord]]
        return np.reshape(rows, (*counts[::-1], -1)) @ self.basis

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        return np.stack([self.chords.x, self.chords.y], axis=-1).reshape(-1, 2), self.chords.weights.ravel()

    def region_matrix(self, region: Area | Target, within: Area | None = None) -> Matrix:
        target = region if isinstance(region, Target) else Target.model_construct(area=region)
        chords, share = self.region_rule(target, within)
        values = self._form_on(chords, self._fields_on(chords)[-1] * share, DISPLACEMENT)
        return self.scatter(sum(self._layer_masses(target, within), start=values))

    def region_rule(self, target: Target, within: Area | None = None) -> tuple[Chords, np.ndarray | float]:
        if target.mask is None:
            return self._chords(curves_of(target, within)), 1.0
        cuts, mask = mask_of(self.laminate, target)
        chords = self._chords(curves_of(PlateRegion.model_construct(area=self.scene.plate.box), within), cuts)
        return chords, chords.sampled(mask)[0]

    def parity_bases(self) -> list[Matrix]:
        return [scipy.sparse.eye_array(self.unknowns, format="csr")]

    def of_scene(self, scene: Scene) -> TrimmedSplines:
        return TrimmedSplines(scene, self.intervals, self)

    def is_near(self, other: TrimmedSplines, share: float) -> bool:
        return self.basis is other.basis

    def _chords(self, curves: Sequence[Curve] = (), cuts: Cuts = ((), ())) -> Chords:
        count = self.degree + (3 if self.laminate.varied else 1)
        along_x, along_y = ([*self._section(axis), *cuts[axis]] for axis in (0, 1))
        near = list(dict.fromkeys(place for function in self.added for place in function.near()))
        low, high = self.outline.bounds[2:]
        section = along_x, np.clip(along_y, low, high).tolist()
        folds = [piece for piece in self._pieces if piece.edge.startswith("supports")] if self.added else []
        return make_chords(self.outline, self._local, (count, count + 1), section, curves, folds, near)

    @property
    def _lines(self) -> tuple[bool, list[float], list[float]]:
        """What the rule of the plate depends on besides the functions and the outline."""
        return self.laminate.varied, self._section(0), self._section(1)

    def _fields_on(self, chords: Chords) -> tuple[np.ndarray | float, ...]:
        """Return Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²] at the points of a rule, or as numbers."""
        if not self.laminate.varied:
            return self.integrals.fields()
        return tuple(chords.sampled(self.integrals.fields_at))

    def _form_on(self, chords: Chords, coefficient: np.ndarray | float, factors: Factors) -> np.ndarray:
        return self._forms_on(chords, coefficient, [factors])[factors]

    def _forms_on(
        self, chords: Chords, coefficient: np.ndarray | float, wanted: Sequence[Factors]
    ) -> dict[Factors, np.ndarray]:
        """Return the full matrices of forms over all functions, by their factors."""
        forms = {}
        (row_x, column_x), (row_y, column_y) = (overlapping_pairs(splines) for splines in self.along)
        places = np.full(self.shape, -1)
        places.ravel()[self._used] = np.arange(self._used.size)
        rows, columns = places[row_y[:, None], row_x], places[column_y[:, None], column_x]
        both = (rows >= 0) & (columns >= 0)
        for factors in wanted:
            along_x, along_y = zip(*(ORDERS[factor] for factor in factors), strict=True)
            values = chords.form(coefficient, (along_x[0], along_x[1]), (along_y[0], along_y[1]))
            forms[factors] = np.zeros((self._used.size, self._used.size))
            forms[factors][rows[both], columns[both]] = values[both]
        if not self.added:
            return forms
        names = sorted({factor for factors in wanted for factor in factors})
        count = self.count - self._used.size
        weights = np.broadcast_to(coefficient, chords.weights.shape) * chords.weights
        squares = {factors: np.zeros((count, count)) for factors in wanted}
        pairs = sorted({pair for one, two in wanted for pair in ((one, two), (two, one))})
        crossed = {pair: np.zeros((*self.shape, count)) for pair in pairs}
        for some in chords.blocks():
            sampled = self._added_on(chords, some, [ORDERS[name] for name in names])
            derivatives = dict(zip(names, sampled, strict=True))
            weighted = {name: value * weights[some] for name, value in derivatives.items()}
            for (one, two), square in squares.items():
                square += weighted[one].reshape(count, -1) @ derivatives[two].reshape(count, -1).T
            for (name, other), integrals in crossed.items():
                chords.add_integrals(integrals, some, weighted[name], *ORDERS[other])
        for (one, two), square in squares.items():
            upper, lower = (crossed[pair].reshape(-1, count)[self._used] for pair in ((two, one), (one, two)))
            forms[one, two] = np.block([[forms[one, two], upper], [lower.T, square]])
        return forms

    def _added_on(self, chords: Chords, some: slice, orders: Sequence[tuple[int, int]]) -> np.ndarray:
        """Return (orders, added functions, some segments, points) derivatives at the points of a rule."""
        x, y = chords.x[some], chords.y[some]
        return sample(self.added, x.ravel(), y.ravel(), orders).reshape(len(orders), -1, *x.shape)

    def _integrals(
        self, chords: Chords, values: np.ndarray | float = 1.0, order: tuple[int, int] = (0, 0)
    ) -> np.ndarray:
        """Return (..., functions) integrals of derivatives times values (..., segments, points) over a rule."""
        products = chords.integrals(values, *order)
        products = products.reshape(*products.shape[:-2], -1)[..., self._used]
        if not self.added:
            return products
        weighted, added = values * chords.weights, np.zeros((*products.shape[:-1], self.count - self._used.size))
        for some in chords.blocks():
            sampled = self._added_on(chords, some, [order])[0]
            added = added + np.einsum("esp,...sp->...e", sampled, weighted[..., some, :])
        return np.concatenate([products, added], axis=-1)

    def _sums(
        self, chords: Chords, vectors: np.ndarray, orders: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[slice, list[np.ndarray]]]:
        products, added = np.split((self.basis @ vectors).T, [self._used.size], axis=1)
        for some, values in chords.sums(self._tables(products), orders):
            points = chords.x.shape[1]
            for part in chords.blocks() if self.added else ():
                if some.start <= part.start < some.stop:
                    at = slice((part.start - some.start) * points, (part.stop - some.start) * points)
                    for value, sampled in zip(values, self._added_on(chords, part, orders), strict=True):
                        value[:, at] += added @ sampled.reshape(added.shape[1], -1)
            yield some, values

    def _rows(self, points: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        """Return (points, functions) values, or slopes along unit vectors (points, 2), of products and added ones."""
        if self.added:
            x, y = points.T
            if normals is None:
                added = sample(self.added, x, y)[0]
            else:
                added = (normals.T[:, None] * sample(self.added, x, y, ((1, 0), (0, 1)))).sum(axis=0)
            return np.hstack([self._product_rows(points, normals), added.T])
        return self._product_rows(points, normals)

    def _product_rows(self, points: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        x, y = points.T
        along_x, along_y = (
            [local.dense(at, derivative) for derivative in range(1 if normals is None else 2)]
            for local, at in zip(self._local, (x, y), strict=True)
        )
        if normals is None:
            return _products(along_y[0], along_x[0])[:, self._used]
        slopes = [_products(along_y[0], along_x[1]), _products(along_y[1], along_x[0])]
        return sum(normal[:, None] * slope[:, self._used] for normal, slope in zip(normals.T, slopes, strict=True))

    def _covered(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (ny, nx) whether points of a grid are on the plate."""
        return self.outline.contains(np.stack(np.meshgrid(x, y), axis=-1))

    def _over_patches(self, areas: np.ndarray, orders: Sequence[tuple[int, int]]) -> np.ndarray:
        """Return (areas, unknowns) integrals of a sum of derivatives over the parts of rectangles on the plate."""
        areas = np.asarray(areas, dtype=float).reshape(-1, 4)
        rows = np.zeros((len(areas), self.basis.shape[0]))
        whole = np.array([not self.added and self.outline.holds(*area) for area in areas.tolist()], dtype=bool)
        for row, area in zip(np.flatnonzero(~whole), areas[~whole].tolist(), strict=True):
            chords = self._chords(curves_of(PlateRegion.model_construct(area=tuple(area))))
            rows[row] = sum(self._integrals(chords, 1.0, order) for order in orders)
        for order in orders if whole.any() else ():
            x0, x1, y0, y1 = areas[whole].T
            along_x, along_y = self.along[0].integrals(x0, x1, order[0]), self.along[1].integrals(y0, y1, order[1])
            rows[whole] += _products(along_y.T, along_x.T)[:, self._used]
        return rows @ self.basis

    def _tables(self, products: np.ndarray) -> np.ndarray:
        """Return (..., functions of y, functions of x) coefficients of all products from those of the used ones."""
        tables = np.zeros((*products.shape[:-1], math.prod(self.shape)))
        tables[..., self._used] = products
        return tables.reshape(*products.shape[:-1], *self.shape)

    def _on_chords(self, chords: Chords) -> np.ndarray:
        return np.asarray(self._integrals(chords) @ self.basis)

    def _over_line(self, axis: int, at: float, low: float, high: float) -> np.ndarray:
        """Return (products,) integrals along a line at x (0) or y (1) from ``low`` to ``high`` of the other [m]."""
        total = np.zeros(self.basis.shape[0])
        for start, end in self.outline.chords(1 - axis, at):
            start, end = max(start, low), min(end, high)
            if end > start:
                breaks = self.along[1 - axis].breaks
                inner = breaks[(breaks > start) & (breaks < end)]
                along, weights = gauss(np.array([start, *inner, end]), self.degree + 1)
                points = np.stack([np.full(along.size, at), along][:: 1 - 2 * axis], axis=1)
                total += weights @ self._rows(points)
        return total

    def _energy(self) -> np.ndarray:
        """Return the matrix of the energy in which functions are independent."""
        stiffness = sum(self.form(term.coefficient, term.factors) for term in self.bending_terms())
        lowest = LOWEST * (2 / np.pi * mean_wave_frequency(self.laminate) / self.outline.area) ** 2
        return np.asarray(stiffness + lowest * self.form(self._fields()[-1]))

    def _make_basis(self, rank: float, near: TrimmedSplines | None) -> tuple[np.ndarray, int, list[int]]:
        """Return independent functions that keep the conditions of the edges, their number without, and the kinds."""
        held = conditions(self.scene, self._pieces, self._local, self._interval, bool(self.added))
        moments = [functions.T @ self._rows(points, along) for points, functions, along in held]
        kinds = [*(one.functions for one in self.added), *map(len, moments)]
        count, seen = (near.independent, near.independent - near.unknowns) if near else (None, None)
        if near and near.kinds != kinds:
            raise Unlike
        energy = self._energy()
        some = independent_functions(energy, rank, count)
        basis = some @ null_space(np.concatenate(moments) @ some, seen) if moments else some
        if near:  # the motions nearest to its basis
            basis = basis @ (basis.T @ (energy @ near.basis))
        return basis, some.shape[1], kinds


def _products(along_y: np.ndarray, along_x: np.ndarray) -> np.ndarray:
    """Return (points, products) of functions (points, ny) and (points, nx)."""
    return (along_y[:, :, None] * along_x[:, None, :]).reshape(len(along_y), along_y.shape[1] * along_x.shape[1])
