"""Resident path on CPU: one launch runs all steps, a plate at a time, so that a plate stays in the cache.

LLVM vectorises a loop only over plain memory with a fixed count. So each of the two passes of a step walks one flat
range of nodes of compile-time length, through arrays made from addresses; padding takes part and stays zero, because
its stiffness is zero. Before each range LLVM's code checks that no arrays overlap, which makes short ranges expensive.
The first pass computes the curvature of every node from u, the second the rate and u in place from the curvature; it
reads u at no other node. Along x, the first pass of second order reads a factor on each node's curvature, and both
passes of fourth order read five lines of taps. Along y, all nodes of a range share the aspect or five taps.

A small plate is walked in as few ranges as there are different taps along y; a large one row by row, each row moved
as soon as the curvatures around it are known. A plate too large for one core is shared by a team: as many launches,
from as many Python threads, each walk a band of rows of the same plate and meet after each pass. Many small plates run
faster in groups, by the same two passes: see ``resident_cpu_groups``.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import flush_denormals, make_fused, portable_kernel, restore_denormals
from warp_plate.kernels.update import make_laplacian, make_parameters, make_state, make_update, make_weighted_sum

# Largest plate, in numbers, that is walked in flat ranges: beyond it two planes of factors no longer stay in L1.
FLAT_NUMBERS = 4096

# Spin first: a meeting takes less than a microsecond. After that, yield the core to the thread that is late.
_MEET = """
__atomic_add_fetch(&arrived.data[0], 1, __ATOMIC_ACQ_REL);
for (int spins = 0; __atomic_load_n(&arrived.data[0], __ATOMIC_ACQUIRE) < goal; ++spins)
    if (spins > 4000) ((void (*)(void))yield_core)();
"""


def taps_along_y(order):
    """Return how many numbers a range has for its neighbours along y: the aspect, or the taps of fourth order."""
    return 1 if order == 2 else 5


@cache
def make_passes(effects, real, row, node, curvature_count, update_count, masked, tap_line=0):
    """Make the passes, functions of addresses: compute_curvature, and update_range by ``make_update_range(loaded)``.

    Args:
        row, node: Numbers from a node to its neighbour along y and along x.
        curvature_count, update_count: Lengths of the ranges of the first and the second pass.
        masked: Each node has its own stiffness, zero where it is held (else: all share ``Parameters.stiffness``).
        tap_line: Numbers from a node's tap along x to its next one.
    """
    order, reach = effects.order, effects.order // 2
    laplacian = make_laplacian(effects.square_cells, real)
    weighted_sum = make_weighted_sum(real)
    update = make_update(effects, real)
    fused = make_fused(real)
    size = wp.types.type_size_in_bytes(real)
    Parameters = make_parameters(real)
    Wave = wp.types.vector(length=2, dtype=real)
    Taps = wp.types.vector(length=5, dtype=real)
    RowTaps = wp.types.vector(length=taps_along_y(order), dtype=real)
    Rows = wp.types.vector(length=2 * reach + 1, dtype=wp.uint64)
    length = curvature_count + 4 * max(row, tap_line)

    @wp.func
    def array_at(address: wp.uint64):
        return wp.array(ptr=address, shape=(wp.static(length),), dtype=real)

    @wp.func
    def add_along_x(total: real, columns: wp.array[real], field: wp.array[real], i: int):
        """Add to a sum the five taps of node i times the nodes around it, the first of which is field[i]."""
        taps = Taps()
        for tap in range(5):
            taps[tap] = columns[i + tap * wp.static(tap_line)]
        return weighted_sum(
            total, taps, field[i], field[i + wp.static(node)], field[i + wp.static(2 * node)],
            field[i + wp.static(3 * node)], field[i + wp.static(4 * node)],
        )

    if order == 2:
        @wp.func
        def compute_curvature(
            u_low: wp.uint64, u_here: wp.uint64, columns: wp.uint64, rows: RowTaps, curvature_at: wp.uint64
        ):
            """``u_low``: a row below the range; ``columns``: factors on the curvature."""
            # One array with neighbours at fixed distances: the fewer pointers, the fewer overlaps LLVM checks.
            u = array_at(u_low)
            factor = array_at(columns)
            curvature = array_at(curvature_at)
            for i in range(wp.static(curvature_count)):
                curvature[i] = factor[i] * laplacian(
                    u[i + wp.static(row)], u[i + wp.static(row - node)], u[i + wp.static(row + node)], u[i],
                    u[i + wp.static(2 * row)], rows[0],
                )

    else:
        @wp.func
        def compute_curvature(
            u_low: wp.uint64, u_here: wp.uint64, columns: wp.uint64, rows: RowTaps, curvature_at: wp.uint64
        ):
            """``u_low``: the lowest of the five rows that ``rows`` weighs; ``u_here``: the range itself."""
            u = array_at(u_low)
            u_along_x = array_at(u_here - wp.uint64(wp.static(2 * node * size)))
            column = array_at(columns)
            curvature = array_at(curvature_at)
            for i in range(wp.static(curvature_count)):
                along_y = weighted_sum(
                    real(0.0), rows, u[i], u[i + wp.static(row)], u[i + wp.static(2 * row)], u[i + wp.static(3 * row)],
                    u[i + wp.static(4 * row)],
                )
                curvature[i] = add_along_x(along_y, column, u_along_x, i)

    def make_update_range(loaded):
        """Make update_range for rows with loads or without."""

        @wp.func
        def rate_after(
            p: Parameters, stiffness: wp.array[real], columns: wp.array[real], rows: RowTaps, low: wp.array[real],
            south: wp.array[real], centre: wp.array[real], north: wp.array[real], high: wp.array[real], wave: Wave,
            in_phase: wp.array[real], quadrature: wp.array[real], rate: wp.array[real], i: int,
        ):
            biharmonic = real(0.0)
            if wp.static(order == 2):
                west = centre[i]
                east = centre[i + wp.static(2 * node)]
                biharmonic = laplacian(centre[i + wp.static(node)], west, east, south[i], north[i], rows[0])
            else:
                middle = centre[i + wp.static(2 * node)]
                along_y = weighted_sum(real(0.0), rows, low[i], south[i], middle, north[i], high[i])
                biharmonic = add_along_x(along_y, columns, centre, i)
            load = real(0.0)
            if wp.static(loaded):
                load = wave[0] * in_phase[i] + wave[1] * quadrature[i]
            node_stiffness = p.stiffness
            if wp.static(masked):
                node_stiffness = stiffness[i]
            return update(rate[i], biharmonic, load, node_stiffness, p)

        @wp.func
        def update_range(
            p: Parameters, stiffness_at: wp.uint64, columns: wp.uint64, rows: RowTaps, wave: Wave, summed: bool,
            curvature_rows: Rows, in_phase_at: wp.uint64, quadrature_at: wp.uint64, u_at: wp.uint64, rate_at: wp.uint64,
            squares_at: wp.uint64,
        ):
            """``curvature_rows``: the range's first node in its own row and in those around it, lowest first."""
            stiffness = array_at(stiffness_at)
            column = array_at(columns)
            low = array_at(curvature_rows[0])
            south = array_at(curvature_rows[wp.static(reach - 1)])
            centre = array_at(curvature_rows[wp.static(reach)] - wp.uint64(wp.static(reach * node * size)))
            north = array_at(curvature_rows[wp.static(reach + 1)])
            high = array_at(curvature_rows[wp.static(2 * reach)])
            in_phase = array_at(in_phase_at)
            quadrature = array_at(quadrature_at)
            u = array_at(u_at)
            rate = array_at(rate_at)
            squares = array_at(squares_at)
            # Two loops: one loop with a branch on ``summed`` is slower by a third.
            if summed:
                for i in range(wp.static(update_count)):
                    new = rate_after(
                        p, stiffness, column, rows, low, south, centre, north, high, wave, in_phase, quadrature, rate, i
                    )
                    rate[i] = new
                    u[i] = u[i] + new
                    squares[i] = fused(new, new, squares[i])
            else:
                for i in range(wp.static(update_count)):
                    new = rate_after(
                        p, stiffness, column, rows, low, south, centre, north, high, wave, in_phase, quadrature, rate, i
                    )
                    rate[i] = new
                    u[i] = u[i] + new

        return update_range

    return compute_curvature, make_update_range


