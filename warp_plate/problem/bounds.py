"""Upper bounds of energies and energy ratios over all drives that are allowed.

With z as in ``optimize.quadratic``, energies are zᵀA z, and limits on drives are limits on the |z_k|² of the actuators,
on their sum (power) or on the energy elsewhere: all of them quadratic forms. Without limits the largest ratio is an
eigenvalue, which a drive reaches. With limits it is bounded by multipliers (``problem.semidefinite``): for a ratio
under equal magnitudes, say, any d with Σ d_k = 0 has

    zᵀA z = zᵀ(A + diag d) z ≤ λ(d) zᵀB z,    λ(d) the largest eigenvalue of (A + diag d) z = λ B z,

and so for every d; the least λ(d) is the bound. A fixed phase leaves its actuator one real number instead of two, which
narrows the matrices themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.semidefinite import ROUNDINGS, QuadraticLimits, least_majorant
from warp_plate.solve.response import Response, largest_ratio

# Relative distance within which a drive that keeps all limits must come for its bound to be called attained.
NEAR = 1e-6
# Above so many actuators the multipliers are not sought: their cost grows as the fourth power.
MOST_ACTUATORS = 40
# Factors by which the drive at which the multipliers point is tried, largest magnitude one to begin with.
SCALES = np.geomspace(1e-3, 1e3, 241)


@dataclass(frozen=True)
class Bound:
    """A proved bound.

    Attributes:
        value: bound in the unit of the bounded quantity.
        kind: "attained" if a drive comes within NEAR of it.
        sentence: reason, for people.
    """

    value: float
    kind: Literal["attained", "bound only"]
    sentence: str


@dataclass(frozen=True)
class AllowedDrives:
    """A set of drives; magnitudes are in the unit of drives.

    Attributes:
        lower: (actuators,) least magnitudes; −∞ where a magnitude may be of any sign.
        upper: (actuators,) largest magnitudes; the same as ``lower`` where they are fixed.
        phase: (actuators,) fixed phases [rad]; NaN where a phase is searched.
        power: largest Σ magnitude².
        equal: whether all magnitudes are the same.
        wider: whether the set holds drives that cannot be chosen, so that one of them may be what reaches a bound.
    """

    lower: np.ndarray
    upper: np.ndarray
    phase: np.ndarray
    power: float = math.inf
    equal: bool = False
    wider: bool = False

    @staticmethod
    def all_drives(actuators: int) -> AllowedDrives:
        """Return the set of all drives."""
        lower, upper, phase = (np.full(actuators, value) for value in (-math.inf, math.inf, math.nan))
        return AllowedDrives(lower, upper, phase)

    @property
    def at_any_scale(self) -> bool:
        """True if a multiple of any drive is allowed, so that limits say nothing about a ratio."""
        return not self.equal and not (self.lower > 0).any()

    def basis(self) -> np.ndarray:
        """Return (2M, parameters): z = basis @ parameters are the drives of the fixed phases.

        There are two parameters for an actuator whose phase is searched, one where it is fixed, none where its
        magnitude must be zero.
        """
        count, columns = len(self.phase), []
        for index, (phase, most) in enumerate(zip(self.phase, self.upper, strict=True)):
            turns = [(1.0, 0.0), (0.0, 1.0)] if math.isnan(phase) else [(math.cos(phase), math.sin(phase))]
            for turn in turns if most > 0 else []:
                column = np.zeros(2 * count)
                column[[index, index + count]] = turn
                columns.append(column)
        return np.array(columns).T.reshape(2 * count, -1)


def bound_localization(
    response: Response, allowed: AllowedDrives, most_actuators: int = MOST_ACTUATORS
) -> Bound | None:
    """Return the bound of the localization factor in a linear scene; None where no drive moves the plate.

    With limits and more than ``most_actuators`` actuators it is the eigenvalue of the drives without limits.
    """
    plate, target = (response.matrices[REGIONS.index(name)] for name in ("plate", "target"))
    basis = allowed.basis()
    reduced = basis.T @ response.matrices @ basis
    value, parameters = largest_ratio(reduced) if basis.shape[1] else (math.nan, np.empty(0))
    if not math.isfinite(value):
        return None
    value *= 1 + ROUNDINGS * np.finfo(float).eps  # no drive passes it by rounding either

    def ratio(drives: np.ndarray) -> np.ndarray:
        energy = response.energy(drives)
        with np.errstate(invalid="ignore", divide="ignore"):
            return energy[:, REGIONS.index("target")] / energy[:, REGIONS.index("plate")]

    sentence = "the largest eigenvalue of the energies' matrices"
    if _best_allowed(ratio, basis @ parameters, allowed) >= value * (1 - NEAR):
        return Bound(value, "attained", f"{sentence}, which a drive reaches")
    if not allowed.at_any_scale and len(allowed.phase) <= most_actuators:
        rows = [_row(plate, 1.0, 0.0), *_limit_rows(allowed)]
        least, nearest = _majorant(target, rows, basis, np.diag(plate))
        if least < value:
            return _of_multipliers(least, _best_allowed(ratio, nearest, allowed))
    return Bound(value, "bound only", f"{sentence}; no drive that keeps all limits is known to reach it")


def bound_energy(
    matrix: np.ndarray, allowed: AllowedDrives, others: Sequence[tuple[np.ndarray, float]] = ()
) -> Bound | None:
    """Return the bound of zᵀ matrix z; None where nothing limits it.

    ``others``: further matrices and the largest values of their forms.
    """
    basis = allowed.basis()
    if not basis.shape[1] or len(allowed.phase) > MOST_ACTUATORS:
        return None
    limits = [_row(other, 0.0, value) for other, value in others]
    sizes = np.diag(matrix) + sum((np.diag(other) for other, _ in others), np.zeros(len(matrix)))
    rows = [(np.zeros_like(matrix), 1.0, 1.0, True), *limits, *_limit_rows(allowed)]
    least, nearest = _majorant(matrix, rows, basis, sizes)
    if not math.isfinite(least):
        return None

    def energy(drives: np.ndarray) -> np.ndarray:
        z = real_parts(drives)
        over = np.max([np.ones(len(z)), *(_forms(other, z) / value for other, value in others)], axis=0)
        if not (allowed.lower > 0).any():  # scaled down to the other limits
            return _forms(matrix, z) / over
        return np.where(over <= 1 + 1e-12, _forms(matrix, z), -np.inf)

    return _of_multipliers(least, _best_allowed(energy, nearest, allowed))


# A limit zᵀ matrix z ≤ (or =) value · τ² + constant, with τ one more number beside z: matrix, its entry for τ², the
# constant, and whether it is an equation. In a ratio τ is arbitrary, for a ratio does not depend on the drive's size.
_Row = tuple[np.ndarray, float, float, bool]


def _row(matrix: np.ndarray, constant: float, value: float) -> _Row:
    return matrix, -value, constant, False


def _limit_rows(allowed: AllowedDrives) -> list[_Row]:
    """Return the limits on |z_k|² and on their sum."""
    count = len(allowed.phase)
    squares = []
    for index in range(count):
        diagonal = np.zeros(2 * count)
        diagonal[[index, index + count]] = 1.0
        squares.append(np.diag(diagonal))
    rows: list[_Row] = []
    for square, low, high in zip(squares, allowed.lower, allowed.upper, strict=True):
        if high == 0:
            continue
        if low == high:
            rows.append((square, -(low**2), 0.0, True))
            continue
        if low > 0:
            rows.append((-square, low**2, 0.0, False))
        if math.isfinite(high):
            rows.append((square, -(high**2), 0.0, False))
    if allowed.equal:
        rows += [(square - squares[0], 0.0, 0.0, True) for square in squares[1:]]
    if math.isfinite(allowed.power):
        rows.append((np.eye(2 * count), -allowed.power, 0.0, False))
    return rows


def _majorant(
    objective: np.ndarray, rows: Sequence[_Row], basis: np.ndarray, sizes: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the bound of zᵀ objective z, and the z (2M,) at which its multipliers point.

    ``sizes``: (2M,) energies of the units: actuators of very different size must not make each other look like
    rounding.
    """
    sizes = np.where(sizes > 0, sizes, 1.0)
    scaled = basis / np.sqrt((basis**2 * sizes[:, None]).sum(axis=0))
    # τ in a unit in which it is about as large as the rest; a ratio may have no limit with τ.
    norms = [(np.abs(scaled.T @ matrix @ scaled).max(), abs(entry)) for matrix, entry, _, _ in rows]
    lifted = any(entry for _, entry in norms)
    wide = np.zeros((len(basis) + lifted, basis.shape[1] + lifted))
    wide[: len(basis), : basis.shape[1]] = scaled
    if lifted:
        wide[-1, -1] = 1 / math.sqrt(max((entry / norm for norm, entry in norms if entry and norm), default=1.0))

    def widened(matrix: np.ndarray, entry: float) -> np.ndarray:
        padded = np.pad(matrix, (0, int(lifted)))
        if lifted:
            padded[-1, -1] = entry
        reduced: np.ndarray = wide.T @ padded @ wide
        return reduced

    limits = QuadraticLimits(
        np.array([widened(matrix, entry) for matrix, entry, _, _ in rows]),
        np.array([constant for _, _, constant, _ in rows]),
        np.array([equation for _, _, _, equation in rows]),
    )
    least, slack = least_majorant(widened(objective, 0.0), limits)
    if not math.isfinite(least) or not slack.any():
        return least, np.zeros(len(basis))
    return least, scaled @ np.linalg.eigh(slack)[1][: basis.shape[1], 0]


