"""The way from a scene to what runs it: engine, grid and device are decided here once; nothing later changes them.

:func:`choose_engine` chooses between modes and time steps; :func:`resolve` also chooses a grid for a scene that asks
for an accuracy. Studies, problems and analyses take the :class:`Resolved` scene.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice, product
from typing import Any, Literal

import numpy as np

from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.configurations import configuration_of, longest_time_step, regrid, waves_along
from warp_plate.accuracy.reference_solution import MoreFunctions
from warp_plate.cluster.evaluator import Evaluator, make_evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.solver import MODAL, ModalGrid, ModalSolver
from warp_plate.plate.designs import NO_PER_PLATE, PerPlate
from warp_plate.plate.scheme import MOST_STEPS, STEPS_A_PERIOD, Discretization, discretize
from warp_plate.plate.signals import plate_harmonic
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import CELLS_A_WAVE, Grid
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import Plan
from warp_plate.solve.devices import find_device
from warp_plate.solve.solver import PlateSolver

Engine = Literal["modes", "steps"]
EvaluatorName = Literal["direct", "response", "modal"]
# What a scene is resolved for.
#   simulate: a single run
#   search: a search by an optimizer
#   exact: a search solved as an eigenvalue problem, when the scene names no method
#   survey: many scenes or drives
#   check: the properties of a scene, without a run
#   replay: the run of a result, or the effects of a scene, once more
Purpose = Literal["simulate", "search", "exact", "survey", "check", "replay"]
# Largest number of corners of the ranges of a sweep among which the one with the shortest waves is sought.
MOST_CORNERS = 64


@dataclass(frozen=True, eq=False)
class Resolved:
    """A scene with all that its run needs."""

    scene: Scene  # Scene with a grid, in place of an accuracy
    engine: Engine  # "modes" or "steps"
    device: str  # Alias of the device
    path: str = "auto"  # Path of the kernels for time steps, as asked for
    evaluator: str | None = None  # How a search computes energies; None for the default of time steps
    # Accuracy asked for, expected error, and reason for the choice; empty if the scene has a grid
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)  # Time that the choice took, under "choose"
    reference: MoreFunctions | None = None  # Modes that were chosen, and more functions that they were compared with
    allow_unstable: bool = False  # True if a time step above the stability limit is accepted

    @property
    def by_modes(self) -> bool:
        """True if modes of the plate are taken, False for time steps."""
        return self.engine == "modes"

    @cached_property
    def grid(self) -> Discretization | ModalGrid:
        """The scene on its grid."""
        return self.grid_for(NO_PER_PLATE)

    def grid_for(self, per_plate: PerPlate) -> Discretization | ModalGrid:
        """Return the scene on its grid for plates that differ in more than their drives."""
        if self.by_modes:
            return ModalGrid(self.scene, per_plate)
        return discretize(self.scene, per_plate, self.allow_unstable)

    def solver(self, grid: Discretization | ModalGrid | None = None, **options: Any) -> PlateSolver | ModalSolver:
        """Return a solver on ``grid`` (default: the scene's); for options and errors see the solvers."""
        grid = self.grid if grid is None else grid
        if isinstance(grid, ModalGrid):
            options.pop("memory_share", None)
            return ModalSolver(grid, self.device, plate=self._modes_of(grid.scene), **options)
        return PlateSolver(grid, self.device, self.path, **options)

    def _modes_of(self, scene: Scene) -> ModalPlate | None:
        """Return the modes of a scene if the choice of the engine has solved for them."""
        taken = None if self.reference is None else self.reference.taken
        return taken if taken is not None and taken.scene == scene and scene.search.frequency is None else None

    def plates(self, grid: Discretization | ModalGrid, pool: WorkerPool | None = None, **options: Any) -> Evaluator:
        """Return the evaluator of a grid, whose time steps run on the workers of a pool; see :meth:`solver`."""
        if isinstance(grid, Discretization):
            return make_evaluator(grid, self.device, self.path, pool, **options)
        return Evaluator(self.solver(grid, **options))

    def with_scene(self, scene: Scene) -> Resolved:
        """Return another scene, which has a grid, resolved to the same engine and device."""
        return self if scene is self.scene else replace(self, scene=scene, reference=None)


def choose_engine(
    scene: Scene, purpose: Purpose, path: str = "auto", evaluator: str | None = None
) -> Literal["modes", "steps", "any"]:
    """Return the engine of a scene; "any": whichever keeps ``grid.accuracy`` at the least cost.

    ``path`` (of the kernels, or "modal") and ``evaluator`` (of a search or a sweep) are those that are asked for.
    """
    search = scene.search
    searched = search.frequency is not None or search.position is not None or search.delay is not None
    # Waveforms whose frequencies, places or delays are searched cost more by modes than on an ordinary grid.
    modes_pay = scene.linear and not (searched and scene.drive.waveform_key is not None)
    # 1. What is asked for.
    if MODAL in (path, evaluator):
        return "modes"
    if evaluator is not None:
        return "steps"
    # 2. Effects that have no time steps.
    if scene.modal_only_key is not None and (path == "auto" or purpose != "simulate"):
        return "modes"
    if path != "auto":
        return "steps"
    # 3. No grid. Next to an outline the errors of grids fall slowly, so that modes always cost less.
    anew = purpose not in ("survey", "replay")
    unwritten = scene.grid.model_fields_set <= {"accuracy", "modal_density"}
    if anew and unwritten and scene.linear and scene.outline is not None:
        return "modes"
    # 4. An accuracy.
    if anew and scene.grid.accuracy is not None:
        return "any" if modes_pay or purpose == "simulate" else "steps"
    # 5. A single run uses time steps. A search of places, frequencies or delays would have to run a plate for each of
    # them; modes run none for it, nor for exact searches and surveys.
    if purpose == "search":
        takes_modes = modes_pay and searched and search.robust is None
    else:
        takes_modes = modes_pay and purpose in ("exact", "survey")
    return "modes" if takes_modes else "steps"


def refuse_nonlinear_modes(scene: Scene) -> None:
    """Refuse to search a scene by modes that needs time steps, with a SceneError that names the key."""
    if not scene.linear:
        raise SceneError(f"evaluator = 'modal': {scene.nonlinear_table} needs time steps; write 'direct'")


def resolve(
    scene: Scene,
    device: str = "auto",
    *,
    purpose: Purpose = "search",
    path: str = "auto",
    evaluator: str | None = None,
    phasors: np.ndarray | None = None,
    allow_unstable: bool = False,
) -> Resolved:
    """Decide the engine, grid and device of a scene.

    For ``grid.accuracy``, the grid is chosen at the highest frequency that the scene's search may try. It is required
    where it is written; a scene without ``[grid]`` gets the best choice there is. ``path`` and ``evaluator`` are what
    is asked for, see :func:`choose_engine`. ``phasors`` (drives, actuators) are the drives whose errors are kept small
    (default: the usual ones).

    Raises:
        SceneError: There is no such device, or no engine keeps a required accuracy.
    """
    device = find_device(device).alias
    engine = choose_engine(scene, purpose, path, evaluator)
    if engine == "modes" and purpose in ("search", "exact"):
        refuse_nonlinear_modes(scene)
    if engine == "modes":
        evaluator = MODAL
    options: dict[str, Any] = {"device": device, "path": path, "allow_unstable": allow_unstable}
    asked = scene.grid.accuracy
    if asked is None:
        assert engine != "any"
        return Resolved(scene, engine, evaluator=evaluator, accuracy=_reason_of_waves(scene), **options)
    if engine == "steps":
        scene.check_stepped()
    started = time.perf_counter()
    for_search = purpose in ("search", "exact", "check") or (purpose == "survey" and engine == "modes")
    at_shortest_wave = at_highest_frequency(scene) if for_search else scene
    required = "grid" in scene.model_fields_set
    choice = choose(at_shortest_wave, asked, device, phasors, engine, required)
    grid = Grid(**choice.scene.grid.model_dump(exclude={"accuracy"}))
    chosen = choice.scene.model_copy(update={"grid": grid} | ({"actuators": scene.actuators} if for_search else {}))
    if for_search and not choice.by_modes and evaluator is None and scene.search.robust is None:
        evaluator = "direct"
    expected = choice.error if math.isfinite(choice.error) else None
    return Resolved(
        chosen,
        "modes" if choice.by_modes else "steps",
        evaluator=MODAL if choice.by_modes else evaluator,
        accuracy={"asked": asked, "expected": expected, "reason": choice.reason},
        seconds={"choose": time.perf_counter() - started},
        reference=choice.reference if isinstance(choice.reference, MoreFunctions) else None,
        **options,
    )


def at_highest_frequency(scene: Scene) -> Scene:
    """Return the scene with searched frequencies at the upper end of their range; SceneError: too many steps."""
    table = scene.search.frequency
    if table is None or scene.drive.signal is not None:  # ``make_design_variables`` refuses both together
        return scene
    most = MOST_STEPS / STEPS_A_PERIOD / scene.window.end / plate_harmonic(scene.drive)
    if scene.grid.time_step is None and table.range[1] > most:
        raise SceneError(
            f"search.frequency.range = {list(table.range)}: {table.range[1]:g} Hz takes "
            f"{MOST_STEPS * table.range[1] / most:.3g} steps until window.end = {scene.window.end:g} s, and at most "
            f"{MOST_STEPS:.3g} are possible; end the range at {most:.4g} Hz or lower"
        )
    named, actuators = table.actuators, [actuator.model_dump() for actuator in scene.actuators]
    for actuator in actuators:
        if named is None or actuator["name"] in named:
            actuator["frequency"] = table.range[1]
    return scene.with_tables(actuators=actuators)


def resolve_for_sweep(scene: Scene, plan: Plan, device: str, evaluator: str) -> Scene:
    """Choose the grid for all points of a sweep: at the corner of its ranges where bending waves are shortest.

    The scene is returned unchanged if the grid is varied, or if the accuracy cannot be reached at that corner; points
    then choose for themselves.
    """
    if scene.grid.accuracy is None or any(key.startswith("grid.") for key in plan.keys):
        return scene
    ends = [np.unique(values)[[0, -1]] if values.dtype.kind in "iuf" else np.unique(values)
            for values in plan.coordinates]  # fmt: skip
    corners = []
    for values in islice(product(*(end.tolist() for end in ends)), MOST_CORNERS):
        with suppress(SceneError):
            corners.append(at_highest_frequency(scene.with_values(dict(zip(plan.keys, values, strict=True)))))
    with suppress(SceneError, ValueError):  # refused, or without corners
        at_shortest_wave = max(corners, key=waves_along)
        chosen = resolve(at_shortest_wave, device, purpose="replay", evaluator=evaluator).scene
        if evaluator == MODAL:
            return scene.model_copy(update={"grid": chosen.grid})
        grid = configuration_of(chosen)  # stable at all corners
        step = min(longest_time_step(corner, grid.order, grid.nodes) for corner in corners)
        return regrid(scene, replace(grid, time_step=step))
    return scene


def _reason_of_waves(scene: Scene) -> dict[str, str]:
    """Return the reason for the grid of a scene that is not linear and has no ``[grid]``; empty for others."""
    if not scene.gridded_by_waves:
        return {}
    (nx, ny), table = scene.grid.nodes, scene.nonlinear_table
    reason = f"time steps: {nx} × {ny} nodes, {CELLS_A_WAVE:g} cells a bending wave; no error is known with {table}"
    return {"reason": reason}
