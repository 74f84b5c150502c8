"""Kinetic energy of regions, from the sums of rate² over the window that every path keeps at each node.

    energy[plate, region] = Σ weights[region, node] · Σ_n rate²

One thread sums each column from bottom to top, so that neighbouring threads read neighbouring numbers; a second kernel
sums the columns from left to right. The order of the additions, and so the last bit, depends on the grid alone.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel


@cache
def make_sum_over_rows(real):
    """Make the kernel that sums each column of each region; launch over (plates, regions, columns)."""

    @portable_kernel()
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


@portable_kernel()
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


@portable_kernel()
def write_energies(
    # inputs
    sums: wp.array2d[wp.float64],  # (plates, regions) weighted sums of rate²
    scale: wp.array[wp.float64],  # (plates,) pressure that each plate is scaled by [N/m²]
    unit: wp.float64,  # energy of a sum of one at a scale of one [J]
    largest_sum: wp.float64,  # of a bounded plate
    # outputs
    energy: wp.array2d[wp.float64],  # (plates, regions) [J]
):
    """Write the energies of plates, NaN for those with a sum or energy out of range; launch over plates."""
    plate = wp.tid()
    sound = bool(True)
    for region in range(sums.shape[1]):
        total = sums[plate, region]
        value = total * unit * (scale[plate] * scale[plate])
        energy[plate, region] = value
        if not (total <= largest_sum and wp.isfinite(value)) or (total > wp.float64(0.0) and value == wp.float64(0.0)):
            sound = False
    if not sound:
        for region in range(sums.shape[1]):
            energy[plate, region] = wp.float64(wp.nan)


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
