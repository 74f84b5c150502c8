"""Choice of the cheapest engine that keeps an error: modes, or a grid, order and time step.

A grid is judged by modes, so where there are modes they cost less than the choice of a grid. Grids take few trial runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    Order,
    Precision,
    bending_wavelength,
    cost_of_run,
    highest_order,
    make_configuration,
    node_steps,
    nodes_for,
    percent,
    refine,
    refuse_many_modes,
    regrid,
    seconds_text,
    two_digits,
)
from warp_plate.accuracy.measure import seconds_of
from warp_plate.accuracy.reference_solution import (
    MoreFunctions,
    ReferenceSolution,
    best_single,
    compare_with_more_functions,
    find_reference_solution,
    seconds_of_modes,
)
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Grid
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver

# Below this tolerance the rounding of float32 may matter, and float64 is tried too.
FLOAT64_BELOW = 2e-3
# Trials of up to this many node-steps take the streaming path, which compiles no kernel for each grid.
STREAMED_NODE_STEPS = {"cpu": 4e7, "cuda": 1e10}
# First grid: cells in a bending wave for an error of 1 % with fourth order, and the range of its side.
CELLS_A_WAVE, FIRST_SIDES = 6.3, (12.0, 120.0)
# Coarser grids may agree with each other and be wrong.
FEWEST_CELLS_A_WAVE = 4.0
# Relative difference of sides that ends the search, and the smallest ratio of successive sides.
CLOSE_ENOUGH, LARGEST_STEP = 1.06, 0.6
# A grid is confirmed by one that is finer by this factor; number of grids that may fail this.
CONFIRMING_FACTOR, ATTEMPTS = 1.2, 4
# Trials for each order and precision; node-steps of a plate and nodes of a side that are never tried.
TRIALS, MOST_NODE_STEPS, MOST_NODES = 10, 2e10, 8193


@dataclass(frozen=True)
class TrialRun:
    """A configuration that was tried."""

    configuration: Configuration  # the configuration
    error: float  # largest relative error of the localization factors


@dataclass(frozen=True)
class GridSearch:
    """The problem that a search for a grid solves."""

    scene: Scene  # scene whose grid is searched
    reference: ReferenceSolution  # reference solution of the scene
    tolerance: float  # largest relative error that is allowed
    device: str  # device of the trial runs
    phasors: np.ndarray  # (drives, actuators) phasors that are tried

    @cached_property
    def waves(self) -> float:
        """Number of bending waves along the side of a square with the plate's area."""
        return math.sqrt(math.prod(self.scene.plate.size)) / bending_wavelength(self.scene)

    def configuration(self, order: Order, precision: Precision, side: float) -> Configuration:
        """Return a configuration with the longest time step and enough cells for each bending wave."""
        nodes = nodes_for(self.scene.plate.size, max(side, 1 + FEWEST_CELLS_A_WAVE * self.waves), order)
        return make_configuration(self.scene, order, nodes, precision)

    def attempt(self, configuration: Configuration) -> TrialRun:
        """Return the trial run of a configuration; its error is infinite if the grid is refused."""
        factors = self.reference.response.localization_factors(self.phasors)
        try:
            return TrialRun(configuration, try_out(self.scene, configuration, self.phasors, factors, self.device))
        except SceneError:  # the grid is too coarse for an actuator
            return TrialRun(configuration, math.inf)

    def predict(self, trial: TrialRun) -> Configuration:
        """Return the configuration that would keep the tolerance by the convergence law of the trial's order."""
        factor = max(1.0, trial.error / self.tolerance) ** (1 / trial.configuration.order)
        return refine(self.scene, trial.configuration, factor)

    def predict_side(self, trial: TrialRun, side: float) -> float:
        """Return the nodes of a side at which the error would equal the tolerance by the convergence law."""
        if not math.isfinite(trial.error):
            return 1.5 * side
        return 1 + (side - 1) * (trial.error / self.tolerance) ** (1 / trial.configuration.order)


def find_grids(search: GridSearch) -> dict[Order, TrialRun]:
    """Return the cheapest trial of each order; second order is searched only as far as it may be cheaper."""
    cells = CELLS_A_WAVE * search.waves * (0.01 / search.tolerance) ** 0.25
    side, most_cost = float(np.clip(1 + cells, *FIRST_SIDES)), math.inf
    trials: dict[Order, TrialRun] = {}
    for order in sorted((order for order in LOAD_OF if order <= highest_order(search.scene)), reverse=True):
        trial = find_confirmed_grid(search, order, "float32", side, most_cost)
        if trial.error > search.tolerance and search.tolerance < FLOAT64_BELOW and not trials:
            other = find_confirmed_grid(search, order, "float64", side, most_cost)
            trial = other if other.error < trial.error else trial
        trials[order] = trial
        if trial.error <= search.tolerance:
            side = math.sqrt(math.prod(trial.configuration.nodes))
            most_cost = cost_of_run(search.scene, trial.configuration)
    return trials


