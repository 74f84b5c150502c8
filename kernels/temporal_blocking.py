"""Streaming path on CUDA: temporal blocking, several steps in one pass over memory.

A warp walks up a strip of columns; a lane holds ``COLUMNS`` neighbouring ones. For each new row of u that the warp
reads, level 1 can move the row two below (fourth order: four below) by one step, level 2 the row as far below that by a
second step, and so on: each level needs only the last rows of the level before, which it keeps in registers. After
``levels`` steps a row is written back. So one pass serves several steps, without barriers, at the price of a margin
around each strip that neighbouring warps compute as well.

Each level keeps its last 3 rows (fourth order: 4) in a window; row y is in slot y mod 3 (mod 4), so no register is
copied from slot to slot. The loop over rows is unrolled by as many, which makes a round. Its body is compiled three
times: for rounds that touch neither a loaded row nor an edge, which are most, for those that touch loaded rows alone,
and for the others. In fourth order, nodes at edges are moved like others, with taps of their own, see
``resident_strips``.

Rows are copied to shared memory ``AHEAD`` rounds before they are read. There each field has a ring of rounds; that of
the loads is longer, because each level needs the row of a load when it moves it.

Displacement and rate are double-buffered, because neighbours still read the old ones. ``clock`` counts steps on the
device, so that a captured CUDA graph can be replayed: a launch adds its own offset to it.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.async_copies import make_copies, shared_place
from warp_plate.kernels.cuda import (
    LANES,
    cuda_kernel,
    make_apply_taps,
    make_from_lane,
    make_laplacian_of_row,
    make_pairs,
    most_registers,
    opaque,
    shared_memory,
)
from warp_plate.kernels.resident_strips import SPECIAL
from warp_plate.kernels.update import make_parameters, make_state, make_update, make_update_unloaded

# Columns per lane, which it reads and writes in one access.
COLUMNS = 2
# By order: how many rows below its newest row a level moves one, and the rows of a round, in which every slot of a
# window is written once.
REACH, ROUND = {2: 2, 4: 4}, {2: 3, 4: 4}
# Rounds by which rows are copied ahead.
AHEAD = 2
# Bit of ``loaded`` that is set where the loads of the round AHEAD rounds later will be read.
READ_LATER = 30
# Warps that share a multiprocessor: with eight, a thread may use as many registers as it can address.
WARPS = {(2, wp.float32): 8, (2, wp.float64): 8, (4, wp.float32): 12, (4, wp.float64): 8}


def strips(nx, margin):
    """Return the number of warps that share a row: each moves the nodes of its strip without the margins."""
    return -(-nx // (LANES * COLUMNS - 2 * margin))


@dataclass(frozen=True)
class Rings:
    """Rings of rows in a warp's shared memory, in bytes: first those of u, rate and the sums, one after another."""

    round: int  # length of a round of rows
    field: int  # length of the ring of a field
    load: int  # length of the ring of a load
    loads: int  # start of the rings of both loads
    waves: int  # start of the factors of the loads, a row for each level
    end: int
    rounds_back: int  # how many rounds before the last level's loads were the first level's


