"""Streaming path on CUDA: temporal blocking, several steps in one pass over memory.

A warp walks up a strip of columns; a lane holds ``COLUMNS`` neighbouring ones. For each new row of u that the warp
reads, level 1 can move the row two below (fourth order: four below) by one step, level 2 the row as far below that by a
second step, and so on: each level needs only the last rows of the level before, which it keeps in registers. After
``levels`` steps a row is written back. So one pass serves several steps, without shared memory or barriers, at the
price of a margin around each strip that neighbouring warps compute as well.

Each level keeps its last 3 rows (fourth order: 4) in a window; row y is in slot y mod 3 (mod 4), so no register is
copied from slot to slot. The loop over rows is unrolled by as many, which makes a round. Most rounds touch neither a
loaded row nor an edge: their body is compiled without either. In fourth order, nodes at edges are moved like others,
with taps of their own, see ``resident_strips``.

Displacement and rate are double-buffered, because neighbours still read the old ones. ``clock`` counts steps on the
device, so that a captured CUDA graph can be replayed: a launch adds its own offset to it.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import (
    LANES,
    any_lane,
    cuda_kernel,
    make_apply_taps,
    make_laplacian_of_row,
    make_pairs,
    most_registers,
    opaque,
)
from warp_plate.kernels.resident_strips import SPECIAL
from warp_plate.kernels.update import make_parameters, make_state, make_update

# Columns per lane, which it reads and writes in one access.
COLUMNS = 2
# By order: how many rows below its newest row a level moves one, and the rows of a round, in which every slot of a
# window is written once.
REACH, ROUND = {2: 2, 4: 4}, {2: 3, 4: 4}
# Warps that share a multiprocessor: with eight, a thread may use as many registers as it can address.
WARPS = {(2, wp.float32): 8, (2, wp.float64): 8, (4, wp.float32): 12, (4, wp.float64): 8}


def strips(nx, margin):
    """Return the number of warps that share a row: each moves the nodes of its strip without the margins."""
    return -(-nx // (LANES * COLUMNS - 2 * margin))


@cache
def make_row_access(real, ny, stride):
    """Make functions of a lane's columns of a row of a field: read_row, write_row, row_at, zero_if."""
    size = wp.types.type_size_in_bytes(real)
    read_pair, write_pair = make_pairs(real)
    Row = wp.types.vector(length=COLUMNS, dtype=real)

    @wp.func
    def read_row(column: wp.uint64, at: int):
        """Read a row from the address of the lane's first column in row 0; ``at`` is the row times stride."""
        return read_pair(column + wp.uint64(at * wp.static(size)))

    @wp.func
    def write_row(column: wp.uint64, at: int, row: Row):
        write_pair(column + wp.uint64(at * wp.static(size)), row)

    @wp.func
    def row_at(y: int):
        """Return row y times stride; rows beyond the plate stand for its first or last one."""
        return opaque(wp.min(wp.max(y, 1), wp.static(ny)) * wp.static(stride))

    @wp.func
    def zero_if(zero: bool, row: Row):
        values = Row()
        for c in range(COLUMNS):
            values[c] = wp.where(zero, real(0.0), row[c])
        return values

    return read_row, write_row, row_at, zero_if


