"""The frequency of a range at which a specification is met best, or worst in a band."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warp_plate.interrupts import check_interrupt
from warp_plate.modal.modes import ModalPlate
from warp_plate.optimize.cones import LeastScale
from warp_plate.optimize.optimizer import minimum_near
from warp_plate.problem.specified_drives import TOLERANCE, Scaled, Tone

# Frequencies of a range that are tried, besides resonances, and the relative accuracy of the best one.
TRIED, FREQUENCY_ACCURACY = 24, 1e-5


def frequencies_to_try(plate: ModalPlate, low: float, high: float) -> np.ndarray:
    """Return the frequencies [Hz] to try: evenly spaced ones, the resonances and places beside these."""
    if low == high:
        return np.array([low])
    centres, widths = (values[plate.resonances[1] > 0] for values in plate.resonances)
    beside = np.concatenate([centres + shift * widths for shift in (-2, -1, 0, 1, 2)])
    beside = beside[(beside > low) & (beside < high)]
    return np.unique(np.concatenate([np.geomspace(low, high, TRIED), beside]))


def best_tone(tones: Sequence[Tone], scales: list[LeastScale], scaled: Scaled) -> tuple[Tone, np.ndarray | None]:
    """Return the tone of the best frequency, or of the worst one in a band, from tones and their scales at the samples;
    and a drive to start a search from.

    Some scales are replaced by those between samples.
    """
    chosen = _choose(tones, scales, scaled)
    tone = tones[chosen]
    if 0 < chosen < len(tones) - 1 and math.isfinite(scales[chosen].scale):
        tone = _between(tones, scales, scaled, chosen)
    return tone, scales[chosen].start


def _order(tone: Tone, result: LeastScale) -> tuple[bool, float]:
    """Return a key that sorts frequencies, the best first: by scale, or by effort where the levels are not reached."""
    if math.isfinite(result.scale):
        return False, result.scale
    return True, tone.solve("actuators alone", slack=None).scale


def _choose(tones: Sequence[Tone], scales: list[LeastScale], scaled: Scaled) -> int:
    """Return the index of the best of the tones, or of the worst one of a band.

    Where phases are free, scales are those at the samples, which may be far too small. They are replaced by those that
    hold between samples, the least first, until one is less than all others.
    """
    orders = [_order(tone, result) for tone, result in zip(tones, scales, strict=True)]
    indices = sorted(range(len(tones)), key=orders.__getitem__)
    if tones[0].requirements.specification.band:
        return indices[-1]
    best = indices[0]
    for k in indices if tones[0].requirements.phases_free and len(tones) > 1 else ():
        if k != best and orders[k] >= orders[best]:
            break
        check_interrupt()
        scales[k] = tones[k].solve(scaled, start=scales[k].start, searches=1)
        orders[k] = _order(tones[k], scales[k])
        best = min(best, k, key=orders.__getitem__)
    return best


def _between(tones: Sequence[Tone], scales: Sequence[LeastScale], scaled: Scaled, chosen: int) -> Tone:
    """Return the tone of the best frequency near that of a tone, or of the worst one of a band."""
    tone, start = tones[chosen], scales[chosen].drive
    requirements = tone.requirements
    sign = -1.0 if requirements.specification.band else 1.0

    def scale(frequency: float) -> float:
        check_interrupt()
        one = replace(tone, frequency=frequency)
        slack = TOLERANCE if requirements.phases_free else None
        return sign * one.solve(scaled, slack=slack, start=start, searches=0).scale

    frequencies = np.array([one.frequency for one in tones])
    best, least, _ = minimum_near(scale, frequencies, chosen, FREQUENCY_ACCURACY, 30)
    return replace(tone, frequency=best) if least < sign * scales[chosen].scale else tone
