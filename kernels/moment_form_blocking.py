"""Moment form, streaming path on CUDA: temporal blocking, see ``temporal_blocking``, of the equations in ``update``.

A row of displacement that a warp reads completes Mx and My of the row below it and Mxy of the cells below that row,
which moves the row two below by one step. Edges take part like other nodes: weights of the west and east neighbours
are in the lane's registers, and coefficients come from planes with zeros beyond the plate. So it does not matter what a
lane or a row beyond an edge holds.

The tension of a stretched membrane needs a sum over the whole plate before each step. There a launch is one step, and
adds up what the next one needs: each warp a part, which the warps of the next launch add in the same order.
"""

from functools import cache

import warp as wp

from warp_plate.kernels import temporal_blocking
from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import LANES, any_lane, cuda_kernel, make_from_lane, make_pairs, most_registers, opaque
from warp_plate.kernels.temporal_blocking import COLUMNS, make_row_access, strips
from warp_plate.kernels.update import (
    make_add_local_forces,
    make_material,
    make_membrane_tension,
    make_moment,
    make_parameters,
    make_state,
    make_update,
)

# As in the plain plate of second order.
REACH, ROUND = temporal_blocking.REACH[2], temporal_blocking.ROUND[2]
# Warps that share a multiprocessor: fewer, with more registers, where several steps' rows and the coefficients of inner
# rows are held, and in float64.
WARPS, FEWER_WARPS = 12, 8
# Threads of a block, whose warps are independent.
BLOCK = 128


def margin_of(effects, levels):
    """Return the nodes around a strip or tile that neighbours compute too; the sum of a membrane needs more."""
    return REACH * (levels + int(effects.membrane))


def plane_width(effects, nx, levels):
    """Return the columns of a material plane, from ``margin_of`` columns before the plate on."""
    margin = margin_of(effects, levels)
    return strips(nx, margin) * (LANES * COLUMNS - 2 * margin) + 2 * margin


def rows_alike(planes):
    """Return whether the rows (planes, ny, nx) that count as inner ones are the same in each material plane."""
    inner = planes[:, 1:-3]
    return inner.shape[1] > 0 and bool((inner == inner[:, :1]).all())


