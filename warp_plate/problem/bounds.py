"""Upper bounds over all drives that a search may choose.

With z as in ``optimize.quadratic``, energies are zᵀA z, and limits on drives are limits on the |z_k|² of the actuators,
on their sum (power), on energies or on sounds: all of them quadratic forms. Without limits the largest ratio is an
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
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Literal

import numpy as np

from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.allowed_drives import AllowedDrives, allowed_drives, best_allowed
from warp_plate.problem.objectives import Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.problem.semidefinite import EIGEN_ERROR, least_majorant, local_maximum
from warp_plate.quantities.region_quantities import PLATE, REGION_QUANTITIES, TARGET
from warp_plate.scene.search import Objective
from warp_plate.solve.response import Response, has_full_rank, largest_ratio

# Relative distance within which a drive that keeps all limits must come for its bound to be called attained.
NEAR = 1e-6
# Largest number of actuators for which multipliers are computed: their cost grows as the fourth power.
MOST_ACTUATORS = 40
# Largest number of actuators with fixed phases whose products of magnitudes are limited.
MOST_FIXED = 8
# Drives under limits are sought from so many points, times the numbers of a drive. They stay below a limited energy by
# this part, so that the rounding of a run does not carry them over the limit.
STARTS, INSIDE = 80, 5e-7
# Ratio of the widest limit to the narrowest beyond which the relaxation is also solved in a unit of the narrowest.
FAR = 1e4


@dataclass(frozen=True)
class Bound:
    """A proved bound.

    It is "attained" if a drive within NEAR of it is known; "bound only" leaves open whether there is one.
    """

    value: float  # in the unit of the bounded quantity
    kind: Literal["attained", "bound only"]
    drive: np.ndarray | None = None  # (actuators,) phasors of the best permitted drive that is known


@dataclass(frozen=True)
class EnergyLimits:
    """Limits on energies zᵀ matrix z, or on sounds that stand for them."""

    at_most: Sequence[tuple[np.ndarray, float]] = ()  # matrices (2M, 2M) and largest values
    at_least: Sequence[tuple[np.ndarray, float]] = ()  # the same of least values

    def __bool__(self) -> bool:
        return bool(self.at_most or self.at_least)

    def limits(self, allowed: AllowedDrives, inside: float = 0.0) -> list[_Limit]:
        """Return the limits, narrower by the part ``inside``."""
        upper = [_limit(matrix, (1 - inside) * value, allowed) for matrix, value in self.at_most]
        return upper + [_limit(-matrix, -(1 + inside) * value, allowed) for matrix, value in self.at_least]

    @property
    def sizes(self) -> np.ndarray | float:
        """(2M,) sums of the energies of unit drives; 0 without limits."""
        return sum((np.diag(matrix) for matrix, _ in (*self.at_most, *self.at_least)), 0.0)

    def factors(self, drives: np.ndarray, scalable: bool) -> np.ndarray:
        """Return factors (drives,) by which drives keep the limits, 1 unless ``scalable``; NaN where none does."""

        def ratios(rows: Sequence[tuple[np.ndarray, float]]) -> np.ndarray:
            forms = np.array([matrix for matrix, _ in rows]).reshape(-1, *2 * (2 * drives.shape[1],))
            return quadratic_forms(forms, drives) / [value for _, value in rows]

        over = ratios(self.at_most).max(axis=1, initial=0.0) / (1 - INSIDE)
        factors = 1 / np.sqrt(np.maximum(over, 1.0)) if scalable else np.where(over <= 1 + INSIDE / 2, 1.0, np.nan)
        least = ratios(self.at_least).min(axis=1, initial=math.inf) * factors**2
        return np.where(least >= 1, factors, np.nan)

    def within(self, values: Callable[[np.ndarray], np.ndarray], scalable: bool) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function of drives (n, actuators) that is ``values`` where they keep the limits, and else −∞."""

        def inside(drives: np.ndarray) -> np.ndarray:
            factors = self.factors(drives, scalable)
            return np.where(np.isnan(factors), -math.inf, values(drives * np.nan_to_num(factors)[:, None]))

        return inside

    def scaled(self, reached: tuple[float, np.ndarray], scalable: bool) -> tuple[float, np.ndarray]:
        """Return a value and its drive (actuators,), scaled to stay inside the limits."""
        factor = float(self.factors(reached[1][None], scalable)[0])
        return reached[0], reached[1] * (1.0 if math.isnan(factor) else factor)


