"""The paths of the CPU: plates in the cache of the cores, shared among them by Python threads."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache, partial
from itertools import pairwise
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import resident_cpu, resident_cpu_groups
from warp_plate.solve.specialize import LINE_BYTES, Specialized
from warp_plate.solve.state import Advance, State

# A single plate with at least so many nodes is worth a crew of threads, which meet twice a step.
CREW_NODES = 8192
# More members than ever come to a meeting: lets all who wait go on.
EVERYBODY = 2**30
# Groups of plates pay while one group's room stays in a core's second-level cache, and from this share of a group on
# (measured: a group of 16 takes as long as 13 single plates of 27 × 27, of fourth order as 8).
GROUP_BYTES = 2**20
GROUP_FILL = {2: 0.85, 4: 0.5}


def compiler_flags() -> str:
    """How LLVM compiles the CPU kernels: whole vectors and fused multiply-adds."""
    wide = " -mprefer-vector-width=512" if platform.machine().lower() in ("x86_64", "amd64") else ""
    return "-march=native -ffp-contract=fast -mllvm=-force-vector-interleave=4" + wide


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that stay; where they are as many as the cores, each on a core of its own.

    Left to itself, Linux wakes a thread on the core that called it, and needs longer than a short run to part the two.
    """
    cores: SimpleQueue[int] = SimpleQueue()
    if hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == threads:
        for core in sorted(os.sched_getaffinity(0)):
            cores.put(core)

    def settle() -> None:
        with contextlib.suppress(Empty):
            os.sched_setaffinity(0, {cores.get_nowait()})

    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warp-plate", initializer=settle)


# One crew at a time: its members wait for each other, so that all must run at once.
_CREW = threading.Lock()


def _yield_address() -> int:
    """Address of the C function with which a thread gives up its core for a while."""
    if sys.platform == "win32":
        function = ctypes.windll.kernel32.SwitchToThread
    else:
        function = ctypes.CDLL(None).sched_yield
    return ctypes.cast(function, ctypes.c_void_p).value or 0


_YIELD = _yield_address()


def resident_path(specialized: Specialized) -> Advance:
    """All steps in one launch, plates shared among the cores by Python threads (Warp frees Python's lock)."""
    ny, stride, threads = specialized.scheme.nodes[1], specialized.stride, specialized.threads
    singly, by_groups = _cpu_singly(specialized), _cpu_by_groups(specialized)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if plates < threads and ny * stride >= CREW_NODES:
            with _CREW:
                for plate in range(plates):
                    arrived = wp.zeros(1, dtype=int, device=specialized.device)
                    crew = [(threads, member, arrived) for member in range(threads)]
                    calls = [partial(singly, state, plate, plate + 1, start, stop, one) for one in crew]
                    # Should a member fail, the others must not wait for it for ever.
                    _at_once(calls, partial(arrived.fill_, EVERYBODY))
            return
        shares = enumerate(_shares(threads, plates))
        _at_once([partial(_cpu_share, singly, by_groups, state, *share, start, stop) for share in shares])

    return advance


def _shares(threads: int, plates: int) -> list[tuple[int, int]]:
    """(first, last + 1) of the plates of each thread."""
    return list(pairwise(np.linspace(0, plates, min(threads, plates) + 1).astype(int).tolist()))


def shared_among_threads(threads: int, plates: int, share: Callable[[int, int, int], Callable[[], None]]) -> None:
    """Make the calls share(thread, first, last + 1) side by side."""
    _at_once([share(thread, first, last) for thread, (first, last) in enumerate(_shares(threads, plates))])


def _cpu_share(
    singly: Any, by_groups: Any, state: State, thread: int, plates: tuple[int, int], start: int, stop: int
) -> None:
    """Plates first ... last − 1 on one thread: in groups as long as these are full enough, the rest singly."""
    low, high = plates
    grouped = low
    if by_groups is not None and not state.has_plate_waves:  # the plates of a group share their waves
        launch, lanes, fill = by_groups
        groups, rest = divmod(high - low, lanes)
        grouped = high if rest >= fill * lanes else low + groups * lanes
        if grouped > low:
            launch(state, thread, low, grouped, start, stop)
    if high > grouped:
        singly(state, grouped, high, start, stop)


def _cpu_singly(specialized: Specialized) -> Callable[..., None]:
    """Launches ``resident_cpu`` on plates first ... last − 1; ``crew``: members, which one, and their meeting."""
    device, stride, ny = specialized.device, specialized.stride, specialized.scheme.nodes[1]
    kernel = resident_cpu.make_run(specialized.effects, specialized.real, ny, stride, compiler_flags())
    wp.load_module(module=kernel.module, device=device)
    shared: list[Any] = [specialized.parameters, *_taps_along_x(specialized), *_taps_along_y(specialized)]
    stiffnesses, window = _stiffnesses(specialized), wp.vec2i(*specialized.scheme.window)
    alone = (1, 0, wp.zeros(1, dtype=int, device=device))

    def launch(state: State, first: int, last: int, start: int, stop: int, crew: tuple[Any, ...] = alone) -> None:
        inputs = [*shared, stiffnesses, state.wave, window, start, stop, first, *crew, _YIELD, state.nodes]
        inputs += [state.in_phase, state.quadrature]
        outputs = [state.u, state.rate, state.squares, state.u_next, state.trace]
        wp.launch(kernel, dim=last - first, inputs=inputs, outputs=outputs, device=device)

    return launch


