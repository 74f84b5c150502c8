"""Slopes of a number by the fields of a plate at points, from those by its matrices, which are linear in them.

The fields are those of the plate, what each layer of another shape than a rectangle adds to them, and the mass per area
of the target.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.effects.effect import DISPLACEMENT, Factors
from warp_plate.modal.sensitivity.matrices import PlateMatrices
from warp_plate.modal.spaces.chords import Chords
from warp_plate.modal.spaces.integrals import Integrals, SplineProducts, bending_terms
from warp_plate.modal.spaces.tensor_splines import ORDERS
from warp_plate.plate.section import Laminate, bilinear

# Complex step of the slopes of fields by a factor of the thickness.
STEP = 1e-30
# Index of the mass per area among the fields, after Dx, D1, Dy and Dxy.
MASS = 4


@dataclass(frozen=True)
class _Part:
    """Fields at the points of a rule."""

    rule: Integrals | Chords
    slopes: dict[int, np.ndarray]  # slopes by fields at each point, by the fields' indices
    layer: int | None = None  # index among the layers of other shapes of the one whose addition the fields are

    def fields(self, laminate: Laminate, step: float = 0.0) -> np.ndarray:
        """Return (5, ...) fields at the points, or with a ``step`` their slopes by the factor of the thickness."""
        return self.rule.sampled(lambda x, y: self._fields_at(laminate, x, y, step))

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
    """Slopes of a number by the fields of a plate, from those by its matrices, and by masses [1/kg] beside them."""

    def __init__(
        self, space: SplineProducts, slopes: PlateMatrices, by_mass: float = 0.0, by_target: float = 0.0
    ) -> None:
        """Prepare the slopes; ``by_mass`` is that by the mass of the plate, ``by_target`` by the mass of the target."""
        self.space, self._slopes, self._by_mass, self._by_target = space, slopes, by_mass, by_target

    @cached_property
    def _parts(self) -> list[_Part]:
        return [*self._of_plate(), *self._of_target()]

    def _of_plate(self) -> Iterator[_Part]:
        count, slopes = self.space.unknowns, self._slopes
        by_density, bending = (slopes.mass + slopes.regions[0])[:count, :count], slopes.bending[:count, :count]
        terms = [
            (index, term)
            for index in range(MASS)
            for term in bending_terms([float(index == field) for field in range(MASS + 1)])
            if term.coefficient
        ]
        layers = [(chords, layer) for layer, (chords, _) in enumerate(self.space.layer_rules())]
        for rule, layer in [(self.space.rule, None), *layers]:
            (of_mass,) = _at_points(self.space, rule, by_density, [DISPLACEMENT])
            by_field = {MASS: (of_mass + self._by_mass) * rule.weights}
            rows = _at_points(self.space, rule, bending, [term.factors for _, term in terms])
            for (index, term), row in zip(terms, rows, strict=True):
                by_field[index] = by_field.get(index, 0.0) + term.coefficient * row * rule.weights
            yield _Part(rule, by_field, layer)

    def _of_target(self) -> Iterator[_Part]:
        count = self.space.unknowns
        by_density = self._slopes.regions[1][:count, :count]
        if not (by_density.any() or self._by_target):
            return
        target = self.space.scene.target
        rules = [self.space.region_rule(target), *self.space.layer_rules(target)]
        for index, (rule, share) in enumerate(rules):
            (of_mass,) = _at_points(self.space, rule, by_density, [DISPLACEMENT])
            slopes = {MASS: share * (of_mass + self._by_target) * rule.weights}
            yield _Part(rule, slopes, index - 1 if index else None)

    def change(self, after: Laminate, before: Laminate) -> float:
        """Return the change of the number between two plates with layers of the same shapes."""
        total = 0.0
        for part in self._parts:
            fields = part.fields(after) - part.fields(before)
            total += sum(float((fields[index] * slopes).sum()) for index, slopes in part.slopes.items())
        return total

    def by_thickness(self) -> np.ndarray:
        """Return the slopes (rows, columns) by the map of thickness; those of fields are exact by a complex step."""
        laminate = self.space.laminate
        total = np.zeros(laminate.maps["thickness"].shape)
        for part in self._parts:
            fields = part.fields(laminate, STEP)
            values = sum(fields[index] * slopes for index, slopes in part.slopes.items())
            total += _onto_map(part.rule, values, total.shape, laminate.size)
        return total


def _at_points(
    space: SplineProducts, rule: Integrals | Chords, matrix: np.ndarray, factors: Sequence[Factors]
) -> list[np.ndarray]:
    """Return Σ_ij matrix_ij ∂ψ_i ∂'ψ_j of a symmetric matrix at the points of a rule, for pairs of derivatives."""
    if isinstance(rule, Chords):
        return space.diagonals(rule, matrix, [(ORDERS[one], ORDERS[two]) for one, two in factors])
    (row_x, column_x), (row_y, column_y) = rule.pairs
    sides = [splines.functions for splines in reversed(rule.along)]
    tables = matrix.reshape(*sides, *sides)
    gathered = tables[row_y[:, None], row_x, column_y[:, None], column_x]
    values = []
    for pair in factors:
        products = []
        for axis, splines in enumerate(rule.along):
            first, second = (splines.values(rule.points[axis], ORDERS[factor][axis]) for factor in pair)
            rows, columns = rule.pairs[axis]
            products.append(first[rows] * second[columns])
        values.append(products[1].T @ gathered @ products[0])
    return values


def _onto_map(
    rule: Integrals | Chords, values: np.ndarray, shape: tuple[int, ...], size: tuple[float, float]
) -> np.ndarray:
    """Return the sums (rows, columns) of values at the points of a rule times the hats of a map's numbers."""
    rows, columns = shape

    def hats(axis: int, count: int, places: np.ndarray) -> np.ndarray:
        return bilinear(np.eye(count), np.linspace(0, 1, count), places / size[axis])

    if isinstance(rule, Integrals):
        x, y = rule.points
        return np.asarray(hats(1, rows, y).T @ values @ hats(0, columns, x))
    along_y, along_x = hats(1, rows, rule.y.ravel()), hats(0, columns, rule.x.ravel())
    return np.asarray((along_y * values.reshape(-1, 1)).T @ along_x)
