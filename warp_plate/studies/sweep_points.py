"""The points of a sweep: the quantities of each, computed in this process or as tasks of a pool."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import numpy as np
import warp as wp

from warp_plate._version import __version__
from warp_plate.analysis.check import check
from warp_plate.cluster.pool import Task, WorkerPool, run_tasks
from warp_plate.cluster.tasks import SceneSpec, refuse_unlike, run_task, worker_device, worker_identity
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.solver import MODAL
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import single_drives
from warp_plate.problem.evaluate_cases import reference_phasors
from warp_plate.problem.methods import resolve_search
from warp_plate.problem.problem import make_problem
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.resolve import resolve
from warp_plate.result.sweep import Sweep, SweepOutput
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import read_beside
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Objective, Search
from warp_plate.scene.vary import Plan, parse_frequencies
from warp_plate.solve.devices import find_device
from warp_plate.studies.frequency_response import check_linear, respond_to_drive
from warp_plate.studies.searches import find_position
from warp_plate.studies.simulate import simulate

# By name: one number, or an array along the output's axis.
Values = dict[str, float | np.ndarray]


@dataclass(frozen=True)
class Point:
    """A point of a sweep, with all that is needed to run it."""

    scene: Scene | SceneSpec  # before anything is varied; plain data for another process
    values: Mapping[str, float | str]  # values of the varied keys
    what: str  # a key of QUANTITIES
    device: str
    path: str
    evaluator: str  # "modal" or "direct"
    count: int  # number of modes
    frequencies: tuple[float, ...]  # frequencies of responses [Hz]


@dataclass(frozen=True)
class Quantities:
    """The quantities of one command."""

    outputs: Mapping[str, SweepOutput]  # by name, the most important first
    compute: Callable[[Scene, Point], Values]
    evaluators: tuple[str, ...] = (MODAL, "direct")  # those that can compute them, the default first


def _localization_quantities(scene: Scene, point: Point) -> Values:
    """Return localization factors and bound, for the first of several targets, from Gram matrices where they apply."""
    scene = scene.model_copy(update={"targets": ()})
    resolved = resolve_search(scene, point.device, point.path, point.evaluator)
    if not resolved.by_modes:  # the default evaluator uses Gram matrices for robust searches
        resolved = replace(resolved, evaluator=None)
    problem = make_problem(resolved)
    if problem.response is not None and scene.search.robust is None:
        problem = problem.by_matrices
    singles = single_drives(problem.scene)
    phasors = np.array(list(reference_phasors(singles, problem.plates.energies_of_phasors).values()))
    equal, single = localization_factor(problem.plates.energies_of_phasors(phasors)).tolist()
    if not np.isfinite([equal, single]).any() and (fault := problem.drive_solver.run(phasors[:1]).fault(0)) != "ok":
        raise SceneError(fault)  # rather than at rest
    position, best = find_position(problem, problem.scene.search.seed), single
    if position is not None:
        best = float(localization_factor(problem.plates.energies(problem.parametrization.designs(position[None])))[0])
    return {"equal": equal, "single": single, "best": best, "bound": np.nan if problem.bound is None else problem.bound}


def _simulation_quantities(scene: Scene, point: Point) -> Values:
    """Return the localization factor, energies and peak displacement under the scene's own drive."""
    path = point.path
    if point.evaluator == MODAL:
        path = MODAL
    elif scene.grid.accuracy is not None:  # a grid for time steps, because an accuracy might choose modes
        phasors = scene_phasors(scene)[None]
        scene = resolve(scene, point.device, purpose="simulate", evaluator="direct", phasors=phasors).scene
    result = simulate(scene, device=point.device, path=path, estimate=False, warnings=False)
    case = result.cases["drive"]
    if case.status != "ok":
        raise SceneError(case.status)
    return {
        "localization_factor": case.localization_factor,
        "energy_plate": case.energy["plate"],
        "energy_target": case.energy["target"],
        "peak_displacement": np.nan if result.peak_displacement is None else result.peak_displacement,
    }


def _modal_quantities(scene: Scene, point: Point) -> Values:
    """Return the lowest natural frequencies; NaN beyond those that are solved for."""
    count = point.count
    frequencies = solve_modes(linear_part(scene), highest=0.0, count=count).frequencies[:count]
    return {"frequency": np.pad(frequencies, (0, count - len(frequencies)), constant_values=np.nan)}


def _response_quantities(scene: Scene, point: Point) -> Values:
    """Return the response to the scene's own drive at each frequency."""
    velocity, factor, bound = respond_to_drive(scene, np.array(point.frequencies))
    return {"mean_square_velocity": velocity, "localization_factor": factor, "bound": bound}


def _sound_quantities(scene: Scene, point: Point) -> Values:
    """Return the sound power level and the quietness of the scene's own drive, and the largest quietness of any."""
    check_linear(scene, None)
    objectives = (Objective(kind="quietness"), Objective(kind="sound"))
    scene = scene.with_tables(search=Search(objectives=objectives[:1]), targets=(), target=scene.target)
    problem = make_problem(resolve_search(scene, point.device, evaluator=MODAL))
    energy = problem.plates.energies_of_phasors(scene_phasors(scene)[None])
    values = replace(problem.objectives, terms=objectives).values(energy)
    bound = problem.loss_bound
    return {
        "sound": float(values["sound"][0]),
        "quietness": float(values["quietness"][0]),
        "bound": np.nan if bound is None else -bound.value,
    }


