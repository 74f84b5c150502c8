"""Judge whether a fitted model describes the measurements, and the likely cause if it does not.

Errors r = log(H / Hₘ) of responses have a systematic part, the mean of r_k r*_{k+1} over neighbouring frequencies, in
which noise averages out. If it is large, the shape of the responses over frequency is fitted alone: factors and powers
of iω of each response do not count, so that the resonances set the free numbers. With these, the errors follow for
factors and powers of the data, for other orders of the sensors, and for mirrored or turned points, and the best one is
fitted again. Errors of natural frequencies are compared with those after a mode is left out or other units are taken.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from warp_plate.fitting.measured_modes import MeasuredModes
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.measured_tables import GRAVITY
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import Measurement
from warp_plate.scene.model import Scene

# Systematic errors of responses (in nepers and rad): the largest, those for which a cause is looked for, and the size
# from which on errors count alike. Largest error of frequencies.
LARGEST_ERROR, NOTABLE_ERROR, CAPPED, LARGEST_OF_MODES = 0.4, 0.2, 1.0, 0.03
# The same for which an exponential window is looked for, whose damping a fitted one conceals.
NOTABLE_DECAY = 0.03
# Part of the error that a cause may leave, the same of errors with noise, and error of frequencies for which one is
# looked for.
LEFT, LEFT_WITH_NOISE, NOTABLE = 0.4, 0.6, 0.005
# Sensors whose orders are tried, and the part of the error by which a cause for single sensors must be better.
MOST_ORDERED, SINGLE = 4, 0.7
# Mean MAC below which mirrored points are tried, its rise at which they are reported, and what is poor in any case.
LEAST_MAC, NOTABLE_MAC, POOR_MAC = 0.8, 0.1, 0.5
# Shear correction factor (Mindlin, J. Appl. Mech. 18, 1951), and the error of thin-plate theory that is remarked.
SHEAR, THICK = 5 / 6, 0.02
# Factors that frequencies may be off by.
FREQUENCY_FACTORS = {"rad/s": 2 * math.pi, "hertz, not rad/s": 0.5 / math.pi, "kHz": 1e-3, "hertz, not kHz": 1e3}


@dataclass(frozen=True)
class Verdict:
    """Judgement of a model by measurements."""

    describes: bool
    error: float  # systematic rms error of log H, or relative rms error of frequencies
    cause: str | None = None  # the likely cause: "sign", "gravity", ...; None if none was found, or none is needed
    text: str = ""  # what to print; "" for nothing

    @property
    def lines(self) -> tuple[str, ...]:
        """The text as warnings."""
        return (self.text,) if self.text else ()


def systematic_error(errors: np.ndarray) -> np.ndarray:
    """Return (m,) systematic rms errors of (m, n) complex errors, outliers capped, without white noise."""
    capped = errors * np.minimum(1, 3 / np.maximum(np.abs(errors), 1e-30))
    return np.sqrt(np.maximum(np.mean((capped[:, 1:] * capped[:, :-1].conj()).real, axis=1), 0))


def thin_plate_error(scene: Scene, frequency: float) -> float:
    """Return how much too high thin-plate theory is for the frequency [Hz] of a bending wave, relative.

    Rotary inertia and shear divide ω² by 1 + (kH)²/12 (1 + 2/(κ(1 − ν))), with the wavenumber k of the thin plate.
    """
    plate = scene.plate
    rigidity = min(scene.effects.rigidities[::2]) if scene.effects.rigidities else plate.rigidity
    wave = 2 * math.pi * frequency * plate.thickness**2 * math.sqrt(plate.density * plate.thickness / rigidity)
    return math.sqrt(1 + wave / 12 * (1 + 2 / (SHEAR * (1 - plate.poisson_ratio)))) - 1


def _thick(scene: Scene, frequency: float) -> str:
    """Return a line on the thickness, "" for a plate that is thin enough."""
    error = thin_plate_error(scene, frequency)
    if error < THICK:
        return ""
    return (
        f"thin-plate theory is {100 * error:.2g} % too high for the highest fitted frequency, {frequency:.4g} Hz: "
        "shear and rotary inertia, which it neglects, matter"
    )


def _failure(error: str, cause: str) -> str:
    return f"The model does not describe these data: {error}. {cause}"


def _left(error: float) -> str:
    return f"this leaves {20 / np.log(10) * error:.2g} dB"


def _unexplained(error: float, said: str, thick: str, at_limit: Sequence[str], tried: str) -> Verdict:
    """Return the verdict on an error for which no cause was found among those ``tried`` in the data."""
    if thick:
        return Verdict(False, error, "thick", _failure(said, f"Likely cause: {thick}."))
    if at_limit:
        return Verdict(False, error, "range", _failure(said, f"{at_limit[0]} is at an end of its range: widen it."))
    return Verdict(False, error, None, _failure(said, f"No cause was found among {tried}."))


# Causes in the data of responses: a name, what to do, and the logarithm of H / Hₘ that they make, for iω (n,).
Cause = tuple[str, str, Callable[[np.ndarray], np.ndarray]]


def _data_causes(quantity: str, adapted: bool) -> list[Cause]:
    """Return the causes in the data of a response in a quantity; without factors if a gain is fitted."""

    def constant(factor: complex) -> Callable[[np.ndarray], np.ndarray]:
        return lambda omega: np.full(omega.shape, np.log(complex(factor)))

    def power(order: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda omega: order * np.log(omega)

    names = ("receptance", "mobility", "accelerance")
    found: list[Cause] = [
        ("sign", "the sign is reversed: negate gain", constant(-1)),
        ("gravity", f"the responses are in g: divide gain by {GRAVITY}", constant(GRAVITY)),
        ("gravity", f"a factor of {GRAVITY} is applied twice: multiply gain by it", constant(1 / GRAVITY)),
        ("sign and gravity", f"negate gain and divide it by {GRAVITY}", constant(-GRAVITY)),
        ("sign and gravity", f"negate gain and multiply it by {GRAVITY}", constant(-1 / GRAVITY)),
        ("thousand", "the responses are a thousand times too small: divide gain by 1000", constant(1e3)),
        ("thousand", "the responses are a thousand times too large: multiply gain by 1000", constant(1e-3)),
    ]
    found, order = found[: 1 if adapted else None], names.index(quantity)
    found += [
        ("quantity", f'the responses are of another quantity: write quantity = "{name}"', power(order - other))
        for other, name in enumerate(names)
        if other != order
    ]
    return found


def free_keys(scene: Scene) -> Sequence[str]:
    """Return the keys under ``[fit.free]``."""
    return [] if scene.fit is None else [key.strip() for key in scene.fit.free]


def _wrapped(errors: np.ndarray) -> np.ndarray:
    """Return errors with phases within ±π."""
    return errors.real + 1j * ((errors.imag + np.pi) % (2 * np.pi) - np.pi)


def _size(errors: np.ndarray) -> np.ndarray:
    """Return (m,) mean sizes of errors, those above a limit as the limit."""
    return np.minimum(np.abs(_wrapped(errors)), CAPPED).mean(axis=1)


def moves(width: float, height: float) -> dict[str, tuple[str, Callable[[float, float], tuple[float, float]]]]:
    """Return explanations and functions of points x, y that are mirrored or turned on a plate, by name."""
    return {
        "mirrored in x": ("points or edges are mirrored: x counts from the right", lambda x, y: (width - x, y)),
        "mirrored in y": ("points or edges are mirrored: y counts from the top", lambda x, y: (x, height - y)),
        "turned": ("the panel is turned by 180°", lambda x, y: (width - x, height - y)),
        "transposed": ("x and y of the points are exchanged", lambda x, y: (y, x)),
    }


def _geometries(rows: Sequence[Measurement], size: tuple[float, float]) -> Iterator[tuple[str, str, list[Measurement]]]:
    """Yield name, explanation and rows of places that are mirrored or turned."""
    width, height = size
    for name, (text, move) in moves(width, height).items():
        named = [{"point": row.point} | ({"force_at": row.force_at} if row.force_at else {}) for row in rows]
        places = [{key: move(*point) for key, point in of.items()} for of in named]
        if any(row.actuator for row in rows) or any(x > width or y > height for at in places for x, y in at.values()):
            continue
        yield name, text, [row.model_copy(update=at) for row, at in zip(rows, places, strict=True)]


class Alternatives(Protocol):
    """Responses at other places, and fits to other data."""

    measured: MeasuredResponses

    def respond(self, rows: Sequence[Measurement]) -> np.ndarray:
        """Return responses (m, n) between the places of rows, of the panel whose resonances are those of the data."""

    def refit(self, rows: Sequence[Measurement], responses: np.ndarray) -> np.ndarray:
        """Return errors log(H / Hₘ) (m, n) of a fit between the places of rows to other responses (m, n)."""

    def of_data(self, responses: np.ndarray) -> Alternatives:
        """Return the same for other responses (m, n), whose resonances may differ."""

    def refit_decay(self, scene: Scene) -> tuple[float, np.ndarray]:
        """Return the decay rate [1/s] that measured responses have and those of a fitted scene lack, and the errors
        log(H / Hₘ) (m, n) of a fit with it."""


def judge_responses(scene: Scene, errors: np.ndarray, alternatives: Alternatives, at_limit: Sequence[str]) -> Verdict:
    """Return the verdict on errors log(H / Hₘ) (m, n) of a fitted scene.

    Args:
        scene: Fitted scene.
        errors: Errors of the fit.
        alternatives: Responses and fits that find the cause of large errors.
        at_limit: Free keys at an end of their range.
    """
    error = float(systematic_error(errors).max())
    thick = _thick(scene, alternatives.measured.frequencies[-1])
    level, angle = 20 / np.log(10) * np.sqrt(np.mean(errors.real**2)), np.degrees(np.sqrt(np.mean(errors.imag**2)))
    said = f"rms error {level:.2g} dB and {angle:.0f}°"
    if clipped := alternatives.measured.clipped:
        text = f"{' and '.join(clipped)}: clipped by an overload, so that no interval holds; measure with less gain"
        return Verdict(False, error, "clipped", text)
    for cause, text, rows, data in _ranked(scene, alternatives) if error > NOTABLE_ERROR else ():
        left = float(systematic_error(alternatives.refit(rows, data)).max())
        if left < LEFT * error and left <= 2 * LARGEST_ERROR:
            return Verdict(False, error, cause, _failure(said, f"Likely cause: {text} ({_left(left)})."))
    if error > NOTABLE_DECAY:
        rate, others = alternatives.refit_decay(scene)
        left = float(systematic_error(others).max())
        smaller = _size(others).mean() < LEFT_WITH_NOISE * _size(errors).mean()
        if smaller and left < LEFT * error and (error > NOTABLE_ERROR or left < LEFT**2 * error):
            key = "fit.signals.exponential" if scene.fit and scene.fit.signals else "fit.exponential"
            window = 1 / (alternatives.measured.decay + rate)
            text = f"an exponential window, for all modes decay faster by {rate:.2g}/s ({_left(left)}): write {key} = "
            text += f"{window:.2g}, or if there is none, free effects.damping.viscous"
            return Verdict(False, error, "exponential window", _failure(said, f"Likely cause: {text}."))
    for channel, data in _force_channels(scene, alternatives.measured.responses) if error > LARGEST_ERROR else ():
        left = float(systematic_error(alternatives.of_data(data).refit(list(scene.measurement), data)).max())
        if left < LEFT * error:
            text = f"the force is in channel {channel} ({_left(left)}): write fit.signals.force_channel = {channel}"
            return Verdict(False, error, "channels", _failure(said, f"Likely cause: {text}."))
    if error <= LARGEST_ERROR:
        return Verdict(True, error, None, thick[:1].upper() + thick[1:])
    return _unexplained(error, said, thick, at_limit, "sign, units, quantity, order, mirror, exponential window")


def _force_channels(scene: Scene, responses: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield other channels of one file of time signals, from 1, and the responses (m, n) if they hold the force."""
    signals, count = scene.fit.signals if scene.fit else None, len(responses)
    if signals is None or signals.force_channel > count + 1:
        return
    held = signals.force_channel - 1
    motions = [channel for channel in range(count + 1) if channel != held]
    for row, channel in enumerate(motions):
        ratios = {held: 1 / responses[row]}
        ratios |= {other: responses[index] / responses[row] for index, other in enumerate(motions) if index != row}
        yield channel + 1, np.array([ratios[other] for other in sorted(ratios)])


