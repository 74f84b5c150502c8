"""Resident path on CUDA, fourth order: a block owns a plate, a warp a strip of its rows, a lane some columns.

All numbers of a strip stay in registers from the first step to the last. Edges take part like other nodes: they are
columns of a lane and rows of a warp, hold zero displacement because their stiffness is zero, and have a curvature.
Along x, each column has its own taps in registers, which are zero beyond the edges; so it does not matter what a lane
at an edge receives from lanes that hold no neighbour. Along y, all rows share their taps but those next to an edge,
which only the first and the last warp have; all are kernel arguments.

Rows are walked upwards, the curvature two rows ahead of the displacement, which is overwritten as soon as the curvature
two rows above, the last to need it, is known. Where a plate takes several warps, the outermost four rows of each strip
go through shared memory, in two buffers that take turns, so that a step has one barrier; a warp computes the curvature
of the two rows outside its strip by itself. Where registers are short, loads and sums of rate² are kept elsewhere, as
in ``resident_strips``.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import LANES, barrier, cuda_kernel, make_from_lane, make_thread_part, shared_memory
from warp_plate.kernels.plans import BORDER, make_place
from warp_plate.kernels.update import make_parameters, make_state, make_update

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
def make_apply_taps(real, columns):
    """Make ``apply_taps``: the sum of taps along x and y for a lane's part of a row, from its own and four rows more.

    a … e are the rows from the lowest on; the newest, e, is added last. All 32 lanes must call it together.
    """
    from_lane, fused = make_from_lane(real), make_fused(real)
    Taps = wp.types.vector(length=5, dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, 5), dtype=real)
    Row = wp.types.vector(length=columns, dtype=real)
    Around = wp.types.vector(length=columns + 4, dtype=real)

    @wp.func
    def apply_taps(a: Row, b: Row, centre: Row, d: Row, e: Row, taps_x: ColumnTaps, taps_y: Taps, lane: int):
        around = Around()
        if wp.static(columns == 1):
            around[0] = from_lane(centre[0], lane - 2)
            around[1] = from_lane(centre[0], lane - 1)
            around[3] = from_lane(centre[0], lane + 1)
            around[4] = from_lane(centre[0], lane + 2)
        else:
            around[0] = from_lane(centre[wp.static(columns - 2)], lane - 1)
            around[1] = from_lane(centre[wp.static(columns - 1)], lane - 1)
            around[wp.static(columns + 2)] = from_lane(centre[0], lane + 1)
            around[wp.static(columns + 3)] = from_lane(centre[wp.static(min(1, columns - 1))], lane + 1)
        for c in range(wp.static(columns)):
            around[c + 2] = centre[c]
        total = Row()
        for c in range(wp.static(columns)):
            for tap in range(5):
                total[c] = fused(taps_x[c, tap], around[c + tap], total[c])
            total[c] = fused(taps_y[0], a[c], total[c])
            total[c] = fused(taps_y[1], b[c], total[c])
            total[c] = fused(taps_y[2], centre[c], total[c])
            total[c] = fused(taps_y[3], d[c], total[c])
            total[c] = fused(taps_y[4], e[c], total[c])
        return total

    return apply_taps


@cache
def make_run_steps(effects, real, across, along, stride, plan, summed):
    """Make the kernel of steps ``start`` … ``stop`` − 1, in the window if ``summed``, for blocks of 32 × warps.

    ``across`` and ``along`` are the cuts of a plate along x and y, with a block for each tile.
    """
    nx, ny = across.length, along.length
    place_x, place_y = make_place(across), make_place(along)
    apply_taps = make_apply_taps(real, plan.columns)
    update = make_update(effects, real)
    fused, Parameters, RowTaps = make_fused(real), make_parameters(real), make_row_taps(real)
    Forcing, Fields = make_state(real)
    columns, rows, warps = plan.columns, plan.rows, plan.warps
    threads = LANES * warps
    size = wp.types.type_size_in_bytes(real)
    last_row = ny - 1 - (warps - 1) * rows  # of the upper edge, in the last strip
    # A buffer has 2·BORDER rows for each strip. Strips 0 and warps + 1 are below and above the plate: zeros.
    line = columns * LANES
    buffer = (warps + 2) * 2 * BORDER * line
    squares_in_registers, squares_in_shared = summed and not plan.squares_shared, summed and plan.squares_shared
    shared_size = (2 * buffer if warps > 1 else 1) + (rows * columns * threads if squares_in_shared else 0)
    squares_at = shared_size - rows * columns * threads
    Row = wp.types.vector(length=columns, dtype=real)
    # Row j of the strip is row j + BORDER of the displacements, and row j + 2 of the curvatures.
    Displacements = wp.types.matrix(shape=(rows + 2 * BORDER, columns), dtype=real)
    Curvatures = wp.types.matrix(shape=(rows + 4, columns), dtype=real)
    Strip = wp.types.matrix(shape=(rows, columns), dtype=real)
    Squares = wp.types.matrix(shape=(rows, columns) if squares_in_registers else (1, 1), dtype=real)
    Loads = wp.types.matrix(shape=(rows, columns) if plan.loads_in_registers else (1, 1), dtype=real)
    LoadRow = wp.types.matrix(shape=(2, columns), dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, 5), dtype=real)
    # Row j, column c of a thread's part is at j·stride + c, an offset that the compiler knows.
    thread_part = make_thread_part(real, (rows - 1) * stride + columns)

    @wp.func
    def read_loads(in_phase: wp.array[real], quadrature: wp.array[real], at: int, wanted: bool, x0: int):
        """Read a lane's part of a row of both loads; zeros if it is not wanted."""
        row = LoadRow()
        if wanted:
            for c in range(wp.static(columns)):
                if x0 + c < wp.static(nx):
                    row[0, c] = in_phase[at + c]
                    row[1, c] = quadrature[at + c]
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
        taps_y: RowTaps,
        bend_x: wp.array2d[real],  # (nx, 5) taps along x
        move_x: wp.array2d[real],
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
        x0 = lane * wp.static(columns)
        y0 = 1 + warp * wp.static(rows)
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

        # Columns and rows beyond the plate hold zeros: no taps, no stiffness, no load.
        strip_u = Displacements()
        strip_rate = Strip()
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
            if x0 + c < wp.static(nx):
                if x0 + c > 0 and x0 + c < wp.static(nx - 1):
                    stiffness[c] = p.stiffness
                for tap in range(5):
                    bend_taps[c, tap] = bend_x[x0 + c, tap]
                    move_taps[c, tap] = move_x[x0 + c, tap]
        for j in range(wp.static(rows)):
            if y0 + j <= wp.static(ny) and x0 < wp.static(nx):
                loads = loads | (loaded[y0 + tile_y + j] << j)
                written = y0 + j > first_y and y0 + j <= end_y
                for c in range(wp.static(columns)):
                    if x0 + c < wp.static(nx):
                        strip_u[j + BORDER, c] = global_u[wp.static(j * stride + c)]
                        strip_rate[j, c] = global_rate[wp.static(j * stride + c)]
                        if wp.static(plan.loads_in_registers):
                            cosine[j, c] = global_in_phase[wp.static(j * stride + c)]
                            sine[j, c] = global_quadrature[wp.static(j * stride + c)]
                        if wp.static(summed):
                            if written and x0 + c >= first_x and x0 + c < end_x:
                                if wp.static(squares_in_registers):
                                    squared[j, c] = global_squares[wp.static(j * stride + c)]
                                else:
                                    slot = wp.static(squares_at + (j * columns + c) * threads) + thread
                                    shared[slot] = global_squares[wp.static(j * stride + c)]

        plate_wave = drive.wave[k]
        next_cosine = plate_wave[start, 0]
        next_sine = plate_wave[start, 1]
        for n in range(start, stop):
            # Requested a step ahead, so that memory has time to answer.
            wave_cosine = next_cosine
            wave_sine = next_sine
            next_cosine = plate_wave[wp.min(n + 1, stop - 1), 0]
            next_sine = plate_wave[wp.min(n + 1, stop - 1), 1]
            if wp.static(warps > 1):
                at = (n & 1) * wp.static(buffer) + (warp + 1) * wp.static(2 * BORDER * line) + lane
                for j in range(wp.static(BORDER)):
                    for c in range(wp.static(columns)):
                        shared[at + wp.static(j * line + c * LANES)] = strip_u[j + BORDER, c]
                        shared[at + wp.static((BORDER + j) * line + c * LANES)] = strip_u[j + wp.static(rows), c]
                barrier()
                for j in range(wp.static(BORDER)):
                    for c in range(wp.static(columns)):
                        strip_u[j, c] = shared[at - wp.static((BORDER - j) * line - c * LANES)]
                        strip_u[j + wp.static(BORDER + rows), c] = shared[
                            at + wp.static((2 * BORDER + j) * line + c * LANES)
                        ]

            load_row = LoadRow()
            if wp.static(not plan.loads_in_registers):
                load_row = read_loads(global_in_phase, global_quadrature, 0, (loads & 1) != 0, x0)
            curvature = Curvatures()
            for r in range(wp.static(rows + 4)):
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
                    row_stiffness = stiffness
                    if wp.static(r == 4):
                        if warp == 0:
                            row_stiffness = Row()
                    if wp.static(r - 4 >= last_row):
                        if warp == wp.static(warps - 1):
                            row_stiffness = Row()
                    load = Row()
                    for c in range(wp.static(columns)):
                        if wp.static(plan.loads_in_registers):
                            load[c] = fused(wave_cosine, cosine[r - 4, c], wave_sine * sine[r - 4, c])
                        else:
                            load[c] = fused(wave_cosine, load_row[0, c], wave_sine * load_row[1, c])
                    if wp.static(not plan.loads_in_registers and r < rows + 3):
                        loaded_next = (loads & wp.static(1 << r - 3)) != 0
                        load_row = read_loads(
                            global_in_phase, global_quadrature, wp.static((r - 3) * stride), loaded_next, x0
                        )
                    for c in range(wp.static(columns)):
                        stepped = update(strip_rate[r - 4, c], biharmonic[c], load[c], row_stiffness[c], p)
                        strip_rate[r - 4, c] = stepped
                        strip_u[r, c] = strip_u[r, c] + stepped
                        if wp.static(squares_in_registers):
                            squared[r - 4, c] = squared[r - 4, c] + stepped * stepped
                        if wp.static(squares_in_shared):
                            slot = wp.static(squares_at + ((r - 4) * columns + c) * threads) + thread
                            shared[slot] = shared[slot] + stepped * stepped

        for j in range(wp.static(rows)):
            if y0 + j <= wp.static(ny) and y0 + j > first_y and y0 + j <= end_y:
                for c in range(wp.static(columns)):
                    if x0 + c < wp.static(nx) and x0 + c >= first_x and x0 + c < end_x:
                        global_new_u[wp.static(j * stride + c)] = strip_u[j + BORDER, c]
                        global_new_rate[wp.static(j * stride + c)] = strip_rate[j, c]
                        if wp.static(squares_in_registers):
                            global_squares[wp.static(j * stride + c)] = squared[j, c]
                        if wp.static(squares_in_shared):
                            slot = wp.static(squares_at + (j * columns + c) * threads) + thread
                            global_squares[wp.static(j * stride + c)] = shared[slot]

    return run_steps
