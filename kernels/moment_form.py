"""Moment form: all effects at one node, for scenes that need more than the plain plate.

Bending goes by moments: Mx and My from the curvatures at each node, Mxy from the twist of each cell, and the force from
the moments:

    Mx = Cxx u_xx + Cxy u_yy,   My = Cxy u_xx + Cyy u_yy,   Mxy = Ct u_xy,   force = Mx_xx + My_yy + Mxy_xy

C varies from node to node and contains the edges (a free edge carries no moment) and stiffeners. Beyond an edge u, Mx
and My continue as mirror images and Mxy as the negative one: a node on an edge has half a cell, and the mirror image is
the other half.

Node (i, j) is at [plate, j, i] in every array; the twist at [plate, j, i] is that of the cell to its upper right.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused, portable_kernel
from warp_plate.kernels.effects import (
    make_add_local_forces,
    make_attached_force,
    make_membrane_tension,
    make_travelling_pressure,
)
from warp_plate.kernels.update import make_material, make_parameters, make_state, make_update


@cache
def make_work(real):
    """Make the struct Work: what the passes of a step leave to each other."""

    @wp.struct
    class Work:
        mx: wp.array3d[real]  # (plates, ny, nx)
        my: wp.array3d[real]
        mxy: wp.array3d[real]
        membrane_curvature: wp.array3d[real]
        row_sums: wp.array4d[real]  # (plates, sums, 2, ny)
        membrane_force: wp.array[real]  # (plates,) of the stretched membrane
        attached_force: wp.array2d[real]  # (plates, attached masses) on the plate

    return Work


@wp.func
def mirror(index: int, count: int):
    """Return the mirror image of an index beyond an edge."""
    inside = index
    if index < 0:
        inside = -index
    if index >= count:
        inside = 2 * (count - 1) - index
    return inside


@cache
def make_moment(effects, real):
    """Make ``moment``: from the curvatures along and across it, less constant tension, as (Mx − Tx u)_xx."""
    fused = make_fused(real)

    @wp.func
    def moment(rigidity: real, along: real, rigidity_across: real, across: real, tension: real, u: real):
        if wp.static(effects.in_plane):
            return fused(rigidity, along, rigidity_across * across) - tension * u
        else:
            return fused(rigidity, along, rigidity_across * across)

    return moment


@cache
def make_compute_moments(effects, real):
    """Make ``compute_moments`` of a node: Mx, My, Mxy of the cell to its upper right, and membrane curvature."""
    Material, Work, (Forcing, Fields) = make_material(real), make_work(real), make_state(real)
    moment = make_moment(effects, real)

    @wp.func
    def retarded_u(f: Fields, m: Material, k: int, j: int, i: int):
        """Return the displacement that causes stress, which includes the strain rate's share."""
        if wp.static(effects.retarded):
            return f.u[k, j, i] + m.retardation * f.rate[k, j, i]
        else:
            return f.u[k, j, i]

    @wp.func
    def compute_moments(f: Fields, w: Work, m: Material, k: int, j: int, i: int):
        ny = f.u.shape[1]
        nx = f.u.shape[2]
        west = mirror(i - 1, nx)
        east = mirror(i + 1, nx)
        south = mirror(j - 1, ny)
        north = mirror(j + 1, ny)
        c = retarded_u(f, m, k, j, i)
        e = retarded_u(f, m, k, j, east)
        n = retarded_u(f, m, k, north, i)
        along_x = retarded_u(f, m, k, j, west) + e - real(2.0) * c
        along_y = m.aspect * (retarded_u(f, m, k, south, i) + n - real(2.0) * c)
        u = f.u[k, j, i]
        in_plane_x = real(0.0)
        in_plane_y = real(0.0)
        if wp.static(effects.in_plane):
            in_plane_x = m.in_plane_x
            in_plane_y = m.in_plane_y
        w.mx[k, j, i] = moment(m.bend_xx[j, i], along_x, m.bend_xy[j, i], along_y, in_plane_x, u)
        w.my[k, j, i] = moment(m.bend_yy[j, i], along_y, m.bend_xy[j, i], along_x, in_plane_y, u)
        if i < nx - 1 and j < ny - 1:
            w.mxy[k, j, i] = m.twist[j, i] * (m.root_aspect * (retarded_u(f, m, k, j + 1, i + 1) - e - n + c))
        if wp.static(effects.membrane):
            u_xx = f.u[k, j, west] + f.u[k, j, east] - real(2.0) * u
            u_yy = m.aspect * (f.u[k, south, i] + f.u[k, north, i] - real(2.0) * u)
            w.membrane_curvature[k, j, i] = u_xx + m.stretch_ratio * u_yy

    return compute_moments


@cache
def make_sum_row(effects, real):
    """Make ``sum_row``: the sums along row j for the membrane (first, if on) and each attached mass's patch."""
    Material, Work, (Forcing, Fields) = make_material(real), make_work(real), make_state(real)
    first = 1 if effects.membrane else 0

    @wp.func
    def sum_row(f: Fields, w: Work, m: Material, k: int, which: int, j: int):
        total = real(0.0)
        total_rate = real(0.0)
        for i in range(f.u.shape[2]):
            if wp.static(effects.membrane):
                if which == 0:
                    total -= m.weight[j, i] * f.u[k, j, i] * w.membrane_curvature[k, j, i]
            if wp.static(effects.attached):
                if which >= wp.static(first):
                    share = m.attached_shares[which - wp.static(first), j, i]
                    total += share * f.u[k, j, i]
                    total_rate += share * f.rate[k, j, i]
        w.row_sums[k, which, 0, j] = total
        w.row_sums[k, which, 1, j] = total_rate

    return sum_row


