"""A search for the coarsest grid of one order that keeps an error, with few trial runs along its convergence law."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    Order,
    Precision,
    bending_wavelength,
    cost_of_run,
    longest_time_step,
    node_steps,
    nodes_for,
    scene_with,
)
from warp_plate.accuracy.reference_solution import ReferenceSolution
from warp_plate.plate.weights import localization_factor
from warp_plate.reference.forced import localization_factors
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.solver import PlateSolver

# Trials of up to this many node-steps take the streaming path, which compiles no kernel for each grid.
STREAMED_NODE_STEPS = {"cpu": 4e7, "cuda": 1e10}
# First grid: cells in a bending wave for an error of 1 % with fourth order, and the range of its side.
CELLS_A_WAVE, FIRST_SIDES = 6.3, (12.0, 120.0)
# Coarser grids may agree with each other and be wrong.
FEWEST_CELLS_A_WAVE = 4.0
# Relative difference of sides that ends the search, and the smallest ratio of successive sides.
CLOSE_ENOUGH, LARGEST_STEP = 1.06, 0.6
# A grid is confirmed by one that is finer by this factor; so many grids may fail to be confirmed.
CONFIRMING_FACTOR, ATTEMPTS = 1.2, 4
# Trials for each order and precision; node-steps of a plate and nodes of a side that are never tried.
TRIALS, MOST_NODE_STEPS, MOST_NODES = 10, 2e10, 8193


@dataclass(frozen=True)
class TrialRun:
    """A configuration that was tried."""

    configuration: Configuration  # the configuration
    error: float  # largest relative error of the localization factors
    cost: float  # see :func:`cost_of_run`


@dataclass(frozen=True)
class GridSearch:
    """The problem that a search for a grid solves."""

    scene: Scene  # scene whose grid is searched
    reference: ReferenceSolution  # reference solution of the scene
    tolerance: float  # largest relative error that is allowed
    device: str  # device of the trial runs
    more_phasors: np.ndarray | None = None  # drives (drives, actuators) that are tried besides the usual ones

    def first_side(self) -> float:
        """Return an estimate of the nodes of a side that fourth order needs."""
        cells = CELLS_A_WAVE * self._waves() * (0.01 / self.tolerance) ** 0.25
        return min(max(1 + cells, FIRST_SIDES[0]), FIRST_SIDES[1])

    def _waves(self) -> float:
        """Return the number of bending waves along the side of a square with the plate's area."""
        return math.sqrt(math.prod(self.scene.plate.size)) / bending_wavelength(self.scene)

    def configuration(self, order: Order, precision: Precision, side: float) -> Configuration:
        """Return a configuration with the longest time step and enough cells for each bending wave."""
        nodes = nodes_for(self.scene.plate.size, max(side, 1 + FEWEST_CELLS_A_WAVE * self._waves()), order)
        return Configuration(order, LOAD_OF[order], nodes, longest_time_step(self.scene, order, nodes), precision)

    def phasors(self) -> np.ndarray:
        """Return (drives, actuators): best single actuator, best drive, equal drive, and ``more_phasors``."""
        equal = np.ones(len(self.scene.actuators))
        usual = np.array([self.reference.drives["single"], self.reference.drives["best"], equal])
        return usual if self.more_phasors is None else np.concatenate([usual, self.more_phasors])

    def attempt(self, configuration: Configuration) -> TrialRun:
        """Return the trial run of a configuration; its error is infinite if the grid is refused."""
        phasors = self.phasors()
        factors = localization_factors(self.reference.matrices, phasors)
        try:
            return try_out(self.scene, configuration, phasors, factors, self.device)
        except SceneError:  # the grid is too coarse for an actuator
            return TrialRun(configuration, math.inf, cost_of_run(self.scene, configuration))

    def predict(self, trial: TrialRun) -> Configuration:
        """Return the configuration that would keep the tolerance by the convergence law of the trial's order."""
        factor = max(1.0, trial.error / self.tolerance) ** (1 / trial.configuration.order)
        return refine(self.scene, trial.configuration, factor)


