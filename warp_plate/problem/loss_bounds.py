"""A proved lower bound of a search's loss, from bounds of the objectives.

The loss is −Σ weight · value, or 1 − LF, and no value can be above its own bound; so no loss is below −Σ weight ·
bound. That sum is reached only if one drive reaches all bounds: of several terms it is called a bound only.
"""

from __future__ import annotations

import math

import numpy as np

from warp_plate.problem.bounds import AllowedDrives, Bound, bound_energy, bound_localization
from warp_plate.problem.design_variables import has_design_tables, only_ratios
from warp_plate.problem.objectives import MOST_DECIBELS, PLATE, TARGET, Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.scene.search import Objective
from warp_plate.solve.response import Response


def bound_loss(
    parametrization: Parametrization,
    objectives: Objectives,
    response: Response | None,
    displacement: Response | None = None,
) -> Bound | None:
    """Return the bound of a search's loss; None where none is claimed.

    ``response`` and ``displacement`` are the energies of all drives and those of ½ ∫ ρH u² dA, for objectives that need
    displacements; None where they are not quadratic forms.
    """
    if response is None or not parametrization.quadratic:
        return None
    allowed = allowed_drives(parametrization)
    forms = {"velocity": response, "displacement": displacement}
    rests = []
    for term in objectives.terms:
        form = forms.get(term.kind)
        if term.rest_limit is not None and form is not None:
            rests.append((form.matrices[PLATE] - form.matrices[TARGET], objectives.masses[1] * term.rest_limit**2 / 2))
    bounds = []
    for term in objectives.terms:
        bound = _bound(term, objectives, allowed, response, forms.get(term.kind), rests)
        if bound is None:
            return None
        bounds.append(_unattained(bound) if allowed.wider else bound)
    if objectives.only_localization:
        return Bound(1 - bounds[0].value, bounds[0].kind, bounds[0].sentence)
    total = -sum(term.weight * bound.value for term, bound in zip(objectives.terms, bounds, strict=True))
    if len(bounds) == 1:
        return Bound(total, bounds[0].kind, bounds[0].sentence)
    return Bound(total, "bound only", "the sum of what each objective alone could reach")


def _bound(
    term: Objective,
    objectives: Objectives,
    allowed: AllowedDrives,
    response: Response,
    form: Response | None,
    rests: list[tuple[np.ndarray, float]],
) -> Bound | None:
    """Return the bound of an objective's value, in its own unit."""
    if term.kind == "uniformity":
        return Bound(1.0, "bound only", "a uniformity is at most 1 by its definition")
    if term.kind in ("localization", "contrast"):
        bound = bound_localization(response, allowed)
        if bound is None or term.kind == "localization":
            return bound
        target, rest = objectives.areas
        ratio = bound.value / (1 - bound.value) * rest / target if bound.value < 1 else math.inf
        decibels = min(10 * math.log10(ratio), MOST_DECIBELS) if ratio > 0 else -MOST_DECIBELS
        return Bound(decibels, bound.kind, f"contrast grows with the localization factor, and of that {bound.sentence}")
    if form is None:
        return None
    energy = bound_energy(form.matrices[TARGET], allowed, rests)
    if energy is None:
        return None
    return Bound(math.sqrt(2 * max(energy.value, 0.0) / objectives.masses[0]), energy.kind, energy.sentence)


def allowed_drives(parametrization: Parametrization) -> AllowedDrives:
    """Return a set of drives that holds all those of the search's positions."""
    scene, unit = parametrization.scene, parametrization.unit
    tables = has_design_tables(scene)
    count = len(scene.actuators)
    fixed = np.array([actuator.magnitude if tables else unit for actuator in scene.actuators])
    phase = np.array([actuator.phase if tables else 0.0 for actuator in scene.actuators])
    lower, upper = np.abs(fixed), np.abs(fixed)
    negative = fixed < 0
    equal = False
    for variable in parametrization.variables:
        group = list(variable.actuators)
        if variable.kind == "magnitude":
            lower[group], upper[group] = unit * variable.lower, unit * variable.upper
            negative[group] = False
            equal |= len(group) == count > 1
        elif variable.kind == "phase":
            phase[group] = np.nan
    phase = np.where(negative, phase + math.pi, phase)
    limits = scene.search.limits
    if only_ratios(scene):  # a drive that is too large is scaled down, and has the same ratios
        return AllowedDrives(lower, upper, phase, equal=equal)
    if limits.magnitude is not None:
        lower, upper = np.minimum(lower, limits.magnitude), np.minimum(upper, limits.magnitude)
    if limits.power is None:
        return AllowedDrives(lower, upper, phase, equal=equal)
    # A drive that is scaled down to the power may end below the range.
    return AllowedDrives(np.minimum(lower, 0.0), upper, phase, limits.power, equal, wider=bool((lower > 0).any()))


def _unattained(bound: Bound) -> Bound:
    """Return the same value, where the drive that reaches it need not be one of the search's."""
    sentence = "the most that any drive of this power and these largest magnitudes has; ranges may keep it lower"
    return Bound(bound.value, "bound only", sentence)
