"""Measurement of a configuration on a device: errors against the reference solution, and the time that a plate takes.

All numbers of a row, the bound too, are computed in the precision of the row, so they include its rounding.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from statistics import median

import numpy as np

from warp_plate.accuracy.configurations import (
    NODE_STEP_SECONDS,
    RELATIVE_COST,
    Configuration,
    configuration_of,
    regrid,
    seconds_text,
    spacing_of,
)
from warp_plate.accuracy.reference_solution import ReferenceSolution, grid_lines, solve_response
from warp_plate.modal.motion import fields
from warp_plate.plate.discretization import discretize
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import cpu_threads, find_device
from warp_plate.solve.response import measure_response, unit_drives
from warp_plate.solve.solver import PlateSolver

# Load of rows of the modal engine, and the densities of functions that are measured.
MODAL, MODAL_DENSITIES = "modal", (0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
# Times within the window at which displacements are compared.
SNAPSHOTS = 6
# Nodes of the largest grid for which natural frequencies are computed, by a sparse factorisation.
SPECTRUM_NODES = 25_000
# Nominal time of the creation of a solver [s], counted in a budget.
START_SECONDS = 1.5
# Runs that are timed, and the time after which no further run begins [s].
RUNS, TIMING_SECONDS = 5, 0.5
# Plates that are timed if the whole swarm would take too long; on a CPU one for each thread if these are more.
FEW_PLATES = {"cpu": 2, "cuda": 16}


@dataclass(frozen=True)
class AccuracyRow:
    """Errors and cost of one configuration; None if not measured."""

    order: int  # spatial order; of modes the degree of their splines
    load: str  # weights of loads and regions; MODAL for modes
    nodes: tuple[int, int]  # nodes (nx, ny); of modes their functions
    time_step: float | None  # time step [s]; None for modes
    precision: str  # precision of the time steps
    damping: str | None  # scheme of viscous damping in time; None without damping
    spacing: float  # square root of the area of a cell [m]
    as_written: bool  # True for the grid of the scene itself
    status: str = "ok"  # "ok", "refused: ...", "unstable", or "skipped: would take ..."
    steps: int | None = None  # number of steps
    localization_factor: float | None = None  # localization factor of the best single actuator
    bound: float | None = None  # largest localization factor of any drive
    error: float | None = None  # largest of the three relative errors below
    error_single: float | None = None  # relative error for the best single actuator
    error_best: float | None = None  # relative error for the best drive
    error_bound: float | None = None  # relative error of the bound
    error_displacement: float | None = None  # relative L2 error over plate and window, best drive
    error_frequencies: float | None = None  # largest relative error of the first natural frequencies
    seconds_per_plate: float | None = None  # time that a plate takes among ``plates``, its share included [s]
    seconds_once: float = 0.0  # time that all plates of a search share [s]
    plates: int | None = None  # plates of the timed run
    path: str | None = None  # path of the solver

    @property
    def measured(self) -> bool:
        """True if errors and cost were measured."""
        return self.status == "ok"

    @property
    def family(self) -> str:
        """Order, load and precision."""
        if self.load == MODAL:
            return MODAL
        return f"order {self.order}, {self.load}, {self.precision}"

    def search_seconds(self, plates: int) -> float:
        """Return the time of a search with a number of plates [s]."""
        alone = (self.seconds_per_plate or 0.0) - self.seconds_once / (self.plates or 1)
        return self.seconds_once + plates * alone


@dataclass
class MeasurementContext:
    """The state that measurements of a scene share."""

    scene: Scene  # scene as written
    reference: ReferenceSolution  # its reference solution
    device: str = "auto"  # device of all runs
    path: str = "auto"  # path of all runs
    speeds: dict[tuple[int, str], float] = field(default_factory=dict)  # latest node-step by (order, precision) [s]
    spent: float = 0.0  # nominal time of the rows so far [s]
    # Errors of natural frequencies by order and nodes
    frequency_errors: dict[tuple[int, tuple[int, int]], float] = field(default_factory=dict)

    @cached_property
    def device_kind(self) -> str:
        """ "cuda" or "cpu"."""
        return "cuda" if find_device(self.device).is_cuda else "cpu"


def measure(
    context: MeasurementContext, configuration: Configuration | None, seconds_left: float = math.inf
) -> AccuracyRow:
    """Return the row of a configuration; None for the scene as written.

    If the whole measurement would take longer than the nominal time ``seconds_left``, the bound is left out and few
    plates are timed; if that takes longer too, the row is skipped. Nominal times are counted in node-steps, so that the
    same rows are measured on every machine.
    """
    scene = context.scene if configuration is None else regrid(context.scene, configuration)
    settings, damping = configuration_of(scene), scene.effects.damping
    row = AccuracyRow(
        **vars(settings),
        damping=damping.scheme if damping else None,
        spacing=spacing_of(context.scene, settings.nodes),
        as_written=configuration is None,
    )
    try:
        discretization = discretize(scene)
        scheme = discretization.scheme
        row = replace(row, time_step=scheme.time_step, steps=scheme.steps)
        node_steps = math.prod(count - 2 for count in scheme.nodes) * scheme.steps
        once = node_steps * NODE_STEP_SECONDS[context.device_kind] * RELATIVE_COST[row.order, row.precision]
        plates = len(unit_drives(len(scene.actuators))) + 2 + 2 * scene.search.particles
        whole, shortest = (START_SECONDS + count * once for count in (plates, 2 + FEW_PLATES[context.device_kind]))
        if shortest > seconds_left:
            return replace(row, status=f"skipped: would take {seconds_text(shortest)}")
        solver = PlateSolver(discretization, context.device, context.path)
    except SceneError as error:
        return replace(row, status=f"refused: {error}")
    complete = whole <= seconds_left
    context.spent += whole if complete else shortest
    return _measured(context, solver, row, complete)


def measure_modal(context: MeasurementContext, density: float) -> AccuracyRow:
    """Return the row of the modal engine with this density of functions.

    Everything from the scene to the energies of the swarm's plates is timed.
    """
    scene, reference, window = context.scene, context.reference, context.scene.window
    plate, response = solve_response(scene, density)
    nodes = plate.space.shape[::-1]
    times = np.linspace(window.start, window.end, SNAPSHOTS + 1)[1:]
    factors = response.localization_factors(np.array(list(reference.drives.values())))
    drive, plates = reference.drives["best"], scene.search.particles
    phasors = _random_phasors(plates, len(scene.actuators))
    once = median(seconds_of(lambda: solve_response(scene, density), RUNS, TIMING_SECONDS))
    alone = median(seconds_of(lambda: response.energy(phasors), RUNS, TIMING_SECONDS)) / plates
    row = AccuracyRow(
        order=plate.space.degree,
        load=MODAL,
        nodes=nodes,
        time_step=None,
        precision="float64",
        damping=None,
        spacing=spacing_of(scene, nodes),
        as_written=False,
        error_displacement=reference.displacement_error(
            drive, times, scene, fields(plate, drive[None], times, *grid_lines(scene))[0]
        ),
        error_frequencies=largest_frequency_error(plate.frequencies, reference.frequencies),
        seconds_per_plate=once / plates + alone,
        seconds_once=once,
        plates=plates,
        path=MODAL,
    )
    return _with_errors(row, reference, factors, response.bound())


def _with_errors(
    row: AccuracyRow, reference: ReferenceSolution, factors: np.ndarray, bound: float | None
) -> AccuracyRow:
    """Return the row with the localization factors of "single" and "best", the bound, and their errors."""
    expected = np.array(list(reference.localization_factors.values()))
    error_single, error_best = np.abs(factors / expected - 1).tolist()
    error_bound = None if bound is None else abs(bound / reference.bound - 1)
    return replace(
        row,
        localization_factor=float(factors[0]),
        bound=bound,
        error=max(error_single, error_best, error_bound or 0.0),
        error_single=error_single,
        error_best=error_best,
        error_bound=error_bound,
    )


def _random_phasors(plates: int, actuators: int) -> np.ndarray:
    """Return (plates, actuators) phasors of a swarm."""
    random = np.random.default_rng(0).normal(size=(2, plates, actuators))
    return np.asarray(random[0] + 1j * random[1])


def _measured(context: MeasurementContext, solver: PlateSolver, row: AccuracyRow, complete: bool) -> AccuracyRow:
    """Return the row with errors and cost."""
    scene, reference, window = solver.scene, context.reference, solver.scene.window
    times = np.linspace(window.start, window.end, SNAPSHOTS + 1)[1:]
    run = solver.run(np.array(list(reference.drives.values())), times.tolist())
    response = measure_response(solver) if complete else None
    matrices = [] if response is None else [response.matrices]
    if not all(np.isfinite(values).all() for values in (run.energy, run.displacement, *matrices)):
        return replace(row, status="unstable")
    few = max(FEW_PLATES[context.device_kind], 0 if context.device_kind == "cuda" else cpu_threads())
    plates = scene.search.particles if complete else few
    phasors = _random_phasors(plates, len(scene.actuators))
    if complete:
        solver.run(phasors)
    seconds = median(seconds_of(lambda: solver.run(phasors), RUNS if complete else 1, TIMING_SECONDS)) / plates
    context.speeds[row.order, row.precision] = seconds / solver.node_steps_per_plate
    row = replace(
        row,
        error_displacement=reference.displacement_error(
            reference.drives["best"], run.times, scene, run.displacement[1]
        ),
        error_frequencies=_frequency_error(context, scene),
        seconds_per_plate=seconds,
        plates=plates,
        path=solver.path,
    )
    return _with_errors(row, reference, localization_factor(run.energy), None if response is None else response.bound())


def seconds_of(run: Callable[[], object], most_runs: int, most_seconds: float) -> list[float]:
    """Return the times of runs [s]; after ``most_seconds`` no further one begins."""
    times: list[float] = []
    while len(times) < most_runs and sum(times) < most_seconds:
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return times


def _frequency_error(context: MeasurementContext, scene: Scene) -> float | None:
    """Return the largest relative error of the first natural frequencies; None for large grids."""
    key = (scene.grid.order, scene.grid.nodes)
    if math.prod(scene.grid.nodes) > SPECTRUM_NODES:
        return None
    if key not in context.frequency_errors:
        expected = context.reference.frequencies
        computed = natural_modes(scene, len(expected)).frequencies
        context.frequency_errors[key] = largest_frequency_error(computed, expected)
    return context.frequency_errors[key]


def largest_frequency_error(computed: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest relative error of natural frequencies (modes,) [Hz], rigid motions aside."""
    count = min(len(computed), len(expected))
    moving = np.flatnonzero(expected[:count])
    return float(np.abs(computed[moving] / expected[moving] - 1).max(initial=0.0))