def try_out(
    scene: Scene, configuration: Configuration, phasors: np.ndarray, factors: np.ndarray, device: str = "auto"
) -> TrialRun:
    """Run drives (drives, actuators) with known localization factors (drives,); non-finite plates have infinite error.

    Raises:
        SceneError: see ``PlateSolver``.
    """
    work = len(phasors) * node_steps(scene, configuration)
    streamed = work < STREAMED_NODE_STEPS["cuda" if find_device(device).is_cuda else "cpu"]
    solver = PlateSolver(scene_with(scene, configuration), device, "streaming" if streamed else "auto")
    error = float(np.abs(localization_factor(solver.run(phasors).energy) / factors - 1).max())
    return TrialRun(configuration, error if np.isfinite(error) else np.inf, cost_of_run(scene, configuration))


def refine(scene: Scene, configuration: Configuration, factor: float) -> Configuration:
    """Return a configuration with ``factor`` times the cells along each side."""
    nx, ny = (math.ceil(factor * (count - 1) - 1e-9) + 1 for count in configuration.nodes)
    return replace(configuration, nodes=(nx, ny), time_step=longest_time_step(scene, configuration.order, (nx, ny)))


def find_confirmed_grid(
    search: GridSearch, order: Order, precision: Precision, first: float, most_cost: float = math.inf
) -> TrialRun:
    """Return :func:`find_coarsest_grid`, confirmed by a somewhat finer grid that also keeps the tolerance.

    Errors of coarse grids may pass through zero, so a single grid may keep the tolerance by chance.
    """
    too_coarse = 0.0
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
    first: float,
    most_cost: float = math.inf,
    too_coarse: float = 0.0,
) -> TrialRun:
    """Return the coarsest grid found that keeps the tolerance, else the last one tried.

    Args:
        search: What is searched.
        order: Spatial order.
        precision: Precision.
        first: Nodes of a side of the first grid.
        most_cost: The search ends early if the tolerance would cost much more.
        too_coarse: Nodes of a side that are known to be too few.
    """
    best, last, fine_enough = None, None, math.inf
    side = first
    for _ in range(TRIALS):
        configuration = search.configuration(order, precision, side)
        impossible = node_steps(search.scene, configuration) > MOST_NODE_STEPS or max(configuration.nodes) > MOST_NODES
        if impossible or (last is not None and configuration == last.configuration):
            break
        last = search.attempt(configuration)
        if last.error <= search.tolerance:
            best, fine_enough = last, side
        else:
            too_coarse = max(too_coarse, side)
        if best is None:
            if math.isfinite(last.error) and cost_of_run(search.scene, search.predict(last)) > 2 * most_cost:
                break
            side = min(max(1.01 * _predicted_side(search, last, side), side + 1), 2 * side)
        else:
            if fine_enough <= CLOSE_ENOUGH * too_coarse:
                break
            side = _side_between(_predicted_side(search, last, side), too_coarse, fine_enough)
    return best or last or TrialRun(configuration, math.inf, math.inf)


def _predicted_side(search: GridSearch, trial: TrialRun, side: float) -> float:
    """Return the nodes of a side at which the error would equal the tolerance by the convergence law."""
    if not math.isfinite(trial.error):
        return 1.5 * side
    return 1 + (side - 1) * (trial.error / search.tolerance) ** (1 / trial.configuration.order)


def _side_between(predicted: float, too_coarse: float, fine_enough: float) -> float:
    """Return the predicted side if it lies between the two others, else a side between them."""
    lowest = max(LARGEST_STEP * fine_enough, CLOSE_ENOUGH * too_coarse)
    if predicted >= fine_enough:
        return math.sqrt(max(lowest, 1.0) * fine_enough)
    return min(max(1.02 * predicted, lowest), fine_enough - 1)
