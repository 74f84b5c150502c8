"""A solver whose plates are run by a pool's workers."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

import warp_plate
from warp_plate.cluster.blocks import Blocks, cut, halves, plates_of_block, put
from warp_plate.cluster.pool import Pool, Task
from warp_plate.cluster.scheduler import ATTEMPTS, spread
from warp_plate.cluster.solver_spec import recipe_of
from warp_plate.cluster.tasks import run_block
from warp_plate.plate.designs import NO_PER_PLATE, Batch, Designs, PerPlate, Shorthand, as_phasors
from warp_plate.plate.weights import NO_AREAS, Region
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.run import Run
from warp_plate.solve.solver import Each, PlateSolver, Progress
from warp_plate.solve.specialize import Quantity

# So many of the last blocks say how long one takes.
REMEMBERED = 64


def solver_on(pool: Pool | None, scene: Scene, device: str = "auto", path: str = "auto", **options: Any) -> PlateSolver:
    """A solver of this process, or where there is a pool one that runs its plates there; see :class:`PlateSolver`."""
    if pool is None:
        return PlateSolver(scene, device, path, **options)
    return SpreadSolver(pool, scene, device, path, **options)


class SpreadSolver(PlateSolver):
    """A :class:`PlateSolver` whose energies come from a pool, and displacements and traces, of few plates, from here.

    device: of what runs here; workers have ``pool.device``.

    Energies are those of one process to the last bit, where workers are of one kind of processor. lost: plates without
    energies because their block failed for good, by what went wrong; their faults say the same.

    Raises:
        SceneError: see :class:`PlateSolver`; a worker cannot make the solver.
    """

    def __init__(
        self,
        pool: Pool,
        scene: Scene,
        device: str = "auto",
        path: str = "auto",
        areas: Mapping[str, Region] = NO_AREAS,
        per_plate: PerPlate = NO_PER_PLATE,
        quantity: Quantity = "velocity",
        share: float = 1.0,
    ) -> None:
        super().__init__(scene, device, path, areas=areas, per_plate=per_plate, quantity=quantity, share=share)
        self.pool = pool
        self.lost: Counter[str] = Counter()
        self._recipe = recipe_of(scene, pool.device, path, areas, per_plate, quantity, share)
        self._made: dict[str, str] = {}
        self._taken: deque[float] = deque(maxlen=REMEMBERED)

    def run(
        self,
        drives: np.ndarray | Sequence[Sequence[complex]] | tuple[np.ndarray, np.ndarray] | Batch,
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
        each: Each | None = None,
    ) -> Run:
        """See :meth:`PlateSolver.run`.

        Raises:
            SceneError: also where workers are of different kinds or versions. WorkersGone: see there.
        """
        if len(times) or len(points):
            return super().run(drives, times, points, progress, each)
        batch = drives if isinstance(drives, Batch) else Designs(as_phasors(drives, len(self.scene.actuators)))
        if isinstance(batch, Designs):
            self._checked(batch)  # a worker would name a plate by its number in the block
        plates, regions = len(batch), self.specialized.regions
        energy, node_steps = np.empty((plates, len(regions))), 0
        faults: dict[int, tuple[str, float]] = {}
        if not self._made:
            self._ask()
        short = isinstance(batch, Shorthand) and batch.scene is self.scene
        sizes = plates_of_block(self.node_steps_per_plate, self._made["kind"])
        blocks = Blocks(batch, cut(plates, *sizes), self._recipe.digest, short)
        for task, answer in spread(self.pool, blocks, halves, self._with_recipe, self._taken):
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
            if each is not None:
                each(task.place, energy[task.place])
            if progress is not None:
                progress(node_steps, plates * self.node_steps_per_plate)
        self.node_steps += node_steps
        return Run(
            energy=energy,
            regions=regions,
            masses=self.specialized.masses,
            displacement=np.empty((plates, 0, *self.scene.grid.nodes[::-1])),
            times=np.empty(0),
            trace=np.empty((plates, 0, self.specialized.scheme.steps)),
            trace_times=np.empty(0),
            node_steps=node_steps,
            faults=faults,
        )

    def _ask(self) -> None:
        """Let one worker make the solver, which compiles its kernels once for all of a machine, and say what it is."""
        nothing = np.zeros((0, len(self.scene.actuators)), dtype=complex)
        task = Task(run_block, {"digest": self._recipe.digest, "drives": nothing})
        for _, answer in spread(self.pool, [task], again=self._with_recipe):
            if answer.fault:
                why = answer.text if answer.fault == "wrong" else self._failed(answer.fault, answer.text)
                raise SceneError(f"a worker: {why}")
            self._same(answer.value["made"])

    def _with_recipe(self, task: Task, value: Mapping[str, Any]) -> Task | None:
        """The task with the recipe, for a worker that asked for it."""
        if "need" not in value:
            return None
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
