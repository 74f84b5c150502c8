"""Resident path on CUDA for plates beyond one warp: a block owns a plate, a warp owns a strip of its rows.

A lane holds ``columns`` neighbouring columns of its warp's strip in registers from the first step to the last. Along
x, neighbours are the lane's own or come from the next lane; along y, the outermost two rows of each strip go through
shared memory, in two buffers that take turns, so that a step has one barrier. With two rows beyond the strip in hand
a warp works out the curvature just outside it by itself.

Where registers are short, the sums of rate² lie in shared memory instead, each thread's own numbers a block apart.
Loads are read where a row has any (few rows do), from the cache.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from warp_plate.kernels.cuda import (
    LANES,
    SHARED_BYTES,
    THREAD_REGISTERS,
    barrier,
    make_from_lane,
    most_registers,
    shared_memory,
)
from warp_plate.kernels.stencil import make_laplacian
from warp_plate.kernels.update import make_parameters, make_update


@dataclass(frozen=True)
class Strips:
    """How a block is cut: columns a lane, rows a warp, warps.

    squares_shared: the sums of rate² lie in shared memory, else in registers; registers: at most so many a thread.
    """

    columns: int
    rows: int
    warps: int
    squares_shared: bool = False
    registers: int | None = None


# Rows a warp that were fastest on an H200, first choice first, for so many columns a lane.
ROWS = {1: (13, 20, 9), 2: (13, 20, 9, 7), 3: (13, 20, 9), 4: (9, 13, 11), 5: (20, 16)}


def plan(nx, ny, real):
    """How to cut a plate of this size, or None where it does not fit on a multiprocessor."""
    columns = -(-(nx - 2) // LANES)
    words = 1 if real is wp.float32 else 2
    for rows in ROWS.get(columns, ()):
        warps = -(-(ny - 2) // rows)
        squares_shared = columns > 2
        # Displacement and rate, the sums where they are kept, three rows of curvature, and addresses and the like.
        needed = words * ((2 if squares_shared else 3) * rows * columns + 6 * columns) + 24
        registers = most_registers(warps)
        squares = rows * warps if squares_shared else 0
        shared = 4 * words * columns * LANES * (2 * 4 * (warps + 2) + squares)
        if needed <= registers and shared <= SHARED_BYTES:
            # Beyond this nothing is gained, and fewer registers let more blocks share the multiprocessor.
            registers = registers if squares_shared else min(registers, 168 * words)
            return Strips(columns, rows, warps, squares_shared, min(registers, THREAD_REGISTERS))
    return None


@cache
def make_run(effects, real, nx, ny, stride, strips, summed):
    """Steps ``start`` ... ``stop`` − 1; launch over (plates × threads,) with blocks of 32 × warps threads.

    summed: whether these steps lie in the window, where rate² is summed.
    factor_x: (nx,), factor_y: (ny,) factors on the curvature, the latter times ``aspect``; wave: (plates, steps, 2);
    loaded: (ny + 2,) one for the rows of the tensor in which some node is loaded, else zero.
    """
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    from_lane = make_from_lane(real)
    Parameters = make_parameters(real)
    columns, rows, warps = strips.columns, strips.rows, strips.warps
    threads = LANES * warps
    size = 4 if real is wp.float32 else 8
    # The last column and the last row that move, by lane and place in the lane, by warp and place in the strip.
    last_lane, last_column = divmod(nx - 3, columns)
    last_warp, last_row = divmod(ny - 3, rows)
    squares_registers = summed and not strips.squares_shared
    # Strips 0 and warps + 1 stand for what lies below and above the plate: zeros.
    buffer = (warps + 2) * 4 * columns * LANES
    room = 2 * buffer + (rows * columns * threads if summed and strips.squares_shared else 0)
    row_of = wp.types.vector(length=columns, dtype=real)
    strip_of = wp.types.matrix(shape=(rows, columns), dtype=real)
    squares_of = wp.types.matrix(shape=(rows, columns) if squares_registers else (1, 1), dtype=real)

    @wp.func
    def own_part(field: wp.array3d[real], offset: wp.uint64):
        """The thread's part of a field: (row j, column c) at j·stride + c, an offset that the compiler knows."""
        return wp.array(ptr=field.ptr + offset, shape=(wp.static((rows - 1) * stride + columns),), dtype=real)

    @wp.func
    def bend(centre: row_of, south: row_of, north: row_of, lane: int, aspect: real):
        """Curvature of a lane's part of one row of displacement."""
        west = from_lane(centre[wp.static(columns - 1)], lane - 1)
        east = from_lane(centre[0], lane + 1)
        if lane == 0:
            west = real(0.0)
        if lane == wp.static(LANES - 1):
            east = real(0.0)
        curvature = row_of()
        for c in range(wp.static(columns)):
            left = west
            right = east
            if wp.static(c > 0):
                left = centre[c - 1]
            if wp.static(c < columns - 1):
                right = centre[c + 1]
            curvature[c] = laplacian(centre[c], left, right, south[c], north[c], aspect)
        return curvature

    @wp.kernel(
        module="unique",
        enable_backward=False,
        grid_stride=False,
        cuda_max_registers=strips.registers,
        module_options={"max_unroll": 64},
    )
    def run(
        p: Parameters,
        factor_x: wp.array[real],
        factor_y: wp.array[real],
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
        warp = thread // LANES
        lane = thread % LANES
        x0 = 1 + lane * wp.static(columns)
        y0 = 2 + warp * wp.static(rows)
        reserved = wp.tile_empty(shape=(wp.static(room),), dtype=real, storage="shared")
        shared = wp.array(ptr=shared_memory(), shape=(wp.static(room),), dtype=real)

        offset = wp.uint64((k * wp.static(ny + 2) + y0) * wp.static(stride) + x0) * wp.uint64(wp.static(size))
        own_u = own_part(u, offset)
        own_rate = own_part(rate, offset)
        own_squares = own_part(squares, offset)
        own_in_phase = own_part(in_phase, offset)
        own_quadrature = own_part(quadrature, offset)

        # Lanes beyond the last column and rows beyond the last hold zeros: no stiffness, no load.
        displacement = strip_of()
        speed = strip_of()
        squared = squares_of()
        stiffness = row_of()
        loads = int(0)
        for c in range(wp.static(columns)):
            if lane < wp.static(last_lane + (c <= last_column)):
                stiffness[c] = p.stiffness
        for j in range(wp.static(rows)):
            if y0 + j < wp.static(ny):
                loads = loads | (loaded[y0 + j] << j)
                for c in range(wp.static(columns)):
                    if lane < wp.static(last_lane + (c <= last_column)):
                        displacement[j, c] = own_u[wp.static(j * stride + c)]
                        speed[j, c] = own_rate[wp.static(j * stride + c)]
                        if wp.static(squares_registers):
                            squared[j, c] = own_squares[wp.static(j * stride + c)]
        if lane > wp.static(last_lane):
            loads = int(0)
        if wp.static(summed and strips.squares_shared):
            for m in range(wp.static(rows * columns)):
                shared[wp.static(2 * buffer + m * threads) + thread] = real(0.0)
        if warp == 0:
            for m in range(wp.static(4 * columns)):
                for b in range(2):
                    shared[b * wp.static(buffer) + m * LANES + lane] = real(0.0)
                    shared[
                        b * wp.static(buffer) + wp.static((warps + 1) * 4 * columns * LANES) + m * LANES + lane
                    ] = real(0.0)

        left_factor = factor_x[0]
        right_factor = factor_x[wp.static(nx - 1)]
        bottom_factor = factor_y[0]
        top_factor = factor_y[wp.static(ny - 1)]
        own_wave = wave[k]
        for n in range(start, stop):
            wave_cosine = own_wave[n, 0]
            wave_sine = own_wave[n, 1]
            own = (n & 1) * wp.static(buffer) + (warp + 1) * wp.static(4 * columns * LANES) + lane
            for c in range(wp.static(columns)):
                shared[own + c * LANES] = displacement[0, c]
                shared[own + wp.static(1 * columns * LANES) + c * LANES] = displacement[1, c]
                shared[own + wp.static(2 * columns * LANES) + c * LANES] = displacement[wp.static(rows - 2), c]
                shared[own + wp.static(3 * columns * LANES) + c * LANES] = displacement[wp.static(rows - 1), c]
            barrier()
            below_1 = row_of()
            below_2 = row_of()
            for c in range(wp.static(columns)):
                below_2[c] = shared[own - wp.static(2 * columns * LANES) + c * LANES]
                below_1[c] = shared[own - wp.static(1 * columns * LANES) + c * LANES]

            below = bend(below_1, below_2, displacement[0], lane, p.aspect)
            if warp == 0:
                below = bottom_factor * displacement[0]
            here = bend(displacement[0], below_1, displacement[1], lane, p.aspect)
            for j in range(wp.static(rows)):
                above = row_of()
                if wp.static(j == rows - 1):
                    above_1 = row_of()
                    above_2 = row_of()
                    for c in range(wp.static(columns)):
                        above_1[c] = shared[own + wp.static(4 * columns * LANES) + c * LANES]
                        above_2[c] = shared[own + wp.static(5 * columns * LANES) + c * LANES]
                    above = bend(above_1, displacement[j], above_2, lane, p.aspect)
                elif wp.static(j == rows - 2):
                    above_1 = row_of()
                    for c in range(wp.static(columns)):
                        above_1[c] = shared[own + wp.static(4 * columns * LANES) + c * LANES]
                    above = bend(displacement[j + 1], displacement[j], above_1, lane, p.aspect)
                else:
                    above = bend(displacement[j + 1], displacement[j], displacement[j + 2], lane, p.aspect)
                if wp.static(j == last_row):
                    if warp == wp.static(last_warp):
                        above = top_factor * displacement[j]

                west = from_lane(here[wp.static(columns - 1)], lane - 1)
                east = from_lane(here[0], lane + 1)
                if lane == 0:
                    west = left_factor * displacement[j, 0]
                # All reads of a row in one branch, so that they are under way together.
                load = row_of()
                if (loads & wp.static(1 << j)) != 0:
                    for c in range(wp.static(columns)):
                        at = wp.static(j * stride + c)
                        load[c] = wave_cosine * own_in_phase[at] + wave_sine * own_quadrature[at]
                        if wp.static(c > last_column):
                            if lane == wp.static(last_lane):
                                load[c] = real(0.0)
                for c in range(wp.static(columns)):
                    left = west
                    right = east
                    if wp.static(c > 0):
                        left = here[c - 1]
                    if wp.static(c < columns - 1):
                        right = here[c + 1]
                    if wp.static(c == last_column):
                        if lane == wp.static(last_lane):
                            right = right_factor * displacement[j, c]
                    biharmonic = laplacian(here[c], left, right, below[c], above[c], p.aspect)
                    hold = stiffness[c]
                    if wp.static(j > last_row):
                        if warp == wp.static(last_warp):
                            hold = real(0.0)
                    new = update(speed[j, c], biharmonic, load[c], hold, p)
                    speed[j, c] = new
                    displacement[j, c] = displacement[j, c] + new
                    if wp.static(squares_registers):
                        squared[j, c] = squared[j, c] + new * new
                    if wp.static(summed and strips.squares_shared):
                        slot = wp.static(2 * buffer + (j * columns + c) * threads) + thread
                        shared[slot] = shared[slot] + new * new
                below = here
                here = above

        for j in range(wp.static(rows)):
            for c in range(wp.static(columns)):
                if y0 + j < wp.static(ny) and lane < wp.static(last_lane + (c <= last_column)):
                    at = wp.static(j * stride + c)
                    own_u[at] = displacement[j, c]
                    own_rate[at] = speed[j, c]
                    if wp.static(squares_registers):
                        own_squares[at] = squared[j, c]
                    if wp.static(summed and strips.squares_shared):
                        own_squares[at] += shared[wp.static(2 * buffer + (j * columns + c) * threads) + thread]

    return run