def _cpu_by_groups(specialized: Specialized) -> tuple[Callable[..., None], int, float] | None:
    """Launches ``resident_cpu_groups``; plates a group; the share of one that pays. None where a group is too large."""
    device, scheme = specialized.device, specialized.scheme
    itemsize = wp.types.type_size_in_bytes(specialized.real)
    lanes = LINE_BYTES // itemsize
    room = resident_cpu_groups.room_of(*scheme.nodes, lanes, scheme.order)
    if room * itemsize > GROUP_BYTES:
        return None
    kernel = resident_cpu_groups.make_run_groups(
        specialized.effects, specialized.real, *scheme.nodes, specialized.stride, lanes, compiler_flags()
    )
    wp.load_module(module=kernel.module, device=device)
    loaded: wp.array = wp.array(specialized.loaded_rows, dtype=int, device=device)
    shared = [specialized.parameters, *_taps_along_x(specialized, lanes), *_taps_along_y(specialized)]
    shared += [loaded, specialized.wave, wp.vec2i(*scheme.window)]
    rooms = wp.zeros((specialized.threads, room), dtype=specialized.real, device=device)

    def launch(state: State, thread: int, first: int, last: int, start: int, stop: int) -> None:
        inputs = [*shared, start, stop, first, last, thread, state.nodes, state.in_phase, state.quadrature]
        outputs = [rooms, state.u, state.rate, state.squares, state.trace]
        wp.launch(kernel, dim=-(-(last - first) // lanes), inputs=inputs, outputs=outputs, device=device)

    return launch, lanes, GROUP_FILL[scheme.order]


def _at_once(calls: Sequence[Callable[[], None]], on_failure: Callable[[], object] = lambda: None) -> None:
    """Make the calls side by side; none runs on when this returns or is interrupted."""
    if len(calls) == 1:
        calls[0]()
        return
    pending: list[Future[None]] = []
    try:
        for call in calls:
            pending.append(_pool(len(calls)).submit(call))
        for future in pending:
            future.result()
    except BaseException:
        on_failure()
        raise
    finally:
        wait(pending)


def _taps_along_x(specialized: Specialized, lanes: int | None = None) -> tuple[wp.array, wp.array]:
    """What both passes read along x, for the ranges of ``resident_cpu`` or for a row with each node ``lanes`` times.

    Of second order factors on the curvature, and nothing; of fourth order five lines of taps.
    """
    scheme, stride = specialized.scheme, specialized.stride
    nx, ny = scheme.nodes

    def lines(values: np.ndarray, rows: int = 1) -> wp.array:
        if lanes is not None:
            return specialized.to_device(np.repeat(values, lanes, axis=1).ravel())
        return specialized.to_device(np.tile(np.pad(values, ((0, 0), (0, stride - nx))), rows).ravel())

    if scheme.order == 4:
        rows = resident_cpu.line_of(ny, stride, scheme.order) // stride
        return lines(scheme.taps_x.bend.T, rows), lines(scheme.taps_x.move.T, rows)
    whole = lanes is None and resident_cpu.ranges(ny, stride, scheme.order) is not None
    factor_y = scheme.taps_y.factors if whole else scheme.taps_y.factors[[0, 1, -1]]
    return lines(np.outer(factor_y, scheme.taps_x.factors)), specialized.to_device(np.zeros(1))


def _taps_along_y(specialized: Specialized) -> tuple[wp.array, wp.array]:
    """What both passes read along y: the aspect, or a row of taps for every row of the plate."""
    scheme = specialized.scheme
    if scheme.order == 2:
        aspect = specialized.to_device(np.full((1, 1), scheme.aspect))
        return aspect, aspect
    bend = scheme.aspect * scheme.taps_y.bend
    # The window of an edge's row ends with the tensor, one row beyond the edge.
    bend[0], bend[-1] = np.roll(bend[0], -1), np.roll(bend[-1], 1)
    return specialized.to_device(bend), specialized.to_device(scheme.aspect * scheme.taps_y.move)


def _stiffnesses(specialized: Specialized) -> wp.array:
    """(rows of the longest range · stride,) stiffness of the nodes, zero where one is held or padding."""
    (nx, ny), stride = specialized.scheme.nodes, specialized.stride
    whole = resident_cpu.ranges(ny, stride, specialized.scheme.order)
    stiffness = np.zeros((max(rows for _, rows in whole[1]) if whole else 1, stride))
    stiffness[:, 1 : nx - 1] = specialized.parameters.stiffness
    return specialized.to_device(stiffness.ravel())