def _ranked(scene: Scene, alternatives: Alternatives) -> list[tuple[str, str, Sequence[Measurement], np.ndarray]]:
    """Return the most likely causes, the best first, each with its places and data."""
    measured, respond = alternatives.measured, alternatives.respond
    rows, data, omega = list(scene.measurement), measured.responses, 2j * np.pi * measured.frequencies
    here, adapted = respond(rows), np.array([f"measurement[{i}].gain" in free_keys(scene) for i in range(len(rows))])

    def size_of(predicted: np.ndarray, to: np.ndarray) -> np.ndarray:
        errors = np.log(predicted / to)
        return _size(errors - np.where(adapted[:, None], errors.real.mean(axis=1, keepdims=True), 0))

    found: list[tuple[float, str, str, Sequence[Measurement], np.ndarray]] = []
    causes = [_data_causes(row.quantity, bool(adapted.any())) for row in rows]
    plain = size_of(here, data)
    for column, (name, text, _) in enumerate(causes[0]):
        changed = np.array([data[i] * np.exp(causes[i][column][2](omega)) for i in range(len(rows))])
        sizes = size_of(here, changed)
        found.append((float(sizes.mean()), name, text, rows, changed))
        for index in range(len(rows) if len(rows) > 1 else 0):
            single = np.where(np.arange(len(rows)) == index, sizes, plain).mean() / SINGLE
            one = np.where(np.arange(len(rows))[:, None] == index, changed, data)
            where = f"measurement[{index}]: {causes[index][column][1]}"
            found.append((float(single), f"{name} of a sensor", where, rows, one))
    conjugate = size_of(here, data.conj()).mean()
    found.append((float(conjugate), "phase", "phases have the other sign, of exp(−iωt)", rows, data.conj()))
    for order in itertools.permutations(range(len(rows))) if 1 < len(rows) <= MOST_ORDERED else ():
        if order != tuple(range(len(rows))):
            size, moved = size_of(here, data[list(order)]).mean(), ", ".join(map(str, order))
            found.append((float(size), "order", f"sensors are in the order {moved}", rows, data[list(order)]))
    for name, text, places in _geometries(rows, scene.plate.size):
        with suppress(SceneError):  # a place that an edge holds
            found.append((float(size_of(respond(places), data).mean()), name, text, places, data))
    ranked = sorted(found, key=lambda each: each[0])[:2]
    return [each[1:] for each in ranked if each[0] < plain.mean()]


