"""The plate in moment form: rigidity, mass and springs of every node, with a scene's edges, layers and effects.

Bending stores ½∫ Dx u_xx² + 2 D1 u_xx u_yy + Dy u_yy² + 4 Dxy u_xy² dA. On the grid, curvatures and moments belong to
nodes and twists to cells, and a node on an edge has half a cell (a quarter at a corner). There the curvature across the
edge is the mirror image's, 2(u₁ − u₀)/h², in series with what holds the edge: a rotational spring of stiffness r per
length adds the compliance 2/(r h) to that of the plate,

    C = (D⁻¹ + diag(2/(rx hx), 2/(ry hy)))⁻¹,

which is D for a clamped edge (r = ∞) and leaves no moment across a supported or free one (r = 0). So the operator comes
from an energy: it is symmetric in the nodes' masses, and never negative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from warp_plate.plate.section import Section, make_section
from warp_plate.plate.weights import EDGE_LINES, moving_nodes, node_positions, overlap
from warp_plate.scene.model import ElasticEdge, Scene

# Up to this many unknowns, all buckling loads are computed by a dense solver.
DENSE = 400


@dataclass(frozen=True)
class Bending:
    """Fields of the plate on its grid."""

    spacing: tuple[float, float]  # (hx, hy) [m]
    bend_xx: np.ndarray  # (ny, nx) Cxx above [N·m]
    bend_xy: np.ndarray  # (ny, nx) Cxy [N·m]
    bend_yy: np.ndarray  # (ny, nx) Cyy [N·m]
    twist: np.ndarray  # (ny − 1, nx − 1) 4Dxy of the cells [N·m]
    mass: np.ndarray  # (ny, nx) mass per area [kg/m²]
    weight: np.ndarray  # (ny, nx) share of each node's cell on the plate: 1, ½ or ¼
    spring: np.ndarray  # (ny, nx) springs per area, of the bed and of elastic edges [N/m³]
    moves: np.ndarray  # (ny, nx) true for nodes that move
    tension: tuple[float, float]  # Tension along x and y [N/m]
    stretch: tuple[float, float]  # Resistance to stretching of the whole plate along x and y [N/m], see ``section``

    @property
    def stretch_ratio(self) -> float:
        """κ of ``section``: stretching tension along y relative to that along x; 1 for an isotropic plate."""
        return math.sqrt(self.stretch[1] / self.stretch[0])

    @property
    def berger(self) -> float:
        """Berger's tension along x for ∫ u_x² + κu_y² dA = 1 m² [N/m³]; for an isotropic plate 6D/(H² area)."""
        area = self.spacing[0] * self.spacing[1] * float(self.weight.sum())
        return self.stretch[0] / (2 * area)


def make_bending(scene: Scene) -> Bending:
    """Return the fields of a scene on its grid."""
    effects, (width, height), (nx, ny) = scene.effects, scene.plate.size, scene.grid.nodes
    hx, hy = width / (nx - 1), height / (ny - 1)
    section = make_section(scene)
    compliance_x, compliance_y = np.zeros((ny, nx)), np.zeros((ny, nx))
    spring = np.full((ny, nx), effects.foundation.stiffness if effects.foundation else 0.0)
    for side, line in EDGE_LINES.items():
        edge = getattr(scene.edges, side)
        across, compliance = (hx, compliance_x) if side in ("left", "right") else (hy, compliance_y)
        if isinstance(edge, ElasticEdge):
            compliance[line] = 2 / (edge.rotation * across) if edge.rotation > 0 else math.inf
            spring[line] += 2 * edge.translation / across
        else:
            compliance[line] = 0 if edge == "clamped" else math.inf
    bend_xx, bend_xy, bend_yy = _in_series(section, compliance_x, compliance_y)
    corners = section.twist
    half_x, half_y = np.ones(nx), np.ones(ny)
    half_x[[0, -1]] = half_y[[0, -1]] = 0.5
    return Bending(
        spacing=(hx, hy),
        bend_xx=bend_xx,
        bend_xy=bend_xy,
        bend_yy=bend_yy,
        twist=corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:],
        mass=section.mass,
        weight=np.outer(half_y, half_x),
        spring=spring,
        moves=moving_nodes(scene),
        tension=(effects.tension.x, effects.tension.y) if effects.tension else (0.0, 0.0),
        stretch=section.stretch,
    )


