"""The error bar of a finished run: its localization factors against a small reference solution.

Results by modes are compared with those of more functions.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    configuration_of,
    cost_of_run,
    fourth_order,
    highest_order,
    node_steps,
    percent,
    refine,
    two_digits,
)
from warp_plate.accuracy.reference_solution import (
    FINER,
    MoreFunctions,
    ReferenceSolution,
    displacement_errors,
    error_of,
    find_reference_solution,
    largest_change,
    refine_until,
    solve_response,
)
from warp_plate.accuracy.richardson import STEPPED_SECONDS, Extrapolation, extrapolate_drives
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response
from warp_plate.solve.run import Run

# Nominal time of the reference [s]. It does not depend on the run's time, so the same run has the same error bar.
REFERENCE_SECONDS = 1.0
# Effect of rounding on a localization factor.
ROUNDING = {"float32": 1e-6, "float64": 1e-13}
# The reference is refined until its uncertainty is this fraction of the run's error. The line for people names an
# uncertainty above this.
GOOD_ENOUGH = 0.1
# Largest and smallest relative uncertainty that a reference is refined to, whatever the run's error.
LOOSEST, TIGHTEST = 0.02, 2e-4
# Tolerances of which the first that the run exceeds gets a price.
TOLERANCES = (0.01, 0.001)
# Fraction of the tolerance that the grid of the price is to keep.
TOLERANCE_SHARE = 0.9
# Numerics and reference of results by modes.
MODES, MORE_FUNCTIONS = "modes", "more functions"


@dataclass(frozen=True)
class Price:
    """The cost of another accuracy."""

    tolerance: float  # relative error
    configuration: Configuration  # cheapest configuration that keeps it
    cost: float  # cost of a plate relative to the run


@dataclass(frozen=True)
class Estimate:
    """Errors of a run, for each drive."""

    numerics: str  # grid of the run, or "modes"
    localization_factors: np.ndarray  # (drives,) computed localization factors
    references: np.ndarray  # (drives,) accurate localization factors
    uncertainty: float  # relative error of the references
    errors: np.ndarray  # (drives,) errors relative to the references, with their uncertainty; NaN for plates at rest
    kind: str  # method of the reference
    seconds: float  # time that the estimate took [s]
    price: Price | None  # price of the next better tolerance; None if the run keeps all
    displacement_errors: np.ndarray  # (drives,) relative L2 errors over plate and recorded times; NaN if not known
    response: Response | None = None  # accurate Gram matrices; None in a scene that is not linear

    def of_bound(self, computed: float, bound: Callable[[Response], float | None]) -> Estimate | None:
        """Return the same for a computed bound, which is a function of Gram matrices; None if it has no error."""
        expected = None if self.response is None else bound(self.response)
        if expected is None:
            return None
        values, references = np.array([[computed], [expected]])
        return replace(
            self,
            localization_factors=values,
            references=references,
            errors=np.abs(values / references - 1) + self.uncertainty,
            price=None,
            displacement_errors=np.array([math.nan]),
        )

    @property
    def intervals(self) -> np.ndarray:
        """Intervals (drives, 2) that hold the true localization factors."""
        return np.clip(self.references[:, None] * (1 + self.uncertainty * np.array([-1, 1])), 0, 1)

    @property
    def error(self) -> float:
        """Largest relative error of all drives."""
        return float(np.nanmax(self.errors)) if np.isfinite(self.errors).any() else math.nan

    def line(self, drive: int = -1, quantity: str = "localization factor") -> str:
        """Return the localization factor of a drive with its error bar, and the price of a better one, for people."""
        value, true = float(self.localization_factors[drive]), float(self.references[drive])
        bar, displacement = float(self.errors[drive]) * true, float(self.displacement_errors[drive])
        if not math.isfinite(bar):
            return f"{self.numerics}: no error estimate (the plate is at rest)"
        text = f"{self.numerics}: {quantity} {_with_bar(value, bar)}"
        if self.kind == MORE_FUNCTIONS:
            text += " at most"
        elif self.uncertainty > GOOD_ENOUGH and self.uncertainty * true > bar / 2:
            text += f" at most (the reference is known to {percent(self.uncertainty)} only)"
        else:
            text += f", the true value is {_with_bar(true, self.uncertainty * true)}"
        if math.isfinite(displacement):
            text += f", displacement ± {percent(displacement)}"
        if self.price is None:
            return text
        times = "" if 0.95 < self.price.cost < 1.05 else f"{two_digits(self.price.cost)} times "
        return f"{text}; {percent(self.price.tolerance)} costs {times}as much ({self.price.configuration.grid_text})"

    def as_json(self) -> dict[str, object]:
        """Return the estimate as numbers and texts."""
        price: dict[str, object] | None = None
        if self.price is not None:
            grid = self.price.configuration
            price = {"tolerance": self.price.tolerance, "cost": self.price.cost}
            price |= {"nodes": list(grid.nodes), "order": grid.order, "load": grid.load}
        return {
            "error": self.error,
            "errors": self.errors.tolist(),
            "displacement_errors": self.displacement_errors.tolist(),
            "references": self.references.tolist(),
            "interval": self.intervals.tolist(),
            "uncertainty": self.uncertainty,
            "reference": self.kind,
            "seconds": self.seconds,
            "price": price,
        }


def _with_bar(value: float, bar: float) -> str:
    """Return a value with as many digits as its error bar justifies, and the bar."""
    digits = max(3, 1 - math.floor(math.log10(bar))) if bar > 0 else 6
    return f"{value:.{min(digits, 8)}f} ± {two_digits(bar)}"


def estimate(
    scene: Scene,
    phasors: np.ndarray,
    localization_factors: np.ndarray,
    device: str = "auto",
    times: Sequence[float] | np.ndarray = (),
    displacement: np.ndarray | None = None,
    time_step: float | None = None,
) -> Estimate:
    """Estimate the errors of (drives,) localization factors and of (drives, times, ny, nx) displacement [m] under
    (drives, actuators) phasors, on a run with a time step [s] (default: that of the scheme of the scene)."""
    started = time.perf_counter()
    computed = np.asarray(localization_factors, dtype=float)
    phasors = np.asarray(phasors, dtype=complex)
    moving = _moving(scene, phasors, computed)
    if not moving.any():
        return _no_estimate(configuration_of(scene).grid_text, computed)
    references = np.full(computed.shape, math.nan)
    reference, references[moving] = _reference(scene, phasors[moving], computed[moving], device)
    differences = np.abs(computed / references - 1)
    largest = float(np.nanmax(differences))
    # A difference below the uncertainty is not known to be the run's error, so no finer grid follows from it.
    price = _price(scene, largest, time_step) if reference.uncertainty < largest else None
    of_displacement = np.full(computed.shape, math.nan)
    if displacement is not None and isinstance(reference, ReferenceSolution) and reference.plate and len(times):
        of_displacement = displacement_errors(reference.plate, phasors, times, scene, displacement)
    return Estimate(
        numerics=configuration_of(scene).grid_text,
        localization_factors=computed,
        references=references,
        uncertainty=reference.uncertainty,
        errors=differences + reference.uncertainty + ROUNDING[scene.grid.precision],
        kind=reference.kind,
        seconds=time.perf_counter() - started,
        price=price,
        displacement_errors=of_displacement,
        response=reference.response if isinstance(reference, ReferenceSolution) else None,
    )


def estimate_modal(scene: Scene, phasors: np.ndarray, run: Run, compared: MoreFunctions | None = None) -> Estimate:
    """Estimate the errors of a run of (drives, actuators) phasors by modes from its change with more functions."""
    computed, phasors = localization_factor(run.energy), np.asarray(phasors, dtype=complex)
    if run.matrices is None:  # under a moving load, which more functions would take too long for
        by_grids = estimate(scene, phasors, computed)
        return replace(by_grids, numerics=MODES, price=None)
    started = time.perf_counter()
    moving = _moving(scene, phasors, computed)
    if not moving.any():
        return _no_estimate(MODES, computed)
    plate, response = (compared.finer, compared.response) if compared else solve_response(scene, FINER)
    change = largest_change(phasors[moving], response, [Response(run.matrices)])
    references, of_displacement = np.full((2, *computed.shape), math.nan)
    references[moving] = response.localization_factors(phasors[moving])
    if run.times.size:
        changes = displacement_errors(plate, phasors[moving], run.times, scene, run.displacement[moving])
        of_displacement[moving] = error_of(changes)
    return Estimate(
        numerics=MODES,
        localization_factors=computed,
        references=references,
        uncertainty=error_of(change) - change,
        errors=np.where(moving, error_of(change), math.nan),
        kind=MORE_FUNCTIONS,
        seconds=time.perf_counter() - started,
        price=None,
        displacement_errors=of_displacement,
        response=response,
    )


def _reference(
    scene: Scene, phasors: np.ndarray, computed: np.ndarray, device: str
) -> tuple[ReferenceSolution | Extrapolation, np.ndarray]:
    """Return a reference and its localization factors; for a nonlinear scene, only for these drives."""

    def wanted(factors: np.ndarray) -> float:
        difference = np.abs(computed / factors - 1).max()
        return min(max(GOOD_ENOUGH * float(difference), TIGHTEST), LOOSEST)

    if not scene.linear:
        # As much time as the run took, if that is more.
        seconds = max(REFERENCE_SECONDS, STEPPED_SECONDS * len(phasors) * node_steps(scene, configuration_of(scene)))
        refinements = extrapolate_drives(scene, phasors, device)
        extrapolation = refine_until(refinements, lambda last: wanted(last.values), seconds)
        return extrapolation, extrapolation.values

    reference = find_reference_solution(
        scene, device, lambda last: wanted(last.localization_factors(phasors)), REFERENCE_SECONDS, phasors
    )
    return reference, reference.response.localization_factors(phasors)


def _moving(scene: Scene, phasors: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Return whether the plates of drives (drives,) move, and so have a localization factor."""
    return np.asarray(np.isfinite(factors) & (np.any(phasors != 0, axis=1) | (not scene.linear)))


def _no_estimate(numerics: str, factors: np.ndarray) -> Estimate:
    unknown = np.full(factors.shape, math.nan)
    return Estimate(numerics, factors, unknown, math.nan, unknown, "none", 0.0, None, unknown)


def _price(scene: Scene, error: float, time_step: float | None) -> Price | None:
    """Return the cheaper of finer grids of the run's own order and of fourth order, by their laws."""
    tolerance = next((tolerance for tolerance in TOLERANCES if error > tolerance), None)
    if tolerance is None or not math.isfinite(error):
        return None
    wanted = TOLERANCE_SHARE * tolerance
    run = replace(configuration_of(scene), time_step=time_step or make_scheme(scene).time_step)
    factor = max((error / wanted) ** (1 / run.order), 9 / min(run.nodes))
    grids = [refine(scene, replace(run, load=LOAD_OF[run.order]), factor)]
    if highest_order(scene) > run.order:
        grids.append(fourth_order(scene, wanted))
    cheapest = min(grids, key=lambda configuration: cost_of_run(scene, configuration))
    return Price(tolerance, cheapest, cost_of_run(scene, cheapest) / cost_of_run(scene, run))
