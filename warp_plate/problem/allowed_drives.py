"""The drives that a search may choose, and the best of them for each design.

Where the drive is linear and free, the largest localization factor that a design can have is the largest eigenvalue of
its Gram matrices, and the best drive is the eigenvector. A search of places, frequencies or delays then varies these
alone, and the drive is eliminated exactly in each evaluation (variable projection: G. H. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 1973, pp. 413-432).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.designs import Designs
from warp_plate.problem.design_variables import fixed_magnitudes, has_design_tables, only_ratios
from warp_plate.problem.parametrization import Parametrization
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.solve.response import largest_ratio

# Factors tried for a drive, which is scaled to a largest magnitude of one.
SCALES = np.geomspace(1e-3, 1e3, 241)


@dataclass(frozen=True)
class AllowedDrives:
    """A set of drives; magnitudes are in the unit of drives."""

    lower: np.ndarray  # (actuators,) least magnitudes; −∞ where a magnitude may be of any sign
    upper: np.ndarray  # (actuators,) largest magnitudes; ``lower`` where they are fixed
    phase: np.ndarray  # (actuators,) fixed phases [rad]; NaN where a phase is searched
    power: float = math.inf  # largest Σ magnitude²
    equal: bool = False  # all magnitudes are the same
    scaled: bool = False  # true if drives of more power than that are scaled down to it, even below ``lower``

    @property
    def limits_ratios(self) -> bool:
        """True if some drives are forbidden at every scale, so that the limits restrict ratios of energies too."""
        return self.equal or bool((self.lower > 0).any()) or len(self.with_fixed_phases) > 1

    @property
    def with_fixed_phases(self) -> list[int]:
        """Indices of the actuators with a fixed phase and a magnitude that is not negative."""
        return np.flatnonzero(~np.isnan(self.phase) & (self.lower >= 0) & (self.upper > 0)).tolist()

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
    """Return a set of drives that holds all those of the search's positions.

    Unless the motion is steady, the first phase is free even where the source paper's search holds it at 0.
    """
    scene, unit = parametrization.scene, parametrization.unit
    tables, limits, equal = has_design_tables(scene), scene.search.limits, False
    fixed = fixed_magnitudes(scene) if tables else np.full(len(scene.actuators), unit)
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
    if not (tables or scene.steady):
        phase[0] = math.nan
    if only_ratios(scene):  # a drive that is too large is scaled down, and has the same ratios
        free = (lower == -math.inf) & (upper == math.inf)
        if free.sum() == len(free) - 1:  # a single fixed magnitude sets the size of the drive
            lower, upper = np.full_like(lower, -math.inf), np.full_like(upper, math.inf)
        return AllowedDrives(lower, upper, phase, equal=equal)
    if limits.magnitude is not None:
        lower, upper = np.minimum(lower, limits.magnitude), np.minimum(upper, limits.magnitude)
    if limits.power is None:
        return AllowedDrives(lower, upper, phase, equal=equal)
    equal |= limits.equal_magnitudes and len(fixed) > 1
    return AllowedDrives(lower, upper, phase, limits.power, equal, scaled=bool((lower > 0).any()))


def has_free_drives(parametrization: Parametrization) -> bool:
    """Return whether each design may have its best drive: only the ratio of energies matters, and magnitudes and phases
    are free up to a common factor."""
    scene = parametrization.scene
    if not scene.linear or parametrization.only_drives or scene.limited_levels:
        return False
    # Where all objectives grow with the localization factor, so does their sum.
    grows = all(REGION_QUANTITIES[term.kind].bounded_by == "localization" for term in scene.search.objectives)
    return grows and allowed_drives(parametrization).free


def searches_only_frequency(parametrization: Parametrization) -> bool:
    """Return whether one frequency is all that a search by modes has to choose."""
    free = has_free_drives(parametrization)
    searched = (parametrization.without_drives if free else parametrization).variables
    return parametrization.scene.linear and [variable.kind for variable in searched] == ["frequency"]


def best_drives(parametrization: Parametrization, designs: Designs, matrices: np.ndarray) -> tuple[Designs, np.ndarray]:
    """Return designs with their best drives, and the energies (n, regions) [J] under these.

    The drives are as large as their ranges allow. ``matrices``: (n, regions, 2M, 2M) Gram matrices of the designs.
    """
    allowed = allowed_drives(parametrization)
    basis = allowed.basis()
    real, imaginary = np.split(largest_ratio(basis.T @ matrices @ basis)[1] @ basis.T, 2, axis=1)
    phasors = real - 1j * imaginary
    upper = np.where(np.isfinite(allowed.upper), allowed.upper, parametrization.unit)
    phasors = np.asarray(phasors / np.abs(phasors / upper).max(axis=1, keepdims=True))
    columns = real_parts(phasors)[:, None, :, None]
    return replace(designs, drives=phasors), (columns.mT @ matrices @ columns)[:, :, 0, 0]


def best_allowed(
    quantity: Callable[[np.ndarray], np.ndarray], z: np.ndarray, allowed: AllowedDrives
) -> tuple[float, np.ndarray]:
    """Return the largest quantity of the drives near ±z, (2M,), that keep the limits, and its phasors; −∞ if none."""
    magnitudes = [*allowed.lower, *allowed.upper, math.sqrt(allowed.power / len(allowed.phase))]
    typical = max((value for value in magnitudes if 0 < value < math.inf), default=1.0)
    best, drive = -math.inf, np.zeros(len(allowed.phase), dtype=complex)
    if not z.any():
        return best, drive
    for real, imaginary in (np.split(z, 2), np.split(-z, 2)):
        phasors = real - 1j * imaginary
        held = ~np.isnan(allowed.phase)
        phase = np.where(held, np.nan_to_num(allowed.phase), -np.angle(phasors))
        sizes = np.where(held, (phasors * np.exp(1j * phase)).real, np.abs(phasors))
        scales = np.append(SCALES * typical / np.abs(sizes).max(), 1.0)
        tried = _within_limits(scales[:, None] * sizes, allowed) * np.exp(-1j * phase)
        values = np.nan_to_num(quantity(tried), nan=-math.inf, neginf=-math.inf)
        if values.max(initial=-math.inf) > best:
            best, drive = float(values.max()), tried[values.argmax()]
    return best, drive


def _within_limits(sizes: np.ndarray, allowed: AllowedDrives) -> np.ndarray:
    """Return those of the magnitudes ``sizes`` (tried, actuators) that keep the limits, made equal, clipped and scaled
    to the power first."""
    if allowed.equal:
        sizes = np.where(sizes < 0, -1, 1) * np.abs(sizes).mean(axis=1, keepdims=True)
    lower = np.maximum(allowed.lower, -allowed.upper)
    sizes = np.concatenate([sizes, np.clip(sizes, lower, allowed.upper)])
    power = (sizes**2).sum(axis=1, keepdims=True)
    reduced = sizes * np.sqrt(np.minimum(1.0, allowed.power / np.where(power > 0, power, 1.0)))
    ranged = sizes if allowed.scaled else reduced
    low, high = lower - 1e-12 * np.abs(lower), allowed.upper + 1e-12 * np.abs(allowed.upper)
    within = ((ranged >= low) & (ranged <= high)).all(axis=1)
    if allowed.equal:
        within &= np.ptp(np.abs(sizes), axis=1) <= 1e-12 * np.abs(sizes).max(axis=1)
    return reduced[within]
