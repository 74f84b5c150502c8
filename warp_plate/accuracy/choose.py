"""Choice of the cheapest engine that keeps an error: modes, or a grid, order and time step.

A grid is judged by modes, so where there are modes they cost less than the choice of a grid. Grids take few trial runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from warp_plate.accuracy.configurations import (
    Configuration,
    cost_of_run,
    percent,
    refine,
    refuse_many_modes,
    scene_with,
    seconds_text,
    two_digits,
)
from warp_plate.accuracy.grid_search import CLOSE_ENOUGH, MOST_NODE_STEPS, TRIALS, GridSearch, TrialRun, find_grids
from warp_plate.accuracy.measure import seconds_of
from warp_plate.accuracy.more_functions import MoreFunctions, compare_with_more_functions
from warp_plate.accuracy.reference_solution import (
    ReferenceSolution,
    best_single,
    find_reference_solution,
    seconds_of_modes,
)
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Grid
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver

# Tolerance of the search relative to the accuracy asked for; the rest allows for rounding, which differs between paths.
SEARCH_SHARE = 0.9
# Uncertainty of the reference relative to the accuracy asked for, and the time that it may take [s].
REFERENCE_SHARE, REFERENCE_SECONDS = 0.15, 30.0
# Functions of modes along each side that are tried, relative to the default, and the nominal time of a solution after
# which no higher density is [s].
MODAL_DENSITIES, DENSER_SECONDS = (1.0, 1.5, 2.2), 4.0
# Plates that are timed on a CUDA device, the most timed runs, and the time after which no further run begins [s].
CUDA_PLATES, TIMED_RUNS, TIMING_SECONDS = 256, 3, 0.2


@dataclass(frozen=True)
class Choice:
    """The engine and the grid that were chosen for an accuracy."""

    scene: Scene  # scene with the chosen grid in place of ``grid.accuracy``; of modes a grid for pictures
    error: float  # estimated relative error: the largest of all drives tried and of the bound
    reason: str  # explanation for people
    reference: ReferenceSolution | MoreFunctions  # reference of the error

    @property
    def by_modes(self) -> bool:
        """True for modes, False for time steps."""
        return isinstance(self.reference, MoreFunctions)


def choose(
    scene: Scene,
    accuracy: float,
    device: str = "auto",
    phasors: np.ndarray | None = None,
    engine: Literal["any", "modes", "steps"] = "steps",
) -> Choice:
    """Return the cheapest engine and configuration whose localization factors have at most this relative error.

    Modes are taken, if they may be, wherever more functions show that they keep it for ``phasors`` (drives, actuators),
    by default equal drive, the best single actuator and the best drive. Else grids of each order are tried against a
    reference solution, for all of these drives; a chosen grid is checked with the Gram matrices of all drives. The
    scene's own grid is ignored, and damping is centred in time.

    Raises:
        SceneError: no configuration within reach keeps this accuracy, or there is no such device.
    """
    find_device(device)
    if engine != "steps" and (by_modes := _by_modes(scene, accuracy, phasors, engine == "modes")):
        return by_modes
    reference = _reference(scene, accuracy, device, phasors)
    uncertainty = reference.uncertainty
    equal, more = np.ones(len(scene.actuators)), () if phasors is None else phasors
    tried = np.array([*reference.drives.values(), equal, *more])
    search = GridSearch(scene, reference, SEARCH_SHARE * accuracy - uncertainty, device, tried)
    trials = find_grids(search)
    kept = [trial for trial in trials.values() if trial.error <= search.tolerance]
    cheapest = min(kept, key=lambda trial: cost_of_run(scene, trial.configuration), default=None)
    chosen, error = _checked(search, cheapest) if cheapest else (None, math.inf)
    if chosen is None or error > SEARCH_SHARE * accuracy:
        nearest = min(trials.values(), key=lambda trial: trial.error)
        raise SceneError(
            f"accuracy = {accuracy:g}: out of reach for this scene: with {nearest.configuration} the error is "
            f"{nearest.error:.2g}, and grids above {MOST_NODE_STEPS:.0e} node-steps a plate are not tried; ask for a "
            "larger error"
        )
    resolved = scene_with(scene, chosen)
    reason = (
        f"time steps, for {percent(accuracy)}: {chosen.nodes[0]} × {chosen.nodes[1]} nodes, order {chosen.order}, "
        f"{chosen.load}, Δt = {chosen.time_step:.2g} s, {chosen.precision}: estimated error {percent(error)}, "
        f"{seconds_text(_seconds_a_plate(resolved, device))} a plate"
    )
    for order, trial in trials.items():
        if order != chosen.order and math.isfinite(trial.error):
            other = search.predict(trial)
            ratio = two_digits(cost_of_run(scene, other) / cost_of_run(scene, chosen))
            reason += f"; order {order} would need about {other.nodes[0]} × {other.nodes[1]} and {ratio} times as long"
    return Choice(resolved, error, reason, reference)


def _by_modes(scene: Scene, accuracy: float, phasors: np.ndarray | None, alone: bool) -> Choice | None:
    """Return the choice of modes; where they do not keep the accuracy None, or a SceneError if they are to."""
    if not scene.linear:
        return None
    least = math.inf
    for density in MODAL_DENSITIES:
        tried = scene.model_copy(update={"grid": Grid(modal_density=density)})
        try:
            refuse_many_modes(tried)
            compared = compare_with_more_functions(tried)
        except SceneError:  # of a higher density: too many functions
            if alone and density == MODAL_DENSITIES[0]:
                raise
            break
        error = compared.error(_usual_drives(compared.finer) if phasors is None else phasors)
        if error <= accuracy:
            reason = f"modes, for errors of at most {percent(error)}, asked {percent(accuracy)}"
            more = "" if density == 1 else f", with {density:g} times as many functions along each side"
            return Choice(tried, error, reason + more, compared)
        least = min(least, error)
        if seconds_of_modes(compared.plate) > DENSER_SECONDS:
            break
    if alone:
        raise SceneError(f"accuracy = {accuracy:g}: modes have errors of up to {least:.2g}; {_advice(least)}")
    return None


def _usual_drives(response: Response) -> np.ndarray:
    """Return the best single actuator, the best drive and equal drive (3, actuators)."""
    best = response.best_drive()
    return np.array([best_single(response), best, np.ones(best.size)])


def _reference(scene: Scene, accuracy: float, device: str, phasors: np.ndarray | None) -> ReferenceSolution:
    """Return a reference solution that grids can be judged by."""
    reference = find_reference_solution(scene, "auto", device, REFERENCE_SHARE * accuracy, REFERENCE_SECONDS, phasors)
    uncertainty = reference.uncertainty
    if not uncertainty <= accuracy / 2:
        raise SceneError(
            f"accuracy = {accuracy:g}: the reference solution of this scene is known to {uncertainty:.2g} "
            f"only; {_advice(2 * uncertainty)}"
        )
    return reference


def _advice(possible: float) -> str:
    """Return what to write in the scene if this relative error is possible."""
    if not possible < 0.4:
        return "write a grid instead"
    digit = 10.0 ** (math.floor(math.log10(possible)) - 1)
    return f"ask for {math.ceil(possible / digit) * digit:g} or more"


def _checked(search: GridSearch, trial: TrialRun) -> tuple[Configuration, float]:
    """Return the configuration, refined until the bound keeps the tolerance too, and the largest error of all."""
    reference, configuration, phasors = search.reference, trial.configuration, search.phasors
    expected = np.append(reference.response.localization_factors(phasors), reference.bound)
    error = math.inf
    for _ in range(TRIALS):
        # The matrices are differences of energies, which float32 would round away.
        solver = PlateSolver(scene_with(search.scene, replace(configuration, precision="float64")), search.device)
        response = measure_response(solver)
        computed = np.append(response.localization_factors(phasors), response.bound())
        error = max(float(np.abs(computed / expected - 1).max()), trial.error) + reference.uncertainty
        if error <= search.tolerance + reference.uncertainty:
            break
        configuration = refine(search.scene, configuration, CLOSE_ENOUGH)
        trial = search.attempt(configuration)
    return configuration, error


def _seconds_a_plate(scene: Scene, device: str) -> float:
    """Return the time per plate of a batch [s], measured after a warm-up run."""
    solver = PlateSolver(scene, device)
    plates = CUDA_PLATES if solver.device.is_cuda else 4 * solver.specialized.threads
    phasors = np.ones((plates, len(scene.actuators)), dtype=complex)
    solver.run(phasors[:1])
    return min(seconds_of(lambda: solver.run(phasors), TIMED_RUNS, TIMING_SECONDS)) / plates
