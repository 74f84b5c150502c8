"""The largest stable time step of a scene's grid and effects, and its cause.

With M the masses, K the stiffness and C the losses that act on the last half-step's rates (damping backward in time,
the material's, of attached dampers), a step from u and v to v⁺ and u + Δt v⁺ is

    (M − ½Δt C)(v⁺ − v)/Δt + ½(C + c)(v⁺ + v) + K u = 0,

c being damping centred in time. With ū half-way between two levels of u, ½vᵀ(M − ½Δt C − ¼Δt²K)v + ½ūᵀKū never grows,
and it bounds u and v as long as its first matrix is positive. Past that the pencil of the step, which is that matrix at
z = −1 and positive at −∞, is singular at some z < −1. So the limit is exactly where the largest eigenvalue of

    A(Δt) = M⁻¹ (Δt²K + 2Δt C)

is 4: without losses Δt = 2/√λ. c does not count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import scipy

from warp_plate.effects.effect import DISPLACEMENT, Term, losses
from warp_plate.plate.bending import (
    Bending,
    buckling_factor,
    make_bending,
    mass_matrix,
    moving_masses,
    stiffness_parts,
    with_attachments,
)
from warp_plate.plate.operator import LARGEST, biharmonic, plain_taps
from warp_plate.plate.signals import waves_apart
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# With so many nodes a side, the end of a periodic plate's spectrum is at most 0.8 % above that of a plate with edges.
FORMULA_NODES = 24
# Relative tolerances of the largest eigenvalue by Lanczos' method, up to FEW unknowns and beyond; the limit keeps
# MARGIN below what it finds. At 1e-3 it was seen to stop at the second largest of 91, 0.3 % below.
TOLERANCE, FEW, TOLERANCE_OF_MORE = 1e-6, 4000, 1e-4
MARGIN = 3e-3
# Up to DENSE unknowns all eigenvalues are computed, and the limit keeps off by rounding alone.
DENSE, DENSE_MARGIN = 60, 1e-9
# Newton's method for the time step ends when the largest eigenvalue is 4 to this part; it takes two or three steps.
CLOSE, MOST_SOLVES = 1e-4, 20

Matrices: TypeAlias = "dict[str, scipy.sparse.sparray]"


@dataclass(frozen=True)
class StabilityLimit:
    """The stability limit and the fastest motion, which sets it."""

    time_step: float  # Largest stable time step [s], at most 1 % below the true one and never above
    shares: Mapping[str, float]  # Share of each stiffness and loss in the fastest motion; they add up to 1
    frequency: float  # Frequency of the fastest motion without losses and steps in time [Hz]
    formula: bool  # True if the limit comes from a formula, False if from the scene's own matrices
    place: tuple[float, float] | None = None  # (x, y) [m] where the fastest motion is largest; None by formula


def find_limit(scene: Scene, moment_form: bool = False) -> tuple[StabilityLimit, Bending | None]:
    """Return the limit of a scene with a grid, and the plate in moment form if it needs or ``moment_form`` asks for it;
    SceneError: the plate buckles, or fourth order is asked of a plate in moment form."""
    if not (moment_form or needs_moment_form(scene)):
        return _limit_of_plain_plate(scene), None
    if scene.grid.order == 4:
        raise SceneError(
            "grid.order = 4: knows an isotropic plate, the same everywhere, with clamped and supported edges, viscous "
            "damping and actuators of one frequency; write 2 for other edges, effects and drives"
        )
    bending = make_bending(scene)
    x, y = bending.membrane
    # Compression by itself is quickly checked and mostly enough, because a pull only helps.
    pressed = replace(bending, membrane=(min(x, 0.0), min(y, 0.0)))
    if min(x, y) < 0 and buckling_factor(pressed) <= 1 and (factor := buckling_factor(bending)) <= 1:
        raise buckled(bending.labels["membrane"], bending.membrane, factor)
    if _homogeneous(bending) and not (bending.attachments or bending.coils) and min(scene.grid.nodes) >= FORMULA_NODES:
        return _by_formula(*_largest_of_homogeneous(scene, bending)), bending
    sprung = replace(
        bending,
        attachments=[*bending.attachments, *(coil.springs for coil in bending.coils)],
        shares=bending.patch_shares,
    )
    stiff, losses = _named_matrices(scene, sprung)
    return _by_matrices(scene, stiff, losses, _root_of_inverse_mass(sprung), np.flatnonzero(bending.moves)), bending


def viscous_damping(scene: Scene) -> tuple[float, bool]:
    """Return all viscous damping [N·s/m³], and whether it is taken backward in time."""
    return losses(scene.terms).viscous, scene.effects.backward


def needs_moment_form(scene: Scene) -> bool:
    """Return whether a scene is more than a uniform plate with viscous damping under one carrier."""
    beside = scene.effects.stretches or scene.effects.travelling or scene.drive.electrostatic
    beyond = bool(beside) or waves_apart(scene) > 1 or not all(_of_plain_plate(term) for term in scene.terms)
    return beyond or scene.coils_in_time or not scene.uniform


def _of_plain_plate(term: Term) -> bool:
    """Return whether a term is viscous damping of the whole plate, or damping that is not stepped."""
    viscous = term.role == "damping" and term.distributed and term.factors == DISPLACEMENT
    return viscous or term.role == "hysteretic" or term.multiple_of == "modes"


def _limit_of_plain_plate(scene: Scene) -> StabilityLimit:
    """Return the limit of a plain plate.

    The largest eigenvalue of the discrete κ²∇⁴ is at most Λ = κ²(s/hx² + s/hy²)², s = 4 for second order and 16/3 for
    fourth: there the spectrum of a periodic plate ends, and edges only lower it (of second order they are even and odd
    mirror images; of fourth see tests/plate/test_operator.py). Undamped or with centred damping the scheme is stable
    for Λ Δt² ≤ 4 (κΔt/h² ≤ 1/4 or 3/16 on square cells); with backward damping for Λ Δt² ≤ 4 − 2cΔt/ρH.
    """
    plate, (nx, ny), spacing, order = scene.plate, scene.grid.nodes, scene.spacing, scene.grid.order
    surface_density = plate.density * plate.thickness
    kappa_squared = plate.rigidity / surface_density
    viscous, backward = viscous_damping(scene)
    loss = viscous / surface_density if backward else 0.0
    if min(nx, ny) >= FORMULA_NODES:
        largest = kappa_squared * (LARGEST[order] / spacing[0] ** 2 + LARGEST[order] / spacing[1] ** 2) ** 2
        return _by_formula({"bending": largest}, {"backward damping": loss})
    matrix = biharmonic(*plain_taps(scene.edges, (nx, ny), order), spacing, order)
    inner = np.add.outer(nx * np.arange(1, ny - 1), np.arange(1, nx - 1)).ravel()
    losses = {"backward damping": loss * scipy.sparse.eye_array(matrix.shape[0])}
    one = scipy.sparse.diags_array(np.ones(matrix.shape[0]))
    return _by_matrices(scene, {"bending": kappa_squared * matrix}, losses, one, inner)


def _root(stiff: float, loss: float) -> float:
    """Return the positive root of Λ Δt² + 2 b Δt − 4 = 0, written so that it does not cancel for large b."""
    return 4 / (loss + math.sqrt(loss**2 + 4 * stiff))


def _by_formula(stiff: Mapping[str, float], losses: Mapping[str, float]) -> StabilityLimit:
    """Return the limit from the largest eigenvalue of each part [1/s², 1/s], all of one motion."""
    step = _root(sum(stiff.values()), sum(losses.values()))
    shares = {name: value * step**2 / 4 for name, value in stiff.items()}
    shares |= {name: value * step / 2 for name, value in losses.items()}
    frequency = math.sqrt(sum(stiff.values())) / (2 * math.pi)
    return StabilityLimit(step, {name: share for name, share in shares.items() if share}, frequency, True)


def _by_matrices(
    scene: Scene, stiff: Matrices, losses: Matrices, root: scipy.sparse.sparray, nodes: np.ndarray
) -> StabilityLimit:
    """Return the limit from parts of K and C, whose first unknowns are these nodes of the grid, counted row by row, and
    a root R of M⁻¹ = RRᵀ.

    The largest eigenvalue of A(Δt) rises with Δt as a maximum of quadratics, so that the root of the quadratic of its
    eigenvector is too long a step and the next try closer (Newton's method).
    """
    stiffness = scipy.sparse.csr_array(root.T @ sum(stiff.values()) @ root)
    loss = root.T @ sum(losses.values(), start=0 * stiffness) @ root
    step = 1 / math.sqrt(abs(stiffness).sum(axis=1).max())
    for _ in range(MOST_SOLVES):
        largest, vector = _largest_eigenpair(step**2 * stiffness + 2 * step * loss)
        if abs(largest / 4 - 1) < CLOSE:
            break
        step = _root(float(vector @ (stiffness @ vector)), float(vector @ (loss @ vector)))
    shape = root @ vector
    shares = {name: step**2 * float(shape @ (part @ shape)) / largest for name, part in stiff.items()}
    shares |= {name: 2 * step * float(shape @ (part @ shape)) / largest for name, part in losses.items()}
    node = nodes[np.argmax(np.abs(shape[: len(nodes)]))]
    (nx, ny), size = scene.grid.nodes, scene.plate.size
    # A shorter step lowers the eigenvalue by its own part at least, without losses by twice that.
    over = max(1.0, largest / 4) * (1 + (DENSE_MARGIN if root.shape[0] <= DENSE else MARGIN))
    return StabilityLimit(
        time_step=step / (over if loss.nnz else math.sqrt(over)),
        shares={name: share for name, share in shares.items() if abs(share) > 1e-6},
        frequency=math.sqrt(float(vector @ (stiffness @ vector))) / (2 * math.pi),
        formula=False,
        place=(node % nx * size[0] / (nx - 1), node // nx * size[1] / (ny - 1)),
    )


def _largest_eigenpair(matrix: scipy.sparse.csr_array) -> tuple[float, np.ndarray]:
    """Return the largest eigenvalue of a symmetric matrix and its vector."""
    if matrix.shape[0] <= DENSE:
        values, vectors = scipy.linalg.eigh(matrix.toarray())
        return float(values[-1]), vectors[:, -1]
    # Started from a vector without symmetry: a symmetric one may have no part of the mode looked for.
    start = np.random.default_rng(0).normal(size=matrix.shape[0])
    tolerance = TOLERANCE if matrix.shape[0] <= FEW else TOLERANCE_OF_MORE
    values, vectors = scipy.sparse.linalg.eigsh(matrix, k=1, which="LA", tol=tolerance, v0=start)
    return float(values[0]), vectors[:, 0]


def _named_matrices(scene: Scene, bending: Bending) -> tuple[Matrices, Matrices]:
    """Return the parts of K [N/m] and of C [N·s/m] by name."""
    moves, attached = np.flatnonzero(bending.moves), bending.attachments
    nothing = scipy.sparse.csr_array((len(moves), len(moves)))

    def of_plate(matrix: scipy.sparse.sparray) -> scipy.sparse.csr_array:
        among_moving = scipy.sparse.csr_array(matrix)[moves][:, moves]
        return with_attachments(bending, among_moving, [0.0] * len(attached))

    stiff = {name: of_plate(part) for name, part in stiffness_parts(bending).items()}
    losses = {}
    viscous, backward = viscous_damping(scene)
    if backward and viscous:
        losses["backward damping"] = of_plate(
            scipy.sparse.diags_array(viscous * mass_matrix(bending) / bending.mass.ravel())
        )
    if bending.retardation:
        losses[bending.labels["retardation"]] = bending.retardation * stiff["bending"]
    for label in dict.fromkeys(attachment.label for attachment in attached):
        of_label = [attachment if attachment.label == label else None for attachment in attached]
        springs = [attachment.stiffness if attachment else 0.0 for attachment in of_label]
        dampers = [attachment.damping if attachment else 0.0 for attachment in of_label]
        stiff[f"{label}s"] = with_attachments(bending, nothing, springs)
        if label == "coil":
            stiff["coils"] = stiff["coils"] + scipy.sparse.diags_array(_springs_of_magnets(bending))
        if any(dampers):
            losses[f"dampers of {label}s"] = with_attachments(bending, nothing, dampers)
    return stiff, losses


def _springs_of_magnets(bending: Bending) -> np.ndarray:
    """Return (unknowns,) springs [N/m] between the attached masses and a frame."""
    magnets = [coil.coil.magnet_stiffness for coil in bending.coils if coil.coil.magnet_mass > 0]
    springs = np.zeros(moving_masses(bending).size)
    springs[springs.size - len(magnets) :] = magnets
    return springs


def _root_of_inverse_mass(bending: Bending) -> scipy.sparse.sparray:
    """Return a root R of M⁻¹ = RRᵀ with the moving masses m of coils, whose patches are apart: with the masses M₀ of
    nodes and a = M₀^(−½) s of shares s, R = M₀^(−½) (1 + m aaᵀ)^(−½) = M₀^(−½) (1 + ((1 + m aᵀa)^(−½) − 1) aaᵀ/aᵀa)."""
    masses, moves = moving_masses(bending), bending.moves.ravel()
    root = scipy.sparse.diags_array(1 / np.sqrt(masses))
    for coil in bending.coils:
        share = np.pad(coil.share.ravel()[moves], (0, masses.size - moves.sum())) / np.sqrt(masses)
        if coil.coil.moving_mass > 0 and (square := float(share @ share)) > 0:
            row = scipy.sparse.csr_array(share[None])
            factor = (1 / math.sqrt(1 + coil.coil.moving_mass * square) - 1) / square
            root = root + factor * (root @ row.T) @ row
    return root


def _homogeneous(bending: Bending) -> bool:
    """Return whether all nodes but those on edges are alike, and springs are the same everywhere."""
    inner = (slice(1, -1), slice(1, -1))
    fields = (bending.bend_xx[inner], bending.bend_xy[inner], bending.bend_yy[inner], bending.twist, bending.mass)
    return all(np.ptp(field) <= 1e-12 * np.abs(field).max() for field in (*fields, bending.spring))


def _largest_of_homogeneous(scene: Scene, bending: Bending) -> tuple[dict[str, float], dict[str, float]]:
    """Return the ends of the periodic plate's spectrum [1/s²], and the losses of that motion [1/s], by name."""
    (hx, hy), (pull_x, pull_y), mass = bending.spacing, bending.membrane, float(bending.mass[0, 0])
    middle = bending.mass.shape[0] // 2, bending.mass.shape[1] // 2
    mixed = bending.bend_xy[middle] + bending.twist[middle] / 2  # D1 + 2Dxy
    along_x, along_y = bending.bend_xx[middle] / hx**4, bending.bend_yy[middle] / hy**4
    stiff = {
        "bending": float(16 * max(along_x, along_y, along_x + along_y + 2 * mixed / (hx * hy) ** 2)) / mass,
        bending.labels.get("membrane", "membrane"): 4 * (max(pull_x, 0) / hx**2 + max(pull_y, 0) / hy**2) / mass,
    }
    for label, springs in bending.springs.items():
        stiff[label] = stiff.get(label, 0.0) + float(springs[middle]) / mass
    viscous, backward = viscous_damping(scene)
    return stiff, {
        "backward damping": viscous / mass if backward else 0.0,
        bending.labels.get("retardation", "retardation"): bending.retardation * stiff["bending"],
    }


def buckled(label: str, membrane: tuple[float, float], factor: float) -> SceneError:
    """Return the error for a plate that in-plane forces [N/m] buckle already when multiplied by ``factor``."""
    x, y = membrane
    return SceneError(
        f"effects.{label} = {{x = {x:g}, y = {y:g}}}: the plate buckles; the critical load is x = {factor * x:.4g}, "
        f"y = {factor * y:.4g} N/m, {factor:.3g} of this one"
    )