def find_confirmed_grid(
    search: GridSearch, order: Order, precision: Precision, first: float, most_cost: float = math.inf
) -> TrialRun:
    """Return the grid of :func:`find_coarsest_grid`, confirmed by a somewhat finer grid that also keeps the tolerance.

    Errors of coarse grids may pass through zero, so a single grid may keep the tolerance by chance.
    """
    trial = find_coarsest_grid(search, order, precision, first, most_cost)
    for _ in range(ATTEMPTS):
        if trial.error > search.tolerance:
            return trial
        if search.attempt(refine(search.scene, trial.configuration, CONFIRMING_FACTOR)).error <= search.tolerance:
            return trial
        too_coarse = math.sqrt(math.prod(trial.configuration.nodes)) * CLOSE_ENOUGH
        trial = find_coarsest_grid(search, order, precision, CONFIRMING_FACTOR * too_coarse, most_cost, too_coarse)
    return replace(trial, error=math.inf)


def find_coarsest_grid(
    search: GridSearch,
    order: Order,
    precision: Precision,
    side: float,
    most_cost: float = math.inf,
    too_coarse: float = 0.0,
) -> TrialRun:
    """Return the coarsest grid within the tolerance, or the last one tried.

    The first grid has ``side`` nodes a side; ``too_coarse`` nodes a side are known to be too few. The search ends early
    if the tolerance would cost much more than ``most_cost``.
    """
    best, last, fine_enough = None, None, math.inf
    for _ in range(TRIALS):
        configuration = search.configuration(order, precision, side)
        impossible = node_steps(search.scene, configuration) > MOST_NODE_STEPS or max(configuration.nodes) > MOST_NODES
        if impossible or (last is not None and configuration == last.configuration):
            break
        last = search.attempt(configuration)
        predicted = search.predict_side(last, side)
        if last.error <= search.tolerance:
            best, fine_enough = last, side
        else:
            too_coarse = max(too_coarse, side)
        if best is None:
            if math.isfinite(last.error) and cost_of_run(search.scene, search.predict(last)) > 2 * most_cost:
                break
            side = min(max(1.01 * predicted, side + 1), 2 * side)
        else:
            if fine_enough <= CLOSE_ENOUGH * too_coarse:
                break
            lowest = max(LARGEST_STEP * fine_enough, CLOSE_ENOUGH * too_coarse)
            if predicted >= fine_enough:
                side = math.sqrt(max(lowest, 1.0) * fine_enough)
            else:
                side = min(max(1.02 * predicted, lowest), fine_enough - 1)
    return best or last or TrialRun(configuration, math.inf)


def try_out(scene: Scene, configuration: Configuration, phasors: np.ndarray, factors: np.ndarray, device: str) -> float:
    """Return the largest error of drives (drives, actuators) with known localization factors (drives,).

    It is infinite if a plate is not finite. Raises a SceneError if ``PlateSolver`` does.
    """
    work = len(phasors) * node_steps(scene, configuration)
    streamed = work < STREAMED_NODE_STEPS["cuda" if find_device(device).is_cuda else "cpu"]
    solver = PlateSolver(regrid(scene, configuration), device, "streaming" if streamed else "auto")
    error = float(np.abs(localization_factor(solver.run(phasors).energy) / factors - 1).max())
    return error if math.isfinite(error) else math.inf


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


