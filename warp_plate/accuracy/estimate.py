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
    highest_order,
    longest_time_step,
    node_steps,
    nodes_for,
)
from warp_plate.accuracy.formatting import percent, two_digits
from warp_plate.accuracy.grid_search import finer
from warp_plate.accuracy.reference_solution import ReferenceStage, grow, ritz_field
from warp_plate.accuracy.trial_runs import TrialRun, cost_of_run, try_out
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.forced import localization_factors as factors_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# The estimate may take this part of the run's time, at least and at most so many seconds.
SHARE, LEAST_SECONDS, MOST_SECONDS = 0.08, 0.4, 20.0
# What rounding may do to a localization factor.
ROUNDING = {"float32": 1e-6, "float64": 1e-13}
# The reference is good enough when its own error is this part of the error that it shows.
GOOD_ENOUGH = 0.2
FIRST_WANTED, FINEST_WANTED = 0.02, 1e-6
# The first of these that the run does not keep is the one that a price is named for.
TOLERANCES = (0.01, 0.001)
# Plates that show how large the error of fourth order is: nodes of a side of a square plate.
PILOT_SIDE = 19
# And node-steps of theirs for each second that the estimate may take.
PILOT_NODE_STEPS = 2e7
# A grid found by the law of its order is to keep this part of the tolerance.
AIM = 0.9


@dataclass(frozen=True)
class Price:
    """What another accuracy takes: tolerance; the configuration; cost: times that of the run, per plate."""

    tolerance: float
    configuration: Configuration
    cost: float


@dataclass(frozen=True)
class Estimate:
    """The error of a run, case by case.

    configuration: of the run; localization_factors: (cases,) found; references: (cases,) what they should be;
    uncertainty: relative, of the references; errors: (cases,) relative, |difference| + uncertainty, NaN for plates at
    rest; error: the largest; displacement_errors: (cases,) relative L2 differences over the plate and the times kept,
    NaN where they are not known; kind: of the reference; seconds: that the estimate took; price: of the next better
    tolerance, None where the run keeps all of them.
    """

    configuration: Configuration
    localization_factors: np.ndarray
    references: np.ndarray
    uncertainty: float
    errors: np.ndarray
    kind: str
    seconds: float
    price: Price | None
    displacement_errors: np.ndarray

    @property
    def error(self) -> float:
        """The largest relative error of all cases."""
        return float(np.nanmax(self.errors)) if np.isfinite(self.errors).any() else math.nan

    def line(self, case: int = -1) -> str:
        """For people: the localization factor of a case with its error bar, and what a better one costs."""
        nx, ny = self.configuration.nodes
        value, bar = float(self.localization_factors[case]), float(self.errors[case] * self.localization_factors[case])
        grid = f"{nx} × {ny}, order {self.configuration.order}, {self.configuration.load}"
        if not math.isfinite(bar):
            return f"{grid}: no error estimate (the plate is at rest, or not linear in its drives)"
        limited = self.uncertainty > float(self.errors[case]) / 2
        at_most = f" at most (the reference is known to {percent(self.uncertainty)} only)" if limited else ""
        moved = float(self.displacement_errors[case])
        displacement = f", displacement ± {percent(moved)}" if math.isfinite(moved) and not limited else ""
        digits = max(3, 1 - math.floor(math.log10(bar))) if bar > 0 else 6
        found = f"localization factor {value:.{min(digits, 8)}f} ± {two_digits(bar)}{at_most}{displacement}"
        return f"{grid}: {found}{self.price_line()}"

    def price_line(self) -> str:
        """ "; 1 % costs 3 times as much (27 × 27, order 4, moments)", or nothing."""
        if self.price is None:
            return ""
        wanted, cost = self.price.configuration, self.price.cost
        grid = f"{wanted.nodes[0]} × {wanted.nodes[1]}, order {wanted.order}, {wanted.load}"
        if 0.95 < cost < 1.05:
            return f"; {percent(self.price.tolerance)} costs as much ({grid})"
        return f"; {percent(self.price.tolerance)} costs {two_digits(cost)} times as much ({grid})"

    def as_json(self) -> dict[str, object]:
        """Of numbers and texts only."""
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


