"""The plain plate in NumPy float64, written from the equations; it shares no step with the kernels.

Second order is the 13-point stencil in one piece with ghost nodes, fourth order matrices of one-dimensional
differences. It steps the paper's two-step scheme instead of the velocity form, in physical units. Slow; for tests.
"""

from __future__ import annotations

import numpy as np

from warp_plate.plate.operator import clamped_rows
from warp_plate.plate.scheme import Scheme


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
    """Return u (..., ny, nx) with one ghost node beyond each edge; edges are left, bottom, right, top.

    Clamped, ∂u/∂n = 0: the ghost equals the first inner node. Supported, ∂²u/∂n² = 0 with u = 0: its negative.
    """
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
    """Return the (nodes, nodes) matrix of ∂² of fourth order [1/m²], for u = 0 at both ends.

    Inside (−1, 16, −30, 16, −1)/12, with the ghost −u₁ beyond a supported end and no curvature on it; at a clamped end
    the rows of nodes 0 and 1 that ``plate.operator`` derives.
    """
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
