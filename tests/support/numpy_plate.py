"""Plates in plain NumPy float64, written from the equations; they share no step with the kernels. Slow; for tests.

The plain plate steps the paper's two-step scheme instead of the velocity form, in physical units. Second order is the
13-point stencil in one piece with ghost nodes, fourth order matrices of one-dimensional differences.

The plate with all effects is stepped by sparse matrices. With M the nodes' masses, K_b the stiffness of bending and K_e
the rest of the stiffness (springs, in-plane forces), both from ``plate.bending``, and C the viscous losses, a step from
t_n to t_{n+1} is

    M (v⁺ − v)/Δt = f − K_b (u + τ v) − K_e u − C r + Σ s_o p_o − N L u,   u⁺ = u + Δt v⁺

r is (v⁺ + v)/2 (centred) or v (backward); τ the retardation of the material. Mass o is attached to the mean sᵀu
of its patch; it pushes the plate with p = k (z − sᵀu) + d (ż − sᵀv) and itself with −p/m. A plate that stretches
adds Berger's force N = B·uᵀLu, L being the matrix of −(∂xx + κ∂yy) times areas, with B and κ of ``plate.bending``.
The load of the first step is halved (see ``plate.signals``).

With coils, v⁺, the magnets' rates and the currents are the solution of one dense system by the trapezoidal rule for all
that depends on rates and currents: with w = (sᵀv⁺ + sᵀv − ż⁺ − ż)/2 and j = (i⁺ + i)/2,

    M (v⁺ − v)/Δt = F(n) + Σ s p,   p = Bl j − k (sᵀu − z) − r w − m sᵀ(v⁺ − v)/Δt,
    Mm (ż⁺ − ż)/Δt = −Bl j + k (sᵀu − z) + r w − κ z − ρ (ż⁺ + ż)/2,   L (i⁺ − i)/Δt + R j + Bl w = V.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from warp_plate.plate.bending import mass_matrix, stiffness_matrix, stiffness_parts
from warp_plate.plate.operator import clamped_rows
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.travelling import moving_weights
from warp_plate.plate.weights import patches, region_weights
from warp_plate.scene.model import Scene


def biharmonic(u: np.ndarray, spacing: tuple[float, float]) -> np.ndarray:
    """Return ∇⁴u (..., ny − 4, nx − 4) [u/m⁴] of u (..., ny, nx), by the 13-point stencil.

    u_xxxx takes 1, −4, 6, −4, 1: the paper, section II.B, prints u_ij twice.
    """
    hx, hy = spacing

    def shifted(j: int, i: int) -> np.ndarray:
        rows, columns = u.shape[-2], u.shape[-1]
        return u[..., 2 + j : rows - 2 + j, 2 + i : columns - 2 + i]

    along_x = shifted(0, -2) - 4 * shifted(0, -1) + 6 * shifted(0, 0) - 4 * shifted(0, 1) + shifted(0, 2)
    along_y = shifted(-2, 0) - 4 * shifted(-1, 0) + 6 * shifted(0, 0) - 4 * shifted(1, 0) + shifted(2, 0)
    mixed = (
        (shifted(-1, -1) - 2 * shifted(-1, 0) + shifted(-1, 1))
        - 2 * (shifted(0, -1) - 2 * shifted(0, 0) + shifted(0, 1))
        + (shifted(1, -1) - 2 * shifted(1, 0) + shifted(1, 1))
    )
    return along_x / hx**4 + 2 * mixed / (hx * hy) ** 2 + along_y / hy**4


def with_ghosts(u: np.ndarray, edges: tuple[str, str, str, str]) -> np.ndarray:
    """Return u (..., ny, nx) with one ghost node beyond each edge, left, bottom, right, top: clamped, ∂u/∂n = 0, it
    equals the first inner node; supported, ∂²u/∂n² = 0 with u = 0, its negative."""
    sign = {"clamped": 1.0, "supported": -1.0}
    left, bottom, right, top = (sign[edge] for edge in edges)
    ghosted = np.zeros((*u.shape[:-2], u.shape[-2] + 2, u.shape[-1] + 2))
    ghosted[..., 1:-1, 1:-1] = u
    ghosted[..., :, 0] = left * ghosted[..., :, 2]
    ghosted[..., :, -1] = right * ghosted[..., :, -3]
    ghosted[..., 0, :] = bottom * ghosted[..., 2, :]
    ghosted[..., -1, :] = top * ghosted[..., -3, :]
    return ghosted


def curvature_matrix(nodes: int, spacing: float, low: str, high: str) -> np.ndarray:
    """Return the (nodes, nodes) matrix of ∂² of fourth order [1/m²], for u = 0 at both ends: inside (−1, 16, −30, 16,
    −1)/12, with the ghost −u₁ beyond a supported end and no curvature on it, and the rows that ``plate.operator``
    derives at a clamped one."""
    matrix = np.zeros((nodes, nodes))
    for node in range(2, nodes - 2):
        matrix[node, node - 2 : node + 3] = np.array([-1, 16, -30, 16, -1]) / 12
    for first_rows, edge in ((matrix, low), (matrix[::-1, ::-1], high)):
        if edge == "supported":
            first_rows[1, 1:4] = np.array([-30 + 1, 16, -1]) / 12
        else:
            first_rows[0, 1:3], first_rows[1, 1:4] = clamped_rows()
    matrix[:, [0, -1]] = 0
    return matrix / spacing**2


def biharmonic_of_fourth_order(
    u: np.ndarray, spacing: tuple[float, float], edges: tuple[str, str, str, str]
) -> np.ndarray:
    """Return ∇⁴u (..., ny − 2, nx − 2) [u/m⁴] of u (..., ny, nx), zero on the edges, as BᵀBu."""
    left, bottom, right, top = edges
    along_x = curvature_matrix(u.shape[-1], spacing[0], left, right)
    along_y = curvature_matrix(u.shape[-2], spacing[1], bottom, top)
    curvature = u @ along_x.T + along_y @ u
    return (curvature @ along_x + along_y.T @ curvature)[..., 1:-1, 1:-1]


def run_plate(
    scheme: Scheme,
    edges: tuple[str, str, str, str],
    viscous: float,
    backward: bool,
    patches: np.ndarray,
    drives: np.ndarray,
    carrier: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Step plates by (ρH/Δt²)(u⁺ − 2u + u⁻) + c·rate + D∇⁴u = f, the rate from u⁺ − u⁻ (centred) or u − u⁻.

    Patches are weights (actuators, ny, nx), drives phasors (plates, actuators) [N/m²], the carrier (steps,) is exp(iωt)
    by default. Returns displacements (plates, steps + 1, ny, nx) [m] and mean squared velocity (plates, ny, nx).
    """
    (nx, ny), dt = scheme.nodes, scheme.time_step
    history = np.zeros((drives.shape[0], scheme.steps + 1, ny, nx))
    if carrier is None:
        carrier = np.exp(1j * scheme.angular_frequency * dt * np.arange(scheme.steps))
    load = np.einsum("pk,kyx->pyx", drives, patches)
    loss = viscous * dt / scheme.surface_density
    before = np.zeros((drives.shape[0], ny, nx))
    for n in range(scheme.steps):
        u = history[:, n]
        f = (load * carrier[n]).real[:, 1:-1, 1:-1]
        if n == 0:
            f = f / 2  # u(−Δt) = u(Δt) for a plate at rest, while the first step below takes u(−Δt) = 0
        if scheme.order == 2:
            bent = biharmonic(with_ghosts(u, edges), scheme.spacing)
        else:
            bent = biharmonic_of_fourth_order(u, scheme.spacing, edges)
        push = dt**2 / scheme.surface_density * (f - scheme.rigidity * bent)
        inner, old = u[:, 1:-1, 1:-1], before[:, 1:-1, 1:-1]
        if backward:
            new = 2 * inner - old - loss * (inner - old) + push
        else:
            new = (2 * inner - (1 - loss / 2) * old + push) / (1 + loss / 2)
        history[:, n + 1, 1:-1, 1:-1] = new
        before = u
    first, last = scheme.window
    velocity = np.diff(history, axis=1)[:, first:last] / dt
    return history, (velocity**2).mean(axis=1)


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
    assert scheme.bending is not None
    coils = scheme.bending.coils
    # Magnets, their rates, currents, and those of shunted inductors of one coil after the other.
    circuits = [np.zeros((len(coils), plates)) for _ in range(3)]
    circuits.append(np.zeros((sum(len(coil.branches) for coil in coils), plates)))
    history, masses = np.zeros((scheme.steps + 1, *u.shape)), np.zeros((scheme.steps + 1, *z.shape))
    for n in range(scheme.steps):
        force = pressed.T @ forces[n].T + travel[n][:, None] - m.bending @ (u + m.retardation * v) - m.other @ u
        push = m.springs[:, None] * (z - m.shares @ u) + m.dampers[:, None] * (speed - m.shares @ v)
        force += m.shares.T @ push - m.berger * np.einsum("kp,kp->p", u, m.slopes @ u) * (m.slopes @ u)
        if scheme.bending.coils:
            v, circuits = with_coils(m, scheme, v, u, force, circuits, forces[n])
        else:
            v = next_rate(m, v, force, step, scheme.backward)
        u = u + step * v
        speed = speed - step * inverse(m.attached)[:, None] * push
        z = z + step * speed
        history[n + 1], masses[n + 1] = u, z
    first, last = scheme.window
    squares = (np.diff(history[first : last + 1], axis=0) ** 2).mean(axis=0) / step**2
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


