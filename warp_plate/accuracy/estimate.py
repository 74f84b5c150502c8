"""The error bar of a finished run: its localization factors against a small reference solution, in little time."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    configuration_of,
    cost_of_run,
    highest_order,
    longest_time_step,
    node_steps,
    nodes_for,
)
from warp_plate.accuracy.formatting import percent, two_digits
from warp_plate.accuracy.grid_search import TrialRun, refine, try_out
from warp_plate.accuracy.reference_solution import Observed, ReferenceStage, refine_reference, ritz_field
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.forced import localization_factors as factors_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Time of the estimate as a fraction of the run's, and its least and greatest value [s].
TIME_SHARE, LEAST_SECONDS, MOST_SECONDS = 0.08, 0.4, 20.0
# Effect of rounding on a localization factor.
ROUNDING = {"float32": 1e-6, "float64": 1e-13}
# Uncertainty of the reference as a fraction of the error that it shows, and its greatest and least value.
GOOD_ENOUGH, FIRST_WANTED, FINEST_WANTED = 0.2, 0.02, 1e-6
# A price is named for the first of these that the run does not keep; its grid is to keep this fraction of it.
TOLERANCES, TOLERANCE_SHARE = (0.01, 0.001), 0.9
# Side of the grid that shows the error of fourth order, and node-steps on it for each second of the estimate.
PILOT_SIDE, PILOT_NODE_STEPS = 19, 2e7


@dataclass(frozen=True)
class Price:
    """The cost of another accuracy."""

    tolerance: float  # relative error
    configuration: Configuration  # cheapest configuration that keeps it
    cost: float  # cost of a plate relative to the run


@dataclass(frozen=True)
class Estimate:
    """Errors of a run, for each drive."""

    configuration: Configuration  # configuration of the run
    localization_factors: np.ndarray  # (drives,) computed localization factors
    references: np.ndarray  # (drives,) accurate localization factors
    uncertainty: float  # relative error of the references
    errors: np.ndarray  # (drives,) relative errors, |difference| + uncertainty; NaN for plates at rest
    kind: str  # method of the reference
    seconds: float  # time that the estimate took [s]
    price: Price | None  # price of the next better tolerance; None if the run keeps all
    displacement_errors: np.ndarray  # (drives,) relative L2 errors over plate and recorded times; NaN if not known

    @property
    def error(self) -> float:
        """Largest relative error of all drives."""
        return float(np.nanmax(self.errors)) if np.isfinite(self.errors).any() else math.nan

    def line(self, drive: int = -1) -> str:
        """Return the localization factor of a drive with its error bar, and the price of a better one, for people."""
        value, error = float(self.localization_factors[drive]), float(self.errors[drive])
        bar, moved = error * value, float(self.displacement_errors[drive])
        grid = _grid_text(self.configuration)
        if not math.isfinite(bar):
            return f"{grid}: no error estimate (the plate is at rest, or not linear in its drives)"
        limited = self.uncertainty > error / 2
        at_most = f" at most (the reference is known to {percent(self.uncertainty)} only)" if limited else ""
        displacement = f", displacement ± {percent(moved)}" if math.isfinite(moved) and not limited else ""
        digits = max(3, 1 - math.floor(math.log10(bar))) if bar > 0 else 6
        text = f"localization factor {value:.{min(digits, 8)}f} ± {two_digits(bar)}{at_most}{displacement}"
        return f"{grid}: {text}{self._price_text()}"

    def _price_text(self) -> str:
        if self.price is None:
            return ""
        cost = "as" if 0.95 < self.price.cost < 1.05 else f"{two_digits(self.price.cost)} times as"
        return f"; {percent(self.price.tolerance)} costs {cost} much ({_grid_text(self.price.configuration)})"

    def as_json(self) -> dict[str, object]:
        """Return the estimate as numbers and texts."""
        price = self.price
        return {
            "error": self.error,
            "errors": self.errors.tolist(),
            "displacement_errors": self.displacement_errors.tolist(),
            "references": self.references.tolist(),
            "uncertainty": self.uncertainty,
            "reference": self.kind,
            "seconds": self.seconds,
            "price": price
            and {
                "tolerance": price.tolerance,
                "cost": price.cost,
                "nodes": list(price.configuration.nodes),
                "order": price.configuration.order,
                "load": price.configuration.load,
            },
        }


def _grid_text(configuration: Configuration) -> str:
    nx, ny = configuration.nodes
    return f"{nx} × {ny}, order {configuration.order}, {configuration.load}"


def estimate(
    scene: Scene,
    phasors: np.ndarray,
    localization_factors: np.ndarray,
    seconds: float,
    device: str = "auto",
    times: Sequence[float] | np.ndarray = (),
    displacement: np.ndarray | None = None,
    stage: ReferenceStage | None = None,
) -> Estimate:
    """Estimate the errors of localization factors in at most a tenth of the time of the run.

    The reference is refined until its own error is well below the one that it shows, or until time is up; its
    remaining error is added.

    Args:
        scene: Scene as it was run.
        phasors: (drives, actuators) phasors.
        localization_factors: (drives,) computed localization factors.
        seconds: Time that the run took [s].
        device: Device of the trial run that prices fourth order.
        times: Times of ``displacement`` [s].
        displacement: (drives, times, ny, nx) displacement of the run [m].
        stage: Reference solution, if there is one already.
    """
    started = time.perf_counter()
    budget = min(max(TIME_SHARE * seconds, LEAST_SECONDS), MOST_SECONDS)
    computed = np.asarray(localization_factors, dtype=float)
    phasors = np.asarray(phasors, dtype=complex)
    # The reference consists of Gram matrices, which a nonlinear plate does not have.
    kept = np.isfinite(computed) & np.any(phasors != 0, axis=1) & scene.linear
    references = np.full(computed.shape, math.nan)
    if not kept.any():
        nothing = (math.nan, references, "none", 0.0, None, references)
        return Estimate(configuration_of(scene), computed, references, *nothing)

    stage = stage or _reference_stage(scene, phasors[kept], computed[kept], device, budget)
    references[kept] = factors_of(stage.matrices, phasors[kept])
    differences = np.abs(computed / references - 1)
    largest = float(np.nanmax(differences))
    # A difference within the uncertainty does not allow to extrapolate to smaller errors.
    known = stage.uncertainty < largest
    price = _price(scene, largest, phasors[kept], references[kept], device, budget) if known else None
    displacement_errors = _displacement_errors(stage, scene, phasors, times, displacement)
    return Estimate(
        configuration=configuration_of(scene),
        localization_factors=computed,
        references=references,
        uncertainty=stage.uncertainty,
        errors=differences + stage.uncertainty + ROUNDING[scene.grid.precision],
        kind=stage.kind,
        seconds=time.perf_counter() - started,
        price=price,
        displacement_errors=displacement_errors,
    )


def _reference_stage(
    scene: Scene, phasors: np.ndarray, computed: np.ndarray, device: str, budget: float
) -> ReferenceStage:
    """Return a reference whose error is well below that of the computed localization factors, if the budget allows."""

    def wanted(matrices: np.ndarray) -> float:
        difference = np.abs(computed / factors_of(matrices, phasors) - 1).max()
        return min(max(GOOD_ENOUGH * float(difference), FINEST_WANTED), FIRST_WANTED)

    return refine_reference(scene, "auto", device, wanted, budget, Observed(only=phasors))


def _displacement_errors(
    stage: ReferenceStage,
    scene: Scene,
    phasors: np.ndarray,
    times: Sequence[float] | np.ndarray,
    displacement: np.ndarray | None,
) -> np.ndarray:
    """Return (drives,) relative L2 errors over nodes and times; NaN unless the reference has modes."""
    errors = np.full(len(phasors), math.nan)
    if displacement is None or stage.modes is None or not len(times):
        return errors
    x, y = (np.linspace(0, side, count) for side, count in zip(scene.plate.size, scene.grid.nodes, strict=True))
    for drive, computed in enumerate(displacement):
        expected = ritz_field(stage.modes, scene, phasors[drive])(times, x, y)
        size = np.linalg.norm(expected)
        if size > 0:
            errors[drive] = np.linalg.norm(computed - expected) / size
    return errors


def _price(
    scene: Scene, error: float, phasors: np.ndarray, references: np.ndarray, device: str, budget: float
) -> Price | None:
    """Return the cheaper of finer grids of the run's own order and of the highest order."""
    tolerance = next((tolerance for tolerance in TOLERANCES if error > tolerance), None)
    if tolerance is None or not math.isfinite(error):
        return None
    run = replace(configuration_of(scene), time_step=make_scheme(scene).time_step)
    run_cost = cost_of_run(scene, run)
    trials = [TrialRun(run, error, run_cost)]
    if scene.grid.order == 2 and highest_order(scene) == 4:
        trials.append(_pilot(scene, phasors, references, device, budget))
    needed = [_needed(scene, trial, TOLERANCE_SHARE * tolerance) for trial in trials if math.isfinite(trial.error)]
    cheapest = min(needed, key=lambda configuration: cost_of_run(scene, configuration))
    return Price(tolerance, cheapest, cost_of_run(scene, cheapest) / run_cost)


def _pilot(scene: Scene, phasors: np.ndarray, references: np.ndarray, device: str, budget: float) -> TrialRun:
    """Return a trial run of fourth order on a coarse grid; its error is infinite if it would take too long."""
    nodes = nodes_for(scene.plate.size, PILOT_SIDE, 4)
    pilot = Configuration(4, LOAD_OF[4], nodes, longest_time_step(scene, 4, nodes), "float32")
    try:
        if len(phasors) * node_steps(scene, pilot) <= PILOT_NODE_STEPS * budget:
            return try_out(scene, pilot, phasors, references, device)
    except SceneError:  # the time step is too long for the window, or the cells too large for an actuator
        pass
    return TrialRun(pilot, math.inf, math.inf)


def _needed(scene: Scene, trial: TrialRun, tolerance: float) -> Configuration:
    """Return the configuration that keeps the tolerance by the convergence law, with the loads that the order needs."""
    configuration = replace(trial.configuration, load=LOAD_OF[trial.configuration.order])
    factor = max((trial.error / tolerance) ** (1 / configuration.order), 9 / min(configuration.nodes))
    return refine(scene, configuration, factor)
