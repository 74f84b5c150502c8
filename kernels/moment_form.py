"""All effects at one node: what the general paths run where a scene asks for more than the plain plate.

Bending goes by moments: from the curvatures of each node its moments Mx and My, from the twist of each cell Mxy, and
from the moments the force:

    Mx = Cxx u_xx + Cxy u_yy,   My = Cxy u_xx + Cyy u_yy,   Mxy = Ct u_xy,   force = Mx_xx + My_yy + Mxy_xy

C varies from node to node: edges are in it (a free edge carries no moment), as are stiffeners. Beyond an edge u, Mx
and My continue as mirror images and Mxy as the negative one: a node on the edge has half a cell, and the mirror image
is the other half.

Node (i, j) lies at [plate, j, i] in every array; twists of cells at [plate, j, i] for the cell to its upper right.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.fused import make_fused
from warp_plate.kernels.load import make_moving_load
from warp_plate.kernels.update import make_parameters, make_update


@cache
def make_structs(real):
    """(Material, Fields): what all plates share, and the state of the batch. All numbers are scaled as in ``update``.

    Material: bend_xx, bend_xy, bend_yy (ny, nx), twist (ny − 1, nx − 1): the C above; mobility: one over the mass of a
    node, zero where it is held; decay; spring: of the bed and of elastic edges; weight: share of a node's cell that is
    on the plate; strength (steps,), along_y (steps, ny), along_x (steps, nx): of the moving load; holds: (oscillators,
    ny, nx) share of each node in an oscillator's patch; oscillators: (oscillators, 4) stiffness, damping, one over the
    mass, 0; aspect: (hx/hy)², and its root; tension_x, tension_y; retardation: in steps; stretching: tension per
    Σ weight · (−u · pull), in SI displacements, pull being u_xx + κ u_yy; stretch_ratio: κ.

    Fields: wave (plates, steps, terms), see ``wave``; loads (terms, plates, ny, nx); u, rate, squares, mx, my, mxy,
    pull (plates, ny, nx); units: (plates,) displacements that one stands for [m]; moving: (plates,) the moving load's
    size; row_sums (plates, sums, 2, ny); tension: (plates,); hung: (plates, oscillators, 2) displacement and rate of
    the masses; push: (plates, oscillators) on the plate.
    """

    @wp.struct
    class Material:
        bend_xx: wp.array2d[real]
        bend_xy: wp.array2d[real]
        bend_yy: wp.array2d[real]
        twist: wp.array2d[real]
        mobility: wp.array2d[real]
        decay: wp.array2d[real]
        spring: wp.array2d[real]
        weight: wp.array2d[real]
        strength: wp.array[real]
        along_x: wp.array2d[real]
        along_y: wp.array2d[real]
        holds: wp.array3d[real]
        oscillators: wp.array2d[real]
        aspect: real
        root_aspect: real
        tension_x: real
        tension_y: real
        retardation: real
        stretching: real
        stretch_ratio: real

    @wp.struct
    class Fields:
        wave: wp.array3d[real]
        loads: wp.array4d[real]
        u: wp.array3d[real]
        rate: wp.array3d[real]
        squares: wp.array3d[real]
        mx: wp.array3d[real]
        my: wp.array3d[real]
        mxy: wp.array3d[real]
        pull: wp.array3d[real]
        units: wp.array[real]
        moving: wp.array[real]
        row_sums: wp.array4d[real]
        tension: wp.array[real]
        hung: wp.array3d[real]
        push: wp.array2d[real]

    return Material, Fields


@wp.func
def mirror(index: int, count: int):
    """A node beyond an edge stands for its mirror image."""
    inside = index
    if index < 0:
        inside = -index
    if index >= count:
        inside = 2 * (count - 1) - index
    return inside


@cache
def make_moment(effects, real):
    """A moment from the curvatures along and across it; a constant pull acts like one: (Mx − Tx u)_xx."""
    fused = make_fused(real)

    @wp.func
    def moment(rigidity: real, along: real, rigidity_across: real, across: real, tension: real, here: real):
        if wp.static(effects.tension):
            return fused(rigidity, along, rigidity_across * across) - tension * here
        else:
            return fused(rigidity, along, rigidity_across * across)

    return moment


@cache
def make_hang(real):
    """An oscillator's push on the plate, and the place and the pace of its mass a step and half a step later."""

    @wp.func
    def hang(place: real, pace: real, under: real, speed: real, oscillators: wp.array2d[real], o: int):
        push = oscillators[o, 0] * (place - under) + oscillators[o, 1] * (pace - speed)
        new = pace - oscillators[o, 2] * push
        return push, place + new, new

    return hang


