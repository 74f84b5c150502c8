"""The ways to step a chunk of plates: each path is a function ``advance(state, plates, start, stop)``.

It takes the first ``plates`` plates of the state from step ``start`` to step ``stop`` and has finished on CPU, or is
queued on the device's stream on CUDA, when it returns.
"""

from __future__ import annotations

import ctypes
import platform
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import resident_cpu, resident_cpu_groups, resident_lanes, resident_strips, streaming, streaming_march
from warp_plate.kernels.cuda import LANES
from warp_plate.scene.errors import SceneError
from warp_plate.solve.specialize import LINE_BYTES, Specialized
from warp_plate.solve.state import State

Advance = Callable[[State, int, int, int], None]

# A single plate with at least so many nodes is worth a crew of CPU threads, which meet twice a step.
CREW_NODES = 8192
# CPU groups of plates pay while one group's room stays in a core's second-level cache, and from this share of a group
# on (measured: a group of 16 takes 13 times as long as one plate of 27 × 27).
GROUP_BYTES = 2**20
GROUP_FILL = 0.85
# Threads a block where each warp has its own plate. Up to so many plates a multiprocessor, a plate's own speed counts
# and the compiler may take as many registers as pay; beyond, what counts is how many plates run side by side.
LANES_BLOCK = 32
FEW_PLATES, FEW_REGISTERS = 12, 160
# Launches in one captured graph; even, so that buffers that take turns end where they began.
GRAPH_LAUNCHES = 16
# Threads a block on the streaming CUDA path, whose warps know nothing of each other.
MARCH_BLOCK = 128
# As many warps as keep a large GPU busy, and the fewest rows that are worth a tile with its margins.
MARCH_WARPS = 4096
MARCH_ROWS = 16


