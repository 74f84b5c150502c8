"""Runs one configuration on a device: its errors against the right answer, and the seconds that a plate takes.

All numbers of a row are in the row's own precision, the bound too: rounding is a part of what is shown.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from warp_plate.accuracy.configurations import Configuration, configuration_of, node_steps, scene_with, spacing_of
from warp_plate.accuracy.formatting import seconds_text
from warp_plate.accuracy.natural_frequencies import natural_frequencies
from warp_plate.accuracy.reference_solution import ReferenceSolution
from warp_plate.accuracy.trial_runs import PATH, RELATIVE_COST
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor
from warp_plate.reference.forced import bound as bound_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import cpu_threads, find_device
from warp_plate.solve.response import measure_response, unit_drives
from warp_plate.solve.solver import PlateSolver

# Times in the window at which displacements are compared.
SNAPSHOTS = 6
# Nodes of the largest grid of which natural frequencies are found (a sparse factorisation).
SPECTRUM_NODES = 25_000
# A guess of the seconds for a node-step of second order in float32, until one is measured, and for making a solver.
GUESS = {"cpu": 0.6e-9, "cuda": 2e-11}
GUESS_START = 1.5
# Runs that are timed, and the seconds after which no further one begins.
RUNS, TIMING_SECONDS = 5, 0.5
# Plates with which a CUDA device is timed where the whole swarm would take too long.
FEW_ON_CUDA = 16


@dataclass(frozen=True)
class AccuracyRow:
    """One configuration's figures; None where there is none.

    nodes: (nx, ny); time_step [s]; damping: scheme of the damping in time, None without; spacing: root of a cell's area
    [m]; localization_factor: of the best single actuator; bound; error: the largest relative error of single, best and
    bound; error_displacement: relative L2 over plate and window, best drive; error_frequencies: the largest relative
    one of the first natural frequencies; seconds_per_plate: where ``plates`` run at once; status: "ok" (then all but
    the bound and frequencies of large grids are there), "refused: ...", "unstable", or "skipped: would take ...".
    """

    order: int
    load: str
    nodes: tuple[int, int]
    time_step: float | None
    precision: str
    damping: str | None
    spacing: float
    as_written: bool
    status: str
    steps: int | None = None
    localization_factor: float | None = None
    bound: float | None = None
    error: float | None = None
    error_single: float | None = None
    error_best: float | None = None
    error_bound: float | None = None
    error_displacement: float | None = None
    error_frequencies: float | None = None
    seconds_per_plate: float | None = None
    plates: int | None = None
    path: str | None = None

    @property
    def measured(self) -> bool:
        """Whether there are figures."""
        return self.status == "ok"


@dataclass
class Bench:
    """What rows share: scene, truth, device and path; the speed seen so far, by (order, precision) [s a node-step]."""

    scene: Scene
    truth: ReferenceSolution
    device: str = "auto"
    path: str = PATH
    speeds: dict[tuple[int, str], float] = field(default_factory=dict)
    start_seconds: float = GUESS_START
    frequencies: dict[tuple[int, tuple[int, int]], float] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Cpu or cuda, in small letters."""
        return "cuda" if find_device(self.device).is_cuda else "cpu"

    def speed(self, order: int, precision: str) -> float:
        """Seconds for a node-step: seen, or concluded from what was seen of another kind."""
        cost = RELATIVE_COST[order, precision]
        if (order, precision) in self.speeds:
            return self.speeds[order, precision]
        if self.speeds:
            return max(value * cost / RELATIVE_COST[key] for key, value in self.speeds.items())
        return GUESS[self.kind] * cost


def measure(bench: Bench, configuration: Configuration | None, seconds_left: float = math.inf) -> AccuracyRow:
    """The row of a configuration, or of the scene as written (None).

    Where all of it would take longer than ``seconds_left``, the bound is left out and two plates are timed; where that
    does too, the row is skipped.
    """
    scene = bench.scene if configuration is None else scene_with(bench.scene, configuration)
    empty = _empty_row(bench.scene, scene, configuration is None)
    try:
        scheme = make_scheme(scene)
    except SceneError as error:
        return replace(empty, status=f"refused: {error}")
    empty = replace(empty, time_step=scheme.time_step, steps=scheme.steps)
    nx, ny = scheme.nodes
    work = (nx - 2) * (ny - 2) * scheme.steps
    full, short = _plan(bench, scene, work)
    if short > seconds_left:
        return replace(empty, status=f"skipped: would take {seconds_text(short)}")
    started = time.perf_counter()
    try:
        solver = PlateSolver(scene, bench.device, bench.path)
    except SceneError as error:
        return replace(empty, status=f"refused: {error}")
    bench.start_seconds = (bench.start_seconds + time.perf_counter() - started) / 2
    return _figures(bench, solver, empty, whole=full <= seconds_left)


