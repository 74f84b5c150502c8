"""The ways to step a chunk of plates: each path is a function ``advance(state, plates, start, stop)``.

It takes the first ``plates`` plates of the state from step ``start`` to step ``stop`` and has finished on CPU, or is
queued on the device's stream on CUDA, when it returns.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import resident_cpu, streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State

Advance = Callable[[State, int, int, int], None]

# Steps in one captured graph; even, so that the two displacement buffers end where they began.
GRAPH_STEPS = 64


def compiler_flags() -> str:
    """How LLVM compiles the CPU kernels: whole vectors and fused multiply-adds."""
    wide = " -mprefer-vector-width=512" if platform.machine().lower() in ("x86_64", "amd64") else ""
    return "-march=native -ffp-contract=fast" + wide


def cpu_threads() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=cpu_threads(), thread_name_prefix="warp-plate")


def load(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compile now, or read from Warp's cache, so that no launch pays for it."""
    wp.load_module(module=kernel.module, device=device)


def resident_cpu_path(specialized: Specialized) -> Advance:
    """All steps in one launch, plates shared among the cores by Python threads (Warp frees Python's lock)."""
    nx, ny = specialized.scheme.nodes
    stride = specialized.stride
    kernel = resident_cpu.make_run(specialized.effects, specialized.real, ny, stride, compiler_flags())
    load(kernel, specialized.device)
    factor, stiffness = _resident_cpu_fields(specialized)
    window = wp.vec2i(*specialized.scheme.window)

    def launch(state: State, first: int, count: int, start: int, stop: int) -> None:
        inputs: list[Any] = [specialized.parameters, factor, stiffness, specialized.wave, window, start, stop]
        inputs += [first, state.nodes, state.in_phase, state.quadrature]
        outputs = [state.u, state.rate, state.squares, state.scratch, state.trace]
        wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=specialized.device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        cuts = np.linspace(0, plates, min(cpu_threads(), plates) + 1).astype(int)
        if len(cuts) == 2:
            launch(state, 0, plates, start, stop)
            return
        slices = zip(cuts[:-1].tolist(), np.diff(cuts).tolist(), strict=True)
        pending = [_pool().submit(launch, state, first, count, start, stop) for first, count in slices]
        for future in pending:
            future.result()

    return advance


def _resident_cpu_fields(specialized: Specialized) -> tuple[wp.array, wp.array]:
    """Curvature factors and stiffnesses in the blocks that ``resident_cpu`` walks."""
    scheme, stride = specialized.scheme, specialized.stride
    nx, ny = scheme.nodes
    curved_rows, moved_rows = resident_cpu.rows_per_block(ny, stride)
    factor_y = scheme.factor_y if curved_rows > 1 else scheme.factor_y[[0, 1, -1]]
    factor = np.zeros((factor_y.size, stride))
    factor[:, :nx] = np.outer(factor_y, scheme.factor_x)
    stiffness = np.zeros((moved_rows, stride))
    stiffness[:, 1 : nx - 1] = scheme.stiffness
    return specialized.to_device(factor.ravel()), specialized.to_device(stiffness.ravel())


def streaming_path(specialized: Specialized) -> Advance:
    """A launch a step; on CUDA, runs of GRAPH_STEPS steps are captured once as a graph and replayed."""
    device, real = specialized.device, specialized.real
    step = streaming.make_step(specialized.effects, real)
    record = streaming.make_record(real)
    for kernel in (step, record, streaming.advance_clock):
        load(kernel, device)
    nx, ny = specialized.scheme.nodes
    factor_x = specialized.to_device(specialized.scheme.factor_x)
    factor_y = specialized.to_device(specialized.scheme.factor_y)
    window = wp.vec2i(*specialized.scheme.window)
    clock = wp.zeros(1, dtype=int, device=device)
    graphs: dict[tuple[int, int, int], wp.Graph] = {}

    def launch_steps(state: State, plates: int, count: int) -> None:
        inputs = [specialized.parameters, factor_x, factor_y, specialized.wave, window, clock]
        for offset in range(count):
            wp.launch(
                step,
                dim=(plates, ny - 2, nx - 2),
                inputs=[*inputs, offset, state.in_phase, state.quadrature, state.u],
                outputs=[state.scratch, state.rate, state.squares],
                device=device,
            )
            state.u, state.scratch = state.scratch, state.u
            if state.nodes.shape[0]:
                wp.launch(
                    record,
                    dim=(plates, state.nodes.shape[0]),
                    inputs=[clock, offset, state.nodes, state.u],
                    outputs=[state.trace],
                    device=device,
                )
        wp.launch(streaming.advance_clock, dim=1, inputs=[clock, count], device=device)

    def replay(state: State, plates: int) -> None:
        # A graph holds addresses: it serves one number of plates and one order of the two buffers.
        key = (plates, state.u.ptr, state.squares.ptr)
        if key not in graphs:
            with wp.ScopedCapture(device=device) as capture:
                launch_steps(state, plates, GRAPH_STEPS)
            graphs[key] = capture.graph
        wp.capture_launch(graphs[key])

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        whole, rest = divmod(stop - start, GRAPH_STEPS) if device.is_cuda else (0, stop - start)
        for _ in range(whole):
            replay(state, plates)
        launch_steps(state, plates, rest)

    return advance


PATHS = {"resident": resident_cpu_path, "streaming": streaming_path}


def choose_path(name: str, device: wp.Device) -> str:
    """The path that "auto" means on this device; a path's name stands for itself."""
    if name != "auto":
        return name
    return "resident" if device.is_cpu else "streaming"
