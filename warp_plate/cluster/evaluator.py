"""Energies of batches of plates, from a solver of this process or from a pool's workers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

import warp_plate
from warp_plate.cluster.pool import WorkerPool
from warp_plate.cluster.scheduler import Task, run_tasks
from warp_plate.cluster.solver_spec import SolverSpec, solver_spec
from warp_plate.cluster.tasks import Block, BlockEnergies, refuse_unlike, run_block
from warp_plate.plate.designs import Designs, as_phasors, check_designs
from warp_plate.plate.discretization import Discretization
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver

# Work in a block: a tenth of a second of a core, and what keeps a GPU busy. It sets how many plates a block has,
# which never depends on the number of workers. (An H200 runs 2112 plates of the paper's scene side by side.)
BLOCK_NODE_STEPS = {"cpu": 8e8, "cuda": 6.6e9}
# The plates of a block are a multiple of this: whole groups of the CPU's lanes and of a GPU's warps.
BLOCK_MULTIPLE = 64

# Called with plates that are done and their energies (plates, regions) [J].
OnBlock = Callable[[slice, np.ndarray], object]


@dataclass(frozen=True)
class Evaluation:
    """Energies of a batch.

    Attributes:
        energy: (plates, regions) as in ``Run``; NaN for a plate that failed.
        node_steps: Nodes updated × steps × plates.
        faults: Reason and time of detection [s] (NaN if unknown) of each plate that failed, by its number.
    """

    energy: np.ndarray
    node_steps: int
    faults: Mapping[int, tuple[str, float]]


class Evaluator:
    """Energies of plates of one scene, from its solver in this process or from a pool's workers.

    Both give the same bits if the workers have this machine's kind of processor.

    Attributes:
        solver: The solver of this process, which also keeps displacements and traces of few plates.
        pool: The workers that run batches; None if this process does.
        lost: Number of plates without energies because their block was given up, by the reason.
    """

    def __init__(self, solver: PlateSolver, pool: WorkerPool | None = None, spec: SolverSpec | None = None) -> None:
        self.solver = solver
        self.pool = pool
        self.lost: Counter[str] = Counter()
        self._spec = spec
        self._worker_node_steps = 0
        self._worker: dict[str, str] = {}

    @property
    def node_steps(self) -> int:
        """Nodes updated × steps × plates of all runs so far, here and on workers."""
        return self.solver.node_steps + self._worker_node_steps

    @property
    def compile_seconds(self) -> float:
        """Seconds that compiling the solver of this process took."""
        return self.solver.compile_seconds

    def run(self, designs: np.ndarray | Designs, on_block: OnBlock | None = None) -> Evaluation:
        """Return the energies of a batch.

        Args:
            designs: Phasors (plates, actuators), or designs as for :meth:`PlateSolver.run`.
            on_block: Called for some plates after others, as soon as their energies are known.

        Raises:
            SceneError: The designs are refused, or workers are of different kinds or versions.
            WorkersGone: No worker is left.
        """
        solver = self.solver
        if self.pool is None:
            run = solver.run(designs)
            if on_block is not None:
                on_block(slice(0, len(run.energy)), run.energy)
            return Evaluation(run.energy, run.node_steps, run.faults)
        grid, actuators = solver.discretization, len(solver.scene.actuators)
        designs = designs if isinstance(designs, Designs) else Designs(as_phasors(designs, actuators))
        # Checked here: a worker would name a plate by its number in the block.
        check_designs(designs, solver.scene, grid.per_plate, grid.scheme.time_step)
        return self._run_blocks(self.pool, designs, on_block)

    def _run_blocks(self, pool: WorkerPool, designs: Designs, on_block: OnBlock | None) -> Evaluation:
        assert self._spec is not None
        if not self._worker:
            self._probe(pool)
        plates = len(designs)
        energy = np.full((plates, len(self.solver.specialized.regions)), np.nan)
        faults: dict[int, tuple[str, float]] = {}
        node_steps, size = 0, block_size(self.solver.node_steps_per_plate, self._worker["kind"])
        slices = [slice(first, min(first + size, plates)) for first in range(0, plates, size)]
        tasks = [Task(run_block, Block(self._spec, designs[some]), some) for some in slices]
        for task, outcome in run_tasks(pool, tasks, halves_of_block):
            some = task.key
            if outcome.failure:
                fault = f"block {outcome.failure}"
                faults |= dict.fromkeys(range(some.start, some.stop), (fault, math.nan))
                self.lost[fault] += some.stop - some.start
            else:
                found: BlockEnergies = outcome.value
                refuse_unlike(self._worker, found.worker)
                energy[some] = found.energy
                faults |= {some.start + plate: fault for plate, fault in found.faults.items()}
                node_steps += found.node_steps
            if on_block is not None:
                on_block(some, energy[some])
        self._worker_node_steps += node_steps
        return Evaluation(energy, node_steps, faults)

    def _probe(self, pool: WorkerPool) -> None:
        """Let one worker make the solver, which compiles kernels once for all of a machine, and learn what it is."""
        assert self._spec is not None
        nothing = Designs(np.zeros((0, len(self.solver.scene.actuators)), dtype=complex))
        for _, outcome in run_tasks(pool, [Task(run_block, Block(self._spec, nothing))]):
            if outcome.failure:
                raise SceneError(f"a worker: {outcome.failure}")
            worker = outcome.value.worker
            refuse_unlike({"warp_plate": warp_plate.__version__, "warp": wp.config.version}, worker)
            self._worker = {name: worker[name] for name in ("kind", "warp_plate", "warp")}


def make_evaluator(
    scene: Scene | Discretization,
    device: str = "auto",
    path: str = "auto",
    pool: WorkerPool | None = None,
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
    return Evaluator(solver, pool, None if pool is None else solver_spec(solver.scene, pool.device, path, **options))


def block_size(node_steps_per_plate: int, kind: str) -> int:
    """Return how many plates a block has on a device of this kind, "cpu" or "cuda"."""
    return BLOCK_MULTIPLE * max(1, int(BLOCK_NODE_STEPS[kind] / (node_steps_per_plate * BLOCK_MULTIPLE)))


def halves_of_block(task: Task) -> list[Task]:
    """Return the task as two of half as many plates; none if it has but one."""
    block, some = task.argument, task.key
    count = (some.stop - some.start) // 2
    if count == 0:
        return []
    first, second = block.designs[:count], block.designs[count:]
    middle = some.start + count
    return [
        Task(run_block, replace(block, designs=first), slice(some.start, middle)),
        Task(run_block, replace(block, designs=second), slice(middle, some.stop)),
    ]
