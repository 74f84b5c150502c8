"""The plainest path, and the place to start reading: two launches a step, a thread a node, any size, order and device.

The first launch computes the curvature of every node from the displacement; the second moves the nodes by the
biharmonic of the displacement, which is the curvature of the curvature. The second launch needs the curvature of a
node's neighbours but the displacement of the node alone, so it works in place. Both weight neighbours by the taps of
each axis, which are data. On CUDA ``temporal_blocking`` is a faster form of this path.

Between the steps of any streaming path, ``record_trace`` stores the displacement of traced nodes. ``clock`` holds, on
the device, the step at which a run of launches began: so recorded launches can be repeated unchanged.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel
from warp_plate.kernels.update import make_parameters, make_state, make_update


@cache
def make_apply_taps(order, real):
    """Make ``apply_taps``: Σ taps · neighbours of a node along both axes."""
    reach = order // 2

    @wp.func
    def apply_taps(field: wp.array3d[real], taps_x: wp.array2d[real], taps_y: wp.array2d[real], k: int, j: int, i: int):
        total = real(0.0)
        for step in range(wp.static(2 * reach + 1)):
            column = i + step - wp.static(reach)
            if column >= 0 and column < taps_x.shape[0]:
                total += taps_x[i, step] * field[k, j + 1, column]
        for step in range(wp.static(2 * reach + 1)):
            row = j + step - wp.static(reach)
            if row >= 0 and row < taps_y.shape[0]:
                total += taps_y[j, step] * field[k, row + 1, i]
        return total

    return apply_taps


@cache
def make_compute_curvature(effects, real):
    """Make the kernel that computes the curvature of all nodes; launch over (plates, ny, nx)."""
    apply_taps = make_apply_taps(effects.order, real)

    @portable_kernel()
    def compute_curvature(
        # inputs
        taps_x: wp.array2d[real],  # (nx, order + 1)
        taps_y: wp.array2d[real],  # (ny, order + 1)
        u: wp.array3d[real],  # (plates, rows, columns)
        # outputs
        curvature: wp.array3d[real],  # (plates, rows, columns)
    ):
        k, j, i = wp.tid()
        curvature[k, j + 1, i] = apply_taps(u, taps_x, taps_y, k, j, i)

    return compute_curvature


@cache
def make_update_nodes(effects, real):
    """Make the kernel that moves all inner nodes by one step; launch over (plates, ny − 2, nx − 2)."""
    apply_taps = make_apply_taps(effects.order, real)
    update = make_update(effects, real)
    Parameters, (Forcing, Fields) = make_parameters(real), make_state(real)

    @portable_kernel()
    def update_nodes(
        # parameters
        p: Parameters,
        taps_x: wp.array2d[real],  # (nx, order + 1)
        taps_y: wp.array2d[real],  # (ny, order + 1)
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        clock: wp.array[int],  # (1,)
        offset: int,  # the step is clock[0] + offset
        # inputs
        drive: Forcing,
        curvature: wp.array3d[real],  # (plates, rows, columns)
        # outputs
        f: Fields,
    ):
        k, inner_row, inner_column = wp.tid()
        i = inner_column + 1
        row = inner_row + 2  # a row of zeros lies below the plate
        n = clock[0] + offset
        biharmonic = apply_taps(curvature, taps_x, taps_y, k, inner_row + 1, i)
        load = drive.wave[k, n, 0] * drive.in_phase[k, row, i] + drive.wave[k, n, 1] * drive.quadrature[k, row, i]
        new = update(f.rate[k, row, i], biharmonic, load, p.stiffness, p)
        f.rate[k, row, i] = new
        f.u[k, row, i] = f.u[k, row, i] + new
        if n >= window[0] and n < window[1]:
            f.squares[k, row, i] += new * new

    return update_nodes


@portable_kernel()
def advance_clock(clock: wp.array[int], steps: int):
    """Advance the clock by ``steps``; launch over (1,)."""
    clock[0] = clock[0] + steps


@cache
def make_record_trace(real):
    """Make the kernel that copies the displacement of traced nodes to the trace; launch over (plates, nodes)."""
    _, Fields = make_state(real)

    @portable_kernel()
    def record_trace(
        # inputs
        clock: wp.array[int],  # (1,)
        offset: int,  # the step is clock[0] + offset
        # outputs
        f: Fields,
    ):
        k, m = wp.tid()
        f.trace[k, m, clock[0] + offset] = f.u[k, f.nodes[m, 0], f.nodes[m, 1]]

    return record_trace