def stiffness_matrix(bending: Bending) -> scipy.sparse.csr_array:
    """Return the symmetric matrix K [N/m] of all nodes, row by row, edges included: ½uᵀKu is the energy stored."""
    (hx, hy), (ny, nx) = bending.spacing, bending.mass.shape
    curve_x = scipy.sparse.kron(scipy.sparse.eye_array(ny), _mirrored_second_difference(nx)) / hx**2
    curve_y = scipy.sparse.kron(_mirrored_second_difference(ny), scipy.sparse.eye_array(nx)) / hy**2
    cells = scipy.sparse.kron(_difference(ny), _difference(nx)) / (hx * hy)
    weight = bending.weight

    def diagonal(values: np.ndarray) -> scipy.sparse.dia_array:
        return scipy.sparse.diags_array(np.ravel(values))

    stiffness = (
        curve_x.T @ diagonal(weight * bending.bend_xx) @ curve_x
        + curve_x.T @ diagonal(weight * bending.bend_xy) @ curve_y
        + curve_y.T @ diagonal(weight * bending.bend_xy) @ curve_x
        + curve_y.T @ diagonal(weight * bending.bend_yy) @ curve_y
        + cells.T @ diagonal(bending.twist) @ cells
        + diagonal(weight * bending.spring)
        - bending.tension[0] * diagonal(weight) @ curve_x
        - bending.tension[1] * diagonal(weight) @ curve_y
    )
    return scipy.sparse.csr_array(hx * hy * stiffness)


def system(scene: Scene, bending: Bending) -> tuple[scipy.sparse.csr_array, np.ndarray]:
    """Return stiffness [N/m] and masses [kg] of the moving nodes, row by row, then of the oscillators' masses."""
    moves, oscillators = np.flatnonzero(bending.moves), scene.effects.oscillators
    stiffness = stiffness_matrix(bending)[moves][:, moves]
    stiffness = with_oscillators(scene, stiffness, moves, [oscillator.stiffness for oscillator in oscillators])
    return stiffness, moving_masses(scene, bending)


def moving_masses(scene: Scene, bending: Bending) -> np.ndarray:
    """Return the masses [kg] of the moving nodes, then those of the oscillators."""
    attached = [oscillator.mass for oscillator in scene.effects.oscillators if oscillator.mass > 0]
    return np.concatenate([mass_matrix(bending)[bending.moves.ravel()], attached])


def with_oscillators(
    scene: Scene, matrix: scipy.sparse.csr_array, moves: np.ndarray, values: Sequence[float]
) -> scipy.sparse.csr_array:
    """Return a matrix over the nodes ``moves`` extended by the oscillators' masses.

    The springs (or dampers) ``values`` join the oscillators' patches to their masses, or to the ground without one.
    """
    if not values:
        return matrix
    shares = oscillator_shares(scene)
    attached = [index for index, oscillator in enumerate(scene.effects.oscillators) if oscillator.mass > 0]
    springs = np.array(values)
    on_plate = scipy.sparse.csr_array(shares.reshape(len(shares), -1)[:, moves])
    plate = matrix + on_plate.T @ scipy.sparse.diags_array(springs) @ on_plate
    if not attached:
        return scipy.sparse.csr_array(plate)
    between = (-scipy.sparse.diags_array(springs) @ on_plate)[attached]
    diagonal = scipy.sparse.diags_array(springs[attached])
    return scipy.sparse.csr_array(scipy.sparse.block_array([[plate, between.T], [between, diagonal]]))