@dataclass(frozen=True)
class AccuracyRequest:
    """A relative error that localization factors of a scene may have."""

    scene: Scene  # its own grid is ignored, and damping is centred in time
    accuracy: float  # relative error
    device: str = "auto"  # device of trial runs
    phasors: np.ndarray | None = None  # (drives, actuators); None: the usual drives

    def choose(self, engine: Literal["any", "modes", "steps"] = "steps") -> Choice:
        """Return the cheapest engine and configuration; modes, if they may be, wherever they keep the accuracy.

        Raises:
            SceneError: No configuration within reach keeps this accuracy, or there is no such device.
        """
        find_device(self.device)
        if engine != "steps" and self.scene.linear and (by_modes := self._by_modes(alone=engine == "modes")):
            return by_modes
        return self._by_steps()

    def _by_modes(self, alone: bool) -> Choice | None:
        """Return the choice of modes; where they do not keep the accuracy None, or a SceneError if they are to."""
        least = math.inf
        for density in MODAL_DENSITIES:
            gridded = self.scene.model_copy(update={"grid": Grid(modal_density=density)})
            try:
                refuse_many_modes(gridded)
                compared = compare_with_more_functions(gridded)
            except SceneError:  # of a higher density: too many functions
                if alone and density == MODAL_DENSITIES[0]:
                    raise
                break
            error = compared.error(_usual_drives(compared.finer) if self.phasors is None else self.phasors)
            if error <= self.accuracy:
                reason = f"modes, for errors of at most {percent(error)}, asked {percent(self.accuracy)}"
                more = "" if density == 1 else f", with {density:g} times as many functions along each side"
                return Choice(gridded, error, reason + more, compared)
            least = min(least, error)
            if seconds_of_modes(compared.plate) > DENSER_SECONDS:
                break
        if alone:
            raise SceneError(f"accuracy = {self.accuracy:g}: modes have errors of up to {least:.2g}; {_advice(least)}")
        return None

    def _by_steps(self) -> Choice:
        """Return the cheapest grid of any order, checked with the Gram matrices of all drives."""
        scene, accuracy, reference = self.scene, self.accuracy, self._reference()
        equal, more = np.ones(len(scene.actuators)), () if self.phasors is None else self.phasors
        drives = np.array([*reference.drives.values(), equal, *more])
        search = GridSearch(scene, reference, SEARCH_SHARE * accuracy - reference.uncertainty, self.device, drives)
        trials = find_grids(search)
        accepted = [trial for trial in trials.values() if trial.error <= search.tolerance]
        cheapest = min(accepted, key=lambda trial: cost_of_run(scene, trial.configuration), default=None)
        chosen, error = _checked(search, cheapest) if cheapest else (None, math.inf)
        if chosen is None or error > SEARCH_SHARE * accuracy:
            nearest = min(trials.values(), key=lambda trial: trial.error)
            raise SceneError(
                f"accuracy = {accuracy:g}: out of reach for this scene: with {nearest.configuration} the error is "
                f"{nearest.error:.2g}, and grids above {MOST_NODE_STEPS:.0e} node-steps a plate are not tried; ask for "
                "a larger error"
            )
        resolved = regrid(scene, chosen)
        reason = (
            f"time steps, for {percent(accuracy)}: {chosen.nodes[0]} × {chosen.nodes[1]} nodes, order {chosen.order}, "
            f"{chosen.load}, Δt = {chosen.time_step:.2g} s, {chosen.precision}: estimated error {percent(error)}, "
            f"{seconds_text(_seconds_a_plate(resolved, self.device))} a plate"
        )
        for order, trial in trials.items():
            if order != chosen.order and math.isfinite(trial.error):
                other = search.predict(trial)
                ratio = two_digits(cost_of_run(scene, other) / cost_of_run(scene, chosen))
                nodes = f"{other.nodes[0]} × {other.nodes[1]}"
                reason += f"; order {order} would need about {nodes} and {ratio} times as long"
        return Choice(resolved, error, reason, reference)

    def _reference(self) -> ReferenceSolution:
        """Return a reference solution that grids can be judged by."""
        wanted = REFERENCE_SHARE * self.accuracy
        reference = find_reference_solution(self.scene, "auto", self.device, wanted, REFERENCE_SECONDS, self.phasors)
        uncertainty = reference.uncertainty
        if not uncertainty <= self.accuracy / 2:
            raise SceneError(
                f"accuracy = {self.accuracy:g}: the reference solution of this scene is known to {uncertainty:.2g} "
                f"only; {_advice(2 * uncertainty)}"
            )
        return reference


def choose(
    scene: Scene,
    accuracy: float,
    device: str = "auto",
    phasors: np.ndarray | None = None,
    engine: Literal["any", "modes", "steps"] = "steps",
) -> Choice:
    """Return the cheapest engine and configuration with at most this relative error; see :class:`AccuracyRequest`."""
    return AccuracyRequest(scene, accuracy, device, phasors).choose(engine)


def _usual_drives(response: Response) -> np.ndarray:
    """Return the best single actuator, the best drive and equal drive (3, actuators)."""
    best = response.best_drive()
    return np.array([best_single(response), best, np.ones(best.size)])


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
        solver = PlateSolver(regrid(search.scene, replace(configuration, precision="float64")), search.device)
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
