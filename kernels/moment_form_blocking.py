"""Moment form, streaming path on CUDA: temporal blocking, see ``temporal_blocking``, of the equations ``moment_form``.

A row of displacement that a warp reads completes Mx and My of the row below it and Mxy of the cells below that row,
which moves the row two below by one step. Edges take part like other nodes: weights of the west and east neighbours
are in the lane's registers, and coefficients come from planes with zeros beyond the plate. So it does not matter what a
lane or a row beyond an edge holds.

The tension of stretching needs a sum over the whole plate before each step. There a launch is one step, and adds up
what the next one needs: each warp its own part, which the warps of the next launch add in the same order.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import LANES, any_lane, cuda_kernel, make_from_lane, make_pairs, most_registers, opaque
from warp_plate.kernels.effects import make_add_local_forces, make_membrane_tension
from warp_plate.kernels.moment_form import make_moment
from warp_plate.kernels.temporal_blocking import COLUMNS, REACH, ROUND, make_row_access
from warp_plate.kernels.update import make_material, make_parameters, make_state, make_update

# Warps that share a multiprocessor.
WARPS = {wp.float32: 12, wp.float64: 8}


def margin_of(effects, levels):
    """Return the nodes around a strip or tile that neighbours compute too; the sum of stretching needs more."""
    return REACH * (levels + int(effects.stretching))


def strips(effects, nx, levels):
    """Return the warps that share a row, each of which moves all but the margins of its strip."""
    return -(-nx // (LANES * COLUMNS - 2 * margin_of(effects, levels)))


def plane_width(effects, nx, levels):
    """Return the columns of a material plane, from ``margin_of`` columns before the plate on."""
    margin = margin_of(effects, levels)
    return strips(effects, nx, levels) * (LANES * COLUMNS - 2 * margin) + 2 * margin


@cache
def make_advance_tiles(effects, real, nx, ny, stride, planes, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,).

    ``planes`` are the names of the material planes, see ``plans``.
    """
    update, add_local_forces = make_update(effects, real), make_add_local_forces(effects, real)
    membrane_tension = make_membrane_tension(real)
    moment, fused, from_lane = make_moment(effects, real), make_fused(real), make_from_lane(real)
    Material, Parameters, (Forcing, Fields) = make_material(real), make_parameters(real), make_state(real)
    size = wp.types.type_size_in_bytes(real)
    columns, margin, strip_count = COLUMNS, margin_of(effects, levels), strips(effects, nx, levels)
    useful, width = LANES * columns - 2 * margin, plane_width(effects, nx, levels) // columns
    at_plane = {name: index * (ny + 2 + 4 * margin) * width for index, name in enumerate(planes)}
    read_row, write_row, row_at = make_row_access(real, ny, stride)
    read_pair = make_pairs(real)[0]
    Row = wp.types.vector(length=columns, dtype=real)
    Rows = wp.types.matrix(shape=(levels * ROUND, columns), dtype=real)
    Round = wp.types.matrix(shape=(ROUND, columns), dtype=real)
    Levels = wp.types.vector(length=levels, dtype=real)
    strained = effects.material_damping

    @wp.func
    def read_material(lane: wp.uint64, at: int):
        """Read the lane's columns of a material plane, of which ``at`` counts pairs of columns."""
        return read_pair(lane + wp.uint64(at * wp.static(columns * size)))

    @wp.func
    def sum_of_neighbours(row: Row, from_west: real, from_east: real, west: Row, east: Row):
        """Add the weighted neighbours along x, of which those beyond the lane come from the next ones."""
        sums = Row()
        sums[0] = fused(west[0], from_west, east[0] * row[1])
        sums[1] = fused(east[1], from_east, west[1] * row[0])
        return sums

    @wp.func
    def sum_of_warp(value: real, lane: int):
        total = value
        for power in range(5):
            total += from_lane(total, lane ^ (1 << power))
        return total

    @cuda_kernel(most_registers(WARPS[real]), max_unroll=32)
    def advance_tiles(
        # parameters
        p: Material,
        material: wp.array3d[Row],  # (planes, rows from 2·margin before the plate on, lanes), zero beyond the plate
        loaded: wp.array[int],  # (rows,) from row −2·margin on: bit b is set where row + b is loaded
        clock: wp.array[int],  # (1,)
        offset: int,  # the first step is clock[0] + offset
        tiles: int,
        tile_rows: int,
        # inputs
        drive: Forcing,
        old: Fields,
        old_sums: wp.array2d[real],  # (plates, strips · tiles) parts of the sum that makes the tension
        # outputs
        new: Fields,
        new_sums: wp.array2d[real],
    ):
        warp = wp.tid() // LANES
        lane = wp.tid() % LANES
        strip = warp % wp.static(strip_count)
        tile = (warp // wp.static(strip_count)) % tiles
        k = warp // (wp.static(strip_count) * tiles)
        n = clock[0] + offset
        # Columns x0 and x0 + 1 of the plate are the lane's; the tile stores rows low … high − 1 of the tensor.
        x0 = strip * wp.static(useful) - wp.static(margin) + lane * wp.static(columns)
        low = 1 + tile * tile_rows
        high = wp.min(low + tile_rows, wp.static(ny + 1))

        # Weights of the neighbours along x, and of the twists around a node: on an edge the inner ones count twice.
        west = Row()
        east = Row()
        twice = Row()
        for c in range(wp.static(columns)):
            if x0 + c >= 0 and x0 + c < wp.static(nx):
                west[c] = wp.where(x0 + c == 0, real(0.0), wp.where(x0 + c == wp.static(nx - 1), real(2.0), real(1.0)))
                east[c] = real(2.0) - west[c]
                twice[c] = p.root_aspect * wp.where(x0 + c == 0 or x0 + c == wp.static(nx - 1), real(2.0), real(1.0))
        lane_at = (x0 + wp.static(margin)) // wp.static(columns)
        lane_material = material.ptr + wp.uint64(lane_at * wp.static(columns * size))
        column = wp.min(wp.max(x0, 0), wp.static((nx - 1) // columns * columns))
        field = wp.int64(k) * wp.int64(wp.static((ny + 2) * stride)) + wp.int64(column)
        part = wp.uint64(field) * wp.uint64(wp.static(size))
        term_size = wp.uint64(drive.loads.shape[1]) * wp.uint64(wp.static((ny + 2) * stride * size))
        lane_u = old.u.ptr + part
        lane_rate = old.rate.ptr + part
        lane_u_next = new.u.ptr + part
        lane_rate_next = new.rate.ptr + part
        lane_squares = new.squares.ptr + part
        stores = lane * wp.static(columns) >= wp.static(margin)
        stores = stores and lane * wp.static(columns) < wp.static(margin + useful) and x0 < wp.static(nx)

        tension = real(0.0)
        if wp.static(effects.stretching):
            for other in range(lane, old_sums.shape[1], LANES):
                tension += old_sums[k, other]
            tension = membrane_tension(drive, p, k, sum_of_warp(tension, lane))
        own_sum = real(0.0)

        # Windows of each level: displacement, what causes stress, rates, moments and sums. Twists are those of the row
        # of cells above a row; of the neighbours that come from other lanes, the last ones.
        kept_u = Rows()
        kept_strained = Rows()
        kept_rate = Rows()
        kept_mx = Rows()
        kept_my = Rows()
        kept_twist = Rows()
        kept_sum = Rows()
        kept_east = Levels()
        kept_west_twist = Levels()
        moved_u = Round()
        # Rows are requested a round ahead, so that memory has time to answer.
        ahead_u = Round()
        ahead_rate = Round()
        ahead_squares = Round()
        first = low - wp.static(margin)
        for turn in range(wp.static(ROUND)):
            ahead_u[turn] = read_row(lane_u, row_at(first + turn))
            ahead_rate[turn] = read_row(lane_rate, row_at(first + turn))
        for round in range((high - first + wp.static(margin + ROUND - 1)) // wp.static(ROUND)):
            start = first + wp.static(ROUND) * round
            bits = loaded[opaque(start + wp.static(margin))]  # of rows from start − margin on
            inside = start >= wp.static(margin + REACH) and start <= wp.static(ny - 2 * ROUND)
            inside = inside and start + wp.static(ROUND) <= high + wp.static(margin)
            plain = any_lane(inside and bits == 0)
            for body in range(2):
                if plain == wp.static(body == 0):
                    at = int(0)  # index of row start − margin
                    if wp.static(body == 0):
                        at = opaque((start - wp.static(margin)) * wp.static(stride))
                    material_at = opaque((start + wp.static(margin)) * wp.static(width))  # the same of the planes
                    pressed = Rows()
                    if wp.static(body == 1):
                        if bits != 0:
                            for t in range(wp.static(effects.terms)):
                                # All reads first, so that they overlap; rows without load hold zeros.
                                lane_load = drive.loads.ptr + wp.uint64(t) * term_size + part
                                parts = Rows()
                                for turn in range(wp.static(ROUND)):
                                    for level in range(wp.static(levels)):
                                        where = row_at(start + turn - wp.static(REACH * (level + 1)))
                                        parts[wp.static(ROUND * level + turn)] = read_row(lane_load, where)
                                for turn in range(wp.static(ROUND)):
                                    for level in range(wp.static(levels)):
                                        for c in range(wp.static(columns)):
                                            slot = wp.static(ROUND * level + turn)
                                            pressed[slot, c] += drive.wave[k, n + level, t] * parts[slot, c]
                    for turn in range(wp.static(ROUND)):
                        y = start + turn
                        above = ahead_u[turn]
                        above_rate = ahead_rate[turn]
                        total = ahead_squares[turn]  # of the row that level 1 moves
                        next_u = at + wp.static((margin + ROUND + turn) * stride)
                        next_squares = at + wp.static((margin + ROUND - REACH + turn) * stride)
                        if wp.static(body == 1):
                            next_u = row_at(y + wp.static(ROUND))
                            next_squares = row_at(y + wp.static(ROUND - REACH))
                        ahead_u[turn] = read_row(lane_u, next_u)
                        ahead_rate[turn] = read_row(lane_rate, next_u)
                        if wp.static(summed):
                            ahead_squares[turn] = read_row(lane_squares, next_squares)

                        for level in range(wp.static(levels)):
                            # ``above`` is row y − 2·level of this level; ``here`` is the row that it moves.
                            here = y - wp.static(REACH * (level + 1))
                            newest = wp.static(ROUND * level + turn)
                            second = wp.static(ROUND * level + (turn + 2) % ROUND)  # the row below
                            third = wp.static(ROUND * level + (turn + 1) % ROUND)
                            here_at = material_at + wp.static((margin + turn - REACH * (level + 1)) * width)
                            next_at = here_at + wp.static(width)
                            south_1 = real(1.0)  # weights of the neighbours along y of the row below, and of ``here``
                            south_2 = real(1.0)
                            twice_y = real(1.0)
                            if wp.static(body == 1):
                                south_1 = wp.where(here == 0, real(0.0), south_1)
                                south_1 = wp.where(here == wp.static(ny - 1), real(2.0), south_1)
                                south_2 = wp.where(here == 1, real(0.0), south_2)
                                south_2 = wp.where(here == wp.static(ny), real(2.0), south_2)
                                twice_y = wp.where(here == 1 or here == wp.static(ny), real(2.0), twice_y)
                            strain = above
                            if wp.static(strained):
                                for c in range(wp.static(columns)):
                                    strain[c] = fused(p.retardation, above_rate[c], above[c])
                                kept_strained[newest] = strain
                            else:
                                kept_strained[newest] = above

                            # Moments of the row below ``above``, and twists of the cells below that row.
                            centre = kept_strained[second]
                            below = kept_strained[third]
                            from_east = from_lane(centre[0], lane + 1)
                            along_x = sum_of_neighbours(centre, from_lane(centre[1], lane - 1), from_east, west, east)
                            bend_xx = read_material(lane_material, next_at + wp.static(at_plane["bend_xx"]))
                            bend_xy = read_material(lane_material, next_at + wp.static(at_plane["bend_xy"]))
                            bend_yy = read_material(lane_material, next_at + wp.static(at_plane["bend_yy"]))
                            rigidity = read_material(lane_material, here_at + wp.static(at_plane["twist"]))
                            mx = Row()
                            my = Row()
                            twist = Row()
                            for c in range(wp.static(columns)):
                                curved_x = along_x[c] - real(2.0) * centre[c]
                                neighbours = fused(south_1, below[c], (real(2.0) - south_1) * strain[c])
                                curved_y = p.aspect * (neighbours - real(2.0) * centre[c])
                                u_1 = kept_u[second, c]
                                mx[c] = moment(bend_xx[c], curved_x, bend_xy[c], curved_y, p.tension_x, u_1)
                                my[c] = moment(bend_yy[c], curved_y, bend_xy[c], curved_x, p.tension_y, u_1)
                            twisted = (centre[1] - below[1]) - (centre[0] - below[0])
                            twist[0] = rigidity[0] * (p.root_aspect * twisted)
                            twisted = (from_east - kept_east[level]) - (centre[1] - below[1])
                            twist[1] = rigidity[1] * (p.root_aspect * twisted)
                            kept_east[level] = from_east

                            # The force on the row ``here``, and its step.
                            mx_here = kept_mx[third]
                            from_west = from_lane(mx_here[1], lane - 1)
                            sum_x = sum_of_neighbours(mx_here, from_west, from_lane(mx_here[0], lane + 1), west, east)
                            west_twist = from_lane(twist[1], lane - 1)
                            bending = Row()
                            for c in range(wp.static(columns)):
                                sum_y = fused(south_2, kept_my[newest, c], (real(2.0) - south_2) * my[c])
                                bending[c] = sum_x[c] - real(2.0) * mx_here[c]
                                bending[c] = fused(p.aspect, sum_y - real(2.0) * kept_my[third, c], bending[c])
                            corner = (kept_west_twist[level] - west_twist) + (twist[0] - kept_twist[third, 0])
                            bending[0] = fused(twice_y * twice[0], corner, bending[0])
                            corner = (kept_twist[third, 0] - twist[0]) + (twist[1] - kept_twist[third, 1])
                            bending[1] = fused(twice_y * twice[1], corner, bending[1])
                            kept_west_twist[level] = west_twist
                            membrane = Row()
                            if wp.static(effects.stretching):
                                middle = kept_u[third]
                                from_west = from_lane(middle[1], lane - 1)
                                along = sum_of_neighbours(middle, from_west, from_lane(middle[0], lane + 1), west, east)
                                for c in range(wp.static(columns)):
                                    neighbours = fused(
                                        south_2, kept_u[newest, c], (real(2.0) - south_2) * kept_u[second, c]
                                    )
                                    u_yy = neighbours - real(2.0) * middle[c]
                                    membrane[c] = fused(
                                        p.aspect * p.stretch_ratio, u_yy, along[c] - real(2.0) * middle[c]
                                    )
                            inverse_mass = read_material(lane_material, here_at + wp.static(at_plane["inverse_mass"]))
                            decay = Row()
                            if wp.static(effects.damping):
                                decay = read_material(lane_material, here_at + wp.static(at_plane["decay"]))
                            spring = Row()
                            if wp.static(effects.foundation):
                                spring = read_material(lane_material, here_at + wp.static(at_plane["spring"]))
                            moved = Row()
                            moved_rate = Row()
                            for c in range(wp.static(columns)):
                                u_here = kept_u[third, c]
                                load = add_local_forces(
                                    pressed[newest, c], inverse_mass[c], spring[c], u_here, tension, membrane[c]
                                )
                                parameters = Parameters()
                                parameters.decay = decay[c]
                                before = kept_rate[third, c]
                                moved_rate[c] = update(before, bending[c], load, inverse_mass[c], parameters)
                                moved[c] = u_here + moved_rate[c]
                                if wp.static(summed and level > 0):
                                    partial = kept_sum[third, c]
                                    kept_sum[newest, c] = total[c]
                                    total[c] = fused(before, before, partial)
                            kept_u[newest] = above
                            kept_rate[newest] = above_rate
                            kept_mx[second] = mx
                            kept_my[second] = my
                            kept_twist[second] = twist
                            above = moved
                            above_rate = moved_rate

                        if wp.static(effects.stretching):
                            # The membrane curvature of the row below the one that moved, after the step.
                            row = y - wp.static(REACH + 1)
                            moved_u[turn] = above
                            u_row = moved_u[wp.static((turn + 2) % ROUND)]
                            from_west = from_lane(u_row[1], lane - 1)
                            along = sum_of_neighbours(u_row, from_west, from_lane(u_row[0], lane + 1), west, east)
                            south = wp.where(row == 1, real(0.0), wp.where(row == wp.static(ny), real(2.0), real(1.0)))
                            weight_at = wp.static(at_plane["weight"] + (margin + turn - REACH - 1) * width)
                            weight = read_material(lane_material, material_at + weight_at)
                            for c in range(wp.static(columns)):
                                neighbours = fused(
                                    south, moved_u[wp.static((turn + 1) % ROUND), c], (real(2.0) - south) * above[c]
                                )
                                u_yy = neighbours - real(2.0) * u_row[c]
                                curved = fused(p.aspect * p.stretch_ratio, u_yy, along[c] - real(2.0) * u_row[c])
                                if stores and row >= low and row < high:
                                    own_sum -= weight[c] * u_row[c] * curved

                        done = y - wp.static(REACH * levels)
                        storing = stores and done >= low
                        to = at + wp.static((margin - REACH * levels + turn) * stride)
                        if wp.static(body == 1):
                            storing = storing and done < high
                            to = opaque(wp.max(done, 0) * wp.static(stride))
                        elif wp.static(effects.stretching):
                            storing = storing and done < high
                        if storing:
                            write_row(lane_u_next, to, above)
                            write_row(lane_rate_next, to, above_rate)
                            if wp.static(summed):
                                for c in range(wp.static(columns)):
                                    total[c] = fused(above_rate[c], above_rate[c], total[c])
                                write_row(lane_squares, to, total)

        if wp.static(effects.stretching):
            own_sum = sum_of_warp(own_sum, lane)
            if lane == 0:
                new_sums[k, tile * wp.static(strip_count) + strip] = own_sum

    return advance_tiles