def _best_allowed(quantity: Callable[[np.ndarray], np.ndarray], z: np.ndarray, allowed: AllowedDrives) -> float:
    """Return the largest quantity of the drives near ±z, (2M,), that keep the limits; −∞ if none does."""
    if not np.abs(z).max() > 0:
        return -math.inf
    best = -math.inf
    for real, imaginary in (np.split(z, 2), np.split(-z, 2)):
        phasors = real - 1j * imaginary
        held = ~np.isnan(allowed.phase)
        phase = np.where(held, np.nan_to_num(allowed.phase), -np.angle(phasors))
        sizes = np.where(held, (phasors * np.exp(1j * phase)).real, np.abs(phasors))
        tried = _within_limits(SCALES[:, None] * sizes / np.abs(sizes).max() * _typical_magnitude(allowed), allowed)
        if tried.size:
            best = max(best, float(np.nanmax(np.append(quantity(tried * np.exp(-1j * phase)), -math.inf))))
    return best


def _within_limits(sizes: np.ndarray, allowed: AllowedDrives) -> np.ndarray:
    """Return magnitudes (some, actuators) that keep the limits, made of others (tried, actuators)."""
    if allowed.equal:
        sizes = np.where(sizes < 0, -1, 1) * np.abs(sizes).mean(axis=1, keepdims=True)
    lower = np.maximum(allowed.lower, -allowed.upper)
    sizes = np.concatenate([sizes, np.clip(sizes, lower, allowed.upper)])
    power = (sizes**2).sum(axis=1, keepdims=True)
    sizes = sizes * np.sqrt(np.minimum(1.0, allowed.power / np.where(power > 0, power, 1.0)))
    low, high = (limit - sign * 1e-12 * np.abs(limit) for limit, sign in ((lower, 1), (allowed.upper, -1)))
    kept = ((sizes >= low) & (sizes <= high)).all(axis=1)
    if allowed.equal:
        kept &= np.ptp(np.abs(sizes), axis=1) <= 1e-12 * np.abs(sizes).max(axis=1)
    return sizes[kept]


def _typical_magnitude(allowed: AllowedDrives) -> float:
    """Return a magnitude among those that are allowed."""
    named = [*allowed.lower, *allowed.upper, math.sqrt(allowed.power / len(allowed.phase))]
    return max((value for value in named if 0 < value < math.inf), default=1.0)


def _of_multipliers(least: float, reached: float) -> Bound:
    """Return the bound by multipliers, with whether a drive reaches it."""
    sentence = "the dual of the semidefinite relaxation under the drive's limits"
    if reached >= least * (1 - NEAR):
        return Bound(least, "attained", f"{sentence}, which a drive reaches")
    return Bound(least, "bound only", f"{sentence}; the best drive may lie below it")


def _forms(matrix: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return zᵀ matrix z, shape (n,), of z (n, 2M)."""
    forms: np.ndarray = np.einsum("pa,ab,pb->p", z, matrix, z, optimize=True)
    return forms
