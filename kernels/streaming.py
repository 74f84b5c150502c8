"""Streaming path in its plainest form: two launches a step, a thread a node, any size and order, any device.

The first launch takes the curvature of every node from the displacement, the second moves the nodes by the curvature:
in place, for it reads the displacement of no node but its own. Both gather their neighbours from the batched tensor
with the taps of each axis as data. CUDA has a faster form for second order in ``streaming_march``.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.update import make_parameters, make_update


@cache
def make_weigh(order, real):
    """Σ of a node's neighbours along both axes, each times its tap."""
    reach = order // 2

    @wp.func
    def weigh(
        field: wp.array3d[real], taps_x: wp.array2d[real], taps_y: wp.array2d[real], k: int, j: int, i: int
    ):
        total = real(0.0)
        for step in range(wp.static(2 * reach + 1)):
            column = i + step - wp.static(reach)
            if column >= 0 and column < taps_x.shape[0]:
                total += taps_x[i, step] * field[k, j + 1, column]
        for step in range(wp.static(2 * reach + 1)):
            row = j + step - wp.static(reach)
            if row >= 0 and row < taps_y.shape[0]:
                total += taps_y[j, step] * field[k, row + 1, i]
        return total

    return weigh


@cache
def make_bend(effects, real):
    """Curvature of all nodes; launch over (plates, ny, nx). taps_x: (nx, taps), taps_y: (ny, taps)."""
    weigh = make_weigh(effects.order, real)

    @wp.kernel(module="unique", enable_backward=False)
    def bend(taps_x: wp.array2d[real], taps_y: wp.array2d[real], u: wp.array3d[real], curvature: wp.array3d[real]):
        k, j, i = wp.tid()
        curvature[k, j + 1, i] = weigh(u, taps_x, taps_y, k, j, i)

    return bend


@cache
def make_move(effects, real):
    """One step of all nodes that move; launch over (plates, ny − 2, nx − 2).

    wave: (plates, steps, 2), cos and sin ωt, see ``wave``; window: first and last + 1 of the steps whose rate² is
    summed; the step is clock[0] + offset.
    """
    weigh = make_weigh(effects.order, real)
    update = make_update(effects, real)
    Parameters = make_parameters(real)

    @wp.kernel(module="unique", enable_backward=False)
    def move(
        p: Parameters,
        taps_x: wp.array2d[real],
        taps_y: wp.array2d[real],
        wave: wp.array3d[real],
        window: wp.vec2i,
        clock: wp.array[int],
        offset: int,
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        curvature: wp.array3d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
    ):
        k, inner_row, inner_column = wp.tid()
        i = inner_column + 1
        row = inner_row + 2  # one row of zeros lies below the plate
        n = clock[0] + offset
        biharmonic = weigh(curvature, taps_x, taps_y, k, inner_row + 1, i)
        load = wave[k, n, 0] * in_phase[k, row, i] + wave[k, n, 1] * quadrature[k, row, i]
        new = update(rate[k, row, i], biharmonic, load, p.stiffness, p)
        rate[k, row, i] = new
        u[k, row, i] = u[k, row, i] + new
        if n >= window[0] and n < window[1]:
            squares[k, row, i] += new * new

    return move
