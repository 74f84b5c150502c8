"""Streaming path on CUDA, fourth order: temporal blocking, as in ``temporal_blocking``.

A row of displacement that a warp reads completes the curvature two rows below, and that moves the row four below by one
step; each further level moves the row four below the level before. A level keeps four rows of displacement and four of
curvature in registers, and the margin around a strip is 4·levels nodes. Edges take part like other nodes, with taps of
their own, see ``resident_wide``.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.cuda import LANES, make_from_lane
from warp_plate.kernels.resident_wide import SPECIAL
from warp_plate.kernels.stencil import make_symmetric_weighted_sum, make_weighted_sum
from warp_plate.kernels.update import make_parameters, make_update

# Columns per lane, see ``temporal_blocking``.
COLUMNS = 2
# Rows of each level that are kept, and margin of a level; rows of a round, in which each window turns once.
WINDOW = 4
# Rows ahead of which loads are requested, since memory answers after several rows of arithmetic.
AHEAD = 2


def strips(nx, levels):
    """Return the warps that share a row, each of which moves all but the margins of its strip."""
    return -(-(nx - 2) // (LANES * COLUMNS - 2 * WINDOW * levels))


@cache
def make_advance_tiles(effects, real, nx, ny, stride, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,)."""
    weighted_sum = make_weighted_sum(real)
    symmetric_weighted_sum = make_symmetric_weighted_sum(real)
    update = make_update(effects, real)
    from_lane = make_from_lane(real)
    Parameters = make_parameters(real)
    size = wp.types.type_size_in_bytes(real)
    columns, margin, strip_count = COLUMNS, WINDOW * levels, strips(nx, levels)
    useful = LANES * columns - 2 * margin
    Taps = wp.types.vector(length=5, dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, 5), dtype=real)
    Row = wp.types.vector(length=columns, dtype=real)
    Levels = wp.types.matrix(shape=(levels, columns), dtype=real)
    Rows = wp.types.matrix(shape=(levels * WINDOW, columns), dtype=real)
    Loads = wp.types.matrix(shape=(AHEAD * levels, columns), dtype=real)
    Waves = wp.types.matrix(shape=(levels, 2), dtype=real)
    Round = wp.types.matrix(shape=(WINDOW, columns), dtype=real)

    @wp.func
    def lane_part(field: wp.array3d[real], offset: wp.uint64):
        """Return a plate's part of a field from the lane's first column on: row r is at r·pitch."""
        return wp.array(ptr=field.ptr + offset, shape=(wp.static((ny + 2) * stride),), dtype=real)

    @wp.func
    def read_round(part: wp.array[real], y: int, pitch: int):
        """Read the lane's columns of WINDOW rows; rows beyond the plate read its first or last one: zeros."""
        rows = Round()
        for turn in range(wp.static(WINDOW)):
            at = wp.min(wp.max(y + turn, 1), wp.static(ny)) * pitch
            for c in range(wp.static(columns)):
                rows[turn, c] = part[at + c]
        return rows

    @wp.func
    def apply_taps(
        a: Row, b: Row, centre: Row, d: Row, e: Row,
        taps_x: ColumnTaps, taps_y: wp.array2d[real], inside: Taps, row: int, lane: int,
    ):  # fmt: skip
        """Return Σ taps · neighbours at tensor row ``row``, of five rows from the lowest on."""
        total = Row()
        if row > wp.static(SPECIAL) and row < wp.static(ny - SPECIAL + 1):
            for k in range(wp.static(columns)):
                total[k] = symmetric_weighted_sum(real(0.0), inside, a[k], b[k], centre[k], d[k], e[k])
        elif row >= 1 and row <= wp.static(ny):
            taps = Taps()
            for tap in range(5):
                taps[tap] = taps_y[row - 1, tap]
            for k in range(wp.static(columns)):
                total[k] = weighted_sum(real(0.0), taps, a[k], b[k], centre[k], d[k], e[k])
        west_2 = from_lane(centre[0], lane - 1)
        west_1 = from_lane(centre[1], lane - 1)
        east_1 = from_lane(centre[0], lane + 1)
        east_2 = from_lane(centre[1], lane + 1)
        total[0] = weighted_sum(total[0], taps_x[0], west_2, west_1, centre[0], centre[1], east_1)
        total[1] = weighted_sum(total[1], taps_x[1], west_1, centre[0], centre[1], east_1, east_2)
        return total

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options={"max_unroll": 32})
    def advance_tiles(
        # parameters
        p: Parameters,
        inside: Taps,  # along y, of rows away from edges
        bend_x: wp.array2d[real],  # (nx, 5) taps along x
        bend_y: wp.array2d[real],  # (ny, 5) along y
        move_x: wp.array2d[real],
        move_y: wp.array2d[real],
        loaded: wp.array[int],  # (ny + 2,) 1 for tensor rows with loaded nodes, else 0
        wave: wp.array3d[real],  # (plates, steps, 2) cos ωt and sin ωt
        clock: wp.array[int],  # (1,)
        offset: int,  # the first step is clock[0] + offset
        tiles: int,
        tile_rows: int,
        # inputs; all fields are (plates, rows, stride)
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        # outputs
        u_next: wp.array3d[real],
        rate_next: wp.array3d[real],
        squares: wp.array3d[real],
    ):
        warp = wp.tid() // LANES
        lane = wp.tid() % LANES
        strip = warp % wp.static(strip_count)
        tile = (warp // wp.static(strip_count)) % tiles
        k = warp // (wp.static(strip_count) * tiles)
        n = clock[0] + offset
        # Columns x0 and x0 + 1 are the lane's; the tile stores rows low … high − 1 of the tensor.
        x0 = 1 + strip * wp.static(useful) - wp.static(margin) + lane * wp.static(columns)
        low = 2 + tile * tile_rows
        high = wp.min(low + tile_rows, wp.static(ny))

        # A lane beside the plate reads the row of zeros below it again and again.
        pitch = int(0)
        column = int(0)
        stiffness = Row()
        bend_taps = ColumnTaps()
        move_taps = ColumnTaps()
        if x0 + wp.static(columns - 1) >= 0 and x0 < wp.static(nx):
            pitch = int(wp.static(stride))
            column = x0
            for c in range(wp.static(columns)):
                if x0 + c >= 0 and x0 + c < wp.static(nx):
                    for tap in range(5):
                        bend_taps[c, tap] = bend_x[x0 + c, tap]
                        move_taps[c, tap] = move_x[x0 + c, tap]
                    if x0 + c > 0 and x0 + c < wp.static(nx - 1):
                        stiffness[c] = p.stiffness
        plane = wp.uint64(k * wp.static((ny + 2) * stride) + column) * wp.uint64(wp.static(size))
        lane_u = lane_part(u, plane)
        lane_rate = lane_part(rate, plane)
        lane_in_phase = lane_part(in_phase, plane)
        lane_quadrature = lane_part(quadrature, plane)
        lane_u_next = lane_part(u_next, plane)
        lane_rate_next = lane_part(rate_next, plane)
        lane_squares = lane_part(squares, plane)
        stores = lane * wp.static(columns) >= wp.static(margin)
        stores = stores and lane * wp.static(columns) < wp.static(margin + useful) and x0 < wp.static(nx - 1)

        waves = Waves()
        plate_wave = wave[k]
        for level in range(wp.static(levels)):
            waves[level, 0] = plate_wave[n + level, 0]
            waves[level, 1] = plate_wave[n + level, 1]

        # For each level, newest first: rows of u and of curvature; rates and sums that are not yet passed on.
        kept_u = Rows()
        kept_curvature = Rows()
        kept_rate = Rows()
        kept_sum = Rows()
        load_bits = int(0)  # bit b: row y − 4 + AHEAD − b is loaded
        # Loads of the rows that levels move next, in turn.
        next_in_phase = Loads()
        next_quadrature = Loads()

        first = low - wp.static(margin)
        rounds = (high - first + wp.static(margin + WINDOW - 1)) // wp.static(WINDOW)
        next_u = read_round(lane_u, first, pitch)
        next_rate = read_round(lane_rate, first - wp.static(WINDOW), pitch)
        next_squares = Round()
        if wp.static(summed):
            next_squares = read_round(lane_squares, first - wp.static(WINDOW), pitch)
        for round in range(rounds):
            # The rows of the next round are requested now, so that memory has a whole round to answer.
            start = first + wp.static(WINDOW) * round
            these_u = next_u
            these_rate = next_rate
            these_squares = next_squares
            next_u = read_round(lane_u, start + wp.static(WINDOW), pitch)
            next_rate = read_round(lane_rate, start, pitch)
            if wp.static(summed):
                next_squares = read_round(lane_squares, start, pitch)
            for turn in range(wp.static(WINDOW)):
                y = start + turn
                ahead = y + wp.static(AHEAD)
                load_bits = (load_bits << 1) | loaded[wp.min(wp.max(ahead - wp.static(WINDOW), 1), wp.static(ny))]
                loads = Levels()
                for level in range(wp.static(levels)):
                    slot = wp.static(AHEAD) * level + turn % wp.static(AHEAD)
                    for c in range(wp.static(columns)):
                        loads[level, c] = waves[level, 0] * next_in_phase[slot, c]
                        loads[level, c] += waves[level, 1] * next_quadrature[slot, c]
                        next_in_phase[slot, c] = real(0.0)
                        next_quadrature[slot, c] = real(0.0)
                    if (load_bits & wp.static(1 << WINDOW * level)) != 0:
                        for c in range(wp.static(columns)):
                            at = (ahead - wp.static(WINDOW * (level + 1))) * pitch + c
                            next_in_phase[slot, c] = lane_in_phase[at]
                            next_quadrature[slot, c] = lane_quadrature[at]
                above = Row()
                moved = Row()
                total = Row()
                for c in range(wp.static(columns)):
                    above[c] = these_u[turn, c]
                    moved[c] = these_rate[turn, c]
                    total[c] = these_squares[turn, c]

                for level in range(wp.static(levels)):
                    # ``above`` is row y − 4·level of this level's displacement; ``here`` is the row that it moves.
                    here = y - wp.static(WINDOW * (level + 1))
                    newest = wp.static(WINDOW) * level
                    curvature = apply_taps(
                        kept_u[newest + 3], kept_u[newest + 2], kept_u[newest + 1], kept_u[newest], above,
                        bend_taps, bend_y, inside, here + 2, lane,
                    )  # fmt: skip
                    biharmonic = apply_taps(
                        kept_curvature[newest + 3], kept_curvature[newest + 2], kept_curvature[newest + 1],
                        kept_curvature[newest], curvature, move_taps, move_y, inside, here, lane,
                    )  # fmt: skip
                    moves = here > 1 and here < wp.static(ny)
                    old_rate = moved
                    old_total = total
                    if wp.static(level > 0):
                        old_rate = kept_rate[newest + 3]
                        old_total = kept_sum[newest + 3]
                    entering = above
                    entering_rate = moved
                    entering_total = total
                    for c in range(wp.static(columns)):
                        stiffness_here = wp.where(moves, stiffness[c], real(0.0))
                        new = update(old_rate[c], biharmonic[c], loads[level, c], stiffness_here, p)
                        above[c] = kept_u[newest + 3, c] + new
                        moved[c] = new
                        if wp.static(summed):
                            total[c] = old_total[c] + new * new
                    for row in range(wp.static(WINDOW - 1)):
                        for c in range(wp.static(columns)):
                            at_row = newest + wp.static(WINDOW - 1) - row
                            kept_u[at_row, c] = kept_u[at_row - 1, c]
                            kept_curvature[at_row, c] = kept_curvature[at_row - 1, c]
                            if wp.static(level > 0):
                                kept_rate[at_row, c] = kept_rate[at_row - 1, c]
                                if wp.static(summed):
                                    kept_sum[at_row, c] = kept_sum[at_row - 1, c]
                    for c in range(wp.static(columns)):
                        kept_u[newest, c] = entering[c]
                        kept_curvature[newest, c] = curvature[c]
                        if wp.static(level > 0):
                            kept_rate[newest, c] = entering_rate[c]
                            if wp.static(summed):
                                kept_sum[newest, c] = entering_total[c]

                done = y - wp.static(margin)
                if stores and done >= low and done < high:
                    for c in range(wp.static(columns)):
                        if x0 + c < wp.static(nx - 1):
                            lane_u_next[done * pitch + c] = above[c]
                            lane_rate_next[done * pitch + c] = moved[c]
                            if wp.static(summed):
                                lane_squares[done * pitch + c] = total[c]

    return advance_tiles