NO_LIMITS = EnergyLimits()


def bound_localization(
    response: Response,
    allowed: AllowedDrives,
    most_actuators: int = MOST_ACTUATORS,
    attain: bool = True,
    others: EnergyLimits = NO_LIMITS,
) -> Bound | None:
    """Return the bound of the localization factor in a linear scene; None where no drive moves the plate.

    With limits and more than ``most_actuators`` actuators it is the eigenvalue of the drives without limits. Without
    ``attain``, no drive under limits is sought that attains it.
    """
    if allowed.scaled and not others:  # drives that are scaled down to a power keep their ratios
        allowed = replace(allowed, power=math.inf, scaled=False)
    plate, basis = response.matrices[PLATE], allowed.basis()
    reduced = basis.T @ response.matrices @ basis
    ratio_of_all, parameters = largest_ratio(reduced) if basis.shape[1] else (math.nan, np.empty(0))
    if not math.isfinite(ratio_of_all):
        return None
    value = float(ratio_of_all) * (1 + EIGEN_ERROR)  # no drive passes it by rounding either

    scalable = not (allowed.lower > 0).any()
    ratio = others.within(lambda drives: localization_factor(response.energy(drives)), scalable)

    def reached(z: np.ndarray) -> tuple[float, np.ndarray]:
        return others.scaled(best_allowed(ratio, z, allowed), scalable)

    bound = _bound(value, [reached(basis @ parameters)])
    restricted = allowed.limits_ratios or bool(others)
    if bound.kind == "bound only" and restricted and len(allowed.phase) <= most_actuators:
        wider = allowed
        if allowed.scaled:  # drives that are scaled down are among those without least magnitudes
            wider = replace(allowed, lower=np.minimum(allowed.lower, 0.0), scaled=False)
        if scalable and not others:  # a smaller drive has the same ratio
            wider = replace(allowed, upper=np.full(len(allowed.upper), math.inf))
        limits = _magnitude_limits(wider)
        inside, limits = limits + others.limits(wider, INSIDE), limits + others.limits(wider)
        least, starts = _majorant(response.matrices[TARGET], [(plate, 0.0, 1.0, False), *limits], basis, np.diag(plate))
        if least < value:
            starts = starts if attain else starts[:0]
            ascents = _ascents(response.matrices[TARGET], plate, inside, wider, np.diag(plate), starts)
            return _bound(least, map(reached, ascents))
    return bound


def bound_energy(
    matrix: np.ndarray, allowed: AllowedDrives, others: EnergyLimits = NO_LIMITS, attain: bool = True
) -> Bound | None:
    """Return the bound of zᵀ matrix z; None where nothing limits it. ``attain``: see :func:`bound_localization`."""
    basis = allowed.basis()
    if not basis.shape[1] or len(allowed.phase) > MOST_ACTUATORS:
        return None
    limits, size = others.limits(allowed) + _magnitude_limits(allowed), np.diag(matrix) + others.sizes
    least, starts = _majorant(matrix, [(np.zeros_like(matrix), 1.0, 1.0, not allowed.scaled), *limits], basis, size)
    if not math.isfinite(least):
        return None
    scalable = not (allowed.lower > 0).any()

    energy = others.within(lambda drives: quadratic_forms(matrix[None], drives)[:, 0], scalable)

    def reached(z: np.ndarray) -> tuple[float, np.ndarray]:
        return others.scaled(best_allowed(energy, z, allowed), scalable)

    starts = starts if attain else starts[:0]
    inside = others.limits(replace(allowed, scaled=False), INSIDE) + _magnitude_limits(allowed)
    ascents = [_ascents(matrix, None, inside, allowed, size, starts)]
    if allowed.scaled:  # and drives of too much power: their energies per power
        unit = np.eye(len(matrix)) / allowed.power
        inside = [(other + entry * unit, 0.0, 0.0, False)
                  for other, entry, *_ in others.limits(replace(allowed, scaled=False), INSIDE)]  # fmt: skip
        inside += [(-unit, 1.0, 0.0, False), *_magnitude_limits(replace(allowed, power=math.inf))]
        ascents.append(_ascents(matrix, unit, inside, allowed, size, starts))
    return _bound(least, map(reached, chain.from_iterable(ascents)))


