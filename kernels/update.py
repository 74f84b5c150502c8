"""Time step of a node: the key kernels are compiled for, the structs they take, differences in space, the update.

    ρH ü + c u̇ + D∇⁴u = f,   velocity form:  rate⁺ = decay·rate − stiffness·∇⁴u + load,   u⁺ = u + rate⁺

``rate`` is the displacement gained in one step, Δt·u̇ at the half-step between two time steps of u. Displacement is in
units of the plate's largest drive × Δt²/ρH, which keeps all numbers near one whatever the material. With κ = √(D/ρH),
``stiffness`` = (κΔt/h²)² (fourth order: (κΔt/12h²)²) and ``load`` ≤ 1, both divided by 1 + cΔt/2ρH where damping is
centred in time.

Differences are on unit spacing along x; ``aspect`` is (spacing x / spacing y)². The second-order biharmonic is the
Laplacian of the Laplacian, 13 nodes in all. In two passes it costs half the arithmetic, and an edge is one factor on
the inner Laplacian (the curvature) of its nodes: 2 where it is clamped, because the mirror node doubles the curvature,
and 0 where it is supported. The fourth-order form is two such passes too, each with five nodes along each axis. Edges
change the taps of the two nodes next to them in both passes, so taps near an edge are data. Each path computes ∇⁴u and
the load in its own way, then calls ``update``.

Scenes that need more than the plain plate take the moment form. Bending goes by moments: Mx and My from the curvatures
at each node, Mxy from the twist of each cell, and the force from the moments:

    Mx = Cxx u_xx + Cxy u_yy,   My = Cxy u_xx + Cyy u_yy,   Mxy = Ct u_xy,   force = Mx_xx + My_yy + Mxy_xy

C varies from node to node and contains the edges (a free edge carries no moment) and stiffeners. Beyond an edge u, Mx
and My continue as mirror images, and Mxy as the negative one: a node on an edge owns half a cell, and the stencil
treats its mirror image as the other half.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused


@dataclass(frozen=True)
class KernelEffects:
    """The compile key: physics compiled into a kernel; what is off leaves no arithmetic behind."""

    damping: bool = False  # The rate decays at each step
    square_cells: bool = True  # Spacings along x and y are equal, which saves an operation in each Laplacian of order 2
    order: int = 2  # Order of the differences in space, 2 or 4
    # The moment form alone has these
    terms: int = 2  # Terms of the load in time, see ``loads``
    moments: bool = False  # Bending stiffness varies over the plate, or an edge is free or elastic
    retarded: bool = False  # Stress follows the strain rate too (Kelvin–Voigt)
    in_plane: bool = False  # Constant membrane tension
    springs: bool = False  # Elastic bed or elastic edges
    membrane: bool = False  # Tension that grows with the deflection (Berger)
    attached: bool = False  # Masses on springs
    coils: bool = False  # Coils on patches
    branches: int = 0  # Shunted inductors of each coil
    travelling: bool = False  # A load that travels over the plate
    outline: bool = False  # Curvatures next to the outline reach to it, between two nodes

    @property
    def plain(self) -> bool:
        """True for a uniform plate with clamped or supported edges, which needs no moment form."""
        return self == KernelEffects(self.damping, self.square_cells, self.order)


@cache
def make_parameters(real):
    """Make the struct of numbers that all plates and nodes share."""

    @wp.struct
    class Parameters:
        stiffness: real
        aspect: real
        decay: real

    return Parameters


@cache
def make_state(real):
    """Make the structs of a batch of plates: Forcing, which kernels read, and Fields, which a step changes."""

    @wp.struct
    class Forcing:
        wave: wp.array3d[real]  # (plates, steps, terms) factors of the loads: of one tone cos ωt and sin ωt
        loads: wp.array4d[real]  # (terms, plates, rows, columns)
        in_phase: wp.array3d[real]  # (plates, rows, columns) the first load, and the second
        quadrature: wp.array3d[real]
        units: wp.array[real]  # (plates,) displacement [m] of a unit of u
        travelling: wp.array[real]  # (plates,) strength of the load that travels
        coefficients: wp.array3d[real]  # (plates, terms, actuators) factors of the waves in each actuator's drive

    @wp.struct
    class Fields:
        u: wp.array3d[real]  # (plates, rows, columns) displacement
        rate: wp.array3d[real]  # displacement gained in a step
        squares: wp.array3d[real]  # sum of rate² over the steps of the window
        attached: wp.array3d[real]  # (plates, attached masses, 2) their displacements and rates
        coils: wp.array3d[real]  # (plates, coils, numbers of the state), see ``coils``
        nodes: wp.array2d[int]  # (traced nodes, 2) row, column
        trace: wp.array3d[real]  # (plates, traced nodes, steps) displacements

    return Forcing, Fields


@cache
def make_material(real):
    """Make the struct Material of the moment form, shared by all plates, scaled as in the update."""

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
        centre_x: wp.array2d[real]  # (ny, nx) factor of the node itself in its curvature along x: 2 but at an outline
        centre_y: wp.array2d[real]  # along y
        strength: wp.array[real]  # (steps,) of the moving load
        along_x: wp.array2d[real]  # (steps, nx) its shares of the nodes
        along_y: wp.array2d[real]  # (steps, ny)
        attached_shares: wp.array3d[real]  # (attached masses, ny, nx) shares of the nodes in each one's patch
        attached: wp.array2d[real]  # (attached masses, 4) stiffness, damping, 1 / mass, 0
        coils: wp.array2d[real]  # (coils, numbers), see ``coils``
        coil_actuators: wp.array[int]  # (coils,) indices of their actuators
        aspect: real  # (hx / hy)²
        root_aspect: real  # hx / hy
        in_plane_x: real
        in_plane_y: real
        retardation: real  # of the material, in steps
        membrane: real  # tension per Σ weight · (−u · membrane curvature), in SI displacements
        stretch_ratio: real  # membrane force along y over that along x; the membrane curvature is u_xx + ratio · u_yy

    return Material


@cache
def make_laplacian(square_cells, real):
    """Make ``laplacian``: ∇²u from the five nodes of the cross."""

    @wp.func
    def laplacian_square(centre: real, west: real, east: real, south: real, north: real, aspect: real):
        return (west + east) + (south + north) - real(4.0) * centre

    @wp.func
    def laplacian_oblong(centre: real, west: real, east: real, south: real, north: real, aspect: real):
        along_x = west + east - real(2.0) * centre
        along_y = south + north - real(2.0) * centre
        return along_x + aspect * along_y

    return laplacian_square if square_cells else laplacian_oblong


@cache
def make_weighted_sum(real):
    """Make ``weighted_sum``: total + Σ taps · five nodes in a row; each step is one fused multiply-add."""
    Taps = wp.types.vector(length=5, dtype=real)

    @wp.func
    def weighted_sum(total: real, taps: Taps, a: real, b: real, c: real, d: real, e: real):
        return taps[0] * a + (taps[1] * b + (taps[2] * c + (taps[3] * d + (taps[4] * e + total))))

    return weighted_sum


@cache
def make_update(effects, real):
    """Make ``update``: the rate one step later from the rate, ∇⁴u, the load and the stiffness at a node."""
    Parameters = make_parameters(real)

    @wp.func
    def update(rate: real, biharmonic: real, load: real, stiffness: real, p: Parameters):
        # Evaluated from the left, so that each term is one fused multiply-add.
        if wp.static(effects.damping):
            return load + p.decay * rate - stiffness * biharmonic
        else:
            return load + rate - stiffness * biharmonic

    return update


@cache
def make_update_unloaded(effects, real):
    """Make ``update_unloaded``: the same where there is no load, with the same roundings."""
    Parameters, fused = make_parameters(real), make_fused(real)

    @wp.func
    def update_unloaded(rate: real, biharmonic: real, stiffness: real, p: Parameters):
        decayed = rate
        if wp.static(effects.damping):
            decayed = p.decay * rate
        return fused(-stiffness, biharmonic, decayed)

    return update_unloaded


@cache
def make_moment(effects, real):
    """Make ``moment``: Mx − Tx u from both curvatures; its second derivative has the force of the tension too."""
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
    """Make ``attached_force``: move an attached mass by one step, and return its force on its patch of the plate."""
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
    """Make ``add_local_forces``: add to the load −k u of springs and N · membrane curvature of a stretched plate."""

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
