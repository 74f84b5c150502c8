"""The plate as moments: rigidity, mass and springs of every node, with a scene's edges, layers and effects in them.

Bending stores ½∫ Dx u_xx² + 2 D1 u_xx u_yy + Dy u_yy² + 4 Dxy u_xy² dA; on the grid, curvatures and moments belong to
nodes, twists to cells, and a node on an edge has half a cell (a quarter at a corner). There the curvature across the
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
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from warp_plate.plate.section import make_section
from warp_plate.plate.weights import EDGE_LINES, moving_nodes, overlap
from warp_plate.scene.model import ElasticEdge, Scene

# Up to so many unknowns all buckling loads are worked out at once.
DENSE = 400


@dataclass(frozen=True)
class Bending:
    """Fields over the nodes, (ny, nx), in SI units.

    spacing: (hx, hy) [m]; bend_xx, bend_xy, bend_yy: C above [N·m]; twist: (ny − 1, nx − 1) 4Dxy of the cells [N·m];
    mass: per area [kg/m²]; weight: share of each node's cell on the plate, 1, ½ or ¼; spring: per area, of the bed and
    of elastic edges [N/m³]; moves: whether the node does; tension: (x, y) [N/m]; stretch: along x and y, what resists
    stretching of the whole plate [N/m] (see ``section``).
    """

    spacing: tuple[float, float]
    bend_xx: np.ndarray
    bend_xy: np.ndarray
    bend_yy: np.ndarray
    twist: np.ndarray
    mass: np.ndarray
    weight: np.ndarray
    spring: np.ndarray
    moves: np.ndarray
    tension: tuple[float, float]
    stretch: tuple[float, float]

    @property
    def stretch_ratio(self) -> float:
        """κ of ``section``: the pull of stretching along y in units of that along x; 1 where the plate is isotropic."""
        return math.sqrt(self.stretch[1] / self.stretch[0])

    @property
    def berger(self) -> float:
        """Berger's tension along x for ∫ u_x² + κu_y² dA = 1 m² [N/m³]; for an isotropic plate 6D/(H² area)."""
        area = self.spacing[0] * self.spacing[1] * float(self.weight.sum())
        return self.stretch[0] / (2 * area)


def make_bending(scene: Scene) -> Bending:
    """The fields of a scene on its grid."""
    effects, (width, height), (nx, ny) = scene.effects, scene.plate.size, scene.grid.nodes
    hx, hy = width / (nx - 1), height / (ny - 1)
    section = make_section(scene)
    yielding_x, yielding_y = np.zeros((ny, nx)), np.zeros((ny, nx))
    spring = np.full((ny, nx), effects.foundation.stiffness if effects.foundation else 0.0)
    for side, line in EDGE_LINES.items():
        edge = getattr(scene.edges, side)
        across, yielding = (hx, yielding_x) if side in ("left", "right") else (hy, yielding_y)
        if isinstance(edge, ElasticEdge):
            yielding[line] = 2 / (edge.rotation * across) if edge.rotation > 0 else math.inf
            spring[line] += 2 * edge.translation / across
        else:
            yielding[line] = 0 if edge == "clamped" else math.inf
    bend_xx, bend_xy, bend_yy = _in_series(section.bend_xx, section.bend_xy, section.bend_yy, yielding_x, yielding_y)
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
    """(nodes, nodes) symmetric matrix K [N/m] of all nodes, row by row, edges included: ½uᵀKu is the energy stored."""
    (hx, hy), (ny, nx) = bending.spacing, bending.mass.shape
    across, along = (_mirrored_second_difference(count) for count in (nx, ny))
    curve_x = scipy.sparse.kron(scipy.sparse.eye_array(ny), across) / hx**2
    curve_y = scipy.sparse.kron(along, scipy.sparse.eye_array(nx)) / hy**2
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
    """Stiffness [N/m] and masses [kg] of what moves: moving nodes row by row, then what oscillators hang."""
    moves = np.flatnonzero(bending.moves)
    stiffness = stiffness_matrix(bending)[moves][:, moves]
    whole = with_oscillators(scene, stiffness, moves, [one.stiffness for one in scene.effects.oscillators])
    hung = [one.mass for one in scene.effects.oscillators if one.mass > 0]
    return whole, np.concatenate([mass_matrix(bending)[moves], hung])


