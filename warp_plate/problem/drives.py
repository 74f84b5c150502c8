"""The drives that a search may choose, and the best of them for each design.

Where the drive is linear and free, the largest localization factor that a design can have is the largest eigenvalue of
its Gram matrices, and the best drive is the eigenvector. A search of places, frequencies or delays then varies these
alone, and the drive is eliminated exactly in each evaluation (variable projection: G. H. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 1973, pp. 413-432).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.designs import Designs
from warp_plate.problem.design_variables import has_design_tables, only_ratios
from warp_plate.problem.objectives import Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.solve.response import largest_ratio


@dataclass(frozen=True)
class AllowedDrives:
    """A set of drives; magnitudes are in the unit of drives."""

    lower: np.ndarray  # (actuators,) least magnitudes; −∞ where a magnitude may be of any sign
    upper: np.ndarray  # (actuators,) largest magnitudes; ``lower`` where they are fixed
    phase: np.ndarray  # (actuators,) fixed phases [rad]; NaN where a phase is searched
    power: float = math.inf  # largest Σ magnitude²
    equal: bool = False  # all magnitudes are the same
    wider: bool = False  # the set contains drives that are not allowed, one of which may attain the bound

    @property
    def limits_ratios(self) -> bool:
        """True if not every drive has a multiple that is allowed, so that limits say something about a ratio."""
        return self.equal or bool((self.lower > 0).any())

    @property
    def free(self) -> bool:
        """True if every drive, up to a common phase, has a multiple that is allowed."""
        sizes = (self.lower <= 0).all() and (self.upper > 0).all() and not self.equal
        return bool(sizes and np.isnan(self.phase[1:]).all())

    def basis(self) -> np.ndarray:
        """Return (2M, parameters): z = basis @ parameters are the drives of the fixed phases.

        An actuator has two parameters where its phase is searched, one where it is fixed, none where it must be off.
        """
        columns = []
        for unit, phase, most in zip(np.eye(len(self.phase)), self.phase, self.upper, strict=True):
            parts = [(1.0, 0.0), (0.0, 1.0)] if math.isnan(phase) else [(math.cos(phase), math.sin(phase))]
            columns += [np.kron(part, unit) for part in parts if most > 0]
        return np.array(columns).T.reshape(2 * len(self.phase), -1)


def allowed_drives(parametrization: Parametrization) -> AllowedDrives:
    """Return a set of drives that holds all those of the search's positions."""
    scene, unit = parametrization.scene, parametrization.unit
    tables, limits, equal = has_design_tables(scene), scene.search.limits, False
    fixed = np.array([actuator.magnitude if tables else unit for actuator in scene.actuators])
    phase = np.array([actuator.phase if tables else 0.0 for actuator in scene.actuators])
    lower, upper = np.abs(fixed), np.abs(fixed)
    for variable in parametrization.variables:
        group = list(variable.actuators)
        if variable.kind == "magnitude":
            lower[group], upper[group], fixed[group] = unit * variable.lower, unit * variable.upper, 0.0
            equal |= len(group) == len(fixed) > 1
        elif variable.kind == "phase":
            phase[group] = np.nan
    phase = np.where(fixed < 0, phase + math.pi, phase)
    if only_ratios(scene):  # a drive that is too large is scaled down, and has the same ratios
        free = (lower == -math.inf) & (upper == math.inf)
        if free.sum() == len(free) - 1:  # a single fixed magnitude sets the size of the drive
            lower, upper = np.full_like(lower, -math.inf), np.full_like(upper, math.inf)
        return AllowedDrives(lower, upper, phase, equal=equal)
    if limits.magnitude is not None:
        lower, upper = np.minimum(lower, limits.magnitude), np.minimum(upper, limits.magnitude)
    if limits.power is None:
        return AllowedDrives(lower, upper, phase, equal=equal)
    # A drive that is scaled down to the power may end below the range.
    return AllowedDrives(np.minimum(lower, 0.0), upper, phase, limits.power, equal, wider=bool((lower > 0).any()))


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
