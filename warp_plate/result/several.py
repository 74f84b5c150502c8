"""What the searches for several targets found, one after the other, and how files keep it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import h5py

from warp_plate.result.model import TargetSearch, bound_kind
from warp_plate.result.safe_hdf5 import names_in
from warp_plate.result.search_state import put_state, read_state
from warp_plate.scene.errors import SceneError

GROUP = "searches"


def put_several(file: h5py.File, several: Sequence[TargetSearch]) -> None:
    """Write the searches, in the order of the scene's targets, as the groups /searches/0, /searches/1, ..."""
    for index, one in enumerate(several):
        state: dict[str, Any] = {f"history {name}": values for name, values in one.history.items()}
        state |= {f"value {name}": value for name, value in one.objective_values.items()}
        state |= {"single": one.single_actuator, "evaluations": one.evaluations}
        state |= {"bound": one.bound, "bound_kind": one.bound_kind}
        put_state(file, f"{GROUP}/{index}", state | ({} if one.position is None else {"position": one.position}))


def read_several(file: h5py.File) -> tuple[TargetSearch, ...]:
    """What :func:`put_several` wrote; nothing where nothing was.

    Raises:
        SceneError: it is damaged.
    """
    several = []
    for index in range(len(names_in(file, GROUP))):
        if str(index) not in file[GROUP]:
            raise SceneError(f"{GROUP}/{index} is missing")
        state = read_state(file, f"{GROUP}/{index}")
        several.append(
            TargetSearch(
                position=state.get("position"),
                single_actuator=int(state["single"]),
                bound=None if state["bound"] is None else float(state["bound"]),
                bound_kind=bound_kind(str(state.get("bound_kind", ""))),
                evaluations=int(state["evaluations"]),
                history=_under("history ", state),
                objective_values={name: float(value) for name, value in _under("value ", state).items()},
            )
        )
    return tuple(several)


def _under(prefix: str, state: dict[str, Any]) -> dict[str, Any]:
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
