"""Resident path on CPU: one launch runs all steps, a plate at a time, so that a plate stays in the cache.

A small plate is walked in as few ranges as there are different taps along y; a large one row by row, each row moved
as soon as the curvatures around it are known.

A plate too large for one core is shared by a team: as many launches, from as many Python threads, each walk their own
band of rows of the same plate and meet after each pass. Many small plates run faster in groups: see
``resident_cpu_groups``, which uses the same two passes.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import flush_denormals, portable_kernel, restore_denormals
from warp_plate.kernels.resident_cpu_passes import make_passes, taps_along_y
from warp_plate.kernels.update import make_parameters

# Largest plate, in numbers, that is walked in flat ranges: beyond it two planes of factors no longer stay in L1.
FLAT_NUMBERS = 4096

# Spin first: a meeting takes less than a microsecond. After that, yield the core to the thread that is late.
_MEET = """
__atomic_add_fetch(&arrived.data[0], 1, __ATOMIC_ACQ_REL);
for (int spins = 0; __atomic_load_n(&arrived.data[0], __ATOMIC_ACQUIRE) < goal; ++spins)
    if (spins > 4000) ((void (*)(void))yield_core)();
"""


@wp.func_native(_MEET)
def meet(arrived: wp.array[int], goal: int, yield_core: wp.uint64):
    """Count the caller in and wait until ``goal`` have arrived; ``yield_core``: address of sched_yield or the like."""


def flat_ranges(ny, row, order):
    """Return the ranges of both passes as lists of (first row, rows), or None where plates are walked row by row.

    ``row``: numbers in a row. In fourth order, the rows next to an edge have taps of their own.
    """
    if ny * row > FLAT_NUMBERS:
        return None
    if order == 2:
        return [(0, ny)], [(1, ny - 2)]
    curvature = [(0, 1), (1, 1), (2, ny - 4), (ny - 2, 1), (ny - 1, 1)]
    update = [(1, 1), (2, 1), (3, ny - 6), (ny - 3, 1), (ny - 2, 1)]
    return curvature, update


def tap_line(ny, row, order):
    """Return the numbers in a line of taps along x: as many as the longest range has nodes."""
    return row if order == 2 or ny * row > FLAT_NUMBERS else (ny - 4) * row


@cache
def make_run_steps(effects, real, ny, stride):
    """Make the kernel of steps ``start`` … ``stop`` − 1 of plates from ``first`` on; launch over (plates,), or by each
    member of a team at the same time over (1,)."""
    Parameters = make_parameters(real)
    order, reach = effects.order, effects.order // 2
    line = tap_line(ny, stride, order)
    flat = flat_ranges(ny, stride, order)
    bends, moves = flat or ([], [])
    bend_rows, move_rows = (max(count for _, count in ranges) for ranges in flat or ([(0, 1)], [(1, 1)]))
    bend_row, move_row, _ = make_passes(effects, real, stride, 1, stride, stride, True, line)
    bend_flat, move_flat, _ = make_passes(effects, real, stride, 1, bend_rows * stride, move_rows * stride, True, line)
    Wave = wp.types.vector(length=2, dtype=real)
    RowTaps = wp.types.vector(length=taps_along_y(order), dtype=real)
    Rows = wp.types.vector(length=order + 1, dtype=wp.uint64)
    row_bytes = stride * wp.types.type_size_in_bytes(real)

    @wp.func
    def row_at(plane: wp.uint64, row: int):
        """Return the address of a row of the tensor."""
        return plane + wp.uint64(row) * wp.uint64(wp.static(row_bytes))

    @wp.func
    def taps_of_row(taps: wp.array2d[real], j: int):
        rows = RowTaps()
        for tap in range(wp.static(taps_along_y(order))):
            rows[tap] = taps[wp.where(wp.static(order == 2), 0, j), tap]
        return rows

    @wp.func
    def lowest_row(j: int):
        """Return the tensor row where the stencil of node row j begins; at an edge it ends with the tensor."""
        return wp.min(wp.max(j + 1 - wp.static(reach), 0), wp.static(ny + 1 - 2 * reach))

    @wp.func
    def bend_node_row(
        u_plane: wp.uint64, columns: wp.uint64, taps: wp.array2d[real], curvature_plane: wp.uint64, j: int
    ):
        """Compute the curvature of node row j, which lies in row j + 1 of the tensor."""
        factors = columns
        if wp.static(order == 2):
            pattern = wp.where(j == 0, 0, wp.where(j == wp.static(ny - 1), 2, 1))
            factors = row_at(columns, pattern)
        low = row_at(u_plane, lowest_row(j))
        bend_row(low, row_at(u_plane, j + 1), factors, taps_of_row(taps, j), row_at(curvature_plane, j + 1))

    @wp.func
    def rows_around(curvature_plane: wp.uint64, j: int):
        rows = Rows()
        for place in range(wp.static(order + 1)):
            rows[place] = row_at(curvature_plane, j + 1 - wp.static(reach) + place)
        return rows

    @portable_kernel(max_unroll=5)
    def run_steps(
        # parameters
        p: Parameters,
        bend_x: wp.array[real],  # order 2: curvature factors of all rows, or of the bottom, an inner and the top one
        move_x: wp.array[real],  # order 4: five lines of ``tap_line`` taps; bend_x too
        bend_y: wp.array2d[real],  # (1, 1) aspect or (ny, 5) taps, those of an edge for the five rows inside it
        move_y: wp.array2d[real],
        stiffness: wp.array[real],  # of the nodes of the longest range, zero where held or padding
        wave: wp.array3d[real],  # (plates, steps, 2) cos ωt and sin ωt
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        start: int,
        stop: int,
        first: int,
        team: int,  # launches that share one plate, or 1
        member: int,
        arrived: wp.array[int],  # (1,) zero before the first launch of a team
        yield_core: wp.uint64,
        nodes: wp.array2d[int],  # (traced nodes, 2) row, column
        # inputs; all fields are (plates, rows, stride)
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        # outputs
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
        curvature: wp.array3d[real],
        trace: wp.array3d[real],  # (plates, traced nodes, steps)
    ):
        before = flush_denormals()
        k = first + wp.tid()
        plane = wp.uint64(k) * wp.uint64(wp.static((ny + 2) * row_bytes))
        u_plane = u.ptr + plane
        curvature_plane = curvature.ptr + plane
        cosine = in_phase.ptr + plane
        sine = quadrature.ptr + plane
        rates = rate.ptr + plane
        sums = squares.ptr + plane
        # The member moves node rows low + 1 … high.
        low = member * wp.static(ny - 2) // team
        high = (member + 1) * wp.static(ny - 2) // team
        goal = int(0)
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = Wave(wave[k, n, 0], wave[k, n, 1])
            if wp.static(flat is not None):
                for index in range(wp.static(len(bends))):
                    j = wp.static(bends[index][0])
                    if wp.static(bends[index][1] == bend_rows):
                        bend_flat(
                            row_at(u_plane, lowest_row(j)), row_at(u_plane, j + 1), bend_x.ptr,
                            taps_of_row(bend_y, j), row_at(curvature_plane, j + 1),
                        )
                    else:
                        bend_node_row(u_plane, bend_x.ptr, bend_y, curvature_plane, j)
                for index in range(wp.static(len(moves))):
                    j = wp.static(moves[index][0])
                    wp.static(move_flat if moves[index][1] == move_rows else move_row)(
                        p, stiffness.ptr, move_x.ptr, taps_of_row(move_y, j), waves, summed,
                        rows_around(curvature_plane, j), row_at(cosine, j + 1), row_at(sine, j + 1),
                        row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                    )
            else:
                # The curvatures of the band's outermost rows, before a neighbour moves the rows that they depend on.
                if low == 0:
                    bend_node_row(u_plane, bend_x.ptr, bend_y, curvature_plane, 0)
                if high == wp.static(ny - 2):
                    bend_node_row(u_plane, bend_x.ptr, bend_y, curvature_plane, wp.static(ny - 1))
                for depth in range(wp.static(reach)):
                    inside = wp.min(low + 1 + depth, wp.static(ny - 2))
                    bend_node_row(u_plane, bend_x.ptr, bend_y, curvature_plane, inside)
                    bend_node_row(u_plane, bend_x.ptr, bend_y, curvature_plane, wp.max(high - depth, 1))
                if team > 1:
                    goal += team
                    meet(arrived, goal, yield_core)
                for j in range(low + 1, high + 1):
                    # Row j moves once the curvatures of the rows above it are known.
                    if j + wp.static(2 * reach) <= high:
                        bend_node_row(u_plane, bend_x.ptr, bend_y, curvature_plane, j + wp.static(reach))
                    move_row(
                        p, stiffness.ptr, move_x.ptr, taps_of_row(move_y, j), waves, summed,
                        rows_around(curvature_plane, j), row_at(cosine, j + 1), row_at(sine, j + 1),
                        row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                    )
                if team > 1:
                    goal += team
                    meet(arrived, goal, yield_core)
            for m in range(member, nodes.shape[0], team):
                trace[k, m, n] = u[k, nodes[m, 0], nodes[m, 1]]
        restore_denormals(before)

    return run_steps
