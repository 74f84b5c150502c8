"""Integrals of a scene's fields times products of two functions, over the products of splines.

Every entry is an integral ∫ C(x, y) X_i X_k Y_j Y_l dA of a field and of derivatives of functions. Gauss's rule makes
it a product of three matrices: pairs of functions of y, the field at Gauss's points, pairs of functions of x. Pairs
that never overlap are left out, so that the same product yields small dense matrices and large sparse ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

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
from warp_plate.plate.section import factors_at, laminates
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene

# With this many breaks between two knots (fine maps), this many Gauss points between two breaks suffice.
FINE, FINE_RULE = 4, 3
# Gauss points between two lines of the plate for its mean wave.
POINTS_OF_MEAN = 2
Field: TypeAlias = "np.ndarray | float"


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

    def integral(self, field: Field) -> float:
        """Return ∫ field dA of values at Gauss's points (y, x), or of a number."""
        return float((self.weights * field).sum())

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
