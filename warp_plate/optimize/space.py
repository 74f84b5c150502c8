"""The numbers that a search may choose: their limits, where a search begins, and which of them wrap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Space:
    """All arrays are (dimension,).

    names: for people, such as "phase of upper left". lower, upper: limits, infinite where there is none. initial_lower,
    initial_upper: a search begins in between. period: what a number may be shifted by without any change, infinite for
    most; limits of a number with a period are infinite.
    """

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    initial_lower: np.ndarray
    initial_upper: np.ndarray
    period: np.ndarray

    @property
    def dimension(self) -> int:
        """How many numbers there are."""
        return len(self.names)
