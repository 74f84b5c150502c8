"""The functions that workers run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

import warp_plate
from warp_plate.cluster.solver_spec import SolverSpec, make_solver
from warp_plate.plate.designs import Designs
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import processor_of

# Beginning of the message of the RuntimeError that Warp raises when an allocation fails.
WARP_OUT_OF_MEMORY = "Failed to allocate"


@dataclass(frozen=True)
class Block:
    """Some plates of a batch.

    Attributes:
        spec: How to make their solver.
        designs: Their designs.
    """

    spec: SolverSpec
    designs: Designs


@dataclass(frozen=True)
class BlockEnergies:
    """What a worker returns for a block.

    Attributes:
        energy: (plates, regions) as in ``Run``.
        node_steps: Nodes updated × steps × plates.
        faults: Reason and time [s] for each plate that failed, as in ``Run``.
        worker: What the bits depend on: "kind" of the device, and versions.
    """

    energy: np.ndarray
    node_steps: int
    faults: Mapping[int, tuple[str, float]]
    worker: Mapping[str, str]


def run_task(function: Callable[[Any], Any], argument: Any) -> Any:
    """Call a function on a worker.

    Raises:
        MemoryError: The worker has too little memory, on the host or on its device.
    """
    try:
        return function(argument)
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, MemoryError) or str(error).startswith(WARP_OUT_OF_MEMORY):
            make_solver.cache_clear()  # frees what other solvers hold
            raise MemoryError(f"out of memory ({' '.join(str(error).split())})") from None
        raise


def run_block(block: Block) -> BlockEnergies:
    """Run the plates of a block.

    Raises:
        SceneError: See :class:`PlateSolver`.
    """
    solver = make_solver(block.spec)
    run = solver.run(block.designs)
    worker = {"kind": "cuda" if solver.device.is_cuda else "cpu", **worker_identity(solver.device)}
    return BlockEnergies(run.energy, run.node_steps, dict(run.faults), worker)


def worker_identity(device: wp.Device) -> dict[str, str]:
    """Return the versions and the processor of this process, on which the last bits of a result depend."""
    return {
        "warp_plate": warp_plate.__version__,
        "warp": wp.config.version,
        "processor": processor_of(device),
    }


def refuse_unlike(expected: Mapping[str, str], worker: Mapping[str, str]) -> None:
    """Refuse a worker that rounds in another way than this process or other workers.

    Args:
        expected: Some entries of a ``worker_identity``, all of which must be equal.
        worker: That of the worker.

    Raises:
        SceneError: One line that names what differs.
    """
    for name, value in expected.items():
        if worker[name] != value:
            raise SceneError(
                f"workers: {name} is {worker[name]} on one and {value} on another or here, which rounds in another "
                "way; make them alike, or name one device for all by --device"
            )
