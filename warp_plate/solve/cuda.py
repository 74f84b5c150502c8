"""Paths of CUDA for plain plates: in registers where a plate fits, else several steps per pass over memory."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import resident_lanes, resident_strips, temporal_blocking
from warp_plate.kernels.cuda import LANES
from warp_plate.kernels.plans import Cut, StripPlan, cut, plan_few, strip_plans, whole
from warp_plate.plate.operator import INSIDE, plain_taps
from warp_plate.scene.errors import SceneError
from warp_plate.solve import streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State
from warp_plate.solve.streaming import Launcher, several_steps_a_launch, split_at_window

# Threads per block where each warp has its own plate.
LANES_BLOCK = 32
# 2 to FEW_PLATES plates per multiprocessor: optimise latency, with FEW_REGISTERS if at most FEW_LOADED_ROWS rows are
# loaded; more: occupancy.
FEW_PLATES, FEW_REGISTERS, FEW_LOADED_ROWS = 12, 160, 16
# Temporal blocking: steps per launch by order and precision.
LEVELS = {(2, wp.float32): 5, (2, wp.float64): 3, (4, wp.float32): 2, (4, wp.float64): 2}
# Warps of a multiprocessor below which temporal blocking divides strips into tiles.
BUSY_WARPS = 8
# Fewest rows of a tile, which must pay for its margins.
FEWEST_TILE_ROWS = 4
# Tiles of few large plates: steps per launch by order, and the longest step that is faster so.
TILE_LEVELS, MOST_LATENCY = {2: 8, 4: 3}, 72


def fits_on_chip(specialized: Specialized) -> bool:
    """Return whether the resident path can take plates of this size."""
    return takes_lanes(specialized) or plan_of(specialized) is not None


def plan_of(specialized: Specialized) -> StripPlan | None:
    """Return the distribution of a plate over a block of the device, or None where it does not fit."""
    order, nodes = specialized.scheme.order, specialized.scheme.nodes
    return next(strip_plans(order, *nodes, specialized.real, specialized.shared_bytes), None)


def takes_lanes(specialized: Specialized) -> bool:
    """Return whether a warp can have a plate."""
    return specialized.scheme.order == 2 and resident_lanes.fits(*specialized.scheme.nodes)


def resident_path(specialized: Specialized) -> Advance:
    """Return the path that runs all steps in one launch, with a plate in the registers of a warp or of a block."""
    if takes_lanes(specialized):
        return _lanes_path(specialized)
    plan = plan_of(specialized)
    if plan is None:
        nx, ny = specialized.scheme.nodes
        raise SceneError(f"path = 'resident': {nx} x {ny} nodes do not fit on one multiprocessor; write 'streaming'")
    return _blocks_path(specialized, _whole(specialized), plan)


def _lanes_path(specialized: Specialized) -> Advance:
    """Return the path with a warp per plate, or a block where multiprocessors would be idle; both give the same bits.

    Between the two, the compiler may use many registers. Each is compiled when a run first takes it.
    """
    effects, real, (nx, ny) = specialized.effects, specialized.real, specialized.scheme.nodes
    loaded = sum(1 << j for j, row in enumerate(specialized.loaded_rows[2:-2]) if row)
    x, y = plain_taps(specialized.scene.edges, (nx, ny), specialized.scheme.order)
    factors = map(specialized.to_device, (x.factors, specialized.scheme.aspect * y.factors))
    inputs = [specialized.parameters, *factors]

    # Else the numbers of a column leave no choice.
    many_registers = real is wp.float32 and loaded.bit_count() <= FEW_LOADED_ROWS

    @cache
    def with_registers(registers: int | None) -> Advance:
        with specialized.compiling_late():
            kernels = {
                summed: resident_lanes.make_run_steps(effects, real, ny, loaded, summed, registers)
                for summed in (False, True)
            }
            return _cuda_advance(specialized, kernels, inputs, LANES, LANES_BLOCK)

    @cache
    def in_blocks() -> Advance:
        with specialized.compiling_late():
            return _blocks_path(specialized, _whole(specialized), plan_few(nx, ny))

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        share = -(-plates // specialized.device.sm_count)  # plates per multiprocessor
        if share <= 1:
            path = in_blocks()
        else:
            path = with_registers(FEW_REGISTERS if share <= FEW_PLATES and many_registers else None)
        path(state, plates, start, stop)

    return advance


def _blocks_path(
    specialized: Specialized, axes: Sequence[Cut], plan: StripPlan, most_steps: int | None = None
) -> Advance:
    """Return the path with a block per tile of a plate, which is whole unless ``axes`` cut it along x and y."""
    effects, real, stride = specialized.effects, specialized.real, specialized.stride
    make_run_steps, threads = resident_strips.make_run_steps, LANES * plan.warps
    kernels = {summed: make_run_steps(effects, real, *axes, stride, plan, summed) for summed in (False, True)}
    tiles = axes[0].count * axes[1].count
    return _cuda_advance(specialized, kernels, _inputs(specialized, axes), tiles * threads, threads, most_steps)


def _whole(specialized: Specialized) -> list[Cut]:
    return [whole(nodes) for nodes in specialized.scheme.nodes]


def _inputs(specialized: Specialized, axes: Sequence[Cut]) -> list[Any]:
    """Return the first arguments of ``resident_strips``: parameters, taps or factors of a tile, loaded rows."""
    aspect, taps_y = specialized.scheme.aspect, resident_strips.make_row_taps(specialized.real)()
    x, y = plain_taps(specialized.scene.edges, (axes[0].length, axes[1].length), specialized.scheme.order)
    if specialized.scheme.order == 2:
        # Along y these kernels take an edge's curvature from its inner neighbour alone: ∇²u there is aspect·u.
        taps_x = [x.factors[:, None], aspect * y.factors[:, None]]
    else:
        special, taps_x = resident_strips.SPECIAL, [x.bend, x.move]
        taps_y.inside = aspect * np.array(INSIDE[4])
        taps_y.bend_low, taps_y.move_low = aspect * y.bend[:special], aspect * y.move[:special]
        taps_y.bend_high = aspect * y.bend[: -special - 1 : -1]
        taps_y.move_high = aspect * y.move[: -special - 1 : -1]
    return [specialized.parameters, taps_y, *map(specialized.to_device, taps_x), specialized.loaded]


def _cuda_advance(
    specialized: Specialized,
    kernels: dict[bool, wp.Kernel],
    inputs: list[Any],
    threads: int,
    block_dim: int,
    most_steps: int | None = None,
) -> Advance:
    """Return launches of a resident kernel, split where the window begins and ends: outside it sums cost nothing.

    With ``most_steps`` per launch the fields alternate. Launches are recorded with the state, which saves Python time.
    """
    specialized.load(*kernels.values(), block_dim=block_dim)
    first_at = len(inputs)  # place of the first step among the arguments

    def record(state: State, plates: int, summed: bool) -> Callable[[int, int], None]:
        command = wp.launch(
            kernels[summed],
            dim=plates * threads,
            inputs=[*inputs, 0, 0, state.drive, state.fields],
            outputs=[state.fields if most_steps is None else state.next_fields],
            device=specialized.device,
            block_dim=block_dim,
            record_cmd=True,
        )

        def launch(first: int, end: int) -> None:
            command.set_param_at_index(first_at, first)
            command.set_param_at_index(first_at + 1, end)
            command.launch()

        return launch

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        for low, high, summed in split_at_window(specialized, start, stop):
            for first in range(low, high, most_steps or high - low):
                key = (kernels[summed], plates, state.has_plate_waves, state.u.ptr)
                if key not in state.recordings:
                    state.recordings[key] = record(state, plates, summed)
                state.recordings[key](first, min(first + (most_steps or high), high))
                if most_steps is not None:
                    state.alternate()

    return advance


def streaming_path(specialized: Specialized) -> Advance:
    """Return the path of plates that no multiprocessor holds: tiles where they are few, else temporal blocking.

    All give the same bits. Traces are recorded after each step, for which only temporal blocking is made.
    """
    blocking = _blocking_path(specialized)

    @cache
    def tiled(plates: int) -> Advance | None:
        tiles = plan_tiles(specialized, plates)
        with specialized.compiling_late():
            return tiles and _blocks_path(specialized, *tiles, TILE_LEVELS[specialized.scheme.order])

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        ((None if state.nodes.shape[0] else tiled(plates)) or blocking)(state, plates, start, stop)

    return advance


def plan_tiles(specialized: Specialized, plates: int) -> tuple[list[Cut], StripPlan] | None:
    """Return a cut of each plate into tiles, at most one for each multiprocessor; None where they are too large.

    The best cut has the shortest step.
    """
    order = specialized.scheme.order
    margin, tiles = order * TILE_LEVELS[order], specialized.device.sm_count // max(1, plates)
    best, shortest = None, MOST_LATENCY + 1
    for count in range(1, tiles + 1):
        axes = [
            cut(nodes, n, margin) for nodes, n in zip(specialized.scheme.nodes, (count, tiles // count), strict=True)
        ]
        sides = axes[0].length, axes[1].length
        for plan in strip_plans(order, *sides, specialized.real, specialized.shared_bytes):
            if plan.latency < shortest:
                best, shortest = (axes, plan), plan.latency
    return best


def _blocking_path(specialized: Specialized) -> Advance:
    """Return the path of temporal blocking, with several steps per launch (one where traces are recorded)."""
    device, scheme = specialized.device, specialized.scheme
    (nx, ny), real, most_levels = scheme.nodes, specialized.real, LEVELS[scheme.order, specialized.real]
    warps = temporal_blocking.warps_of_block(scheme.order, real, most_levels, specialized.shared_bytes)
    kernels = {
        (levels, summed): temporal_blocking.make_advance_tiles(
            specialized.effects, real, nx, ny, specialized.stride, warps, levels, summed
        )
        for levels in (1, most_levels)
        for summed in (False, True)
    }
    specialized.load(*kernels.values(), block_dim=warps * LANES)
    constants = {levels: _constants(specialized, levels) for levels in (1, most_levels)}

    def launch_tiles(
        launch: Launcher, state: State, plates: int, clock: wp.array, offset: int, levels: int, summed: bool
    ) -> None:
        strips = temporal_blocking.strips(nx, temporal_blocking.REACH[scheme.order] * levels)
        tiles = tiles_of(specialized, plates * strips, ny - 2)
        launch(
            kernels[levels, summed],
            dim=plates * strips * tiles * LANES,
            inputs=[*constants[levels], clock, offset, tiles, -(-(ny - 2) // tiles), state.drive, state.fields],
            outputs=[state.next_fields],
            device=device,
            block_dim=warps * LANES,
        )

    return several_steps_a_launch(specialized, most_levels, launch_tiles)


def tiles_of(specialized: Specialized, strips: int, rows: int) -> int:
    """Return the tiles of a strip of so many rows, where there are so many strips, that keep the device busy."""
    busy = BUSY_WARPS * specialized.device.sm_count
    return max(1, min(busy // strips, rows // FEWEST_TILE_ROWS))


def _constants(specialized: Specialized, levels: int) -> list[Any]:
    """Return the first arguments of temporal blocking: parameters, taps and loaded rows, zero beyond the plate."""
    scheme = specialized.scheme
    x, y, reach = scheme.taps_x, scheme.taps_y, temporal_blocking.REACH[scheme.order]
    margin, ahead = reach * levels, temporal_blocking.ROUND[scheme.order] - reach
    inside, taps = np.zeros(5), [x.factors[:, None], y.factors[:, None]] * 2
    if scheme.order == 4:
        beyond = ((2 * margin + 1, 2 * margin + 1), (0, 0))
        inside = scheme.aspect * np.array(INSIDE[4])
        taps = [x.bend, np.pad(scheme.aspect * y.bend, beyond), x.move, np.pad(scheme.aspect * y.move, beyond)]
    back = temporal_blocking.make_rings(scheme.order, specialized.real, levels, True).rounds_back
    later = [temporal_blocking.ROUND[scheme.order] * (temporal_blocking.AHEAD + count) for count in range(back + 1)]
    loaded = streaming.loaded_ahead(specialized, margin, margin + ahead, later)
    return [specialized.parameters, inside, *map(specialized.to_device, taps), loaded]