@cache
def make_bend_node(effects, real):
    """Moments at a node, the twist of the cell to its upper right, and u_xx + κu_yy where stretching asks for it."""
    Material, Fields = make_structs(real)
    moment = make_moment(effects, real)

    @wp.func
    def strained(f: Fields, m: Material, k: int, j: int, i: int):
        """What the material's stress follows."""
        if wp.static(effects.material_damping):
            return f.u[k, j, i] + m.retardation * f.rate[k, j, i]
        else:
            return f.u[k, j, i]

    @wp.func
    def bend_node(f: Fields, m: Material, k: int, j: int, i: int):
        ny = f.u.shape[1]
        nx = f.u.shape[2]
        west = mirror(i - 1, nx)
        east = mirror(i + 1, nx)
        south = mirror(j - 1, ny)
        north = mirror(j + 1, ny)
        c = strained(f, m, k, j, i)
        e = strained(f, m, k, j, east)
        n = strained(f, m, k, north, i)
        along_x = strained(f, m, k, j, west) + e - real(2.0) * c
        along_y = m.aspect * (strained(f, m, k, south, i) + n - real(2.0) * c)
        here = f.u[k, j, i]
        tension_x = real(0.0)
        tension_y = real(0.0)
        if wp.static(effects.tension):
            tension_x = m.tension_x
            tension_y = m.tension_y
        f.mx[k, j, i] = moment(m.bend_xx[j, i], along_x, m.bend_xy[j, i], along_y, tension_x, here)
        f.my[k, j, i] = moment(m.bend_yy[j, i], along_y, m.bend_xy[j, i], along_x, tension_y, here)
        if i < nx - 1 and j < ny - 1:
            f.mxy[k, j, i] = m.twist[j, i] * (m.root_aspect * (strained(f, m, k, j + 1, i + 1) - e - n + c))
        if wp.static(effects.stretching):
            pull = f.u[k, j, west] + f.u[k, j, east] - real(2.0) * here
            pull_y = m.aspect * (f.u[k, south, i] + f.u[k, north, i] - real(2.0) * here)
            f.pull[k, j, i] = pull + m.stretch_ratio * pull_y

    return bend_node


@cache
def make_sum_row(effects, real):
    """Sums along row j: of stretching first, then of each oscillator's patch."""
    Material, Fields = make_structs(real)
    first = 1 if effects.stretching else 0

    @wp.func
    def sum_row(f: Fields, m: Material, k: int, which: int, j: int):
        total = real(0.0)
        speed = real(0.0)
        for i in range(f.u.shape[2]):
            if wp.static(effects.stretching):
                if which == 0:
                    total -= m.weight[j, i] * f.u[k, j, i] * f.pull[k, j, i]
            if wp.static(effects.oscillators):
                if which >= wp.static(first):
                    share = m.holds[which - wp.static(first), j, i]
                    total += share * f.u[k, j, i]
                    speed += share * f.rate[k, j, i]
        f.row_sums[k, which, 0, j] = total
        f.row_sums[k, which, 1, j] = speed

    return sum_row


@cache
def make_finish_sum(effects, real):
    """From the rows' sums the plate's tension, or an oscillator's push and its mass half a step and a step later."""
    Material, Fields = make_structs(real)
    hang = make_hang(real)
    first = 1 if effects.stretching else 0

    @wp.func
    def finish_sum(f: Fields, m: Material, k: int, which: int):
        total = real(0.0)
        speed = real(0.0)
        for j in range(f.u.shape[1]):
            total += f.row_sums[k, which, 0, j]
            speed += f.row_sums[k, which, 1, j]
        if wp.static(effects.stretching):
            if which == 0:
                f.tension[k] = m.stretching * f.units[k] * f.units[k] * total
        if wp.static(effects.oscillators):
            if which >= wp.static(first):
                o = which - wp.static(first)
                push, place, pace = hang(f.hung[k, o, 0], f.hung[k, o, 1], total, speed, m.oscillators, o)
                f.push[k, o] = push
                f.hung[k, o, 0] = place
                f.hung[k, o, 1] = pace

    return finish_sum


@cache
def make_other_forces(effects, real):
    """The load at a node, and with it what the bed and stretching do there: −k u + N(u_xx + κu_yy)."""

    @wp.func
    def other_forces(load: real, mobility: real, spring: real, here: real, tension: real, pull: real):
        total = load
        if wp.static(effects.foundation):
            total -= mobility * (spring * here)
        if wp.static(effects.stretching):
            total += mobility * (tension * pull)
        return total

    return other_forces


@cache
def make_move_node(effects, real):
    """Rate and displacement of a node half a step and a step later."""
    Material, Fields = make_structs(real)
    Parameters = make_parameters(real)
    update = make_update(effects, real)
    other_forces = make_other_forces(effects, real)
    moving_load = make_moving_load(real)

    @wp.func
    def move_node(f: Fields, m: Material, window: wp.vec2i, n: int, k: int, j: int, i: int):
        mobility = m.mobility[j, i]
        if mobility > real(0.0):
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

            here = f.u[k, j, i]
            load = real(0.0)
            for term in range(wp.static(effects.terms)):
                load += f.wave[k, n, term] * f.loads[term, k, j, i]
            if wp.static(effects.moving_load):
                pressed = moving_load(f.moving[k] * m.strength[n], m.along_y[n, j], m.along_x[n, i])
                load += mobility / m.weight[j, i] * pressed
            spring = real(0.0)
            tension = real(0.0)
            pull = real(0.0)
            if wp.static(effects.foundation):
                spring = m.spring[j, i]
            if wp.static(effects.stretching):
                tension = f.tension[k]
                pull = f.pull[k, j, i]
            load = other_forces(load, mobility, spring, here, tension, pull)
            if wp.static(effects.oscillators):
                for o in range(m.holds.shape[0]):
                    load += mobility / m.weight[j, i] * m.holds[o, j, i] * f.push[k, o]
            p = Parameters()
            if wp.static(effects.damping):
                p.decay = m.decay[j, i]
            new = update(f.rate[k, j, i], bending, load, mobility, p)
            f.rate[k, j, i] = new
            f.u[k, j, i] = here + new
            if n >= window[0] and n < window[1]:
                f.squares[k, j, i] += new * new

    return move_node