def with_oscillators(
    scene: Scene, matrix: scipy.sparse.csr_array, moves: np.ndarray, values: Sequence[float]
) -> scipy.sparse.csr_array:
    """A matrix over the nodes ``moves`` alone, then over hung masses too, with the springs (or dampers) ``values``
    between the oscillators' patches and their masses, or the ground where there are none."""
    if not values:
        return matrix
    shares = oscillator_shares(scene)
    hung = [index for index, one in enumerate(scene.effects.oscillators) if one.mass > 0]
    springs = np.array(values)
    on_plate = scipy.sparse.csr_array(shares.reshape(len(shares), -1)[:, moves])
    plate = matrix + on_plate.T @ scipy.sparse.diags_array(springs) @ on_plate
    own = scipy.sparse.diags_array(springs[hung])
    between = -scipy.sparse.diags_array(springs) @ on_plate
    whole = scipy.sparse.block_array([[plate, between[hung].T], [between[hung], own]]) if hung else plate
    return scipy.sparse.csr_array(whole)


def buckling_factor(scene: Scene, bending: Bending) -> float:
    """By how much the in-plane forces can grow until the plate buckles; infinite where they never press on it.

    The smallest μ with (K₀ + μG)u = 0, K₀ being the stiffness without in-plane forces and G their part of it.
    """
    moves = np.flatnonzero(bending.moves)
    bare = stiffness_matrix(replace(bending, tension=(0.0, 0.0), spring=np.zeros_like(bending.spring)))
    springs = scipy.sparse.diags_array((mass_matrix(bending) / bending.mass.ravel()) * bending.spring.ravel())
    pull = (stiffness_matrix(bending) - bare - springs)[moves][:, moves]
    # Rigid motion of a plate that nothing holds is no buckling: it gets a stiffness of rounding's size.
    if abs(pull).max() == 0:  # below rounding
        return math.inf
    held = (bare + springs)[moves][:, moves] + 1e-9 * bare.diagonal().max() * scipy.sparse.eye_array(len(moves))
    if len(moves) <= DENSE:
        largest = scipy.linalg.eigh(-pull.toarray(), held.toarray(), eigvals_only=True)[-1]
    else:
        # One more than what is looked for, so that a precision relative to it is enough where it is next to nothing.
        start = np.random.default_rng(0).normal(size=len(moves))
        largest = scipy.sparse.linalg.eigsh(
            held - pull, k=1, M=held.tocsc(), which="LA", v0=start, tol=1e-6, ncv=60, return_eigenvectors=False
        )[0] - 1  # fmt: skip
    return math.inf if largest <= 1e-6 else 1 / float(largest)


def oscillator_shares(scene: Scene) -> np.ndarray:
    """(oscillators, ny, nx) share of each node in the mean displacement of each oscillator's patch; sums of one."""
    (nx, ny), (width, height) = scene.grid.nodes, scene.plate.size
    x, y = np.linspace(0, width, nx), np.linspace(0, height, ny)
    shares = np.zeros((len(scene.effects.oscillators), ny, nx))
    for share, oscillator in zip(shares, scene.effects.oscillators, strict=True):
        x0, x1, y0, y1 = oscillator.area
        share[:] = np.outer(overlap(y, y0, y1), overlap(x, x0, x1))
        share /= share.sum()
    return shares


def mass_matrix(bending: Bending) -> np.ndarray:
    """(nodes,) masses [kg] of the nodes, row by row."""
    masses: np.ndarray = (bending.spacing[0] * bending.spacing[1] * bending.weight * bending.mass).ravel()
    return masses


def _in_series(
    stiff_x: np.ndarray, coupling: np.ndarray, stiff_y: np.ndarray, yielding_x: np.ndarray, yielding_y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cxx, Cxy, Cyy of the docstring; a yielding (compliance) may be infinite."""
    determinant = stiff_x * stiff_y - coupling**2
    soft_x, soft_y = stiff_y / determinant + yielding_x, stiff_x / determinant + yielding_y
    mixed = -coupling / determinant
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = soft_x * soft_y - mixed**2
        both = np.isfinite(soft_x) & np.isfinite(soft_y)
        bend_xx = np.where(both, soft_y / whole, np.where(np.isfinite(soft_x), 1 / soft_x, 0.0))
        bend_yy = np.where(both, soft_x / whole, np.where(np.isfinite(soft_y), 1 / soft_y, 0.0))
        bend_xy = np.where(both, -mixed / whole, 0.0)
    return bend_xx, bend_xy, bend_yy


def _mirrored_second_difference(count: int) -> scipy.sparse.csr_array:
    matrix = scipy.sparse.diags_array(
        [np.ones(count - 1), np.full(count, -2.0), np.ones(count - 1)], offsets=[-1, 0, 1]
    ).tolil()
    matrix[0, 1] = matrix[count - 1, count - 2] = 2
    return scipy.sparse.csr_array(matrix)


def _difference(count: int) -> scipy.sparse.csr_array:
    return scipy.sparse.csr_array(
        scipy.sparse.diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1], shape=(count - 1, count))
    )
