"""One drive for all cases of a specification's tolerances."""

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.interrupts import check_interrupt
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.other_solutions import modes_with_responses
from warp_plate.optimize.optimizer import minimum_near
from warp_plate.problem.requirements import make_requirements
from warp_plate.problem.specified_drives import Ratios, Scaled, Tone, solve_together
from warp_plate.result.specified import Scatter
from warp_plate.scene.errors import under
from warp_plate.scene.keys import resolved_key, value_of

# Rounds of a drive for all cases of the tolerances, those of one of several frequencies that are tried for it, and how
# many frequencies.
ROTATIONS, FEW_ROTATIONS, ROBUST_TRIED = 12, 2, 5
# Relative violation that counts as none, in programs; and that of a case's best drive, of which the contrast is told.
NOTHING, OF_RETUNED = 1e-7, 1e-5
# Density of the splines of the responses in the cases.
FINER = 1.0


def contrast_of(tone: Tone, scale: float, rest: int, level: float = 1.0) -> float:
    """Return the contrast [dB] of a scale of the levels elsewhere, for a multiple of the wanted levels: that of one of
    them, by its index."""
    if not tone.requirements.rests or not math.isfinite(scale):
        return math.nan
    return decibels(scale * tone.allowed_for(level)[rest] / (level * tone.wanted.min()))


def nearest_rest(levels: Ratios) -> int:
    """Return the index of the level elsewhere that is nearest to what is allowed, of levels over those; 0 for none."""
    return int(levels[1].argmax()) if levels[1].size else 0


def decibels(ratio: float) -> float:
    """Return the decibels of a ratio of amplitudes."""
    return 20 * math.log10(ratio) if ratio > 0 else -math.inf


def drive_for_cases(
    tone: Tone, scaled: Scaled, starts: Sequence[tuple[float, np.ndarray]]
) -> tuple[float, np.ndarray, list[Scatter]]:
    """Return the frequency [Hz] and the one drive (actuators,) for all cases of the tolerances; and the cases.

    The drive is sought at several frequencies, from a drive for each; first comes the drive of the nominal scene.
    """
    scene, specification = tone.plate.scene, tone.requirements.specification
    keys = {resolved_key(scene, key): part for key, part in specification.tolerance.items()}
    cases = [dict(zip(keys, signs, strict=True)) for signs in itertools.product((-1, 0, 1), repeat=len(keys))]
    factors = [{key: 1 + sign * keys[key] for key, sign in case.items()} for case in cases]
    tones = []
    for case in factors:
        check_interrupt()
        named = ", ".join(f"{key} × {factor:g}" for key, factor in case.items() if factor != 1)
        with under(named and f"specification.tolerance: {named}"):
            varied = scene.with_values({key: float(value_of(scene, key)) * factor for key, factor in case.items()})
            plate = solve_modes(varied, max(frequency for frequency, _ in starts), key=specification.frequency_key)
            tones.append(replace(tone, plate=plate, requirements=make_requirements(plate), points={}))

    def at(frequency: float, some: Sequence[Tone] = tones) -> list[Tone]:
        return [replace(one, frequency=frequency, points=dict(one.points)) for one in some]

    def rough(frequency: float, drive: np.ndarray) -> tuple[float, np.ndarray]:
        tried = at(frequency)
        result = _drive_for_all(tried, scaled, drive, FEW_ROTATIONS)
        for one, before in zip(tried, tones, strict=True):
            before.points = one.points  # of the next frequency most are the same
        return result

    nominal_frequency, nominal = starts[0]
    tried, places = [rough(*start) for start in starts], np.array([frequency for frequency, _ in starts])
    chosen = min(range(len(tried)), key=lambda k: tried[k][0])
    frequency, (least, robust) = float(places[chosen]), tried[chosen]
    if chosen:
        place, value, _ = minimum_near(lambda x: rough(x, robust)[0], places[1:], chosen - 1, 1e-3, ROBUST_TRIED)
        frequency = place if value < least else frequency
    there = at(frequency)
    robust = _drive_for_all(there, scaled, robust)[1]
    finer = [refined(one, {nominal_frequency, frequency}, FINER) for one in there]
    last = solve_together(_rotated(finer, robust), scaled, start=robust, searches=0)
    robust = last.drive if math.isfinite(last.scale) else robust
    rows = []
    for before, one, case in zip(at(nominal_frequency, finer), finer, factors, strict=True):
        nominal_level, nominal_db = _level_and_contrast(before, before.reached(nominal))
        robust_levels = one.reached(robust)
        robust_level, robust_db = _level_and_contrast(one, robust_levels)
        retuned = contrast_of(one, one.solve(scaled, slack=OF_RETUNED).scale, nearest_rest(robust_levels))
        met = one.is_met(robust, NOTHING)
        rows.append(Scatter(case, nominal_level, nominal_db, robust_level, robust_db, retuned, met))
    return frequency, robust, rows


def refined(tone: Tone, frequencies: Collection[float], density: float) -> Tone:
    """Return a tone for some frequencies [Hz] by more functions, see :func:`modes_with_responses`; or the same."""
    check_interrupt()
    plate = modes_with_responses(tone.plate, frequencies, density)
    return tone if plate is None else replace(tone, plate=plate, requirements=make_requirements(plate))


def _drive_for_all(
    tones: Sequence[Tone], scaled: Scaled, drive: np.ndarray, rounds: int = ROTATIONS
) -> tuple[float, np.ndarray]:
    """Return the scale of the best drive for all tones, and this drive (actuators,), in rounds from a given one, which
    is returned if none reaches the levels of all; roughly, at samples."""
    least = math.inf
    for _ in range(rounds):
        check_interrupt()
        result = solve_together(_rotated(tones, drive), scaled, slack=None, start=drive, searches=0)
        if not result.scale < least * (1 - 1e-4):
            break
        least, drive = result.scale, result.drive
    return least, drive


def _rotated(tones: Sequence[Tone], drive: np.ndarray) -> list[Tone]:
    """Return tones that ask for the phases and levels that a drive reaches, scaled to the wanted ones in the worst."""
    rotated = [tone.rotated(drive) for tone in tones]
    least = min(tone.reach for tone in rotated)
    for tone in rotated:
        tone.reach /= least
    return rotated


def _level_and_contrast(tone: Tone, levels: Ratios) -> tuple[float, float]:
    """Return the least level of a drive over the wanted one, and the contrast [dB] or NaN."""
    in_aims, in_rests = levels
    scale = in_rests.max() / in_aims.min() if in_rests.size else math.nan
    return float(in_aims.min()), contrast_of(tone, scale, nearest_rest(levels))
