"""One point of a sweep: here, or on a worker of a pool."""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import warp as wp

import warp_plate
from warp_plate.cluster.frames import encode
from warp_plate.cluster.pool import Answer, Pool, Task
from warp_plate.cluster.scheduler import spread
from warp_plate.cluster.solver_spec import DEVICE, contents_of, scene_in
from warp_plate.cluster.tasks import perform
from warp_plate.result.sweep import Sweep
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import with_numbers
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.quantities_of_interest import QUANTITIES, Options, Values

# That a worker keeps, with the files that they name.
MOST_SCENES = 4
_SCENES: OrderedDict[str, tuple[Scene, TemporaryDirectory[str]]] = OrderedDict()


class Found(NamedTuple):
    """What became of a point: its figures, or why it was refused; and on what, "" where it was given up."""

    point: int
    values: Values | None
    reason: str
    device: str = ""
    processor: str = ""


def run_point(payload: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of a scene with other numbers.

    payload: "scene", "numbers", "what", "device", "path", "count".

    Returns "values", None where the point is refused, "reason", "device", and "made", which says on what.

    Raises:
        SceneError: no such device.
    """
    device = find_device(payload["device"] or "auto")
    made = {"warp_plate": warp_plate.__version__, "warp": wp.config.version, "processor": processor_of(device)}
    options = Options(device.alias, payload["path"], payload["count"])
    values: Values | None = None
    reason = ""
    try:
        values = QUANTITIES[payload["what"]].of(with_numbers(payload["scene"], payload["numbers"]), options)
    except SceneError as error:
        reason = str(error)
    return {"values": values, "reason": reason, "device": device.alias, "made": made}


def run_here(begun: Sweep, points: Sequence[int]) -> Iterator[Found]:
    """One point after the other in this process, as a worker does them: one that runs out of memory is given up. Points
    whose kernels have the same compile key share them."""
    common = {**_common(begun), "scene": begun.scene, "device": begun.device}
    for point in points:
        payload = {**common, "numbers": begun.plan.numbers(point)}
        yield _found(point, Answer(**perform(f"{__name__}:run_point", payload)))


def run_there(begun: Sweep, points: Sequence[int], pool: Pool) -> Iterator[Found]:
    """Points on a pool's workers, in the order in which they are done; the figures are those of one process to the last
    bit, where workers are of its kind. A point whose workers end or have too little memory is refused after all
    attempts.

    Raises:
        SceneError: workers differ in kind or version from each other, or have no such device. WorkersGone: see there.
    """
    base = {"text": dump_scene(begun.scene), "files": contents_of(begun.scene)}
    digest = hashlib.sha256(b"".join(encode(base))).hexdigest()
    common = {**_common(begun), "digest": digest, "device": pool.device}

    def with_scene(task: Task, value: Mapping[str, Any]) -> Task | None:
        return replace(task, payload={**task.payload, "base": base}) if "need" in value else None

    tasks = [Task(run_task, {**common, "numbers": begun.plan.numbers(point)}, point) for point in points]
    first: Mapping[str, str] = {"warp_plate": warp_plate.__version__, "warp": wp.config.version}
    for task, answer in spread(pool, tasks, again=with_scene):
        if answer.fault == "wrong":
            raise SceneError(f"a worker: {answer.text}")
        found = _found(task.place, answer)
        made = answer.value.get("made", first)  # none where the point is given up
        for name, value in made.items():
            if value != first.get(name, value):
                raise SceneError(
                    f"workers: {name} is {value} on one and {first[name]} on another or here, which rounds in another "
                    "way; make them alike"
                )
        first = made
        yield found


def run_task(payload: Mapping[str, Any]) -> dict[str, Any]:
    """A point, on a worker.

    payload: "digest" of the scene; "base", itself as text and the files that it names, where this worker may not know
    it; "numbers", "what", "device", "path", "count".

    Returns {"need": digest} where the scene is not known here; else what ``run_point`` does.

    Raises:
        SceneError: no such device.
    """
    digest = payload["digest"]
    known = _SCENES.pop(digest, None)
    if known is None:
        if "base" not in payload:
            return {"need": digest}
        folder = TemporaryDirectory()
        known = scene_in(folder.name, payload["base"]["text"], payload["base"]["files"]), folder
    _SCENES[digest] = known
    while len(_SCENES) > MOST_SCENES:
        _SCENES.popitem(last=False)[1][1].cleanup()
    return run_point({**payload, "scene": known[0], "device": os.environ.get(DEVICE) or payload["device"]})


def _common(begun: Sweep) -> dict[str, Any]:
    """Of the payloads of all points."""
    return {"what": begun.what, "path": begun.path, "count": begun.count}


def _found(point: int, answer: Answer) -> Found:
    """Of an answer; a point that no attempt came to an end with is given up.

    Raises:
        SceneError: the answer is that the task is wrong.
    """
    if answer.fault == "wrong":
        raise SceneError(answer.text)
    if answer.fault:
        return Found(point, None, f"given up: {answer.text}")
    value = answer.value
    return Found(point, value["values"], value["reason"], value.get("device", ""), value["made"]["processor"])
