"""The best drive of each design, for searches of places, frequencies and delays.

Where the drive is linear and free, the largest localization factor that a design can have is the largest eigenvalue of
its Gram matrices, and the best drive is the eigenvector. The search therefore only varies nonlinear variables, and the
drive is eliminated exactly in each evaluation (variable projection: G. H. Golub and V. Pereyra, SIAM J. Numer. Anal.
10, 1973, pp. 413-432).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.designs import Designs
from warp_plate.problem.bounds import AllowedDrives, allowed_drives
from warp_plate.problem.objectives import Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.solve.response import largest_ratio


def has_free_drives(parametrization: Parametrization, objectives: Objectives) -> bool:
    """Return whether each design may have its best drive: only the ratio of energies matters, and magnitudes and phases
    are free up to a common factor."""
    if not parametrization.scene.linear or parametrization.only_drives:
        return False
    # Where all objectives grow with the localization factor, so does their sum.
    grows = all(REGION_QUANTITIES[term.kind].grows_with == "localization" for term in objectives.terms)
    ratio = grows and not objectives.limits
    return ratio and allowed_drives(parametrization).free


def best_drives(parametrization: Parametrization, designs: Designs, matrices: np.ndarray) -> tuple[Designs, np.ndarray]:
    """Return designs with their best drives, and the energies (n, regions) [J] under these.

    The drives are as large as their ranges allow. ``matrices``: (n, regions, 2M, 2M) Gram matrices of the designs.
    """
    allowed = allowed_drives(parametrization)
    basis = allowed.basis()
    z = largest_ratio(basis.T @ matrices @ basis)[1] @ basis.T
    phasors = _scaled(z, allowed, parametrization.unit)
    columns = real_parts(phasors)[:, None, :, None]
    return replace(designs, drives=phasors), (columns.mT @ matrices @ columns)[:, :, 0, 0]


def _scaled(z: np.ndarray, allowed: AllowedDrives, unit: float) -> np.ndarray:
    """Return the phasors (n, M) of z (n, 2M), scaled to the largest magnitudes that are allowed."""
    real, imaginary = np.split(z, 2, axis=1)
    phasors = real - 1j * imaginary
    upper = np.where(np.isfinite(allowed.upper), allowed.upper, unit)
    return np.asarray(phasors / np.abs(phasors / upper).max(axis=1, keepdims=True))
