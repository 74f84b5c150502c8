"""Work between the steps of the streaming paths: recording single nodes, and counting steps on the device.

``clock`` holds the step at which a run of launches began, so that recorded launches can be repeated unchanged.
"""

from functools import cache

import warp as wp


@wp.kernel(module="unique", enable_backward=False)
def advance_clock(clock: wp.array[int], steps: int):
    """Advance the clock by ``steps``; launch over (1,)."""
    clock[0] = clock[0] + steps


@cache
def make_record_trace(real):
    """Make the kernel that copies the displacement of single nodes to the trace; launch over (plates, nodes)."""

    @wp.kernel(module="unique", enable_backward=False)
    def record_trace(
        # inputs
        clock: wp.array[int],  # (1,)
        offset: int,  # the step is clock[0] + offset
        nodes: wp.array2d[int],  # (traced nodes, 2) row, column
        u: wp.array3d[real],  # (plates, rows, columns)
        # outputs
        trace: wp.array3d[real],  # (plates, traced nodes, steps)
    ):
        k, m = wp.tid()
        trace[k, m, clock[0] + offset] = u[k, nodes[m, 0], nodes[m, 1]]

    return record_trace
