"""Resident path on CPU: one launch runs all steps, a plate at a time, so that a plate stays in the cache.

LLVM turns a loop into vector instructions only where it sees plain memory and a fixed count. So each pass walks one
flat range of nodes of compile-time length (all rows with their padding, one row where the plate is large), through
sub-arrays made from pointers; the padding takes part and stays zero, because its stiffness is zero.

A step is two passes: the curvature of every node from u, then the rate and u in place from the curvature. In place
is safe: the second pass reads u at no node but its own.

A plate too large for one core is shared by a crew: as many launches, from as many Python threads, each walk their
own band of rows of the same plate, and meet after each pass. Many small plates go faster in groups: see
``resident_cpu_groups``, which uses the same two passes.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.stencil import make_laplacian
from warp_plate.kernels.update import make_parameters, make_update

# Above this many nodes in a pass, passes go row by row: two planes of factors would no longer stay in L1.
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


def rows_per_block(ny, row):
    """(curvature pass, update pass): how many rows one flat range covers; ``row``: numbers a row."""
    return (ny, ny - 2) if ny * row <= FLAT_NODES else (1, 1)


@cache
def make_passes(effects, real, row, beside, curved, moved, held):
    """The two passes as functions of addresses, each of which walks one flat range: bend, move, move_unloaded.

    The third is the second for nodes without load.

    row: numbers a row; beside: numbers from a node to its neighbour along x; curved, moved: lengths of the ranges;
    held: whether some nodes of the second range are held, as their stiffness says; else all have the same stiffness.
    """
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    Parameters = make_parameters(real)
    wave_of = wp.types.vector(length=2, dtype=real)
    longest = curved + 2 * row

    @wp.func
    def numbers(address: wp.uint64):
        return wp.array(ptr=address, shape=(wp.static(longest),), dtype=real)

    @wp.func
    def bend(u_south: wp.uint64, factors: wp.uint64, curvatures: wp.uint64, aspect: real):
        """Curvature from u; ``u_south``: address of the node a row below the range's first."""
        # One window, with neighbours at fixed distances in it: the fewer pointers, the fewer overlaps LLVM checks.
        u = numbers(u_south)
        factor = numbers(factors)
        curvature = numbers(curvatures)
        for i in range(wp.static(curved)):
            curvature[i] = factor[i] * laplacian(
                u[i + wp.static(row)],
                u[i + wp.static(row - beside)],
                u[i + wp.static(row + beside)],
                u[i],
                u[i + wp.static(2 * row)],
                aspect,
            )

    def make_move(loaded):
        @wp.func
        def rate_after(
            p: Parameters,
            stiffness: wp.array[real],
            waves: wave_of,
            south: wp.array[real],
            centre: wp.array[real],
            north: wp.array[real],
            in_phase: wp.array[real],
            quadrature: wp.array[real],
            rate: wp.array[real],
            i: int,
        ):
            west = centre[i]
            east = centre[i + wp.static(2 * beside)]
            biharmonic = laplacian(centre[i + wp.static(beside)], west, east, south[i], north[i], p.aspect)
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
            waves: wave_of,
            summed: bool,
            south_curvatures: wp.uint64,
            curvatures: wp.uint64,
            north_curvatures: wp.uint64,
            in_phases: wp.uint64,
            quadratures: wp.uint64,
            displacements: wp.uint64,
            rates: wp.uint64,
            squared_sums: wp.uint64,
        ):
            """Rate and displacement half a step and a step later."""
            stiffness = numbers(stiffnesses)
            south = numbers(south_curvatures)
            centre = numbers(curvatures - wp.uint64(wp.static(beside * wp.types.type_size_in_bytes(real))))
            north = numbers(north_curvatures)
            in_phase = numbers(in_phases)
            quadrature = numbers(quadratures)
            u = numbers(displacements)
            rate = numbers(rates)
            squares = numbers(squared_sums)
            # Two loops, not one with a test inside: a loop with a branch on ``summed`` is slower by a third.
            if summed:
                for i in range(wp.static(moved)):
                    new = rate_after(p, stiffness, waves, south, centre, north, in_phase, quadrature, rate, i)
                    rate[i] = new
                    u[i] = u[i] + new
                    squares[i] = squares[i] + new * new
            else:
                for i in range(wp.static(moved)):
                    new = rate_after(p, stiffness, waves, south, centre, north, in_phase, quadrature, rate, i)
                    rate[i] = new
                    u[i] = u[i] + new

        return move

    return bend, make_move(True), make_move(False)


