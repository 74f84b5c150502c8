"""Resident path on CPU: one launch runs all steps, a plate at a time, so that a plate stays in the cache.

A small plate is walked in as few ranges as there are different taps along y; a large one row by row, each row moved
as soon as the curvatures around it are known.

A plate too large for one core is shared by a crew: as many launches, from as many Python threads, each walk their
own band of rows of the same plate, and meet after each pass. Many small plates go faster in groups: see
``resident_cpu_groups``, which uses the same two passes.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.denormals import flush_denormals, restore_denormals
from warp_plate.kernels.resident_cpu_passes import make_passes, taps_along_y
from warp_plate.kernels.update import make_parameters

# Above this many nodes in a plate, passes go row by row: two planes of factors would no longer stay in L1.
FLAT_NODES = 4096

# Waiting first spins, for a meeting takes less than a microsecond. Where another program holds the core that the late
# one needs, it then lets that one run, through the system's own call.
_MEET = """
__atomic_add_fetch(&arrived.data[0], 1, __ATOMIC_ACQ_REL);
for (int spins = 0; __atomic_load_n(&arrived.data[0], __ATOMIC_ACQUIRE) < goal; ++spins)
    if (spins > 4000) ((void (*)(void))let_others_run)();
"""


@wp.func_native(_MEET)
def meet(arrived: wp.array[int], goal: int, let_others_run: wp.uint64):
    """Counts the caller in and waits until ``goal`` have come; launches run at the same time on CPU threads.

    let_others_run: address of the C function that gives up the core for a while, sched_yield for one.
    """
    ...


def ranges(ny, row, order):
    """(first row, rows) of the ranges that each pass walks, or None where it goes row by row.

    row: numbers a row. Of fourth order, the rows next to an edge have taps of their own.
    """
    if ny * row > FLAT_NODES:
        return None
    if order == 2:
        return [(0, ny)], [(1, ny - 2)]
    bend = [(0, 1), (1, 1), (2, ny - 4), (ny - 2, 1), (ny - 1, 1)]
    move = [(1, 1), (2, 1), (3, ny - 6), (ny - 3, 1), (ny - 2, 1)]
    return bend, move


def line_of(ny, row, order):
    """Numbers in a line of taps along x: as many as the longest range has nodes."""
    return row if order == 2 or ny * row > FLAT_NODES else (ny - 4) * row


@cache
def make_run(effects, real, ny, stride, compiler_flags):
    """Steps ``start`` ... ``stop`` − 1 of the plates from ``first`` on; launch over (plates,).

    crew: launches that share one plate, 1 for none; member: which of them this is; arrived: zero before the first;
    let_others_run: see ``meet``.
    bend_x: of second order, curvature factors of all rows, or of the bottom, an inner and the top one where it goes row
    by row; of fourth order five lines of ``line_of`` taps, and move_x the same for the second pass;
    bend_y, move_y: (1, 1) the aspect, or (ny, 5) taps, where the two edges' rows weigh the five rows inside them;
    stiffness: of the nodes of the longest range of the second pass, zero where a node is held or padding;
    wave: (plates, steps, 2), cos and sin ωt, see ``wave``; window: first and last + 1 of the steps whose rate² is
    summed; nodes: (traced nodes, 2), row and column; trace: (plates, traced nodes, steps).
    """
    Parameters = make_parameters(real)
    order, reach = effects.order, effects.order // 2
    line = line_of(ny, stride, order)
    whole = ranges(ny, stride, order)
    bends, moves = whole or ([], [])
    rows_bent, rows_moved = (max(count for _, count in walk) for walk in whole or ([(0, 1)], [(1, 1)]))
    bend_row, move_row, _ = make_passes(effects, real, stride, 1, stride, stride, True, line)
    bend_many, move_many, _ = make_passes(effects, real, stride, 1, rows_bent * stride, rows_moved * stride, True, line)
    wave_of = wp.types.vector(length=2, dtype=real)
    rows_of = wp.types.vector(length=taps_along_y(order), dtype=real)
    places_of = wp.types.vector(length=order + 1, dtype=wp.uint64)
    row_bytes = stride * wp.types.type_size_in_bytes(real)

    @wp.func
    def row_at(plane: wp.uint64, row: int):
        """Address of a row of the tensor."""
        return plane + wp.uint64(row) * wp.uint64(wp.static(row_bytes))

    @wp.func
    def taps_of_row(taps: wp.array2d[real], j: int):
        rows = rows_of()
        for tap in range(wp.static(taps_along_y(order))):
            rows[tap] = taps[wp.where(wp.static(order == 2), 0, j), tap]
        return rows

    @wp.func
    def lowest_row(j: int):
        """Row of the tensor where the window of node row j begins: those of the edges end with the tensor."""
        return wp.min(wp.max(j + 1 - wp.static(reach), 0), wp.static(ny + 1 - 2 * reach))

    @wp.func
    def bend_one(
        u_plane: wp.uint64, columns: wp.uint64, taps: wp.array2d[real], curvature_plane: wp.uint64, j: int
    ):
        """Curvature of node row j, which lies in row j + 1 of the tensor."""
        factors = columns
        if wp.static(order == 2):
            pattern = wp.where(j == 0, 0, wp.where(j == wp.static(ny - 1), 2, 1))
            factors = row_at(columns, pattern)
        low = row_at(u_plane, lowest_row(j))
        bend_row(low, row_at(u_plane, j + 1), factors, taps_of_row(taps, j), row_at(curvature_plane, j + 1))

    @wp.func
    def around(curvature_plane: wp.uint64, j: int):
        places = places_of()
        for place in range(wp.static(order + 1)):
            places[place] = row_at(curvature_plane, j + 1 - wp.static(reach) + place)
        return places

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": 5},
    )
    def run(
        p: Parameters,
        bend_x: wp.array[real],
        move_x: wp.array[real],
        bend_y: wp.array2d[real],
        move_y: wp.array2d[real],
        stiffness: wp.array[real],
        wave: wp.array3d[real],
        window: wp.vec2i,
        start: int,
        stop: int,
        first: int,
        crew: int,
        member: int,
        arrived: wp.array[int],
        let_others_run: wp.uint64,
        nodes: wp.array2d[int],
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
        curvature: wp.array3d[real],
        trace: wp.array3d[real],
    ):
        before = flush_denormals()
        k = first + wp.tid()
        plane = wp.uint64(k) * wp.uint64(wp.static((ny + 2) * row_bytes))
        u_plane = u.ptr + plane
        bent = curvature.ptr + plane
        cosine = in_phase.ptr + plane
        sine = quadrature.ptr + plane
        rates = rate.ptr + plane
        sums = squares.ptr + plane
        # Node rows low + 1 ... high are the member's to move.
        low = member * wp.static(ny - 2) // crew
        high = (member + 1) * wp.static(ny - 2) // crew
        goal = int(0)
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = wave_of(wave[k, n, 0], wave[k, n, 1])
            if wp.static(whole is not None):
                for walk in range(wp.static(len(bends))):
                    if wp.static(bends[walk][1] == rows_bent):
                        j = wp.static(bends[walk][0])
                        bend_many(
                            row_at(u_plane, lowest_row(j)), row_at(u_plane, j + 1), bend_x.ptr,
                            taps_of_row(bend_y, j), row_at(bent, j + 1),
                        )
                    else:
                        bend_one(u_plane, bend_x.ptr, bend_y, bent, wp.static(bends[walk][0]))
                for walk in range(wp.static(len(moves))):
                    j = wp.static(moves[walk][0])
                    if wp.static(moves[walk][1] == rows_moved):
                        move_many(
                            p, stiffness.ptr, move_x.ptr, taps_of_row(move_y, j), waves, summed, around(bent, j),
                            row_at(cosine, j + 1), row_at(sine, j + 1),
                            row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                        )
                    else:
                        move_row(
                            p, stiffness.ptr, move_x.ptr, taps_of_row(move_y, j), waves, summed, around(bent, j),
                            row_at(cosine, j + 1), row_at(sine, j + 1),
                            row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                        )
            else:
                # The curvatures of the band's outermost rows, before a neighbour moves the rows that they rest on.
                if low == 0:
                    bend_one(u_plane, bend_x.ptr, bend_y, bent, 0)
                if high == wp.static(ny - 2):
                    bend_one(u_plane, bend_x.ptr, bend_y, bent, wp.static(ny - 1))
                for depth in range(wp.static(reach)):
                    bend_one(u_plane, bend_x.ptr, bend_y, bent, wp.min(low + 1 + depth, wp.static(ny - 2)))
                    bend_one(u_plane, bend_x.ptr, bend_y, bent, wp.max(high - depth, 1))
                if crew > 1:
                    goal += crew
                    meet(arrived, goal, let_others_run)
                for j in range(low + 1, high + 1):
                    # Row j moves once the curvatures of the rows above it are known.
                    if j + wp.static(2 * reach) <= high:
                        bend_one(u_plane, bend_x.ptr, bend_y, bent, j + wp.static(reach))
                    move_row(
                        p, stiffness.ptr, move_x.ptr, taps_of_row(move_y, j), waves, summed, around(bent, j),
                        row_at(cosine, j + 1), row_at(sine, j + 1),
                        row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                    )
                if crew > 1:
                    goal += crew
                    meet(arrived, goal, let_others_run)
            for m in range(member, nodes.shape[0], crew):
                trace[k, m, n] = u[k, nodes[m, 0], nodes[m, 1]]
        restore_denormals(before)

    return run
