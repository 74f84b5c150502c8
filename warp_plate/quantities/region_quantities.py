"""Quantities of the motion of the plate's regions: one list for objectives, bounds, cases, sweeps and tables.

All follow from energies of regions, which are quadratic forms of the drives in a linear scene. With E, A and M a
region's energy [J], area [m²] and mass [kg], t the target and r the rest of the plate:

    localization   E_t / (E_t + E_r)
    contrast       10 log10 (E_t/A_t) / (E_r/A_r)  [dB], within ± MOST_DECIBELS
    velocity       √(2 E_t / M_t)  [m/s], the root of the mean square over the region's mass and the window
    displacement   √(2 U_t / M_t)  [m], the same of U = ½ ∫ ρH u² dA, averaged over the window
    uniformity     (Σ E_i)² / (Σ A_i · Σ E_i²/A_i), over cells i of the target; 1 where all E_i/A_i are the same
    sound          10 log10 P / 1 pW  [dB(A)], P the A-weighted sound power, in place of the energy of a region
    quietness      10 log10 ρc ∫_t v² dA / P  [dB], ρc the impedance of air
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np

from warp_plate.effects.air import AIR_DENSITY, SOUND_SPEED
from warp_plate.plate.weights import REGIONS, localization_factor
from warp_plate.quantities.sound_levels import POWER_REFERENCE

# Largest contrast of either sign [dB]: beyond it, the smaller energy is rounding.
MOST_DECIBELS = 120.0
# Share of the plate's area up to which what the target leaves counts as no rest.
LEAST_REST = 1e-9
PLATE, TARGET = REGIONS.index("plate"), REGIONS.index("target")


@dataclass(frozen=True)
class RegionSizes:
    """Sizes to which quantities refer energies."""

    areas: np.ndarray  # (2,) areas of target and rest [m²]
    masses: np.ndarray  # (2,) masses of target and rest [kg]
    cells: np.ndarray = field(default_factory=lambda: np.empty(0))  # (cells,) areas of the target's cells [m²]
    sound: int = -1  # index of the region that stands for the sound power, if there is one


@dataclass(frozen=True)
class Quantity:
    """A quantity of a plate's motion."""

    name: str  # its name in scenes and results
    unit: str  # its unit
    meaning: str  # its name for people
    # function from energies (plates, regions) of plate, target and the target's cells, and sizes, to values (plates,)
    evaluate: Callable[[np.ndarray, RegionSizes], np.ndarray]
    energy_of: Literal["velocity", "displacement"] = "velocity"  # motion whose mean squares give these energies
    is_ratio: bool = False  # true if a common factor of all drives does not change it in a linear scene
    # the bounded quantity of which it is an increasing function: the localization factor, the energy of the target, the
    # sound power, or the ratio of these; None if there is none. Without this and ``largest``, no bound is claimed
    bounded_by: Literal["localization", "energy", "sound", "quietness"] | None = None
    largest: float | None = None  # upper bound by its definition, if no other bounds it
    # function like ``evaluate`` for the rest of the plate; None if the rest has no such quantity
    of_rest: Callable[[np.ndarray, RegionSizes], np.ndarray] | None = None


def mean_square(energy: np.ndarray, mass: np.ndarray | float) -> np.ndarray:
    """Return the mean square velocity or displacement of regions of these energies and masses."""
    return np.asarray(2 * energy / mass)


def contrast(energy: np.ndarray, sizes: RegionSizes) -> np.ndarray:
    """Return the level (plates,) of the target's energy density over that of the rest [dB]; NaN for a plate at rest."""
    target, rest = (_target_and_rest(energy) / sizes.areas).T
    return np.clip(decibels(target, rest), -MOST_DECIBELS, MOST_DECIBELS)


def uniformity(energy: np.ndarray, sizes: RegionSizes) -> np.ndarray:
    """Return how evenly (plates,) the target's cells move, at most 1; NaN for a plate at rest."""
    cells = energy[:, len(REGIONS) : len(REGIONS) + sizes.cells.size]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = cells / np.abs(cells).max(axis=1, keepdims=True)  # squares of small energies would be lost
        return np.asarray(share.sum(axis=1) ** 2 / (sizes.cells.sum() * (share**2 / sizes.cells).sum(axis=1)))


def sound_level(energy: np.ndarray, sizes: RegionSizes) -> np.ndarray:
    """Return the A-weighted sound power level (plates,) [dB re 1 pW], at least −MOST_DECIBELS."""
    return np.maximum(decibels(energy[:, sizes.sound], np.array(POWER_REFERENCE)), -MOST_DECIBELS)


def quietness(energy: np.ndarray, sizes: RegionSizes) -> np.ndarray:
    """Return the sound power (plates,) of a piston that moves as the target does, over that of the plate [dB]; NaN for
    a plate at rest."""
    piston = AIR_DENSITY * SOUND_SPEED * sizes.areas[0] * mean_square(energy[:, TARGET], sizes.masses[0])
    return np.clip(decibels(piston, energy[:, sizes.sound]), -MOST_DECIBELS, MOST_DECIBELS)


def decibels(energy: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the level of energies over others [dB]; energies that rounding made negative count as zero."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(10 * (np.log10(np.maximum(energy, 0)) - np.log10(np.maximum(reference, 0))))


def _target_and_rest(energy: np.ndarray) -> np.ndarray:
    """Return energies (plates, 2) of target and rest."""
    return np.stack([energy[:, TARGET], energy[:, PLATE] - energy[:, TARGET]], axis=1)


def _rms_of(part: int, energy: np.ndarray, sizes: RegionSizes) -> np.ndarray:
    """Return the root mean square (plates,) of the velocity or displacement of the target, 0, or of the rest, 1."""
    with np.errstate(invalid="ignore", divide="ignore"):  # a target that is all of the plate has no rest
        return np.asarray(np.sqrt(mean_square(np.maximum(_target_and_rest(energy), 0), sizes.masses)))[:, part]


RMS_OF_TARGET, RMS_OF_REST = partial(_rms_of, 0), partial(_rms_of, 1)
_LIST = (
    Quantity(
        "localization",
        "1",
        "localization factor",
        lambda energy, _: localization_factor(energy),
        is_ratio=True,
        bounded_by="localization",
    ),
    Quantity("contrast", "dB", "contrast of target and rest", contrast, is_ratio=True, bounded_by="localization"),
    Quantity("velocity", "m/s", "velocity of the target", RMS_OF_TARGET, bounded_by="energy", of_rest=RMS_OF_REST),
    Quantity(
        "displacement",
        "m",
        "displacement of the target",
        RMS_OF_TARGET,
        energy_of="displacement",
        bounded_by="energy",
        of_rest=RMS_OF_REST,
    ),
    Quantity("uniformity", "1", "uniformity of the target", uniformity, is_ratio=True, largest=1.0),
    Quantity("sound", "dB(A)", "A-weighted sound power level", sound_level, bounded_by="sound"),
    Quantity("quietness", "dB", "quietness", quietness, is_ratio=True, bounded_by="quietness"),
    Quantity("energy_plate", "J", "kinetic energy of the plate", lambda energy, _: energy[:, PLATE]),
    Quantity("energy_target", "J", "kinetic energy of the target", lambda energy, _: energy[:, TARGET]),
    Quantity(
        "mean_square_velocity",
        "m^2/s^2",
        "mean square velocity",
        lambda energy, sizes: mean_square(energy[:, PLATE], sizes.masses.sum()),
    ),
)
REGION_QUANTITIES = {quantity.name: quantity for quantity in _LIST}
