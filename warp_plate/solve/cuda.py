"""Paths of CUDA for plain plates: in registers where a plate fits, else several steps per pass over memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import resident_lanes, resident_strips, resident_wide, temporal_blocking, temporal_blocking_wide
from warp_plate.kernels.cuda import LANES
from warp_plate.kernels.resident_strips import StripPlan
from warp_plate.plate.operator import INSIDE
from warp_plate.scene.errors import SceneError
from warp_plate.solve import streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State
from warp_plate.solve.streaming import Launcher, several_steps_a_launch, split_at_window

# Threads per block where each warp has its own plate.
LANES_BLOCK = 32
# From 2 to FEW_PLATES per multiprocessor the speed of a plate counts, and the compiler may use FEW_REGISTERS if at most
# FEW_LOADED_ROWS rows are loaded; beyond, what counts is how many plates run side by side.
FEW_PLATES, FEW_REGISTERS, FEW_LOADED_ROWS = 12, 160, 16
# Temporal blocking: steps per launch by order and precision, and threads per block, whose warps are independent.
LEVELS = {(2, wp.float32): 5, (2, wp.float64): 2, (4, wp.float32): 2, (4, wp.float64): 1}
STREAMING_BLOCK = 128
# Fewest rows of a tile, which must pay for its margins.
FEWEST_TILE_ROWS = 4


def fits_on_chip(specialized: Specialized) -> bool:
    """Return whether the resident path can take plates of this size."""
    return takes_lanes(specialized) or plan_of(specialized) is not None


def plan_of(specialized: Specialized) -> StripPlan | None:
    """Return the distribution of a plate over a block of the device, or None where it does not fit."""
    kind = resident_wide if specialized.scheme.order == 4 else resident_strips
    return kind.plan_strips(*specialized.scheme.nodes, specialized.real, specialized.shared_bytes)


def takes_lanes(specialized: Specialized) -> bool:
    """Return whether a warp can have a plate."""
    return specialized.scheme.order == 2 and resident_lanes.fits(*specialized.scheme.nodes)


def resident_path(specialized: Specialized) -> Advance:
    """Return the path that runs all steps in one launch, with a plate in the registers of a warp or of a block.

    Raises:
        SceneError: The plate does not fit on a multiprocessor.
    """
    if takes_lanes(specialized):
        return _lanes_path(specialized)
    plan = plan_of(specialized)
    if plan is None:
        nx, ny = specialized.scheme.nodes
        raise SceneError(f"path = 'resident': {nx} x {ny} nodes do not fit on one multiprocessor; write 'streaming'")
    return (_wide_path if specialized.scheme.order == 4 else _strips_path)(specialized, plan)


def _wide_path(specialized: Specialized, plan: StripPlan) -> Advance:
    """Return the fourth-order path: a block per plate."""
    effects, real, scheme = specialized.effects, specialized.real, specialized.scheme
    kernels = {
        summed: resident_wide.make_run_steps(effects, real, *scheme.nodes, specialized.stride, plan, summed)
        for summed in (False, True)
    }
    taps_y = resident_wide.make_row_taps(real)()
    y, special = scheme.taps_y, resident_wide.SPECIAL
    taps_y.inside = scheme.aspect * np.array(INSIDE[4])
    taps_y.bend_low, taps_y.move_low = scheme.aspect * y.bend[:special], scheme.aspect * y.move[:special]
    taps_y.bend_high = scheme.aspect * y.bend[: -special - 1 : -1]
    taps_y.move_high = scheme.aspect * y.move[: -special - 1 : -1]
    bend_x, _, move_x, _ = specialized.taps
    inputs = [specialized.parameters, taps_y, bend_x, move_x, specialized.loaded]
    return _cuda_advance(specialized, kernels, inputs, LANES * plan.warps, LANES * plan.warps)


def _lanes_path(specialized: Specialized) -> Advance:
    """Return the path with a warp per plate, or a block where multiprocessors would be idle; both give the same bits.

    Between the two, the compiler may use many registers.
    """
    effects, real, (nx, ny) = specialized.effects, specialized.real, specialized.scheme.nodes
    loaded = sum(1 << j for j, row in enumerate(specialized.loaded_rows[2:-2]) if row)

    def compiled(registers: int | None) -> Advance:
        kernels = {
            summed: resident_lanes.make_run_steps(effects, real, ny, loaded, summed, registers)
            for summed in (False, True)
        }
        return _cuda_advance(specialized, kernels, _edge_factors(specialized), LANES, LANES_BLOCK)

    fewest, few = _strips_path(specialized, resident_strips.plan_few(nx, ny)), compiled(None)
    many = few
    if real is wp.float32 and loaded.bit_count() <= FEW_LOADED_ROWS:  # else the numbers of a column leave no choice
        few = compiled(FEW_REGISTERS)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        each = -(-plates // specialized.device.sm_count)
        (fewest if each <= 1 else few if each <= FEW_PLATES else many)(state, plates, start, stop)

    return advance


def _strips_path(specialized: Specialized, plan: StripPlan) -> Advance:
    """Return the second-order path with a block per plate."""
    effects, real, nodes = specialized.effects, specialized.real, specialized.scheme.nodes
    kernels = {
        summed: resident_strips.make_run_steps(effects, real, *nodes, specialized.stride, plan, summed)
        for summed in (False, True)
    }
    inputs = [*_edge_factors(specialized), specialized.loaded]
    return _cuda_advance(specialized, kernels, inputs, LANES * plan.warps, LANES * plan.warps)


def _edge_factors(specialized: Specialized) -> list[Any]:
    """Return the first arguments of the resident kernels of second order: parameters, and factors on the edges."""
    scheme = specialized.scheme
    # Along y these kernels take an edge's curvature from its inner neighbour alone: ∇²u there is aspect·u.
    factors = [specialized.to_device(f) for f in (scheme.taps_x.factors, scheme.aspect * scheme.taps_y.factors)]
    return [specialized.parameters, *factors]


def _cuda_advance(
    specialized: Specialized, kernels: dict[bool, wp.Kernel], inputs: list[Any], threads: int, block_dim: int
) -> Advance:
    """Return launches of a resident kernel, split where the window begins and ends: outside it sums cost nothing."""
    device = specialized.device
    specialized.load(*kernels.values(), block_dim=block_dim)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        for low, high, summed in split_at_window(specialized, start, stop):
            wp.launch(
                kernels[summed],
                dim=plates * threads,
                inputs=[*inputs, state.wave, low, high, state.in_phase, state.quadrature],
                outputs=[state.u, state.rate, state.squares],
                device=device,
                block_dim=block_dim,
            )

    return advance


def streaming_path(specialized: Specialized) -> Advance:
    """Return the path with several steps per launch (one where traces are recorded)."""
    device, scheme = specialized.device, specialized.scheme
    (nx, ny), most_levels = scheme.nodes, LEVELS[scheme.order, specialized.real]
    blocking = temporal_blocking_wide if scheme.order == 4 else temporal_blocking
    kernels = {
        (levels, summed): blocking.make_advance_tiles(
            specialized.effects, specialized.real, nx, ny, specialized.stride, levels, summed
        )
        for levels in (1, most_levels)
        for summed in (False, True)
    }
    specialized.load(*kernels.values(), block_dim=STREAMING_BLOCK)
    constants = {levels: _constants(specialized, blocking, levels) for levels in (1, most_levels)}

    def launch_tiles(
        launch: Launcher, state: State, plates: int, clock: wp.array, offset: int, levels: int, summed: bool
    ) -> None:
        strips = blocking.strips(nx, levels)
        tiles = tiles_of(specialized, plates * strips, ny - 2)
        launch(
            kernels[levels, summed],
            dim=plates * strips * tiles * LANES,
            inputs=[*constants[levels], state.wave, clock, offset, tiles, -(-(ny - 2) // tiles)]
            + [state.in_phase, state.quadrature, state.u, state.rate],
            outputs=[state.u_next, state.rate_next, state.squares],
            device=device,
            block_dim=STREAMING_BLOCK,
        )

    return several_steps_a_launch(specialized, most_levels, launch_tiles)


def tiles_of(specialized: Specialized, strips: int, rows: int) -> int:
    """Return the tiles of a strip of so many rows, where there are so many strips, that keep the device busy."""
    busy = temporal_blocking.WARPS * specialized.device.sm_count
    return max(1, min(busy // strips, rows // FEWEST_TILE_ROWS))


def _constants(specialized: Specialized, blocking: Any, levels: int) -> list[Any]:
    """Return the first arguments of a streaming kernel: parameters, taps and loaded rows, zero beyond the plate."""
    scheme, margin = specialized.scheme, blocking.REACH * levels
    taps: list[Any]
    if scheme.order == 2:
        taps = [specialized.to_device(taps.factors) for taps in (scheme.taps_x, scheme.taps_y)]
    else:
        x, y, beyond = scheme.taps_x, scheme.taps_y, 2 * margin + 1
        rows = [np.pad(scheme.aspect * taps, ((beyond, beyond), (0, 0))) for taps in (y.bend, y.move)]
        taps = [scheme.aspect * np.array(INSIDE[4])]
        taps += map(specialized.to_device, (x.bend, rows[0], x.move, rows[1]))
    ahead = streaming.loaded_ahead(specialized, margin, margin + blocking.ROUND - blocking.REACH)
    return [specialized.parameters, *taps, ahead]
