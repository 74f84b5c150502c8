"""Streaming path on CUDA: a warp marches up a strip of columns, several steps of time deep, in one launch.

A lane holds ``columns`` neighbouring columns. For each new row of u that the warp reads, level 1 of the march can
move the row two below by one step of time, level 2 the row four below by a second step, and so on: each level needs
only the last three rows of the level before, which it keeps in registers. After ``levels`` steps a row goes back to
memory. So one pass over memory serves several steps, without shared memory or barriers, and the price is a margin of
2·levels nodes around each strip that neighbouring warps work out as well.

Displacement and rate lie in two buffers that take turns, because the neighbours still read the old ones. ``clock``
counts steps on the device, so that a captured CUDA graph can be replayed: a launch adds its own offset to it.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.cuda import LANES, make_from_lane
from warp_plate.kernels.stencil import make_laplacian
from warp_plate.kernels.update import make_parameters, make_update


def useful_columns(columns, levels):
    """Columns that one warp moves for good; the rest of its strip is margin."""
    return LANES * columns - 4 * levels


@cache
def make_march(effects, real, nx, ny, stride, columns, levels, summed, registers=None):
    """``levels`` steps; launch over (plates · strips · tiles · 32,), strips along x and tiles of ``tile_rows`` rows.

    columns: 1 or 2, so that the column beside an edge that a lane may read is zero;
    summed: whether these steps lie in the window, where rate² is summed.
    factor_x: (nx,), factor_y: (ny,) factors on the curvature; wave: (plates, steps, 2);
    loaded: (ny + 2,) one for the rows of the tensor in which some node is loaded, else zero.
    """
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    from_lane = make_from_lane(real)
    Parameters = make_parameters(real)
    size = 4 if real is wp.float32 else 8
    row_of = wp.types.vector(length=columns, dtype=real)
    levels_of = wp.types.matrix(shape=(levels, columns), dtype=real)
    wave_of = wp.types.matrix(shape=(levels, 2), dtype=real)
    round_of = wp.types.matrix(shape=(3, columns), dtype=real)
    useful = useful_columns(columns, levels)
    margin = 2 * levels
    strips = -(-(nx - 2) // useful)

    @wp.func
    def plane_part(field: wp.array3d[real], offset: wp.uint64):
        """What a lane sees of its plate: its first column of row r lies at r·pitch."""
        return wp.array(ptr=field.ptr + offset, shape=(wp.static((ny + 2) * stride),), dtype=real)

    @wp.func
    def read_round(part: wp.array[real], y: int, pitch: int):
        """The lane's columns of three rows; rows beyond the plate read its first or last one: zeros."""
        rows = round_of()
        for turn in range(3):
            at = wp.min(wp.max(y + turn, 1), wp.static(ny)) * pitch
            for c in range(wp.static(columns)):
                rows[turn, c] = part[at + c]
        return rows

    @wp.kernel(
        module="unique",
        enable_backward=False,
        grid_stride=False,
        cuda_max_registers=registers,
        module_options={"max_unroll": 32},
    )
    def march(
        p: Parameters,
        factor_x: wp.array[real],
        factor_y: wp.array[real],
        loaded: wp.array[int],
        wave: wp.array3d[real],
        clock: wp.array[int],
        offset: int,
        tiles: int,
        tile_rows: int,
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        u_next: wp.array3d[real],
        rate_next: wp.array3d[real],
        squares: wp.array3d[real],
    ):
        warp = wp.tid() // LANES
        lane = wp.tid() % LANES
        strip = warp % wp.static(strips)
        tile = (warp // wp.static(strips)) % tiles
        k = warp // (wp.static(strips) * tiles)
        n = clock[0] + offset
        # Columns x0 ... x0 + columns − 1 are the lane's; rows low ... high − 1 of the tensor are the tile's to store.
        x0 = 1 + strip * wp.static(useful) - wp.static(margin) + lane * wp.static(columns)
        low = 2 + tile * tile_rows
        high = wp.min(low + tile_rows, wp.static(ny))

        # A lane beside the plate reads the row of zeros below it over and over.
        pitch = int(0)
        column = int(0)
        stiffness = row_of()
        factor = row_of()
        if x0 + wp.static(columns - 1) >= 0 and x0 < wp.static(nx):
            pitch = int(wp.static(stride))
            column = x0
            for c in range(wp.static(columns)):
                if x0 + c >= 0 and x0 + c < wp.static(nx):
                    factor[c] = factor_x[x0 + c]
                    if x0 + c > 0 and x0 + c < wp.static(nx - 1):
                        stiffness[c] = p.stiffness
        plane = wp.uint64(k * wp.static((ny + 2) * stride) + column) * wp.uint64(wp.static(size))
        lane_u = plane_part(u, plane)
        lane_rate = plane_part(rate, plane)
        lane_in_phase = plane_part(in_phase, plane)
        lane_quadrature = plane_part(quadrature, plane)
        lane_u_next = plane_part(u_next, plane)
        lane_rate_next = plane_part(rate_next, plane)
        lane_squares = plane_part(squares, plane)
        stores = lane * wp.static(columns) >= wp.static(margin)
        stores = stores and lane * wp.static(columns) < wp.static(margin + useful) and x0 < wp.static(nx - 1)

        bottom = factor_y[0]
        top = factor_y[wp.static(ny - 1)]
        waves = wave_of()
        own_wave = wave[k]
        for level in range(wp.static(levels)):
            waves[level, 0] = own_wave[n + level, 0]
            waves[level, 1] = own_wave[n + level, 1]

        # For each level: the last two rows of what it reads, the last two curvatures, rates and sums in waiting.
        u_1 = levels_of()
        u_2 = levels_of()
        bent_1 = levels_of()
        bent_2 = levels_of()
        rate_1 = levels_of()
        rate_2 = levels_of()
        sum_1 = levels_of()
        sum_2 = levels_of()
        load_bits = int(0)  # bit b: row y − 2 − b is loaded

        first = low - wp.static(margin)
        rounds = (high - first + wp.static(margin) + 2) // 3
        next_u = read_round(lane_u, first, pitch)
        next_rate = read_round(lane_rate, first - 2, pitch)
        next_squares = round_of()
        if wp.static(summed):
            next_squares = read_round(lane_squares, first - 2, pitch)
        for round in range(rounds):
            # Three rows a round: after three, each window has turned once and no register need move. The rows of
            # the next round are asked for now, so that memory has a whole round to answer.
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
                load_bits = (load_bits << 1) | loaded[wp.min(wp.max(y - 2, 1), wp.static(ny))]
                above = row_of()
                moved = row_of()
                total = row_of()
                for c in range(wp.static(columns)):
                    above[c] = these_u[turn, c]
                    moved[c] = these_rate[turn, c]
                    total[c] = these_squares[turn, c]

                for level in range(wp.static(levels)):
                    # ``above`` is row y − 2·level of this level's displacement; curvature of the row below it.
                    bent_row = y - wp.static(2 * level + 1)
                    factor_row = wp.where(bent_row == 1, bottom, real(1.0))
                    factor_row = wp.where(bent_row == wp.static(ny), top, factor_row)
                    west = from_lane(u_1[level, wp.static(columns - 1)], lane - 1)
                    east = from_lane(u_1[level, 0], lane + 1)
                    bent = row_of()
                    for c in range(wp.static(columns)):
                        left = west
                        right = east
                        if wp.static(c > 0):
                            left = u_1[level, c - 1]
                        if wp.static(c < columns - 1):
                            right = u_1[level, c + 1]
                        curvature = laplacian(u_1[level, c], left, right, u_2[level, c], above[c], p.aspect)
                        bent[c] = (factor_row * factor[c]) * curvature

                    # The row below that has curvatures on all sides: it moves, unless it is an edge or beyond.
                    here = y - wp.static(2 * level + 2)
                    load = row_of()
                    if (load_bits & wp.static(1 << 2 * level)) != 0:
                        for c in range(wp.static(columns)):
                            at = here * pitch + c
                            load[c] = waves[level, 0] * lane_in_phase[at] + waves[level, 1] * lane_quadrature[at]
                    west = from_lane(bent_1[level, wp.static(columns - 1)], lane - 1)
                    east = from_lane(bent_1[level, 0], lane + 1)
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
                            left = bent_1[level, c - 1]
                        if wp.static(c < columns - 1):
                            right = bent_1[level, c + 1]
                        biharmonic = laplacian(bent_1[level, c], left, right, bent_2[level, c], bent[c], p.aspect)
                        new = update(old_rate[c], biharmonic, load[c], wp.where(moves, stiffness[c], real(0.0)), p)
                        above[c] = u_2[level, c] + new
                        moved[c] = new
                        if wp.static(summed):
                            total[c] = old_total[c] + new * new
                    for c in range(wp.static(columns)):
                        u_2[level, c] = u_1[level, c]
                        u_1[level, c] = entering[c]
                        bent_2[level, c] = bent_1[level, c]
                        bent_1[level, c] = bent[c]

                done = y - wp.static(margin)
                if stores and done >= low and done < high:
                    for c in range(wp.static(columns)):
                        if x0 + c < wp.static(nx - 1):
                            lane_u_next[done * pitch + c] = above[c]
                            lane_rate_next[done * pitch + c] = moved[c]
                            if wp.static(summed):
                                lane_squares[done * pitch + c] = total[c]

    return march
