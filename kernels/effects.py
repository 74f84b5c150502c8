"""Moment form: scenes that need more than the plain plate, and what acts by way of sums over the plate, or travels.

Bending goes by moments: Mx and My from the curvatures at each node, Mxy from the twist of each cell, and the force from
the moments:

    Mx = Cxx u_xx + Cxy u_yy,   My = Cxy u_xx + Cyy u_yy,   Mxy = Ct u_xy,   force = Mx_xx + My_yy + Mxy_xy

C varies from node to node and contains the edges (a free edge carries no moment) and stiffeners. Beyond an edge u, Mx
and My continue as mirror images and Mxy as the negative one: a node on an edge has half a cell, and the mirror image is
the other half.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.update import make_material, make_state


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
def make_attached_force(real):
    """Make ``attached_force``: the force of a mass on its patch of the plate, which also moves the mass by a step."""
    Material, (_, Fields) = make_material(real), make_state(real)

    @wp.func
    def attached_force(f: Fields, m: Material, k: int, o: int, patch_u: real, patch_rate: real):
        mass_u = f.attached[k, o, 0]
        mass_rate = f.attached[k, o, 1]
        force = m.attached[o, 0] * (mass_u - patch_u) + m.attached[o, 1] * (mass_rate - patch_rate)
        rate = mass_rate - m.attached[o, 2] * force
        f.attached[k, o, 0] = mass_u + rate
        f.attached[k, o, 1] = rate
        return force

    return attached_force


@cache
def make_membrane_tension(real):
    """Make ``membrane_tension``: Berger's tension from Σ weight · (−u · membrane curvature)."""
    Material, (Forcing, _) = make_material(real), make_state(real)

    @wp.func
    def membrane_tension(d: Forcing, m: Material, k: int, total: real):
        return m.membrane * d.units[k] * d.units[k] * total

    return membrane_tension


@cache
def make_travelling_pressure(real):
    """Make ``travelling_pressure``: that of the load that travels, on node (i, j) at step n."""
    Material, (Forcing, _) = make_material(real), make_state(real)

    @wp.func
    def travelling_pressure(d: Forcing, m: Material, k: int, n: int, j: int, i: int):
        return d.travelling[k] * m.strength[n] * m.along_y[n, j] * m.along_x[n, i]

    return travelling_pressure


@cache
def make_add_local_forces(effects, real):
    """Make ``add_local_forces``: add to the load what bed and membrane do at a node, −k u + N(u_xx + κu_yy)."""

    @wp.func
    def add_local_forces(
        load: real, inverse_mass: real, spring: real, u: real, tension: real, membrane_curvature: real
    ):
        total = load
        if wp.static(effects.springs):
            total -= inverse_mass * (spring * u)
        if wp.static(effects.membrane):
            total += inverse_mass * (tension * membrane_curvature)
        return total

    return add_local_forces
