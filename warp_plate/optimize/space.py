"""The space that a method searches: limits, where a search begins, and which numbers wrap."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class SearchSpace:
    """The numbers of a position, without their meaning.

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
        """Number of numbers in a position."""
        return len(self.names)

    @cached_property
    def span(self) -> np.ndarray:
        """(dimension,) lengths of the initial ranges; 1 for a range of no length."""
        return np.where(self.initial_upper > self.initial_lower, self.initial_upper - self.initial_lower, 1.0)

    @cached_property
    def wrapped(self) -> list[tuple[int, float, float]]:
        """Column, period and lower end of the period for each number that wraps."""
        return [
            (column, float(self.period[column]), float(self.initial_lower[column]))
            for column in np.flatnonzero(np.isfinite(self.period)).tolist()
        ]

    def wrap(self, positions: np.ndarray) -> None:
        """Shift the numbers that wrap into one period from the lower ends of their ranges on, in place."""
        for column, period, lowest in self.wrapped:
            positions[:, column] -= period * np.floor((positions[:, column] - lowest) / period)

    def from_unit(self, points: np.ndarray, wrap: bool = True) -> np.ndarray:
        """Return the positions (n, dimension) of points that are 0 and 1 at the ends of the initial ranges."""
        positions = self.initial_lower + self.span * points
        if wrap:
            self.wrap(positions)
        clipped: np.ndarray = np.clip(positions, self.lower, self.upper)
        return clipped

    def to_unit(self, positions: np.ndarray) -> np.ndarray:
        """Return the points (n, dimension) of positions: 0 and 1 at the ends of the initial ranges."""
        return (positions - self.initial_lower) / self.span
