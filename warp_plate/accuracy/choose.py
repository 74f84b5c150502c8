"""Choice of the engine and the grid that keep an error: modes, or else the coarsest grid of the scene's highest order.

A grid is judged by modes, so where there are modes they cost less than the choice of a grid.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from warp_plate.accuracy.configurations import (
    Configuration,
    highest_order,
    make_configuration,
    node_steps,
    nodes_for,
    nominal_seconds,
    percent,
    refine,
    refuse_many_modes,
    regrid,
    seconds_text,
    waves_along,
)
from warp_plate.accuracy.reference_solution import (
    FINER,
    MoreFunctions,
    ReferenceSolution,
    error_of,
    find_reference_solution,
    largest_change,
    seconds_of_modes,
    solve_response,
    usual_drives,
)
from warp_plate.accuracy.richardson import FEWEST_CELLS_A_WAVE
from warp_plate.plate.stability_limit import needs_moment_form
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import CELLS_A_WAVE, Grid, grid_by_waves
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.response import count_unit_drives, measure_response
from warp_plate.solve.solver import PlateSolver

# Functions of modes along each side that are tried, relative to the default, and the nominal time of a solution beyond
# which no higher density is tried [s]. Nor is one if the error would have to fall by more than this power of its last
# fall.
MODAL_DENSITIES, DENSER_SECONDS, STEEPEST_FALL = (1.0, 1.5, 2.2), 4.0, 3
# Uncertainty of the reference relative to the accuracy asked for, and the time that it may take [s].
REFERENCE_SHARE, REFERENCE_SECONDS = 0.15, 30.0
# Error of a grid relative to the accuracy asked for; the rest allows for rounding in float32.
SEARCH_SHARE = 0.9
# Fewest cells along a side: as with few in a wave, coarser grids may agree with each other and be wrong.
FEWEST_ALONG = 8.0
# A grid is confirmed by one that is finer by this factor, and the next grid is finer by a factor between these.
CONFIRMING_FACTOR, LEAST_STEP, LARGEST_STEP = 1.2, 1.06, 1.5
# Grids that are tried, the node-steps of all their plates together (two minutes of a core), and nodes of a side.
TRIALS, MOST_NODE_STEPS, MOST_NODES = 20, 4e10, 8193
# Trials of plain plates of up to this many node-steps take the streaming path, which compiles no kernel a grid.
STREAMED_NODE_STEPS = {"cpu": 4e7, "cuda": 1e10}


@dataclass(frozen=True)
class Choice:
    """The engine and the grid that were chosen for an accuracy."""

    scene: Scene  # scene with the chosen grid in place of ``grid.accuracy``; of modes a grid for pictures
    error: float  # estimated relative error: the largest of all drives tried and of the bound; inf if not known
    reason: str  # explanation for people
    reference: ReferenceSolution | MoreFunctions | None  # reference of the error; None if it is not known

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
    required: bool = True,
) -> Choice:
    """Return the engine and the grid with at most a relative error; modes, if they may be, wherever they keep it.

    ``phasors`` (drives, actuators) are the drives that keep it (default: the usual ones). The scene's own grid is
    ignored, and damping is centred in time. Where no choice keeps the error, modes with the least one are returned, or
    a grid of which no error is known; a SceneError is raised if the accuracy is ``required``.
    """
    find_device(device)
    least = math.inf
    if engine != "steps" and scene.linear:
        by_modes = _choose_modes(scene, accuracy, phasors, alone=engine == "modes")
        if by_modes is not None:
            least = by_modes.error
            if least <= accuracy or not required:
                return by_modes
            if engine == "modes":
                raise SceneError(f"accuracy = {accuracy:g}: modes have errors of up to {least:.2g}; {_advice(least)}")
    try:
        return _choose_grid(scene, accuracy, device, phasors, least)
    except SceneError:
        if required:
            raise
        return _grid_by_waves(scene)


def _choose_modes(scene: Scene, accuracy: float, phasors: np.ndarray | None, alone: bool) -> Choice | None:
    """Return the modes that keep the accuracy, or else those with the least error.

    Return None if there are no modes, which is a SceneError if nothing else may be chosen (``alone``).
    """
    best: Choice | None = None
    last = math.inf
    for density in MODAL_DENSITIES:
        gridded = scene.model_copy(update={"grid": Grid(modal_density=density)})
        try:
            refuse_many_modes(gridded)
            (taken, response), (finer, expected) = (solve_response(gridded, factor) for factor in (1.0, FINER))
        except SceneError:  # of a higher density: too many functions
            if alone and density == MODAL_DENSITIES[0]:
                raise
            break
        observed = np.empty((0, len(scene.actuators))) if phasors is None else phasors
        error = error_of(largest_change(observed, expected, [response]))
        if best is None or error < best.error:
            reason = f"modes, for errors of at most {percent(error)}, asked {percent(accuracy)}"
            more = "" if density == 1 else f", with {density:g} times as many functions along each side"
            best = Choice(gridded, error, reason + more, MoreFunctions(taken, finer, expected))
        hopeless = error * (error / last) ** STEEPEST_FALL > accuracy
        if error <= accuracy or hopeless or seconds_of_modes(finer) > DENSER_SECONDS:
            break
        last = error
    return best


def _choose_grid(scene: Scene, accuracy: float, device: str, phasors: np.ndarray | None, of_modes: float) -> Choice:
    """Return the choice of a grid, where modes have an error of at least ``of_modes``."""
    wanted = REFERENCE_SHARE * accuracy
    reference = find_reference_solution(scene, device, wanted, REFERENCE_SECONDS, phasors)
    uncertainty = reference.uncertainty
    if not uncertainty <= accuracy / 2:
        known = min(uncertainty, of_modes)
        raise SceneError(
            f"accuracy = {accuracy:g}: the solution of this scene is known to {known:.2g} only; "
            f"{_advice(min(2 * uncertainty, of_modes))}"
        )
    drives = usual_drives(reference.response)
    if phasors is not None:
        drives = np.concatenate([drives, phasors])
    error_on = partial(error_of_grid, scene, reference, drives, device)
    grid, error = find_grid(scene, SEARCH_SHARE * accuracy - uncertainty, error_on)
    if grid is None:
        raise SceneError(
            f"accuracy = {accuracy:g}: out of reach for this scene: the error is {error:.2g} on the finest grid, and "
            f"finer grids would take the trials beyond {MOST_NODE_STEPS:.0e} node-steps; "
            f"{_advice(min((error + uncertainty) / SEARCH_SHARE, of_modes))}"
        )
    rounded = _error_with_rounding(scene, reference, drives, device, grid)
    if rounded + uncertainty <= accuracy:
        error = max(error, rounded)
    else:  # of small localization factors
        grid = replace(grid, precision="float64")
    error += uncertainty
    reason = (
        f"time steps, for {percent(accuracy)}: {grid.nodes[0]} × {grid.nodes[1]} nodes, order {grid.order}, "
        f"{grid.load}, Δt = {grid.time_step:.2g} s, {grid.precision}: estimated error {percent(error)}, about "
        f"{seconds_text(nominal_seconds(scene, grid, device))} a plate"
    )
    return Choice(regrid(scene, grid), error, reason, reference)


def _grid_by_waves(scene: Scene) -> Choice:
    """Return the grid by bending waves of a scene of which no error is known."""
    order = highest_order(scene)
    nodes = grid_by_waves(scene.plate.size, math.sqrt(math.prod(scene.plate.size)) / waves_along(scene)).nodes
    grid = make_configuration(scene, order, nodes)
    reason = (
        f"time steps: {nodes[0]} × {nodes[1]} nodes, order {order}, {CELLS_A_WAVE:g} cells a bending wave; no error is "
        "known beforehand"
    )
    return Choice(regrid(scene, grid), math.inf, reason, None)


def find_grid(
    scene: Scene, tolerance: float, error_on: Callable[[Configuration], float]
) -> tuple[Configuration | None, float]:
    """Return the coarsest grid within the tolerance and its error; None and the last error if none is within reach."""
    order, error = highest_order(scene), math.inf
    cells = max(FEWEST_ALONG, FEWEST_CELLS_A_WAVE * waves_along(scene))
    left = MOST_NODE_STEPS / count_unit_drives(len(scene.actuators))
    for _ in range(TRIALS):
        grid = make_configuration(scene, order, nodes_for(scene.plate.size, 1 + cells, order))
        finer = refine(scene, grid, CONFIRMING_FACTOR)
        left -= node_steps(scene, grid)
        if node_steps(scene, finer) > left or max(grid.nodes) > MOST_NODES:
            break
        error = error_on(grid)
        if error <= tolerance:
            left -= node_steps(scene, finer)
            of_finer = error_on(finer)
            if of_finer <= tolerance:
                return grid, error
            error = of_finer
        cells *= float(np.clip(1.02 * (error / tolerance) ** (1 / order), LEAST_STEP, LARGEST_STEP))
    return None, error


def error_of_grid(
    scene: Scene, reference: ReferenceSolution, drives: np.ndarray, device: str, configuration: Configuration
) -> float:
    """Return the largest relative error of drives (drives, actuators) and of the bound; infinity if there is none."""
    path = _path_of(scene, count_unit_drives(len(scene.actuators)) * node_steps(scene, configuration), device)
    try:
        response = measure_response(PlateSolver(regrid(scene, configuration).in_float64(), device, path))
    except SceneError:  # the cells are too large for an actuator
        return math.inf
    if not np.isfinite(response.matrices).all():
        return math.inf
    computed = np.append(response.localization_factors(drives), response.bound())
    expected = np.append(reference.response.localization_factors(drives), reference.bound)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = float(np.abs(computed / expected - 1).max())
    return math.inf if math.isnan(error) else error


def _error_with_rounding(
    scene: Scene, reference: ReferenceSolution, drives: np.ndarray, device: str, configuration: Configuration
) -> float:
    """Return the largest relative error of drives (drives, actuators) in the precision of the configuration."""
    path = _path_of(scene, len(drives) * node_steps(scene, configuration), device)
    computed = localization_factor(PlateSolver(regrid(scene, configuration), device, path).run(drives).energy)
    return float(np.abs(computed / reference.response.localization_factors(drives) - 1).max())


def _path_of(scene: Scene, work: float, device: str) -> str:
    """Return the path of trials of so many node-steps."""
    few = work < STREAMED_NODE_STEPS["cuda" if find_device(device).is_cuda else "cpu"]
    return "streaming" if few and not needs_moment_form(scene) else "auto"


def _advice(possible: float) -> str:
    """Return what to write in the scene if this relative error is possible."""
    if not possible < 0.4:
        return "write a grid instead"
    digit = 10.0 ** (math.floor(math.log10(possible)) - 1)
    return f"ask for {math.ceil(possible / digit) * digit:g} or more"
