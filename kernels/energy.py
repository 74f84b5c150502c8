"""Kinetic energy: every path sums rate² over the window at each node; here those sums meet the regions.

    energy[plate, region] = Σ weights[region, node] · Σ_n rate²

Rows first, then the rows of a plate, each by one thread from left to right: the order of the additions, and so
the result's last bit, depends on nothing but the grid.
"""

from functools import cache

import warp as wp


@cache
def make_sum_along_rows(real):
    """squares: (plates, rows, columns); weights: (regions, rows, columns); row_sums: (plates, regions, rows)."""

    @wp.kernel(module="unique", enable_backward=False)
    def sum_along_rows(
        squares: wp.array3d[real], weights: wp.array3d[wp.float64], row_sums: wp.array3d[wp.float64]
    ):
        plate, region, row = wp.tid()
        total = wp.float64(0.0)
        for column in range(weights.shape[2]):
            total += weights[region, row, column] * wp.float64(squares[plate, row, column])
        row_sums[plate, region, row] = total

    return sum_along_rows


@cache
def make_sum_rows():
    """row_sums: (plates, regions, rows); energy: (plates, regions)."""

    @wp.kernel(module="unique", enable_backward=False)
    def sum_rows(row_sums: wp.array3d[wp.float64], energy: wp.array2d[wp.float64]):
        plate, region = wp.tid()
        total = wp.float64(0.0)
        for row in range(row_sums.shape[2]):
            total += row_sums[plate, region, row]
        energy[plate, region] = total

    return sum_rows
