"""Search for the coarsest grid that keeps an error, with few trial runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

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
    refine,
    scene_with,
)
from warp_plate.accuracy.reference_solution import ReferenceSolution
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
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
    solver = PlateSolver(scene_with(scene, configuration), device, "streaming" if streamed else "auto")
    error = float(np.abs(localization_factor(solver.run(phasors).energy) / factors - 1).max())
    return error if math.isfinite(error) else math.inf
