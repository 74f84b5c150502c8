"""What the streaming paths do between steps: keep the trace of single nodes, and count steps on the device.

``clock`` holds the step at which a run of launches began, so that launches that were put together can be repeated.
"""

from functools import cache

import warp as wp


@wp.kernel(module="unique", enable_backward=False)
def advance_clock(clock: wp.array[int], steps: int):
    """The steps of a run of launches are done."""
    clock[0] = clock[0] + steps


@cache
def make_record(real):
    """Copies the displacement of single nodes into the trace; launch over (plates, nodes)."""

    @wp.kernel(module="unique", enable_backward=False)
    def record(
        clock: wp.array[int],
        offset: int,
        nodes: wp.array2d[int],
        u: wp.array3d[real],
        trace: wp.array3d[real],
    ):
        k, m = wp.tid()
        trace[k, m, clock[0] + offset] = u[k, nodes[m, 0], nodes[m, 1]]

    return record
