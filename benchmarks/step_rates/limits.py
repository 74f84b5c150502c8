"""Measured limits of a device, memory copies and arithmetic, and the share of them that a node-step needs.

A share of a limit is (need of a node-step) × (node-steps a second) / (limit).

Memory: displacement and rate, each read and written once, which is the least for a path with one launch a step. A path
that takes several steps on each pass through memory may exceed a share of one.

Arithmetic: an addition, a multiplication or a fused multiply-add counts as one operation. The measured limit counts a
fused multiply-add as two, as is customary, and is halved for the comparison. Edges, padding, addresses, exchange
between threads and loads of nodes without an actuator do not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import warp as wp

from step_rates.multiply_adds import make_multiply_adds
from warp_plate.solve.devices import cpu_threads, load_kernel
from warp_plate.solve.specialize import Specialized

# Numbers moved: displacement and rate, read and written.
NUMBERS_MOVED = 4
# Operations of the bending: two Laplacians by order (three additions and a multiply-add each; of fourth order two
# additions and three multiply-adds along each axis), or the moment form (second differences and the twist, three
# moments, their differences); of the update (two multiply-adds and an addition), the load of a node (a multiplication
# and a multiply-add) and the window's sum (a multiply-add).
LAPLACIANS, MOMENT_FORM, UPDATE, LOAD, SUM = {2: 2 * 4, 4: 2 * 10}, 21, 3, 2, 1
# Bytes beyond any cache, and copies in a row where one is too short to be timed.
COPY_BYTES, COPIES = {"cpu": 2**28, "cuda": 2**30}, {"cpu": 1, "cuda": 8}
# CPU: passes over a block in the first-level cache. CUDA: a few times as many threads as fit.
CPU_BLOCK, CPU_DEPTH, CPU_PASSES = 1024, 32, 100_000
CUDA_THREADS, CUDA_DEPTH, CUDA_ROUNDS = 4 * 2048, 128, 256
# The fastest of these runs counts, because other programs can only slow a device down.
RUNS = 5


@dataclass(frozen=True)
class DeviceLimits:
    """Measured limits of a device."""

    copy_bytes_per_second: float  # read and written together
    flops: Mapping[str, float]  # by precision; a fused multiply-add is two


def seconds_of(work: Callable[[], None], device: wp.Device) -> float:
    """Return the time of some work [s], from an idle device to an idle device."""
    wp.synchronize_device(device)
    start = time.perf_counter()
    work()
    wp.synchronize_device(device)
    return time.perf_counter() - start


def measure_limits(device: wp.Device, precisions: Iterable[str]) -> DeviceLimits:
    """Measure both limits of a device, on CPU with as many threads as the simulation uses.

    Raises:
        SceneError: WARP_PLATE_THREADS is not a number of threads.
    """
    threads = cpu_threads() if device.is_cpu else 1
    copied = _copy_bytes_per_second(device, threads)
    return DeviceLimits(copied, {name: _flops(device, getattr(wp, name), threads) for name in precisions})


def share_of_limit(specialized: Specialized, path: str, rate: float, limits: DeviceLimits) -> tuple[str, float]:
    """Return the name of the limit that applies to a path, and the share that ``rate`` [node-steps/s] is of it."""
    if path == "streaming":
        moved = NUMBERS_MOVED * wp.types.type_size_in_bytes(specialized.real)
        return "copy", rate * moved / limits.copy_bytes_per_second
    operations = limits.flops[specialized.scene.grid.precision] / 2
    return "arithmetic", rate * operations_a_node_step(specialized) / operations


def operations_a_node_step(specialized: Specialized) -> float:
    """Return the floating-point operations of a node-step, averaged over the nodes and steps of a scene."""
    (start, end), steps = specialized.scheme.window, specialized.scheme.steps
    loaded, summed = specialized.support.shape[0] / specialized.interior_nodes, (end - start) / steps
    bending = LAPLACIANS[specialized.effects.order] if specialized.effects.plain else MOMENT_FORM
    return bending + UPDATE + LOAD * loaded + SUM * summed


def _copy_bytes_per_second(device: wp.Device, threads: int) -> float:
    kind = "cuda" if device.is_cuda else "cpu"
    size = min(COPY_BYTES[kind], device.free_memory // 4) if device.is_cuda else COPY_BYTES[kind]
    count = size // 4 // threads
    source, target = (wp.full(count * threads, value, dtype=wp.float32, device=device) for value in (1.0, 2.0))
    starts = [part * count for part in range(threads)] * COPIES[kind]
    copies = [partial(wp.copy, target, source, start, start, count) for start in starts]
    return 2 * 4 * count * len(copies) / _fastest(copies, device)


def _flops(device: wp.Device, real: type, threads: int) -> float:
    rows, block, depth, rounds, passes = 1, CPU_BLOCK, CPU_DEPTH, 1, CPU_PASSES
    if device.is_cuda:
        rows, block, depth, rounds, passes = device.sm_count * CUDA_THREADS, 1, CUDA_DEPTH, CUDA_ROUNDS, 1
    kernel = make_multiply_adds(real, block, depth, rounds)
    load_kernel(kernel, device)
    numbers = [wp.zeros((rows, block), dtype=real, device=device) for _ in range(threads)]
    # x ← x/2 + 1 converges to 2, so numbers neither overflow nor vanish.
    inputs = [0.5, 1.0, passes]
    calls = [partial(wp.launch, kernel, dim=rows, inputs=inputs, outputs=[array], device=device) for array in numbers]
    return 2 * depth * rounds * passes * block * rows * threads / _fastest(calls, device)


def _fastest(calls: Sequence[Callable[[], object]], device: wp.Device) -> float:
    """Return the time of all calls [s], on CPU in a thread each, on CUDA queued one after another."""
    with ThreadPoolExecutor(len(calls)) as pool:

        def work() -> None:
            run = map if device.is_cuda else pool.map
            list(run(lambda call: call(), calls))

        work()
        return min(seconds_of(work, device) for _ in range(RUNS))
