"""Resident path on CUDA, second order, plates beyond one warp: a block owns a plate, a warp owns a strip of its rows.

A lane holds ``columns`` neighbouring columns of its warp's strip in registers from the first step to the last. Along x,
neighbours are the lane's own or come from the next lane; along y, the outermost two rows of each strip go through
shared memory, in two buffers that take turns, so that a step has one barrier. With two rows beyond its strip, a warp
computes the curvature just outside the strip by itself.

Where registers are short, loads are read from the cache instead, each row of them while the row below moves, and the
sums of rate² are in shared memory, each thread's numbers a block apart.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import LANES, barrier, cuda_kernel, make_from_lane, make_thread_part, shared_memory
from warp_plate.kernels.plans import make_place
from warp_plate.kernels.update import make_laplacian, make_parameters, make_state, make_update


@cache
def make_run_steps(effects, real, across, along, stride, plan, summed):
    """Make the kernel of steps ``start`` … ``stop`` − 1, in the window if ``summed``, for blocks of 32 × warps.

    ``across`` and ``along`` are the cuts of a plate along x and y, with a block for each tile.
    """
    nx, ny = across.length, along.length
    place_x, place_y = make_place(across), make_place(along)
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    from_lane, fused = make_from_lane(real), make_fused(real)
    Parameters, (Forcing, Fields) = make_parameters(real), make_state(real)
    columns, rows, warps = plan.columns, plan.rows, plan.warps
    threads = LANES * warps
    size = wp.types.type_size_in_bytes(real)
    # The last column and the last row that move, by lane and place in the lane, by warp and place in the strip.
    last_lane, last_column = divmod(nx - 3, columns)
    last_warp, last_row = divmod(ny - 3, rows)
    squares_in_registers, squares_in_shared = summed and not plan.squares_shared, summed and plan.squares_shared
    # A buffer has four rows for each strip. Strips 0 and warps + 1 are below and above the plate: zeros.
    line = columns * LANES
    buffer = (warps + 2) * 4 * line
    shared_size = 2 * buffer + (rows * columns * threads if squares_in_shared else 0)
    Row = wp.types.vector(length=columns, dtype=real)
    Strip = wp.types.matrix(shape=(rows, columns), dtype=real)
    Squares = wp.types.matrix(shape=(rows, columns) if squares_in_registers else (1, 1), dtype=real)
    Loads = wp.types.matrix(shape=(rows, columns) if plan.loads_in_registers else (1, 1), dtype=real)
    LoadRow = wp.types.matrix(shape=(2, columns), dtype=real)
    # Row j, column c of a thread's part is at j·stride + c, an offset that the compiler knows.
    thread_part = make_thread_part(real, (rows - 1) * stride + columns)

    @wp.func
    def curvature_of_row(centre: Row, south: Row, north: Row, lane: int, aspect: real):
        """Compute the curvature of a lane's part of a row of displacement."""
        west = from_lane(centre[wp.static(columns - 1)], lane - 1)
        east = from_lane(centre[0], lane + 1)
        if lane == 0:
            west = real(0.0)
        if lane == wp.static(LANES - 1):
            east = real(0.0)
        curvature = Row()
        for c in range(wp.static(columns)):
            left = west
            right = east
            if wp.static(c > 0):
                left = centre[c - 1]
            if wp.static(c < columns - 1):
                right = centre[c + 1]
            curvature[c] = laplacian(centre[c], left, right, south[c], north[c], aspect)
        return curvature

    @wp.func
    def read_loads(in_phase: wp.array[real], quadrature: wp.array[real], at: int, wanted: bool, lane: int):
        """Read a lane's part of a row of both loads; zeros if it is not wanted."""
        row = LoadRow()
        if wanted:
            for c in range(wp.static(columns)):
                if lane < wp.static(last_lane + (c <= last_column)):
                    row[0, c] = in_phase[at + c]
                    row[1, c] = quadrature[at + c]
        return row

    @cuda_kernel(plan.registers, max_unroll=64)
    def run_steps(
        # parameters
        p: Parameters,
        factor_x: wp.array[real],  # (nx,) factors on the curvature
        factor_y: wp.array[real],  # (ny,) the same times aspect
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
        warp = thread // LANES
        lane = thread % LANES
        x0 = 1 + lane * wp.static(columns)
        y0 = 2 + warp * wp.static(rows)
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

        # Lanes beyond the last column and rows beyond the last hold zeros: no stiffness, no load.
        strip_u = Strip()
        strip_rate = Strip()
        squared = Squares()
        cosine = Loads()
        sine = Loads()
        stiffness = Row()
        loads = int(0)
        if wp.static(squares_in_shared):
            for m in range(wp.static(rows * columns)):
                shared[wp.static(2 * buffer + m * threads) + thread] = real(0.0)
        for c in range(wp.static(columns)):
            if lane < wp.static(last_lane + (c <= last_column)):
                stiffness[c] = p.stiffness
        for j in range(wp.static(rows)):
            if y0 + j < wp.static(ny):
                loads = loads | (loaded[y0 + tile_y + j] << j)
                written = y0 + j > first_y and y0 + j <= end_y
                for c in range(wp.static(columns)):
                    if lane < wp.static(last_lane + (c <= last_column)):
                        strip_u[j, c] = global_u[wp.static(j * stride + c)]
                        strip_rate[j, c] = global_rate[wp.static(j * stride + c)]
                        if wp.static(plan.loads_in_registers):
                            cosine[j, c] = global_in_phase[wp.static(j * stride + c)]
                            sine[j, c] = global_quadrature[wp.static(j * stride + c)]
                        if wp.static(summed):
                            if written and x0 + c >= first_x and x0 + c < end_x:
                                if wp.static(squares_in_registers):
                                    squared[j, c] = global_squares[wp.static(j * stride + c)]
                                else:
                                    slot = wp.static(2 * buffer + (j * columns + c) * threads) + thread
                                    shared[slot] = global_squares[wp.static(j * stride + c)]
        if lane > wp.static(last_lane):
            loads = int(0)
        if warp == 0:
            for m in range(wp.static(4 * columns)):
                for b in range(2):
                    shared[b * wp.static(buffer) + m * LANES + lane] = real(0.0)
                    shared[b * wp.static(buffer) + wp.static((warps + 1) * 4 * line) + m * LANES + lane] = real(0.0)

        left_factor = factor_x[0]
        right_factor = factor_x[wp.static(nx - 1)]
        bottom_factor = factor_y[0]
        top_factor = factor_y[wp.static(ny - 1)]
        plate_wave = drive.wave[k]
        next_cosine = plate_wave[start, 0]
        next_sine = plate_wave[start, 1]
        for n in range(start, stop):
            # Requested a step ahead, so that memory has time to answer.
            wave_cosine = next_cosine
            wave_sine = next_sine
            next_cosine = plate_wave[wp.min(n + 1, stop - 1), 0]
            next_sine = plate_wave[wp.min(n + 1, stop - 1), 1]
            at = (n & 1) * wp.static(buffer) + (warp + 1) * wp.static(4 * line) + lane
            for c in range(wp.static(columns)):
                shared[at + c * LANES] = strip_u[0, c]
                shared[at + wp.static(1 * line) + c * LANES] = strip_u[1, c]
                shared[at + wp.static(2 * line) + c * LANES] = strip_u[wp.static(rows - 2), c]
                shared[at + wp.static(3 * line) + c * LANES] = strip_u[wp.static(rows - 1), c]
            load_row = LoadRow()
            if wp.static(not plan.loads_in_registers):
                load_row = read_loads(global_in_phase, global_quadrature, 0, (loads & 1) != 0, lane)
            barrier()
            below_1 = Row()
            below_2 = Row()
            for c in range(wp.static(columns)):
                below_2[c] = shared[at - wp.static(2 * line) + c * LANES]
                below_1[c] = shared[at - wp.static(1 * line) + c * LANES]

            below = curvature_of_row(below_1, below_2, strip_u[0], lane, p.aspect)
            if warp == 0:
                below = bottom_factor * strip_u[0]
            here = curvature_of_row(strip_u[0], below_1, strip_u[1], lane, p.aspect)
            for j in range(wp.static(rows)):
                above = Row()
                if wp.static(j == rows - 1):
                    above_1 = Row()
                    above_2 = Row()
                    for c in range(wp.static(columns)):
                        above_1[c] = shared[at + wp.static(4 * line) + c * LANES]
                        above_2[c] = shared[at + wp.static(5 * line) + c * LANES]
                    above = curvature_of_row(above_1, strip_u[j], above_2, lane, p.aspect)
                elif wp.static(j == rows - 2):
                    above_1 = Row()
                    for c in range(wp.static(columns)):
                        above_1[c] = shared[at + wp.static(4 * line) + c * LANES]
                    above = curvature_of_row(strip_u[j + 1], strip_u[j], above_1, lane, p.aspect)
                else:
                    above = curvature_of_row(strip_u[j + 1], strip_u[j], strip_u[j + 2], lane, p.aspect)
                if wp.static(j == last_row):
                    if warp == wp.static(last_warp):
                        above = top_factor * strip_u[j]

                west = from_lane(here[wp.static(columns - 1)], lane - 1)
                east = from_lane(here[0], lane + 1)
                if lane == 0:
                    west = left_factor * strip_u[j, 0]
                load = Row()
                for c in range(wp.static(columns)):
                    if wp.static(plan.loads_in_registers):
                        load[c] = fused(wave_cosine, cosine[j, c], wave_sine * sine[j, c])
                    else:
                        load[c] = fused(wave_cosine, load_row[0, c], wave_sine * load_row[1, c])
                if wp.static(not plan.loads_in_registers and j < rows - 1):
                    loaded_next = (loads & wp.static(1 << j + 1)) != 0
                    load_row = read_loads(
                        global_in_phase, global_quadrature, wp.static((j + 1) * stride), loaded_next, lane
                    )
                for c in range(wp.static(columns)):
                    left = west
                    right = east
                    if wp.static(c > 0):
                        left = here[c - 1]
                    if wp.static(c < columns - 1):
                        right = here[c + 1]
                    if wp.static(c == last_column):
                        if lane == wp.static(last_lane):
                            right = right_factor * strip_u[j, c]
                    biharmonic = laplacian(here[c], left, right, below[c], above[c], p.aspect)
                    node_stiffness = stiffness[c]
                    if wp.static(j > last_row):
                        if warp == wp.static(last_warp):
                            node_stiffness = real(0.0)
                    stepped = update(strip_rate[j, c], biharmonic, load[c], node_stiffness, p)
                    strip_rate[j, c] = stepped
                    strip_u[j, c] = strip_u[j, c] + stepped
                    if wp.static(squares_in_registers):
                        squared[j, c] = squared[j, c] + stepped * stepped
                    if wp.static(squares_in_shared):
                        slot = wp.static(2 * buffer + (j * columns + c) * threads) + thread
                        shared[slot] = shared[slot] + stepped * stepped
                below = here
                here = above

        for j in range(wp.static(rows)):
            inside_y = y0 + j < wp.static(ny) and y0 + j > first_y and y0 + j <= end_y
            for c in range(wp.static(columns)):
                inside_x = lane < wp.static(last_lane + (c <= last_column)) and x0 + c >= first_x and x0 + c < end_x
                if inside_y and inside_x:
                    i = wp.static(j * stride + c)
                    global_new_u[i] = strip_u[j, c]
                    global_new_rate[i] = strip_rate[j, c]
                    if wp.static(squares_in_registers):
                        global_squares[i] = squared[j, c]
                    if wp.static(squares_in_shared):
                        global_squares[i] = shared[wp.static(2 * buffer + (j * columns + c) * threads) + thread]

    return run_steps