@cache
def make_run(effects, real, ny, stride, compiler_flags):
    """Steps ``start`` ... ``stop`` − 1 of the plates from ``first`` on; launch over (plates,).

    crew: launches that share one plate, 1 for none; member: which of them this is; arrived: zero before the first;
    let_others_run: see ``meet``.
    factor: curvature factors of the block's nodes, one block or the bottom, inner and top one;
    stiffness: of the nodes of an update block, zero where a node is held or padding;
    wave: (steps, 2), cos and sin ωt; window: first and last + 1 of the steps whose rate² is summed;
    nodes: (traced nodes, 2), row and column; trace: (plates, traced nodes, steps).
    """
    Parameters = make_parameters(real)
    curved_rows, moved_rows = rows_per_block(ny, stride)
    bend, move, _ = make_passes(effects, real, stride, 1, curved_rows * stride, moved_rows * stride, True)
    wave_of = wp.types.vector(length=2, dtype=real)
    row_bytes = stride * wp.types.type_size_in_bytes(real)
    curved_blocks, moved_blocks = ny // curved_rows, (ny - 2) // moved_rows

    @wp.func
    def bend_block(u_plane: wp.uint64, factors: wp.uint64, curvature_plane: wp.uint64, block: int, aspect: real):
        at = wp.uint64(block * wp.static(curved_rows * row_bytes))
        pattern = int(0)
        if wp.static(curved_blocks > 1):
            pattern = wp.where(block == 0, 0, wp.where(block == wp.static(curved_blocks - 1), 2, 1))
        factor = factors + wp.uint64(pattern * wp.static(curved_rows * row_bytes))
        bend(u_plane + at, factor, curvature_plane + at + wp.uint64(wp.static(row_bytes)), aspect)

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": 1},
    )
    def run(
        p: Parameters,
        factor: wp.array[real],
        stiffness: wp.array[real],
        wave: wp.array2d[real],
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
        k = first + wp.tid()
        plane = wp.uint64(k) * wp.uint64(wp.static((ny + 2) * row_bytes))
        u_plane = u.ptr + plane
        bent = curvature.ptr + plane
        low = member * wp.static(moved_blocks) // crew
        high = (member + 1) * wp.static(moved_blocks) // crew
        goal = int(0)
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = wave_of(wave[n, 0], wave[n, 1])
            if wp.static(curved_blocks == 1):
                bend_block(u_plane, factor.ptr, bent, 0, p.aspect)
            else:
                # The curvatures of the band's outermost rows, before a neighbour moves the rows that they rest on.
                if low == 0:
                    bend_block(u_plane, factor.ptr, bent, 0, p.aspect)
                if high == wp.static(moved_blocks):
                    bend_block(u_plane, factor.ptr, bent, wp.static(curved_blocks - 1), p.aspect)
                bend_block(u_plane, factor.ptr, bent, low + 1, p.aspect)
                bend_block(u_plane, factor.ptr, bent, high, p.aspect)
            if crew > 1:
                goal += crew
                meet(arrived, goal, let_others_run)
            for block in range(low, high):
                # Row block + 1 moves once the curvature of the row above it is known.
                if block + 2 < high:
                    bend_block(u_plane, factor.ptr, bent, block + 2, p.aspect)
                at = wp.uint64(block * wp.static(moved_rows * row_bytes) + wp.static(2 * row_bytes))
                above = wp.uint64(wp.static(row_bytes))
                move(
                    p, stiffness.ptr, waves, summed, bent + at - above, bent + at, bent + at + above,
                    in_phase.ptr + plane + at, quadrature.ptr + plane + at,
                    u_plane + at, rate.ptr + plane + at, squares.ptr + plane + at,
                )
            if crew > 1:
                goal += crew
                meet(arrived, goal, let_others_run)
            for m in range(member, nodes.shape[0], crew):
                trace[k, m, n] = u[k, nodes[m, 0], nodes[m, 1]]

    return run
