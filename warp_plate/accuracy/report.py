"""The accuracy report of a scene: all configurations from cheap to expensive, within a time budget."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from warp_plate.accuracy.configurations import Configuration, make_configurations
from warp_plate.accuracy.fit import ConvergenceLaw, Recommendation, fit_laws, pareto_front, recommend
from warp_plate.accuracy.measure import AccuracyRow, MeasurementContext, measure
from warp_plate.accuracy.reference_solution import ReferenceSolution, find_reference_solution
from warp_plate.scene.model import Grid, Scene

# Fraction of the budget that the reference may take, and its uncertainty, far below the smallest tolerance.
REFERENCE_SHARE, REFERENCE_ERROR = 0.15, 1e-5
# Fraction of the remaining budget that a row may take, and the number of rows measured whatever they take.
ROW_SHARE, FIRST_ROWS = 0.5, 6


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
    speeds: dict[str, float]  # time of a node-step by order and precision [ns]
    seconds: float  # time that the report took [s]
    interrupted: bool  # True if Ctrl-C ended it

    def as_json(self) -> dict[str, object]:
        """Return the report as numbers, texts, lists and mappings."""
        reference = self.reference
        return {
            "scene": self.scene,
            "device": self.device,
            "path": self.path,
            "particles": self.particles,
            "iterations": self.iterations,
            "reference": {
                "kind": reference.kind,
                "localization_factor": reference.localization_factors["single"],
                "bound": reference.bound,
                "uncertainty": reference.uncertainty,
                "frequencies": reference.frequencies.tolist(),
            },
            "rows": [asdict(row) for row in self.rows],
            "orders": [asdict(law) for law in self.laws],
            "front": list(self.front),
            "recommended": [asdict(recommendation) for recommendation in self.recommended],
            "nanoseconds_per_node_step": self.speeds,
            "seconds": self.seconds,
            "interrupted": self.interrupted,
        }


def measure_configurations(
    scene: Scene,
    source: str = "",
    device: str = "auto",
    path: str = "auto",
    budget: float = 120.0,
    on_progress: Callable[[int, int, str], object] | None = None,
) -> AccuracyReport:
    """Measure the scene as written and all configurations for it; Ctrl-C ends the report with the rows so far.

    Args:
        scene: Scene to measure.
        source: Name of the scene in the report.
        device: Device.
        path: Path of the solver.
        budget: Time for the report [s]; rows that would take longer are skipped.
        on_progress: Called before each row with the number of rows so far, of all rows, and the name of the next.

    Raises:
        SceneError: see ``PlateSolver``.
        KeyboardInterrupt: no row has been measured yet.
    """
    started = time.perf_counter()
    reference = find_reference_solution(scene, "auto", device, REFERENCE_ERROR, REFERENCE_SHARE * budget)
    configurations: list[Configuration | None] = [None]
    if scene.grid.accuracy is not None:  # the scene as written has no grid
        scene, configurations = scene.model_copy(update={"grid": Grid()}), []
    configurations += make_configurations(scene)
    context = MeasurementContext(scene, reference, device, path)
    rows, interrupted = _measure_rows(context, configurations, started + budget, on_progress)
    particles, iterations = scene.search.particles, scene.search.iterations
    return AccuracyReport(
        scene=source,
        device=device,
        path=path,
        reference=reference,
        particles=particles,
        iterations=iterations,
        rows=tuple(rows),
        laws=fit_laws(rows, reference.uncertainty),
        front=pareto_front(rows),
        recommended=recommend(rows, reference.uncertainty, particles * iterations),
        speeds={f"order {key[0]}, {key[1]}": 1e9 * context.speeds[key] for key in sorted(context.speeds)},
        seconds=time.perf_counter() - started,
        interrupted=interrupted,
    )


def _measure_rows(
    context: MeasurementContext,
    configurations: Sequence[Configuration | None],
    deadline: float,
    on_progress: Callable[[int, int, str], object] | None,
) -> tuple[list[AccuracyRow], bool]:
    """Return the rows that are measured before the deadline, or skipped, and whether Ctrl-C ended the measurement."""
    rows: list[AccuracyRow] = []
    try:
        for configuration in configurations:
            if on_progress is not None:
                on_progress(len(rows), len(configurations), str(configuration or "the scene as written"))
            first = sum(row.measured for row in rows) < FIRST_ROWS
            seconds_left = math.inf if first else ROW_SHARE * (deadline - time.perf_counter())
            rows.append(measure(context, configuration, seconds_left))
    except KeyboardInterrupt:
        if not rows:
            raise
        return rows, True
    return rows, False
