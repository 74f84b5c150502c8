"""Measurement of a configuration: errors against the reference solution, the time that a plate takes, and the machine.

All numbers of a row, the bound too, are computed in the precision of the row, so they include its rounding.
"""

import math
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import metadata
from statistics import median
from typing import Any

import numpy as np
import warp as wp

from warp_plate._version import __version__
from warp_plate.accuracy.configurations import (
    Configuration,
    configuration_of,
    nominal_seconds,
    regrid,
    seconds_text,
    spacing_of,
)
from warp_plate.accuracy.reference_solution import ReferenceSolution, solve_response
from warp_plate.modal.motion import fields
from warp_plate.plate.scheme import discretize
from warp_plate.plate.weights import localization_factor, node_positions
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import cpu_threads, find_device, processor_of
from warp_plate.solve.response import count_unit_drives, measure_response
from warp_plate.solve.solver import PlateSolver

# Load of rows of the modal engine, and the densities of functions that are measured.
MODAL, MODAL_DENSITIES = "modal", (0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
# Times within the window at which displacements are compared.
SNAPSHOTS = 6
# Nominal time of the creation of a solver [s], counted in a budget.
START_SECONDS = 1.5
# Runs that are timed, and the time after which no further run begins [s].
RUNS, TIMING_SECONDS = 5, 0.5


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
    error: float | None = None  # largest relative error of the best single actuator, the best drive and the bound
    error_displacement: float | None = None  # relative L2 error over plate and window, best drive
    seconds_per_plate: float | None = None  # time that a plate takes among ``plates``, its share included [s]
    seconds_once: float = 0.0  # time that all plates of a search share [s]
    plates: int | None = None  # plates of the timed run
    path: str | None = None  # path of the solver
    budgeted: float = 0.0  # nominal time of the measurement [s]

    @property
    def measured(self) -> bool:
        """True if errors and cost were measured."""
        return self.status == "ok"

    @property
    def family(self) -> str:
        """Order, load and precision."""
        return MODAL if self.load == MODAL else f"order {self.order}, {self.load}, {self.precision}"

    def search_seconds(self, plates: int) -> float:
        """Return the time of a search with a number of plates [s]."""
        alone = (self.seconds_per_plate or 0.0) - self.seconds_once / (self.plates or 1)
        return self.seconds_once + plates * alone


def measure(
    scene: Scene,
    reference: ReferenceSolution,
    configuration: Configuration | None,
    device: str = "auto",
    path: str = "auto",
    seconds_left: float = math.inf,
) -> AccuracyRow:
    """Return the row of a configuration (None: the scene as written), skipped beyond ``seconds_left`` nominal ones."""
    gridded = scene if configuration is None else regrid(scene, configuration)
    settings, damping = configuration_of(gridded), gridded.effects.damping
    row = AccuracyRow(
        **vars(settings),
        damping=damping.scheme if damping else None,
        spacing=spacing_of(scene.plate.size, settings.nodes),
        as_written=configuration is None,
    )
    try:
        discretization = discretize(gridded)
        scheme = discretization.scheme
        plates = count_unit_drives(len(scene.actuators)) + 2 + 2 * scene.search.particles
        plate = nominal_seconds(scene, replace(settings, time_step=scheme.time_step), device)
        row = replace(row, time_step=scheme.time_step, steps=scheme.steps, budgeted=START_SECONDS + plates * plate)
        if row.budgeted > seconds_left:
            return replace(row, status=f"skipped: would take {seconds_text(row.budgeted)}", budgeted=0.0)
        solver = PlateSolver(discretization, device, path)
    except SceneError as error:
        return replace(row, status=f"refused: {error}")
    return _measured(solver, reference, row)


def _measured(solver: PlateSolver, reference: ReferenceSolution, row: AccuracyRow) -> AccuracyRow:
    """Return the row with errors and cost."""
    scene, times = solver.scene, _snapshots(solver.scene)
    run = solver.run(np.array(list(reference.drives.values())), times.tolist())
    response = measure_response(solver)
    if not all(np.isfinite(values).all() for values in (run.energy, run.displacement, response.matrices)):
        return replace(row, status="unstable")
    plates = scene.search.particles
    phasors = _random_phasors(plates, len(scene.actuators))
    solver.run(phasors)
    row = replace(
        row,
        error_displacement=reference.displacement_error(run.times, scene, run.displacement[1]),
        seconds_per_plate=median(seconds_of(lambda: solver.run(phasors))) / plates,
        plates=plates,
        path=solver.path,
    )
    return _with_errors(row, reference, localization_factor(run.energy), response.bound())


def measure_modal(scene: Scene, reference: ReferenceSolution, density: float) -> AccuracyRow:
    """Return the row of modes with this density of functions, timed from the scene to the energies of the swarm."""
    plate, response = solve_response(scene, density)
    nodes, times = plate.space.shape[::-1], _snapshots(scene)
    factors = response.localization_factors(np.array(list(reference.drives.values())))
    plates = scene.search.particles
    phasors = _random_phasors(plates, len(scene.actuators))
    once = median(seconds_of(lambda: solve_response(scene, density)))
    alone = median(seconds_of(lambda: response.energy(phasors))) / plates
    motion = fields(plate, reference.drives["best"][None], times, *node_positions(scene))[0]
    row = AccuracyRow(
        order=plate.space.degree,
        load=MODAL,
        nodes=nodes,
        time_step=None,
        precision="float64",
        damping=None,
        spacing=spacing_of(scene.plate.size, nodes),
        as_written=False,
        error_displacement=reference.displacement_error(times, scene, motion),
        seconds_per_plate=once / plates + alone,
        seconds_once=once,
        plates=plates,
        path=MODAL,
    )
    return _with_errors(row, reference, factors, response.bound())


def _with_errors(row: AccuracyRow, reference: ReferenceSolution, factors: np.ndarray, bound: float) -> AccuracyRow:
    """Return the row with the localization factors of "single" and "best", the bound, and their largest error."""
    expected = [*reference.localization_factors.values(), reference.bound]
    error = float(np.abs(np.append(factors, bound) / expected - 1).max())
    return replace(row, localization_factor=float(factors[0]), bound=bound, error=error)


def _snapshots(scene: Scene) -> np.ndarray:
    """Return the times (SNAPSHOTS,) at which displacements are compared [s]."""
    return np.linspace(scene.window.start, scene.window.end, SNAPSHOTS + 1)[1:]


def _random_phasors(plates: int, actuators: int) -> np.ndarray:
    """Return (plates, actuators) phasors of a swarm."""
    random = np.random.default_rng(0).normal(size=(2, plates, actuators))
    return np.asarray(random[0] + 1j * random[1])


def seconds_of(run: Callable[[], object]) -> list[float]:
    """Return the times of up to RUNS runs [s]; after TIMING_SECONDS no further one begins."""
    times: list[float] = []
    while len(times) < RUNS and sum(times) < TIMING_SECONDS:
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return times


def describe_machine(name: str) -> dict[str, Any]:
    """Return the machine of a measurement on a device, with the load average of the minute before."""
    device = find_device(name)
    model = processor_of(device) + (f", {cpu_threads()} threads" if device.is_cpu else "")
    return {
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cores": os.cpu_count() or 1,
        "threads": cpu_threads(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "devices": {name: model},
    }


def describe_versions() -> dict[str, str]:
    """Return the versions of Python, this program, Warp, NumPy and CUDA."""
    versions = {"python": platform.python_version(), "warp-plate": __version__}
    versions |= {package: metadata.version(package) for package in ("warp-lang", "numpy")}
    for name, version in (("toolkit", wp.get_cuda_toolkit_version()), ("driver", wp.get_cuda_driver_version())):
        if wp.is_cuda_available() and version:
            versions[f"cuda {name}"] = ".".join(map(str, version))
    return versions
