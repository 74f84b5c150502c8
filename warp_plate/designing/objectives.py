"""What a design maximises and limits, from the quadratic forms of a panel's motion, with slopes by these forms.

Values are those of :mod:`warp_plate.quantities.region_quantities`. But for localization factors, the logarithm to the
base 10 counts, with a minus where the quantity is lowered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.sensitivity.forms import PlateForms
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.quantities.sound_levels import POWER_REFERENCE
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import Design, DesignLimits
from warp_plate.scene.model import Scene
from warp_plate.solve.response import largest_ratio

# Form of each quantity: of root mean squares over the mass of the target, of others, and of efforts.
AMPLITUDES = {"velocity": "target", "displacement": "displacement", "acceleration": "acceleration"}
FORM_OF_QUANTITY = {**AMPLITUDES, "energy_target": "target", "sound": "sound", "power": "power"}
LOWERED = ("sound", "power")
# Part of the largest effort of combinations of drives that is none, as its slopes are hidden by rounding; and part of
# the largest motion that is rounding.
NO_EFFORT, ROUNDING = 1e-8, 1e-13
# Key of each limit on a motion under the scene's drive, and the quantity.
LEAST = {"energy_target": "energy_target", **{f"least_{name}": name for name in AMPLITUDES}}
# Natural frequencies on either side of the gap that count.
NEAR = 6


@dataclass(frozen=True)
class Judged:
    """A number of a panel, and its slopes by the forms under a drive."""

    value: float
    phasors: np.ndarray  # (M,) drive
    weights: dict[str, float]  # slope by each form, by its name
    by_target: float = 0.0  # slope by the mass of the target [1/kg]


def judge(design: Design, forms: PlateForms) -> Judged:
    """Return what a design maximises."""
    objective, effort = design.objective, design.effort
    if objective in ("bound", "drive"):
        both = np.stack([forms["plate"], forms["target"]])
        value, phasors = largest(both)
        if objective == "drive":
            phasors = scene_phasors(forms.scene)
            value = float(localization_factor(quadratic_forms(both, phasors[None]))[0])
        plate = quadratic_forms(both, phasors[None])[0, 0]
        return Judged(value, phasors, {"plate": -value / plate, "target": 1 / plate})
    name, phasors = FORM_OF_QUANTITY[objective], scene_phasors(forms.scene)
    if effort is not None:
        of_effort = np.eye(len(forms[name])) if effort == "drive" else forms[effort]
        if _is_unlimited(of_effort, forms[name]):
            raise SceneError(
                f'design.effort = "{effort}": some drives move the target with hardly any, which sets no limit; '
                'write damping, fewer actuators, or effort = "drive"'
            )
        phasors = largest(np.stack([of_effort, forms[name]]))[1]
    size = _of(forms[name], phasors)
    if not size > 0:
        raise SceneError("actuators: the scene's drive does not move the target; write other magnitudes")
    share = (-1 if design.lowers else 1) * (0.5 if objective in AMPLITUDES else 1)
    value, weights, by_target = share * math.log10(size), {name: share / (size * math.log(10))}, 0.0
    if effort is not None:
        size = _of(of_effort, phasors)
        value -= share * math.log10(size)
        if effort != "drive":
            weights[effort] = -share / (size * math.log(10))
    if objective in AMPLITUDES:
        mass = target_mass(forms)
        value, by_target = value + share * math.log10(2 / mass), -share / (mass * math.log(10))
    return Judged(value, phasors, weights, by_target)


def shown(design: Design, value: float) -> float:
    """Return the quantity in its unit from what is maximised."""
    if design.objective in ("bound", "drive"):
        return value
    if design.objective == "sound":
        return 10 * (-value - math.log10(POWER_REFERENCE))
    return float(10 ** (-value if design.objective == "power" else value))


def limits(design: Design, forms: PlateForms, margin: float = 0.0) -> Iterator[tuple[str, Judged]]:
    """Yield the keys of limits on the motion under the scene's drive and by what part each is passed, the limits being
    narrower by a part ``margin`` of a form."""
    given, phasors = design.limits, scene_phasors(forms.scene)
    for key, quantity in LEAST.items():
        if (least := getattr(given, key)) is not None:
            name = FORM_OF_QUANTITY[quantity]
            size = _of(forms[name], phasors)
            if quantity in AMPLITUDES:
                least, mass = least * math.sqrt(1 + margin), target_mass(forms)
                part = math.sqrt(2 * size / mass) / least
                yield key, Judged(1 - part, phasors, {name: -part / (2 * size)}, part / (2 * mass))
            else:
                least *= 1 + margin
                yield key, Judged(1 - size / least, phasors, {name: -1 / least})
    most = {"sound": None if given.sound is None else POWER_REFERENCE * 10 ** (given.sound / 10), "power": given.power}
    for name, largest_one in most.items():
        if largest_one is not None:
            narrower = largest_one * (1 - margin)
            yield name, Judged(_of(forms[name], phasors) / narrower - 1, phasors, {name: 1 / narrower})


def check_steady(design: Design, scene: Scene) -> None:
    """Raise a SceneError, naming the key, if a quantity needs a steady state that the scene does not have."""
    used: dict[str, str | None] = {"design.objective": design.objective, "design.effort": design.effort}
    given = (key for key in DesignLimits.model_fields if getattr(design.limits, key) is not None)
    used |= {f"design.limits.{key}": key for key in given}
    steady = ("acceleration", "least_acceleration", *LOWERED)
    key = next((key for key, name in used.items() if name in steady), None)
    if key is not None and not (design.steady or scene.steady):
        raise SceneError(f"{key}: {used[key]} is that of a steady state; write design.steady = true")
    sounds = next((key for key, name in used.items() if name == "sound"), None)
    if sounds is not None and scene.effects.air is not None and not scene.effects.air.baffle:
        raise SceneError(f"{sounds}: sound is that of a plate in a baffle; delete effects.air.baffle")


def check_gap(design: Design, natural: np.ndarray) -> None:
    """Raise a SceneError unless some natural frequencies (n,) [Hz] of a panel, rising, are above the gap, which would
    mean nothing without them."""
    gap, highest = design.limits.gap, float(natural[-NEAR:][0])
    if gap is not None and gap[1] >= highest:
        least = f"must end below {highest:.5g} Hz, up to which natural frequencies are computed for this drive"
        raise SceneError(f"design.limits.gap = {list(gap)}: {least}")


def uses_sound(design: Design) -> bool:
    """Return whether the sound of the plate counts."""
    return "sound" in (design.objective, design.effort) or design.limits.sound is not None


def largest(both: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the largest ratio of the second of two forms (2, 2M, 2M) to the first, and phasors (M,) that have it."""
    value, z = largest_ratio(both)
    if not np.isfinite(value):
        raise SceneError("actuators: no drive moves the plate; move them off the edges")
    cosine, sine = np.split(z, 2)
    return float(value), cosine - 1j * sine


def target_mass(forms: PlateForms) -> float:
    """Return the mass of the target [kg]."""
    return forms.plate.space.region_mass(forms.scene.target)


def _is_unlimited(effort: np.ndarray, moved: np.ndarray) -> bool:
    """Return whether some drives have a part in a form (2M, 2M) of motion, and hardly any in one of an effort."""
    scale = np.sqrt(np.maximum(np.diag(effort), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(effort / np.outer(scale, scale))
    free = vectors[:, values <= NO_EFFORT * values[-1]] / scale[:, None]
    lengths = np.linalg.norm(free, axis=0)
    parts = np.diag(free.T @ moved @ free) / lengths**2
    return bool((parts > ROUNDING * np.linalg.norm(moved, 2)).any())


def _of(form: np.ndarray, phasors: np.ndarray) -> float:
    return float(quadratic_forms(form[None], phasors[None])[0, 0])