def bound_loss(
    parametrization: Parametrization,
    objectives: Objectives,
    response: Response | None,
    displacement: Response | None = None,
    *,
    attain: bool = True,
) -> Bound | None:
    """Return the lower bound of a search's loss; None where none is claimed.

    ``response`` has the energies of all drives, ``displacement`` those of ½ ∫ ρH u² dA for objectives that need them;
    None where they are not quadratic forms. ``attain``: see :func:`bound_localization`.
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
    regions = [(one.least, (response.matrices[one.region], one.energy)) for one in objectives.region_limits]
    at_most = [*rests, *(row for least, row in regions if not least)]
    others = EnergyLimits(at_most, [row for least, row in regions if least])
    attain &= len(terms) == 1
    bounds = [_bound_value(term, objectives, allowed, response, forms.get(term.kind), others, attain) for term in terms]
    proved = [bound for bound in bounds if bound is not None]
    if len(proved) < len(terms):
        return None
    total = -sum(term.weight * bound.value for term, bound in zip(terms, proved, strict=True))
    total += objectives.only_localization
    if len(terms) > 1:
        return Bound(total, "bound only")  # the sum of what each objective alone could reach
    return replace(proved[0], value=total)


def _bound_value(
    term: Objective,
    objectives: Objectives,
    allowed: AllowedDrives,
    response: Response,
    form: Response | None,
    others: EnergyLimits,
    attain: bool,
) -> Bound | None:
    """Return the bound of an objective's value, in its own unit."""
    quantity = REGION_QUANTITIES[term.kind]
    if quantity.largest is not None:
        return Bound(quantity.largest, "bound only")  # by its definition
    bound, region, whole, sound = None, TARGET, PLATE, objectives.sizes.sound
    if quantity.bounded_by == "localization":
        bound = bound_localization(response, allowed, attain=attain, others=others)
    elif quantity.bounded_by == "quietness" and has_full_rank(response.matrices[sound], allowed.basis()):
        ratio, whole = Response(response.matrices[[sound, TARGET]]), sound
        bound = bound_localization(ratio, allowed, attain=attain, others=others)
    elif quantity.bounded_by == "sound":
        bound, region = bound_energy(response.matrices[sound], allowed, others, attain), sound
    elif quantity.bounded_by == "energy" and form is not None:
        bound = bound_energy(form.matrices[TARGET], allowed, others, attain)
    if bound is None:
        return None
    energy = np.full((1, len(response.matrices)), math.nan)
    energy[:, whole], energy[:, region] = 1.0, bound.value
    value = float(quantity.evaluate(energy, objectives.sizes)[0])
    return replace(bound, value=value)


# A limit zᵀ matrix z + entry · τ² ≤ (or =) constant, with τ one more number beside z: matrix, entry, constant, and
# whether it is an equation. Of an energy τ² = 1, or τ² ≤ 1 where drives are scaled down to a power, and their ranges
# with them; in a ratio, which does not depend on the drive's size, τ is arbitrary.
_Limit = tuple[np.ndarray, float, float, bool]


def _limit(matrix: np.ndarray, largest: float, allowed: AllowedDrives) -> _Limit:
    """Return the limit zᵀ matrix z ≤ largest, which scaling a drive does not change."""
    return (matrix, 0.0, largest, False) if allowed.scaled else (matrix, -largest, 0.0, False)


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
    alike = (allowed.lower == allowed.upper).all() and not np.ptp(allowed.lower)
    if allowed.equal and not alike:  # equations that depend on each other stop an ascent at its start
        limits += [(square - squares[0], 0.0, 0.0, True) for square in squares[1:]]
    limits += _pair_limits(allowed)
    if math.isfinite(allowed.power):
        limits.append(_limit(np.eye(2 * len(squares)), allowed.power, allowed))
    return limits


def _pair_limits(allowed: AllowedDrives) -> Iterator[_Limit]:
    """Yield limits on products r_i r_j of the magnitudes of actuators whose phases are fixed."""
    fixed = allowed.with_fixed_phases
    if len(fixed) > MOST_FIXED:
        return
    parts = np.concatenate([np.diag(np.cos(allowed.phase)), np.diag(np.sin(allowed.phase))])
    for first, second in combinations(fixed, 2):
        product = np.outer(parts[:, first], parts[:, second])
        product = (product + product.T) / 2
        low, high = (float(ends[first] * ends[second]) for ends in (allowed.lower, allowed.upper))
        if allowed.equal or low == high:
            continue  # equations would leave the relaxation without an inside
        yield -product, low, 0.0, False
        if math.isfinite(high):
            yield product, -high, 0.0, False