@cache
def make_advance_tiles(effects, real, nx, ny, stride, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,)."""
    laplacian_of_row = make_laplacian_of_row(effects.square_cells, real, COLUMNS, False)
    apply_taps = make_apply_taps(real, COLUMNS)
    update, Parameters = make_update(effects, real), make_parameters(real)
    fused, (Forcing, Fields) = make_fused(real), make_state(real)
    order, reach, per_round = effects.order, REACH[effects.order], ROUND[effects.order]
    read_row, write_row, row_at, zero_if = make_row_access(real, ny, stride)
    size = wp.types.type_size_in_bytes(real)
    columns, margin, strip_count = COLUMNS, reach * levels, strips(nx, reach * levels)
    useful = LANES * columns - 2 * margin
    # Rows at the start of a plate's tensor that are not updated as those inside: the row of zeros and the plate's first
    # row, in fourth order its first SPECIAL rows.
    edge = reach if order == 2 else SPECIAL + 1
    # Rows by which the sums of rate² are read later than the rates: with several levels the second one is the first to
    # add to a sum, reach rows later. Fourth order reads the sum then, which saves a window of registers.
    delay = reach if order == 4 and levels > 1 else 0
    taps = 1 if order == 2 else 5  # a factor on the curvature, or taps along an axis
    Taps = wp.types.vector(length=5, dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, taps), dtype=real)
    Row = wp.types.vector(length=columns, dtype=real)
    Rows = wp.types.matrix(shape=(levels * per_round, columns), dtype=real)
    Waves = wp.types.matrix(shape=(levels, 2), dtype=real)
    Round = wp.types.matrix(shape=(per_round, columns), dtype=real)

    @cuda_kernel(most_registers(WARPS[order, real]), max_unroll=32)
    def advance_tiles(
        # parameters
        p: Parameters,
        inside: Taps,  # along y, of rows away from edges; of fourth order alone, as move_x and move_y
        bend_x: wp.array2d[real],  # (nx, 5) taps along x; of second order (nx, 1) factors on the curvature
        bend_y: wp.array2d[real],  # (ny + 2 + 4·margin, 5) of rows −2·margin …, zero beyond the plate; or (ny, 1)
        move_x: wp.array2d[real],
        move_y: wp.array2d[real],
        loaded: wp.array[int],  # (ny + 2 + 4·margin,) from row −2·margin on: bit b is set where row + b is loaded
        clock: wp.array[int],  # (1,)
        offset: int,  # the first step is clock[0] + offset
        tiles: int,
        tile_rows: int,
        # inputs
        drive: Forcing,
        old: Fields,
        # outputs
        new: Fields,
    ):
        warp = wp.tid() // LANES
        lane = wp.tid() % LANES
        strip = warp % wp.static(strip_count)
        tile = (warp // wp.static(strip_count)) % tiles
        k = warp // (wp.static(strip_count) * tiles)
        n = clock[0] + offset
        # Columns x0 … x0 + columns − 1 are the lane's; the tile stores rows low … high − 1 of the tensor.
        x0 = strip * wp.static(useful) - wp.static(margin) + lane * wp.static(columns)
        low = 2 + tile * tile_rows
        high = wp.min(low + tile_rows, wp.static(ny))

        stiffness = Row()
        bend_taps = ColumnTaps()
        move_taps = ColumnTaps()
        for c in range(wp.static(columns)):
            if x0 + c >= 0 and x0 + c < wp.static(nx):
                for tap in range(wp.static(taps)):
                    bend_taps[c, tap] = bend_x[x0 + c, tap]
                    if wp.static(order == 4):
                        move_taps[c, tap] = move_x[x0 + c, tap]
                if x0 + c > 0 and x0 + c < wp.static(nx - 1):
                    stiffness[c] = p.stiffness
        # A lane beside the plate reads columns of it, which must count as zeros.
        beside = x0 < 0 or x0 >= wp.static(nx)
        column = wp.min(wp.max(x0, 0), wp.static((nx - 1) // columns * columns))
        field = wp.int64(k) * wp.int64(wp.static((ny + 2) * stride)) + wp.int64(column)
        part = wp.uint64(field) * wp.uint64(wp.static(size))
        lane_u = old.u.ptr + part
        lane_rate = old.rate.ptr + part
        lane_in_phase = drive.in_phase.ptr + part
        lane_quadrature = drive.quadrature.ptr + part
        lane_u_next = new.u.ptr + part
        lane_rate_next = new.rate.ptr + part
        lane_squares = new.squares.ptr + part
        stores = lane * wp.static(columns) >= wp.static(margin)
        stores = stores and lane * wp.static(columns) < wp.static(margin + useful) and x0 < wp.static(nx)

        bottom = real(0.0)
        top = real(0.0)
        if wp.static(order == 2):
            bottom = bend_y[0, 0]
            top = bend_y[wp.static(ny - 1), 0]
        waves = Waves()
        plate_wave = drive.wave[k]
        for level in range(wp.static(levels)):
            waves[level, 0] = plate_wave[n + level, 0]
            waves[level, 1] = plate_wave[n + level, 1]

        # Windows of each level: displacement, curvature, and the rates and sums that the level before passed on.
        window_u = Rows()
        window_curvature = Rows()
        window_rate = Rows()
        window_sum = Rows()
        # Rows are requested a round ahead, so that memory has time to answer.
        ahead_u = Round()
        ahead_rate = Round()
        ahead_squares = Round()
        first = low - wp.static(margin)
        for phase in range(wp.static(per_round)):
            ahead_u[phase] = zero_if(beside, read_row(lane_u, row_at(first + phase)))
        for round in range((high - first + wp.static(margin + per_round - 1)) // wp.static(per_round)):
            start = first + wp.static(per_round) * round
            bits = loaded[opaque(start + wp.static(margin))]  # of rows from start − margin on
            away = start >= wp.static(margin + edge) and start <= wp.static(ny - 2 * per_round)
            away = away and start + wp.static(per_round) <= high + wp.static(margin)
            plain = any_lane(away and bits == 0)
            for body in range(2):
                if plain == wp.static(body == 0):
                    at = int(0)  # index of row start − margin
                    if wp.static(body == 0):
                        at = opaque((start - wp.static(margin)) * wp.static(stride))
                    loads = Rows()
                    if wp.static(body == 1):
                        if bits != 0:
                            # All reads first, so that they overlap; rows without load hold zeros.
                            cosines = Rows()
                            sines = Rows()
                            for phase in range(wp.static(per_round)):
                                for level in range(wp.static(levels)):
                                    where = row_at(start + phase - wp.static(reach * (level + 1)))
                                    slot = wp.static(per_round * level + phase)
                                    cosines[slot] = zero_if(beside, read_row(lane_in_phase, where))
                                    sines[slot] = zero_if(beside, read_row(lane_quadrature, where))
                            for phase in range(wp.static(per_round)):
                                for level in range(wp.static(levels)):
                                    for c in range(wp.static(columns)):
                                        slot = wp.static(per_round * level + phase)
                                        quadrature_part = waves[level, 1] * sines[slot, c]
                                        loads[slot, c] = fused(waves[level, 0], cosines[slot, c], quadrature_part)
                    for phase in range(wp.static(per_round)):
                        y = start + phase
                        above = ahead_u[phase]
                        stepped_rate = ahead_rate[phase]
                        total = ahead_squares[phase]  # of the row that the first level to add to them moves
                        next_u = at + wp.static((margin + per_round + phase) * stride)
                        next_rate = at + wp.static((margin + per_round - reach + phase) * stride)
                        if wp.static(body == 1):
                            next_u = row_at(y + wp.static(per_round))
                            next_rate = row_at(y + wp.static(per_round - reach))
                        ahead_u[phase] = zero_if(beside, read_row(lane_u, next_u))
                        ahead_rate[phase] = zero_if(beside, read_row(lane_rate, next_rate))
                        if wp.static(summed):
                            next_squares = next_rate - wp.static(delay * stride)
                            if wp.static(delay > 0 and body == 1):
                                next_squares = row_at(y - delay)
                            ahead_squares[phase] = read_row(lane_squares, next_squares)

                        for level in range(wp.static(levels)):
                            # ``above`` is row y − reach·level of this level; ``here`` is the row that it moves.
                            here = y - wp.static(reach * (level + 1))
                            newest = wp.static(per_round * level + phase)
                            row_1 = wp.static(per_round * level + (phase - 1) % per_round)  # the row below, and so on
                            row_2 = wp.static(per_round * level + (phase - 2) % per_round)
                            row_3 = wp.static(per_round * level + (phase - 3) % per_round)
                            moved = wp.static(per_round * level + (phase - reach) % per_round)
                            bent = wp.static(per_round * level + (phase - reach // 2) % per_round)
                            curvature = Row()
                            biharmonic = Row()
                            if wp.static(order == 2):
                                bare = laplacian_of_row(window_u[row_2], window_u[row_1], above, lane, p.aspect)
                                factor_row = real(1.0)
                                if wp.static(body == 1):
                                    factor_row = wp.where(here == 0, bottom, factor_row)
                                    factor_row = wp.where(here == wp.static(ny - 1), top, factor_row)
                                for c in range(wp.static(columns)):
                                    if wp.static(body == 1):
                                        curvature[c] = (factor_row * bend_taps[c, 0]) * bare[c]
                                    else:
                                        curvature[c] = bend_taps[c, 0] * bare[c]
                                biharmonic = laplacian_of_row(
                                    window_curvature[row_3], window_curvature[row_2], curvature, lane, p.aspect
                                )
                            else:
                                bend = inside
                                move = inside
                                if wp.static(body == 1):
                                    for tap in range(5):
                                        bend[tap] = bend_y[opaque(here + wp.static(2 + 2 * margin)), tap]
                                        move[tap] = move_y[opaque(here + wp.static(2 * margin)), tap]
                                curvature = apply_taps(
                                    window_u[newest], window_u[row_3], window_u[row_2], window_u[row_1], above,
                                    bend_taps, bend, lane,
                                )  # fmt: skip
                                biharmonic = apply_taps(
                                    window_curvature[row_2], window_curvature[row_1], window_curvature[newest],
                                    window_curvature[row_3], curvature, move_taps, move, lane,
                                )  # fmt: skip
                            moves = True
                            if wp.static(body == 1):
                                moves = here > 1 and here < wp.static(ny)
                            for c in range(wp.static(columns)):
                                before = stepped_rate[c]
                                if wp.static(level > 0):
                                    before = window_rate[moved, c]
                                    window_rate[newest, c] = stepped_rate[c]
                                    if wp.static(summed):
                                        partial = total[c]
                                        if wp.static(delay == 0 or level > 1):
                                            partial = window_sum[moved, c]
                                            window_sum[newest, c] = total[c]
                                        total[c] = fused(before, before, partial)
                                stiffness_here = stiffness[c]
                                if wp.static(body == 1):
                                    stiffness_here = wp.where(moves, stiffness[c], real(0.0))
                                load = loads[wp.static(per_round * level + phase), c]
                                stepped_rate[c] = update(before, biharmonic[c], load, stiffness_here, p)
                                entering = above[c]
                                above[c] = window_u[moved, c] + stepped_rate[c]
                                window_u[newest, c] = entering
                                window_curvature[bent, c] = curvature[c]

                        done = y - wp.static(margin)
                        storing = stores and done >= low
                        to = at + wp.static(phase * stride)
                        if wp.static(body == 1):
                            storing = storing and done < high
                            to = opaque(wp.max(done, 0) * wp.static(stride))
                        if storing:
                            write_row(lane_u_next, to, above)
                            write_row(lane_rate_next, to, stepped_rate)
                            if wp.static(summed):
                                for c in range(wp.static(columns)):
                                    total[c] = fused(stepped_rate[c], stepped_rate[c], total[c])
                                write_row(lane_squares, to, total)

    return advance_tiles