def _empty_row(written: Scene, scene: Scene, as_written: bool) -> AccuracyRow:
    grid, damping = scene.grid, scene.effects.damping
    one = configuration_of(scene)
    return AccuracyRow(
        order=one.order,
        load=one.load,
        nodes=one.nodes,
        time_step=grid.time_step,
        precision=one.precision,
        damping=damping.scheme if damping else None,
        spacing=spacing_of(written, one.nodes),
        as_written=as_written,
        status="ok",
    )


def _plan(bench: Bench, scene: Scene, work: float) -> tuple[float, float]:
    """Seconds of a whole and of a short measurement."""
    once = work * bench.speed(scene.grid.order, scene.grid.precision)
    actuators = len(scene.actuators)
    plates = len(unit_drives(actuators)) + 2 + 2 * scene.search.particles
    few = FEW_ON_CUDA if bench.kind == "cuda" else max(2, cpu_threads())
    return bench.start_seconds + plates * once, bench.start_seconds + (2 + few) * once


def _figures(bench: Bench, solver: PlateSolver, empty: AccuracyRow, whole: bool) -> AccuracyRow:
    """The figures of a solver that could be made."""
    scene, truth = solver.scene, bench.truth
    drives = np.array([truth.drives["single"], truth.drives["best"]])
    window = scene.window
    times = np.linspace(window.start, window.end, SNAPSHOTS + 1)[1:]
    run = solver.run(drives, times.tolist())
    if not (run.finite.all() and np.isfinite(run.displacement).all()):
        return replace(empty, status="unstable")
    factors = localization_factor(run.energy)
    right = truth.localization_factors
    error_single, error_best = (abs(float(f) / right[name] - 1) for f, name in zip(factors, right, strict=True))
    largest, error_bound = None, None
    if whole:
        matrices = measure_response(solver).matrices
        if not np.isfinite(matrices).all():
            return replace(empty, status="unstable")
        largest = bound_of(matrices)[0]
        error_bound = abs(largest / truth.bound - 1)
    seconds, plates = _seconds_of_swarm(solver, scene.search.particles if whole else _few(solver), whole)
    bench.speeds[empty.order, empty.precision] = seconds / plates / solver.node_steps_per_plate
    return replace(
        empty,
        localization_factor=float(factors[0]),
        bound=largest,
        error=max(error_single, error_best, error_bound or 0.0),
        error_single=error_single,
        error_best=error_best,
        error_bound=error_bound,
        error_displacement=_displacement_error(truth, scene, run.times, run.displacement[1]),
        error_frequencies=_frequency_error(bench, scene),
        seconds_per_plate=seconds / plates,
        plates=plates,
        path=solver.path,
    )


def _few(solver: PlateSolver) -> int:
    """The fewest plates that show the speed of a device."""
    return FEW_ON_CUDA if solver.device.is_cuda else max(2, solver.specialized.threads)


def _seconds_of_swarm(solver: PlateSolver, plates: int, repeated: bool) -> tuple[float, int]:
    """Median seconds of a run of so many plates, and their number; ``run`` returns when the device is idle.

    The solver has run before; unless ``repeated``, one run counts.
    """
    random = np.random.default_rng(0)
    parts = random.normal(size=(2, plates, len(solver.scene.actuators)))
    drives = parts[0] + 1j * parts[1]
    if repeated:
        solver.run(drives)
    taken: list[float] = []
    while len(taken) < (RUNS if repeated else 1) and (not taken or sum(taken) < TIMING_SECONDS):
        started = time.perf_counter()
        solver.run(drives)
        taken.append(time.perf_counter() - started)
    return median(taken), plates


def _displacement_error(truth: ReferenceSolution, scene: Scene, times: np.ndarray, found: np.ndarray) -> float:
    """‖u − u_true‖ / ‖u_true‖ over all nodes and times."""
    width, height = scene.plate.size
    nx, ny = scene.grid.nodes
    right = truth.displacement(times.tolist(), np.linspace(0, width, nx), np.linspace(0, height, ny))
    size = float(np.linalg.norm(right))
    return float(np.linalg.norm(found - right)) / size if size > 0 else math.nan


def _frequency_error(bench: Bench, scene: Scene) -> float | None:
    """Largest relative error of the first natural frequencies; None for large grids."""
    key = (scene.grid.order, scene.grid.nodes)
    if math.prod(scene.grid.nodes) > SPECTRUM_NODES:
        return None
    if key not in bench.frequencies:
        right = bench.truth.frequencies
        found = natural_frequencies(scene, len(right))
        bench.frequencies[key] = float(np.abs(found / right[: len(found)] - 1).max())
    return bench.frequencies[key]


def cost_order(scene: Scene, configuration: Configuration) -> float:
    """By which configurations are sorted from cheap to dear."""
    return node_steps(scene, configuration) * RELATIVE_COST[configuration.order, configuration.precision]


def speeds_json(speeds: Mapping[tuple[int, str], float]) -> dict[str, float]:
    """Nanoseconds for a node-step, by kind."""
    return {f"order {order}, {precision}": 1e9 * value for (order, precision), value in sorted(speeds.items())}
