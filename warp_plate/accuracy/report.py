"""The whole family of a scene: every configuration from cheap to dear, within a budget of seconds."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from warp_plate.accuracy.configurations import Configuration, make_configurations
from warp_plate.accuracy.fit import ConvergenceLaw, Recommendation, fit_laws, pareto_front, recommend
from warp_plate.accuracy.measure import AccuracyRow, Bench, cost_order, measure, speeds_json
from warp_plate.accuracy.reference_solution import ReferenceSolution, find_reference_solution
from warp_plate.accuracy.trial_runs import PATH
from warp_plate.scene.model import Grid, Scene

# The reference may take this part of the budget; its error is to be far below the smallest tolerance.
REFERENCE_SHARE, REFERENCE_ERROR = 0.15, 1e-5
# A row may take this part of what is left, so that the dearest does not eat what the others need.
SHARE_OF_REST = 0.5
# So many rows are measured whatever the budget.
FIRST_ROWS = 6


@dataclass(frozen=True)
class AccuracyReport:
    """scene: its name; device; path; truth; rows; laws; front: indices of the rows on the Pareto front; recommended;
    speeds [ns a node-step]; seconds that all took; interrupted by Ctrl-C."""

    scene: str
    device: str
    path: str
    reference: ReferenceSolution
    particles: int
    iterations: int
    rows: Sequence[AccuracyRow]
    laws: Sequence[ConvergenceLaw]
    front: Sequence[int]
    recommended: Sequence[Recommendation]
    speeds: dict[str, float]
    seconds: float
    interrupted: bool

    def as_json(self) -> dict[str, object]:
        """Of numbers, texts, lists and mappings only; ``localization_factor`` is the best single actuator's."""
        truth = self.reference
        return {
            "scene": self.scene,
            "device": self.device,
            "path": self.path,
            "particles": self.particles,
            "iterations": self.iterations,
            "reference": {
                "kind": truth.kind,
                "localization_factor": truth.localization_factors["single"],
                "bound": truth.bound,
                "uncertainty": truth.uncertainty,
                "frequencies": truth.frequencies.tolist(),
            },
            "rows": [asdict(row) for row in self.rows],
            "orders": [asdict(law) for law in self.laws],
            "front": list(self.front),
            "recommended": [asdict(one) for one in self.recommended],
            "nanoseconds_per_node_step": self.speeds,
            "seconds": self.seconds,
            "interrupted": self.interrupted,
        }


def measure_configurations(
    scene: Scene,
    source: str = "",
    device: str = "auto",
    path: str = PATH,
    budget: float = 120.0,
    on_progress: Callable[[int, int, str], object] | None = None,
) -> AccuracyReport:
    """The scene as written and all of its family.

    Args:
        budget: seconds for all; what would take longer is a row marked so.
        on_progress: called before each row with the rows done, all rows, and the next one's name.

    Ctrl-C ends it with what is measured.

    Raises:
        SceneError: see ``PlateSolver``.
        KeyboardInterrupt: nothing has been measured yet.
    """
    started = time.perf_counter()
    truth = find_reference_solution(scene, "auto", device, REFERENCE_ERROR, REFERENCE_SHARE * budget)
    asked = scene.grid.accuracy is not None  # then the scene as written has no grid, and the family is all there is
    scene = scene.model_copy(update={"grid": Grid()}) if asked else scene
    bench = Bench(scene, truth, device, path)
    family = sorted(make_configurations(scene), key=lambda one: cost_order(scene, one))
    wanted: list[Configuration | None] = [*([] if asked else [None]), *family]
    rows: list[AccuracyRow] = []
    interrupted = False
    try:
        for configuration in wanted:
            if on_progress is not None:
                on_progress(len(rows), len(wanted), str(configuration or "the scene as written"))
            left = budget - (time.perf_counter() - started)
            first = sum(row.measured for row in rows) < FIRST_ROWS
            rows.append(measure(bench, configuration, math.inf if first else SHARE_OF_REST * left))
    except KeyboardInterrupt:
        if not rows:
            raise
        interrupted = True
    plates = scene.search.particles * scene.search.iterations
    return AccuracyReport(
        scene=source,
        device=device,
        path=path,
        reference=truth,
        particles=scene.search.particles,
        iterations=scene.search.iterations,
        rows=tuple(rows),
        laws=fit_laws(rows, truth.uncertainty),
        front=pareto_front(rows),
        recommended=recommend(rows, truth.uncertainty, plates),
        speeds=speeds_json(bench.speeds),
        seconds=time.perf_counter() - started,
        interrupted=interrupted,
    )
