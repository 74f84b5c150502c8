"""Energies of batches of plates, from a solver of this process or from a pool's workers."""

import math
from collections import Counter
from typing import Any

import numpy as np
import warp as wp

from warp_plate._version import __version__
from warp_plate.cluster.pool import Task, WorkerPool, run_tasks
from warp_plate.cluster.tasks import Evaluation, SolverSpec, refuse_unlike, run_block
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import Designs, as_phasors, check_designs
from warp_plate.plate.scheme import Discretization
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver

# The plates of a block are a multiple of this: whole groups of the CPU's lanes and of a GPU's warps.
BLOCK_MULTIPLE = 64


class Evaluator:
    """Energies of plates of one scene, from its solver in this process or from a pool's workers.

    Both give the same bits if the workers have this machine's kind of processor.
    """

    def __init__(
        self, solver: PlateSolver | ModalSolver, pool: WorkerPool | None = None, spec: SolverSpec | None = None
    ) -> None:
        self.solver = solver  # of this process, which also keeps displacements and traces of few plates
        self.pool = pool  # the workers that run batches; None if this process does
        self.lost: Counter[str] = Counter()  # plates without energies because their block was given up, by the reason
        self._spec = spec
        self._worker_node_steps = 0
        self._worker: dict[str, str] = {}

    @property
    def node_steps(self) -> int:
        """Nodes updated × steps × plates of all runs so far, here and on workers."""
        return self.solver.node_steps + self._worker_node_steps

    @property
    def compile_seconds(self) -> float:
        """Time that compiling the solver of this process took [s]."""
        return self.solver.compile_seconds

    def run(self, designs: np.ndarray | Designs) -> Evaluation:
        """Return the energies of a batch: of phasors (plates, actuators), or designs as for :meth:`PlateSolver.run`.

        Raises:
            SceneError: The designs are refused, or workers are of different kinds or versions.
            WorkersGone: No worker is left.
        """
        solver = self.solver
        if self.pool is None:
            run = solver.run(designs)
            return Evaluation(run.energy, run.node_steps, run.faults)
        if not isinstance(designs, Designs):
            designs = Designs(as_phasors(designs, len(solver.scene.actuators)))
        # Checked here: a worker would name a plate by its number in the block.
        grid = solver.discretization
        if not designs.only_drives:
            check_designs(designs, solver.scene, grid.per_plate, grid.time_step)
        return self._run_blocks(self.pool, designs)

    def _run_blocks(self, pool: WorkerPool, designs: Designs) -> Evaluation:
        if not self._worker:
            self._probe(pool)
        plates = len(designs)
        energy = np.full((plates, len(self.solver.regions)), np.nan)
        faults: dict[int, tuple[str, float]] = {}
        node_steps = 0
        work = pool.block_node_steps[self._worker["kind"]]
        size = block_size(plates, pool.worker_count(), self.solver.node_steps_per_plate, work)
        slices = [slice(first, min(first + size, plates)) for first in range(0, plates, size)]
        tasks = [Task(run_block, (self._spec, designs[some]), some) for some in slices]
        for task, outcome in run_tasks(pool, tasks):
            some = task.key
            if outcome.failure:
                fault = f"block {outcome.failure}"
                faults |= dict.fromkeys(range(some.start, some.stop), (fault, math.nan))
                self.lost[fault] += some.stop - some.start
                continue
            block, worker = outcome.value
            refuse_unlike(self._worker, worker)
            energy[some] = block.energy
            faults |= {some.start + plate: fault for plate, fault in block.faults.items()}
            node_steps += block.node_steps
        self._worker_node_steps += node_steps
        return Evaluation(energy, node_steps, faults)

    def _probe(self, pool: WorkerPool) -> None:
        """Let one worker build the solver, which compiles kernels once per machine, and return its description."""
        nothing = Designs(np.zeros((0, len(self.solver.scene.actuators)), dtype=complex))
        for _, outcome in run_tasks(pool, [Task(run_block, (self._spec, nothing))]):
            if outcome.failure:
                raise SceneError(f"a worker: {outcome.failure}")
            _, worker = outcome.value
            refuse_unlike({"warp_plate": __version__, "warp": wp.config.version}, worker)
            self._worker = {name: worker[name] for name in ("kind", "warp_plate", "warp")}


def make_evaluator(
    scene: Scene | Discretization,
    device: str = "auto",
    path: str = "auto",
    pool: WorkerPool | None = None,
    **options: Any,
) -> Evaluator:
    """Return the evaluator of a scene by time steps; see :class:`PlateSolver` for the options and errors.

    ``device`` is that of the solver in this process; the workers of a ``pool``, which run batches, have their own.
    """
    solver = PlateSolver(scene, device, path, **options)
    if pool is None:
        return Evaluator(solver)
    options["per_plate"] = solver.discretization.per_plate
    return Evaluator(solver, pool, SolverSpec.of(solver.scene, pool.device, path, **options))


def block_size(plates: int, workers: int, node_steps_per_plate: int, work: tuple[float, float]) -> int:
    """Return how many plates a block has: two blocks for each worker, or more where these were too large.

    ``work``: the least and the most node-steps of a block.
    """
    least, most = (max(1, int(node_steps / node_steps_per_plate)) for node_steps in work)
    blocks_per_worker = max(2, math.ceil(plates / (workers * most)))
    size = max(least, math.ceil(plates / (workers * blocks_per_worker)))
    return BLOCK_MULTIPLE * math.ceil(size / BLOCK_MULTIPLE)
