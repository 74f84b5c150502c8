"""The paths of CUDA devices: plates in registers where they fit, else several steps a pass over memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import record, resident_lanes, resident_strips, resident_wide
from warp_plate.kernels import temporal_blocking as streaming_march
from warp_plate.kernels.cuda import LANES
from warp_plate.plate.operator import INSIDE
from warp_plate.scene.errors import SceneError
from warp_plate.solve import streaming
from warp_plate.solve.launches import Launcher, repeat
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State

# Threads a block where each warp has its own plate. Up to so many plates a multiprocessor, a plate's own speed counts
# and the compiler may take as many registers as pay; beyond, what counts is how many plates run side by side.
LANES_BLOCK = 32
FEW_PLATES, FEW_REGISTERS, FEW_LOADED_ROWS = 12, 160, 16
# Launches that are put together; even, so that buffers that take turns end where they began.
LAUNCHES = 16
# Threads a block on the streaming path, whose warps know nothing of each other.
MARCH_BLOCK = 128
# As many warps as keep a large GPU busy, and the fewest rows that are worth a tile with its margins.
MARCH_WARPS = 4096
MARCH_ROWS = 16


@dataclass(frozen=True)
class March:
    """How the streaming path cuts a plate: columns a lane, steps a launch, rows a tile (None: to suit the device)."""

    columns: int = 2
    levels: int = 4
    tile_rows: int | None = None
    registers: int | None = None

    def tiles(self, strips: int, moving_rows: int) -> int:
        """Tiles along y for so many strips on the whole device."""
        if self.tile_rows:
            return -(-moving_rows // self.tile_rows)
        return max(1, min(-(-MARCH_WARPS // strips), moving_rows // MARCH_ROWS))


def fits_on_chip(specialized: Specialized) -> bool:
    """Whether the resident path can take plates of this size."""
    nx, ny = specialized.scheme.nodes
    if specialized.scheme.order == 4:
        return resident_wide.plan(nx, ny, specialized.real) is not None
    return resident_lanes.fits(nx, ny) or resident_strips.plan(nx, ny, specialized.real) is not None


def resident_path(specialized: Specialized) -> Advance:
    """All steps in one launch, the plate in the registers of a warp or of a block."""
    nx, ny = specialized.scheme.nodes
    if not fits_on_chip(specialized):
        raise SceneError(f"path = 'resident': {nx} x {ny} nodes do not fit on one multiprocessor; write 'streaming'")
    if specialized.scheme.order == 4:
        return wide_path(specialized, resident_wide.plan(nx, ny, specialized.real))
    if resident_lanes.fits(nx, ny):
        return _lanes_path(specialized)
    return strips_path(specialized, resident_strips.plan(nx, ny, specialized.real))


def wide_path(specialized: Specialized, wide: resident_wide.Wide) -> Advance:
    """Fourth order: a block a plate, cut as ``wide`` says."""
    effects, real, scheme = specialized.effects, specialized.real, specialized.scheme
    kernels = {
        summed: resident_wide.make_run(effects, real, *scheme.nodes, specialized.stride, wide, summed)
        for summed in (False, True)
    }
    closures = resident_wide.make_closures(real)()
    y, special = scheme.taps_y, resident_wide.SPECIAL
    closures.inside = scheme.aspect * np.array(INSIDE[4])
    closures.bend_low, closures.move_low = scheme.aspect * y.bend[:special], scheme.aspect * y.move[:special]
    closures.bend_high = scheme.aspect * y.bend[: -special - 1 : -1]
    closures.move_high = scheme.aspect * y.move[: -special - 1 : -1]
    bend_x, _, move_x, _ = specialized.taps
    loaded: wp.array = wp.array(specialized.loaded_rows, dtype=int, device=specialized.device)
    inputs = [specialized.parameters, closures, bend_x, move_x, loaded]
    threads = LANES * wide.warps
    return _cuda_advance(specialized, kernels, inputs, threads, threads)


def _lanes_path(specialized: Specialized) -> Advance:
    """A warp a plate: compiled twice, with many registers for few plates and with few for many plates at a time."""
    effects, real, ny = specialized.effects, specialized.real, specialized.scheme.nodes[1]
    loaded = sum(1 << j for j, row in enumerate(specialized.loaded_rows[2:-2]) if row)

    def compiled(registers: int | None) -> Advance:
        kernels = {
            summed: resident_lanes.make_run(effects, real, ny, loaded, summed, registers) for summed in (False, True)
        }
        return _cuda_advance(specialized, kernels, _edges(specialized), LANES, LANES_BLOCK)

    if real is wp.float64 or loaded.bit_count() > FEW_LOADED_ROWS:
        return compiled(None)  # the numbers that stay in registers leave no choice
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
    loaded: wp.array = wp.array(specialized.loaded_rows, dtype=int, device=specialized.device)
    threads = LANES * strips.warps
    return _cuda_advance(specialized, kernels, [*_edges(specialized), loaded], threads, threads)


def _edges(specialized: Specialized) -> list[Any]:
    """The first arguments of the resident kernels of second order: parameters, factors of the edges."""
    scheme = specialized.scheme
    # Along y these kernels take the curvature of an edge from its inner neighbour alone: ∇²u there is aspect·u.
    edges = [specialized.to_device(f) for f in (scheme.taps_x.factors, scheme.aspect * scheme.taps_y.factors)]
    return [specialized.parameters, *edges]


def _cuda_advance(
    specialized: Specialized, kernels: dict[bool, wp.Kernel], inputs: list[Any], threads: int, block_dim: int
) -> Advance:
    """Launches of a resident CUDA kernel, cut where the window begins and ends: the sums cost nothing outside it."""
    device = specialized.device
    for kernel in kernels.values():
        wp.load_module(module=kernel.module, device=device, block_dim=block_dim)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        for low, high, summed in _cut_at_window(specialized, start, stop):
            wp.launch(
                kernels[summed],
                dim=plates * threads,
                inputs=[*inputs, state.wave, low, high, state.in_phase, state.quadrature],
                outputs=[state.u, state.rate, state.squares],
                device=device,
                block_dim=block_dim,
            )

    return advance


def streaming_path(specialized: Specialized, march: March | None = None) -> Advance:
    """Several steps a launch; a launch for each where the trace is kept."""
    if specialized.scheme.order == 4:
        return streaming.streaming_path(specialized)
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
    keep = record.make_record(specialized.real)
    for kernel in kernels.values():
        wp.load_module(module=kernel.module, device=device, block_dim=MARCH_BLOCK)
    for kernel in (keep, record.advance_clock):
        wp.load_module(module=kernel.module, device=device)
    loaded: wp.array = wp.array(specialized.loaded_rows, dtype=int, device=device)
    factors = [specialized.to_device(taps.factors) for taps in (scheme.taps_x, scheme.taps_y)]
    shared = [specialized.parameters, *factors, loaded]
    clock = wp.zeros(1, dtype=int, device=device)

    def launches(launch: Launcher, state: State, plates: int, count: int, levels: int, summed: bool) -> None:
        strips = -(-(nx - 2) // streaming_march.useful_columns(march.columns, levels))
        tiles = march.tiles(plates * strips, ny - 2)
        for index in range(count):
            launch(
                kernels[levels, summed],
                dim=plates * strips * tiles * LANES,
                inputs=[*shared, state.wave, clock, index * levels, tiles, -(-(ny - 2) // tiles)]
                + [state.in_phase, state.quadrature, state.u, state.rate],
                outputs=[state.u_next, state.rate_next, state.squares],
                device=device,
                block_dim=MARCH_BLOCK,
            )
            state.u, state.u_next = state.u_next, state.u
            state.rate, state.rate_next = state.rate_next, state.rate
            if state.nodes.shape[0]:
                inputs = [clock, index, state.nodes, state.u]
                outputs = [state.trace]
                launch(keep, dim=(plates, state.nodes.shape[0]), inputs=inputs, outputs=outputs, device=device)
        launch(record.advance_clock, dim=1, inputs=[clock, count * levels], device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        levels = 1 if state.nodes.shape[0] else march.levels  # a trace needs every step
        for low, high, summed in _cut_at_window(specialized, start, stop):
            deep, rest = divmod(high - low, levels)
            runs, deep = divmod(deep, LAUNCHES)
            for _ in range(runs):
                repeat(device, launches, state, plates, LAUNCHES, levels, summed)
            if deep:
                launches(wp.launch, state, plates, deep, levels, summed)
            if rest:
                launches(wp.launch, state, plates, rest, 1, summed)

    return advance


def _cut_at_window(specialized: Specialized, start: int, stop: int) -> list[tuple[int, int, bool]]:
    """(first, last + 1, inside) of the runs of steps before, inside and after the window."""
    first, last = (min(max(cut, start), stop) for cut in specialized.scheme.window)
    cuts = ((start, first, False), (first, last, True), (last, stop, False))
    return [cut for cut in cuts if cut[1] > cut[0]]
