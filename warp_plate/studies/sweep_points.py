"""The points of a sweep, run one after the other in this process or as tasks of a pool."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from tempfile import TemporaryDirectory
from typing import NamedTuple

import warp as wp

from warp_plate._version import __version__
from warp_plate.cluster.pool import Task, WorkerPool, run_tasks
from warp_plate.cluster.tasks import SceneSpec, refuse_unlike, run_task, worker_device, worker_identity
from warp_plate.plate.files import named_files, read_beside
from warp_plate.result.sweep import Sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import Plan, parse_frequencies
from warp_plate.solve.devices import find_device
from warp_plate.studies.quantities_of_interest import QUANTITIES, Settings, Values

# Number of tasks prepared for a pool, because their scenes may hold large files.
TASK_BLOCK = 1000


@dataclass(frozen=True)
class Point:
    """A point of a sweep, with all that is needed to run it; the scene is plain data for another process."""

    scene: Scene | SceneSpec
    values: Mapping[str, float | str]
    what: str
    settings: Settings


class PointResult(NamedTuple):
    """The result at a point.

    Attributes:
        values: quantities by name; None if the point was refused.
        reason: why it was refused; "" if it was not.
        device: device on which it ran; "" if it was given up.
        worker: versions and processor that it ran with; empty if it was given up.
    """

    point: int
    values: Values | None
    reason: str
    device: str = ""
    worker: Mapping[str, str] = {}

    @property
    def processor(self) -> str:
        """Name of the processor; "" if the point was given up."""
        return self.worker.get("processor", "")


def varied_files(scene: Scene, plan: Plan) -> dict[str, list[str]]:
    """Return the names of files that a plan varies, by key."""
    named = named_files(scene)
    pairs = zip(plan.keys, plan.coordinates, strict=True)
    return {key: list(dict.fromkeys(values.tolist())) for key, values in pairs if key in named}


def run_point(point: Point) -> PointResult:
    """Run a point; the caller fills in its number."""
    with TemporaryDirectory() as folder:
        scene, name = point.scene, point.settings.device or "auto"
        if isinstance(scene, SceneSpec):
            scene, name = scene.scene_in(folder), worker_device(name)
        device, values, reason = find_device(name), None, ""
        try:
            varied = scene.with_values(point.values)
            values = QUANTITIES[point.what].compute(varied, replace(point.settings, device=device.alias))
        except SceneError as error:
            reason = str(error)
        return PointResult(-1, values, reason, device.alias, worker_identity(device))


def run_here(start: Sweep, points: Sequence[int]) -> Iterator[PointResult]:
    """Yield one point after the other, run in this process; a point that runs out of memory is given up."""
    for number, point in zip(points, _points(start, points, start.scene, start.device), strict=True):
        try:
            yield run_task(run_point, point)._replace(point=number)
        except MemoryError as error:
            yield PointResult(number, None, f"given up: {error}")


def run_on_pool(start: Sweep, points: Sequence[int], pool: WorkerPool) -> Iterator[PointResult]:
    """Yield points in the order in which a pool's workers finish them; one that fails in all attempts is given up.

    The quantities are those of one process to the last bit if the workers have its kind of processor.
    """
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
    settings = Settings(device, start.path, start.evaluator, start.count, tuple(frequencies))
    keys = list(varied_files(start.scene, start.plan))
    for at in points:
        values, own = start.plan.values(at), scene
        if isinstance(scene, SceneSpec):  # a worker may have none of the files
            read = {str(values[key]): read_beside(key, str(values[key]), start.scene.folder) for key in keys}
            own = replace(scene, files={**scene.files, **read})
        yield Point(own, values, start.what, settings)
