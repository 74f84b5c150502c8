"""What a device can do at most, measured: copying memory, and arithmetic; and what a node-step needs of each.

A share of a limit is (need of a node-step) × (node-steps a second) / (limit).

Memory: displacement and rate, each read and written once. That is the least for a path with one launch a step; a path
that takes several steps on the way through memory can pass it, and has a share above one.

Arithmetic: an addition, a multiplication or a fused multiply-add counts as one operation, for each takes one turn of
the arithmetic unit. The measured limit, which by custom counts a fused multiply-add as two, is halved to compare.
Only what any program must do is counted: not edges, padding, addresses, exchange between threads, or loads of nodes
that no actuator covers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import warp as wp

from warp_plate.bench.clock import seconds_of
from warp_plate.kernels.limits import make_multiply_adds
from warp_plate.solve.cpu import compiler_flags
from warp_plate.solve.devices import cpu_threads
from warp_plate.solve.specialize import Specialized

REALS = {"float32": wp.float32, "float64": wp.float64}
# Displacement and rate, read and written.
NUMBERS_MOVED = 4
# Each of the two Laplacians: three additions and a multiply-add. The update: two multiply-adds and an addition.
LAPLACIANS, UPDATE = 2 * 4, 3
# Where a node is loaded: a multiplication and a multiply-add. In the window: rate² to its sum, a multiply-add.
LOAD, SUM = 2, 1
# Larger than any cache, and several of them where one is over too soon to be timed.
COPY_BYTES = {"cpu": 2**28, "cuda": 2**30}
COPIES = {"cpu": 1, "cuda": 8}
# CPU: a block that stays in the first-level cache, over and over. CUDA: as many threads as fit, some times over.
CPU_BLOCK, CPU_DEPTH, CPU_PASSES = 1024, 32, 100_000
CUDA_THREADS, CUDA_DEPTH, CUDA_ROUNDS = 4 * 2048, 128, 256
# The fastest of so many runs: a limit is what the device can do when nothing disturbs it.
RUNS = 5


@dataclass(frozen=True)
class DeviceLimits:
    """copy_bytes_per_second: read and written together; flops: by precision, a fused multiply-add being two."""

    copy_bytes_per_second: float
    flops: Mapping[str, float]


def measure_limits(device: wp.Device, precisions: Iterable[str]) -> DeviceLimits:
    """Both limits of a device; on CPU with as many threads as the simulation uses.

    Raises:
        SceneError: WARP_PLATE_THREADS is no number of threads.
    """
    threads = cpu_threads() if device.is_cpu else 1
    copied = _copy_bytes_per_second(device, threads)
    return DeviceLimits(copied, {name: _flops(device, REALS[name], threads) for name in precisions})


def share_of_limit(specialized: Specialized, path: str, rate: float, limits: DeviceLimits) -> tuple[str, float]:
    """Name of the limit that a path is held against, and the share that ``rate`` [node-steps/s] is of it."""
    if path == "streaming":
        moved = NUMBERS_MOVED * wp.types.type_size_in_bytes(specialized.real)
        return "copy", rate * moved / limits.copy_bytes_per_second
    operations = limits.flops[specialized.scene.grid.precision] / 2
    return "arithmetic", rate * operations_a_node_step(specialized) / operations


def operations_a_node_step(specialized: Specialized) -> float:
    """Floating-point operations that a node-step needs, averaged over the nodes and steps of a scene."""
    scheme = specialized.scheme
    loaded = specialized.support.shape[0] / specialized.interior_nodes
    summed = (scheme.window[1] - scheme.window[0]) / scheme.steps
    return LAPLACIANS + UPDATE + LOAD * loaded + SUM * summed


def _copy_bytes_per_second(device: wp.Device, threads: int) -> float:
    kind = "cuda" if device.is_cuda else "cpu"
    size = min(COPY_BYTES[kind], device.free_memory // 4) if device.is_cuda else COPY_BYTES[kind]
    count = size // 4 // threads
    source, target = (wp.full(count * threads, value, dtype=wp.float32, device=device) for value in (1.0, 2.0))
    parts = [
        partial(wp.copy, target, source, dest_offset=part * count, src_offset=part * count, count=count)
        for part in range(threads)
    ]
    seconds = _fastest(parts * COPIES[kind], device)
    return 2 * 4 * count * threads * COPIES[kind] / seconds


def _flops(device: wp.Device, real: type, threads: int) -> float:
    if device.is_cuda:
        rows, block, depth, rounds, passes = device.sm_count * CUDA_THREADS, 1, CUDA_DEPTH, CUDA_ROUNDS, 1
    else:
        rows, block, depth, rounds, passes = 1, CPU_BLOCK, CPU_DEPTH, 1, CPU_PASSES
    kernel = make_multiply_adds(real, block, depth, rounds, compiler_flags())
    wp.load_module(module=kernel.module, device=device)
    numbers = [wp.zeros((rows, block), dtype=real, device=device) for _ in range(threads)]
    # 2 is where x ← x/2 + 1 comes to rest: neither too large nor too small for a number.
    inputs = [0.5, 1.0, passes]
    calls = [partial(wp.launch, kernel, dim=rows, inputs=inputs, outputs=[own], device=device) for own in numbers]
    return 2 * depth * rounds * passes * block * rows * threads / _fastest(calls, device)


def _fastest(calls: Sequence[Callable[[], object]], device: wp.Device) -> float:
    """Seconds for all calls: on CPU side by side, a thread each; on CUDA queued one after another."""
    with ThreadPoolExecutor(len(calls)) as pool:

        def work() -> None:
            if device.is_cuda:
                for call in calls:
                    call()
            else:
                for future in [pool.submit(call) for call in calls]:
                    future.result()

        work()
        return min(seconds_of(work, device) for _ in range(RUNS))
