"""Run single points of a sweep, in this process or on the workers of a pool."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import NamedTuple

import warp as wp

import warp_plate
from warp_plate.cluster.pool import WorkerPool
from warp_plate.cluster.scheduler import Task, run_tasks
from warp_plate.cluster.tasks import SceneSpec, refuse_unlike, run_task, worker_device, worker_identity
from warp_plate.result.sweep import Sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import with_numbers
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.studies.quantities_of_interest import QUANTITIES, QuantityOptions, Values


@dataclass(frozen=True)
class Point:
    """A point of a sweep, with all that is needed to run it.

    Attributes:
        scene: The scene that is varied; plain data for another process.
        numbers: What the point's scene has in other keys' places.
        what: Name in QUANTITIES.
        options: Device, path and count of the quantities.
    """

    scene: Scene | SceneSpec
    numbers: Mapping[str, float]
    what: str
    options: QuantityOptions


class PointResult(NamedTuple):
    """The result at a point.

    Attributes:
        point: Index of the point.
        values: Quantities by name; None if the point was refused.
        reason: Why it was refused; "" if it was not.
        device: Device on which it ran; "" if it was given up.
        worker: Versions and processor that it ran with; empty if it was given up.
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


def run_point(point: Point) -> PointResult:
    """Run a point, whose number the caller fills in."""
    with TemporaryDirectory() as folder:
        scene, name = point.scene, point.options.device or "auto"
        if isinstance(scene, SceneSpec):
            scene, name = scene.scene_in(folder), worker_device(name)
        device = find_device(name)
        values, reason = None, ""
        try:
            options = QuantityOptions(device.alias, point.options.path, point.options.count)
            values = QUANTITIES[point.what].compute(with_numbers(scene, point.numbers), options)
        except SceneError as error:
            reason = str(error)
        return PointResult(-1, values, reason, device.alias, worker_identity(device))


def run_here(begun: Sweep, points: Sequence[int]) -> Iterator[PointResult]:
    """Yield one point after the other, run in this process; a point that runs out of memory is given up.

    Points whose kernels have the same compile key share them.
    """
    for number, point in zip(points, _points(begun, points, begun.scene, begun.device), strict=True):
        try:
            yield run_task(run_point, point)._replace(point=number)
        except MemoryError as error:
            yield PointResult(number, None, f"given up: {error}")


def run_on_pool(begun: Sweep, points: Sequence[int], pool: WorkerPool) -> Iterator[PointResult]:
    """Yield points in the order in which a pool's workers finish them; one that fails in all attempts is given up.

    The quantities are those of one process to the last bit if the workers have its kind of processor.
    """
    expected: Mapping[str, str] = {"warp_plate": warp_plate.__version__, "warp": wp.config.version}
    arguments = _points(begun, points, SceneSpec.of(begun.scene), pool.device)
    tasks = [Task(run_point, point, number) for number, point in zip(points, arguments, strict=True)]
    for task, outcome in run_tasks(pool, tasks):
        if outcome.failure:
            yield PointResult(task.key, None, outcome.failure)
            continue
        result: PointResult = outcome.value
        refuse_unlike(expected, result.worker)
        expected = result.worker
        yield result._replace(point=task.key)


def _points(begun: Sweep, points: Sequence[int], scene: Scene | SceneSpec, device: str) -> Iterator[Point]:
    options = QuantityOptions(device, begun.path, begun.count)
    return (Point(scene, begun.plan.numbers(number), begun.what, options) for number in points)
