"""Kinetic energy of regions, from the sums of rate² over the window that every path keeps at each node.

    energy[plate, region] = Σ weights[region, node] · Σ_n rate²

One thread sums each column from bottom to top, so that neighbouring threads read neighbouring numbers; a second kernel
sums the columns from left to right. The order of the additions, and so the last bit, depends on the grid alone.
"""

from functools import cache

import warp as wp


@cache
def make_sum_over_rows(real):
    """Make the kernel that sums each column of each region; launch over (plates, regions, columns)."""

    @wp.kernel(module="unique", enable_backward=False)
    def sum_over_rows(
        # inputs
        squares: wp.array3d[real],  # (plates, rows, columns)
        weights: wp.array3d[wp.float64],  # (regions, rows, columns)
        # outputs
        column_sums: wp.array3d[wp.float64],  # (plates, regions, columns)
    ):
        plate, region, column = wp.tid()
        total = wp.float64(0.0)
        for row in range(weights.shape[1]):
            total += weights[region, row, column] * wp.float64(squares[plate, row, column])
        column_sums[plate, region, column] = total

    return sum_over_rows


@wp.kernel(module="unique", enable_backward=False)
def sum_over_columns(
    # inputs
    column_sums: wp.array3d[wp.float64],  # (plates, regions, columns)
    # outputs
    energy: wp.array2d[wp.float64],  # (plates, regions)
):
    """Sum the columns of each region; launch over (plates, regions)."""
    plate, region = wp.tid()
    total = wp.float64(0.0)
    for column in range(column_sums.shape[2]):
        total += column_sums[plate, region, column]
    energy[plate, region] = total