def _majorant(
    objective: np.ndarray, limits: Sequence[_Limit], basis: np.ndarray, sizes: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the bound of zᵀ objective z, and some z (starts, 2M) at which its multipliers point.

    There are none if no multipliers were found. Actuators of very different size are scaled by the ``sizes`` (2M,), the
    energies of unit drives.
    """
    scaled = basis / _norms(basis, sizes)
    matrices, entries, constants, equations = map(np.array, zip(*limits, strict=True))
    forms = np.pad(scaled.T @ np.array([objective, *matrices]) @ scaled, ((0, 0), *2 * ((0, int(entries.any())),)))
    units = [1.0]
    if entries.any():  # τ in units in which it is about as large as a drive at the widest, or at the narrowest limit
        largest = np.abs(forms[1:]).max(axis=(1, 2))
        ratios = np.divide(np.abs(entries), largest, out=np.zeros_like(largest), where=largest > 0)
        narrowest = ratios[ratios > 0].min(initial=ratios.max())
        units = [float(value or 1.0) for value in (ratios.max(), narrowest)]
        units = units[: 1 + (units[0] > FAR * units[1])]
    majorants = []
    for unit in units:
        if entries.any():
            forms[1:, -1, -1] = entries / unit
        majorants.append(least_majorant(forms[0], forms[1:], constants, equations))
    least, slack = min(majorants, key=lambda pair: pair[0])
    if not math.isfinite(least) or not slack.any():
        return least, np.empty((0, len(basis)))
    # The smallest eigenvector, and points that vary as the relaxation's z zᵀ, the inverse of the slack, does; τ enters
    # squared, so that the slack has no entries between z and τ.
    values, vectors = np.linalg.eigh(slack[: basis.shape[1], : basis.shape[1]])
    count = max(1, STARTS // basis.shape[1])
    drawn = np.random.default_rng(0).normal(size=(len(values), count))
    drawn /= np.sqrt(np.maximum(values, EIGEN_ERROR))[:, None]
    drawn[:, 0] = np.eye(len(values))[0]
    return least, (scaled @ vectors @ drawn).T


def _norms(basis: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the roots (parameters,) of the columns' ``sizes`` (2M,), so that actuators of any strength count alike."""
    return np.asarray(np.sqrt((basis**2 * np.where(sizes > 0, sizes, 1.0)[:, None]).sum(axis=0)))


def _ascents(
    numerator: np.ndarray,
    denominator: np.ndarray | None,
    limits: Sequence[_Limit],
    allowed: AllowedDrives,
    sizes: np.ndarray,
    starts: np.ndarray,
) -> Iterator[np.ndarray]:
    """Yield the first of the starts (n, 2M), then the z (2M,) to which ascents from all of them lead."""
    yield from starts[:1]
    basis = allowed.basis()
    norms = _norms(basis, sizes)
    scaled = basis / norms
    reduced = [(scaled.T @ form @ scaled, entry - constant, equation) for form, entry, constant, equation in limits]
    top, bottom = (None if form is None else scaled.T @ form @ scaled for form in (numerator, denominator))
    assert top is not None
    # With a fixed phase, a magnitude is one number, which may not become negative.
    actuator = np.abs(basis).argmax(axis=0) % len(allowed.phase)
    least = np.where(np.isnan(allowed.phase) | (allowed.lower < 0), -math.inf, 0.0)[actuator]
    for z in starts:
        yield scaled @ local_maximum(top, bottom, reduced, least, norms * (basis.T @ z))


def _bound(value: float, drives: Iterable[tuple[float, np.ndarray]]) -> Bound:
    """Return an upper bound, attained if one of the drives, which come with their values, is within NEAR of it."""
    best, drive = -math.inf, None
    for reached, phasors in drives:
        if reached > best:
            best, drive = reached, phasors
        if best >= value * (1 - NEAR):
            return Bound(value, "attained", drive)
    return Bound(value, "bound only", drive)