def buckling_factor(scene: Scene, bending: Bending) -> float:
    """Return the factor by which the in-plane forces can grow until the plate buckles; infinite if they never press.

    It is the smallest μ with (K₀ + μG)u = 0, K₀ being the stiffness without in-plane forces and G their part of it.
    """
    moves = np.flatnonzero(bending.moves)
    bare = stiffness_matrix(replace(bending, tension=(0.0, 0.0), spring=np.zeros_like(bending.spring)))
    springs = scipy.sparse.diags_array((mass_matrix(bending) / bending.mass.ravel()) * bending.spring.ravel())
    in_plane = (stiffness_matrix(bending) - bare - springs)[moves][:, moves]
    if abs(in_plane).max() == 0:
        return math.inf
    # The rigid motion of a plate that nothing holds is no buckling: it gets a stiffness of rounding's size.
    held = (bare + springs)[moves][:, moves] + 1e-9 * bare.diagonal().max() * scipy.sparse.eye_array(len(moves))
    if len(moves) <= DENSE:
        largest = scipy.linalg.eigh(-in_plane.toarray(), held.toarray(), eigvals_only=True)[-1]
    else:
        # Shifted by one, so that a relative tolerance suffices where the eigenvalue is next to nothing.
        start = np.random.default_rng(0).normal(size=len(moves))
        largest = scipy.sparse.linalg.eigsh(
            held - in_plane, k=1, M=held.tocsc(), which="LA", v0=start, tol=1e-6, ncv=60, return_eigenvectors=False
        )[0] - 1  # fmt: skip
    return math.inf if largest <= 1e-6 else 1 / float(largest)


def oscillator_shares(scene: Scene) -> np.ndarray:
    """Return (oscillators, ny, nx) shares of the nodes in the mean displacement of each oscillator's patch."""
    x, y = node_positions(scene)
    areas = (oscillator.area for oscillator in scene.effects.oscillators)
    shares = np.array([np.outer(overlap(y, y0, y1), overlap(x, x0, x1)) for x0, x1, y0, y1 in areas])
    return np.array([share / share.sum() for share in shares]).reshape(-1, y.size, x.size)


def mass_matrix(bending: Bending) -> np.ndarray:
    """Return (nodes,) masses [kg] of all nodes, row by row."""
    masses: np.ndarray = (bending.spacing[0] * bending.spacing[1] * bending.weight * bending.mass).ravel()
    return masses


def _in_series(section: Section, compliance_x: np.ndarray, compliance_y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return Cxx, Cxy, Cyy of the module's docstring; compliances may be infinite."""
    stiff_x, coupling, stiff_y = section.bend_xx, section.bend_xy, section.bend_yy
    determinant = stiff_x * stiff_y - coupling**2
    soft_x, soft_y = stiff_y / determinant + compliance_x, stiff_x / determinant + compliance_y
    mixed = -coupling / determinant
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = soft_x * soft_y - mixed**2
        both = np.isfinite(soft_x) & np.isfinite(soft_y)
        bend_xx = np.where(both, soft_y / whole, np.where(np.isfinite(soft_x), 1 / soft_x, 0.0))
        bend_yy = np.where(both, soft_x / whole, np.where(np.isfinite(soft_y), 1 / soft_y, 0.0))
        bend_xy = np.where(both, -mixed / whole, 0.0)
    return bend_xx, bend_xy, bend_yy


def _mirrored_second_difference(count: int) -> scipy.sparse.csr_array:
    low, high = np.ones(count - 1), np.ones(count - 1)
    low[-1] = high[0] = 2
    return scipy.sparse.csr_array(scipy.sparse.diags_array([low, np.full(count, -2.0), high], offsets=[-1, 0, 1]))


def _difference(count: int) -> scipy.sparse.csr_array:
    sides = np.ones(count - 1)
    return scipy.sparse.csr_array(scipy.sparse.diags_array([-sides, sides], offsets=[0, 1], shape=(count - 1, count)))
