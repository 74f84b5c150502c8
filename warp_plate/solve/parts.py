"""Runs of large batches, part by part, as many plates at a time as the memory of a device holds."""

import math
from collections import deque
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import partial
from itertools import cycle

import numpy as np
import warp as wp

from warp_plate.interrupts import check_interrupt
from warp_plate.plate.designs import PerPlateValues
from warp_plate.scene.errors import SceneError
from warp_plate.solve.batching import Batch, steps_between_checks
from warp_plate.solve.compiled_scene import CompiledScene
from warp_plate.solve.run import Faults, Progress, Run
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State, bytes_per_plate

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


@dataclass(frozen=True)
class Records:
    """Displacements that a run records besides energies."""

    snapshots: Sequence[int]  # Steps at which displacements are kept
    samples: Set[int]  # Steps at which displacements are sampled for their peak
    corners: np.ndarray  # (points, 4, 2) row and column of the nodes around each point whose displacement is traced
    shares: np.ndarray  # (points, 4) their weights

    def __bool__(self) -> bool:
        return bool(self.snapshots or self.samples or len(self.corners))


def run_parts(
    compiled: CompiledScene,
    states: Sequence[State],
    phasors: np.ndarray,
    values: PerPlateValues,
    records: Records,
    run: Run,
    progress: Progress,
) -> None:
    """Step plates part by part, and write their energies, records and faults into ``run``.

    Parts alternate between the states: while the device steps one, the host prepares the next.
    """
    specialized, size = compiled.specialized, states[0].capacity
    plates, work = len(phasors), specialized.node_steps_per_plate
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
        whole = not records and _takes_whole(compiled, values, part.stop - first)
        batch = Batch(compiled, state, part.stop - first)
        batch.load(phasors[part], values[part], whole)
        if not whole:
            _advance(batch, records, run.displacement[part], partial(report, first * work))
            if records.samples:
                run.peak[part] = batch.peak if batch.step == specialized.scheme.steps else np.nan
        queued.append((part, batch.queue_energies()))
        if len(records.corners):
            run.trace[part] = batch.trace(records.shares)
    while queued:
        finish_oldest()


def run_parts_on_device(compiled: CompiledScene, state: State, drives: wp.array, energy: wp.array) -> None:
    """Step plates part by part under drives (plates, actuators, 2), and write their energies (plates, regions).

    On CUDA all is queued; the host waits only for plates that may grow.
    """
    steps = compiled.specialized.scheme.steps
    for first in range(0, len(drives), state.capacity):
        part = slice(first, min(first + state.capacity, len(drives)))
        batch = Batch(compiled, state, part.stop - first)
        batch.load_on_device(drives[part])
        segment, may_grow = segment_steps(compiled.specialized, batch.plates)
        for stop in (*range(segment, steps, segment), steps):
            batch.advance(stop)
            check_interrupt()
            if may_grow and batch.check_growth():
                break
        batch.write_energies(energy[part])


def _takes_whole(compiled: CompiledScene, values: PerPlateValues, plates: int) -> bool:
    """Return whether a part can be one call: on a chip, all steps at once, only drives differ, none may grow."""
    segment, may_grow = segment_steps(compiled.specialized, plates)
    resident = compiled.specialized.device.is_cuda and compiled.path == "resident"
    return resident and values.edges is None and not may_grow and segment >= compiled.specialized.scheme.steps


def _advance(batch: Batch, records: Records, displacement: np.ndarray, report: Callable[[int], None]) -> None:
    """Take plates to the end of the window, or until all grow without bound; on CUDA the last steps are queued.

    The displacement (plates, times, ny, nx) is written at the steps of ``records``.
    """
    specialized = batch.compiled.specialized
    steps = specialized.scheme.steps
    segment, may_grow = segment_steps(specialized, batch.plates)
    waits = {*range(segment, steps, segment), *records.snapshots}
    for stop in sorted({*waits, *records.samples, steps}):
        batch.advance(stop)
        all_grown = may_grow and batch.check_growth()
        if stop in records.samples:
            batch.sample_peak()
        for index, snapshot in enumerate(records.snapshots):
            if snapshot == stop:
                displacement[:, index] = batch.displacement
        if stop < steps and (stop in waits or specialized.device.is_cpu):
            wp.synchronize_device(specialized.device)
            report(stop * batch.plates * specialized.interior_nodes)
            check_interrupt()
        if all_grown:
            break


def states_for(
    specialized: Specialized, states: list[State], plates: int, corners: np.ndarray, chunk: int | None, share: float
) -> list[State]:
    """Return the states that parts alternate between, which trace the nodes ``corners`` (nodes, 2)."""
    device, traced = specialized.device, len(corners)
    part = math.ceil(PART_NODE_STEPS / specialized.node_steps_per_plate)
    size, count = max(1, plates), 1
    if chunk is not None:
        size = min(chunk, size)
    elif device.is_cuda and not traced and plates >= 2 * part:
        size, count = part, 2
    usable = [] if traced or any(state.nodes.shape[0] for state in states) else states
    # A CUDA driver may take a while to report its free memory.
    if chunk is None and not (device.is_cuda and _have_room(usable, count, size)):
        in_use = sum(state.capacity * bytes_per_plate(specialized, state.nodes.shape[0]) for state in states)
        room = plates_that_fit(specialized, traced, in_use, share)
        count = min(count, room)
        size = min(size, room // count)
    if not _have_room(usable, count, size):
        states.clear()  # frees the old arrays before new ones are allocated
        nodes: wp.array = wp.array(corners + np.array([1, 0], np.int32), dtype=int, device=device)
        states += [State(specialized, size, nodes) for _ in range(count)]
    return states[:count]


def _have_room(states: list[State], count: int, plates: int) -> bool:
    return len(states) >= count and all(state.capacity >= plates for state in states[:count])


def segment_steps(specialized: Specialized, plates: int) -> tuple[int, bool]:
    """Return the largest number of steps to take at once, and whether to check for growth after them."""
    node_steps = plates * specialized.interior_nodes
    segment = max(1, int(SEGMENT_NODE_STEPS["cuda" if specialized.device.is_cuda else "cpu"] / node_steps))
    between = steps_between_checks(specialized, plates)
    return min(segment, between or segment), between is not None


def plates_that_fit(specialized: Specialized, traced_nodes: int, held: float, memory_share: float) -> int:
    """Return how many plates the device has memory for, at least 1."""
    device, needed = specialized.device, bytes_per_plate(specialized, traced_nodes)
    if device.is_cuda:
        room = memory_share * CUDA_MEMORY_SHARE * device.free_memory + held
        if needed > room:
            raise SceneError(
                f"grid.nodes = {list(specialized.scene.grid.nodes)}: a plate takes {needed / 2**30:.3g} GiB, and "
                f"{room / 2**30:.3g} GiB of {device.alias} may be taken; use fewer nodes or record.points"
            )
        return int(room / needed)
    most = plates_a_launch(specialized.node_steps_per_plate)
    return max(1, min(most, int(memory_share * CPU_BYTES / needed)))


def plates_a_launch(node_steps: float) -> int:
    """Return the largest number of plates of so many node-steps that are run at once on CPU."""
    return max(FEWEST_PLATES, int(SEGMENT_NODE_STEPS["cpu"] / node_steps))
