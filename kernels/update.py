"""One step of one node: what kernels are compiled for, the structs they take, differences in space, and the update.

    ρH ü + c u̇ + D∇⁴u = f,   velocity form:  rate⁺ = decay·rate − stiffness·∇⁴u + load,   u⁺ = u + rate⁺

``rate`` is the displacement gained in one step, Δt·u̇ at the half-step between two levels of u. Displacement is in
units of the plate's largest drive × Δt²/ρH, which keeps all numbers near one whatever the material: ``stiffness`` =
(κΔt/h²)² (fourth order: (κΔt/12h²)²) and ``load`` ≤ 1, both divided by 1 + cΔt/2ρH where damping is centred in time.

Differences are on unit spacing along x; ``aspect`` is (spacing x / spacing y)². The second-order biharmonic is the
Laplacian of the Laplacian, 13 nodes in all. In two passes it costs half the arithmetic, and edges become simple: where
the inner Laplacian (the curvature) is stored, a clamped edge, whose mirror node doubles it, and a supported edge, where
it is zero, are the factors 2 and 0 on the curvature of the edge's nodes. The fourth-order form is two such passes too,
each with five nodes along each axis. Edges change the taps of the two nodes next to them in both passes, so taps near
an edge are data. Each path gathers ∇⁴u and the load by itself.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp


@dataclass(frozen=True)
class KernelEffects:
    """The compile key: physics compiled into a kernel; what is off leaves no arithmetic behind."""

    damping: bool = False  # The rate decays at each step
    square_cells: bool = True  # Spacings along x and y are equal, which saves an operation in each Laplacian of order 2
    order: int = 2  # Order of the differences in space, 2 or 4
    # The moment form alone has these, see ``effects``
    terms: int = 2  # Terms of the load in time, see ``loads``
    moments: bool = False  # Bending stiffness varies over the plate, or an edge is free or elastic
    retarded: bool = False  # Stress follows the strain rate too (Kelvin–Voigt)
    in_plane: bool = False  # Constant membrane tension
    springs: bool = False  # Elastic bed or elastic edges
    membrane: bool = False  # Tension that grows with the deflection (Berger)
    attached: bool = False  # Masses on springs
    travelling: bool = False  # A load that travels over the plate

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

    @wp.struct
    class Fields:
        u: wp.array3d[real]  # (plates, rows, columns) displacement
        rate: wp.array3d[real]  # displacement gained in a step
        squares: wp.array3d[real]  # sum of rate² over the steps of the window
        attached: wp.array3d[real]  # (plates, attached masses, 2) their displacements and rates
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
        strength: wp.array[real]  # (steps,) of the moving load
        along_x: wp.array2d[real]  # (steps, nx) its shares of the nodes
        along_y: wp.array2d[real]  # (steps, ny)
        attached_shares: wp.array3d[real]  # (attached masses, ny, nx) shares of the nodes in each one's patch
        attached: wp.array2d[real]  # (attached masses, 4) stiffness, damping, 1 / mass, 0
        aspect: real  # (hx / hy)²
        root_aspect: real  # hx / hy
        in_plane_x: real
        in_plane_y: real
        retardation: real  # of the material, in steps
        membrane: real  # tension per Σ weight · (−u · membrane curvature), in SI displacements
        stretch_ratio: real  # κ of the membrane curvature u_xx + κ u_yy

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
    """Make ``update``: the rate half a step later from the rate, ∇⁴u, the load and the stiffness at a node."""
    Parameters = make_parameters(real)

    @wp.func
    def update(rate: real, biharmonic: real, load: real, stiffness: real, p: Parameters):
        # Evaluated from the left, so that each term is one fused multiply-add.
        if wp.static(effects.damping):
            return load + p.decay * rate - stiffness * biharmonic
        else:
            return load + rate - stiffness * biharmonic

    return update
