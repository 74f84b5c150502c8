"""The two passes of a step on CPU, over flat ranges of memory.

LLVM turns a loop into vector instructions only where it sees plain memory and a fixed count. So each pass walks one
flat range of nodes of compile-time length, through sub-arrays made from pointers; padding takes part and stays zero,
because its stiffness is zero. Before each range LLVM's code makes sure that nothing overlaps, so that short ranges
are dear.

The first pass takes the curvature of every node from u, the second the rate and u in place from the curvature. In
place is safe: the second pass reads u at no node but its own. Along x, the first pass of second order reads a factor
on the curvature for each node, and both passes of fourth order five lines of taps; along y, each range has the aspect
or five taps for all its nodes.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.fused import make_fused
from warp_plate.kernels.stencil import make_laplacian, make_weighed
from warp_plate.kernels.update import make_parameters, make_update


def taps_along_y(order):
    """How many numbers a range has for its neighbours along y: the aspect, or the taps of fourth order."""
    return 1 if order == 2 else 5


@cache
def make_passes(effects, real, row, beside, curved, moved, held, line=0):
    """The two passes as functions of addresses, each of which walks one flat range: bend, move, move_unloaded.

    The third is the second for nodes without load.

    row: numbers a row; beside: numbers from a node to its neighbour along x; curved, moved: lengths of the ranges;
    held: whether some nodes of the second range are held, as their stiffness says; else all have the same stiffness;
    line: numbers from a node's tap along x to its next one.
    """
    order, reach = effects.order, effects.order // 2
    laplacian = make_laplacian(effects.square_cells, real)
    weighed = make_weighed(real)
    update = make_update(effects, real)
    fused = make_fused(real)
    Parameters = make_parameters(real)
    wave_of = wp.types.vector(length=2, dtype=real)
    taps_of = wp.types.vector(length=5, dtype=real)
    rows_of = wp.types.vector(length=taps_along_y(order), dtype=real)
    places_of = wp.types.vector(length=2 * reach + 1, dtype=wp.uint64)
    longest = curved + 4 * max(row, line)

    @wp.func
    def numbers(address: wp.uint64):
        return wp.array(ptr=address, shape=(wp.static(longest),), dtype=real)

    @wp.func
    def along_x(total: real, columns: wp.array[real], nodes: wp.array[real], i: int):
        """Of fourth order: a sum, and to it the node's five taps, a line for each, times the nodes from i on."""
        taps = taps_of()
        for tap in range(5):
            taps[tap] = columns[i + tap * wp.static(line)]
        return weighed(
            total,
            taps,
            nodes[i],
            nodes[i + wp.static(beside)],
            nodes[i + wp.static(2 * beside)],
            nodes[i + wp.static(3 * beside)],
            nodes[i + wp.static(4 * beside)],
        )

    @wp.func
    def bend_second(u_low: wp.uint64, u_here: wp.uint64, columns: wp.uint64, rows: rows_of, curvatures: wp.uint64):
        """Curvature from u. u_low: address of the node a row below the range's first; columns: factors."""
        # One window, with neighbours at fixed distances in it: the fewer pointers, the fewer overlaps LLVM checks.
        u = numbers(u_low)
        factor = numbers(columns)
        curvature = numbers(curvatures)
        for i in range(wp.static(curved)):
            curvature[i] = factor[i] * laplacian(
                u[i + wp.static(row)],
                u[i + wp.static(row - beside)],
                u[i + wp.static(row + beside)],
                u[i],
                u[i + wp.static(2 * row)],
                rows[0],
            )

    @wp.func
    def bend_fourth(u_low: wp.uint64, u_here: wp.uint64, columns: wp.uint64, rows: rows_of, curvatures: wp.uint64):
        """Curvature from u. u_low: of the lowest of the five rows that ``rows`` weighs; u_here: of the range's own."""
        u = numbers(u_low)
        beside_u = numbers(u_here - wp.uint64(wp.static(2 * beside * wp.types.type_size_in_bytes(real))))
        column = numbers(columns)
        curvature = numbers(curvatures)
        for i in range(wp.static(curved)):
            along_y = weighed(
                real(0.0),
                rows,
                u[i],
                u[i + wp.static(row)],
                u[i + wp.static(2 * row)],
                u[i + wp.static(3 * row)],
                u[i + wp.static(4 * row)],
            )
            curvature[i] = along_x(along_y, column, beside_u, i)

    def make_move(loaded):
        @wp.func
        def rate_after(
            p: Parameters,
            stiffness: wp.array[real],
            columns: wp.array[real],
            rows: rows_of,
            low: wp.array[real],
            south: wp.array[real],
            centre: wp.array[real],
            north: wp.array[real],
            high: wp.array[real],
            waves: wave_of,
            in_phase: wp.array[real],
            quadrature: wp.array[real],
            rate: wp.array[real],
            i: int,
        ):
            biharmonic = real(0.0)
            if wp.static(order == 2):
                west = centre[i]
                east = centre[i + wp.static(2 * beside)]
                biharmonic = laplacian(centre[i + wp.static(beside)], west, east, south[i], north[i], rows[0])
            else:
                middle = centre[i + wp.static(2 * beside)]
                along_y = weighed(real(0.0), rows, low[i], south[i], middle, north[i], high[i])
                biharmonic = along_x(along_y, columns, centre, i)
            load = real(0.0)
            if wp.static(loaded):
                load = waves[0] * in_phase[i] + waves[1] * quadrature[i]
            hold = p.stiffness
            if wp.static(held):
                hold = stiffness[i]
            return update(rate[i], biharmonic, load, hold, p)

        @wp.func
        def move(
            p: Parameters,
            stiffnesses: wp.uint64,
            columns: wp.uint64,
            rows: rows_of,
            waves: wave_of,
            summed: bool,
            curvatures: places_of,
            in_phases: wp.uint64,
            quadratures: wp.uint64,
            displacements: wp.uint64,
            rates: wp.uint64,
            squared_sums: wp.uint64,
        ):
            """Rate and displacement half a step and a step later.

            curvatures: addresses of the range's first node in its row and those around it, lowest first.
            """
            stiffness = numbers(stiffnesses)
            column = numbers(columns)
            low = numbers(curvatures[0])
            south = numbers(curvatures[wp.static(reach - 1)])
            centre = numbers(
                curvatures[wp.static(reach)] - wp.uint64(wp.static(reach * beside * wp.types.type_size_in_bytes(real)))
            )
            north = numbers(curvatures[wp.static(reach + 1)])
            high = numbers(curvatures[wp.static(2 * reach)])
            in_phase = numbers(in_phases)
            quadrature = numbers(quadratures)
            u = numbers(displacements)
            rate = numbers(rates)
            squares = numbers(squared_sums)
            # Two loops, not one with a test inside: a loop with a branch on ``summed`` is slower by a third.
            if summed:
                for i in range(wp.static(moved)):
                    new = rate_after(
                        p, stiffness, column, rows, low, south, centre, north, high, waves, in_phase, quadrature, rate,
                        i,
                    )
                    rate[i] = new
                    u[i] = u[i] + new
                    squares[i] = fused(new, new, squares[i])
            else:
                for i in range(wp.static(moved)):
                    new = rate_after(
                        p, stiffness, column, rows, low, south, centre, north, high, waves, in_phase, quadrature, rate,
                        i,
                    )
                    rate[i] = new
                    u[i] = u[i] + new

        return move

    return bend_second if order == 2 else bend_fourth, make_move(True), make_move(False)
