"""Runs of large batches: parts of the plates take turns on the memory of a device."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence, Set
from functools import partial
from itertools import cycle

import numpy as np
import warp as wp

from warp_plate.interrupts import check_interrupt
from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.weights import bilinear
from warp_plate.scene.errors import SceneError
from warp_plate.solve.batching import PlateBatch
from warp_plate.solve.device_batch import DeviceBatch
from warp_plate.solve.engine import Engine
from warp_plate.solve.run import Progress, Run
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State, bytes_per_plate
from warp_plate.solve.status import steps_between_checks

Faults = dict[int, tuple[str, float]]

# Approximate limit of the work of a launch, so that progress is shown and Ctrl-C is noticed.
SEGMENT_NODE_STEPS = {"cpu": 1e9, "cuda": 5e10}
# A part of a large batch on CUDA: eight times the 2112 plates of the paper's scene that an H200 runs side by side.
# While it is stepped, the host prepares the next one.
PART_NODE_STEPS = 1.32e10
# Largest share of a CUDA device's free memory that plates take; bytes that they take on CPU. A batch on CPU is also no
# larger than one launch can finish, or than FEWEST_PLATES if that is more.
CUDA_MEMORY_SHARE = 0.6
CPU_BYTES = 256 * 2**20
FEWEST_PLATES = 64


class PartRunner:
    """Runs of any number of plates, part by part.

    Attributes:
        engine: The compiled kernels.
        chunk: Number of plates of a part; None for as many as memory holds.
        memory_share: Share of the memory for plates to take.
        states: Device arrays that runs use, made by the first run.
    """

    def __init__(self, engine: Engine, chunk: int | None, memory_share: float) -> None:
        self.engine, self.chunk, self.memory_share = engine, chunk, memory_share
        self.states: list[State] = []

    @property
    def specialized(self) -> Specialized:
        """Compile key and device arrays."""
        return self.engine.specialized

    def run(
        self,
        run: Run,
        phasors: np.ndarray,
        values: PerPlateValues,
        snapshots: list[int],
        samples: Set[int],
        points: Sequence[tuple[float, float]],
        progress: Progress,
    ) -> None:
        """Step plates part by part, and write their energies, records and faults into ``run``.

        Displacements are kept at the steps ``snapshots``, and sampled for their peak at the steps ``samples``.

        Parts take turns on the states: while the device steps one, the host prepares the next.
        """
        plates, work = len(phasors), self.specialized.node_steps_per_plate
        corners, shares = np.empty((0, 4, 2), np.int32), np.empty((0, 4))
        if len(points):
            corners, shares = bilinear(points, self.specialized.scheme.nodes, self.specialized.scene.plate.size)
        states, size = self.states_for(plates, corners.reshape(-1, 2))
        queued: deque[tuple[slice, Callable[[np.ndarray], Faults]]] = deque()

        def report(before: int, done: int) -> None:
            progress(before + done, run.node_steps)

        def finish_oldest() -> None:
            part, finish_energies = queued.popleft()
            faults = finish_energies(run.energy[part])
            run.faults.update({part.start + plate: fault for plate, fault in faults.items()})
            report(part.stop * work, 0)

        for first, state in zip(range(0, plates, size), cycle(states), strict=False):
            part = slice(first, min(first + size, plates))
            if len(queued) == len(states):
                finish_oldest()
            whole = not (snapshots or samples or points) and self._takes_whole(values, part.stop - first)
            batch = PlateBatch(self.engine, state, phasors[part], values[part], whole)
            if whole:
                batch.run_whole()
            else:
                self._advance(batch, snapshots, run.displacement[part], samples, partial(report, first * work))
                if samples:
                    run.peak[part] = batch.peak if batch.step == self.specialized.scheme.steps else np.nan
            queued.append((part, batch.queue_energies()))
            if len(points):
                run.trace[part] = batch.trace(shares)
        while queued:
            finish_oldest()

    def run_on_device(self, drives: wp.array, energy: wp.array) -> None:
        """Step plates part by part under drives (plates, actuators, 2), and write their energies (plates, regions).

        On CUDA all is queued; the host waits only for plates that may grow.
        """
        steps = self.specialized.scheme.steps
        states, size = self.states_for(len(drives), np.empty((0, 2), int))
        for first in range(0, len(drives), size):
            part = slice(first, min(first + size, len(drives)))
            batch = DeviceBatch(self.engine, states[0], drives[part])
            segment, may_grow = segment_steps(self.specialized, batch.plates)
            for stop in (*range(segment, steps, segment), steps):
                batch.advance(stop)
                check_interrupt()
                if may_grow and batch.check_growth():
                    break
            batch.write_energies(energy[part])

    def _takes_whole(self, values: PerPlateValues, plates: int) -> bool:
        """Return whether a part can be one call: on a chip, all steps at once, only drives differ, none may grow."""
        segment, may_grow = segment_steps(self.specialized, plates)
        resident = self.specialized.device.is_cuda and self.engine.path == "resident"
        return resident and values.edges is None and not may_grow and segment >= self.specialized.scheme.steps

    def states_for(self, plates: int, corners: np.ndarray) -> tuple[list[State], int]:
        """Return the states that take turns, which trace the nodes ``corners``, and how many plates each takes."""
        part = math.ceil(PART_NODE_STEPS / self.specialized.node_steps_per_plate)
        size, turns, traced = max(1, plates), 1, len(corners)
        if self.chunk is not None:
            size = min(self.chunk, size)
        elif self.specialized.device.is_cuda and not traced and plates >= 2 * part:
            size, turns = part, 2
        held = [] if traced or any(state.nodes.shape[0] for state in self.states) else self.states
        # A CUDA driver may take a while to report its free memory.
        if self.chunk is None and not (self.specialized.device.is_cuda and _have_room(held, turns, size)):
            in_use = sum(one.capacity * bytes_per_plate(self.specialized, one.nodes.shape[0]) for one in self.states)
            room = plates_that_fit(self.specialized, traced, in_use, self.memory_share)
            turns = min(turns, room)
            size = min(size, room // turns)
        if not _have_room(held, turns, size):
            self.states.clear()  # frees the old arrays before new ones are allocated
            nodes: wp.array = wp.array(corners + np.array([1, 0], np.int32), dtype=int, device=self.specialized.device)
            self.states += [State(self.specialized, size, nodes) for _ in range(turns)]
        return self.states[:turns], size

    def _advance(
        self,
        batch: PlateBatch,
        snapshots: list[int],
        displacement: np.ndarray,
        samples: Set[int],
        report: Callable[[int], None],
    ) -> None:
        """Take plates to the end of the window, or until all grow without bound; on CUDA the last steps are queued.

        The displacement (plates, times, ny, nx) is written at the steps ``snapshots``, and sampled at ``samples``.
        """
        steps, plates = self.specialized.scheme.steps, len(batch.phasors)
        segment, may_grow = segment_steps(self.specialized, plates)
        waits = {*range(segment, steps, segment), *snapshots}
        for stop in sorted({*waits, *samples, steps}):
            batch.advance(stop)
            all_grown = may_grow and batch.check_growth()
            if stop in samples:
                batch.sample_peak()
            for index, snapshot in enumerate(snapshots):
                if snapshot == stop:
                    displacement[:, index] = batch.displacement
            if stop < steps and (stop in waits or self.specialized.device.is_cpu):
                wp.synchronize_device(self.specialized.device)
                report(stop * plates * self.specialized.interior_nodes)
                check_interrupt()
            if all_grown:
                break


def _have_room(states: list[State], count: int, plates: int) -> bool:
    return len(states) >= count and all(state.capacity >= plates for state in states[:count])


def segment_steps(specialized: Specialized, plates: int) -> tuple[int, bool]:
    """Return the largest number of steps to take at once, and whether to check for growth after them."""
    node_steps = plates * specialized.interior_nodes
    segment = max(1, int(SEGMENT_NODE_STEPS["cuda" if specialized.device.is_cuda else "cpu"] / node_steps))
    between = steps_between_checks(specialized, plates)
    return min(segment, between or segment), between is not None


def plates_that_fit(specialized: Specialized, traced_nodes: int, held: float, memory_share: float) -> int:
    """Return how many plates the device has memory for, at least 1.

    Args:
        traced_nodes: Number of nodes whose displacement is recorded.
        held: Bytes that this solver's states hold now and would give back.
        memory_share: Share of the memory for plates that this solver may take.

    Raises:
        SceneError: A CUDA device has no memory for one plate.
    """
    device, needed = specialized.device, bytes_per_plate(specialized, traced_nodes)
    if device.is_cuda:
        room = memory_share * CUDA_MEMORY_SHARE * device.free_memory + held
        if needed > room:
            raise SceneError(
                f"grid.nodes = {list(specialized.scene.grid.nodes)}: a plate takes {needed / 2**30:.3g} GiB, and "
                f"{room / 2**30:.3g} GiB of {device.alias} may be taken; use fewer nodes or record.points"
            )
        return int(room / needed)
    most = max(FEWEST_PLATES, int(SEGMENT_NODE_STEPS["cpu"] / specialized.node_steps_per_plate))
    return max(1, min(most, int(memory_share * CPU_BYTES / needed)))
