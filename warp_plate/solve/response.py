"""Gram matrices of the unit responses, and the exact bound on the localization factor that they give.

A scene that is linear in its drives has, with z = (Re Z₁ ... Re Z_M, −Im Z₁ ... −Im Z_M) in R^{2M}, the energies
zᵀA z in the target and zᵀB z in the plate. So LF = zᵀA z / zᵀB z, and no drive exceeds the largest eigenvalue of
A z = λ B z. The matrices come from plates like any others, by polarisation: with E the energy under a drive,
E(a + b) − E(a) − E(b) = 2 aᵀA b. That takes M(2M + 1) plates.
"""

from dataclasses import dataclass

import numpy as np

from warp_plate.optimize.quadratic import RANK_TOLERANCE, quadratic_forms
from warp_plate.plate.weights import REGIONS, localization_factor
from warp_plate.solve.run import Progress
from warp_plate.solve.solver import PlateSolver

# Numbers of the phasors that are in memory at a time.
PHASORS_AT_ONCE = 2**21


@dataclass(frozen=True, eq=False)
class Response:
    """Energies as quadratic forms zᵀ matrix z of the drives, for regions of which the first are REGIONS."""

    matrices: np.ndarray  # (regions, 2M, 2M) symmetric float64 [J per (N/m²)²]

    def energy(self, phasors: np.ndarray) -> np.ndarray:
        """Return (plates, regions) energies [J] of phasors (plates, actuators), as ``PlateSolver.run`` would."""
        return quadratic_forms(self.matrices, phasors)

    def localization_factors(self, phasors: np.ndarray) -> np.ndarray:
        """Return (plates,) localization factors of phasors (plates, actuators)."""
        return localization_factor(self.energy(phasors))

    def bound(self) -> float:
        """Return the largest localization factor that any drive can reach."""
        return float(largest_ratio(self.matrices)[0])

    def best_drive(self) -> np.ndarray:
        """Return (actuators,) phasors [N/m²] that reach the bound, the largest of magnitude one."""
        cosine, sine = np.split(largest_ratio(self.matrices)[1], 2)
        phasors: np.ndarray = cosine - 1j * sine
        return phasors / np.abs(phasors).max()


def count_unit_drives(actuators: int) -> int:
    """Return the number of drives for the polarisation."""
    return actuators * (2 * actuators + 1)


def unit_drives(actuators: int, rows: slice = slice(None)) -> np.ndarray:
    """Return (M(2M + 1), actuators) phasors for the polarisation, or some rows of them: the 2M units, then their sums
    two by two."""
    units = np.concatenate([np.eye(actuators), -1j * np.eye(actuators), np.zeros((1, actuators))])
    count = 2 * actuators
    pairs = np.concatenate([[np.arange(count), np.full(count, count)], np.triu_indices(count, k=1)], axis=1)
    first, second = pairs[:, rows]
    return units[first] + units[second]


def measure_response(
    solver: PlateSolver, progress: Progress | None = None, block_numbers: int = PHASORS_AT_ONCE
) -> Response:
    """Simulate the unit drives; ``solver`` should be float64, for the differences of energies lose digits."""
    actuators, work = len(solver.scene.actuators), solver.node_steps_per_plate
    count, block, energies = count_unit_drives(actuators), max(1, block_numbers // actuators), []
    for first in range(0, count, block):

        def report(done: int, _total: int, before: int = first * work) -> None:
            if progress is not None:
                progress(before + done, count * work)

        energies.append(solver.run(unit_drives(actuators, slice(first, first + block)), progress=report).energy)
    return response_of(np.concatenate(energies), actuators)


def response_of(energy: np.ndarray, actuators: int) -> Response:
    """Return the response whose plates had the energies (M(2M + 1), regions) [J] under ``unit_drives``."""
    count = 2 * actuators
    first, second = np.triu_indices(count, k=1)
    matrices = np.zeros((energy.shape[1], count, count))
    for matrix, single, pair in zip(matrices, energy[:count].T, energy[count:].T, strict=True):
        matrix[np.diag_indices(count)] = single
        matrix[first, second] = matrix[second, first] = (pair - single[first] - single[second]) / 2
    return Response(matrices)


def has_full_rank(matrix: np.ndarray, basis: np.ndarray) -> bool:
    """Return whether zᵀ matrix z of all drives z = basis @ parameters is more than rounding."""
    reduced = basis.T @ matrix @ basis
    size = np.sqrt(np.where(np.diag(reduced) > 0, np.diag(reduced), 1))
    values = np.linalg.eigvalsh(reduced / np.outer(size, size))
    return bool(values.size and values[0] > RANK_TOLERANCE * values[-1] > 0)


def unit_energy_basis(forms: np.ndarray) -> np.ndarray:
    """Return vectors (..., n, n) of unit energy in which Hermitian forms are diagonal; zeros where it is rounding."""
    # Scaled to units of equal energy, so that no small actuator looks like rounding.
    diagonal = np.diagonal(forms, axis1=-2, axis2=-1).real
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1))
    values, vectors = np.linalg.eigh(forms / (size[..., :, None] * size[..., None, :]))
    largest = values[..., -1:]
    nonzero = (values > RANK_TOLERANCE * largest) & (largest > 0)
    lengths = np.where(nonzero, 1 / np.sqrt(np.where(nonzero, values, 1)), 0)
    return np.asarray(vectors * lengths[..., None, :] / size[..., :, None])


def largest_ratio(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest λ (...) of A z = λ B z and its z (..., 2M), among drives that move the plate.

    ``matrices``: (..., regions, 2M, 2M) Gram matrices. NaN and 0 where no drive moves the plate.
    """
    target, plate = matrices[..., REGIONS.index("target"), :, :], matrices[..., REGIONS.index("plate"), :, :]
    basis = unit_energy_basis(plate)
    ratios, directions = np.linalg.eigh(basis.mT @ target @ basis)
    best = (basis @ directions[..., -1:])[..., 0]
    return np.where(basis.any(axis=(-2, -1)), ratios[..., -1], np.nan), best
