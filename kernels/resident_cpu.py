"""Resident path on CPU: one launch runs all steps, a plate at a time, so that a plate stays in the cache.

LLVM turns a loop into vector instructions only where it sees plain memory and a fixed count. So each pass walks one
flat range of nodes of compile-time length (all rows with their padding, one row where the plate is large), through
sub-arrays made from pointers; the padding takes part and stays zero, because its stiffness is zero.

A step is two passes: the curvature of every node from u, then the rate and u in place from the curvature. In place
is safe: the second pass reads u at no node but its own.

A plate too large for one core is shared by a crew: as many launches, from as many Python threads, each walk their
own band of rows of the same plate, and meet after each pass.
"""

from functools import lru_cache

import warp as wp

from warp_plate.kernels.stencil import make_laplacian
from warp_plate.kernels.update import make_parameters, make_update

# Above this many nodes in a pass, passes go row by row: two planes of factors would no longer stay in L1.
FLAT_NODES = 4096

_MEET = """
__atomic_add_fetch(&arrived.data[0], 1, __ATOMIC_ACQ_REL); while (__atomic_load_n(&arrived.data[0], __ATOMIC_ACQUIRE) < goal) {}
"""


@wp.func_native(_MEET)
def meet(arrived: wp.array[int], goal: int):
    """Counts the caller in and waits until ``goal`` have come; launches run at the same time on CPU threads."""
    ...


def rows_per_block(ny, stride):
    """(curvature pass, update pass): how many rows one flat range covers."""
    return (ny, ny - 2) if ny * stride <= FLAT_NODES else (1, 1)


@lru_cache(maxsize=None)
def make_run(effects, real, ny, stride, compiler_flags):
    """Steps ``start`` ... ``stop`` − 1 of the plates from ``first`` on; launch over (plates,).

    crew: launches that share one plate, 1 for none; member: which of them this is; arrived: zero before the first.

    factor: curvature factors of the block's nodes, one block or the bottom, inner and top one;
    stiffness: of the nodes of an update block, zero where a node is held or padding;
    wave: (steps, 2), cos and sin ωt; window: first and last + 1 of the steps whose rate² is summed;
    nodes: (traced nodes, 2), row and column; trace: (plates, traced nodes, steps).
    """
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    Parameters = make_parameters(real)
    size = 4 if real is wp.float32 else 8
    curved_rows, moved_rows = rows_per_block(ny, stride)
    curved, moved = curved_rows * stride, moved_rows * stride
    curved_blocks, moved_blocks = ny // curved_rows, (ny - 2) // moved_rows

    @wp.func
    def curved_span(base: wp.uint64, start: int):
        return wp.array(ptr=base + wp.uint64(start * wp.static(size)), shape=(wp.static(curved),), dtype=real)

    @wp.func
    def moved_span(base: wp.uint64, start: int):
        return wp.array(ptr=base + wp.uint64(start * wp.static(size)), shape=(wp.static(moved),), dtype=real)

    @wp.func
    def bend(u_plane: wp.uint64, curvature_plane: wp.uint64, factors: wp.uint64, block: int, aspect: real):
        """Curvature of one block of rows."""
        at = (1 + block * wp.static(curved_rows)) * wp.static(stride)
        pattern = int(0)
        if wp.static(curved_blocks > 1):
            pattern = wp.where(block == 0, 0, wp.where(block == wp.static(curved_blocks - 1), 2, 1))
        factor = curved_span(factors, pattern * wp.static(curved))
        centre = curved_span(u_plane, at)
        west = curved_span(u_plane, at - 1)
        east = curved_span(u_plane, at + 1)
        south = curved_span(u_plane, at - wp.static(stride))
        north = curved_span(u_plane, at + wp.static(stride))
        curvature = curved_span(curvature_plane, at)
        for i in range(wp.static(curved)):
            curvature[i] = factor[i] * laplacian(centre[i], west[i], east[i], south[i], north[i], aspect)

    @wp.func
    def move(
        p: Parameters,
        stiffnesses: wp.uint64,
        cosine: real,
        sine: real,
        summed: bool,
        curvature_plane: wp.uint64,
        in_phase_plane: wp.uint64,
        quadrature_plane: wp.uint64,
        u_plane: wp.uint64,
        rate_plane: wp.uint64,
        squares_plane: wp.uint64,
        block: int,
    ):
        """Rate and displacement of one block of rows, half a step and a step later."""
        at = (2 + block * wp.static(moved_rows)) * wp.static(stride)
        centre = moved_span(curvature_plane, at)
        west = moved_span(curvature_plane, at - 1)
        east = moved_span(curvature_plane, at + 1)
        south = moved_span(curvature_plane, at - wp.static(stride))
        north = moved_span(curvature_plane, at + wp.static(stride))
        stiffness = moved_span(stiffnesses, 0)
        in_phase = moved_span(in_phase_plane, at)
        quadrature = moved_span(quadrature_plane, at)
        u = moved_span(u_plane, at)
        rate = moved_span(rate_plane, at)
        squares = moved_span(squares_plane, at)
        # Two loops, not one with a test inside: a loop with a branch on ``summed`` is slower by a third.
        if summed:
            for i in range(wp.static(moved)):
                biharmonic = laplacian(centre[i], west[i], east[i], south[i], north[i], p.aspect)
                load = cosine * in_phase[i] + sine * quadrature[i]
                new = update(rate[i], biharmonic, load, stiffness[i], p)
                rate[i] = new
                u[i] = u[i] + new
                squares[i] = squares[i] + new * new
        else:
            for i in range(wp.static(moved)):
                biharmonic = laplacian(centre[i], west[i], east[i], south[i], north[i], p.aspect)
                load = cosine * in_phase[i] + sine * quadrature[i]
                new = update(rate[i], biharmonic, load, stiffness[i], p)
                rate[i] = new
                u[i] = u[i] + new

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
        plane = wp.uint64(k) * wp.uint64(wp.static((ny + 2) * stride * size))
        curved_low = member * wp.static(curved_blocks) // crew
        curved_high = (member + 1) * wp.static(curved_blocks) // crew
        moved_low = member * wp.static(moved_blocks) // crew
        moved_high = (member + 1) * wp.static(moved_blocks) // crew
        goal = int(0)
        for n in range(start, stop):
            for block in range(curved_low, curved_high):
                bend(u.ptr + plane, curvature.ptr + plane, factor.ptr, block, p.aspect)
            if crew > 1:
                goal += crew
                meet(arrived, goal)
            summed = n >= window[0] and n < window[1]
            for block in range(moved_low, moved_high):
                move(
                    p, stiffness.ptr, wave[n, 0], wave[n, 1], summed, curvature.ptr + plane,
                    in_phase.ptr + plane, quadrature.ptr + plane, u.ptr + plane, rate.ptr + plane,
                    squares.ptr + plane, block,
                )
            if crew > 1:
                goal += crew
                meet(arrived, goal)
            for m in range(member, nodes.shape[0], crew):
                trace[k, m, n] = u[k, nodes[m, 0], nodes[m, 1]]

    return run
