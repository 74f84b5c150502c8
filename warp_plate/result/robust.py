"""Comparison of a robust drive with the nominal one over scenarios that neither was optimized for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from warp_plate.result.hdf5 import Dataset

# Fraction of all scenarios that counts as the worst ones.
TAIL = 0.05
DRIVES = ("robust", "nominal")
_ROWS = "of the robust and of the nominal drive"


@dataclass(frozen=True, eq=False)
class RobustComparison:
    """Values of the robust drive and of the nominal drive, in this order (``DRIVES``).

    Larger values are better. They are localization factors or, if other objectives were given, weighted sums of the
    objectives; not finite where a plate failed.

    Attributes:
        measure: Measure over the scenarios that the robust search maximized.
        scenarios: Number of scenarios of the search.
        localization: True if the values are localization factors.
        validation: (2, validation scenarios) values in scenarios that the search did not use.
    """

    measure: str
    scenarios: int
    localization: bool
    bound: Annotated[float | None, Dataset("1", "upper bound of the measure")]
    searched: Annotated[np.ndarray, Dataset("1", f"measure {_ROWS} over the scenarios of the search", ("drive",))]
    nominal_plate: Annotated[np.ndarray, Dataset("1", f"value {_ROWS} without scatter", ("drive",))]
    validation: Annotated[
        np.ndarray, Dataset("1", f"value {_ROWS} in each fresh scenario", ("drive", "scenario")), "fresh"
    ]

    @property
    def failed(self) -> np.ndarray:
        """(2,) numbers of validation scenarios in which the plate failed."""
        return np.sum(~np.isfinite(self.validation), axis=1)

    def rows(self) -> Mapping[str, np.ndarray]:
        """Return the (2,) statistics to tabulate, by name; a plate that failed counts as −∞."""
        values = np.where(np.isfinite(self.validation), self.validation, -np.inf)
        return {
            "mean": values.mean(axis=1),
            "worst_5_percent": mean_of_worst(values),
            "worst": values.min(axis=1),
            "nominal_plate": self.nominal_plate,
            "searched": self.searched,
        }


def mean_of_worst(values: np.ndarray) -> np.ndarray:
    """Return the (rows,) means of the smallest 5 % of each row's values, at least of one value."""
    count = max(1, int(np.ceil(TAIL * values.shape[1] - 1e-9)))
    return np.asarray(np.sort(values, axis=1)[:, :count].mean(axis=1))
