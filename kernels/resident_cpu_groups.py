"""Resident path on CPU for many plates: a group of plates side by side, the plates innermost in memory.

In a group, node i of plate k lies at i·lanes + k, so that a vector holds the same node of several plates: neighbours
along x lie whole vectors apart, no number is padding, and a plate's width does not matter. To the two passes of
``resident_cpu_passes`` it is one plate with rows ``lanes`` times as long, of which they take one at a time. The batched
tensors keep their layout: a launch copies a group in, runs all steps, and copies it out.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.denormals import flush_denormals, restore_denormals
from warp_plate.kernels.resident_cpu_passes import make_passes, taps_along_y
from warp_plate.kernels.update import make_parameters

# Planes of one group's room: u, rate, squares, in phase, quadrature.
PLANES = 5


def room_of(nx, ny, lanes, order):
    """Numbers in the room of one thread: the planes, the rows of curvature in use, and what taps reach beyond them."""
    return (PLANES * (ny + 2) + order + 1) * nx * lanes + order // 2 * lanes


@cache
def make_run_groups(effects, real, nx, ny, stride, lanes, compiler_flags):
    """Steps ``start`` ... ``stop`` − 1 of ``lanes`` plates at a time; launch over (groups,), from plate ``first`` on.

    Plates from ``last`` on are not there: their lanes run empty. room: (threads, room_of(nx, ny, lanes, order)), of
    which the launch uses line ``thread``. bend_x, move_x, bend_y, move_y: as in ``resident_cpu``, those along x
    repeated for each lane, the factors of second order for the bottom, an inner and the top row; loaded: (ny + 2,) one
    for the rows of the tensor in which some node is loaded, else zero; wave: (steps, 2), the same for all plates;
    window, nodes, trace: as in ``resident_cpu``.
    """
    Parameters = make_parameters(real)
    reach, places = effects.order // 2, effects.order + 1
    row = nx * lanes
    bend, move, move_unloaded = make_passes(effects, real, row, lanes, row, row - 2 * lanes, False, row)
    wave_of = wp.types.vector(length=2, dtype=real)
    rows_of = wp.types.vector(length=taps_along_y(effects.order), dtype=real)
    places_of = wp.types.vector(length=places, dtype=wp.uint64)
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

    @wp.func
    def row_taps(taps: wp.array2d[real], r: int):
        rows = rows_of()
        for tap in range(wp.static(taps_along_y(effects.order))):
            rows[tap] = taps[r, tap]
        return rows

    @wp.func
    def bend_row(in_u: wp.uint64, columns: wp.uint64, taps_y: wp.array2d[real], bent: wp.uint64, r: int):
        """Row r's curvature, into its place: the rows in use take turns."""
        out = bent + wp.uint64(r % wp.static(places) * wp.static(row_bytes))
        here = in_u + wp.uint64((r + 1) * wp.static(row_bytes))
        if wp.static(effects.order == 4):
            low = wp.min(wp.max(r - 1, 0), wp.static(ny - 3))
            bend(in_u + wp.uint64(low * wp.static(row_bytes)), here, columns, row_taps(taps_y, r), out)
        else:
            pattern = wp.where(r == 0, 0, wp.where(r == wp.static(ny - 1), 2, 1))
            factor = columns + wp.uint64(pattern * wp.static(row_bytes))
            bend(in_u + wp.uint64(r * wp.static(row_bytes)), here, factor, row_taps(taps_y, 0), out)

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": 5},
    )
    def run_groups(
        p: Parameters,
        bend_x: wp.array[real],
        move_x: wp.array[real],
        bend_y: wp.array2d[real],
        move_y: wp.array2d[real],
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
        before = flush_denormals()
        low = first + wp.tid() * wp.static(lanes)
        in_u = room.ptr + wp.uint64(thread) * wp.uint64(room.shape[1] * wp.static(size))
        in_rate = in_u + wp.uint64(wp.static(1 * plane_bytes))
        in_squares = in_u + wp.uint64(wp.static(2 * plane_bytes))
        in_cosine = in_u + wp.uint64(wp.static(3 * plane_bytes))
        in_sine = in_u + wp.uint64(wp.static(4 * plane_bytes))
        bent = in_u + wp.uint64(wp.static(5 * plane_bytes))
        node = wp.uint64(wp.static(node_bytes))
        # What an earlier group left must not reach this one, not even times zero: it may be no number.
        in_use = wp.array(ptr=bent, shape=(wp.static(places * row + reach * lanes),), dtype=real)
        for i in range(wp.static(places * row + reach * lanes)):
            in_use[i] = real(0.0)
        copy_in(u, in_u, low, last)
        copy_in(rate, in_rate, low, last)
        copy_in(squares, in_squares, low, last)
        copy_in(in_phase, in_cosine, low, last)
        copy_in(quadrature, in_sine, low, last)
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = wave_of(wave[n, 0], wave[n, 1])
            for r in range(wp.static(reach + 1)):
                bend_row(in_u, bend_x.ptr, bend_y, bent, r)
            for r in range(1, wp.static(ny - 1)):
                # Row r moves once the curvatures of the rows above it are known.
                if r + wp.static(reach) < wp.static(ny):
                    bend_row(in_u, bend_x.ptr, bend_y, bent, r + wp.static(reach))
                rows = row_taps(move_y, 0)
                if wp.static(effects.order == 4):
                    rows = row_taps(move_y, r)
                around = places_of()
                for place in range(wp.static(places)):
                    turn = (r + place + wp.static(places - reach)) % wp.static(places)
                    around[place] = bent + wp.uint64(turn * wp.static(row_bytes)) + node
                at = wp.uint64((r + 1) * wp.static(row_bytes)) + node
                if loaded[r + 1] != 0:
                    move(
                        p, move_x.ptr, move_x.ptr + node, rows, waves, summed, around,
                        in_cosine + at, in_sine + at, in_u + at, in_rate + at, in_squares + at,
                    )
                else:
                    move_unloaded(
                        p, move_x.ptr, move_x.ptr + node, rows, waves, summed, around,
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
        restore_denormals(before)

    return run_groups
