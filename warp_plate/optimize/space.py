"""The search space: limits, initial ranges, and components that wrap."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class SearchSpace:
    """The components of a position, without their meaning.

    Attributes:
        names: (dimension,) names for people, such as "phase of upper left".
        lower: (dimension,) lower limits; −∞ where there is none.
        upper: (dimension,) upper limits; ∞ where there is none.
        initial_lower: (dimension,) lower ends of the ranges in which a search begins.
        initial_upper: (dimension,) upper ends of these ranges.
        period: (dimension,) periods of numbers that wrap, which have no limits; ∞ for all others.
    """

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    initial_lower: np.ndarray
    initial_upper: np.ndarray
    period: np.ndarray

    @property
    def dimension(self) -> int:
        """Number of components of a position."""
        return len(self.names)

    @cached_property
    def span(self) -> np.ndarray:
        """(dimension,) lengths of the initial ranges; 1 for a range of no length."""
        return np.where(self.initial_upper > self.initial_lower, self.initial_upper - self.initial_lower, 1.0)

    def wrap(self, positions: np.ndarray) -> None:
        """Shift the numbers that wrap into one period from the lower ends of their ranges on, in place."""
        self._shift(positions, np.floor, self.initial_lower)

    def shorten(self, differences: np.ndarray) -> None:
        """Shift differences of positions to the shorter way round where numbers wrap, in place."""
        self._shift(differences, np.rint, np.zeros(self.dimension))

    def _shift(self, values: np.ndarray, rounding: np.ufunc, lowest: np.ndarray) -> None:
        for column in np.flatnonzero(np.isfinite(self.period)):
            periods = values[:, column] - lowest[column]
            periods /= self.period[column]
            rounding(periods, out=periods)
            periods *= self.period[column]
            values[:, column] -= periods

    def from_unit(self, points: np.ndarray, wrap: bool = True) -> np.ndarray:
        """Return the positions (n, dimension) of points that are 0 and 1 at the ends of the initial ranges."""
        positions = self.initial_lower + self.span * points
        if wrap:
            self.wrap(positions)
        return np.asarray(np.clip(positions, self.lower, self.upper))

    def to_unit(self, positions: np.ndarray) -> np.ndarray:
        """Return the points (n, dimension) of positions: 0 and 1 at the ends of the initial ranges."""
        return (positions - self.initial_lower) / self.span
