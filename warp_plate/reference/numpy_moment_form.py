"""The plate with all effects in plain NumPy float64, stepped by sparse matrices and sharing no step with the kernels.

With M the nodes' masses, K_b the stiffness of bending and K_e that of what pulls back beside it (bed, elastic edges,
tension), both from ``plate.bending``, and C the viscous losses, a step from t_n to t_{n+1} is

    M (v⁺ − v)/Δt = f − K_b (u + τ v) − K_e u − C r + Σ s_o p_o − N L u,   u⁺ = u + Δt v⁺

r is (v⁺ + v)/2 (centred) or v (backward); τ the retardation of the material. Oscillator o hangs on the mean sᵀu of its
patch and pushes the plate with p = k (z − sᵀu) + d (ż − sᵀv), itself with −p/m. Stretching pulls with Berger's
N = B·uᵀLu, L being the matrix of −(∂xx + κ∂yy) times areas, with B and κ of ``plate.bending``. Loads are halved at the
first step (see ``plate.scheme``). Slow; meant for tests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse

from warp_plate.plate.bending import mass_matrix, oscillator_shares, stiffness_matrix
from warp_plate.plate.moving_load import moving_weights
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.weights import patches, region_weights
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class Matrices:
    """A scene's plate as matrices over all nodes, row by row, edges included, in SI units.

    mass: (nodes,) [kg]; bending, other: K_b and K_e above [N/m]; viscous: (nodes,) C [N·s/m]; slopes: L, so that
    uᵀLu = ∫ u_x² + κu_y² dA; retardation: τ [s]; berger: N for uᵀLu = 1 m² [N/m³]; shares: (oscillators, nodes) s_o;
    springs, dampers, hung: (oscillators,) k [N/m], d [N·s/m] and m [kg], which is zero where the spring stands on the
    ground; moves: (nodes,) whether a node does.
    """

    mass: np.ndarray
    bending: scipy.sparse.csr_array
    other: scipy.sparse.csr_array
    viscous: np.ndarray
    slopes: scipy.sparse.csr_array
    retardation: float
    berger: float
    shares: np.ndarray
    springs: np.ndarray
    dampers: np.ndarray
    hung: np.ndarray
    moves: np.ndarray


@dataclass(frozen=True)
class History:
    """What the plates did: displacement (plates, steps + 1, ny, nx) [m] from rest on, hung (plates, steps + 1,
    oscillators) [m] of the masses, energy (plates, regions) kinetic, averaged over the window [J]."""

    displacement: np.ndarray
    hung: np.ndarray
    energy: np.ndarray


def make_matrices(scene: Scene, scheme: Scheme) -> Matrices:
    """The matrices of a scene that goes the general way.

    Raises:
        ValueError: a plain plate, for which :func:`warp_plate.reference.numpy_plate.run_plate` is.
    """
    whole, effects = scheme.bending, scene.effects
    if whole is None:
        raise ValueError("scene: a plain plate has no matrices; take reference.numpy_plate")
    nothing = np.zeros_like(whole.mass)
    unbent = replace(whole, bend_xx=nothing, bend_xy=nothing, bend_yy=nothing, twist=np.zeros_like(whole.twist))
    cell = scheme.spacing[0] * scheme.spacing[1]
    oscillators = effects.oscillators
    return Matrices(
        mass=mass_matrix(whole),
        bending=stiffness_matrix(replace(whole, spring=nothing, tension=(0.0, 0.0))),
        other=stiffness_matrix(unbent),
        viscous=scheme.viscous * cell * whole.weight.ravel(),
        slopes=stiffness_matrix(replace(unbent, spring=nothing, tension=(1.0, whole.stretch_ratio))),
        retardation=effects.material_damping.time if effects.material_damping else 0.0,
        berger=whole.berger if effects.stretching else 0.0,
        shares=oscillator_shares(scene).reshape(len(oscillators), whole.mass.size),
        springs=np.array([one.stiffness for one in oscillators]),
        dampers=np.array([one.damping for one in oscillators]),
        hung=np.array([one.mass for one in oscillators]),
        moves=whole.moves.ravel(),
    )


def run_general(scene: Scene, drives: np.ndarray) -> History:
    """All steps of one plate a drive, from rest; drives: (plates, actuators) complex phasors [N/m²].

    Raises:
        SceneError: as ``plate.scheme.make_scheme``. ValueError: a plain plate.
    """
    scheme = make_scheme(scene)
    m, step, (nx, ny) = make_matrices(scene, scheme), scheme.time_step, scheme.nodes
    cell, plates = scheme.spacing[0] * scheme.spacing[1], len(drives)
    pressed = cell * patches(scene).reshape(-1, nx * ny)
    signals = make_signals(scene, step, scheme.steps, scene.folder)
    forces = np.einsum("nt,ptk->npk", signals.wave, signals.coefficients(drives))
    travel = np.zeros((scheme.steps, 1))
    if scene.effects.moving_load is not None:
        wave, along_x, along_y = moving_weights(scene, step, scheme.steps)
        travel = cell * np.einsum("n,nj,ni->nji", wave, along_y, along_x).reshape(scheme.steps, -1)
    # Nodes by row, plates by column.
    u, v = np.zeros((nx * ny, plates)), np.zeros((nx * ny, plates))
    z, pace = np.zeros((len(m.hung), plates)), np.zeros((len(m.hung), plates))
    history, hung = np.zeros((scheme.steps + 1, nx * ny, plates)), np.zeros((scheme.steps + 1, len(m.hung), plates))
    for n in range(scheme.steps):
        force = pressed.T @ forces[n].T + travel[n][:, None] - m.bending @ (u + m.retardation * v) - m.other @ u
        push = m.springs[:, None] * (z - m.shares @ u) + m.dampers[:, None] * (pace - m.shares @ v)
        force += m.shares.T @ push - m.berger * np.einsum("kp,kp->p", u, m.slopes @ u) * (m.slopes @ u)
        v = next_rate(m, v, force, step, scheme.backward)
        u = u + step * v
        pace = pace - step * inverse(m.hung)[:, None] * push
        z = z + step * pace
        history[n + 1], hung[n + 1] = u, z
    first, last = scheme.window
    squares = (np.diff(history[first : last + 1], axis=0) ** 2).mean(axis=0) / step**2
    assert scheme.bending is not None
    weights = 0.5 * cell * (region_weights(scene) * scheme.bending.mass).reshape(-1, nx * ny)
    displacement = np.moveaxis(history, 2, 0).reshape(plates, scheme.steps + 1, ny, nx)
    return History(displacement, np.moveaxis(hung, 2, 0), (weights @ squares).T)


def next_rate(m: Matrices, rate: np.ndarray, force: np.ndarray, step: float, backward: bool) -> np.ndarray:
    """(nodes, plates) v half a step later [m/s]; force (nodes, plates) [N]: of all but the viscous losses."""
    mass, half = m.mass[:, None], step / 2 * m.viscous[:, None]
    if backward:
        new = (mass * rate + step * force - 2 * half * rate) / mass
    else:
        new = ((mass - half) * rate + step * force) / (mass + half)
    return np.where(m.moves[:, None], new, 0.0)


def inverse(masses: np.ndarray) -> np.ndarray:
    """1/m, and zero for what stands on the ground."""
    return np.divide(1, masses, out=np.zeros(len(masses)), where=masses > 0)
