"""Resident path on CUDA for the fourth order: a block owns a plate, a warp a strip of its rows, a lane some columns.

All of a strip's numbers lie in registers from the first step to the last. Edges take part like any other node: they
are columns of a lane and rows of a warp, hold zero displacement because their stiffness is zero, and have a curvature.
Along x, each column has its own taps in registers, which are zero beyond the edges; so it does not matter what a lane
at an edge gets from lanes that hold no neighbour. Along y, the taps are the same for all rows but those next to an
edge, which only the first and the last warp have; all come with the kernel's arguments.

Rows are walked upwards, the curvature running two rows ahead of the displacement, which is overwritten as soon as the
curvature two rows above, the last to need it, is known. Where a plate takes several warps, the outermost four rows
of each strip go through shared memory, in two buffers that take turns, so that a step has one barrier; a warp works
out the curvature of the two rows outside its strip by itself.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from warp_plate.kernels.cuda import LANES, SHARED_BYTES, barrier, make_from_lane, most_registers, shared_memory
from warp_plate.kernels.stencil import make_weighed, make_weighed_evenly
from warp_plate.kernels.update import make_parameters, make_update

# Rows next to an edge whose taps along y may be their own, and rows of u that a strip needs from each neighbour.
SPECIAL, BORDER = 3, 4


@dataclass(frozen=True)
class Wide:
    """How a block is cut: columns a lane, rows a warp, warps; registers: at most so many a thread."""

    columns: int
    rows: int
    warps: int
    registers: int


def plan(nx, ny, real):
    """How to cut a plate of this size into as few strips as go, or None where it does not fit on a multiprocessor."""
    columns = -(-nx // LANES)
    words = 1 if real is wp.float32 else 2
    for warps in range(1, 33):
        rows = -(-ny // warps)
        # The first and the last strip hold all rows whose taps are their own.
        if rows > LANES or (warps - 1) * rows > ny - BORDER or rows < BORDER + 1:
            continue
        registers = most_registers(warps)
        # Displacement, rate and sums, taps of both passes, rows of curvature, and addresses and the like.
        needed = words * columns * (3 * rows + 10 + 7) + 30
        shared = 4 * words * 2 * 2 * BORDER * columns * LANES * (warps + 2)
        if needed <= registers and shared <= SHARED_BYTES:
            return Wide(columns, rows, warps, registers)
    return None


@cache
def make_closures(real):
    """Taps along y, times ``aspect``: inside, and of the SPECIAL nodes next to each edge from the edge inwards."""
    taps_of = wp.types.vector(length=5, dtype=real)
    rows_of = wp.types.matrix(shape=(SPECIAL, 5), dtype=real)

    @wp.struct
    class Closures:
        inside: taps_of
        bend_low: rows_of
        bend_high: rows_of
        move_low: rows_of
        move_high: rows_of

    return Closures


@cache
def make_run(effects, real, nx, ny, stride, wide, summed):
    """Steps ``start`` ... ``stop`` − 1; launch over (plates × threads,) with blocks of 32 × warps threads.

    summed: whether these steps lie in the window, where rate² is summed.
    bend_x, move_x: (nx, 5) taps along x of both passes; wave: (plates, steps, 2);
    loaded: (ny + 2,) one for the rows of the tensor in which some node is loaded, else zero.
    """
    weighed = make_weighed(real)
    weighed_evenly = make_weighed_evenly(real)
    update = make_update(effects, real)
    from_lane = make_from_lane(real)
    Parameters = make_parameters(real)
    Closures = make_closures(real)
    columns, rows, warps = wide.columns, wide.rows, wide.warps
    threads = LANES * warps
    size = 4 if real is wp.float32 else 8
    last_row = ny - 1 - (warps - 1) * rows  # of the upper edge, in the last strip
    # Strips 0 and warps + 1 stand for what lies below and above the plate: zeros.
    line = columns * LANES
    buffer = (warps + 2) * 2 * BORDER * line
    room = 2 * buffer if warps > 1 else 1
    taps_of = wp.types.vector(length=5, dtype=real)
    row_of = wp.types.vector(length=columns, dtype=real)
    around_of = wp.types.vector(length=columns + 4, dtype=real)
    # Row j of the strip is row j + BORDER of the displacements, and row j + 2 of the curvatures.
    displacements_of = wp.types.matrix(shape=(rows + 2 * BORDER, columns), dtype=real)
    curvatures_of = wp.types.matrix(shape=(rows + 4, columns), dtype=real)
    strip_of = wp.types.matrix(shape=(rows, columns), dtype=real)
    squares_of = wp.types.matrix(shape=(rows, columns) if summed else (1, 1), dtype=real)
    x_taps_of = wp.types.matrix(shape=(columns, 5), dtype=real)

    @wp.func
    def own_part(field: wp.array3d[real], offset: wp.uint64):
        """The thread's part of a field: (row j, column c) at j·stride + c, an offset that the compiler knows."""
        return wp.array(ptr=field.ptr + offset, shape=(wp.static((rows - 1) * stride + columns),), dtype=real)

    @wp.func
    def along_x(total: row_of, row: row_of, taps: x_taps_of, lane: int):
        around = around_of()
        if wp.static(columns == 1):
            around[0] = from_lane(row[0], lane - 2)
            around[1] = from_lane(row[0], lane - 1)
            around[3] = from_lane(row[0], lane + 1)
            around[4] = from_lane(row[0], lane + 2)
        else:
            around[0] = from_lane(row[wp.static(columns - 2)], lane - 1)
            around[1] = from_lane(row[wp.static(columns - 1)], lane - 1)
            around[wp.static(columns + 2)] = from_lane(row[0], lane + 1)
            around[wp.static(columns + 3)] = from_lane(row[wp.static(min(1, columns - 1))], lane + 1)
        for c in range(wp.static(columns)):
            around[c + 2] = row[c]
        sum = row_of()
        for c in range(wp.static(columns)):
            sum[c] = weighed(total[c], taps[c], around[c], around[c + 1], around[c + 2], around[c + 3], around[c + 4])
        return sum

    @wp.func
    def along_y_inside(a: row_of, b: row_of, c: row_of, d: row_of, e: row_of, taps: taps_of):
        sum = row_of()
        for k in range(wp.static(columns)):
            sum[k] = weighed_evenly(real(0.0), taps, a[k], b[k], c[k], d[k], e[k])
        return sum

    @wp.func
    def along_y_special(a: row_of, b: row_of, c: row_of, d: row_of, e: row_of, taps: taps_of):
        sum = row_of()
        for k in range(wp.static(columns)):
            sum[k] = weighed(real(0.0), taps, a[k], b[k], c[k], d[k], e[k])
        return sum

    @wp.kernel(
        module="unique",
        enable_backward=False,
        grid_stride=False,
        cuda_max_registers=wide.registers,
        module_options={"max_unroll": 64},
    )
    def run(
        p: Parameters,
        closures: Closures,
        bend_x: wp.array2d[real],
        move_x: wp.array2d[real],
        loaded: wp.array[int],
        wave: wp.array3d[real],
        start: int,
        stop: int,
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
    ):
        k = wp.tid() // threads
        thread = wp.tid() % threads
        warp = int(0)
        if wp.static(warps > 1):
            warp = thread // LANES
        lane = thread % LANES
        x0 = lane * wp.static(columns)
        y0 = 1 + warp * wp.static(rows)
        reserved = wp.tile_empty(shape=(wp.static(room),), dtype=real, storage="shared")
        shared = wp.array(ptr=shared_memory(), shape=(wp.static(room),), dtype=real)

        offset = wp.uint64((k * wp.static(ny + 2) + y0) * wp.static(stride) + x0) * wp.uint64(wp.static(size))
        own_u = own_part(u, offset)
        own_rate = own_part(rate, offset)
        own_squares = own_part(squares, offset)
        own_in_phase = own_part(in_phase, offset)
        own_quadrature = own_part(quadrature, offset)

        # Columns and rows beyond the plate hold zeros: no taps, no stiffness, no load.
        displacement = displacements_of()
        speed = strip_of()
        squared = squares_of()
        stiffness = row_of()
        bend_taps = x_taps_of()
        move_taps = x_taps_of()
        loads = int(0)
        for c in range(wp.static(columns)):
            if x0 + c < wp.static(nx):
                if x0 + c > 0 and x0 + c < wp.static(nx - 1):
                    stiffness[c] = p.stiffness
                for tap in range(5):
                    bend_taps[c, tap] = bend_x[x0 + c, tap]
                    move_taps[c, tap] = move_x[x0 + c, tap]
        for j in range(wp.static(rows)):
            if y0 + j <= wp.static(ny) and x0 < wp.static(nx):
                loads = loads | (loaded[y0 + j] << j)
                for c in range(wp.static(columns)):
                    if x0 + c < wp.static(nx):
                        displacement[j + BORDER, c] = own_u[wp.static(j * stride + c)]
                        speed[j, c] = own_rate[wp.static(j * stride + c)]
                        if wp.static(summed):
                            squared[j, c] = own_squares[wp.static(j * stride + c)]
        if wp.static(warps > 1):
            for m in range(thread, wp.static(room), wp.static(threads)):
                shared[m] = real(0.0)
            barrier()

        own_wave = wave[k]
        for n in range(start, stop):
            wave_cosine = own_wave[n, 0]
            wave_sine = own_wave[n, 1]
            if wp.static(warps > 1):
                own = (n & 1) * wp.static(buffer) + (warp + 1) * wp.static(2 * BORDER * line) + lane
                for j in range(wp.static(BORDER)):
                    for c in range(wp.static(columns)):
                        shared[own + wp.static(j * line + c * LANES)] = displacement[j + BORDER, c]
                        shared[own + wp.static((BORDER + j) * line + c * LANES)] = displacement[j + wp.static(rows), c]
                barrier()
                for j in range(wp.static(BORDER)):
                    for c in range(wp.static(columns)):
                        displacement[j, c] = shared[own - wp.static((BORDER - j) * line - c * LANES)]
                        displacement[j + wp.static(BORDER + rows), c] = shared[
                            own + wp.static((2 * BORDER + j) * line + c * LANES)
                        ]

            curvature = curvatures_of()
            for r in range(wp.static(rows + 4)):
                # The curvature of row r − 2 of the strip; of a single strip, those outside it are not wanted.
                if wp.static(warps > 1 or 2 <= r < rows + 2):
                    upward = row_of()
                    if wp.static(0 <= r - 2 < SPECIAL or 0 <= last_row - (r - 2) < SPECIAL):
                        taps = closures.inside
                        if wp.static(0 <= r - 2 < SPECIAL):
                            if warp == 0:
                                taps = closures.bend_low[wp.static(r - 2)]
                        if wp.static(0 <= last_row - (r - 2) < SPECIAL):
                            if warp == wp.static(warps - 1):
                                taps = closures.bend_high[wp.static(last_row - (r - 2))]
                        upward = along_y_special(
                            displacement[r], displacement[r + 1], displacement[r + 2],
                            displacement[r + 3], displacement[r + 4], taps,
                        )
                    else:
                        upward = along_y_inside(
                            displacement[r], displacement[r + 1], displacement[r + 2],
                            displacement[r + 3], displacement[r + 4], closures.inside,
                        )
                    bent = along_x(upward, displacement[r + 2], bend_taps, lane)
                    for c in range(wp.static(columns)):
                        curvature[r, c] = bent[c]

                # With it, all that moves row r − 4 is known.
                if wp.static(r >= 4):
                    across = row_of()
                    if wp.static(0 <= r - 4 < SPECIAL or 0 <= last_row - (r - 4) < SPECIAL):
                        weights = closures.inside
                        if wp.static(0 <= r - 4 < SPECIAL):
                            if warp == 0:
                                weights = closures.move_low[wp.static(r - 4)]
                        if wp.static(0 <= last_row - (r - 4) < SPECIAL):
                            if warp == wp.static(warps - 1):
                                weights = closures.move_high[wp.static(last_row - (r - 4))]
                        across = along_y_special(
                            curvature[r - 4], curvature[r - 3], curvature[r - 2], curvature[r - 1], curvature[r],
                            weights,
                        )
                    else:
                        across = along_y_inside(
                            curvature[r - 4], curvature[r - 3], curvature[r - 2], curvature[r - 1], curvature[r],
                            closures.inside,
                        )
                    biharmonic = along_x(across, curvature[r - 2], move_taps, lane)
                    hold = stiffness
                    if wp.static(r == 4):
                        if warp == 0:
                            hold = row_of()
                    if wp.static(r - 4 >= last_row):
                        if warp == wp.static(warps - 1):
                            hold = row_of()
                    # All reads of a row in one branch, so that they are under way together.
                    load = row_of()
                    if (loads & wp.static(1 << r - 4)) != 0:
                        for c in range(wp.static(columns)):
                            if x0 + c < wp.static(nx):
                                at = wp.static((r - 4) * stride + c)
                                load[c] = wave_cosine * own_in_phase[at] + wave_sine * own_quadrature[at]
                    for c in range(wp.static(columns)):
                        new = update(speed[r - 4, c], biharmonic[c], load[c], hold[c], p)
                        speed[r - 4, c] = new
                        displacement[r, c] = displacement[r, c] + new
                        if wp.static(summed):
                            squared[r - 4, c] = squared[r - 4, c] + new * new

        for j in range(wp.static(rows)):
            if y0 + j <= wp.static(ny):
                for c in range(wp.static(columns)):
                    if x0 + c < wp.static(nx):
                        own_u[wp.static(j * stride + c)] = displacement[j + BORDER, c]
                        own_rate[wp.static(j * stride + c)] = speed[j, c]
                        if wp.static(summed):
                            own_squares[wp.static(j * stride + c)] = squared[j, c]

    return run
