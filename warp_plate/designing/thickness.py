"""Maps of thickness from free numbers: a filter for the least length, a projection, and a mass that stays.

The free numbers x, from 0 to 1, at points half a length apart, are averaged over the cone of that radius, t = Fx
(T. E. Bruns and D. A. Tortorelli, Comput. Methods Appl. Mech. Eng. 190, 2001, pp. 3443-3459), and projected by

    thickness = low + (high − low) p(t),     p = 1 / (1 + exp(−β(t − η)))

in which η is the one with the mass that is asked for, as in S. Xu, Y. Cai and G. Cheng, Struct. Multidisc. Optim. 41,
2010, pp. 495-505, so that range and mass hold whatever x is; without such a mass it is ½.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from warp_plate.modal.spaces.splines import gauss
from warp_plate.plate.section import bilinear, laminate_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import FreeThickness
from warp_plate.scene.model import Scene

# Points of the map in a length, and the largest number of points along a side.
POINTS_A_LENGTH, MOST_POINTS = 2, 200
# Points of Gauss's rule between two points of the map.
GAUSS = 3
# Standard deviation of the numbers of random starts.
SPREAD = 0.3
# Largest |β(t − η)|.
LARGEST_EXPONENT = 40.0


@dataclass(frozen=True, eq=False)
class ThicknessMap:
    """The map of thickness of a scene's design as a function of free numbers."""

    scene: Scene
    # function that returns points (n, 2) [m] and weights (n,) [m²] on a plate with an outline
    on_outline: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None

    @property
    def _free(self) -> FreeThickness:
        """The table ``[design.thickness]``."""
        assert self.scene.design is not None
        assert self.scene.design.thickness is not None
        return self.scene.design.thickness

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and of columns of the map; SceneError: too many."""
        length = self._free.length_scale
        columns, rows = (max(2, math.ceil(POINTS_A_LENGTH * side / length) + 1) for side in self.scene.plate.size)
        if max(rows, columns) > MOST_POINTS:
            least = POINTS_A_LENGTH * max(self.scene.plate.size) / (MOST_POINTS - 1)
            raise SceneError(f"design.thickness.length_scale: {length:g} m is too fine; at least {least:.2g} m")
        return rows, columns

    @cached_property
    def range(self) -> tuple[float, float]:
        """Least and largest factor on ``plate.thickness``."""
        low, high = (float(end) / self.scene.plate.thickness for end in self._free.range)
        return low, high

    @cached_property
    def _variable(self) -> np.ndarray:
        """(rows · columns,) index of the free number of each point, which mirror images share."""
        index = np.arange(self.shape[0] * self.shape[1]).reshape(self.shape)
        if self._free.symmetry in ("x", "both"):
            index = np.minimum(index, index[:, ::-1])
        if self._free.symmetry in ("y", "both"):
            index = np.minimum(index, index[::-1])
        return np.unique(index, return_inverse=True)[1].ravel()

    @property
    def count(self) -> int:
        """Number of free numbers."""
        return int(self._variable.max()) + 1

    @cached_property
    def _filter(self) -> scipy.sparse.csr_array:
        """(points, free numbers) matrix F of the averages."""
        places = np.stack(np.meshgrid(*self._points), axis=-1).reshape(-1, 2)
        tree, radius, count = scipy.spatial.cKDTree(places), self._free.length_scale, len(places)
        near = tree.sparse_distance_matrix(tree, radius, output_type="coo_matrix")
        apart = near.row != near.col
        pairs = near.row[apart], near.col[apart]
        cone = scipy.sparse.csr_array((radius - near.data[apart], pairs), (count, count))
        cone = cone + radius * scipy.sparse.eye_array(count)
        shared = scipy.sparse.csr_array((np.ones(count), (np.arange(count), self._variable)), (count, self.count))
        return scipy.sparse.csr_array(scipy.sparse.diags_array(1 / cone.sum(axis=1)) @ cone @ shared)

    @cached_property
    def _shares(self) -> np.ndarray:
        """(points,) shares of the points' thickness in the mass of a plate of the factor 1."""
        rows, columns = self.shape
        laminate = laminate_of(self.scene)
        if self.scene.outline is not None and self.on_outline is not None:
            (x, y), weights = self.on_outline()[0].T / np.array([laminate.size]).T, self.on_outline()[1]
            density = laminate.maps.get("density", np.ones((1, 1)))
            weights = weights * ((_hats(y, len(density)) @ density) * _hats(x, density.shape[1])).sum(axis=1)
            shares = ((_hats(y, rows) * weights[:, None]).T @ _hats(x, columns)).ravel()
            return np.asarray(shares / shares.sum())
        sides = []
        for side, count in zip(self.scene.plate.size, (columns, rows), strict=True):
            places, weights = gauss(np.linspace(0, side, count), GAUSS)
            sides.append((places, weights[:, None] * _hats(places / side, count)))
        (x, along_x), (y, along_y) = sides
        shares = (along_y.T @ laminate.factors_at(x, y)["density"] @ along_x).ravel()
        return np.asarray(shares / shares.sum())

    @cached_property
    def mass(self) -> float | None:
        """Sum of shares times factors that the map must have; None if it is free. SceneError: out of range."""
        if self._free.mass is None:
            return None
        present = laminate_of(self.scene).factors_at(*self._points)["thickness"].ravel()
        mass = float(self._free.mass * (self._shares @ present))
        low, high = self.range
        if not low < mass < high:
            reach = f"the range allows {low / mass * self._free.mass:.3g} to {high / mass * self._free.mass:.3g}"
            raise SceneError(f"design.thickness.mass: {self._free.mass:g}: {reach}")
        return mass

    @property
    def _points(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = self.shape
        width, height = self.scene.plate.size
        return np.linspace(0, width, columns), np.linspace(0, height, rows)

    def factors(self, numbers: np.ndarray) -> np.ndarray:
        """Return the factors (rows, columns) of free numbers (count,) from 0 to 1."""
        averages = self._filter @ numbers
        low, high = self.range
        return np.asarray((low + (high - low) * self._projected(averages)).reshape(self.shape))

    def slopes(self, numbers: np.ndarray, by_factors: np.ndarray) -> np.ndarray:
        """Return the slopes (count,) by free numbers of what has slopes (rows, columns) by the factors."""
        projected = self._projected(self._filter @ numbers)
        slope = (self.range[1] - self.range[0]) * self._free.steepness * projected * (1 - projected)
        by_average = by_factors.ravel() * slope
        if self.mass is not None:  # η moves so that the sum of shares times factors stays
            by_average -= by_average.sum() / (self._shares @ slope) * self._shares * slope
        return np.asarray(self._filter.T @ by_average)

    def numbers(self, factors: np.ndarray | None = None) -> np.ndarray:
        """Return free numbers (count,) whose map is about that of factors (rows, columns) (default: the scene's)."""
        if factors is None:
            factors = laminate_of(self.scene).factors_at(*self._points)["thickness"]
        shares = (factors.ravel() - self.range[0]) / (self.range[1] - self.range[0])
        shares = np.clip(shares, 1e-9, 1 - 1e-9)
        averages = 0.5 + np.log(shares / (1 - shares)) / self._free.steepness
        totals = np.bincount(self._variable, averages, self.count) / np.bincount(self._variable)
        return np.asarray(np.clip(totals, 0, 1))

    def draw(self, random: np.random.Generator) -> np.ndarray:
        """Return random free numbers (count,) with hills as wide as a few lengths."""
        smooth, own = random.normal(size=self.count), np.bincount(self._variable)
        for _ in range(2):
            smooth = np.bincount(self._variable, self._filter @ smooth, self.count) / own
        return np.asarray(np.clip(0.5 + SPREAD * smooth / smooth.std(), 0, 1))

    def _projected(self, averages: np.ndarray) -> np.ndarray:
        """Return p (points,) of averages t (points,)."""
        steep = self._free.steepness

        def logistic(middle: float) -> np.ndarray:
            return np.asarray(scipy.special.expit(steep * (averages - middle)))

        if self.mass is None:
            return logistic(0.5)
        low, high = self.range
        share = (self.mass - low) / (high - low)
        reach = 1 + LARGEST_EXPONENT / steep
        middle = scipy.optimize.brentq(lambda at: self._shares @ logistic(at) - share, -reach, reach, xtol=1e-15)
        return logistic(float(middle))


def _hats(places: np.ndarray, count: int) -> np.ndarray:
    """Return (places, count) shares of the numbers along a side of a map in its values at shares of the side."""
    return bilinear(np.eye(count), np.linspace(0, 1, count), places)