def estimate(
    scene: Scene,
    drives: np.ndarray,
    localization_factors: np.ndarray,
    seconds: float,
    device: str = "auto",
    times: Sequence[float] | np.ndarray = (),
    displacement: np.ndarray | None = None,
    stage: ReferenceStage | None = None,
) -> Estimate:
    """How far the localization factors of a run are from the right ones, at a tenth of its price or less.

    Args:
        scene: as it was run.
        drives: (cases, actuators) phasors.
        localization_factors: (cases,) found.
        seconds: that the run took.
        device: for the plates that price fourth order.
        times, displacement: (cases, times, ny, nx) [m] of the run at times [s].
        stage: a reference that is there already.

    The reference grows until its own error is well below the one that it shows, or until time is up; what is left of
    its error is added.
    """
    started = time.perf_counter()
    budget = min(max(SHARE * seconds, LEAST_SECONDS), MOST_SECONDS)
    found = np.asarray(localization_factors, dtype=float)
    drives = np.asarray(drives, dtype=complex)
    # The reference is one of Gram matrices, which a plate that stretches does not have.
    kept = np.isfinite(found) & np.any(drives != 0, axis=1) & scene.linear
    if not kept.any():
        nothing = np.full(found.shape, math.nan)
        return Estimate(configuration_of(scene), found, nothing, math.nan, nothing, "none", 0.0, None, nothing)

    def enough(matrices: np.ndarray) -> float:
        difference = np.abs(found[kept] / factors_of(matrices, drives[kept]) - 1).max()
        return min(max(GOOD_ENOUGH * float(difference), FINEST_WANTED), FIRST_WANTED)

    stage = stage or grow(scene, "auto", device, enough, budget, drives[kept])
    references = np.full(found.shape, math.nan)
    references[kept] = factors_of(stage.matrices, drives[kept])
    differences = np.abs(found / references - 1)
    errors = differences + stage.uncertainty + ROUNDING[scene.grid.precision]
    worst = float(np.nanmax(differences))
    # What is mostly the reference's own error says nothing of the price of a smaller one.
    known = stage.uncertainty < worst
    price = _price(scene, worst, drives[kept], references[kept], device, budget) if known else None
    moved = _displacement_errors(stage, scene, drives, times, displacement)
    took = time.perf_counter() - started
    return Estimate(
        configuration=configuration_of(scene),
        localization_factors=found,
        references=references,
        uncertainty=stage.uncertainty,
        errors=errors,
        kind=stage.kind,
        seconds=took,
        price=price,
        displacement_errors=moved,
    )


def _displacement_errors(
    stage: ReferenceStage,
    scene: Scene,
    drives: np.ndarray,
    times: Sequence[float] | np.ndarray,
    displacement: np.ndarray | None,
) -> np.ndarray:
    """(cases,) relative L2 differences over the nodes and times, where the reference knows displacements at once."""
    errors = np.full(len(drives), math.nan)
    if displacement is None or stage.modes is None or not len(times):
        return errors
    (nx, ny), (width, height) = scene.grid.nodes, scene.plate.size
    for case, (drive, found) in enumerate(zip(drives, displacement, strict=True)):
        right = ritz_field(stage.modes, scene, drive)(times, np.linspace(0, width, nx), np.linspace(0, height, ny))
        size = np.linalg.norm(right)
        if size > 0:
            errors[case] = np.linalg.norm(found - right) / size
    return errors


def _price(
    scene: Scene, error: float, drives: np.ndarray, references: np.ndarray, device: str, budget: float
) -> Price | None:
    """The cheaper of finer grids of the run's own kind and of the highest order."""
    tolerance = next((one for one in TOLERANCES if error > one), None)
    if tolerance is None or not math.isfinite(error):
        return None
    written = replace(configuration_of(scene), time_step=make_scheme(scene).time_step)
    own_cost = cost_of_run(scene, written)
    known = [TrialRun(written, error, own_cost)]
    if scene.grid.order == 2 and highest_order(scene) == 4:
        known.append(_pilot(scene, drives, references, device, budget))
    needed = [_needed(scene, trial, AIM * tolerance) for trial in known if math.isfinite(trial.error)]
    best = min(needed, key=lambda one: cost_of_run(scene, one))
    return Price(tolerance, best, cost_of_run(scene, best) / own_cost)


def _pilot(scene: Scene, drives: np.ndarray, references: np.ndarray, device: str, budget: float) -> TrialRun:
    """Fourth order on a coarse grid, if its few plates take no longer than the estimate may."""
    nodes = nodes_for(scene.plate.size, PILOT_SIDE, 4)
    pilot = Configuration(4, LOAD_OF[4], nodes, longest_time_step(scene, 4, nodes), "float32")
    if len(drives) * node_steps(scene, pilot) > PILOT_NODE_STEPS * budget:
        return TrialRun(pilot, math.inf, math.inf)
    try:
        return try_out(scene, pilot, drives, references, device)
    except SceneError:  # its step is too long for the window, or its cells too large for an actuator
        return TrialRun(pilot, math.inf, math.inf)


def _needed(scene: Scene, trial: TrialRun, aim: float) -> Configuration:
    """The grid that keeps the error by the law of its order; loads on whole nodes are weighed as the order does."""
    configuration = replace(trial.configuration, load=LOAD_OF[trial.configuration.order])
    factor = max((trial.error / aim) ** (1 / configuration.order), 9 / min(configuration.nodes))
    return finer(scene, configuration, factor)