@wp.func_native(_MEET)
def meet(arrived: wp.array[int], goal: int, yield_core: wp.uint64):
    """Count the caller in and wait until ``goal`` have arrived; ``yield_core``: address of sched_yield or the like."""


def walked_flat(ny, row):
    """Return whether plates of ``ny`` rows of ``row`` numbers are walked in flat ranges, not row by row."""
    return ny * row <= FLAT_NUMBERS


def end_rows(order):
    """Return how many rows next to an edge have taps of their own along y, and are walked alone."""
    return 0 if order == 2 else 2


def tap_line(ny, row, order):
    """Return the numbers in a line of taps along x: as many as the longest range has nodes."""
    return row if order == 2 or not walked_flat(ny, row) else (ny - 2 * end_rows(order)) * row


@cache
def make_factors(real):
    """Make the struct Factors: what both passes read beside the fields, of ``resident_cpu`` or of its groups."""

    @wp.struct
    class Factors:
        bend_x: wp.array[real]  # order 2: curvature factors of all rows, or of the bottom, an inner and the top one
        move_x: wp.array[real]  # order 4: five lines of ``tap_line`` taps; bend_x too
        bend_y: wp.array2d[real]  # (1, 1) aspect or (ny, 5) taps, those of an edge for the five rows inside it
        move_y: wp.array2d[real]
        stiffness: wp.array[real]  # of the nodes of the longest range, zero where held or padding
        loaded: wp.array[int]  # (ny + 2,) 1 for tensor rows with loaded nodes, else 0; of groups

    return Factors


@wp.struct
class Team:
    """Launches that share one plate."""

    size: int
    member: int
    arrived: wp.array[int]  # (1,) zero before the first launch
    yield_core: wp.uint64


