"""The paths of ``general``: a launch for each pass, or all steps in one launch.

Resident, a plate belongs to one thread on CPU and to one block on CUDA, whose threads share the nodes and meet after
each pass; the plate's fields stay in the cache of the core or of the multiprocessor.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.cuda import barrier
from warp_plate.kernels.general import (
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


@cache
def make_run(effects, real, threads):
    """Steps ``start`` ... ``stop`` − 1; launch over (plates × threads,), on CUDA with blocks of ``threads`` threads.

    nodes: (traced nodes, 2), row and column; trace: (plates, traced nodes, steps).
    """
    Material, Fields = make_structs(real)
    bend_node, move_node = make_bend_node(effects, real), make_move_node(effects, real)
    sum_row, finish_sum = make_sum_row(effects, real), make_finish_sum(effects, real)
    sums = effects.stretching or effects.oscillators
    together = threads > 1

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def run(
        f: Fields,
        m: Material,
        window: wp.vec2i,
        first: int,
        start: int,
        stop: int,
        nodes: wp.array2d[int],
        trace: wp.array3d[real],
    ):
        k = first + wp.tid() // wp.static(threads)
        thread = wp.tid() % wp.static(threads)
        ny = f.u.shape[1]
        nx = f.u.shape[2]
        for n in range(start, stop):
            for node in range(thread, nx * ny, wp.static(threads)):
                bend_node(f, m, k, node // nx, node % nx)
            if wp.static(together):
                barrier()
            if wp.static(sums):
                for row in range(thread, f.row_sums.shape[1] * ny, wp.static(threads)):
                    sum_row(f, m, k, row // ny, row % ny)
                if wp.static(together):
                    barrier()
                for which in range(thread, f.row_sums.shape[1], wp.static(threads)):
                    finish_sum(f, m, k, which)
                if wp.static(together):
                    barrier()
            for node in range(thread, nx * ny, wp.static(threads)):
                move_node(f, m, window, n, k, node // nx, node % nx)
            if wp.static(together):
                barrier()
            for traced in range(thread, nodes.shape[0], wp.static(threads)):
                trace[k, traced, n] = f.u[k, nodes[traced, 0], nodes[traced, 1]]

    return run
