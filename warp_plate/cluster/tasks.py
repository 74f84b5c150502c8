"""What a worker does, whoever started it: a task by its function's name, and blocks of plates."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np
import warp as wp

import warp_plate
from warp_plate.cluster.solver_spec import Recipe, make_solver
from warp_plate.plate.designs import Batch, Designs
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import processor_of
from warp_plate.solve.solver import PlateSolver

MakersByName = dict[str, Callable[[np.ndarray], Batch]]
# Of the recipes met last: the scenarios of a robust search take one each.
MOST_SOLVERS = 128
# How Warp's word for want of memory begins; it has no kind of error of its own for it.
NO_MEMORY = "Failed to allocate"
_SOLVERS: OrderedDict[str, tuple[PlateSolver, MakersByName]] = OrderedDict()


def begin(name: str, payload: Mapping[str, Any], caught: bool = False) -> Callable[[], dict[str, Any]]:
    """Begin a task, "module:function" by its name; what is returned waits for its end, and gives the fields of the
    ``pool.Answer``. A task's function may leave a part of its work to a function that it returns.

    caught: what no task should raise is an answer too, which a worker can send; left out: it is raised.
    """
    fields = _answer(lambda: _function(name)(payload), caught)
    rest = fields.get("value")
    return (lambda: _answer(rest, caught)) if callable(rest) else (lambda: fields)


def gpu_end() -> Callable[[], object] | None:
    """What waits, in any thread, until this process's GPU is done with all that was begun; None where it is done, or
    where it failed, which the ends of tasks say."""
    solver, _ = next(reversed(_SOLVERS.values()), (None, None))
    if solver is None or not solver.device.is_cuda or wp.get_stream(solver.device).is_complete:
        return None
    device = solver.device
    try:
        event = wp.get_stream(device).record_event()
    except RuntimeError:
        return None

    def wait() -> None:
        device.make_current()  # for this thread
        wp.synchronize_event(event)

    return wait


def perform(name: str, payload: Mapping[str, Any], caught: bool = False) -> dict[str, Any]:
    """Do a task to its end; see ``begin``."""
    return begin(name, payload, caught)()


def _answer(step: Callable[[], Any], caught: bool) -> dict[str, Any]:
    try:
        return {"value": step()}
    except SceneError as error:
        return {"fault": "wrong", "text": str(error)}
    except Exception as error:
        if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and str(error).startswith(NO_MEMORY)):
            _SOLVERS.clear()  # what they hold may be what is wanting
            return {"fault": "memory", "text": f"out of memory ({' '.join(str(error).split())})"}
        if not caught:
            raise
        return of_error(error)


def of_error(error: BaseException) -> dict[str, Any]:
    """The answer for what no task should raise, for which its worker may be to blame."""
    if isinstance(error, ImportError):
        return {
            "fault": "wrong",
            "text": f"a worker cannot import {error.name}: install the same warp-plate on every worker",
        }
    return {"fault": "lost", "text": f"{type(error).__name__}: {str(error).strip()}".partition("\n")[0]}


def batch_in(payload: Mapping[str, Any], scene: Scene, makers: MakersByName) -> Batch:
    """What ``run_block`` is given; makers: of that scene, those met before."""
    if "maker" in payload:
        name = payload["maker"]
        if name not in makers:
            makers[name] = _function(name)(scene)
        return makers[name](payload["numbers"])
    return Designs(payload["drives"], *(payload.get(name) for name in ("frequency", "centre", "delay")))


def _function(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found


def run_block(payload: Mapping[str, Any]) -> Mapping[str, Any] | Callable[[], Mapping[str, Any]]:
    """Plates of one recipe, which a GPU begins at once.

    payload: "digest" of the recipe; "recipe", itself as plain data, where this worker may not know it; "drives" and,
    where plates have them of their own, "frequency", "centre" and "delay" as in :class:`Designs`; or "numbers" and
    "maker" as in :class:`Shorthand`.

    Returns {"need": digest} where the recipe is not known here; else what waits for and then gives "energy" (plates,
    regions), "node_steps", "made", which says on what, and "faults": of each plate that went wrong its place, what it
    was, and when.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    digest = payload["digest"]
    known = _SOLVERS.pop(digest, None)
    if known is None:
        if "recipe" not in payload:
            return {"need": digest}
        known = make_solver(Recipe.from_plain(payload["recipe"])), {}
    _SOLVERS[digest] = known
    while len(_SOLVERS) > MOST_SOLVERS:
        _SOLVERS.popitem(last=False)
    solver, makers = known
    begun = solver.begin(batch_in(payload, solver.scene, makers))
    made = {
        "kind": "cuda" if solver.device.is_cuda else "cpu",
        "processor": processor_of(solver.device),
        "warp_plate": warp_plate.__version__,
        "warp": wp.config.version,
    }

    def rest() -> dict[str, Any]:
        run = begun()
        faults = [[plate, *fault] for plate, fault in run.faults.items()]
        return {"energy": run.energy, "node_steps": run.node_steps, "faults": faults, "made": made}

    return rest