@cache
def make_finish_sum(effects, real):
    """Make ``finish_sum``: from the rows' sums the tension, or the force of an attached mass, which moves by a step."""
    Material, Work, (Forcing, Fields) = make_material(real), make_work(real), make_state(real)
    attached_force, membrane_tension = make_attached_force(real), make_membrane_tension(real)
    first = 1 if effects.membrane else 0

    @wp.func
    def finish_sum(d: Forcing, f: Fields, w: Work, m: Material, k: int, which: int):
        total = real(0.0)
        total_rate = real(0.0)
        for j in range(f.u.shape[1]):
            total += w.row_sums[k, which, 0, j]
            total_rate += w.row_sums[k, which, 1, j]
        if wp.static(effects.membrane):
            if which == 0:
                w.membrane_force[k] = membrane_tension(d, m, k, total)
        if wp.static(effects.attached):
            if which >= wp.static(first):
                o = which - wp.static(first)
                w.attached_force[k, o] = attached_force(f, m, k, o, total, total_rate)

    return finish_sum


@cache
def make_update_node(effects, real):
    """Make ``update_node``: rate and displacement of a node half a step and a step later."""
    Material, Work, (Forcing, Fields) = make_material(real), make_work(real), make_state(real)
    Parameters = make_parameters(real)
    update = make_update(effects, real)
    add_local_forces, travelling_pressure = make_add_local_forces(effects, real), make_travelling_pressure(real)

    @wp.func
    def update_node(d: Forcing, f: Fields, w: Work, m: Material, summed: bool, n: int, k: int, j: int, i: int):
        inverse_mass = m.inverse_mass[j, i]
        if inverse_mass > real(0.0):
            ny = f.u.shape[1]
            nx = f.u.shape[2]
            mx_c = w.mx[k, j, i]
            my_c = w.my[k, j, i]
            bending = w.mx[k, j, mirror(i - 1, nx)] + w.mx[k, j, mirror(i + 1, nx)] - real(2.0) * mx_c
            bending += m.aspect * (w.my[k, mirror(j - 1, ny), i] + w.my[k, mirror(j + 1, ny), i] - real(2.0) * my_c)
            # The four cells around the node; those beyond an edge are negative mirror images.
            left = wp.max(i - 1, 0)
            right = wp.min(i, nx - 2)
            low = wp.max(j - 1, 0)
            high = wp.min(j, ny - 2)
            sign_left = wp.where(i == 0, real(1.0), real(-1.0))
            sign_right = wp.where(i == nx - 1, real(-1.0), real(1.0))
            sign_low = wp.where(j == 0, real(1.0), real(-1.0))
            sign_high = wp.where(j == ny - 1, real(-1.0), real(1.0))
            upper = sign_right * w.mxy[k, high, right] + sign_left * w.mxy[k, high, left]
            lower = sign_right * w.mxy[k, low, right] + sign_left * w.mxy[k, low, left]
            bending += m.root_aspect * (sign_high * upper + sign_low * lower)

            u = f.u[k, j, i]
            load = real(0.0)
            for term in range(wp.static(effects.terms)):
                load += d.wave[k, n, term] * d.loads[term, k, j, i]
            if wp.static(effects.travelling):
                load += inverse_mass / m.weight[j, i] * travelling_pressure(d, m, k, n, j, i)
            spring = real(0.0)
            tension = real(0.0)
            membrane_curvature = real(0.0)
            if wp.static(effects.springs):
                spring = m.spring[j, i]
            if wp.static(effects.membrane):
                tension = w.membrane_force[k]
                membrane_curvature = w.membrane_curvature[k, j, i]
            load = add_local_forces(load, inverse_mass, spring, u, tension, membrane_curvature)
            if wp.static(effects.attached):
                for o in range(m.attached_shares.shape[0]):
                    load += inverse_mass / m.weight[j, i] * m.attached_shares[o, j, i] * w.attached_force[k, o]
            p = Parameters()
            if wp.static(effects.damping):
                p.decay = m.decay[j, i]
            new = update(f.rate[k, j, i], bending, load, inverse_mass, p)
            f.rate[k, j, i] = new
            f.u[k, j, i] = u + new
            if summed:
                f.squares[k, j, i] += new * new

    return update_node


@cache
def make_passes(effects, real):
    """Make the kernels of the streaming path's step, a launch for each pass.

    Launch them over (plates, ny, nx), (plates, sums, ny), (plates, sums) and (plates, ny, nx).
    """
    Material, Work, (Forcing, Fields) = make_material(real), make_work(real), make_state(real)
    compute_node, update_node = make_compute_moments(effects, real), make_update_node(effects, real)
    sum_row, finish_sum = make_sum_row(effects, real), make_finish_sum(effects, real)

    @portable_kernel()
    def compute_moments(d: Forcing, f: Fields, w: Work, m: Material):
        k, j, i = wp.tid()
        compute_node(f, w, m, k, j, i)

    @portable_kernel()
    def sum_rows(d: Forcing, f: Fields, w: Work, m: Material):
        k, which, j = wp.tid()
        sum_row(f, w, m, k, which, j)

    @portable_kernel()
    def finish_sums(d: Forcing, f: Fields, w: Work, m: Material):
        k, which = wp.tid()
        finish_sum(d, f, w, m, k, which)

    @portable_kernel()
    def update_nodes(
        d: Forcing,
        f: Fields,
        w: Work,
        m: Material,
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        clock: wp.array[int],  # (1,)
        offset: int,  # the step is clock[0] + offset
    ):
        k, j, i = wp.tid()
        n = clock[0] + offset
        update_node(d, f, w, m, n >= window[0] and n < window[1], n, k, j, i)

    return compute_moments, sum_rows, finish_sums, update_nodes
