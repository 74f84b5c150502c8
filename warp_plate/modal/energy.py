"""Mean kinetic energies over a window as quadratic forms of the drives, exactly in time.

Actuator k presses with Re(Z_k exp(iω_k t)) from t = 0 on. A unit phasor moves the modes by a forced motion A_k
exp(iω_k t) and free motions Σ_p ψ_p c_pk exp(s_p t), see :mod:`warp_plate.modal.poles`. With ⟨σ⟩ the mean of exp(σt)
over the window and G the mass matrix of a region, two complex rates v_k, v_l have the mean product

    ⟨v_kᵀ G v_l⟩ = A_kᵀ G A_l ⟨iω_k + iω_l⟩ + A_kᵀ G Σ_p ψ_p c_pl ⟨iω_k + s_p⟩ + (k ↔ l)
                   + Σ_pq c_pk ψ_pᵀ G ψ_q c_ql ⟨s_p + s_q⟩

and likewise that of v̄_k and v_l. From both follow the means of Re v_k Re v_l and so on: with z = (Re Z, −Im Z) the
energy of the region is zᵀ matrix z. A plate with a loss factor has no free motion, and means over its periods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles, make_poles
from warp_plate.scene.model import Window

# Free motions whose energies together are below this part of the forced motion's are left out.
NEGLIGIBLE = 1e-7


def gram_matrices(
    plate: ModalPlate,
    regions: Sequence[np.ndarray],
    forces: np.ndarray,
    frequency: np.ndarray,
    window: Window | None,
    quantity: str = "velocity",
) -> np.ndarray:
    """Return (designs, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²].

    Args:
        plate: Modes.
        regions: Mass matrices (modes, modes) of the regions, see :meth:`ModalPlate.kinetic_matrix`.
        forces: (designs or 1, modes, M) modal forces of the actuators' unit pressures.
        frequency: (designs, M) frequencies of the actuators [Hz].
        window: Window of a plate that starts from rest; None for the steady state, in which actuators of different
            frequencies do not interfere.
        quantity: "velocity", or "displacement" for ½ ∫ ρH u² dA [J s² per (N/m²)²].
    """
    omega = 2 * math.pi * frequency
    rate = 1j * omega if quantity == "velocity" else np.ones_like(omega)
    forced = _forced(plate, forces, omega) * rate[:, None, :]
    if window is None:
        same = omega[:, :, None] == omega[:, None, :]
        mixed = [(forced.conj().mT @ times(region, forced)) * same for region in regions]
        return np.stack([real_form(np.zeros_like(product), product) for product in mixed], axis=1)
    poles = make_poles(plate, window.end)
    drive = 1j * omega
    free = -(poles.vectors.T @ forces) / (drive[:, None, :] - poles.values[:, None])
    if quantity == "velocity":
        free *= poles.values[:, None]
    kept = _lasting(poles, free, forced, window)
    motion = _Motion(forced, drive, poles.vectors[:, kept], poles.values[kept], free[:, kept])
    return np.stack([real_form(*motion.products(region, window)) for region in regions], axis=1)


@dataclass(frozen=True)
class _Motion:
    """Rates of the modes under unit phasors."""

    forced: np.ndarray  # (designs, modes, M) amplitudes A
    drive: np.ndarray  # (designs, M) iω [1/s]
    shapes: np.ndarray  # (modes, poles) ψ
    poles: np.ndarray  # (poles,) s [1/s]
    free: np.ndarray  # (designs, poles, M) amplitudes c

    def products(self, region: np.ndarray, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Return (designs, M, M) means of v_kᵀ G v_l and of v̄_kᵀ G v_l."""
        forced, free, drive, poles = times(region, self.forced), self.free, self.drive, self.poles
        shapes = times(region, self.shapes)
        left = (self.forced, drive, self.shapes, poles, free)
        means = []
        for a, turn, psi, decay, c in (left, [array.conj() for array in left]):
            first, other = turn[:, :, None], decay[:, None]
            means.append(
                (a.mT @ forced) * mean_exponential(first, drive[:, None, :], window)
                + ((a.mT @ shapes) * mean_exponential(first, poles, window)) @ free
                + c.mT @ ((psi.T @ forced) * mean_exponential(other, drive[:, None, :], window))
                + c.mT @ (((psi.T @ shapes) * mean_exponential(other, poles, window)) @ free)
            )
        return means[0], means[1]


def _forced(plate: ModalPlate, forces: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Return (designs, modes, M) amplitudes of the forced motion."""
    shape = (len(omega), forces.shape[1], omega.shape[1])
    if (omega == omega[:, :1]).all() and len(forces) == 1:
        return plate.respond(omega[:, 0] / (2 * math.pi), forces[0])
    forced, loads = np.empty(shape, dtype=complex), np.broadcast_to(forces, shape)
    for actuator, turns in enumerate(omega.T):
        for turn in np.unique(turns):
            some = turns == turn
            forced[some, :, actuator] = plate.respond(np.array([turn / (2 * math.pi)]), loads[some, :, actuator].T)[0].T
    return forced


def times(region: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the product of a real matrix and complex columns, in real arithmetic."""
    return np.asarray((region @ values.real) + 1j * (region @ values.imag))


def _lasting(poles: Poles, free: np.ndarray, forced: np.ndarray, window: Window) -> np.ndarray:
    """Return the indices of the poles whose free motion counts after the start of the window."""
    decay = np.exp(poles.values.real * window.start)[:, None] * np.linalg.norm(poles.vectors, axis=0)[:, None]
    largest = np.sqrt((np.abs(forced) ** 2).sum(axis=1, keepdims=True))
    energy = (np.abs(free * decay / np.where(largest > 0, largest, 1)) ** 2).max(axis=(0, 2))
    order = np.argsort(energy)
    return np.sort(order[np.cumsum(energy[order]) > NEGLIGIBLE])


def mean_exponential(first: np.ndarray, second: np.ndarray, window: Window) -> np.ndarray:
    """Return the means of exp((first + second) t) over the window, broadcast."""
    turn = (first + second) * (window.end - window.start)
    early = np.exp(first * window.start) * np.exp(second * window.start)
    late = np.exp(first * window.end) * np.exp(second * window.end)
    small = np.abs(turn) < 1e-3
    mean = (late - early) / np.where(small, 1, turn)
    if small.any():  # where the difference would cancel: a series whose next term is below 1e-14
        near = turn[small]
        mean[small] = early[small] * (1 + near / 2 * (1 + near / 3 * (1 + near / 4)))
    return np.asarray(mean)


def real_form(plain: np.ndarray, mixed: np.ndarray) -> np.ndarray:
    """Return ½ of the means (..., 2M, 2M) of products of Re v and Im v, from means of v_k v_l and of v̄_k v_l."""
    real, imaginary = (mixed + plain).real / 4, (mixed - plain).real / 4
    cross = (mixed + plain).imag / 4
    rows = np.concatenate([real, cross], axis=-1), np.concatenate([cross.mT, imaginary], axis=-1)
    return np.concatenate(rows, axis=-2)
