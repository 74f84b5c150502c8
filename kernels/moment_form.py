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
from warp_plate.kernels.update import make_parameters, make_update


@cache
def make_structs(real):
    """Make the structs Material, shared by all plates, and Fields, the state of the batch, scaled as in ``update``."""

    @wp.struct
    class Material:
        bend_xx: wp.array2d[real]  # (ny, nx) Cxx
        bend_xy: wp.array2d[real]  # (ny, nx) Cxy
        bend_yy: wp.array2d[real]  # (ny, nx) Cyy
        twist: wp.array2d[real]  # (ny − 1, nx − 1) Ct
        inverse_mass: wp.array2d[real]  # (ny, nx) zero where a node is held
        decay: wp.array2d[real]  # (ny, nx)
        spring: wp.array2d[real]  # (ny, nx) stiffness of the bed and of elastic edges
        weight: wp.array2d[real]  # (ny, nx) share of a node's cell that lies on the plate
        strength: wp.array[real]  # (steps,) of the moving load
        along_x: wp.array2d[real]  # (steps, nx) its shares of the nodes
        along_y: wp.array2d[real]  # (steps, ny)
        oscillator_shares: wp.array3d[real]  # (oscillators, ny, nx) shares of the nodes in an oscillator's patch
        oscillators: wp.array2d[real]  # (oscillators, 4) stiffness, damping, 1 / mass, 0
        aspect: real  # (hx / hy)²
        root_aspect: real  # hx / hy
        tension_x: real
        tension_y: real
        retardation: real  # of the material, in steps
        stretching: real  # tension per Σ weight · (−u · membrane curvature), in SI displacements
        stretch_ratio: real  # κ of the membrane curvature u_xx + κ u_yy

    @wp.struct
    class Fields:
        wave: wp.array3d[real]  # (plates, steps, terms), see ``wave``
        loads: wp.array4d[real]  # (terms, plates, ny, nx)
        u: wp.array3d[real]  # (plates, ny, nx), as the next six
        rate: wp.array3d[real]
        squares: wp.array3d[real]
        mx: wp.array3d[real]
        my: wp.array3d[real]
        mxy: wp.array3d[real]
        membrane_curvature: wp.array3d[real]
        units: wp.array[real]  # (plates,) unit of displacement [m]
        moving: wp.array[real]  # (plates,) size of the moving load
        row_sums: wp.array4d[real]  # (plates, sums, 2, ny)
        tension: wp.array[real]  # (plates,) by stretching
        oscillator_state: wp.array3d[real]  # (plates, oscillators, 2) displacement and rate of the masses
        oscillator_force: wp.array2d[real]  # (plates, oscillators) on the plate

    return Material, Fields


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
        if wp.static(effects.tension):
            return fused(rigidity, along, rigidity_across * across) - tension * u
        else:
            return fused(rigidity, along, rigidity_across * across)

    return moment


@cache
def make_oscillator_force(real):
    """Make ``oscillator_force``: the force on the plate, and the mass's displacement and rate after the step."""

    @wp.func
    def oscillator_force(
        mass_u: real, mass_rate: real, plate_u: real, plate_rate: real, oscillators: wp.array2d[real], o: int
    ):
        force = oscillators[o, 0] * (mass_u - plate_u) + oscillators[o, 1] * (mass_rate - plate_rate)
        new = mass_rate - oscillators[o, 2] * force
        return force, mass_u + new, new

    return oscillator_force


