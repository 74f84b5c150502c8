"""Streaming path on CUDA, fourth order: temporal blocking, as in ``temporal_blocking``.

A row of displacement that a warp reads completes the curvature two rows below, and that moves the row four below by one
step; each further level moves the row four below the level before. A level keeps four rows of displacement and four of
curvature in registers, and the margin around a strip is 4·levels nodes. Edges take part like other nodes, with taps of
their own, see ``resident_wide``.

Rows are walked in rounds of four, in which row y of each level has slot y modulo 4 of its window, so that no register
is moved. Most rounds touch no loaded row and no row near an edge: their body is compiled without either.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import LANES, any_lane, cuda_kernel, most_registers, opaque
from warp_plate.kernels.resident_wide import SPECIAL, make_apply_taps
from warp_plate.kernels.temporal_blocking import COLUMNS, make_row_access, strips
from warp_plate.kernels.update import make_parameters, make_state, make_update

# Rows below the newest one that a level moves, and rows of a round, in which each window turns once.
REACH, ROUND = 4, 4
# Warps that share a multiprocessor, also in the moment form.
WARPS = {wp.float32: 12, wp.float64: 8}


@cache
def make_advance_tiles(effects, real, nx, ny, stride, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,)."""
    update, Parameters, (Forcing, Fields) = make_update(effects, real), make_parameters(real), make_state(real)
    fused, apply_taps = make_fused(real), make_apply_taps(real, COLUMNS)
    read_row, write_row, row_at, zero_if = make_row_access(real, ny, stride)
    size = wp.types.type_size_in_bytes(real)
    columns, margin, strip_count = COLUMNS, REACH * levels, strips(nx, REACH * levels)
    useful = LANES * columns - 2 * margin
    # Rows by which sums are read later than rates: the first level has nothing to add to them.
    delay = REACH if levels > 1 else 0
    Taps = wp.types.vector(length=5, dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, 5), dtype=real)
    Row = wp.types.vector(length=columns, dtype=real)
    Rows = wp.types.matrix(shape=(levels * ROUND, columns), dtype=real)
    Waves = wp.types.matrix(shape=(levels, 2), dtype=real)
    Round = wp.types.matrix(shape=(ROUND, columns), dtype=real)

    @cuda_kernel(most_registers(WARPS[real]), max_unroll=32)
    def advance_tiles(
        # parameters
        p: Parameters,
        inside: Taps,  # along y, of rows away from edges
        bend_x: wp.array2d[real],  # (nx, 5) taps along x
        bend_y: wp.array2d[real],  # (ny + 2 + 4·margin, 5) along y, of rows −2·margin …, zeros beyond the plate
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
        # Columns x0 and x0 + 1 are the lane's; the tile stores rows low … high − 1 of the tensor.
        x0 = strip * wp.static(useful) - wp.static(margin) + lane * wp.static(columns)
        low = 2 + tile * tile_rows
        high = wp.min(low + tile_rows, wp.static(ny))

        stiffness = Row()
        bend_taps = ColumnTaps()
        move_taps = ColumnTaps()
        for c in range(wp.static(columns)):
            if x0 + c >= 0 and x0 + c < wp.static(nx):
                for tap in range(5):
                    bend_taps[c, tap] = bend_x[x0 + c, tap]
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
        for phase in range(wp.static(ROUND)):
            ahead_u[phase] = zero_if(beside, read_row(lane_u, row_at(first + phase)))
        for round in range((high - first + wp.static(margin + ROUND - 1)) // wp.static(ROUND)):
            start = first + wp.static(ROUND) * round
            bits = loaded[opaque(start + wp.static(margin))]  # of rows from start − margin on
            away = start > wp.static(margin + SPECIAL) and start <= wp.static(ny - 2 * ROUND)
            away = away and start + wp.static(ROUND) <= high + wp.static(margin)
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
                            for phase in range(wp.static(ROUND)):
                                for level in range(wp.static(levels)):
                                    where = row_at(start + phase - wp.static(REACH * (level + 1)))
                                    slot = wp.static(ROUND * level + phase)
                                    cosines[slot] = zero_if(beside, read_row(lane_in_phase, where))
                                    sines[slot] = zero_if(beside, read_row(lane_quadrature, where))
                            for phase in range(wp.static(ROUND)):
                                for level in range(wp.static(levels)):
                                    for c in range(wp.static(columns)):
                                        slot = wp.static(ROUND * level + phase)
                                        quadrature_part = waves[level, 1] * sines[slot, c]
                                        loads[slot, c] = fused(waves[level, 0], cosines[slot, c], quadrature_part)
                    for phase in range(wp.static(ROUND)):
                        y = start + phase
                        above = ahead_u[phase]
                        stepped_rate = ahead_rate[phase]
                        total = ahead_squares[phase]  # of the row that the second level moves, or the only one
                        next_u = at + wp.static((margin + ROUND + phase) * stride)
                        next_rate = at + wp.static((margin + phase) * stride)
                        if wp.static(body == 1):
                            next_u = row_at(y + wp.static(ROUND))
                            next_rate = row_at(y)
                        ahead_u[phase] = zero_if(beside, read_row(lane_u, next_u))
                        ahead_rate[phase] = zero_if(beside, read_row(lane_rate, next_rate))
                        if wp.static(summed):
                            next_squares = next_rate - wp.static(delay * stride)
                            if wp.static(body == 1):
                                next_squares = row_at(y - delay)
                            ahead_squares[phase] = read_row(lane_squares, next_squares)

                        for level in range(wp.static(levels)):
                            # ``above`` is row y − 4·level of this level; ``here`` is the row that it moves.
                            here = y - wp.static(REACH * (level + 1))
                            oldest = wp.static(ROUND * level + phase)
                            second = wp.static(ROUND * level + (phase + 1) % ROUND)
                            third = wp.static(ROUND * level + (phase + 2) % ROUND)
                            fourth = wp.static(ROUND * level + (phase + 3) % ROUND)
                            bend = inside
                            move = inside
                            if wp.static(body == 1):
                                for tap in range(5):
                                    bend[tap] = bend_y[opaque(here + wp.static(2 + 2 * margin)), tap]
                                    move[tap] = move_y[opaque(here + wp.static(2 * margin)), tap]
                            curvature = apply_taps(
                                window_u[oldest], window_u[second], window_u[third], window_u[fourth], above,
                                bend_taps, bend, lane,
                            )  # fmt: skip
                            biharmonic = apply_taps(
                                window_curvature[third], window_curvature[fourth], window_curvature[oldest],
                                window_curvature[second], curvature, move_taps, move, lane,
                            )  # fmt: skip
                            moves = True
                            if wp.static(body == 1):
                                moves = here > 1 and here < wp.static(ny)
                            for c in range(wp.static(columns)):
                                before = stepped_rate[c]
                                if wp.static(level > 0):
                                    before = window_rate[oldest, c]
                                    window_rate[oldest, c] = stepped_rate[c]
                                    if wp.static(summed):
                                        partial = total[c]
                                        if wp.static(level > 1):
                                            partial = window_sum[oldest, c]
                                            window_sum[oldest, c] = total[c]
                                        total[c] = fused(before, before, partial)
                                stiffness_here = stiffness[c]
                                if wp.static(body == 1):
                                    stiffness_here = wp.where(moves, stiffness[c], real(0.0))
                                load = loads[wp.static(ROUND * level + phase), c]
                                stepped_rate[c] = update(before, biharmonic[c], load, stiffness_here, p)
                                entering = above[c]
                                above[c] = window_u[oldest, c] + stepped_rate[c]
                                window_u[oldest, c] = entering
                                window_curvature[third, c] = curvature[c]

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