def with_coils(
    m: Matrices,
    scheme: Scheme,
    rate: np.ndarray,
    u: np.ndarray,
    force: np.ndarray,
    circuits: list[np.ndarray],
    sources: np.ndarray,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return v (nodes, plates) a step later [m/s], and magnets, their rates and currents (coils, plates), and those of
    shunted inductors; force as in :func:`next_rate` without coils, sources (plates, actuators) [V or A]."""
    assert scheme.bending is not None
    step, coils, nodes = scheme.time_step, scheme.bending.coils, len(rate)
    size = shunted = nodes + 2 * len(coils)
    size += len(circuits[3])
    viscous = m.viscous / 2
    new, old = np.zeros((size, size)), np.zeros((size, size))  # new · x⁺ = old · x + given
    ahead, behind = (0 * viscous, 2 * viscous) if scheme.backward else (viscous, viscous)
    new[range(nodes), range(nodes)] = m.mass / step + ahead
    old[range(nodes), range(nodes)] = m.mass / step - behind
    given = np.concatenate([force, np.zeros((size - nodes, force.shape[1]))])
    for index, mounted in enumerate(coils):
        coil, magnet, current = mounted.coil, nodes + index, nodes + len(coils) + index
        patch, stroke = np.zeros(size), np.zeros(size)
        patch[:nodes] = stroke[:nodes] = mounted.share.ravel()
        stroke[magnet] = -1
        inertia = coil.moving_mass / step * np.outer(patch, patch)
        inertia[magnet, magnet] += coil.magnet_mass / step
        loss = coil.suspension_damping / 2 * np.outer(stroke, stroke)
        loss[magnet, magnet] += coil.magnet_damping / 2
        new, old = new + inertia + loss, old + inertia - loss
        new[:, current] -= coil.force_factor * stroke / 2
        old[:, current] += coil.force_factor * stroke / 2
        given[:size] -= coil.suspension_stiffness * stroke[:, None] * (patch[:nodes] @ u - circuits[0][index])
        given[magnet] -= coil.magnet_stiffness * circuits[0][index]
        if mounted.by_voltage:
            inductance, half = coil.inductance / step, coil.resistance / 2
            new[current] += coil.force_factor * stroke / 2
            old[current] -= coil.force_factor * stroke / 2
            new[current, current], old[current, current] = inductance + half, inductance - half
            for resistance, inductance in mounted.branches:
                across = np.zeros(size)
                across[current], across[shunted] = 1, -1
                drop = resistance / 2 * np.outer(across, across)
                new[[current, shunted]] += drop[[current, shunted]]
                old[[current, shunted]] -= drop[[current, shunted]]
                new[shunted, shunted] += inductance / step
                old[shunted, shunted] += inductance / step
                shunted += 1
        else:
            new[current, current] = old[current, current] = 0.5
            old[current, current] = -0.5
        given[current] = sources[:, mounted.actuator]
        if not coil.magnet_mass:
            new[magnet], old[magnet], given[magnet] = 0, 0, 0
            new[magnet, magnet] = 1
    held = np.flatnonzero(~m.moves)
    new[held], old[held], given[held] = 0, 0, 0
    new[held, held] = 1
    x = np.linalg.solve(new, old @ np.concatenate([rate, *circuits[1:]]) + given)
    moved, currents, others = np.split(x[nodes:], [len(coils), 2 * len(coils)])
    return x[:nodes], [circuits[0] + step * moved, moved, currents, others]


def inverse(masses: np.ndarray) -> np.ndarray:
    """Return 1/m, and zero for springs on the ground."""
    return np.divide(1, masses, out=np.zeros(len(masses)), where=masses > 0)
