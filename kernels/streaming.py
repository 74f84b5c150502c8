"""Streaming path in its plainest form: one launch a step, a thread a node, any size of plate, any device.

Each thread gathers the 13 nodes around its own from the batched tensor. The displacement lies in two buffers that
take turns, because neighbours still read the old one. CUDA has a faster form in ``streaming_march``.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.stencil import make_laplacian
from warp_plate.kernels.update import make_parameters, make_update


@cache
def make_step(effects, real):
    """One step of all plates; launch over (plates, ny − 2, nx − 2).

    factor_x, factor_y: (nx,), (ny,) factors on the curvature (see ``stencil``); wave: (steps, 2), cos and sin ωt;
    window: first and last + 1 of the steps whose rate² is summed.
    """
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    Parameters = make_parameters(real)

    @wp.kernel(module="unique", enable_backward=False)
    def step(
        p: Parameters,
        factor_x: wp.array[real],
        factor_y: wp.array[real],
        wave: wp.array2d[real],
        window: wp.vec2i,
        n: int,
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
        u: wp.array3d[real],
        u_next: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
    ):
        k, j, i = wp.tid()
        x = i + 1
        y = j + 2  # one row of zeros lies below the plate

        #                 nn
        #            nw   n    ne
        #       ww   w    c    e    ee
        #            sw   s    se
        #                 ss
        c = u[k, y, x]
        w = u[k, y, x - 1]
        e = u[k, y, x + 1]
        s = u[k, y - 1, x]
        t = u[k, y + 1, x]
        sw = u[k, y - 1, x - 1]
        se = u[k, y - 1, x + 1]
        nw = u[k, y + 1, x - 1]
        ne = u[k, y + 1, x + 1]
        ww = real(0.0)
        if x > 1:
            ww = u[k, y, x - 2]
        ee = u[k, y, x + 2]
        ss = u[k, y - 2, x]
        nn = u[k, y + 2, x]

        curvature = laplacian(c, w, e, s, t, p.aspect)
        curvature_w = factor_x[x - 1] * laplacian(w, ww, c, sw, nw, p.aspect)
        curvature_e = factor_x[x + 1] * laplacian(e, c, ee, se, ne, p.aspect)
        curvature_s = factor_y[y - 2] * laplacian(s, sw, se, ss, c, p.aspect)
        curvature_n = factor_y[y] * laplacian(t, nw, ne, c, nn, p.aspect)
        biharmonic = laplacian(curvature, curvature_w, curvature_e, curvature_s, curvature_n, p.aspect)

        load = wave[n, 0] * in_phase[k, y, x] + wave[n, 1] * quadrature[k, y, x]
        new = update(rate[k, y, x], biharmonic, load, p.stiffness, p)
        rate[k, y, x] = new
        u_next[k, y, x] = c + new
        if n >= window[0] and n < window[1]:
            squares[k, y, x] += new * new

    return step
