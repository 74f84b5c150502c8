"""The two passes of a step on CPU, over flat ranges of memory.

LLVM vectorises a loop only over plain memory with a fixed count. So each pass walks one flat range of nodes of
compile-time length, through arrays made from addresses; padding takes part and stays zero, because its stiffness is
zero. Before each range LLVM's code checks that no arrays overlap, which makes short ranges expensive.

The first pass computes the curvature of every node from u, the second the rate and u in place from the curvature;
it reads u at no other node. Along x, the first pass of second order reads a factor on each node's curvature, and both
passes of fourth order read five lines of taps. Along y, all nodes of a range share the aspect or five taps.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.stencil import make_laplacian, make_weighted_sum
from warp_plate.kernels.update import make_parameters, make_update


def taps_along_y(order):
    """Return how many numbers a range has for its neighbours along y: the aspect, or the taps of fourth order."""
    return 1 if order == 2 else 5


@cache
def make_passes(effects, real, row, node, curvature_count, update_count, masked, tap_line=0):
    """Make the passes compute_curvature, update_loaded and update_unloaded, functions of addresses.

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

    @wp.func
    def compute_curvature_second(
        u_low: wp.uint64, u_here: wp.uint64, columns: wp.uint64, rows: RowTaps, curvature_at: wp.uint64
    ):
        """``u_low``: a row below the range; ``columns``: factors on the curvature."""
        # One array with neighbours at fixed distances: the fewer pointers, the fewer overlaps LLVM checks.
        u = array_at(u_low)
        factor = array_at(columns)
        curvature = array_at(curvature_at)
        for i in range(wp.static(curvature_count)):
            curvature[i] = factor[i] * laplacian(
                u[i + wp.static(row)], u[i + wp.static(row - node)], u[i + wp.static(row + node)],
                u[i], u[i + wp.static(2 * row)], rows[0],
            )

    @wp.func
    def compute_curvature_fourth(
        u_low: wp.uint64, u_here: wp.uint64, columns: wp.uint64, rows: RowTaps, curvature_at: wp.uint64
    ):
        """``u_low``: the lowest of the five rows that ``rows`` weighs; ``u_here``: the range itself."""
        u = array_at(u_low)
        u_along_x = array_at(u_here - wp.uint64(wp.static(2 * node * size)))
        column = array_at(columns)
        curvature = array_at(curvature_at)
        for i in range(wp.static(curvature_count)):
            along_y = weighted_sum(
                real(0.0), rows, u[i], u[i + wp.static(row)], u[i + wp.static(2 * row)],
                u[i + wp.static(3 * row)], u[i + wp.static(4 * row)],
            )
            curvature[i] = add_along_x(along_y, column, u_along_x, i)

    def make_update_range(loaded):
        @wp.func
        def rate_after(
            p: Parameters, stiffness: wp.array[real], columns: wp.array[real], rows: RowTaps,
            low: wp.array[real], south: wp.array[real], centre: wp.array[real], north: wp.array[real],
            high: wp.array[real], wave: Wave, in_phase: wp.array[real], quadrature: wp.array[real],
            rate: wp.array[real], i: int,
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
            curvature_rows: Rows, in_phase_at: wp.uint64, quadrature_at: wp.uint64,
            u_at: wp.uint64, rate_at: wp.uint64, squares_at: wp.uint64,
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

    compute_curvature = compute_curvature_second if order == 2 else compute_curvature_fourth
    return compute_curvature, make_update_range(True), make_update_range(False)