@dataclass(frozen=True, eq=False)
class ModesToJudge:
    """Measured modes beside fitted ones."""

    measured: MeasuredModes
    numbers: np.ndarray  # (n,) numbers of the fitted ones, from 1
    frequencies: np.ndarray  # (n,) their frequencies [Hz]
    computed: np.ndarray  # frequencies of all modes of the fitted panel, by rising number
    mac: float = 1.0  # mean MAC of measured and fitted shapes
    # mean MAC of measured shapes and those at points (points, 2) that are most alike
    assurance: Callable[[np.ndarray], float] = lambda points: 1.0


def judge_modes(
    scene: Scene, judged: ModesToJudge, refit: Callable[[MeasuredModes], np.ndarray], at_limit: Sequence[str]
) -> Verdict:
    """Return the verdict on fitted modes of a scene.

    Args:
        scene: Fitted scene.
        judged: Its modes.
        refit: Relative errors of a fit to other modes.
        at_limit: Free keys at an end of their range.
    """
    measured, numbers, frequencies = judged.measured, judged.numbers, judged.frequencies
    errors = frequencies / measured.frequencies - 1
    error = float(np.sqrt(np.mean(errors**2)))
    thick = _thick(scene, float(measured.frequencies.max()))
    ordered = measured.numbers is None and np.array_equal(numbers, np.arange(1, len(numbers) + 1))
    said = f"rms error {100 * error:.2g} % of the frequencies"
    if judged.mac < LEAST_MAC and (verdict := _verdict_on_shapes(scene, judged, error)) is not None:
        return verdict
    for cause, text, changed in _other_modes(measured, judged.computed, ordered) if error > NOTABLE else ():
        left = float(np.sqrt(np.mean(refit(changed) ** 2)))
        if left < LEFT * error and (error > LARGEST_OF_MODES or left < LEFT**2 * error):
            text = f"Likely cause: {text} (this leaves {100 * left:.2g} %)."
            return Verdict(False, error, cause, _failure(said, text))
    if error <= LARGEST_OF_MODES:
        return Verdict(True, error, None, thick[:1].upper() + thick[1:])
    return _unexplained(error, said, thick, at_limit, "units, a missing and a further mode")


