"""Energies of batches of plates, from a solver of this process or from a pool's workers."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

import warp_plate
from warp_plate.cluster.blocks import Blocks, cut, halves, plates_of_block, put
from warp_plate.cluster.pool import Pool, Task
from warp_plate.cluster.scheduler import ATTEMPTS, spread
from warp_plate.cluster.solver_spec import Recipe, recipe_of
from warp_plate.cluster.tasks import run_block
from warp_plate.plate.designs import Batch, Designs, Shorthand, as_phasors, check_designs
from warp_plate.plate.discretization import Discretization
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver

# Durations of this many blocks are remembered.
REMEMBERED = 64

# Called with plates that are done and their energies (plates, regions).
OnBlock = Callable[[slice, np.ndarray], object]


@dataclass(frozen=True)
class Evaluation:
    """Energies of a batch.

    Attributes:
        energy: (plates, regions) as in ``Run``; NaN for a plate that failed.
        node_steps: Nodes updated × steps × plates.
        faults: For each plate that failed, the reason and the time at which it grew without bound [s] or NaN.
    """

    energy: np.ndarray
    node_steps: int
    faults: Mapping[int, tuple[str, float]]


class Evaluator:
    """Energies of plates of one scene, from its solver in this process or from a pool's workers.

    Both give the same bits where the workers have this machine's kind of processor.

    Attributes:
        solver: The solver of this process, which also keeps displacements and traces of few plates.
        pool: The workers that run batches; None if this process does.
        lost: Plates without energies because their block failed for good, counted by the reason.
    """

    def __init__(self, solver: PlateSolver, pool: Pool | None = None, recipe: Recipe | None = None) -> None:
        self.solver = solver
        self.pool = pool
        self.lost: Counter[str] = Counter()
        self._recipe = recipe
        self._node_steps = 0
        self._made: dict[str, str] = {}
        self._taken: deque[float] = deque(maxlen=REMEMBERED)

    @property
    def node_steps(self) -> int:
        """Nodes updated × steps × plates of all runs, the solver's own among them."""
        return self.solver.node_steps + self._node_steps

    @property
    def compile_seconds(self) -> float:
        """Seconds that compiling the solver took."""
        return self.solver.compile_seconds

    def run(self, designs: np.ndarray | Batch, on_block: OnBlock | None = None) -> Evaluation:
        """Return the energies of a batch.

        Args:
            designs: Phasors (plates, actuators), or designs as for :meth:`PlateSolver.run`.
            on_block: Called for some plates after others, as soon as their energies are known.

        Raises:
            SceneError: The designs are refused, or workers are of different kinds or versions.
            WorkersGone: No worker is left.
        """
        if self.pool is None:
            run = self.solver.run(designs)
            if on_block is not None:
                on_block(slice(0, len(run.energy)), run.energy)
            return Evaluation(run.energy, run.node_steps, run.faults)
        return self._run_blocks(self.pool, designs, on_block)

    def _run_blocks(self, pool: Pool, drives: np.ndarray | Batch, on_block: OnBlock | None) -> Evaluation:
        assert self._recipe is not None
        solver = self.solver
        batch = drives if isinstance(drives, Batch) else Designs(as_phasors(drives, len(solver.scene.actuators)))
        if isinstance(batch, Designs):  # checked here: a worker would name a plate by its number in the block
            check_designs(batch, solver.scene, solver.discretization.per_plate, solver.specialized.scheme.time_step)
        plates, regions = len(batch), solver.specialized.regions
        energy, node_steps = np.empty((plates, len(regions))), 0
        faults: dict[int, tuple[str, float]] = {}
        if not self._made:
            self._ask(pool)
        short = isinstance(batch, Shorthand) and batch.scene is solver.scene
        sizes = plates_of_block(solver.node_steps_per_plate, self._made["kind"])
        blocks = Blocks(batch, cut(plates, *sizes), self._recipe.digest, short)
        for task, answer in spread(pool, blocks, halves, self._with_recipe, self._taken):
            if answer.fault == "wrong":
                raise SceneError(answer.text)
            if answer.fault:
                why, places = self._failed(answer.fault, answer.text), range(task.place.start, task.place.stop)
                faults |= dict.fromkeys(places, (why, math.nan))
                self.lost[why] += len(places)
                energy[task.place] = np.nan
            else:
                self._same(answer.value["made"])
                put(answer.value, task.place, energy, faults)
                node_steps += answer.value["node_steps"]
            if on_block is not None:
                on_block(task.place, energy[task.place])
        self._node_steps += node_steps
        return Evaluation(energy, node_steps, faults)

    def _ask(self, pool: Pool) -> None:
        """Let one worker make the solver, which compiles its kernels once for all of a machine, and say what it is."""
        assert self._recipe is not None
        nothing = np.zeros((0, len(self.solver.scene.actuators)), dtype=complex)
        task = Task(run_block, {"digest": self._recipe.digest, "drives": nothing})
        for _, answer in spread(pool, [task], again=self._with_recipe):
            if answer.fault:
                why = answer.text if answer.fault == "wrong" else self._failed(answer.fault, answer.text)
                raise SceneError(f"a worker: {why}")
            self._same(answer.value["made"])

    def _with_recipe(self, task: Task, value: Mapping[str, Any]) -> Task | None:
        """The task with the recipe, for a worker that asked for it."""
        if "need" not in value:
            return None
        assert self._recipe is not None
        return replace(task, payload={**task.payload, "recipe": self._recipe.plain})

    def _same(self, made: Mapping[str, str]) -> None:
        here = {"warp_plate": warp_plate.__version__, "warp": wp.config.version, **self._made}
        for name in ("warp_plate", "warp", "kind"):
            if made[name] != here.get(name, made[name]):
                raise SceneError(
                    f"workers: {name} is {made[name]} on one and {here[name]} on another or here, which rounds in "
                    "another way; make them alike, or name one device for all by --device"
                )
        self._made = self._made or dict(made)

    def _failed(self, fault: str, text: str) -> str:
        return f"block given up: {text}" if fault == "memory" else f"block given up after {ATTEMPTS} attempts: {text}"


def make_evaluator(
    scene: Scene | Discretization,
    device: str = "auto",
    path: str = "auto",
    pool: Pool | None = None,
    **options: Any,
) -> Evaluator:
    """Return the evaluator of a scene; the options are those of :class:`PlateSolver` (areas, memory_share, ...).

    Args:
        scene: A scene with a grid, or its discretization.
        device: Device of the solver in this process; workers have ``pool.device``.
        path: See :class:`PlateSolver`.
        pool: Workers that run batches (default: this process does).

    Raises:
        SceneError: See :class:`PlateSolver`.
    """
    solver = PlateSolver(scene, device, path, **options)
    return Evaluator(solver, pool, None if pool is None else recipe_of(solver.scene, pool.device, path, **options))
