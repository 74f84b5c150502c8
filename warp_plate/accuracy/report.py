"""The accuracy report of a scene: configurations measured within a time budget, the laws they follow, and advice."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from numbers import Real

import numpy as np

from warp_plate.accuracy.configurations import Configuration, make_configurations
from warp_plate.accuracy.measure import MODAL, MODAL_DENSITIES, AccuracyRow, measure, measure_modal
from warp_plate.accuracy.reference_solution import LEAST_ERROR, ReferenceSolution, find_reference_solution
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Grid
from warp_plate.scene.model import Scene, SceneSource

# Fraction of the budget that the reference may take.
BUDGET_SHARE = 0.15
# Fraction of the remaining budget that a row may take, and number of rows that are always measured.
ROW_SHARE, FIRST_ROWS = 0.5, 6
# Relative errors for which a row is recommended.
TOLERANCES = (0.1, 0.03, 0.01, 0.003, 0.001)
# Errors that a fit takes: below the first number (coarser grids do not yet converge regularly), this many times above
# the uncertainty of the reference, and well above the rounding of energies.
LARGEST_ERROR, ABOVE_UNCERTAINTY = 0.3, 3.0
SMALLEST_ERROR = {"float32": 1e-5, "float64": 1e-10}
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
    cost_exponent: float | None  # exponent p of seconds ∝ (nodes a side)^p


@dataclass(frozen=True)
class Recommendation:
    """The cheapest row for a tolerance."""

    tolerance: float  # relative error
    row: int | None  # index of the row; None if no row keeps the tolerance
    seconds: float | None  # time of the whole search [s]


@dataclass(frozen=True)
class AccuracyReport:
    """Measured configurations of a scene and the conclusions from them."""

    scene: str  # name of the scene
    device: str  # device
    path: str  # path of the solver
    reference: ReferenceSolution  # reference solution
    particles: int  # particles of the scene's search
    iterations: int  # iterations of the scene's search
    rows: Sequence[AccuracyRow]  # measured, refused and skipped configurations
    laws: Sequence[ConvergenceLaw]  # convergence and cost
    front: Sequence[int]  # indices of the rows on the Pareto front
    recommended: Sequence[Recommendation]  # cheapest row for each tolerance
    seconds: float  # time that the report took [s]
    interrupted: bool  # True if Ctrl-C ended it

    def as_json(self) -> dict[str, object]:
        """Return the report as numbers, texts, lists and mappings."""
        record, reference = dict(vars(self)), self.reference
        record["orders"] = [asdict(law) for law in record.pop("laws")]
        record["rows"] = [asdict(row) for row in self.rows]
        record["recommended"] = [asdict(recommendation) for recommendation in self.recommended]
        record["reference"] = {
            "kind": reference.kind,
            "localization_factor": reference.localization_factors["single"],
            "bound": reference.bound,
            "uncertainty": reference.uncertainty,
        }
        return record


def measure_accuracy(
    scene: SceneSource,
    *,
    source: str = "",
    device: str = "auto",
    path: str = "auto",
    budget: float = 120.0,
    on_progress: Callable[[int, int, str], object] | None = None,
) -> AccuracyReport:
    """Measure the scene as written and all configurations for it; Ctrl-C ends the report with the rows so far.

    Args:
        source: Name of the scene in the report.
        device, path: See :class:`PlateSolver`.
        budget: Nominal time for the report [s], counted in node-steps; rows beyond it are skipped, except the first
            ones.
        on_progress: Called before each row with the number of rows so far, of all rows, and the name of the next.

    Raises:
        SceneError: see ``PlateSolver``.
        KeyboardInterrupt: no row has been measured yet.
    """
    scene = Scene.load(scene)
    if not isinstance(budget, Real) or not 0 < float(budget) < math.inf:
        raise SceneError(f"budget = {budget!r}: must be a time in seconds, greater than 0")
    started = time.perf_counter()
    reference = find_reference_solution(scene, device, 2 * LEAST_ERROR, BUDGET_SHARE * budget)
    points: list[float | Configuration | None] = [None]  # densities of functions, and grids; None for that of the scene
    if scene.grid.accuracy is not None:
        scene, points = scene.model_copy(update={"grid": Grid()}), []
    points += make_configurations(scene)
    if scene.modal_only_key is not None:
        points = []
    if reference.plate is not None:  # coarser ones than the reference itself
        points = [*(density for density in MODAL_DENSITIES if density < reference.density), *points]
    rows: list[AccuracyRow] = []
    interrupted, seconds = False, (1 - BUDGET_SHARE) * budget
    try:
        for point in points:
            if on_progress is not None:
                name = "modes" if isinstance(point, float) else str(point or "the scene as written")
                on_progress(len(rows), len(points), name)
            if isinstance(point, float):
                rows.append(measure_modal(scene, reference, point))
                continue
            first = sum(row.measured and row.load != MODAL for row in rows) < FIRST_ROWS
            seconds_left = math.inf if first else ROW_SHARE * (seconds - sum(row.budgeted for row in rows))
            rows.append(measure(scene, reference, point, device, path, seconds_left))
    except KeyboardInterrupt:
        if not rows:
            raise
        interrupted = True
    particles, iterations = scene.search.particles, scene.search.iterations
    return AccuracyReport(
        scene=source,
        device=device,
        path=path,
        reference=reference,
        particles=particles,
        iterations=iterations,
        rows=rows,
        laws=fit_laws(rows, reference.uncertainty),
        front=pareto_front(rows),
        recommended=recommend(rows, reference.uncertainty, particles * iterations),
        seconds=time.perf_counter() - started,
        interrupted=interrupted,
    )


def fit_laws(rows: Sequence[AccuracyRow], uncertainty: float) -> list[ConvergenceLaw]:
    """Return a law for each order, load and precision, from the longest time step of each grid."""
    laws = []
    measured = [row for row in rows if row.measured and not row.as_written]
    for family in dict.fromkeys(row.family for row in measured):
        grids: dict[tuple[int, int], list[AccuracyRow]] = {}
        for row in measured:
            if row.family == family:
                grids.setdefault(row.nodes, []).append(row)
        members = [max(grid, key=lambda row: row.time_step or 0) for grid in grids.values()]
        members.sort(key=lambda row: -row.spacing)
        floor = max(ABOVE_UNCERTAINTY * uncertainty, SMALLEST_ERROR[members[0].precision])
        field_floor = max(floor, displacement_floor(uncertainty))
        cost = _slope(members, "seconds_per_plate", 0.0, math.inf)
        laws.append(
            ConvergenceLaw(
                family=family,
                rows=len(members),
                order=_slope(members, "error", floor),
                order_displacement=_slope(members, "error_displacement", field_floor),
                cost_exponent=None if cost is None else -cost,
            )
        )
    return laws


def _slope(rows: Sequence[AccuracyRow], name: str, floor: float, most: float = LARGEST_ERROR) -> float | None:
    """Return p of the least-squares law value ∝ spacing^p of the finest rows; None for fewer than FEWEST_ROWS."""
    points = [(row.spacing, getattr(row, name)) for row in rows if floor < (getattr(row, name) or 0.0) < most]
    if len(points) < FEWEST_ROWS:
        return None
    x, y = np.log(np.array(points[-MOST_ROWS:])).T
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


def displacement_floor(uncertainty: float) -> float:
    """Return the relative error of the reference's displacement; that of energies is about its square."""
    return math.sqrt(uncertainty)


def recommend(rows: Sequence[AccuracyRow], uncertainty: float, plates: int) -> list[Recommendation]:
    """Return the cheapest row for each of ``TOLERANCES``, in a search of ``plates`` plates.

    The tolerance includes the error of the reference, and the finer grids of the row's order, load and precision must
    keep it too: a coarse grid may be right by chance.
    """
    measured = {index: row for index, row in enumerate(rows) if row.measured}
    cost = {index: row.search_seconds(plates) for index, row in measured.items()}
    worst = {index: _worst(row, measured.values()) + uncertainty for index, row in measured.items()}
    recommendations = []
    for tolerance in TOLERANCES:
        accepted = [index for index in measured if worst[index] <= tolerance]
        row = min(accepted, key=lambda index: cost[index], default=None)
        recommendations.append(Recommendation(tolerance, row, None if row is None else cost[row]))
    return recommendations


def _worst(row: AccuracyRow, rows: Iterable[AccuracyRow]) -> float:
    """Return the largest error of the row and of finer ones of its family."""
    finer = (other for other in rows if other.family == row.family and other.spacing <= row.spacing * (1 + 1e-9))
    return max(math.inf if other.error is None else other.error for other in finer)
