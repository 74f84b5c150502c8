"""Resident path on CUDA, plates beyond one warp: a block owns a plate, a warp a strip of its rows, a lane some columns.

All numbers of a strip stay in registers from the first step to the last. Along x, neighbours are the lane's own or come
from the next lane; along y, the outermost rows of each strip (two, of fourth order four) go through shared memory, in
two buffers that take turns, so that a step has one barrier. With them, a warp computes the curvature just outside its
strip by itself. Where registers are short, loads are read from the cache instead, each row of them while the row below
moves, and the sums of rate² are in shared memory, each thread's numbers a block apart.

Of second order a strip has the rows and columns that move. Of fourth order edges take part like other nodes: they have
a curvature, and hold zero displacement because their stiffness is zero. There each column has taps of its own in
registers, which are zero beyond the edges; so it does not matter what a lane at an edge receives from lanes that hold
no neighbour. Along y, all rows share their taps but those next to an edge, which only the first and the last warp have;
all are kernel arguments. Rows are walked upwards, the curvature two rows ahead of the displacement, which is
overwritten as soon as the curvature two rows above, the last to need it, is known.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import (
    LANES,
    barrier,
    cuda_kernel,
    make_apply_taps,
    make_from_lane,
    make_laplacian_of_row,
    make_thread_part,
    shared_memory,
)
from warp_plate.kernels.plans import BORDER, make_place
from warp_plate.kernels.update import make_laplacian, make_parameters, make_state, make_update

# Rows next to an edge that may have taps of their own along y.
SPECIAL = 3


@cache
def make_row_taps(real):
    """Make the struct of taps along y, times aspect: inside, and of SPECIAL nodes from each edge inwards."""
    Taps = wp.types.vector(length=5, dtype=real)
    EdgeTaps = wp.types.matrix(shape=(SPECIAL, 5), dtype=real)

    @wp.struct
    class RowTaps:
        inside: Taps
        bend_low: EdgeTaps
        bend_high: EdgeTaps
        move_low: EdgeTaps
        move_high: EdgeTaps

    return RowTaps


@cache
def make_run_steps(effects, real, across, along, stride, plan, summed):
    """Make the kernel of steps ``start`` … ``stop`` − 1, in the window if ``summed``, for blocks of 32 × warps.

    ``across`` and ``along`` are the cuts of a plate along x and y, with a block for each tile.
    """
    order, nx, ny = effects.order, across.length, along.length
    place_x, place_y = make_place(across), make_place(along)
    laplacian, apply_taps = make_laplacian(effects.square_cells, real), make_apply_taps(real, plan.columns)
    curvature_of_row = make_laplacian_of_row(effects.square_cells, real, plan.columns, True)
    update, from_lane, fused = make_update(effects, real), make_from_lane(real), make_fused(real)
    Parameters, RowTaps, (Forcing, Fields) = make_parameters(real), make_row_taps(real), make_state(real)
    columns, rows, warps = plan.columns, plan.rows, plan.warps
    threads = LANES * warps
    size = wp.types.type_size_in_bytes(real)
    # Nodes from an edge to the strip; rows around the strip that it holds too; rows from the newest to one that moves.
    inset, around, ahead = (1, 0, 0) if order == 2 else (0, BORDER, 4)
    border = order  # rows that neighbouring strips need
    # The last column and row of a strip, by lane and place in the lane, and by place in the last strip.
    last_lane, last_column = divmod(nx - 1 - 2 * inset, columns)
    last_row = ny - 1 - 2 * inset - (warps - 1) * rows
    exchanged = order == 2 or warps > 1
    # A buffer has 2·border rows for each strip. Strips 0 and warps + 1 are below and above the plate: zeros.
    line = columns * LANES
    buffer = (warps + 2) * 2 * border * line
    # Rows of rates and of sums in registers. The rows above these are in shared memory, behind the buffers: the
    # number of row j, column c of a thread is at rates_at or squares_at + (j·columns + c)·threads + thread.
    own_rates, own_squares = rows - plan.shared_rates, rows - plan.shared_squares
    plane, buffers = columns * threads, 2 * buffer if exchanged else 1
    rates_at, squares_at = buffers - own_rates * plane, buffers + (plan.shared_rates - own_squares) * plane
    shared_size = buffers + (plan.shared_rates + summed * plan.shared_squares) * plane
    Row = wp.types.vector(length=columns, dtype=real)
    Displacements = wp.types.matrix(shape=(rows + 2 * around, columns), dtype=real)
    Curvatures = wp.types.matrix(shape=(rows + 4, columns), dtype=real)  # row j of the strip is row j + 2
    Rates = wp.types.matrix(shape=(max(own_rates, 1), columns), dtype=real)
    Squares = wp.types.matrix(shape=(own_squares, columns) if summed and own_squares else (1, 1), dtype=real)
    Loads = wp.types.matrix(shape=(rows, columns) if plan.loads_in_registers else (1, 1), dtype=real)
    LoadRow = wp.types.matrix(shape=(2, columns), dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, 5), dtype=real)
    # Row j, column c of a thread's part is at j·stride + c, an offset that the compiler knows.
    thread_part = make_thread_part(real, (rows - 1) * stride + columns)

    @wp.func
    def in_row(lane: int, c: int):
        """Return whether the lane's column c is in the strip."""
        return lane < last_lane + int(c <= last_column)

    @wp.func
    def read_loads(in_phase: wp.array[real], quadrature: wp.array[real], at: int, wanted: bool, lane: int):
        """Read a lane's part of a row of both loads; zeros if it is not wanted."""
        row = LoadRow()
        if wanted:
            for c in range(wp.static(columns)):
                if in_row(lane, c):
                    row[0, c] = in_phase[at + c]
                    row[1, c] = quadrature[at + c]
        return row

    @wp.func
    def read_shared(shared: wp.array[real], at: int):
        row = Row()
        for c in range(wp.static(columns)):
            row[c] = shared[at + c * LANES]
        return row

    def near_low(j):
        """Return whether row j of the first strip has taps of its own."""
        return 0 <= j < SPECIAL

    def near_high(j):
        """Return whether row j of the last strip has taps of its own."""
        return 0 <= last_row - j < SPECIAL

    @cuda_kernel(plan.registers, max_unroll=64)
    def run_steps(
        # parameters
        p: Parameters,
        taps_y: RowTaps,  # of fourth order
        bend_x: wp.array2d[real],  # (nx, 5) taps along x; of second order (nx, 1) factors on the curvature
        move_x: wp.array2d[real],  # (nx, 5) the same; (ny, 1) factors along y times aspect
        loaded: wp.array[int],  # (ny + 2,) 1 for tensor rows with loaded nodes, else 0
        start: int,
        stop: int,
        # inputs
        drive: Forcing,
        old: Fields,
        # outputs, which may be the inputs where a plate is one tile
        new: Fields,
    ):
        tile = wp.tid() // threads
        k = tile // wp.static(across.count * along.count)
        tile_x, first_x, end_x = place_x(tile % wp.static(across.count))
        tile_y, first_y, end_y = place_y(tile // wp.static(across.count) % wp.static(along.count))
        thread = wp.tid() % threads
        warp = int(0)
        if wp.static(warps > 1):
            warp = thread // LANES
        lane = thread % LANES
        x0 = inset + lane * wp.static(columns)
        y0 = wp.static(1 + inset) + warp * wp.static(rows)
        reserved = wp.tile_empty(shape=(wp.static(shared_size),), dtype=real, storage="shared")
        shared = wp.array(ptr=shared_memory(), shape=(wp.static(shared_size),), dtype=real)

        origin = (k * wp.static(along.nodes + 2) + y0 + tile_y) * wp.static(stride) + x0 + tile_x
        offset = wp.uint64(origin) * wp.uint64(wp.static(size))
        global_u = thread_part(old.u, offset)
        global_rate = thread_part(old.rate, offset)
        global_new_u = thread_part(new.u, offset)
        global_new_rate = thread_part(new.rate, offset)
        global_squares = thread_part(new.squares, offset)
        global_in_phase = thread_part(drive.in_phase, offset)
        global_quadrature = thread_part(drive.quadrature, offset)

        # Columns and rows beyond the strip hold zeros: no taps, no stiffness, no load.
        strip_u = Displacements()
        strip_rate = Rates()
        squared = Squares()
        cosine = Loads()
        sine = Loads()
        stiffness = Row()
        bend_taps = ColumnTaps()
        move_taps = ColumnTaps()
        loads = int(0)
        if wp.static(shared_size > 1):
            for m in range(thread, wp.static(shared_size), wp.static(threads)):
                shared[m] = real(0.0)
            barrier()
        for c in range(wp.static(columns)):
            if in_row(lane, c):
                if wp.static(order == 2):
                    stiffness[c] = p.stiffness
                else:
                    if x0 + c > 0 and x0 + c < wp.static(nx - 1):
                        stiffness[c] = p.stiffness
                    for tap in range(5):
                        bend_taps[c, tap] = bend_x[x0 + c, tap]
                        move_taps[c, tap] = move_x[x0 + c, tap]
        for j in range(wp.static(rows)):
            if y0 + j <= wp.static(ny - inset) and lane <= last_lane:
                loads = loads | (loaded[y0 + tile_y + j] << j)
                written = y0 + j > first_y and y0 + j <= end_y
                for c in range(wp.static(columns)):
                    if in_row(lane, c):
                        strip_u[j + around, c] = global_u[wp.static(j * stride + c)]
                        if wp.static(j < own_rates):
                            strip_rate[j, c] = global_rate[wp.static(j * stride + c)]
                        else:
                            shared[wp.static(rates_at + (j * columns + c) * threads) + thread] = global_rate[
                                wp.static(j * stride + c)
                            ]
                        if wp.static(plan.loads_in_registers):
                            cosine[j, c] = global_in_phase[wp.static(j * stride + c)]
                            sine[j, c] = global_quadrature[wp.static(j * stride + c)]
                        if wp.static(summed):
                            if written and x0 + c >= first_x and x0 + c < end_x:
                                if wp.static(j < own_squares):
                                    squared[j, c] = global_squares[wp.static(j * stride + c)]
                                else:
                                    slot = wp.static(squares_at + (j * columns + c) * threads) + thread
                                    shared[slot] = global_squares[wp.static(j * stride + c)]

        left_factor = real(0.0)
        right_factor = real(0.0)
        bottom_factor = real(0.0)
        top_factor = real(0.0)
        if wp.static(order == 2):
            left_factor = bend_x[0, 0]
            right_factor = bend_x[wp.static(nx - 1), 0]
            bottom_factor = move_x[0, 0]
            top_factor = move_x[wp.static(ny - 1), 0]
        plate_wave = drive.wave[k]
        next_cosine = plate_wave[start, 0]
        next_sine = plate_wave[start, 1]
        for n in range(start, stop):
            # Requested a step ahead, so that memory has time to answer.
            wave_cosine = next_cosine
            wave_sine = next_sine
            next_cosine = plate_wave[wp.min(n + 1, stop - 1), 0]
            next_sine = plate_wave[wp.min(n + 1, stop - 1), 1]
            at = (n & 1) * wp.static(buffer) + (warp + 1) * wp.static(2 * border * line) + lane
            if wp.static(exchanged):
                for j in range(wp.static(border)):
                    for c in range(wp.static(columns)):
                        shared[at + wp.static(j * line + c * LANES)] = strip_u[j + around, c]
                        shared[at + wp.static((border + j) * line + c * LANES)] = strip_u[
                            j + wp.static(around + rows - border), c
                        ]
            load_row = LoadRow()
            if wp.static(not plan.loads_in_registers):
                load_row = read_loads(global_in_phase, global_quadrature, 0, (loads & 1) != 0, lane)
            if wp.static(exchanged):
                barrier()
            below = Row()
            here = Row()
            curvature = Curvatures()
            if wp.static(order == 2):
                below_2 = read_shared(shared, at - wp.static(2 * line))
                below_1 = read_shared(shared, at - wp.static(line))
                below = curvature_of_row(below_2, below_1, strip_u[0], lane, p.aspect)
                if warp == 0:
                    below = bottom_factor * strip_u[0]
                here = curvature_of_row(below_1, strip_u[0], strip_u[1], lane, p.aspect)
            elif wp.static(exchanged):
                for j in range(wp.static(border)):
                    for c in range(wp.static(columns)):
                        strip_u[j, c] = shared[at - wp.static((border - j) * line - c * LANES)]
                        strip_u[j + wp.static(around + rows), c] = shared[
                            at + wp.static((2 * border + j) * line + c * LANES)
                        ]

            for r in range(wp.static(rows + ahead)):
                biharmonic = Row()
                if wp.static(order == 2):
                    above = Row()
                    if wp.static(r == rows - 1):
                        above_1 = read_shared(shared, at + wp.static(4 * line))
                        above_2 = read_shared(shared, at + wp.static(5 * line))
                        above = curvature_of_row(strip_u[r], above_1, above_2, lane, p.aspect)
                    elif wp.static(r == rows - 2):
                        above_1 = read_shared(shared, at + wp.static(4 * line))
                        above = curvature_of_row(strip_u[r], strip_u[r + 1], above_1, lane, p.aspect)
                    else:
                        above = curvature_of_row(strip_u[r], strip_u[r + 1], strip_u[r + 2], lane, p.aspect)
                    if wp.static(r == last_row):
                        if warp == wp.static(warps - 1):
                            above = top_factor * strip_u[r]
                    west = from_lane(here[wp.static(columns - 1)], lane - 1)
                    east = from_lane(here[0], lane + 1)
                    if lane == 0:
                        west = left_factor * strip_u[r, 0]
                    for c in range(wp.static(columns)):
                        left = west
                        right = east
                        if wp.static(c > 0):
                            left = here[c - 1]
                        if wp.static(c < columns - 1):
                            right = here[c + 1]
                        if wp.static(c == last_column):
                            if lane == wp.static(last_lane):
                                right = right_factor * strip_u[r, c]
                        biharmonic[c] = laplacian(here[c], left, right, below[c], above[c], p.aspect)
                    below = here
                    here = above
                else:
                    # The curvature of row r − 2 of the strip; a single strip needs none outside it.
                    if wp.static(warps > 1 or 2 <= r < rows + 2):
                        bend_y = taps_y.inside
                        if wp.static(near_low(r - 2)):
                            if warp == 0:
                                bend_y = taps_y.bend_low[wp.static(r - 2)]
                        if wp.static(near_high(r - 2)):
                            if warp == wp.static(warps - 1):
                                bend_y = taps_y.bend_high[wp.static(last_row - (r - 2))]
                        curvature_row = apply_taps(
                            strip_u[r], strip_u[r + 1], strip_u[r + 2], strip_u[r + 3], strip_u[r + 4],
                            bend_taps, bend_y, lane,
                        )  # fmt: skip
                        for c in range(wp.static(columns)):
                            curvature[r, c] = curvature_row[c]
                    # With it, all that moves row r − 4 is known.
                    if wp.static(r >= 4):
                        move_y = taps_y.inside
                        if wp.static(near_low(r - 4)):
                            if warp == 0:
                                move_y = taps_y.move_low[wp.static(r - 4)]
                        if wp.static(near_high(r - 4)):
                            if warp == wp.static(warps - 1):
                                move_y = taps_y.move_high[wp.static(last_row - (r - 4))]
                        biharmonic = apply_taps(
                            curvature[r - 4], curvature[r - 3], curvature[r - 2], curvature[r - 1], curvature[r],
                            move_taps, move_y, lane,
                        )  # fmt: skip
                if wp.static(r >= ahead):
                    row_stiffness = stiffness
                    if wp.static(order == 4 and r == ahead):
                        if warp == 0:
                            row_stiffness = Row()
                    if wp.static(r - ahead >= last_row + inset):
                        if warp == wp.static(warps - 1):
                            row_stiffness = Row()
                    load = Row()
                    for c in range(wp.static(columns)):
                        if wp.static(plan.loads_in_registers):
                            load[c] = fused(wave_cosine, cosine[r - ahead, c], wave_sine * sine[r - ahead, c])
                        else:
                            load[c] = fused(wave_cosine, load_row[0, c], wave_sine * load_row[1, c])
                    if wp.static(not plan.loads_in_registers and r < rows + ahead - 1):
                        loaded_next = (loads & wp.static(1 << r - ahead + 1)) != 0
                        load_row = read_loads(
                            global_in_phase, global_quadrature, wp.static((r - ahead + 1) * stride), loaded_next, lane
                        )
                    for c in range(wp.static(columns)):
                        rate_slot = wp.static(rates_at + ((r - ahead) * columns + c) * threads) + thread
                        rate = real(0.0)
                        if wp.static(r - ahead < own_rates):
                            rate = strip_rate[r - ahead, c]
                        if wp.static(r - ahead >= own_rates):
                            rate = shared[rate_slot]
                        stepped = update(rate, biharmonic[c], load[c], row_stiffness[c], p)
                        if wp.static(r - ahead < own_rates):
                            strip_rate[r - ahead, c] = stepped
                        else:
                            shared[rate_slot] = stepped
                        strip_u[r - ahead + around, c] = strip_u[r - ahead + around, c] + stepped
                        if wp.static(summed and r - ahead < own_squares):
                            squared[r - ahead, c] = squared[r - ahead, c] + stepped * stepped
                        if wp.static(summed and r - ahead >= own_squares):
                            slot = wp.static(squares_at + ((r - ahead) * columns + c) * threads) + thread
                            shared[slot] = shared[slot] + stepped * stepped

        for j in range(wp.static(rows)):
            if y0 + j <= wp.static(ny - inset) and y0 + j > first_y and y0 + j <= end_y:
                for c in range(wp.static(columns)):
                    if in_row(lane, c) and x0 + c >= first_x and x0 + c < end_x:
                        global_new_u[wp.static(j * stride + c)] = strip_u[j + around, c]
                        if wp.static(j < own_rates):
                            global_new_rate[wp.static(j * stride + c)] = strip_rate[j, c]
                        else:
                            slot = wp.static(rates_at + (j * columns + c) * threads) + thread
                            global_new_rate[wp.static(j * stride + c)] = shared[slot]
                        if wp.static(summed and j < own_squares):
                            global_squares[wp.static(j * stride + c)] = squared[j, c]
                        if wp.static(summed and j >= own_squares):
                            slot = wp.static(squares_at + (j * columns + c) * threads) + thread
                            global_squares[wp.static(j * stride + c)] = shared[slot]

    return run_steps
