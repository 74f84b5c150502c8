"""The streaming path of ``general``: a launch for each pass of a step, on every device."""

from functools import cache

import warp as wp

from warp_plate.kernels.moment_form import (
    make_bend_node,
    make_finish_sum,
    make_move_node,
    make_structs,
    make_sum_row,
)


@cache
def make_passes(effects, real):
    """Kernels bend over (plates, ny, nx), sum_rows (plates, sums, ny), finish_sums (plates, sums), move (plates, ny,
    nx); the step that ``move`` takes is clock[0] + offset."""
    Material, Fields = make_structs(real)
    bend_node, move_node = make_bend_node(effects, real), make_move_node(effects, real)
    sum_row, finish_sum = make_sum_row(effects, real), make_finish_sum(effects, real)

    @wp.kernel(module="unique", enable_backward=False)
    def bend(f: Fields, m: Material):
        k, j, i = wp.tid()
        bend_node(f, m, k, j, i)

    @wp.kernel(module="unique", enable_backward=False)
    def sum_rows(f: Fields, m: Material):
        k, which, j = wp.tid()
        sum_row(f, m, k, which, j)

    @wp.kernel(module="unique", enable_backward=False)
    def finish_sums(f: Fields, m: Material):
        k, which = wp.tid()
        finish_sum(f, m, k, which)

    @wp.kernel(module="unique", enable_backward=False)
    def move(f: Fields, m: Material, window: wp.vec2i, clock: wp.array[int], offset: int):
        k, j, i = wp.tid()
        move_node(f, m, window, clock[0] + offset, k, j, i)

    return bend, sum_rows, finish_sums, move