def _verdict_on_shapes(scene: Scene, judged: ModesToJudge, error: float) -> Verdict | None:
    """Return the verdict on shapes that are not those of the fitted panel; None if they may be."""
    (width, height), points = scene.plate.size, np.asarray(judged.measured.points)
    best = (judged.mac + NOTABLE_MAC, "", "")
    for name, (text, move) in moves(width, height).items():
        moved = np.array([move(*point) for point in points])
        if np.all(moved <= (width, height)):
            best = max(best, (judged.assurance(moved), name, text))
    said, (found, name, text) = f"the mean MAC of the shapes is {judged.mac:.2f}", best
    if name:
        return Verdict(False, error, name, _failure(said, f"Likely cause: {text} (the MAC is then {found:.2f})."))
    if judged.mac > POOR_MAC:
        return None
    return Verdict(False, error, None, _failure(said, "No cause was found: the points are not mirrored or turned."))


def _other_modes(
    measured: MeasuredModes, computed: np.ndarray, ordered: bool
) -> Iterator[tuple[str, str, MeasuredModes]]:
    """Yield causes, the most likely first, and the modes without them."""
    count, logs = len(measured.frequencies), np.log(measured.frequencies)

    def spread(numbers: np.ndarray, of: np.ndarray) -> float:
        return float(np.std(np.log(computed[numbers - 1]) - of)) if numbers.max() <= len(computed) else math.inf

    numbers = np.arange(1, count + 1) if measured.numbers is None else measured.numbers
    if spread(numbers, logs) < LARGEST_OF_MODES:
        shift = float(np.mean(np.log(computed[numbers - 1]) - logs))
        by_factor = sorted(FREQUENCY_FACTORS.items(), key=lambda each: abs(shift + math.log(each[1])))
        for unit, factor in by_factor[:2]:
            yield "unit", f"frequencies are in {unit}", replace(measured, frequencies=measured.frequencies / factor)
    if not ordered:
        return
    found: list[tuple[float, str, str, MeasuredModes]] = []
    for at in range(count):
        skipped = numbers + (np.arange(count) >= at)
        found.append((spread(skipped, logs), "missing mode", f"mode {at + 1} is missing; number the modes, or use "
                      'fit.pairing = "nearest"', replace(measured, numbers=skipped)))  # fmt: skip
        if count > 2:
            fewer = np.delete(np.arange(count), at)
            frequencies, damping = measured.frequencies[fewer], measured.damping[fewer]
            shapes = None if measured.shapes is None else measured.shapes[fewer]
            without = replace(measured, frequencies=frequencies, damping=damping, shapes=shapes)
            named = f"{measured.frequencies[at]:.4g} Hz is no mode of this panel"
            found.append((spread(numbers[:-1], logs[fewer]), "further mode", named, without))
    yield from (each[1:] for each in sorted(found, key=lambda each: each[0])[:2])