def make_rings(order, real, levels, summed):
    """Return the layout of the rings of a warp."""
    row, per_round = LANES * COLUMNS * wp.types.type_size_in_bytes(real), ROUND[order]
    back = -(-REACH[order] * (levels - 1) // per_round)
    field, load = (AHEAD + 1) * per_round * row, (AHEAD + 1 + back) * per_round * row
    loads = (2 + summed) * field
    waves = loads + 2 * load
    return Rings(per_round * row, field, load, loads, waves, waves + levels * row, back)


def warps_of_block(order, real, levels, shared_bytes):
    """Return the warps of a block, which are independent: up to four, as shared memory allows."""
    needed = make_rings(order, real, levels, True).end
    return next(warps for warps in (4, 2, 1) if warps * needed <= shared_bytes or warps == 1)


@cache
def make_row_access(real, ny, stride):
    """Make functions of a lane's columns of a row of a field: read_row, write_row, row_at."""
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

    return read_row, write_row, row_at


@cache
def make_advance_tiles(effects, real, nx, ny, stride, warps, levels, summed):
    """Make the kernel of ``levels`` steps, in the window if ``summed``; launch over (plates · strips · tiles · 32,).

    Blocks have so many warps.
    """
    laplacian_of_row = make_laplacian_of_row(effects.square_cells, real, COLUMNS, False)
    apply_taps = make_apply_taps(real, COLUMNS)
    update, update_unloaded = make_update(effects, real), make_update_unloaded(effects, real)
    Parameters, fused, (Forcing, Fields) = make_parameters(real), make_fused(real), make_state(real)
    order, reach, per_round = effects.order, REACH[effects.order], ROUND[effects.order]
    copy_pair, commit_copies, wait_for_copies, read_pair_if = make_copies(real, per_round * AHEAD - 1)
    _, write_row, row_at = make_row_access(real, ny, stride)
    rings, from_lane = make_rings(order, real, levels, summed), make_from_lane(int)
    size, row_bytes, back = wp.types.type_size_in_bytes(real), rings.round // per_round, rings.rounds_back
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
    Places = wp.types.vector(length=back + 1, dtype=int)

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
        # From the first lane's number the compiler sees that all lanes take the same branches.
        warp = from_lane(wp.tid() // LANES, 0)
        lane = wp.tid() % LANES
        reserved = wp.tile_empty(shape=(wp.static(warps * rings.end // size),), dtype=real, storage="shared")
        ring = shared_place(shared_memory()) + warp % wp.static(warps) * wp.static(rings.end)
        ring += lane * wp.static(columns * size)
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
        plate_wave = drive.wave[k]
        for level in range(wp.static(levels)):
            place = ring + wp.static(rings.waves + level * row_bytes)
            copy_pair(place, plate_wave.ptr, (n + level) * wp.static(2 * size), False)

        # Windows of each level: displacement, curvature, and the rates and sums that the level before passed on.
        window_u = Rows()
        window_curvature = Rows()
        window_rate = Rows()
        window_sum = Rows()
        last_word = wp.static(ny + 1 + 4 * margin)
        # The first rounds; columns beside the plate are zeros.
        first = low - wp.static(margin)
        for ahead in range(wp.static(AHEAD * per_round)):
            place = ring + wp.static(ahead * row_bytes)
            behind = row_at(first + wp.static(ahead - reach)) * wp.static(size)
            copy_pair(place, lane_u, row_at(first + ahead) * wp.static(size), beside)
            copy_pair(place + wp.static(rings.field), lane_rate, behind, beside)
            copy_pair(place + wp.static(rings.loads), lane_in_phase, behind, beside)
            copy_pair(place + wp.static(rings.loads + rings.load), lane_quadrature, behind, beside)
            if wp.static(summed):
                behind = row_at(first + wp.static(ahead - reach - delay)) * wp.static(size)
                copy_pair(place + wp.static(2 * rings.field), lane_squares, behind, beside)
            commit_copies()
        # Rounds of the rings of fields that are read and copied; of loads, their numbers in the rings.
        read_round = ring
        copied_round = ring + wp.static(AHEAD * rings.round)
        read_load = int(0)
        copied_load = int(wp.static(AHEAD))
        # Each lane has the word of ``loaded`` for one of 32 rounds, and for one of the 32 after these.
        word = int(0)
        next_word = loaded[wp.min(first + wp.static(margin) + lane * wp.static(per_round), last_word)]
        for round in range((high - first + wp.static(margin + per_round - 1)) // wp.static(per_round)):
            start = first + wp.static(per_round) * round
            if round % LANES == 0:
                word = next_word
                later = start + wp.static(margin + LANES * per_round) + lane * wp.static(per_round)
                next_word = loaded[wp.min(later, last_word)]
            bits = from_lane(word, round % LANES)  # of rows from start − margin on
            if (bits >> wp.static(READ_LATER)) != 0:
                place = ring + wp.static(rings.loads) + copied_load * wp.static(rings.round)
                for phase in range(wp.static(per_round)):
                    where = row_at(start + wp.static(AHEAD * per_round - reach) + phase) * wp.static(size)
                    copy_pair(place + wp.static(phase * row_bytes), lane_in_phase, where, beside)
                    copy_pair(place + wp.static(phase * row_bytes + rings.load), lane_quadrature, where, beside)
            bits = bits & wp.static((1 << READ_LATER) - 1)
            away = start >= wp.static(margin + edge) and start <= wp.static(ny - (AHEAD + 1) * per_round)
            away = away and start + wp.static(per_round) <= high + wp.static(margin)
            # 0: neither a loaded row nor an edge is touched, 1: loaded rows alone are, 2: edges are.
            kind = wp.where(away, wp.where(bits != 0, 1, 0), 2)
            for body in range(3):
                if kind == body:
                    # Addresses of the lane's columns of row start − margin, at edges those of row 0.
                    skipped = wp.uint64(0)
                    if wp.static(body < 2):
                        skipped = wp.uint64(opaque((start - wp.static(margin)) * wp.static(stride * size)))
                    from_u = lane_u + skipped
                    from_rate = lane_rate + skipped
                    squares = lane_squares + skipped
                    to_u = lane_u_next + skipped
                    to_rate = lane_rate_next + skipped
                    load_rounds = Places()  # of this round and of those before it
                    if wp.static(body > 0):
                        for age in range(wp.static(back + 1)):
                            number = read_load - age
                            if number < 0:
                                number += wp.static(AHEAD + 1 + back)
                            load_rounds[age] = ring + wp.static(rings.loads) + number * wp.static(rings.round)
                    for phase in range(wp.static(per_round)):
                        y = start + phase
                        wait_for_copies()
                        place = read_round + wp.static(phase * row_bytes)
                        above = read_pair_if(True, place)
                        stepped_rate = read_pair_if(True, place + wp.static(rings.field))
                        total = Row()  # of the row that the first level to add to them moves
                        if wp.static(summed):
                            total = read_pair_if(True, place + wp.static(2 * rings.field))
                        next_u = wp.static((margin + AHEAD * per_round + phase) * stride * size)
                        next_rate = wp.static((margin + AHEAD * per_round - reach + phase) * stride * size)
                        next_squares = wp.static((margin + AHEAD * per_round - reach - delay + phase) * stride * size)
                        if wp.static(body == 2):
                            next_u = row_at(y + wp.static(AHEAD * per_round)) * wp.static(size)
                            next_rate = row_at(y + wp.static(AHEAD * per_round - reach)) * wp.static(size)
                            next_squares = row_at(y + wp.static(AHEAD * per_round - reach - delay)) * wp.static(size)
                        place = copied_round + wp.static(phase * row_bytes)
                        copy_pair(place, from_u, next_u, beside)
                        copy_pair(place + wp.static(rings.field), from_rate, next_rate, beside)
                        if wp.static(summed):
                            copy_pair(place + wp.static(2 * rings.field), squares, next_squares, beside)
                        commit_copies()

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
                                if wp.static(body == 2):
                                    factor_row = wp.where(here == 0, bottom, factor_row)
                                    factor_row = wp.where(here == wp.static(ny - 1), top, factor_row)
                                for c in range(wp.static(columns)):
                                    if wp.static(body == 2):
                                        curvature[c] = (factor_row * bend_taps[c, 0]) * bare[c]
                                    else:
                                        curvature[c] = bend_taps[c, 0] * bare[c]
                                biharmonic = laplacian_of_row(
                                    window_curvature[row_3], window_curvature[row_2], curvature, lane, p.aspect
                                )
                            else:
                                bend = inside
                                move = inside
                                if wp.static(body == 2):
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
                            load = Row()
                            if wp.static(body > 0):
                                place = load_rounds[wp.static(-((phase - reach * level) // per_round))]
                                place += wp.static((phase - reach * level) % per_round * row_bytes)
                                wanted = wp.static(body == 1) or bits != 0
                                cosines = read_pair_if(wanted, place)
                                sines = read_pair_if(wanted, place + wp.static(rings.load))
                                wave = read_pair_if(True, ring + wp.static(rings.waves + level * row_bytes))
                                for c in range(wp.static(columns)):
                                    load[c] = fused(wave[0], cosines[c], wave[1] * sines[c])
                            moves = True
                            if wp.static(body == 2):
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
                                if wp.static(body == 2):
                                    stiffness_here = wp.where(moves, stiffness[c], real(0.0))
                                if wp.static(body == 0):
                                    stepped_rate[c] = update_unloaded(before, biharmonic[c], stiffness_here, p)
                                else:
                                    stepped_rate[c] = update(before, biharmonic[c], load[c], stiffness_here, p)
                                entering = above[c]
                                above[c] = window_u[moved, c] + stepped_rate[c]
                                window_u[newest, c] = entering
                                window_curvature[bent, c] = curvature[c]

                        done = y - wp.static(margin)
                        storing = stores and done >= low
                        to = wp.static(phase * stride)
                        if wp.static(body == 2):
                            storing = storing and done < high
                            to = opaque(wp.max(done, 0) * wp.static(stride))
                        if storing:
                            write_row(to_u, to, above)
                            write_row(to_rate, to, stepped_rate)
                            if wp.static(summed):
                                for c in range(wp.static(columns)):
                                    total[c] = fused(stepped_rate[c], stepped_rate[c], total[c])
                                write_row(squares, to, total)
            copied_round = read_round
            read_round += wp.static(rings.round)
            if read_round == ring + wp.static(rings.field):
                read_round = ring
            read_load = wp.where(read_load == wp.static(AHEAD + back), 0, read_load + 1)
            copied_load = wp.where(copied_load == wp.static(AHEAD + back), 0, copied_load + 1)

    return advance_tiles