@cache
def make_run_steps(effects, real, ny, stride):
    """Make the kernel of steps ``start`` … ``stop`` − 1 of plates from ``first`` on; launch over (plates,), or by each
    member of a team at the same time over (1,)."""
    Parameters, Factors, (Forcing, Fields) = make_parameters(real), make_factors(real), make_state(real)
    order, reach = effects.order, effects.order // 2
    line = tap_line(ny, stride, order)
    flat, ends = walked_flat(ny, stride), end_rows(order)
    inner = (ny - 2 * ends) * stride if flat else stride
    updated = max(inner - 2 * stride, stride)
    bend_row, make_move_row = make_passes(effects, real, stride, 1, stride, stride, True, line)
    bend_flat, make_move_flat = make_passes(effects, real, stride, 1, inner, updated, True, line)
    move_row, move_flat = make_move_row(True), make_move_flat(True)
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

    @portable_kernel(max_unroll=5, block_dim=1)
    def run_steps(
        # parameters
        p: Parameters,
        factors: Factors,
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        start: int,
        stop: int,
        first: int,
        team: Team,  # of one where each launch has its plates
        # inputs
        drive: Forcing,
        # outputs
        f: Fields,
        curvature: wp.array3d[real],  # (plates, rows, stride), as the fields
    ):
        before = flush_denormals()
        k = first + wp.tid()
        plane = wp.uint64(k) * wp.uint64(wp.static((ny + 2) * row_bytes))
        u_plane = f.u.ptr + plane
        curvature_plane = curvature.ptr + plane
        cosine = drive.in_phase.ptr + plane
        sine = drive.quadrature.ptr + plane
        rates = f.rate.ptr + plane
        sums = f.squares.ptr + plane
        # The member moves node rows low + 1 … high.
        low = team.member * wp.static(ny - 2) // team.size
        high = (team.member + 1) * wp.static(ny - 2) // team.size
        goal = int(0)
        end_count = int(wp.static(2 * ends))  # a variable, so that no loop over the ends is unrolled
        bend_x = factors.bend_x.ptr
        move_x = factors.move_x.ptr
        stiffness = factors.stiffness.ptr
        offset = wp.uint64(wp.static((ends + 2) * row_bytes))
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = Wave(drive.wave[k, n, 0], drive.wave[k, n, 1])
            if wp.static(flat):
                if wp.static(ends > 0):
                    for end in range(end_count):
                        j = wp.where(end < wp.static(ends), end, wp.static(ny - 2 * ends) + end)
                        bend_node_row(u_plane, bend_x, factors.bend_y, curvature_plane, j)
                bend_flat(
                    row_at(u_plane, lowest_row(wp.static(ends))), row_at(u_plane, wp.static(ends + 1)), bend_x,
                    taps_of_row(factors.bend_y, wp.static(ends)), row_at(curvature_plane, wp.static(ends + 1)),
                )
                if wp.static(ends > 0):
                    for end in range(end_count):
                        j = wp.where(end < wp.static(ends), end + 1, wp.static(ny - 1 - 2 * ends) + end)
                        move_row(
                            p, stiffness, move_x, taps_of_row(factors.move_y, j), waves, summed,
                            rows_around(curvature_plane, j), row_at(cosine, j + 1), row_at(sine, j + 1),
                            row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                        )
                move_flat(
                    p, stiffness, move_x, taps_of_row(factors.move_y, wp.static(ends + 1)), waves, summed,
                    rows_around(curvature_plane, wp.static(ends + 1)), cosine + offset, sine + offset,
                    u_plane + offset, rates + offset, sums + offset,
                )
            else:
                # The curvatures of the band's outermost rows, before a neighbour moves the rows that they depend on.
                if low == 0:
                    bend_node_row(u_plane, bend_x, factors.bend_y, curvature_plane, 0)
                if high == wp.static(ny - 2):
                    bend_node_row(u_plane, bend_x, factors.bend_y, curvature_plane, wp.static(ny - 1))
                for depth in range(wp.static(reach)):
                    inside = wp.min(low + 1 + depth, wp.static(ny - 2))
                    bend_node_row(u_plane, bend_x, factors.bend_y, curvature_plane, inside)
                    bend_node_row(u_plane, bend_x, factors.bend_y, curvature_plane, wp.max(high - depth, 1))
                if team.size > 1:
                    goal += team.size
                    meet(team.arrived, goal, team.yield_core)
                for j in range(low + 1, high + 1):
                    # Row j moves once the curvatures of the rows above it are known.
                    if j + wp.static(2 * reach) <= high:
                        bend_node_row(u_plane, bend_x, factors.bend_y, curvature_plane, j + wp.static(reach))
                    move_row(
                        p, stiffness, move_x, taps_of_row(factors.move_y, j), waves, summed,
                        rows_around(curvature_plane, j), row_at(cosine, j + 1), row_at(sine, j + 1),
                        row_at(u_plane, j + 1), row_at(rates, j + 1), row_at(sums, j + 1),
                    )
                if team.size > 1:
                    goal += team.size
                    meet(team.arrived, goal, team.yield_core)
            for m in range(team.member, f.nodes.shape[0], team.size):
                f.trace[k, m, n] = f.u[k, f.nodes[m, 0], f.nodes[m, 1]]
        restore_denormals(before)

    return run_steps
