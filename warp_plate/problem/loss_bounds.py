"""The smallest loss that a search could find, where that can be proved: from bounds of what its loss is made of.

The loss is −Σ weight · value, or 1 − LF, and no value can be above its own bound; so no loss is below −Σ weight ·
bound. That sum is reached only if one drive reaches all bounds: of several terms it is called a bound only.
"""

from __future__ import annotations

import math

import numpy as np

from warp_plate.plate.weights import REGIONS
from warp_plate.problem.bounds import AllowedDrives, Bound, bound_energy, bound_localization
from warp_plate.problem.design_variables import has_design_tables, only_ratios
from warp_plate.problem.objectives import MOST_DECIBELS, Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.scene.search import Objective
from warp_plate.solve.response import Response

_PLATE, _TARGET = REGIONS.index("plate"), REGIONS.index("target")


def bound_loss(
    variables: Parametrization, judge: Objectives, response: Response | None, displacement: Response | None = None
) -> Bound | None:
    """The bound of the loss; None where none is claimed.

    Args:
        variables: of a search; judge: of its losses.
        response: the energies of all drives, None where they are no quadratic forms; displacement: the same of
            ½ ∫ ρH u² dA, where displacements are judged.
    """
    if response is None or not variables.quadratic:
        return None
    allowed = allowed_drives(variables)
    forms = {"velocity": response, "displacement": displacement}
    rests = []
    for one in judge.terms:
        form = forms.get(one.kind)
        if one.rest_limit is not None and form is not None:
            rests.append((form.matrices[_PLATE] - form.matrices[_TARGET], judge.masses[1] * one.rest_limit**2 / 2))
    bounds = []
    for one in judge.terms:
        bound = _bound(one, judge, allowed, response, forms.get(one.kind), rests)
        if bound is None:
            return None
        bounds.append(_unattained(bound) if allowed.wider else bound)
    if judge.only_localization:
        return Bound(1 - bounds[0].value, bounds[0].kind, bounds[0].sentence)
    total = -sum(one.weight * bound.value for one, bound in zip(judge.terms, bounds, strict=True))
    if len(bounds) == 1:
        return Bound(total, bounds[0].kind, bounds[0].sentence)
    return Bound(total, "bound only", "the sum of what each objective alone could reach")


def _bound(
    objective: Objective,
    objectives: Objectives,
    allowed: AllowedDrives,
    response: Response,
    form: Response | None,
    rests: list[tuple[np.ndarray, float]],
) -> Bound | None:
    """Of an objective's value, in its own unit."""
    if objective.kind == "uniformity":
        return Bound(1.0, "bound only", "a uniformity is at most 1 by what it means")
    if objective.kind in ("localization", "contrast"):
        bound = bound_localization(response, allowed)
        if bound is None or objective.kind == "localization":
            return bound
        target, rest = objectives.areas
        ratio = bound.value / (1 - bound.value) * rest / target if bound.value < 1 else math.inf
        decibels = min(10 * math.log10(ratio), MOST_DECIBELS) if ratio > 0 else -MOST_DECIBELS
        return Bound(decibels, bound.kind, f"contrast grows with the localization factor, and of that {bound.sentence}")
    if form is None:
        return None
    energy = bound_energy(form.matrices[_TARGET], allowed, rests)
    if energy is None:
        return None
    return Bound(math.sqrt(2 * max(energy.value, 0.0) / objectives.masses[0]), energy.kind, energy.sentence)


def allowed_drives(variables: Parametrization) -> AllowedDrives:
    """What drives a search's positions can have, or more."""
    scene, unit = variables.scene, variables.unit
    own = has_design_tables(scene)
    count = len(scene.actuators)
    held = np.array([one.magnitude if own else unit for one in scene.actuators])
    phase = np.array([one.phase if own else 0.0 for one in scene.actuators])
    lower, upper = np.abs(held), np.abs(held)
    turned = held < 0
    equal = False
    for number in variables.numbers:
        who = list(number.actuators)
        if number.kind == "magnitude":
            lower[who], upper[who] = unit * number.lower, unit * number.upper
            turned[who] = False
            equal |= len(who) == count > 1
        elif number.kind == "phase":
            phase[who] = np.nan
    phase = np.where(turned, phase + math.pi, phase)
    limits = scene.search.limits
    if only_ratios(scene):  # a drive that is too large is taken smaller, and has the same ratios
        return AllowedDrives(lower, upper, phase, equal=equal)
    if limits.magnitude is not None:
        lower, upper = np.minimum(lower, limits.magnitude), np.minimum(upper, limits.magnitude)
    if limits.power is None:
        return AllowedDrives(lower, upper, phase, equal=equal)
    # What is brought down to the power may end below the range.
    return AllowedDrives(np.minimum(lower, 0.0), upper, phase, limits.power, equal, wider=bool((lower > 0).any()))


def _unattained(bound: Bound) -> Bound:
    """The same value, where what reaches it may be no drive of the search's."""
    sentence = "the most that any drive of this power and these largest magnitudes has; ranges may keep it lower"
    return Bound(bound.value, "bound only", sentence)