@dataclass(frozen=True)
class March:
    """How the streaming CUDA path cuts a plate: columns a lane, steps a launch; None: rows a tile to suit."""

    columns: int = 2
    levels: int = 4
    tile_rows: int | None = None
    registers: int | None = None

    def tiles(self, strips: int, moving_rows: int) -> int:
        """Tiles along y for so many strips on the whole device."""
        if self.tile_rows:
            return -(-moving_rows // self.tile_rows)
        return max(1, min(-(-MARCH_WARPS // strips), moving_rows // MARCH_ROWS))


def compiler_flags() -> str:
    """How LLVM compiles the CPU kernels: whole vectors and fused multiply-adds."""
    wide = " -mprefer-vector-width=512" if platform.machine().lower() in ("x86_64", "amd64") else ""
    return "-march=native -ffp-contract=fast -mllvm=-force-vector-interleave=4" + wide


@lru_cache(maxsize=None)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warp-plate")


# One crew at a time: its members wait for each other, so that all must run at once.
_CREW = threading.Lock()


def _yield_address() -> int:
    """Address of the C function with which a thread gives up its core for a while."""
    function = ctypes.windll.kernel32.SwitchToThread if sys.platform == "win32" else ctypes.CDLL(None).sched_yield
    return ctypes.cast(function, ctypes.c_void_p).value or 0


_YIELD = _yield_address()


def load(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compile now, or read from Warp's cache, so that no launch pays for it."""
    wp.load_module(module=kernel.module, device=device)


def resident_cpu_path(specialized: Specialized) -> Advance:
    """All steps in one launch, plates shared among the cores by Python threads (Warp frees Python's lock)."""
    ny, stride, threads = specialized.scheme.nodes[1], specialized.stride, specialized.threads
    singly, by_groups = _cpu_singly(specialized), _cpu_by_groups(specialized)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if plates < threads and ny * stride >= CREW_NODES:
            with _CREW:
                for plate in range(plates):
                    arrived = wp.zeros(1, dtype=int, device=specialized.device)
                    crew = [(threads, member, arrived) for member in range(threads)]
                    _at_once([partial(singly, state, plate, plate + 1, start, stop, one) for one in crew])
            return
        cuts = np.linspace(0, plates, min(threads, plates) + 1).astype(int).tolist()
        calls: list[Callable[[], None]] = []
        for thread, (low, high) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
            calls.append(partial(_cpu_share, singly, by_groups, state, thread, low, high, start, stop))
        _at_once(calls)

    return advance


def _cpu_share(
    singly: Any, by_groups: Any, state: State, thread: int, low: int, high: int, start: int, stop: int
) -> None:
    """Plates ``low`` ... ``high`` − 1 on one thread: in groups as long as these are full enough, the rest singly."""
    grouped = low
    if by_groups is not None:
        launch, lanes = by_groups
        groups, rest = divmod(high - low, lanes)
        grouped = high if rest >= GROUP_FILL * lanes else low + groups * lanes
        if grouped > low:
            launch(state, thread, low, grouped, start, stop)
    if high > grouped:
        singly(state, grouped, high, start, stop)


def _cpu_singly(specialized: Specialized) -> Callable[..., None]:
    """Launches ``resident_cpu`` on plates first ... last − 1; ``crew``: members, which one, and their meeting."""
    device, stride, ny = specialized.device, specialized.stride, specialized.scheme.nodes[1]
    kernel = resident_cpu.make_run(specialized.effects, specialized.real, ny, stride, compiler_flags())
    load(kernel, device)
    factor, stiffness = _resident_cpu_fields(specialized)
    shared: list[Any] = [specialized.parameters, factor, stiffness, specialized.wave]
    shared += [wp.vec2i(*specialized.scheme.window)]
    alone = (1, 0, wp.zeros(1, dtype=int, device=device))

    def launch(state: State, first: int, last: int, start: int, stop: int, crew: tuple[Any, ...] = alone) -> None:
        inputs = [*shared, start, stop, first, *crew, _YIELD, state.nodes, state.in_phase, state.quadrature]
        outputs = [state.u, state.rate, state.squares, state.u_next, state.trace]
        wp.launch(kernel, dim=last - first, inputs=inputs, outputs=outputs, device=device)

    return launch


def _cpu_by_groups(specialized: Specialized) -> tuple[Callable[..., None], int] | None:
    """Launches ``resident_cpu_groups``, and plates a group; None for plates whose groups would leave the cache."""
    device, scheme = specialized.device, specialized.scheme
    itemsize = wp.types.type_size_in_bytes(specialized.real)
    lanes = LINE_BYTES // itemsize
    room = resident_cpu_groups.room_of(*scheme.nodes, lanes)
    if room * itemsize > GROUP_BYTES:
        return None
    kernel = resident_cpu_groups.make_run_groups(
        specialized.effects, specialized.real, *scheme.nodes, specialized.stride, lanes, compiler_flags()
    )
    load(kernel, device)
    factor = np.outer(scheme.factor_y[[0, 1, -1]], np.repeat(scheme.factor_x, lanes))
    shared = [specialized.parameters, specialized.to_device(factor.ravel()), specialized.wave]
    shared += [wp.vec2i(*scheme.window)]
    rooms = wp.zeros((specialized.threads, room), dtype=specialized.real, device=device)

    def launch(state: State, thread: int, first: int, last: int, start: int, stop: int) -> None:
        inputs = [*shared, start, stop, first, last, thread, state.nodes, state.in_phase, state.quadrature]
        outputs = [rooms, state.u, state.rate, state.squares, state.trace]
        wp.launch(kernel, dim=-(-(last - first) // lanes), inputs=inputs, outputs=outputs, device=device)

    return launch, lanes


def _at_once(calls: list[Callable[[], None]]) -> None:
    """Make the calls side by side, the last of them here."""
    pending = [_pool(len(calls) - 1).submit(call) for call in calls[:-1]]
    calls[-1]()
    for future in pending:
        future.result()


def _resident_cpu_fields(specialized: Specialized) -> tuple[wp.array, wp.array]:
    """Curvature factors and stiffnesses in the blocks that ``resident_cpu`` walks."""
    scheme, stride = specialized.scheme, specialized.stride
    nx, ny = scheme.nodes
    curved_rows, moved_rows = resident_cpu.rows_per_block(ny, stride)
    factor_y = scheme.factor_y if curved_rows > 1 else scheme.factor_y[[0, 1, -1]]
    factor = np.zeros((factor_y.size, stride))
    factor[:, :nx] = np.outer(factor_y, scheme.factor_x)
    stiffness = np.zeros((moved_rows, stride))
    stiffness[:, 1 : nx - 1] = specialized.parameters.stiffness
    return specialized.to_device(factor.ravel()), specialized.to_device(stiffness.ravel())


def resident_cuda_path(specialized: Specialized) -> Advance:
    """All steps in one launch, the plate in the registers of a warp or, beyond 32 nodes a side, of a block."""
    nx, ny = specialized.scheme.nodes
    if resident_lanes.fits(nx, ny):
        return _lanes_path(specialized)
    strips = resident_strips.plan(nx, ny, specialized.real)
    if strips is None:
        raise SceneError(f"path = 'resident': {nx} x {ny} nodes do not fit on one multiprocessor; write 'streaming'")
    return strips_path(specialized, strips)


def _lanes_path(specialized: Specialized) -> Advance:
    """A warp a plate: compiled twice, with many registers for few plates and with few for many plates at a time."""
    effects, real, ny = specialized.effects, specialized.real, specialized.scheme.nodes[1]
    loaded = sum(1 << j for j, row in enumerate(_loaded_rows(specialized)[2:-2]) if row)

    def compiled(registers: int | None) -> Advance:
        kernels = {
            summed: resident_lanes.make_run(effects, real, ny, loaded, summed, registers) for summed in (False, True)
        }
        return _cuda_advance(specialized, kernels, [], LANES, LANES_BLOCK)

    if real is wp.float64:
        return compiled(None)
    few, many = compiled(FEW_REGISTERS), compiled(None)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        (few if plates <= FEW_PLATES * specialized.device.sm_count else many)(state, plates, start, stop)

    return advance


def strips_path(specialized: Specialized, strips: resident_strips.Strips) -> Advance:
    """A block a plate, cut as ``strips`` says."""
    nx, ny = specialized.scheme.nodes
    kernels = {
        summed: resident_strips.make_run(
            specialized.effects, specialized.real, nx, ny, specialized.stride, strips, summed
        )
        for summed in (False, True)
    }
    loaded = wp.array(_loaded_rows(specialized), dtype=int, device=specialized.device)
    threads = LANES * strips.warps
    return _cuda_advance(specialized, kernels, [loaded], threads, threads)


def _cuda_advance(
    specialized: Specialized, kernels: dict[bool, wp.Kernel], extra: list[Any], threads: int, block_dim: int
) -> Advance:
    """Launches of a resident CUDA kernel, cut where the window begins and ends: the sums cost nothing outside it."""
    device, scheme = specialized.device, specialized.scheme
    for kernel in kernels.values():
        wp.load_module(module=kernel.module, device=device, block_dim=block_dim)
    inputs = [specialized.parameters, specialized.to_device(scheme.factor_x), specialized.to_device(scheme.factor_y)]
    inputs += [specialized.wave, *extra]

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        for low, high, summed in _cut_at_window(specialized, start, stop):
            wp.launch(
                kernels[summed],
                dim=plates * threads,
                inputs=[*inputs, low, high, state.in_phase, state.quadrature],
                outputs=[state.u, state.rate, state.squares],
                device=device,
                block_dim=block_dim,
            )

    return advance


def streaming_cpu_path(specialized: Specialized) -> Advance:
    """A launch a step, a thread a node: slow, and the plainest of the paths."""
    device, real = specialized.device, specialized.real
    step = streaming.make_step(specialized.effects, real)
    record = streaming.make_record(real)
    for kernel in (step, record):
        load(kernel, device)
    nx, ny = specialized.scheme.nodes
    factors = [specialized.to_device(specialized.scheme.factor_x), specialized.to_device(specialized.scheme.factor_y)]
    window = wp.vec2i(*specialized.scheme.window)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        for n in range(start, stop):
            wp.launch(
                step,
                dim=(plates, ny - 2, nx - 2),
                inputs=[specialized.parameters, *factors, specialized.wave, window, n, state.in_phase, state.quadrature, state.u],
                outputs=[state.u_next, state.rate, state.squares],
                device=device,
            )
            state.u, state.u_next = state.u_next, state.u
            if state.nodes.shape[0]:
                outputs = [state.trace]
                wp.launch(record, dim=(plates, state.nodes.shape[0]), inputs=[n, state.nodes, state.u], outputs=outputs, device=device)

    return advance


def streaming_cuda_path(specialized: Specialized, march: March | None = None) -> Advance:
    """Several steps a launch; runs of GRAPH_LAUNCHES launches are captured once as a CUDA graph and replayed."""
    march = march or March()
    device, scheme = specialized.device, specialized.scheme
    nx, ny = scheme.nodes
    kernels = {
        (levels, summed): streaming_march.make_march(
            specialized.effects, specialized.real, nx, ny, specialized.stride, march.columns, levels, summed,
            march.registers,
        )
        for levels in {1, march.levels}
        for summed in (False, True)
    }
    record = streaming_march.make_record(specialized.real)
    for kernel in kernels.values():
        wp.load_module(module=kernel.module, device=device, block_dim=MARCH_BLOCK)
    for kernel in (record, streaming_march.advance_clock):
        load(kernel, device)
    loaded = wp.array(_loaded_rows(specialized), dtype=int, device=device)
    shared = [specialized.parameters, specialized.to_device(scheme.factor_x), specialized.to_device(scheme.factor_y)]
    shared += [specialized.wave, loaded]
    clock = wp.zeros(1, dtype=int, device=device)
    graphs: dict[tuple[int, int, bool], wp.Graph] = {}

    def launches(state: State, plates: int, count: int, levels: int, summed: bool) -> None:
        strips = -(-(nx - 2) // streaming_march.useful_columns(march.columns, levels))
        tiles = march.tiles(plates * strips, ny - 2)
        for index in range(count):
            wp.launch(
                kernels[levels, summed],
                dim=plates * strips * tiles * LANES,
                inputs=[*shared, clock, index * levels, tiles, -(-(ny - 2) // tiles)]
                + [state.in_phase, state.quadrature, state.u, state.rate],
                outputs=[state.u_next, state.rate_next, state.squares],
                device=device,
                block_dim=MARCH_BLOCK,
            )
            state.u, state.u_next = state.u_next, state.u
            state.rate, state.rate_next = state.rate_next, state.rate
            if state.nodes.shape[0]:
                inputs = [clock, index, state.nodes, state.u]
                wp.launch(record, dim=(plates, state.nodes.shape[0]), inputs=inputs, outputs=[state.trace], device=device)
        wp.launch(streaming_march.advance_clock, dim=1, inputs=[clock, count * levels], device=device)

    def replay(state: State, plates: int, levels: int, summed: bool) -> None:
        # A graph holds addresses: it serves one number of plates and one order of the two buffers.
        key = (plates, state.u.ptr, summed)
        if key not in graphs:
            with wp.ScopedCapture(device=device) as capture:
                launches(state, plates, GRAPH_LAUNCHES, levels, summed)
            graphs[key] = capture.graph
        wp.capture_launch(graphs[key])

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        levels = 1 if state.nodes.shape[0] else march.levels  # a trace needs every step
        for low, high, summed in _cut_at_window(specialized, start, stop):
            deep, rest = divmod(high - low, levels)
            graphs_whole, deep = divmod(deep, GRAPH_LAUNCHES)
            for _ in range(graphs_whole):
                replay(state, plates, levels, summed)
            if deep:
                launches(state, plates, deep, levels, summed)
            if rest:
                launches(state, plates, rest, 1, summed)

    return advance


def _cut_at_window(specialized: Specialized, start: int, stop: int) -> list[tuple[int, int, bool]]:
    """(first, last + 1, inside) of the runs of steps before, inside and after the window."""
    first, last = (min(max(cut, start), stop) for cut in specialized.scheme.window)
    cuts = ((start, first, False), (first, last, True), (last, stop, False))
    return [cut for cut in cuts if cut[1] > cut[0]]


def _loaded_rows(specialized: Specialized) -> np.ndarray:
    """(rows,) one for the rows of the tensor in which some node is loaded."""
    loaded = np.zeros(specialized.rows, dtype=np.int32)
    loaded[np.unique(specialized.support.numpy()[:, 0])] = 1
    return loaded


PATHS: dict[str, dict[str, Callable[[Specialized], Advance]]] = {
    "cpu": {"resident": resident_cpu_path, "streaming": streaming_cpu_path},
    "cuda": {"resident": resident_cuda_path, "streaming": streaming_cuda_path},
}


def paths_of(device: wp.Device) -> dict[str, Callable[[Specialized], Advance]]:
    """The paths that a device has, by name."""
    return PATHS["cuda" if device.is_cuda else "cpu"]


def choose_path(specialized: Specialized) -> str:
    """The fastest path: resident wherever the plate fits on the chip."""
    if specialized.device.is_cpu:
        return "resident"
    nx, ny = specialized.scheme.nodes
    fits = resident_lanes.fits(nx, ny) or resident_strips.plan(nx, ny, specialized.real) is not None
    return "resident" if fits else "streaming"
