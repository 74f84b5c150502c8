"""Moment form, streaming path: a launch for each pass of a step, on every device."""

from functools import cache

import warp as wp

from warp_plate.kernels.moment_form import (
    make_compute_moments,
    make_finish_sum,
    make_structs,
    make_sum_row,
    make_update_node,
)


@cache
def make_passes(effects, real):
    """Make the kernels of a step, in order.

    Launch compute_moments over (plates, ny, nx), sum_rows over (plates, sums, ny), finish_sums over (plates, sums),
    update_nodes over (plates, ny, nx).
    """
    Material, Fields = make_structs(real)
    compute_node, update_node = make_compute_moments(effects, real), make_update_node(effects, real)
    sum_row, finish_sum = make_sum_row(effects, real), make_finish_sum(effects, real)

    @wp.kernel(module="unique", enable_backward=False)
    def compute_moments(f: Fields, m: Material):
        k, j, i = wp.tid()
        compute_node(f, m, k, j, i)

    @wp.kernel(module="unique", enable_backward=False)
    def sum_rows(f: Fields, m: Material):
        k, which, j = wp.tid()
        sum_row(f, m, k, which, j)

    @wp.kernel(module="unique", enable_backward=False)
    def finish_sums(f: Fields, m: Material):
        k, which = wp.tid()
        finish_sum(f, m, k, which)

    @wp.kernel(module="unique", enable_backward=False)
    def update_nodes(
        f: Fields,
        m: Material,
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        clock: wp.array[int],  # (1,)
        offset: int,  # the step is clock[0] + offset
    ):
        k, j, i = wp.tid()
        update_node(f, m, window, clock[0] + offset, k, j, i)

    return compute_moments, sum_rows, finish_sums, update_nodes