@cache
def make_compute_moments(effects, real):
    """Make ``compute_moments`` of a node: Mx, My, Mxy of the cell to its upper right, and membrane curvature."""
    Material, Fields = make_structs(real)
    moment = make_moment(effects, real)

    @wp.func
    def retarded_u(f: Fields, m: Material, k: int, j: int, i: int):
        """Return the displacement that causes stress, which includes the strain rate's share."""
        if wp.static(effects.material_damping):
            return f.u[k, j, i] + m.retardation * f.rate[k, j, i]
        else:
            return f.u[k, j, i]

    @wp.func
    def compute_moments(f: Fields, m: Material, k: int, j: int, i: int):
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
        tension_x = real(0.0)
        tension_y = real(0.0)
        if wp.static(effects.tension):
            tension_x = m.tension_x
            tension_y = m.tension_y
        f.mx[k, j, i] = moment(m.bend_xx[j, i], along_x, m.bend_xy[j, i], along_y, tension_x, u)
        f.my[k, j, i] = moment(m.bend_yy[j, i], along_y, m.bend_xy[j, i], along_x, tension_y, u)
        if i < nx - 1 and j < ny - 1:
            f.mxy[k, j, i] = m.twist[j, i] * (m.root_aspect * (retarded_u(f, m, k, j + 1, i + 1) - e - n + c))
        if wp.static(effects.stretching):
            u_xx = f.u[k, j, west] + f.u[k, j, east] - real(2.0) * u
            u_yy = m.aspect * (f.u[k, south, i] + f.u[k, north, i] - real(2.0) * u)
            f.membrane_curvature[k, j, i] = u_xx + m.stretch_ratio * u_yy

    return compute_moments


@cache
def make_sum_row(effects, real):
    """Make ``sum_row``: the sums along row j for stretching (first, if on) and for each oscillator's patch."""
    Material, Fields = make_structs(real)
    first = 1 if effects.stretching else 0

    @wp.func
    def sum_row(f: Fields, m: Material, k: int, which: int, j: int):
        total = real(0.0)
        total_rate = real(0.0)
        for i in range(f.u.shape[2]):
            if wp.static(effects.stretching):
                if which == 0:
                    total -= m.weight[j, i] * f.u[k, j, i] * f.membrane_curvature[k, j, i]
            if wp.static(effects.oscillators):
                if which >= wp.static(first):
                    share = m.oscillator_shares[which - wp.static(first), j, i]
                    total += share * f.u[k, j, i]
                    total_rate += share * f.rate[k, j, i]
        f.row_sums[k, which, 0, j] = total
        f.row_sums[k, which, 1, j] = total_rate

    return sum_row


@cache
def make_finish_sum(effects, real):
    """Make ``finish_sum``: from the rows' sums the tension, or an oscillator's force and its state after the step."""
    Material, Fields = make_structs(real)
    oscillator_force = make_oscillator_force(real)
    first = 1 if effects.stretching else 0

    @wp.func
    def finish_sum(f: Fields, m: Material, k: int, which: int):
        total = real(0.0)
        total_rate = real(0.0)
        for j in range(f.u.shape[1]):
            total += f.row_sums[k, which, 0, j]
            total_rate += f.row_sums[k, which, 1, j]
        if wp.static(effects.stretching):
            if which == 0:
                f.tension[k] = m.stretching * f.units[k] * f.units[k] * total
        if wp.static(effects.oscillators):
            if which >= wp.static(first):
                o = which - wp.static(first)
                force, mass_u, mass_rate = oscillator_force(
                    f.oscillator_state[k, o, 0], f.oscillator_state[k, o, 1], total, total_rate, m.oscillators, o
                )
                f.oscillator_force[k, o] = force
                f.oscillator_state[k, o, 0] = mass_u
                f.oscillator_state[k, o, 1] = mass_rate

    return finish_sum


@cache
def make_add_local_forces(effects, real):
    """Make ``add_local_forces``: add to the load what bed and stretching do at a node, −k u + N(u_xx + κu_yy)."""

    @wp.func
    def add_local_forces(
        load: real, inverse_mass: real, spring: real, u: real, tension: real, membrane_curvature: real
    ):
        total = load
        if wp.static(effects.foundation):
            total -= inverse_mass * (spring * u)
        if wp.static(effects.stretching):
            total += inverse_mass * (tension * membrane_curvature)
        return total

    return add_local_forces


