"""Resident path on CPU for many plates: a group of plates side by side, the plates innermost in memory.

In a group, node i of plate k lies at i·lanes + k, so that a vector holds the same node of several plates: neighbours
along x lie whole vectors apart, no number is padding, and a plate's width does not matter. To the two passes of
``resident_cpu`` it is one plate with rows ``lanes`` times as long, of which they take one at a time. The batched
tensors keep their layout: a launch copies a group in, runs all steps, and copies it out.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.resident_cpu import make_passes
from warp_plate.kernels.update import make_parameters

# Planes of one group's room: u, rate, squares, in phase, quadrature; and the rows of curvature that are in use.
PLANES, CURVED_ROWS = 5, 3


def room_of(nx, ny, lanes):
    """Numbers in the room of one thread."""
    return (PLANES * (ny + 2) + CURVED_ROWS) * nx * lanes


@cache
def make_run_groups(effects, real, nx, ny, stride, lanes, compiler_flags):
    """Steps ``start`` ... ``stop`` − 1 of ``lanes`` plates at a time; launch over (groups,), from plate ``first`` on.

    Plates from ``last`` on are not there: their lanes run empty. room: (threads, room_of(nx, ny, lanes)), of which the
    launch uses line ``thread``. factor: curvature factors of the bottom, an inner and the top row, repeated for each
    lane; loaded: (ny + 2,) one for the rows of the tensor in which some node is loaded, else zero; wave, window,
    nodes, trace: as in ``resident_cpu``.
    """
    Parameters = make_parameters(real)
    row = nx * lanes
    bend, move, move_unloaded = make_passes(effects, real, row, lanes, row, row - 2 * lanes, False)
    wave_of = wp.types.vector(length=2, dtype=real)
    size = wp.types.type_size_in_bytes(real)
    row_bytes, node_bytes = row * size, lanes * size
    plane_bytes = (ny + 2) * row_bytes

    @wp.func
    def copy_in(field: wp.array3d[real], plane: wp.uint64, first: int, last: int):
        inside = wp.array(ptr=plane, shape=(wp.static((ny + 2) * row),), dtype=real)
        for lane in range(wp.static(lanes)):
            there = first + lane < last
            for j in range(1, wp.static(ny + 1)):
                for i in range(wp.static(nx)):
                    value = real(0.0)
                    if there:
                        value = field[first + lane, j, i]
                    inside[(j * wp.static(nx) + i) * wp.static(lanes) + lane] = value

    @wp.func
    def copy_out(plane: wp.uint64, field: wp.array3d[real], first: int, last: int):
        inside = wp.array(ptr=plane, shape=(wp.static((ny + 2) * row),), dtype=real)
        for lane in range(wp.min(wp.static(lanes), last - first)):
            for j in range(1, wp.static(ny + 1)):
                for i in range(wp.static(nx)):
                    field[first + lane, j, i] = inside[(j * wp.static(nx) + i) * wp.static(lanes) + lane]

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": 1},
    )
    def run_groups(
        p: Parameters,
        factor: wp.array[real],
        loaded: wp.array[int],
        wave: wp.array2d[real],
        window: wp.vec2i,
        start: int,
        stop: int,
        first: int,
        last: int,
        thread: int,
        nodes: wp.array2d[int],
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        room: wp.array2d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
        trace: wp.array3d[real],
    ):
        low = first + wp.tid() * wp.static(lanes)
        in_u = room.ptr + wp.uint64(thread) * wp.uint64(room.shape[1] * wp.static(size))
        in_rate = in_u + wp.uint64(wp.static(1 * plane_bytes))
        in_squares = in_u + wp.uint64(wp.static(2 * plane_bytes))
        in_cosine = in_u + wp.uint64(wp.static(3 * plane_bytes))
        in_sine = in_u + wp.uint64(wp.static(4 * plane_bytes))
        bent = in_u + wp.uint64(wp.static(5 * plane_bytes))
        inner_factor = factor.ptr + wp.uint64(wp.static(row_bytes))
        top_factor = factor.ptr + wp.uint64(wp.static(2 * row_bytes))
        copy_in(u, in_u, low, last)
        copy_in(rate, in_rate, low, last)
        copy_in(squares, in_squares, low, last)
        copy_in(in_phase, in_cosine, low, last)
        copy_in(quadrature, in_sine, low, last)
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = wave_of(wave[n, 0], wave[n, 1])
            # Curvatures of three rows take turns in three places: row r lies in place r mod 3.
            bend(in_u, factor.ptr, bent, p.aspect)
            bend(in_u + wp.uint64(wp.static(row_bytes)), inner_factor, bent + wp.uint64(wp.static(row_bytes)), p.aspect)
            for r in range(1, wp.static(ny - 1)):
                # Row r moves once the curvature of the row above it is known.
                above = bent + wp.uint64((r + 1) % 3 * wp.static(row_bytes))
                above_factor = wp.where(r == wp.static(ny - 2), top_factor, inner_factor)
                bend(in_u + wp.uint64((r + 1) * wp.static(row_bytes)), above_factor, above, p.aspect)
                at = wp.uint64((r + 1) * wp.static(row_bytes) + wp.static(node_bytes))
                node = wp.uint64(wp.static(node_bytes))
                south = bent + wp.uint64((r - 1) % 3 * wp.static(row_bytes)) + node
                centre = bent + wp.uint64(r % 3 * wp.static(row_bytes)) + node
                if loaded[r + 1] != 0:
                    move(
                        p, factor.ptr, waves, summed, south, centre, above + node,
                        in_cosine + at, in_sine + at, in_u + at, in_rate + at, in_squares + at,
                    )
                else:
                    move_unloaded(
                        p, factor.ptr, waves, summed, south, centre, above + node,
                        in_cosine + at, in_sine + at, in_u + at, in_rate + at, in_squares + at,
                    )
            for m in range(nodes.shape[0]):
                node_at = (nodes[m, 0] * wp.static(nx) + nodes[m, 1]) * wp.static(lanes)
                inside = wp.array(ptr=in_u, shape=(wp.static((ny + 2) * row),), dtype=real)
                for lane in range(wp.min(wp.static(lanes), last - low)):
                    trace[low + lane, m, n] = inside[node_at + lane]
        copy_out(in_u, u, low, last)
        copy_out(in_rate, rate, low, last)
        copy_out(in_squares, squares, low, last)

    return run_groups
