"""Resident path on CPU for many plates: a group of plates side by side, the plates innermost in memory.

In a group, node i of plate k lies at i·lanes + k, so that a vector holds the same node of several plates: neighbours
along x lie whole vectors apart, there is no padding, and a plate's width does not matter. To the two passes of
``resident_cpu`` a group is one plate with rows ``lanes`` times as long, walked one row at a time. The batched
tensors keep their layout: a launch copies a group in, runs all steps, and copies it out.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import flush_denormals, portable_kernel, restore_denormals
from warp_plate.kernels.resident_cpu import make_factors, make_passes, taps_along_y
from warp_plate.kernels.update import make_parameters, make_state

# Planes of a group's workspace: u, rate, squares, in phase, quadrature.
PLANES = 5


def workspace_size(nx, ny, lanes, order):
    """Return the numbers in a thread's workspace: planes, rows of curvature in use, and the reach of taps beyond."""
    return (PLANES * (ny + 2) + order + 1) * nx * lanes + order // 2 * lanes


@cache
def make_run_steps(effects, real, nx, ny, stride, lanes):
    """Make the kernel of steps ``start`` … ``stop`` − 1 of ``lanes`` plates at a time, from ``first`` on; launch over
    (groups,)."""
    Parameters, Factors, (Forcing, Fields) = make_parameters(real), make_factors(real), make_state(real)
    reach, places = effects.order // 2, effects.order + 1
    row = nx * lanes
    bend, make_move = make_passes(effects, real, row, lanes, row, row - 2 * lanes, False, row)
    move, move_unloaded = make_move(True), make_move(False)
    Wave = wp.types.vector(length=2, dtype=real)
    RowTaps = wp.types.vector(length=taps_along_y(effects.order), dtype=real)
    Rows = wp.types.vector(length=places, dtype=wp.uint64)
    Values = wp.types.vector(length=PLANES, dtype=real)
    size = wp.types.type_size_in_bytes(real)
    row_bytes, node_bytes = row * size, lanes * size
    plane_bytes = (ny + 2) * row_bytes

    @wp.func
    def plane_array(plane: wp.uint64):
        return wp.array(ptr=plane, shape=(wp.static((ny + 2) * row),), dtype=real)

    @wp.func
    def copy_in(f: Fields, drive: Forcing, workspace: wp.uint64, first: int, last: int):
        """Copy all fields of the group into its workspace, plate by plate; lanes without a plate get zeros."""
        inside = wp.array(ptr=workspace, shape=(wp.static(PLANES * (ny + 2) * row),), dtype=real)
        for lane in range(wp.static(lanes)):
            for j in range(1, wp.static(ny + 1)):
                for i in range(wp.static(nx)):
                    at = (j * wp.static(nx) + i) * wp.static(lanes) + lane
                    values = Values()
                    if first + lane < last:
                        k = first + lane
                        values = Values(
                            f.u[k, j, i], f.rate[k, j, i], f.squares[k, j, i], drive.in_phase[k, j, i],
                            drive.quadrature[k, j, i],
                        )
                    for plane in range(wp.static(PLANES)):
                        inside[plane * wp.static((ny + 2) * row) + at] = values[plane]

    @wp.func
    def copy_out(workspace: wp.uint64, f: Fields, first: int, last: int):
        """Copy the fields that a run changes out of the workspace of the group."""
        inside = wp.array(ptr=workspace, shape=(wp.static(PLANES * (ny + 2) * row),), dtype=real)
        for lane in range(wp.min(wp.static(lanes), last - first)):
            for j in range(1, wp.static(ny + 1)):
                for i in range(wp.static(nx)):
                    at = (j * wp.static(nx) + i) * wp.static(lanes) + lane
                    f.u[first + lane, j, i] = inside[at]
                    f.rate[first + lane, j, i] = inside[wp.static((ny + 2) * row) + at]
                    f.squares[first + lane, j, i] = inside[wp.static(2 * (ny + 2) * row) + at]

    @wp.func
    def taps_of_row(taps: wp.array2d[real], j: int):
        rows = RowTaps()
        for tap in range(wp.static(taps_along_y(effects.order))):
            rows[tap] = taps[j, tap]
        return rows

    @wp.func
    def bend_node_row(
        u_plane: wp.uint64, columns: wp.uint64, taps_y: wp.array2d[real], curvature_rows: wp.uint64, j: int
    ):
        """Compute the curvature of node row j into its place: the rows in use take turns."""
        out = curvature_rows + wp.uint64(j % wp.static(places) * wp.static(row_bytes))
        here = u_plane + wp.uint64((j + 1) * wp.static(row_bytes))
        if wp.static(effects.order == 4):
            low = wp.min(wp.max(j - 1, 0), wp.static(ny - 3))
            bend(u_plane + wp.uint64(low * wp.static(row_bytes)), here, columns, taps_of_row(taps_y, j), out)
        else:
            pattern = wp.where(j == 0, 0, wp.where(j == wp.static(ny - 1), 2, 1))
            factor = columns + wp.uint64(pattern * wp.static(row_bytes))
            bend(u_plane + wp.uint64(j * wp.static(row_bytes)), here, factor, taps_of_row(taps_y, 0), out)

    @portable_kernel(max_unroll=5, block_dim=1)
    def run_steps(
        # parameters
        p: Parameters,
        factors: Factors,  # along x repeated for each lane; order 2: of the bottom, an inner and the top row
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        start: int,
        stop: int,
        first: int,
        last: int,  # one beyond the last plate
        thread: int,
        # inputs
        drive: Forcing,  # of plates that share their wave
        # outputs
        f: Fields,
        workspace: wp.array2d[real],  # (threads, workspace_size(…)); the launch uses row ``thread``
    ):
        before = flush_denormals()
        low = first + wp.tid() * wp.static(lanes)
        u_plane = workspace.ptr + wp.uint64(thread) * wp.uint64(workspace.shape[1] * wp.static(size))
        rates = u_plane + wp.uint64(wp.static(1 * plane_bytes))
        sums = u_plane + wp.uint64(wp.static(2 * plane_bytes))
        cosine = u_plane + wp.uint64(wp.static(3 * plane_bytes))
        sine = u_plane + wp.uint64(wp.static(4 * plane_bytes))
        curvature_rows = u_plane + wp.uint64(wp.static(5 * plane_bytes))
        node = wp.uint64(wp.static(node_bytes))
        # Clear what an earlier group left: it may be NaN, which a factor of zero does not remove.
        curvature = wp.array(ptr=curvature_rows, shape=(wp.static(places * row + reach * lanes),), dtype=real)
        for i in range(wp.static(places * row + reach * lanes)):
            curvature[i] = real(0.0)
        copy_in(f, drive, u_plane, low, last)
        bend_x = factors.bend_x.ptr
        move_x = factors.move_x.ptr
        for n in range(start, stop):
            summed = n >= window[0] and n < window[1]
            waves = Wave(drive.wave[0, n, 0], drive.wave[0, n, 1])
            # One loop, in which each pass is compiled once: its first rounds only fill the rows of curvature.
            for j in range(wp.static(-reach), wp.static(ny - 1)):
                # Row j moves once the curvatures of the rows above it are known.
                if j + wp.static(reach) < wp.static(ny):
                    bend_node_row(u_plane, bend_x, factors.bend_y, curvature_rows, j + wp.static(reach))
                if j >= 1:
                    rows = taps_of_row(factors.move_y, 0)
                    if wp.static(effects.order == 4):
                        rows = taps_of_row(factors.move_y, j)
                    around = Rows()
                    for place in range(wp.static(places)):
                        turn = (j + place + wp.static(places - reach)) % wp.static(places)
                        around[place] = curvature_rows + wp.uint64(turn * wp.static(row_bytes)) + node
                    at = wp.uint64((j + 1) * wp.static(row_bytes)) + node
                    if factors.loaded[j + 1] != 0:
                        move(
                            p, move_x, move_x + node, rows, waves, summed, around, cosine + at, sine + at, u_plane + at,
                            rates + at, sums + at,
                        )
                    else:
                        move_unloaded(
                            p, move_x, move_x + node, rows, waves, summed, around, cosine + at, sine + at, u_plane + at,
                            rates + at, sums + at,
                        )
            for m in range(f.nodes.shape[0]):
                node_at = (f.nodes[m, 0] * wp.static(nx) + f.nodes[m, 1]) * wp.static(lanes)
                for lane in range(wp.min(wp.static(lanes), last - low)):
                    f.trace[low + lane, m, n] = plane_array(u_plane)[node_at + lane]
        copy_out(u_plane, f, low, last)
        restore_denormals(before)

    return run_steps