@cache
def make_update_node(effects, real):
    """Make ``update_node``: rate and displacement of a node half a step and a step later."""
    Material, Fields = make_structs(real)
    Parameters = make_parameters(real)
    update = make_update(effects, real)
    add_local_forces = make_add_local_forces(effects, real)

    @wp.func
    def update_node(f: Fields, m: Material, window: wp.vec2i, n: int, k: int, j: int, i: int):
        inverse_mass = m.inverse_mass[j, i]
        if inverse_mass > real(0.0):
            ny = f.u.shape[1]
            nx = f.u.shape[2]
            mx_c = f.mx[k, j, i]
            my_c = f.my[k, j, i]
            bending = f.mx[k, j, mirror(i - 1, nx)] + f.mx[k, j, mirror(i + 1, nx)] - real(2.0) * mx_c
            bending += m.aspect * (f.my[k, mirror(j - 1, ny), i] + f.my[k, mirror(j + 1, ny), i] - real(2.0) * my_c)
            # The four cells around the node; those beyond an edge are negative mirror images.
            left = wp.max(i - 1, 0)
            right = wp.min(i, nx - 2)
            low = wp.max(j - 1, 0)
            high = wp.min(j, ny - 2)
            sign_left = wp.where(i == 0, real(1.0), real(-1.0))
            sign_right = wp.where(i == nx - 1, real(-1.0), real(1.0))
            sign_low = wp.where(j == 0, real(1.0), real(-1.0))
            sign_high = wp.where(j == ny - 1, real(-1.0), real(1.0))
            upper = sign_right * f.mxy[k, high, right] + sign_left * f.mxy[k, high, left]
            lower = sign_right * f.mxy[k, low, right] + sign_left * f.mxy[k, low, left]
            bending += m.root_aspect * (sign_high * upper + sign_low * lower)

            u = f.u[k, j, i]
            load = real(0.0)
            for term in range(wp.static(effects.terms)):
                load += f.wave[k, n, term] * f.loads[term, k, j, i]
            if wp.static(effects.moving_load):
                pressure = f.moving[k] * m.strength[n] * m.along_y[n, j] * m.along_x[n, i]
                load += inverse_mass / m.weight[j, i] * pressure
            spring = real(0.0)
            tension = real(0.0)
            membrane_curvature = real(0.0)
            if wp.static(effects.foundation):
                spring = m.spring[j, i]
            if wp.static(effects.stretching):
                tension = f.tension[k]
                membrane_curvature = f.membrane_curvature[k, j, i]
            load = add_local_forces(load, inverse_mass, spring, u, tension, membrane_curvature)
            if wp.static(effects.oscillators):
                for o in range(m.oscillator_shares.shape[0]):
                    load += inverse_mass / m.weight[j, i] * m.oscillator_shares[o, j, i] * f.oscillator_force[k, o]
            p = Parameters()
            if wp.static(effects.damping):
                p.decay = m.decay[j, i]
            new = update(f.rate[k, j, i], bending, load, inverse_mass, p)
            f.rate[k, j, i] = new
            f.u[k, j, i] = u + new
            if n >= window[0] and n < window[1]:
                f.squares[k, j, i] += new * new

    return update_node


@cache
def make_passes(effects, real):
    """Make the kernels of the streaming path's step, a launch for each pass.

    Launch them over (plates, ny, nx), (plates, sums, ny), (plates, sums) and (plates, ny, nx).
    """
    Material, Fields = make_structs(real)
    compute_node, update_node = make_compute_moments(effects, real), make_update_node(effects, real)
    sum_row, finish_sum = make_sum_row(effects, real), make_finish_sum(effects, real)

    @portable_kernel()
    def compute_moments(f: Fields, m: Material):
        k, j, i = wp.tid()
        compute_node(f, m, k, j, i)

    @portable_kernel()
    def sum_rows(f: Fields, m: Material):
        k, which, j = wp.tid()
        sum_row(f, m, k, which, j)

    @portable_kernel()
    def finish_sums(f: Fields, m: Material):
        k, which = wp.tid()
        finish_sum(f, m, k, which)

    @portable_kernel()
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
