"""What the rows of a family say together: measured orders, cost exponents, the Pareto front, recommendations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.accuracy.measure import AccuracyRow

TOLERANCES = (0.1, 0.03, 0.01, 0.003, 0.001)
# The clean part of a family: errors below the first (coarser grids are not yet on the law), so many times above what
# the reference leaves open, and well above what rounding of float32 does to an energy.
LARGEST_ERROR, ABOVE_UNCERTAINTY = 0.3, 3.0
ROUNDING = {"float32": 1e-5, "float64": 1e-10}
# Rows that a line takes: the finest ones, for coarse grids are not yet on the law, and starting a run counts there.
FEWEST_ROWS, MOST_ROWS = 3, 4


@dataclass(frozen=True)
class ConvergenceLaw:
    """A family's laws: error ∝ spacing^order, seconds ∝ (nodes a side)^cost_exponent; None where rows are too few.

    order is of the localization factors, order_displacement and order_frequencies of these.
    """

    family: str
    rows: int
    order: float | None
    order_displacement: float | None
    order_frequencies: float | None
    cost_exponent: float | None


@dataclass(frozen=True)
class Recommendation:
    """tolerance; row: index of the cheapest row that keeps it, None if none does; seconds: of the whole search."""

    tolerance: float
    row: int | None
    seconds: float | None


def family_of(row: AccuracyRow) -> str:
    """Rows of one name differ in grid and time step only."""
    return f"order {row.order}, {row.load}, {row.precision}"


def fit_laws(rows: Sequence[AccuracyRow], uncertainty: float) -> list[ConvergenceLaw]:
    """A law for each family, from the longest time step of every grid; the scene as written is left out."""
    laws = []
    for name in dict.fromkeys(family_of(row) for row in rows if not row.as_written):
        mine = longest_steps([row for row in rows if family_of(row) == name and row.measured and not row.as_written])
        if not mine:
            continue
        floor = max(ABOVE_UNCERTAINTY * uncertainty, ROUNDING[mine[0].precision])
        # The reference's displacement is less exact than its energies, whose error is about the square.
        field_floor = max(floor, math.sqrt(uncertainty))
        sides = [(1 / row.spacing, row.seconds_per_plate) for row in mine]
        laws.append(
            ConvergenceLaw(
                family=name,
                rows=len(mine),
                order=_order([(row.spacing, row.error) for row in mine], floor),
                order_displacement=_order([(row.spacing, row.error_displacement) for row in mine], field_floor),
                order_frequencies=_order([(row.spacing, row.error_frequencies) for row in mine], 1e-7),
                cost_exponent=slope(sides[-MOST_ROWS:]),
            )
        )
    return laws


def longest_steps(rows: Sequence[AccuracyRow]) -> list[AccuracyRow]:
    """Of each grid the row with the longest step, from coarse to fine."""
    found: dict[tuple[int, int], AccuracyRow] = {}
    for row in rows:
        other = found.get(row.nodes)
        if other is None or (row.time_step or 0) > (other.time_step or 0):
            found[row.nodes] = row
    return sorted(found.values(), key=lambda row: -row.spacing)


def _order(points: Sequence[tuple[float, float | None]], floor: float) -> float | None:
    kept = [(spacing, error) for spacing, error in points if error and floor < error < LARGEST_ERROR]
    return slope(kept[-MOST_ROWS:])


def slope(points: Sequence[tuple[float, float | None]]) -> float | None:
    """Exponent p of the least-squares law y ∝ x^p; None for fewer than FEWEST_ROWS points."""
    kept = [(x, y) for x, y in points if y is not None and y > 0]
    if len(kept) < FEWEST_ROWS:
        return None
    x, y = np.log(np.array(kept)).T
    return float(np.polyfit(x, y, 1)[0])


# A dearer row is on the front if its error is smaller by this part at least.
LEAST_GAIN = 0.01


def _keeps(row: AccuracyRow, error: float) -> bool:
    return row.measured and row.error is not None and row.error <= error


def _as_fine(other: AccuracyRow, row: AccuracyRow) -> bool:
    """Whether it is measured, of the same family and no coarser: one that is right by chance is not recommended."""
    alike = (other.order, other.load, other.precision) == (row.order, row.load, row.precision)
    return other.measured and alike and other.spacing <= row.spacing * (1 + 1e-9)


def pareto_front(rows: Sequence[AccuracyRow]) -> list[int]:
    """Indices of the measured rows that no other beats in both seconds and error, from cheap to dear."""
    order = sorted(
        (index for index, row in enumerate(rows) if row.measured),
        key=lambda index: (rows[index].seconds_per_plate, rows[index].error),
    )
    front: list[int] = []
    least = math.inf
    for index in order:
        error = rows[index].error
        if error is not None and error < (1 - LEAST_GAIN) * least:
            front.append(index)
            least = error
    return front


def recommend(
    rows: Sequence[AccuracyRow], uncertainty: float, plates: int, tolerances: Sequence[float] = TOLERANCES
) -> list[Recommendation]:
    """For each tolerance the cheapest row whose error and the reference's own stay below it.

    plates: of the whole search, particles × iterations.
    """
    found = []
    for tolerance in tolerances:
        keeping = [
            (row.seconds_per_plate, index)
            for index, row in enumerate(rows)
            if row.measured and row.seconds_per_plate is not None
            if all(_keeps(other, tolerance - uncertainty) for other in rows if _as_fine(other, row))
        ]
        seconds, index = min(keeping, default=(None, None))
        found.append(Recommendation(tolerance, index, None if seconds is None else plates * seconds))
    return found
