"""Slopes of numbers by the fields of a plate at points, from those by its matrices, which are linear in them.

The fields are those of the plate, what each layer of another shape than a rectangle adds to them, and the mass per area
of the target.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_plate.effects.effect import DISPLACEMENT, Factors
from warp_plate.effects.layers import Layer
from warp_plate.modal.sensitivity.forms import PlateMatrices
from warp_plate.modal.spaces.chords import Chords
from warp_plate.modal.spaces.integrals import Integrals, SplineProducts, bending_terms
from warp_plate.modal.spaces.splines import Pairs
from warp_plate.modal.spaces.tensor_splines import ORDERS
from warp_plate.plate.section import Laminate, bilinear

# Complex step of the slopes of fields by a factor of the thickness.
STEP = 1e-30
# Index of the mass per area among the fields, after Dx, D1, Dy and Dxy.
MASS = 4
# Distance from the edges of layers, as a part of the side, at which fields and functions beside them are taken.
BESIDE = 1e-9


@dataclass(frozen=True)
class _Part:
    """Fields at the points of a rule."""

    rule: Integrals | Chords
    slopes: dict[int, np.ndarray]  # slopes (numbers, ...) by fields at each point, by the fields' indices
    layer: int | None = None  # index among the layers of other shapes of the one whose addition the fields are

    def fields(self, laminate: Laminate, step: float = 0.0) -> np.ndarray:
        """Return (5, ...) fields at the points, or with a ``step`` their slopes by the factor of the thickness."""
        return self.rule.sampled(lambda x, y: self._fields_at(laminate, x, y, step))

    def times(self, fields: np.ndarray) -> np.ndarray:
        """Return the sums (numbers,) of slopes times fields (5, ...) at the points."""
        return np.asarray(sum((fields[index] * slopes).sum(axis=(1, 2)) for index, slopes in self.slopes.items()))

    def _fields_at(self, laminate: Laminate, x: np.ndarray, y: np.ndarray, step: float) -> list[np.ndarray]:
        factors = laminate.factors_at(x, y)
        if step:
            factors["thickness"] = factors["thickness"] + 1j * step

        def of(over: int | None) -> list[np.ndarray]:
            layer = None if over is None else laminate.shaped_layers[over]
            rigidities, twist, mass, _ = laminate.fields(x, y, factors, layer)
            fields = (*rigidities, twist, mass)
            return [np.asarray(field).imag / step if step else np.asarray(field) for field in fields]

        if self.layer is None:
            return of(None)
        return [with_it - bare for with_it, bare in zip(of(self.layer), of(None), strict=True)]


class FieldSlopes:
    """Slopes of numbers by the fields of a plate, from those by its matrices, and by masses [1/kg] beside them."""

    def __init__(
        self, space: SplineProducts, slopes: Sequence[PlateMatrices], by_mass: np.ndarray, by_target: np.ndarray
    ) -> None:
        """Prepare the slopes; ``by_mass`` (numbers,) are those by the mass of the plate, ``by_target`` by the mass of
        the target."""
        self.space, self._slopes = space, slopes
        self._by_mass, self._by_target = by_mass[:, None, None], by_target[:, None, None]

    @cached_property
    def _parts(self) -> list[_Part]:
        layers = [(chords, layer) for layer, (chords, _) in enumerate(self.space.layer_rules())]
        return [*self._of_plate([(self.space.rule, None), *layers]), *self._of_target()]

    def _of_plate(self, rules: Iterable[tuple[Integrals | Chords, int | None]]) -> Iterator[_Part]:
        count = self.space.unknowns
        by_density = [(one.mass + one.regions[0])[:count, :count] for one in self._slopes]
        bending = [one.bending[:count, :count] for one in self._slopes]
        terms = [
            (index, term)
            for index in range(MASS)
            for term in bending_terms([float(index == field) for field in range(MASS + 1)])
            if term.coefficient
        ]
        for rule, layer in rules:
            (of_mass,) = _at_points(self.space, rule, by_density, [DISPLACEMENT])
            by_field = {MASS: (of_mass + self._by_mass) * rule.weights}
            rows = _at_points(self.space, rule, bending, [term.factors for _, term in terms])
            for (index, term), row in zip(terms, rows, strict=True):
                by_field[index] = by_field.get(index, 0.0) + term.coefficient * row * rule.weights
            yield _Part(rule, by_field, layer)

    def _of_target(self) -> Iterator[_Part]:
        count = self.space.unknowns
        by_density = [one.regions[1][:count, :count] for one in self._slopes]
        if not (np.any(by_density) or self._by_target.any()):
            return
        target = self.space.scene.target
        rules = [self.space.region_rule(target), *self.space.layer_rules(target)]
        for index, (rule, share) in enumerate(rules):
            (of_mass,) = _at_points(self.space, rule, by_density, [DISPLACEMENT])
            slopes = {MASS: share * (of_mass + self._by_target) * rule.weights}
            yield _Part(rule, slopes, index - 1 if index else None)

    def total(self, laminate: Laminate) -> np.ndarray:
        """Return the sums (numbers,) of slopes times the fields of a plate with layers of the same shapes."""
        return self._total(self._parts, laminate)

    def total_in_target(self, laminate: Laminate) -> np.ndarray:
        """Return the part of :meth:`total` by the mass of the target alone."""
        return self._total(self._of_target(), laminate)

    def _total(self, parts: Iterable[_Part], laminate: Laminate) -> np.ndarray:
        total = np.zeros(len(self._slopes))
        for part in parts:
            total += part.times(part.fields(laminate))
        return total

    def by_place(self, layer: Layer, axis: int) -> np.ndarray:
        """Return the slopes (numbers,) [1/m] by the place along x (0) or y (1) of a rectangular layer of a rectangular
        plate, without those by the mass of the target: slopes by fields times what the layer adds, along its edges."""
        rule, laminate = self.space.rule, self.space.laminate
        assert isinstance(rule, Integrals)
        assert layer.area is not None
        others = [*laminate.layers]
        others.remove(layer)  # one alone of layers that are alike
        without = replace(laminate, layers=others)
        ends, span = np.repeat(layer.area[2 * axis : 2 * axis + 2], 2), layer.area[2 - 2 * axis : 4 - 2 * axis]
        side, outwards = laminate.size[axis], np.array([-0.5, -0.5, 0.5, 0.5])
        inside = _Part(rule.on_lines(axis, ends - 2 * outwards * BESIDE * side, outwards, span), {})
        # Curvatures of functions may jump at the edges, and the mean of both sides counts.
        beside = np.clip(ends + BESIDE * side * np.array([-1, 1, -1, 1]), 0.0, side)
        (part,) = self._of_plate([(rule.on_lines(axis, beside, outwards, span), None)])
        return part.times(inside.fields(laminate) - inside.fields(without))

    def by_thickness(self) -> np.ndarray:
        """Return the slopes (numbers, rows, columns) by the map of thickness; those of fields are exact by a complex
        step."""
        laminate = self.space.laminate
        total = np.zeros((len(self._slopes), *laminate.maps["thickness"].shape))
        for part in self._parts:
            fields = part.fields(laminate, STEP)
            values = sum(fields[index] * slopes for index, slopes in part.slopes.items())
            total += _onto_map(part.rule, values, total.shape[1:], laminate.size)
        return total


def _at_points(
    space: SplineProducts, rule: Integrals | Chords, matrices: Sequence[np.ndarray], factors: Sequence[Factors]
) -> list[np.ndarray]:
    """Return Σ_ij matrix_ij ∂ψ_i ∂'ψ_j (matrices, ...) of symmetric matrices at the points of a rule, for pairs of
    derivatives."""
    if isinstance(rule, Chords):
        derivatives = [(ORDERS[one], ORDERS[two]) for one, two in factors]
        rows = [space.diagonals(rule, matrix, derivatives) for matrix in matrices]
        return [np.stack(values) for values in zip(*rows, strict=True)]
    functions, unknowns = rule.along[0].functions, space.unknowns
    sides = [[side.values(at, order) for order in range(3)] for side, at in zip(rule.along, rule.points, strict=True)]

    def entries(x: Pairs, y: Pairs) -> np.ndarray:
        places = (y[0][:, None] * functions + x[0]) * unknowns + y[1][:, None] * functions + x[1]
        return np.stack([np.take(matrix, places) for matrix in matrices])

    # With equal derivatives the pairs i, k and k, i of functions of x count together, and those of functions of y.
    x, y = ((rows[rows <= columns], columns[rows <= columns]) for rows, columns in rule.pairs)
    together = (entries(x, y) + entries(x[::-1], y)) * np.where(x[0] == x[1], 0.5, 1.0)
    tables = {True: (x, y, together * np.where(y[0] == y[1], 1, 2)[:, None])}
    if any(one != two for one, two in factors):
        tables[False] = (*rule.pairs, entries(*rule.pairs))
    found = dict[frozenset[str], np.ndarray]()
    for pair in factors:
        if (key := frozenset(pair)) not in found:  # symmetric matrices have the same sums for pairs in either order
            of_x, of_y, table = tables[len(key) == 1]
            orders = [[ORDERS[factor][axis] for factor in pair] for axis in (0, 1)]
            along_x, along_y = (
                values[one][rows] * values[two][columns]
                for values, (one, two), (rows, columns) in zip(sides, orders, (of_x, of_y), strict=True)
            )
            found[key] = along_y.T @ table @ along_x
    return [found[frozenset(pair)] for pair in factors]


def _onto_map(
    rule: Integrals | Chords, values: np.ndarray, shape: tuple[int, ...], size: tuple[float, float]
) -> np.ndarray:
    """Return the sums (n, rows, columns) of values (n, ...) at the points of a rule times the hats of a map's
    numbers."""
    rows, columns = shape

    def hats(axis: int, count: int, places: np.ndarray) -> np.ndarray:
        return bilinear(np.eye(count), np.linspace(0, 1, count), places / size[axis])

    if isinstance(rule, Integrals):
        x, y = rule.points
        return np.asarray(hats(1, rows, y).T @ values @ hats(0, columns, x))
    along_y, along_x = hats(1, rows, rule.y.ravel()), hats(0, columns, rule.x.ravel())
    return np.asarray((along_y.T * values.reshape(len(values), 1, -1)) @ along_x)
