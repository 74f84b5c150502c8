"""Streaming path on CUDA, second order: temporal blocking, several steps in one pass over memory.

A warp walks up a strip of columns; a lane holds ``COLUMNS`` neighbouring ones. For each new row of u that the warp
reads, level 1 can move the row two below by one step, level 2 the row four below by a second step, and so on: each
level needs only the last three rows of the level before, which it keeps in registers. After ``levels`` steps a row is
written back. So one pass serves several steps, without shared memory or barriers, at the price of a margin of 2·levels
nodes around each strip that neighbouring warps compute as well.

Displacement and rate are in two buffers that take turns, because neighbours still read the old ones. ``clock`` counts
steps on the device, so that a captured CUDA graph can be replayed: a launch adds its own offset to it.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.cuda import LANES, make_from_lane
from warp_plate.kernels.stencil import make_laplacian
from warp_plate.kernels.update import make_parameters, make_update

# Columns per lane; at most 2, so that the column beside an edge that a lane may read is zero.
COLUMNS = 2
# Rows of a round, in which each window turns once.
ROUND = 3


def strips(nx, levels):
    """Return the warps that share a row, each of which moves all but the margins of its strip."""
    return -(-(nx - 2) // (LANES * COLUMNS - 4 * levels))


@cache
def make_advance_tiles(effects, real, nx, ny, stride, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,)."""
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    from_lane = make_from_lane(real)
    Parameters = make_parameters(real)
    size = wp.types.type_size_in_bytes(real)
    columns, margin, strip_count = COLUMNS, 2 * levels, strips(nx, levels)
    useful = LANES * columns - 2 * margin
    Row = wp.types.vector(length=columns, dtype=real)
    Levels = wp.types.matrix(shape=(levels, columns), dtype=real)
    Waves = wp.types.matrix(shape=(levels, 2), dtype=real)
    Round = wp.types.matrix(shape=(ROUND, columns), dtype=real)
    Loads = wp.types.matrix(shape=(ROUND * levels, columns), dtype=real)

    @wp.func
    def lane_part(field: wp.array3d[real], offset: wp.uint64):
        """Return a plate's part of a field from the lane's first column on: row r is at r·pitch."""
        return wp.array(ptr=field.ptr + offset, shape=(wp.static((ny + 2) * stride),), dtype=real)

    @wp.func
    def read_round(part: wp.array[real], y: int, pitch: int):
        """Read the lane's columns of three rows; rows beyond the plate read its first or last one: zeros."""
        rows = Round()
        for turn in range(3):
            at = wp.min(wp.max(y + turn, 1), wp.static(ny)) * pitch
            for c in range(wp.static(columns)):
                rows[turn, c] = part[at + c]
        return rows

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options={"max_unroll": 32})
    def advance_tiles(
        # parameters
        p: Parameters,
        factor_x: wp.array[real],  # (nx,) factors on the curvature
        factor_y: wp.array[real],  # (ny,)
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
        # Columns x0 … x0 + columns − 1 are the lane's; the tile stores rows low … high − 1 of the tensor.
        x0 = 1 + strip * wp.static(useful) - wp.static(margin) + lane * wp.static(columns)
        low = 2 + tile * tile_rows
        high = wp.min(low + tile_rows, wp.static(ny))

        # A lane beside the plate reads the row of zeros below it again and again.
        pitch = int(0)
        column = int(0)
        stiffness = Row()
        factor = Row()
        if x0 + wp.static(columns - 1) >= 0 and x0 < wp.static(nx):
            pitch = int(wp.static(stride))
            column = x0
            for c in range(wp.static(columns)):
                if x0 + c >= 0 and x0 + c < wp.static(nx):
                    factor[c] = factor_x[x0 + c]
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

        bottom = factor_y[0]
        top = factor_y[wp.static(ny - 1)]
        waves = Waves()
        plate_wave = wave[k]
        for level in range(wp.static(levels)):
            waves[level, 0] = plate_wave[n + level, 0]
            waves[level, 1] = plate_wave[n + level, 1]

        # For each level: the last two rows of u and of curvature, and the last two rates and sums, not yet passed on.
        u_1 = Levels()
        u_2 = Levels()
        curvature_1 = Levels()
        curvature_2 = Levels()
        rate_1 = Levels()
        rate_2 = Levels()
        sum_1 = Levels()
        sum_2 = Levels()
        # Loads are requested a round before the row moves, since memory answers after several rows of arithmetic.
        load_bits = int(0)  # bit b: row y − 2 + ROUND − b is loaded
        next_in_phase = Loads()
        next_quadrature = Loads()

        first = low - wp.static(margin)
        rounds = (high - first + wp.static(margin) + 2) // 3
        next_u = read_round(lane_u, first, pitch)
        next_rate = read_round(lane_rate, first - 2, pitch)
        next_squares = Round()
        if wp.static(summed):
            next_squares = read_round(lane_squares, first - 2, pitch)
        for round in range(rounds):
            # Three rows a round: after three, each window has turned once and no register need move. The rows of the
            # next round are requested now, so that memory has a whole round to answer.
            start = first + 3 * round
            these_u = next_u
            these_rate = next_rate
            these_squares = next_squares
            next_u = read_round(lane_u, start + 3, pitch)
            next_rate = read_round(lane_rate, start + 1, pitch)
            if wp.static(summed):
                next_squares = read_round(lane_squares, start + 1, pitch)
            for turn in range(3):
                y = start + turn
                ahead = y + wp.static(ROUND)
                load_bits = (load_bits << 1) | loaded[wp.min(wp.max(ahead - 2, 1), wp.static(ny))]
                loads = Levels()
                for level in range(wp.static(levels)):
                    slot = wp.static(ROUND) * level + turn
                    for c in range(wp.static(columns)):
                        loads[level, c] = waves[level, 0] * next_in_phase[slot, c]
                        loads[level, c] += waves[level, 1] * next_quadrature[slot, c]
                        next_in_phase[slot, c] = real(0.0)
                        next_quadrature[slot, c] = real(0.0)
                    if (load_bits & wp.static(1 << 2 * level)) != 0:
                        for c in range(wp.static(columns)):
                            at = (ahead - wp.static(2 * (level + 1))) * pitch + c
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
                    # ``above`` is row y − 2·level of this level's displacement; compute the curvature one row below.
                    curvature_row = y - wp.static(2 * level + 1)
                    factor_row = wp.where(curvature_row == 1, bottom, real(1.0))
                    factor_row = wp.where(curvature_row == wp.static(ny), top, factor_row)
                    west = from_lane(u_1[level, wp.static(columns - 1)], lane - 1)
                    east = from_lane(u_1[level, 0], lane + 1)
                    curvature = Row()
                    for c in range(wp.static(columns)):
                        left = west
                        right = east
                        if wp.static(c > 0):
                            left = u_1[level, c - 1]
                        if wp.static(c < columns - 1):
                            right = u_1[level, c + 1]
                        bare = laplacian(u_1[level, c], left, right, u_2[level, c], above[c], p.aspect)
                        curvature[c] = (factor_row * factor[c]) * bare

                    # The row below that has curvatures on all sides: move it, unless it is an edge or beyond.
                    here = y - wp.static(2 * level + 2)
                    west = from_lane(curvature_1[level, wp.static(columns - 1)], lane - 1)
                    east = from_lane(curvature_1[level, 0], lane + 1)
                    moves = here > 1 and here < wp.static(ny)
                    old_rate = moved
                    old_total = total
                    if wp.static(level > 0):
                        for c in range(wp.static(columns)):
                            old_rate[c] = rate_2[level, c]
                            rate_2[level, c] = rate_1[level, c]
                            rate_1[level, c] = moved[c]
                            if wp.static(summed):
                                old_total[c] = sum_2[level, c]
                                sum_2[level, c] = sum_1[level, c]
                                sum_1[level, c] = total[c]
                    entering = above
                    for c in range(wp.static(columns)):
                        left = west
                        right = east
                        if wp.static(c > 0):
                            left = curvature_1[level, c - 1]
                        if wp.static(c < columns - 1):
                            right = curvature_1[level, c + 1]
                        biharmonic = laplacian(
                            curvature_1[level, c], left, right, curvature_2[level, c], curvature[c], p.aspect
                        )
                        stiffness_here = wp.where(moves, stiffness[c], real(0.0))
                        new = update(old_rate[c], biharmonic, loads[level, c], stiffness_here, p)
                        above[c] = u_2[level, c] + new
                        moved[c] = new
                        if wp.static(summed):
                            total[c] = old_total[c] + new * new
                    for c in range(wp.static(columns)):
                        u_2[level, c] = u_1[level, c]
                        u_1[level, c] = entering[c]
                        curvature_2[level, c] = curvature_1[level, c]
                        curvature_1[level, c] = curvature[c]

                done = y - wp.static(margin)
                if stores and done >= low and done < high:
                    for c in range(wp.static(columns)):
                        if x0 + c < wp.static(nx - 1):
                            lane_u_next[done * pitch + c] = above[c]
                            lane_rate_next[done * pitch + c] = moved[c]
                            if wp.static(summed):
                                lane_squares[done * pitch + c] = total[c]

    return advance_tiles
