"""Paths of the CPU for plain plates: plates in the cores' caches, distributed by Python threads."""

import contextlib
import ctypes
import os
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

# Fewest numbers in a plate that a team of threads shares; its members meet twice a step.
TEAM_NUMBERS = 8192
# More than ever arrive at a meeting: releases all who wait.
RELEASE = 2**30
# Groups of plates pay while a group's workspace stays in a core's second-level cache, and if at least this share of a
# group is used, by order. (Measured: a group of 16 takes as long as 13 single plates of 27 × 27, of fourth order as 8.)
GROUP_BYTES = 2**20
GROUP_FILL = {2: 0.85, 4: 0.5}
# Node-steps of plates that could have run in groups before the kernel of groups is compiled, which takes half a second:
# so many take 0.1 s one plate at a time, and two fifths less in groups.
GROUP_WORK = 5e8
# Lock for the one team that may run: its members wait for each other, so all must run at once.
_TEAM = threading.Lock()
# Address of the C function with which a thread yields its core.
_LIBRARY, _NAME = ("kernel32", "SwitchToThread") if sys.platform == "win32" else (None, "sched_yield")
_YIELD = ctypes.cast(getattr(ctypes.CDLL(_LIBRARY), _NAME), ctypes.c_void_p).value


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Return a permanent pool; threads as many as the cores are bound to one core each.

    Linux wakes a thread on the core of its caller, and takes longer than a short run to move one of the two.
    """
    cores: SimpleQueue[int] = SimpleQueue()
    if hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == threads:
        for core in sorted(os.sched_getaffinity(0)):
            cores.put(core)

    def bind() -> None:
        with contextlib.suppress(Empty):
            os.sched_setaffinity(0, {cores.get_nowait()})

    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warp-plate", initializer=bind)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a fork copies no threads


def run_concurrently(calls: Sequence[Callable[[], None]], on_failure: Callable[[], object] = lambda: None) -> None:
    """Make the calls on a thread each; none still runs when this returns or is interrupted."""
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


def distribute(threads: int, plates: int, run_share: Callable[[int, int, int], None]) -> None:
    """Call ``run_share(thread, first, last + 1)`` on each thread with its share of the plates."""
    bounds = np.linspace(0, plates, min(threads, plates) + 1).astype(int).tolist()
    run_concurrently([partial(run_share, thread, *share) for thread, share in enumerate(pairwise(bounds))])


def resident_path(specialized: Specialized) -> Advance:
    """Return the path that runs all steps in one launch per thread (Warp releases Python's lock)."""
    ny, stride, threads = specialized.scheme.nodes[1], specialized.stride, specialized.threads
    launch_single = _single_plates(specialized)
    lanes, fill = _lanes_of_groups(specialized), GROUP_FILL[specialized.scheme.order]
    make_groups = cache(partial(_plate_groups, specialized, lanes))
    work = 0.0  # node-steps of plates that could run in groups

    def in_groups(plates: int) -> int:
        """Return how many of a thread's plates run in groups, which are full enough; the rest run singly."""
        full, rest = divmod(plates, lanes) if lanes else (0, 0)
        return plates if lanes and rest >= fill * lanes else full * lanes

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if plates < threads and ny * stride >= TEAM_NUMBERS:
            with _TEAM:
                for plate in range(plates):
                    arrived = wp.zeros(1, dtype=int, device=specialized.device)
                    teams = [make_team(threads, member, arrived) for member in range(threads)]
                    calls = [partial(launch_single, state, plate, plate + 1, start, stop, team) for team in teams]
                    # If a member fails, the others must not wait for it.
                    run_concurrently(calls, partial(arrived.fill_, RELEASE))
            return

        nonlocal work
        grouped_share = 0 if state.has_plate_waves else in_groups(-(-plates // threads))
        work += threads * grouped_share * ny * stride * (stop - start)
        launch_groups = None
        if grouped_share and work >= GROUP_WORK:
            with specialized.compiling_late():
                launch_groups = make_groups()

        def run_share(thread: int, first: int, last: int) -> None:
            grouped = first
            if launch_groups is not None:
                grouped += in_groups(last - first)
                if grouped > first:
                    launch_groups(state, thread, first, grouped, start, stop)
            if last > grouped:
                launch_single(state, grouped, last, start, stop)

        distribute(threads, plates, run_share)

    return advance


def _single_plates(specialized: Specialized) -> Callable[..., None]:
    """Return launch(state, first, last + 1, start, stop[, team]) of ``resident_cpu``; team: size, member, meeting."""
    device, stride, (nx, ny) = specialized.device, specialized.stride, specialized.scheme.nodes
    kernel = resident_cpu.make_run_steps(specialized.effects, specialized.real, ny, stride)
    specialized.load(kernel)
    rows = ny - 2 - 2 * resident_cpu.end_rows(specialized.scheme.order)
    stiffness = np.zeros((rows if resident_cpu.walked_flat(ny, stride) else 1, stride))
    stiffness[:, 1 : nx - 1] = specialized.parameters.stiffness  # zero where held or padding
    factors, window = _factors(specialized), wp.vec2i(*specialized.scheme.window)
    factors.stiffness = specialized.to_device(stiffness.ravel())
    alone = make_team(1, 0, wp.zeros(1, dtype=int, device=device))

    def launch(state: State, first: int, last: int, start: int, stop: int, team: Any = alone) -> None:
        inputs = [specialized.parameters, factors, window, start, stop, first, team, state.drive]
        wp.launch(kernel, dim=last - first, inputs=inputs, outputs=[state.fields, state.u_next], device=device)

    return launch


def make_team(size: int, member: int, arrived: wp.array) -> Any:
    """Return the struct of a member of a team."""
    team = resident_cpu.Team()
    team.size, team.member, team.arrived, team.yield_core = size, member, arrived, _YIELD
    return team


def _lanes_of_groups(specialized: Specialized) -> int:
    """Return the plates of a group, or 0 where a group is too large for the cache."""
    itemsize = wp.types.type_size_in_bytes(specialized.real)
    lanes = LINE_BYTES // itemsize
    size = resident_cpu_groups.workspace_size(*specialized.scheme.nodes, lanes, specialized.scheme.order)
    return lanes if size * itemsize <= GROUP_BYTES else 0


def _plate_groups(specialized: Specialized, lanes: int) -> Callable[..., None]:
    """Return launch(state, thread, first, last + 1, start, stop) of ``resident_cpu_groups``; plates of a group share
    their waves."""
    device, scheme = specialized.device, specialized.scheme
    size = resident_cpu_groups.workspace_size(*scheme.nodes, lanes, scheme.order)
    kernel = resident_cpu_groups.make_run_steps(
        specialized.effects, specialized.real, *scheme.nodes, specialized.stride, lanes
    )
    specialized.load(kernel)
    factors, window = _factors(specialized, lanes), wp.vec2i(*scheme.window)
    workspace = wp.zeros((specialized.threads, size), dtype=specialized.real, device=device)

    def launch(state: State, thread: int, first: int, last: int, start: int, stop: int) -> None:
        inputs = [specialized.parameters, factors, window, start, stop, first, last, thread, state.drive]
        dim = -(-(last - first) // lanes)
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=[state.fields, workspace], device=device)

    return launch


def _factors(specialized: Specialized, lanes: int | None = None) -> Any:
    """Return the struct of what both passes read beside the fields, of single plates or of groups of ``lanes``."""
    factors = resident_cpu.make_factors(specialized.real)()
    factors.bend_x, factors.move_x = _taps_along_x(specialized, lanes)
    factors.bend_y, factors.move_y = _taps_along_y(specialized)
    factors.loaded = specialized.loaded
    return factors


def _taps_along_x(specialized: Specialized, lanes: int | None = None) -> tuple[wp.array, wp.array]:
    """Return what both passes read along x: curvature factors and nothing, or five lines of taps each (order 4).

    For the ranges of ``resident_cpu``, or for a row with each node ``lanes`` times.
    """
    scheme, stride = specialized.scheme, specialized.stride
    nx, ny = scheme.nodes

    def lines(values: np.ndarray, rows: int = 1) -> wp.array:
        if lanes is not None:
            return specialized.to_device(np.repeat(values, lanes, axis=1).ravel())
        return specialized.to_device(np.tile(np.pad(values, ((0, 0), (0, stride - nx))), rows).ravel())

    if scheme.order == 4:
        rows = resident_cpu.tap_line(ny, stride, scheme.order) // stride
        return lines(scheme.taps_x.bend.T, rows), lines(scheme.taps_x.move.T, rows)
    flat = lanes is None and resident_cpu.walked_flat(ny, stride)
    factor_y = scheme.taps_y.factors if flat else scheme.taps_y.factors[[0, 1, -1]]
    return lines(np.outer(factor_y, scheme.taps_x.factors)), specialized.to_device(np.zeros(1))


def _taps_along_y(specialized: Specialized) -> tuple[wp.array, wp.array]:
    """Return what both passes read along y: the aspect, or the taps of every row of the plate (order 4)."""
    scheme = specialized.scheme
    if scheme.order == 2:
        aspect = specialized.to_device(np.full((1, 1), scheme.aspect))
        return aspect, aspect
    bend = scheme.aspect * scheme.taps_y.bend
    # The stencil of an edge's row ends with the tensor, one row beyond the edge.
    bend[0], bend[-1] = np.roll(bend[0], -1), np.roll(bend[-1], 1)
    return specialized.to_device(bend), specialized.to_device(scheme.aspect * scheme.taps_y.move)
