"""Gram matrices of the unit responses, and the exact bound on the localization factor that they give.

A scene that is linear in its drives has, with z = (Re Z₁ ... Re Z_M, −Im Z₁ ... −Im Z_M) in R^{2M}, the energies
zᵀA z in the target and zᵀB z in the plate. So LF = zᵀA z / zᵀB z, and no drive passes the largest eigenvalue of
A z = λ B z. The matrices come from plates like any others, by polarisation: with E the energy under a drive,
E(a + b) − E(a) − E(b) = 2 aᵀA b. That takes M(2M + 1) plates, and no kernel of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.weights import REGIONS
from warp_plate.solve.solver import PlateSolver, Progress

# Drives whose plate energy is below this part of the largest are combinations that cancel out: two actuators in one
# place, for example. What is left of their energy is rounding, and no ratio of it means anything.
RANK_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Response:
    """Symmetric matrices (regions, 2M, 2M) with energy = zᵀ matrix z [J per (N/m²)²]; float64; REGIONS come first."""

    matrices: np.ndarray

    def energy(self, drives: np.ndarray) -> np.ndarray:
        """(plates, regions) energies [J] of drives (plates, actuators), as ``PlateSolver.run`` would give them."""
        z = real_parts(drives)
        return np.einsum("pa,rab,pb->pr", z, self.matrices, z)

    def bound(self) -> float:
        """The largest localization factor that any drive can reach."""
        return largest_ratio(self.matrices)[0]

    def best_drive(self) -> np.ndarray:
        """(actuators,) a drive [N/m²] that reaches the bound; its first actuator with magnitude at most one."""
        z = largest_ratio(self.matrices)[1]
        cosine, sine = np.split(z, 2)
        drive: np.ndarray = cosine - 1j * sine
        return drive / np.abs(drive).max()


def unit_drives(actuators: int) -> np.ndarray:
    """(M(2M + 1), actuators) drives for the polarisation: the 2M units, then their sums two by two."""
    units = np.concatenate([np.eye(actuators), -1j * np.eye(actuators)])
    first, second = np.triu_indices(2 * actuators, k=1)
    return np.concatenate([units, units[first] + units[second]])


def measure_response(solver: PlateSolver, progress: Progress | None = None) -> Response:
    """Simulate the unit drives; ``solver`` should be float64, for the differences of energies lose digits.

    Raises:
        SceneError: so many actuators that their drives do not fit into memory.
    """
    actuators = len(solver.scene.actuators)
    refuse_beyond_memory(100.0 * actuators**3, f"actuators: {actuators}, which makes {2 * actuators**2} unit drives;")
    return response_of(solver.run(unit_drives(actuators), progress=progress).energy, actuators)


def response_of(energy: np.ndarray, actuators: int) -> Response:
    """The response whose plates had these energies (M(2M + 1), regions) [J] under ``unit_drives``."""
    count = 2 * actuators
    first, second = np.triu_indices(count, k=1)
    matrices = np.zeros((energy.shape[1], count, count))
    diagonal, mixed = energy[:count], energy[count:]
    for matrix, own, pair in zip(matrices, diagonal.T, mixed.T, strict=True):
        matrix[np.diag_indices(count)] = own
        matrix[first, second] = matrix[second, first] = (pair - own[first] - own[second]) / 2
    return Response(matrices)


def real_parts(drives: np.ndarray) -> np.ndarray:
    """(plates, 2M) z = (Re Z, −Im Z) of drives (plates, actuators)."""
    drives = np.asarray(drives, dtype=complex)
    return np.concatenate([drives.real, -drives.imag], axis=1)


def largest_ratio(matrices: np.ndarray) -> tuple[float, np.ndarray]:
    """Largest λ of A z = λ B z and its z, within the drives that move the plate; (NaN, 0) if none does."""
    target, plate = matrices[REGIONS.index("target")], matrices[REGIONS.index("plate")]
    # Actuators of very different size must not make each other look like rounding: units of equal energy first.
    size = np.sqrt(np.where(np.diag(plate) > 0, np.diag(plate), 1))
    values, vectors = np.linalg.eigh(plate / np.outer(size, size))
    kept = values > RANK_TOLERANCE * values[-1]
    if values[-1] <= 0 or not kept.any():
        return float("nan"), np.zeros(len(plate))
    basis = vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]
    ratios, directions = np.linalg.eigh(basis.T @ target @ basis)
    return float(ratios[-1]), basis @ directions[:, -1]
