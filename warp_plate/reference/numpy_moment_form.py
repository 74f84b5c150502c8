"""The plate with all effects in plain NumPy float64, stepped by sparse matrices; it shares no step with the kernels.

With M the nodes' masses, K_b the stiffness of bending and K_e the rest of the stiffness (springs, in-plane forces),
both from ``plate.bending``, and C the viscous losses, a step from t_n to t_{n+1} is

    M (v⁺ − v)/Δt = f − K_b (u + τ v) − K_e u − C r + Σ s_o p_o − N L u,   u⁺ = u + Δt v⁺

r is (v⁺ + v)/2 (centred) or v (backward); τ the retardation of the material. Mass o is attached to the mean sᵀu
of its patch; it pushes the plate with p = k (z − sᵀu) + d (ż − sᵀv) and itself with −p/m. A plate that stretches
adds Berger's force N = B·uᵀLu, L being the matrix of −(∂xx + κ∂yy) times areas, with B and κ of ``plate.bending``.
The load of the first step is halved (see ``plate.signals``). Slow; for tests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from warp_plate.plate.bending import mass_matrix, stiffness_matrix, stiffness_parts
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.travelling import moving_weights
from warp_plate.plate.weights import patches, region_weights
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class Matrices:
    """A scene's plate as matrices over all nodes, row by row, edges included, in SI units."""

    mass: np.ndarray  # (nodes,) M [kg]
    bending: scipy.sparse.csr_array  # K_b [N/m]
    other: scipy.sparse.csr_array  # K_e [N/m]
    viscous: np.ndarray  # (nodes,) C [N·s/m]
    slopes: scipy.sparse.csr_array  # L, so that uᵀLu = ∫ u_x² + κu_y² dA
    retardation: float  # τ [s]
    berger: float  # N for uᵀLu = 1 m² [N/m³]
    shares: np.ndarray  # (attachments, nodes) s_o
    springs: np.ndarray  # (attachments,) k [N/m]
    dampers: np.ndarray  # (attachments,) d [N·s/m]
    attached: np.ndarray  # (attachments,) m [kg]; zero for a spring on the ground
    moves: np.ndarray  # (nodes,) true for nodes that move


@dataclass(frozen=True)
class History:
    """Motion of plates."""

    displacement: np.ndarray  # (plates, steps + 1, ny, nx) [m], from rest on
    attached: np.ndarray  # (plates, steps + 1, attachments) displacement of the attached masses [m]
    energy: np.ndarray  # (plates, regions) kinetic energy averaged over the window [J]


def make_matrices(scene: Scene, scheme: Scheme) -> Matrices:
    """Return the matrices of a scene that needs the moment form, and is no plain plate."""
    fields = scheme.bending
    assert fields is not None
    bending, *others = stiffness_parts(fields).values()
    slopes = replace(fields, springs={}, membrane=(1.0, fields.stretch_ratio))
    cell = scheme.spacing[0] * scheme.spacing[1]
    attached = fields.attachments
    return Matrices(
        mass=mass_matrix(fields),
        bending=bending,
        other=scipy.sparse.csr_array(sum(others, start=0 * bending)),
        viscous=scheme.viscous * cell * fields.weight.ravel(),
        slopes=scipy.sparse.csr_array(stiffness_matrix(slopes) - bending),
        retardation=fields.retardation,
        berger=fields.berger if scene.effects.stretches else 0.0,
        shares=fields.shares.reshape(len(attached), fields.mass.size),
        springs=np.array([attachment.stiffness for attachment in attached]),
        dampers=np.array([attachment.damping for attachment in attached]),
        attached=np.array([attachment.mass for attachment in attached]),
        moves=fields.moves.ravel(),
    )


def run_moment_form(scene: Scene, drives: np.ndarray) -> History:
    """Step one plate of a scene that needs the moment form for each row of phasors (plates, actuators), from rest."""
    scheme = make_scheme(scene)
    m, step, (nx, ny) = make_matrices(scene, scheme), scheme.time_step, scheme.nodes
    cell, plates = scheme.spacing[0] * scheme.spacing[1], len(drives)
    pressed = cell * patches(scene).reshape(-1, nx * ny)
    signals = make_signals(scene, step, scheme.steps, scene.folder)
    forces = np.einsum("nt,ptk->npk", signals.wave, signals.coefficients(drives))
    travel = np.zeros((scheme.steps, 1))
    if scene.effects.travelling is not None:
        wave, along_x, along_y = moving_weights(scene, step, scheme.steps)
        travel = cell * np.einsum("n,nj,ni->nji", wave, along_y, along_x).reshape(scheme.steps, -1)
    # Nodes are rows, plates are columns.
    u, v = np.zeros((nx * ny, plates)), np.zeros((nx * ny, plates))
    z, speed = np.zeros((len(m.attached), plates)), np.zeros((len(m.attached), plates))
    history, masses = np.zeros((scheme.steps + 1, *u.shape)), np.zeros((scheme.steps + 1, *z.shape))
    for n in range(scheme.steps):
        force = pressed.T @ forces[n].T + travel[n][:, None] - m.bending @ (u + m.retardation * v) - m.other @ u
        push = m.springs[:, None] * (z - m.shares @ u) + m.dampers[:, None] * (speed - m.shares @ v)
        force += m.shares.T @ push - m.berger * np.einsum("kp,kp->p", u, m.slopes @ u) * (m.slopes @ u)
        v = next_rate(m, v, force, step, scheme.backward)
        u = u + step * v
        speed = speed - step * inverse(m.attached)[:, None] * push
        z = z + step * speed
        history[n + 1], masses[n + 1] = u, z
    first, last = scheme.window
    squares = (np.diff(history[first : last + 1], axis=0) ** 2).mean(axis=0) / step**2
    assert scheme.bending is not None
    weights = 0.5 * cell * (region_weights(scene) * scheme.bending.mass).reshape(-1, nx * ny)
    displacement = np.moveaxis(history, 2, 0).reshape(plates, scheme.steps + 1, ny, nx)
    return History(displacement, np.moveaxis(masses, 2, 0), (weights @ squares).T)


def next_rate(m: Matrices, rate: np.ndarray, force: np.ndarray, step: float, backward: bool) -> np.ndarray:
    """Return (nodes, plates) v a step later [m/s]; force (nodes, plates) [N] is all but the viscous loss."""
    mass, half = m.mass[:, None], step / 2 * m.viscous[:, None]
    if backward:
        new = (mass * rate + step * force - 2 * half * rate) / mass
    else:
        new = ((mass - half) * rate + step * force) / (mass + half)
    return np.where(m.moves[:, None], new, 0.0)


def inverse(masses: np.ndarray) -> np.ndarray:
    """Return 1/m, and zero for springs on the ground."""
    return np.divide(1, masses, out=np.zeros(len(masses)), where=masses > 0)
