"""Choice of the cheapest grid, order and time step that keep an error, for a scene on a device."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.accuracy.configurations import Configuration, Order, cost_of_run, highest_order, scene_with
from warp_plate.accuracy.formatting import percent, seconds_text, two_digits
from warp_plate.accuracy.grid_search import (
    CLOSE_ENOUGH,
    MOST_NODE_STEPS,
    TRIALS,
    GridSearch,
    TrialRun,
    find_confirmed_grid,
    refine,
)
from warp_plate.accuracy.reference_solution import ReferenceSolution, find_reference_solution
from warp_plate.reference.forced import bound, localization_factors
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.response import measure_response
from warp_plate.solve.solver import PlateSolver

# Tolerance of the search relative to the accuracy asked for; the rest allows for rounding, which differs between paths.
SEARCH_SHARE = 0.9
# Uncertainty of the reference relative to the accuracy asked for, and the time that it may take [s].
REFERENCE_SHARE, REFERENCE_SECONDS = 0.15, 30.0
# Below this tolerance the rounding of float32 may matter, and float64 is tried too.
FLOAT64_BELOW = 2e-3
# Plates that are timed on a CUDA device, and the time after which no further run begins [s].
CUDA_PLATES, TIMING_SECONDS = 256, 0.2


@dataclass(frozen=True)
class GridChoice:
    """The grid that was chosen for an accuracy."""

    scene: Scene  # scene with the chosen grid in place of ``grid.accuracy``
    asked: float  # relative error that was asked for
    # Estimated relative error: the largest of all drives tried and of the bound
    error: float
    seconds: float  # time that a plate takes among several [s]
    reason: str  # explanation for people
    reference: ReferenceSolution  # reference solution that the error was measured against


def choose(scene: Scene, accuracy: float, device: str = "auto", phasors: np.ndarray | None = None) -> GridChoice:
    """Return the cheapest configuration whose localization factors have at most this relative error.

    Grids of each order are tried against the reference solution with equal drive, the best single actuator, the best
    drive and ``phasors`` (drives, actuators); the chosen one is checked with the Gram matrices of all drives. The
    scene's own grid is ignored, and damping is centred in time.

    Raises:
        SceneError: no configuration within reach keeps this accuracy, or there is no such device.
    """
    find_device(device)
    reference = find_reference_solution(scene, "auto", device, REFERENCE_SHARE * accuracy, REFERENCE_SECONDS, phasors)
    if not reference.uncertainty <= accuracy / 2:
        possible = reference.uncertainty < 0.2
        advice = f"ask for {_rounded_up(2 * reference.uncertainty):g} or more" if possible else "write a grid instead"
        raise SceneError(
            f"accuracy = {accuracy:g}: the reference solution of this scene is known to {reference.uncertainty:.2g} "
            f"only; {advice}"
        )
    search = GridSearch(scene, reference, SEARCH_SHARE * accuracy - reference.uncertainty, device, phasors)
    trials = _trials(search)
    kept = [trial for trial in trials.values() if trial.error <= search.tolerance]
    chosen, error = _checked(search, min(kept, key=lambda trial: trial.cost)) if kept else (None, math.inf)
    if chosen is None or error > SEARCH_SHARE * accuracy:
        nearest = min(trials.values(), key=lambda trial: trial.error)
        raise SceneError(
            f"accuracy = {accuracy:g}: out of reach for this scene: with {nearest.configuration} the error is "
            f"{nearest.error:.2g}, and grids above {MOST_NODE_STEPS:.0e} node-steps a plate are not tried; ask for a "
            "larger error"
        )
    resolved = scene_with(scene, chosen)
    seconds = _seconds_a_plate(resolved, device)
    reason = (
        f"{percent(accuracy)}: {chosen.nodes[0]} × {chosen.nodes[1]} nodes, order {chosen.order}, {chosen.load}, "
        f"Δt = {chosen.time_step:.2g} s, {chosen.precision}: estimated error {percent(error)}, "
        f"{seconds_text(seconds)} a plate{_alternatives(search, trials, chosen)}"
    )
    return GridChoice(resolved, accuracy, error, seconds, reason, reference)


def _trials(search: GridSearch) -> dict[Order, TrialRun]:
    """Return the cheapest trial of each order; second order is searched only as far as it may be cheaper."""
    side, most_cost = search.first_side(), math.inf
    orders: tuple[Order, ...] = (4, 2) if highest_order(search.scene) == 4 else (2,)
    trials: dict[Order, TrialRun] = {}
    for order in orders:
        trial = find_confirmed_grid(search, order, "float32", side, most_cost)
        if trial.error > search.tolerance and search.tolerance < FLOAT64_BELOW and order == orders[0]:
            other = find_confirmed_grid(search, order, "float64", side, most_cost)
            trial = other if other.error < trial.error else trial
        trials[order] = trial
        if trial.error <= search.tolerance:
            side, most_cost = math.sqrt(math.prod(trial.configuration.nodes)), trial.cost
    return trials


def _checked(search: GridSearch, trial: TrialRun) -> tuple[Configuration, float]:
    """Return the configuration, refined until the bound keeps the tolerance too, and the largest error of all."""
    reference, configuration, phasors = search.reference, trial.configuration, search.phasors()
    expected = np.append(localization_factors(reference.matrices, phasors), reference.bound)
    error = math.inf
    for _ in range(TRIALS):
        # The matrices are differences of energies, which float32 would round away.
        solver = PlateSolver(scene_with(search.scene, replace(configuration, precision="float64")), search.device)
        matrices = measure_response(solver).matrices
        computed = np.append(localization_factors(matrices, phasors), bound(matrices)[0])
        error = max(float(np.abs(computed / expected - 1).max()), trial.error) + reference.uncertainty
        if error <= search.tolerance + reference.uncertainty:
            break
        configuration = refine(search.scene, configuration, CLOSE_ENOUGH)
        trial = search.attempt(configuration)
    return configuration, error


def _seconds_a_plate(scene: Scene, device: str) -> float:
    """Return the time that a plate takes among several [s], after a run to warm up."""
    solver = PlateSolver(scene, device)
    plates = CUDA_PLATES if solver.device.is_cuda else 4 * solver.specialized.threads
    phasors = np.ones((plates, len(scene.actuators)), dtype=complex)
    solver.run(phasors[:1])
    times: list[float] = []
    while len(times) < 3 and sum(times) < TIMING_SECONDS:
        started = time.perf_counter()
        solver.run(phasors)
        times.append(time.perf_counter() - started)
    return min(times) / plates


def _alternatives(search: GridSearch, trials: dict[Order, TrialRun], chosen: Configuration) -> str:
    """Return the cost of the orders that were not chosen, for people."""
    text = ""
    for order, trial in trials.items():
        if order != chosen.order and math.isfinite(trial.error):
            other = search.predict(trial)
            ratio = cost_of_run(search.scene, other) / cost_of_run(search.scene, chosen)
            text += f"; order {order} would need about {other.nodes[0]} × {other.nodes[1]} and {two_digits(ratio)} "
            text += "times as long"
    return text


def _rounded_up(value: float) -> float:
    """Return the value rounded up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit
