"""The drives that a search may choose, the best of them for each design, and upper bounds over all of them.

Where the drive is linear and free, the largest localization factor that a design can have is the largest eigenvalue of
its Gram matrices, and the best drive is the eigenvector. A search of places, frequencies or delays then varies these
alone, and the drive is eliminated exactly in each evaluation (variable projection: G. H. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 1973, pp. 413-432).

With z as in ``optimize.quadratic``, energies are zᵀA z, and limits on drives are limits on the |z_k|² of the actuators,
on their sum (power) or on the energy elsewhere: all of them quadratic forms. Without limits the largest ratio is an
eigenvalue, which a drive reaches. With limits it is bounded by multipliers (``problem.semidefinite``): for a ratio
under equal magnitudes, say, any d with Σ d_k = 0 has

    zᵀA z = zᵀ(A + diag d) z ≤ λ(d) zᵀB z,    λ(d) the largest eigenvalue of (A + diag d) z = λ B z,

and so for every d; the least λ(d) is the bound. A fixed phase leaves its actuator one real parameter instead of two, so
that the matrices are smaller.

The loss is −Σ weight · value, or 1 − LF, so that −Σ weight · bound of value is a lower bound. It is reached only if one
drive reaches all bounds: with several objectives it is called "bound only".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from warp_plate.optimize.quadratic import quadratic_forms, real_parts
from warp_plate.plate.designs import Designs
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import has_design_tables, only_ratios
from warp_plate.problem.objectives import Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.problem.semidefinite import ROUNDING, least_majorant
from warp_plate.quantities.region_quantities import PLATE, REGION_QUANTITIES, TARGET
from warp_plate.scene.search import Objective
from warp_plate.solve.response import Response, largest_ratio

# Relative distance within which a drive that keeps all limits must come for its bound to be called attained.
NEAR = 1e-6
# Largest number of actuators for which multipliers are computed: their cost grows as the fourth power.
MOST_ACTUATORS = 40
# Factors tried for the drive that the multipliers suggest, which is scaled to a largest magnitude of one.
SCALES = np.geomspace(1e-3, 1e3, 241)
MULTIPLIERS = "the dual of the semidefinite relaxation under the drive's limits"


@dataclass(frozen=True)
class AllowedDrives:
    """A set of drives; magnitudes are in the unit of drives."""

    lower: np.ndarray  # (actuators,) least magnitudes; −∞ where a magnitude may be of any sign
    upper: np.ndarray  # (actuators,) largest magnitudes; ``lower`` where they are fixed
    phase: np.ndarray  # (actuators,) fixed phases [rad]; NaN where a phase is searched
    power: float = math.inf  # largest Σ magnitude²
    equal: bool = False  # all magnitudes are the same
    contains_forbidden: bool = False  # true if it has drives that are not allowed; one of them may attain the bound

    @property
    def limits_ratios(self) -> bool:
        """True if some drives have no allowed multiple, so that the limits restrict ratios of energies too."""
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
    """Return a set of drives that holds all those of the search's positions.

    Unless the motion is steady, the first phase is free even where the source paper's search holds it at 0.
    """
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
    # Scaling a drive down to the power limit may take a magnitude below its range, so the lower ends are dropped.
    dropped = bool((lower > 0).any())
    return AllowedDrives(np.minimum(lower, 0.0), upper, phase, limits.power, equal, contains_forbidden=dropped)


def has_free_drives(parametrization: Parametrization, objectives: Objectives) -> bool:
    """Return whether each design may have its best drive: only the ratio of energies matters, and magnitudes and phases
    are free up to a common factor."""
    if not parametrization.scene.linear or parametrization.only_drives:
        return False
    # Where all objectives grow with the localization factor, so does their sum.
    grows = all(REGION_QUANTITIES[term.kind].bounded_by == "localization" for term in objectives.terms)
    ratio = grows and not objectives.limits
    return ratio and allowed_drives(parametrization).free


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


@dataclass(frozen=True)
class Bound:
    """A proved bound.

    It is "attained" if a drive within NEAR of it is known; "bound only" leaves open whether there is one.
    """

    value: float  # in the unit of the bounded quantity
    kind: Literal["attained", "bound only"]
    sentence: str  # reason, for people


def bound_localization(
    response: Response, allowed: AllowedDrives, most_actuators: int = MOST_ACTUATORS
) -> Bound | None:
    """Return the bound of the localization factor in a linear scene; None where no drive moves the plate.

    With limits and more than ``most_actuators`` actuators it is the eigenvalue of the drives without limits.
    """
    plate, basis = response.matrices[PLATE], allowed.basis()
    reduced = basis.T @ response.matrices @ basis
    ratio_of_all, parameters = largest_ratio(reduced) if basis.shape[1] else (math.nan, np.empty(0))
    if not math.isfinite(ratio_of_all):
        return None
    value = float(ratio_of_all) * (1 + ROUNDING)  # no drive passes it by rounding either

    def ratio(drives: np.ndarray) -> np.ndarray:
        return localization_factor(response.energy(drives))

    reached = _best_allowed(ratio, basis @ parameters, allowed)
    bound = _bound(value, reached, "the largest eigenvalue of the energies' matrices")
    if bound.kind == "bound only" and allowed.limits_ratios and len(allowed.phase) <= most_actuators:
        limits = [(plate, 0.0, 1.0, False), *_magnitude_limits(allowed)]
        least, nearest = _majorant(response.matrices[TARGET], limits, basis, np.diag(plate))
        if least < value:
            return _bound(least, _best_allowed(ratio, nearest, allowed), MULTIPLIERS)
    return bound


def bound_energy(
    matrix: np.ndarray, allowed: AllowedDrives, others: Sequence[tuple[np.ndarray, float]] = ()
) -> Bound | None:
    """Return the bound of zᵀ matrix z; None where nothing limits it.

    ``others``: further matrices and the largest values of their forms.
    """
    basis = allowed.basis()
    if not basis.shape[1] or len(allowed.phase) > MOST_ACTUATORS:
        return None
    forms, largest = np.array([matrix, *(other for other, _ in others)]), [value for _, value in others]
    limits = [(other, -value, 0.0, False) for other, value in others]
    limits = [(np.zeros_like(matrix), 1.0, 1.0, True), *limits, *_magnitude_limits(allowed)]
    least, nearest = _majorant(matrix, limits, basis, np.diag(matrix) + sum(map(np.diag, forms[1:])))
    if not math.isfinite(least):
        return None

    def energy(drives: np.ndarray) -> np.ndarray:
        energies = quadratic_forms(forms, drives)
        over = (energies[:, 1:] / largest).max(axis=1, initial=1.0)
        if not (allowed.lower > 0).any():  # scaled down to the other limits
            return energies[:, 0] / over
        return np.where(over <= 1 + 1e-12, energies[:, 0], -np.inf)

    return _bound(least, _best_allowed(energy, nearest, allowed), MULTIPLIERS)


def bound_loss(
    parametrization: Parametrization,
    objectives: Objectives,
    response: Response | None,
    displacement: Response | None = None,
) -> Bound | None:
    """Return the lower bound of a search's loss; None where none is claimed.

    ``response`` has the energies of all drives, ``displacement`` those of ½ ∫ ρH u² dA for objectives that need them;
    None where they are not quadratic forms.
    """
    if response is None or not parametrization.quadratic:
        return None
    allowed, terms = allowed_drives(parametrization), objectives.terms
    forms = {"velocity": response, "displacement": displacement}
    rests = [
        (form.matrices[PLATE] - form.matrices[TARGET], objectives.sizes.masses[1] * term.rest_limit**2 / 2)
        for term in terms
        if term.rest_limit is not None and (form := forms[term.kind]) is not None
    ]
    bounds = [_bound_value(term, objectives, allowed, response, forms.get(term.kind), rests) for term in terms]
    proved = [bound for bound in bounds if bound is not None]
    if len(proved) < len(terms):
        return None
    total = -sum(term.weight * bound.value for term, bound in zip(terms, proved, strict=True))
    total += objectives.only_localization
    if len(terms) > 1:
        return Bound(total, "bound only", "the sum of what each objective alone could reach")
    if allowed.contains_forbidden:  # the drive that reaches it need not be one of the search's
        sentence = "the most that any drive of this power and these largest magnitudes has; ranges may keep it lower"
        return Bound(total, "bound only", sentence)
    return replace(proved[0], value=total)


def _bound_value(
    term: Objective,
    objectives: Objectives,
    allowed: AllowedDrives,
    response: Response,
    form: Response | None,
    rests: Sequence[tuple[np.ndarray, float]],
) -> Bound | None:
    """Return the bound of an objective's value, in its own unit."""
    quantity, sentence = REGION_QUANTITIES[term.kind], ""
    if quantity.largest is not None:
        return Bound(quantity.largest, "bound only", f"a {term.kind} is at most {quantity.largest:g} by its definition")
    bound, plate = None, math.nan
    if quantity.bounded_by == "localization":
        bound, plate = bound_localization(response, allowed), 1.0
        if term.kind != "localization":
            sentence = f"{term.kind} grows with the localization factor, and of that "
    elif quantity.bounded_by == "energy" and form is not None:
        bound = bound_energy(form.matrices[TARGET], allowed, rests)
    if bound is None:
        return None
    energy = np.full((1, 2), plate)
    energy[:, TARGET] = bound.value
    return Bound(float(quantity.evaluate(energy, objectives.sizes)[0]), bound.kind, sentence + bound.sentence)


# A limit zᵀ matrix z + entry · τ² ≤ (or =) constant, with τ one more number beside z: matrix, entry, constant, and
# whether it is an equation. Of an energy τ² = 1; in a ratio, which does not depend on the drive's size, τ is arbitrary.
_Limit = tuple[np.ndarray, float, float, bool]


def _magnitude_limits(allowed: AllowedDrives) -> list[_Limit]:
    """Return the limits on |z_k|² and on their sum."""
    squares = [np.diag(diagonal) for diagonal in np.tile(np.eye(len(allowed.phase)), 2)]
    limits: list[_Limit] = []
    for square, low, high in zip(squares, allowed.lower, allowed.upper, strict=True):
        if low == high > 0:
            limits.append((square, -(low**2), 0.0, True))
        if 0 < low < high:
            limits.append((-square, low**2, 0.0, False))
        if low < high < math.inf and high != 0:
            limits.append((square, -(high**2), 0.0, False))
    if allowed.equal:
        limits += [(square - squares[0], 0.0, 0.0, True) for square in squares[1:]]
    if math.isfinite(allowed.power):
        limits.append((np.eye(2 * len(squares)), -allowed.power, 0.0, False))
    return limits


def _majorant(
    objective: np.ndarray, limits: Sequence[_Limit], basis: np.ndarray, sizes: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the bound of zᵀ objective z, and the z (2M,) at which its multipliers point.

    z is zero if the slack's smallest eigenvector has only a τ component, or if no multipliers were found. Actuators of
    very different size are scaled by the ``sizes`` (2M,), the energies of unit drives.
    """
    sizes = np.where(sizes > 0, sizes, 1.0)
    scaled = basis / np.sqrt((basis**2 * sizes[:, None]).sum(axis=0))
    matrices, entries, constants, equations = map(np.array, zip(*limits, strict=True))
    lifted = int(entries.any())
    wide, padded = np.pad(scaled, (0, lifted)), np.array([np.pad(form, (0, lifted)) for form in (objective, *matrices)])
    if lifted:  # τ in a unit in which it is about as large as the rest
        norms = np.abs(scaled.T @ matrices @ scaled).max(axis=(1, 2))
        nonzero = (entries != 0) & (norms != 0)
        wide[-1, -1] = 1 / math.sqrt(np.max(np.abs(entries[nonzero]) / norms[nonzero])) if nonzero.any() else 1.0
        padded[1:, -1, -1] = entries
    reduced = wide.T @ padded @ wide
    least, slack = least_majorant(reduced[0], reduced[1:], constants, equations)
    if not math.isfinite(least) or not slack.any():
        return least, np.zeros(len(basis))
    return least, scaled @ np.linalg.eigh(slack)[1][: basis.shape[1], 0]


def _best_allowed(quantity: Callable[[np.ndarray], np.ndarray], z: np.ndarray, allowed: AllowedDrives) -> float:
    """Return the largest quantity of the drives near ±z, (2M,), that keep the limits; −∞ if none does."""
    if not z.any():
        return -math.inf
    magnitudes = [*allowed.lower, *allowed.upper, math.sqrt(allowed.power / len(allowed.phase))]
    typical, best = max((value for value in magnitudes if 0 < value < math.inf), default=1.0), -math.inf
    for real, imaginary in (np.split(z, 2), np.split(-z, 2)):
        phasors = real - 1j * imaginary
        held = ~np.isnan(allowed.phase)
        phase = np.where(held, np.nan_to_num(allowed.phase), -np.angle(phasors))
        sizes = np.where(held, (phasors * np.exp(1j * phase)).real, np.abs(phasors))
        tried = _within_limits(SCALES[:, None] * sizes / np.abs(sizes).max() * typical, allowed)
        if tried.size:
            best = max(best, float(np.nanmax(np.append(quantity(tried * np.exp(-1j * phase)), -math.inf))))
    return best


def _within_limits(sizes: np.ndarray, allowed: AllowedDrives) -> np.ndarray:
    """Return those of the magnitudes ``sizes`` (tried, actuators) that keep the limits, made equal, clipped and scaled
    to the power first."""
    if allowed.equal:
        sizes = np.where(sizes < 0, -1, 1) * np.abs(sizes).mean(axis=1, keepdims=True)
    lower = np.maximum(allowed.lower, -allowed.upper)
    sizes = np.concatenate([sizes, np.clip(sizes, lower, allowed.upper)])
    power = (sizes**2).sum(axis=1, keepdims=True)
    sizes = sizes * np.sqrt(np.minimum(1.0, allowed.power / np.where(power > 0, power, 1.0)))
    low, high = lower - 1e-12 * np.abs(lower), allowed.upper + 1e-12 * np.abs(allowed.upper)
    within = ((sizes >= low) & (sizes <= high)).all(axis=1)
    if allowed.equal:
        within &= np.ptp(np.abs(sizes), axis=1) <= 1e-12 * np.abs(sizes).max(axis=1)
    return sizes[within]


def _bound(value: float, reached: float, reason: str) -> Bound:
    """Return an upper bound, attained if the value ``reached`` by a drive comes within NEAR of it."""
    if reached >= value * (1 - NEAR):
        return Bound(value, "attained", f"{reason}, which a drive reaches")
    return Bound(value, "bound only", f"{reason}; no drive that keeps all limits is known to reach it")