def _numerical_quantities(scene: Scene, point: Point) -> Values:
    """Return the time step and its limit, and the resolution in time and space."""
    numerics = check(resolve(scene, point.device, purpose="simulate", evaluator="direct").scene, point.device)
    return {
        "time_step": numerics.time_step,
        "limit": numerics.limit.time_step,
        "steps_a_period": numerics.steps_a_period,
        "points_a_wavelength": numerics.points_a_wavelength,
    }


def _output(name: str, case: str = "", axis: Literal["frequency"] | None = None) -> SweepOutput:
    quantity = REGION_QUANTITIES[name]
    return SweepOutput(quantity.unit, f"{quantity.meaning}, {case}" if case else quantity.meaning, axis)


QUANTITIES: Mapping[str, Quantities] = {
    "localize": Quantities(
        {
            "best": _output("localization", "best drive"),
            "bound": _output("localization", "bound"),
            "single": _output("localization", "best single actuator"),
            "equal": _output("localization", "equal drive"),
        },
        _localization_quantities,
    ),
    "simulate": Quantities(
        {
            "localization_factor": _output("localization"),
            "energy_plate": _output("energy_plate"),
            "energy_target": _output("energy_target"),
            "peak_displacement": SweepOutput("m", "largest displacement"),
        },
        _simulation_quantities,
    ),
    "modes": Quantities({"frequency": SweepOutput("Hz", "natural frequency", "mode")}, _modal_quantities, (MODAL,)),
    "frf": Quantities(
        {
            "mean_square_velocity": _output("mean_square_velocity", axis="frequency"),
            "localization_factor": _output("localization", "drive", "frequency"),
            "bound": _output("localization", "bound", "frequency"),
        },
        _response_quantities,
        (MODAL,),
    ),
    "sound": Quantities(
        {
            "sound": _output("sound"),
            "quietness": _output("quietness", "drive"),
            "bound": _output("quietness", "bound"),
        },
        _sound_quantities,
        (MODAL,),
    ),
    "check": Quantities(
        {
            "limit": SweepOutput("s", "time step, largest stable"),
            "time_step": SweepOutput("s", "time step, taken"),
            "steps_a_period": SweepOutput("1", "resolution, steps in a period of the drive"),
            "points_a_wavelength": SweepOutput("1", "resolution, nodes in a bending wavelength"),
        },
        _numerical_quantities,
        ("direct",),
    ),
}

# Number of tasks prepared for a pool, because their scenes may hold large files.
TASK_BLOCK = 1000


class PointResult(NamedTuple):
    """The result at a point."""

    point: int
    values: Values | None  # quantities by name; None if the point was refused
    reason: str  # why it was refused
    device: str = ""  # "" if the point was given up
    worker: Mapping[str, str] = {}  # versions and processor; empty if the point was given up

    @property
    def processor(self) -> str:
        """Name of the processor; "" if the point was given up."""
        return self.worker.get("processor", "")


def varied_files(scene: Scene, plan: Plan) -> dict[str, list[str]]:
    """Return the names of files that a plan varies, by key."""
    named = scene.named_files
    pairs = zip(plan.keys, plan.coordinates, strict=True)
    return {key: list(dict.fromkeys(values.tolist())) for key, values in pairs if key in named}


def run_point(point: Point) -> PointResult:
    """Run a point; the caller fills in its number."""
    with TemporaryDirectory() as folder:
        scene, name = point.scene, point.device or "auto"
        if isinstance(scene, SceneSpec):
            scene, name = scene.scene_in(folder), worker_device(name)
        device, values, reason = find_device(name), None, ""
        try:
            varied = scene.with_values(point.values)
            values = QUANTITIES[point.what].compute(varied, replace(point, device=device.alias))
        except SceneError as error:
            reason = str(error)
        return PointResult(-1, values, reason, device.alias, worker_identity(device))


def run_here(
    start: Sweep, points: Sequence[int], run: Callable[[Point], PointResult] = run_point
) -> Iterator[PointResult]:
    """Yield one point after the other, run in this process; a point that runs out of memory is given up."""
    for number, point in zip(points, _points(start, points, start.scene, start.device), strict=True):
        try:
            yield run_task(run, point)._replace(point=number)
        except MemoryError as error:
            yield PointResult(number, None, f"given up: {error}")


def run_on_pool(start: Sweep, points: Sequence[int], pool: WorkerPool) -> Iterator[PointResult]:
    """Yield points in the order in which a pool's workers finish them; one that fails in all attempts is given up."""
    expected: Mapping[str, str] = {"warp_plate": __version__, "warp": wp.config.version}
    arguments = _points(start, points, SceneSpec.of(start.scene), pool.device)
    tasks = (Task(run_point, point, number) for number, point in zip(points, arguments, strict=True))
    while block := list(islice(tasks, TASK_BLOCK)):
        for task, outcome in run_tasks(pool, block):
            if outcome.failure:
                yield PointResult(task.key, None, outcome.failure)
                continue
            result: PointResult = outcome.value
            refuse_unlike(expected, result.worker)
            expected = result.worker
            yield result._replace(point=task.key)


def _points(start: Sweep, points: Sequence[int], scene: Scene | SceneSpec, device: str) -> Iterator[Point]:
    frequencies = parse_frequencies(start.frequencies).tolist() if start.frequencies else ()
    kept = start.what, device, start.path, start.evaluator, start.count, tuple(frequencies)
    keys = list(varied_files(start.scene, start.plan))
    for at in points:
        values, complete = start.plan.values(at), scene
        if isinstance(scene, SceneSpec):  # a worker may have none of the files
            read = {str(values[key]): read_beside(key, str(values[key]), start.scene.folder) for key in keys}
            complete = replace(scene, files={**scene.files, **read})
        yield Point(complete, values, *kept)
