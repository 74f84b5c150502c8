"""What a worker does, whoever started it: a task by its function's name, and blocks of plates."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import warp as wp

import warp_plate
from warp_plate.cluster.recipe import Recipe, make_solver
from warp_plate.plate.designs import Designs
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import processor_of
from warp_plate.solve.solver import PlateSolver

# Of the recipes met last: the scenarios of a robust search take one each.
MOST_SOLVERS = 128
# How Warp's word for want of memory begins; it has no kind of error of its own for it.
NO_MEMORY = "Failed to allocate"
_SOLVERS: OrderedDict[str, PlateSolver] = OrderedDict()


def perform(name: str, payload: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of the ``pool.Answer`` of a task, "module:function" by its name."""
    module, _, function = name.partition(":")
    try:
        return {"value": getattr(import_module(module), function)(payload)}
    except SceneError as error:
        return {"fault": "wrong", "text": str(error)}
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not str(error).startswith(NO_MEMORY):
            raise
        _SOLVERS.clear()  # what they hold may be what is wanting
        return {"fault": "memory", "text": f"out of memory ({' '.join(str(error).split())})"}


def designs_in(payload: Mapping[str, Any]) -> Designs:
    """What ``run_block`` is given."""
    return Designs(payload["drives"], *(payload.get(name) for name in ("frequency", "centre", "delay")))


def run_block(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Plates of one recipe.

    payload: "digest" of the recipe; "recipe", itself as plain data, where this worker may not know it; "drives" and,
    where plates have them of their own, "frequency", "centre" and "delay" as in :class:`Designs`.

    Returns {"need": digest} where the recipe is not known here; else "energy" (plates, regions), "node_steps", "made",
    which says on what, and "faults": of each plate that went wrong its place, what it was, and when.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    digest = payload["digest"]
    solver = _SOLVERS.pop(digest, None)
    if solver is None:
        if "recipe" not in payload:
            return {"need": digest}
        solver = make_solver(Recipe.from_plain(payload["recipe"]))
    _SOLVERS[digest] = solver
    while len(_SOLVERS) > MOST_SOLVERS:
        _SOLVERS.popitem(last=False)
    run = solver.run(designs_in(payload))
    return {
        "energy": run.energy,
        "node_steps": run.node_steps,
        "faults": [[plate, *fault] for plate, fault in run.faults.items()],
        "made": {
            "kind": "cuda" if solver.device.is_cuda else "cpu",
            "processor": processor_of(solver.device),
            "warp_plate": warp_plate.__version__,
            "warp": wp.config.version,
        },
    }
