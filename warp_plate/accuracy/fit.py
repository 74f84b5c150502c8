"""Convergence orders, cost exponents, Pareto front and recommendations from measured configurations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.accuracy.measure import AccuracyRow

TOLERANCES = (0.1, 0.03, 0.01, 0.003, 0.001)
# Errors that a fit takes: below the first number (coarser grids do not yet converge regularly), this many times above
# the uncertainty of the reference, and well above the rounding of energies.
LARGEST_ERROR, ABOVE_UNCERTAINTY = 0.3, 3.0
ROUNDING = {"float32": 1e-5, "float64": 1e-10}
# Rows that a fit takes, the finest ones: on coarse grids the start of a run costs time too.
FEWEST_ROWS, MOST_ROWS = 3, 4
# Relative reduction of the error for which a more expensive row is on the Pareto front.
LEAST_GAIN = 0.01


@dataclass(frozen=True)
class ConvergenceLaw:
    """Power laws of configurations that differ in grid only; an exponent is None if there are too few rows."""

    family: str  # order, load and precision
    rows: int  # number of grids
    order: float | None  # exponent p of error ∝ spacing^p, of localization factors
    order_displacement: float | None  # likewise, of displacements
    order_frequencies: float | None  # likewise, of natural frequencies
    cost_exponent: float | None  # exponent p of seconds ∝ (nodes a side)^p


@dataclass(frozen=True)
class Recommendation:
    """The cheapest row for a tolerance."""

    tolerance: float  # relative error
    row: int | None  # index of the row; None if no row keeps the tolerance
    seconds: float | None  # time of the whole search [s]


def fit_laws(rows: Sequence[AccuracyRow], uncertainty: float) -> list[ConvergenceLaw]:
    """Return a law for each order, load and precision, from the longest time step of each grid."""
    laws = []
    for family in dict.fromkeys(_family(row) for row in rows if not row.as_written):
        members = [row for row in rows if _family(row) == family and row.measured and not row.as_written]
        if not members:
            continue
        members = _longest_steps(members)
        floor = max(ABOVE_UNCERTAINTY * uncertainty, ROUNDING[members[0].precision])
        # The error of energies is about the square of that of displacements.
        field_floor = max(floor, math.sqrt(uncertainty))
        laws.append(
            ConvergenceLaw(
                family=family,
                rows=len(members),
                order=_order([(row.spacing, row.error) for row in members], floor),
                order_displacement=_order([(row.spacing, row.error_displacement) for row in members], field_floor),
                order_frequencies=_order([(row.spacing, row.error_frequencies) for row in members], 1e-7),
                cost_exponent=slope([(1 / row.spacing, row.seconds_per_plate) for row in members][-MOST_ROWS:]),
            )
        )
    return laws


def _family(row: AccuracyRow) -> str:
    return f"order {row.order}, {row.load}, {row.precision}"


def _longest_steps(rows: Sequence[AccuracyRow]) -> list[AccuracyRow]:
    """Return the row with the longest time step of each grid, from coarse to fine."""
    longest: dict[tuple[int, int], AccuracyRow] = {}
    for row in rows:
        other = longest.get(row.nodes)
        if other is None or (row.time_step or 0) > (other.time_step or 0):
            longest[row.nodes] = row
    return sorted(longest.values(), key=lambda row: -row.spacing)


def _order(points: Sequence[tuple[float, float | None]], floor: float) -> float | None:
    kept = [(spacing, error) for spacing, error in points if error and floor < error < LARGEST_ERROR]
    return slope(kept[-MOST_ROWS:])


def slope(points: Sequence[tuple[float, float | None]]) -> float | None:
    """Return the exponent p of the least-squares law y ∝ x^p; None for fewer than FEWEST_ROWS points."""
    kept = [(x, y) for x, y in points if y is not None and y > 0]
    if len(kept) < FEWEST_ROWS:
        return None
    x, y = np.log(np.array(kept)).T
    return float(np.polyfit(x, y, 1)[0])


def pareto_front(rows: Sequence[AccuracyRow]) -> list[int]:
    """Return the indices of the measured rows that no other row beats in time and error, from cheap to expensive."""
    measured = [index for index, row in enumerate(rows) if row.measured]
    front: list[int] = []
    least = math.inf
    for index in sorted(measured, key=lambda index: (rows[index].seconds_per_plate, rows[index].error)):
        error = rows[index].error
        if error is not None and error < (1 - LEAST_GAIN) * least:
            front.append(index)
            least = error
    return front


def recommend(
    rows: Sequence[AccuracyRow], uncertainty: float, plates: int, tolerances: Sequence[float] = TOLERANCES
) -> list[Recommendation]:
    """Return the cheapest row for each tolerance, in a search of ``plates`` plates.

    The tolerance includes the uncertainty of the reference, and the finer grids of the row's order, load and precision
    must keep it too: a coarse grid may be right by chance.
    """

    def keeps(row: AccuracyRow, error: float) -> bool:
        return all(
            other.error is not None and other.error <= error
            for other in rows
            if other.measured and _family(other) == _family(row) and other.spacing <= row.spacing * (1 + 1e-9)
        )

    recommendations = []
    for tolerance in tolerances:
        candidates = [
            (row.seconds_per_plate, index)
            for index, row in enumerate(rows)
            if row.measured and row.seconds_per_plate is not None and keeps(row, tolerance - uncertainty)
        ]
        seconds, index = min(candidates, default=(None, None))
        recommendations.append(Recommendation(tolerance, index, None if seconds is None else plates * seconds))
    return recommendations