@cache
def make_advance_tiles(effects, real, nx, ny, stride, planes, alike, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,).

    ``planes`` are the names of the material planes, see ``plans``; ``alike`` is true if they vary along y only near the
    edges, see ``rows_alike``. Lanes then hold the coefficients of inner rows in registers.
    """
    update, add_local_forces = make_update(effects, real), make_add_local_forces(effects, real)
    membrane_tension = make_membrane_tension(real)
    moment, fused, from_lane = make_moment(effects, real), make_fused(real), make_from_lane(real)
    Material, Parameters, (Forcing, Fields) = make_material(real), make_parameters(real), make_state(real)
    size = wp.types.type_size_in_bytes(real)
    columns, margin, strip_count = COLUMNS, margin_of(effects, levels), strips(nx, margin_of(effects, levels))
    useful, width = LANES * columns - 2 * margin, plane_width(effects, nx, levels) // columns
    at_plane = {name: index * (ny + 2 + 4 * margin) * width for index, name in enumerate(planes)}
    middle_row = (ny // 2 + 2 * margin) * width  # index of a row in the middle of a plane
    read_row, write_row, row_at = make_row_access(real, ny, stride)
    read_pair = make_pairs(real)[0]
    Row = wp.types.vector(length=columns, dtype=real)
    Rows = wp.types.matrix(shape=(levels * ROUND, columns), dtype=real)
    Round = wp.types.matrix(shape=(ROUND, columns), dtype=real)
    Levels = wp.types.vector(length=levels, dtype=real)
    Inner = wp.types.matrix(shape=(len(planes) if alike else 1, columns), dtype=real)
    strained = effects.retarded
    warps = FEWER_WARPS if real is wp.float64 or (alike and levels > 1) else WARPS

    @wp.func
    def read_material(lane: wp.uint64, at: int):
        """Read the lane's columns of a material plane, of which ``at`` counts pairs of columns."""
        return read_pair(lane + wp.uint64(at * wp.static(columns * size)))

    @cache
    def reader(name, plain):
        """Make a function that returns the lane's columns of a plane, at index ``at`` of its rows."""

        @wp.func
        def inner_coefficient(inner: Inner, lane: wp.uint64, at: int):
            return inner[wp.static(planes.index(name))]

        @wp.func
        def coefficient(inner: Inner, lane: wp.uint64, at: int):
            return read_material(lane, at + wp.static(at_plane[name]))

        return inner_coefficient if alike and plain else coefficient

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

    @cuda_kernel(most_registers(warps), max_unroll=32)
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
        wave: wp.array3d[real],  # drive.wave and drive.loads: fields of structs are fetched anew wherever they are used
        loads: wp.array4d[real],
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
        inner = Inner()
        if wp.static(alike):
            for plane in range(wp.static(len(planes))):
                at_middle = wp.static(middle_row + plane * (ny + 2 + 4 * margin) * width)
                inner[plane] = read_material(lane_material, at_middle)
        column = wp.min(wp.max(x0, 0), wp.static((nx - 1) // columns * columns))
        field = wp.int64(k) * wp.int64(wp.static((ny + 2) * stride)) + wp.int64(column)
        part = wp.uint64(field) * wp.uint64(wp.static(size))
        term_size = wp.uint64(loads.shape[1]) * wp.uint64(wp.static((ny + 2) * stride * size))
        lane_u = old.u.ptr + part
        lane_rate = old.rate.ptr + part
        lane_u_next = new.u.ptr + part
        lane_rate_next = new.rate.ptr + part
        lane_squares = new.squares.ptr + part
        stores = lane * wp.static(columns) >= wp.static(margin)
        stores = stores and lane * wp.static(columns) < wp.static(margin + useful) and x0 < wp.static(nx)

        tension = real(0.0)
        if wp.static(effects.membrane):
            for other in range(lane, old_sums.shape[1], LANES):
                tension += old_sums[k, other]
            tension = membrane_tension(drive, p, k, sum_of_warp(tension, lane))
        warp_sum = real(0.0)

        # Windows of each level: displacement, what causes stress, rates, moments and sums. Twists are those of the row
        # of cells above a row; of the neighbours that come from other lanes, the last ones.
        window_u = Rows()
        window_strained = Rows()
        window_rate = Rows()
        window_mx = Rows()
        window_my = Rows()
        window_twist = Rows()
        window_sum = Rows()
        window_east = Levels()
        window_west_twist = Levels()
        new_rows = Round()
        # Rows are requested a round ahead, so that memory has time to answer.
        ahead_u = Round()
        ahead_rate = Round()
        ahead_squares = Round()
        first = low - wp.static(margin)
        for phase in range(wp.static(ROUND)):
            ahead_u[phase] = read_row(lane_u, row_at(first + phase))
            ahead_rate[phase] = read_row(lane_rate, row_at(first + phase))
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
                                lane_load = loads.ptr + wp.uint64(t) * term_size + part
                                parts = Rows()
                                for phase in range(wp.static(ROUND)):
                                    for level in range(wp.static(levels)):
                                        where = row_at(start + phase - wp.static(REACH * (level + 1)))
                                        parts[wp.static(ROUND * level + phase)] = read_row(lane_load, where)
                                for phase in range(wp.static(ROUND)):
                                    for level in range(wp.static(levels)):
                                        for c in range(wp.static(columns)):
                                            slot = wp.static(ROUND * level + phase)
                                            pressed[slot, c] += wave[k, n + level, t] * parts[slot, c]
                    for phase in range(wp.static(ROUND)):
                        y = start + phase
                        above = ahead_u[phase]
                        above_rate = ahead_rate[phase]
                        total = ahead_squares[phase]  # of the row that level 1 moves
                        next_u = at + wp.static((margin + ROUND + phase) * stride)
                        next_squares = at + wp.static((margin + ROUND - REACH + phase) * stride)
                        if wp.static(body == 1):
                            next_u = row_at(y + wp.static(ROUND))
                            next_squares = row_at(y + wp.static(ROUND - REACH))
                        ahead_u[phase] = read_row(lane_u, next_u)
                        ahead_rate[phase] = read_row(lane_rate, next_u)
                        if wp.static(summed):
                            ahead_squares[phase] = read_row(lane_squares, next_squares)

                        for level in range(wp.static(levels)):
                            # ``above`` is row y − 2·level of this level; ``here`` is the row that it moves.
                            here = y - wp.static(REACH * (level + 1))
                            newest = wp.static(ROUND * level + phase)
                            second = wp.static(ROUND * level + (phase + 2) % ROUND)  # the row below
                            third = wp.static(ROUND * level + (phase + 1) % ROUND)
                            here_at = material_at + wp.static((margin + phase - REACH * (level + 1)) * width)
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
                                window_strained[newest] = strain
                            else:
                                window_strained[newest] = above

                            # Moments of the row below ``above``, and twists of the cells below that row.
                            centre = window_strained[second]
                            below = window_strained[third]
                            from_east = from_lane(centre[0], lane + 1)
                            along_x = sum_of_neighbours(centre, from_lane(centre[1], lane - 1), from_east, west, east)
                            bend_xx = wp.static(reader("bend_xx", body == 0))(inner, lane_material, next_at)
                            bend_xy = wp.static(reader("bend_xy", body == 0))(inner, lane_material, next_at)
                            bend_yy = wp.static(reader("bend_yy", body == 0))(inner, lane_material, next_at)
                            rigidity = wp.static(reader("twist", body == 0))(inner, lane_material, here_at)
                            mx = Row()
                            my = Row()
                            twist = Row()
                            for c in range(wp.static(columns)):
                                curved_x = along_x[c] - real(2.0) * centre[c]
                                neighbours = fused(south_1, below[c], (real(2.0) - south_1) * strain[c])
                                curved_y = p.aspect * (neighbours - real(2.0) * centre[c])
                                u_1 = window_u[second, c]
                                mx[c] = moment(bend_xx[c], curved_x, bend_xy[c], curved_y, p.in_plane_x, u_1)
                                my[c] = moment(bend_yy[c], curved_y, bend_xy[c], curved_x, p.in_plane_y, u_1)
                            twisted = (centre[1] - below[1]) - (centre[0] - below[0])
                            twist[0] = rigidity[0] * (p.root_aspect * twisted)
                            twisted = (from_east - window_east[level]) - (centre[1] - below[1])
                            twist[1] = rigidity[1] * (p.root_aspect * twisted)
                            window_east[level] = from_east

                            # The force on the row ``here``, and its step.
                            mx_here = window_mx[third]
                            from_west = from_lane(mx_here[1], lane - 1)
                            sum_x = sum_of_neighbours(mx_here, from_west, from_lane(mx_here[0], lane + 1), west, east)
                            west_twist = from_lane(twist[1], lane - 1)
                            bending = Row()
                            for c in range(wp.static(columns)):
                                sum_y = fused(south_2, window_my[newest, c], (real(2.0) - south_2) * my[c])
                                bending[c] = sum_x[c] - real(2.0) * mx_here[c]
                                bending[c] = fused(p.aspect, sum_y - real(2.0) * window_my[third, c], bending[c])
                            corner = (window_west_twist[level] - west_twist) + (twist[0] - window_twist[third, 0])
                            bending[0] = fused(twice_y * twice[0], corner, bending[0])
                            corner = (window_twist[third, 0] - twist[0]) + (twist[1] - window_twist[third, 1])
                            bending[1] = fused(twice_y * twice[1], corner, bending[1])
                            window_west_twist[level] = west_twist
                            membrane = Row()
                            if wp.static(effects.membrane):
                                middle = window_u[third]
                                from_west = from_lane(middle[1], lane - 1)
                                along = sum_of_neighbours(middle, from_west, from_lane(middle[0], lane + 1), west, east)
                                for c in range(wp.static(columns)):
                                    neighbours = fused(
                                        south_2, window_u[newest, c], (real(2.0) - south_2) * window_u[second, c]
                                    )
                                    u_yy = neighbours - real(2.0) * middle[c]
                                    membrane[c] = fused(
                                        p.aspect * p.stretch_ratio, u_yy, along[c] - real(2.0) * middle[c]
                                    )
                            inverse_mass = wp.static(reader("inverse_mass", body == 0))(inner, lane_material, here_at)
                            decay = Row()
                            if wp.static(effects.damping):
                                decay = wp.static(reader("decay", body == 0))(inner, lane_material, here_at)
                            spring = Row()
                            if wp.static(effects.springs):
                                spring = wp.static(reader("spring", body == 0))(inner, lane_material, here_at)
                            stepped = Row()
                            stepped_rate = Row()
                            for c in range(wp.static(columns)):
                                u_here = window_u[third, c]
                                load = add_local_forces(
                                    pressed[newest, c], inverse_mass[c], spring[c], u_here, tension, membrane[c]
                                )
                                parameters = Parameters()
                                parameters.decay = decay[c]
                                before = window_rate[third, c]
                                stepped_rate[c] = update(before, bending[c], load, inverse_mass[c], parameters)
                                stepped[c] = u_here + stepped_rate[c]
                                if wp.static(summed and level > 0):
                                    partial = window_sum[third, c]
                                    window_sum[newest, c] = total[c]
                                    total[c] = fused(before, before, partial)
                            window_u[newest] = above
                            window_rate[newest] = above_rate
                            window_mx[second] = mx
                            window_my[second] = my
                            window_twist[second] = twist
                            above = stepped
                            above_rate = stepped_rate

                        if wp.static(effects.membrane):
                            # The membrane curvature of the row below the one that stepped, after the step.
                            row = y - wp.static(REACH + 1)
                            new_rows[phase] = above
                            u_row = new_rows[wp.static((phase + 2) % ROUND)]
                            from_west = from_lane(u_row[1], lane - 1)
                            along = sum_of_neighbours(u_row, from_west, from_lane(u_row[0], lane + 1), west, east)
                            south = wp.where(row == 1, real(0.0), wp.where(row == wp.static(ny), real(2.0), real(1.0)))
                            weight_at = material_at + wp.static((margin + phase - REACH - 1) * width)
                            weight = wp.static(reader("weight", body == 0))(inner, lane_material, weight_at)
                            for c in range(wp.static(columns)):
                                neighbours = fused(
                                    south, new_rows[wp.static((phase + 1) % ROUND), c], (real(2.0) - south) * above[c]
                                )
                                u_yy = neighbours - real(2.0) * u_row[c]
                                curved = fused(p.aspect * p.stretch_ratio, u_yy, along[c] - real(2.0) * u_row[c])
                                if stores and row >= low and row < high:
                                    warp_sum -= weight[c] * u_row[c] * curved

                        done = y - wp.static(REACH * levels)
                        storing = stores and done >= low
                        to = at + wp.static((margin - REACH * levels + phase) * stride)
                        if wp.static(body == 1):
                            storing = storing and done < high
                            to = opaque(wp.max(done, 0) * wp.static(stride))
                        elif wp.static(effects.membrane):
                            storing = storing and done < high
                        if storing:
                            write_row(lane_u_next, to, above)
                            write_row(lane_rate_next, to, above_rate)
                            if wp.static(summed):
                                for c in range(wp.static(columns)):
                                    total[c] = fused(above_rate[c], above_rate[c], total[c])
                                write_row(lane_squares, to, total)

        if wp.static(effects.membrane):
            warp_sum = sum_of_warp(warp_sum, lane)
            if lane == 0:
                new_sums[k, tile * wp.static(strip_count) + strip] = warp_sum

    return advance_tiles
