"""A robust drive beside the nominal one, over scenarios that neither was searched with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

# The worst part of all scenarios, whose mean stands in the report.
TAIL = 0.05
DRIVES = ("robust", "nominal")


@dataclass(frozen=True)
class RobustComparison:
    """Values are what people want large: localization factors, or the weighted sum of the objectives; not finite where
    a plate failed. The first row is the robust drive's, the second the nominal one's: DRIVES.

    measure: that was searched, over so many ``scenarios``; localization: whether values are localization factors;
    bound: of the measure, above which no drive comes, None where none is claimed. searched: (2,) the measure;
    nominal_plate: (2,) on the plate without scatter; fresh: (2, fresh scenarios).
    """

    measure: str
    scenarios: int
    localization: bool
    bound: float | None
    searched: np.ndarray
    nominal_plate: np.ndarray
    validation: np.ndarray

    @property
    def failed(self) -> np.ndarray:
        """(2,) on how many of the fresh panels the plate had no energies."""
        found: np.ndarray = np.count_nonzero(~np.isfinite(self.validation), axis=1)
        return found

    def rows(self) -> Mapping[str, np.ndarray]:
        """(2,) by what they are, for tables; a plate that failed counts as worse than any, −∞."""
        values = np.where(np.isfinite(self.validation), self.validation, -np.inf)
        return {
            "mean": values.mean(axis=1),
            "worst_5_percent": mean_of_worst(values),
            "worst": values.min(axis=1),
            "nominal_plate": self.nominal_plate,
            "searched": self.searched,
        }


def mean_of_worst(values: np.ndarray) -> np.ndarray:
    """(rows,) mean of the smallest twentieth of each row's values, at least one of them."""
    smallest = max(1, int(np.ceil(TAIL * values.shape[1] - 1e-9)))
    tail: np.ndarray = np.sort(values, axis=1)[:, :smallest].mean(axis=1)
    return tail
