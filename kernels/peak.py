"""The largest displacement of each node, kept between launches."""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel


@cache
def make_keep_largest(real):
    """Make the kernel that keeps the largest magnitudes of u, and NaN for ever; launch over the shape of u."""

    @portable_kernel()
    def keep_largest(
        # inputs
        u: wp.array3d[real],  # (plates, rows, columns)
        # outputs
        largest: wp.array3d[real],
    ):
        k, j, i = wp.tid()
        size = wp.abs(u[k, j, i])
        before = largest[k, j, i]
        if not wp.isnan(before) and not (size <= before):
            largest[k, j, i] = size

    return keep_largest
