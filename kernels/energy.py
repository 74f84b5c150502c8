"""Kinetic energy: every path sums rate² over the window at each node; here those sums meet the regions.

    energy[plate, region] = Σ weights[region, node] · Σ_n rate²

Columns first, each from bottom to top by one thread, so that neighbouring threads read neighbouring numbers; then the
columns of a plate from left to right. The order of the additions, and so the result's last bit, depends on nothing but
the grid.
"""

from functools import cache

import warp as wp


@cache
def make_sum_along_columns(real):
    """squares: (plates, rows, columns); weights: (regions, rows, columns); column_sums: (plates, regions, columns)."""

    @wp.kernel(module="unique", enable_backward=False)
    def sum_along_columns(
        squares: wp.array3d[real], weights: wp.array3d[wp.float64], column_sums: wp.array3d[wp.float64]
    ):
        plate, region, column = wp.tid()
        total = wp.float64(0.0)
        for row in range(weights.shape[1]):
            total += weights[region, row, column] * wp.float64(squares[plate, row, column])
        column_sums[plate, region, column] = total

    return sum_along_columns


@cache
def make_sum_columns():
    """column_sums: (plates, regions, columns); energy: (plates, regions)."""

    @wp.kernel(module="unique", enable_backward=False)
    def sum_columns(column_sums: wp.array3d[wp.float64], energy: wp.array2d[wp.float64]):
        plate, region = wp.tid()
        total = wp.float64(0.0)
        for column in range(column_sums.shape[2]):
            total += column_sums[plate, region, column]
        energy[plate, region] = total

    return sum_columns
