"""The drive that meets a scene's specification, or the proof that none does."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.interrupts import check_interrupt
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.other_solutions import coarser_modes
from warp_plate.optimize.cones import LeastScale
from warp_plate.problem.requirements import make_requirements
from warp_plate.problem.specified_drives import Ratios, Scaled, Tone
from warp_plate.result.specified import Margin, SpecifiedDrive
from warp_plate.scene.errors import SceneError, check_function, check_type
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.scene.specification import Specification
from warp_plate.studies.best_frequency import best_tone, frequencies_to_try
from warp_plate.studies.drive_for_cases import (
    NOTHING,
    ROBUST_TRIED,
    contrast_of,
    decibels,
    drive_for_cases,
    nearest_rest,
    refined,
)
from warp_plate.studies.frequency_response import check_linear

# Lowest frequency [Hz]: levels are accelerations, which vanish below all measure under a slower drive.
LOWEST = 0.01
# Multiples of the wanted levels on the curve of level against contrast.
PARETO = np.geomspace(1 / 8, 8, 13)
SAME = 1e-4  # relative difference of two scales that counts as none
# Relative violation of levels that counts as none; part of a certificate from which on it is named.
VIOLATION, NAMED = 1e-6, 0.02
OF_EFFORT = 1e-6  # largest violation by the drives whose part of the limits is reported
# Density of the splines of the answer, and, relative to it, of those that errors are estimated with; and the error of
# the answer over the difference.
FINER, COARSER, CAUTION = 2.0, 1 / 1.3, 3.0
LARGEST_ERROR = 0.2  # relative error of levels from which on nothing is proved
# Points of the map along the longer side of the plate.
MAP_POINTS = 161


def specify(
    scene: SceneSource, tolerances: bool = True, on_progress: Callable[[int, int], object] | None = None
) -> SpecifiedDrive:
    """Return the drive that meets a scene's ``[specification]`` best, and what no drive can do.

    The drive has the least contrast of the levels elsewhere; without any, the least part of the actuators' limits.

    Args:
        scene: Linear scene with a specification; its motion is steady.
        tolerances: Also find one drive for all cases of ``specification.tolerance``.
        on_progress: Function of the number of frequencies done and their total.

    Raises:
        SceneError: The scene has no specification, is not linear, a region of the specification is empty, or no drive
            of any size reaches the levels.
    """
    scene = Scene.load(scene)
    check_type("tolerances", tolerances, bool)
    check_function("on_progress", on_progress)
    specification = scene.specification
    if specification is None:
        raise SceneError("specification: is missing; write for example [specification] level = { acceleration_g = 1 }")
    check_linear(scene, None)
    low, high = _range(scene, specification)
    plate = solve_modes(scene, high, key=specification.frequency_key)
    largest = _largest_drives(scene, specification)
    requirements = make_requirements(plate)
    scaled: Scaled = "elsewhere" if requirements.rests else "actuators"
    frequencies = frequencies_to_try(plate, low, high)
    tones: list[Tone] = []
    scales: list[LeastScale] = []
    for done, frequency in enumerate(frequencies):
        check_interrupt()
        points = tones[-1].essential_points(scales[-1]) if tones and requirements.rests else {}
        tones.append(Tone(plate, requirements, float(frequency), largest, points=points))
        start = scales[-1].start if scales else None
        scales.append(tones[-1].solve(scaled, slack=None, start=start, searches=1))
        if on_progress is not None:
            on_progress(done + 1, len(frequencies))
    tone, start = best_tone(tones, scales, scaled)
    answer, tone = _answer(tone, scaled, tones, scales, start)
    if specification.tolerance and tolerances:
        spread = np.unique(np.linspace(0, len(tones) - 1, 1 if specification.band else ROBUST_TRIED).astype(int))
        starts = [(tone.frequency, answer.drive / answer.limits)]
        reached = [k for k in spread if len(spread) > 1 and scales[k].start is not None]
        starts += [(tones[k].frequency, scales[k].drive) for k in reached]
        frequency, robust, scatter = drive_for_cases(tone, scaled, starts)
        met, notes = sum(case.met for case in scatter), list(answer.notes)
        if met < len(scatter):
            notes.append(f"the one drive for all cases meets the specification in {met} of {len(scatter)} cases")
        field = _field(replace(tone, frequency=frequency), robust)
        answer = replace(answer, scatter=scatter, robust_frequency=frequency, notes=notes, field_db=field)
        answer = replace(answer, robust_drive=robust * answer.limits)
    return answer


def _range(scene: Scene, specification: Specification) -> tuple[float, float]:
    """Return the lowest and the highest frequency [Hz]; SceneError: one is below ``LOWEST``."""
    frequency = specification.frequency or scene.drive.frequency
    low, high = frequency if isinstance(frequency, tuple) else (frequency, frequency)
    if low < LOWEST:
        least = f"must be at least {LOWEST:g} Hz, as slower drives hardly accelerate a plate"
        raise SceneError(f"{specification.frequency_key} = {low:g}: {least}")
    return low, high


def _notes(scene: Scene, specification: Specification, frequency: float) -> list[str]:
    """Return what should be known of an answer at a frequency [Hz], in sentences."""
    notes = []
    if isinstance(specification.frequency, tuple) and not specification.band and frequency in specification.frequency:
        notes.append(f"the best frequency, {frequency:g} Hz, is an end of the range; a wider one may be better")
    for index, level in enumerate(specification.levels):
        if level.phase != "free" and abs(level.phase) > 2 * math.pi:
            row = f"[{index}]" if isinstance(specification.level, tuple) else ""
            notes.append(f"specification.level{row}.phase = {level.phase:g} is over a turn; phases are in radians")
    if (key := scene.nonperiodic_key) is not None:
        notes.append(f"{key} is not used: levels are those of steady motion, all actuators at one frequency")
    return notes


def _largest_drives(scene: Scene, specification: Specification) -> np.ndarray:
    """Return the (actuators,) largest magnitudes, in the unit of the scene's drives."""
    limits, largest = specification.limits, []
    units = zip(scene.actuators, scene.unit_drives, scene.limit_units, strict=True)
    for index, (actuator, unit, shown) in enumerate(units):
        allowed = {"V": limits.voltage, "A": limits.current, "N": limits.force}[shown]
        limit = abs(actuator.magnitude) if allowed is None else allowed / unit
        if limit == 0:
            key = f"actuators[{index}].{actuator.amplitude_key} = 0"
            raise SceneError(f"{key}: allows no drive; raise it, or write specification.limits")
        largest.append(limit)
    return np.array(largest)


def _answer(
    rough: Tone, scaled: Scaled, tones: Sequence[Tone], scales: Sequence[LeastScale], start: np.ndarray | None
) -> tuple[SpecifiedDrive, Tone]:
    """Return the answer at the frequency of a tone, from a drive to start from, without cases of tolerances; and this
    tone by more functions. ``tones`` and ``scales`` are those of all frequencies that were tried."""
    tone = refined(rough, {rough.frequency}, FINER)
    scene, rests = tone.plate.scene, tone.requirements.rests
    whole = tone.solve("actuators alone", start=None if rests else start)
    if whole.start is None:
        raise SceneError(
            "specification.level: no drive reaches it at all points in phase: a held edge or a line that never moves "
            'is in the target; add actuators, write measure = "mean", or make the target smaller'
        )
    result = tone.solve(scaled, start=start) if rests else whole
    if not math.isfinite(result.scale) and whole.scale <= 1:
        result = tone.solve(scaled, start=whole.drive)
        if not math.isfinite(result.scale):  # the search ended without a drive, but there is this one
            result = replace(result, drive=whole.drive, scale=float(tone.reached(whole.drive)[1].max()))
    binding, reached = tone.binding(result), math.isfinite(result.scale)
    limits = tone.largest * scene.unit_drives
    feasible = reached and result.scale <= 1 + NOTHING and tone.is_met(result.drive, VIOLATION)
    essential = replace(tone, points=tone.essential_points(result))
    effort = essential.solve("actuators", slack=OF_EFFORT) if rests else result
    drive = result.drive if reached else whole.drive / whole.scale
    levels, in_phase = tone.reached(drive), 1.0 if reached else 1 / whole.scale
    ends = tone.errors(_other(tone, rough), drive, CAUTION)
    if feasible:
        drive, in_phase, levels = _stronger(tone, scaled, drive, ends, levels)
    nearest = nearest_rest(levels)
    contrast, bound = (contrast_of(tone, scale, nearest) for scale in (result.scale, result.bound))
    pareto = _pareto(essential, scaled, drive) if rests else []
    efforts = [_effort(essential, level, effort.scale) for level, _ in pareto]
    excluded = not feasible and _excludes(tone, scaled, _largest_error(ends))
    error = _largest_error(tone.errors(rough, drive, CAUTION) if tone is not rough else ends)
    others = [(one, scale) for one, scale in zip(tones, scales, strict=True) if one.frequency != tone.frequency]
    proofs = (scale.bound > 1 and _excludes(one, scaled, error) for one, scale in others)
    in_band = tone.requirements.specification.band
    least = effort.scale, tone.frequency
    if rests and not (feasible or in_band):
        least = _least_effort(least, [one for one, _ in others])
    obstacles = [] if feasible else _obstacles(tone, binding, excluded, contrast, least, whole)
    answer = SpecifiedDrive(
        scene=scene,
        feasible=feasible,
        proved=feasible or ((excluded or any(proofs)) if in_band else (excluded and all(proofs))),
        frequency=tone.frequency,
        drive=drive * limits,
        limits=limits,
        units=tuple(scene.limit_units),
        levels=tone.extremes(drive),
        margins=_margins(tone, drive, levels, limits),
        contrast_db=contrast,
        bound_db=bound if reached else math.nan,
        allowed_db=contrast_of(tone, 1.0, nearest) if rests and tone.requirements.relative[nearest] else math.nan,
        interval=_interval(tone, ends, levels, in_phase),
        effort=effort.scale,
        largest_level=1 / whole.scale,
        obstacles=obstacles,
        gains=_gains(result, limits) if rests and reached and result.allowed else np.full(len(limits), np.nan),
        frequencies=np.array([one.frequency for one in tones]),
        contrasts=np.array([contrast_of(tone, one.scale, nearest) for one in scales]),
        efforts=np.array([math.nan if rests else one.scale for one in scales]),
        pareto_levels=np.array([level for level, _ in pareto]),
        pareto_contrasts=np.array([contrast_of(tone, one.scale, nearest, level) for level, one in pareto]),
        pareto_efforts=np.array(efforts),
        field_db=_field(tone, drive),
        guard=[line.corners for rest in rests for line in rest.region.lines],
        scatter=(),
        robust_frequency=math.nan,
        robust_drive=np.full(len(limits), np.nan),
        notes=_notes(scene, tone.requirements.specification, tone.frequency),
    )
    return answer, tone


def _other(tone: Tone, rough: Tone) -> Tone:
    """Return a tone by fewer functions than another, which is a refined one or the ``rough`` one itself."""
    if tone is not rough:
        return refined(rough, {rough.frequency}, FINER * COARSER)
    plate = coarser_modes(rough.plate, COARSER)
    return replace(rough, plate=plate, requirements=make_requirements(plate), points={})


def _largest_error(ends: tuple[Ratios, Ratios]) -> float:
    """Return the largest relative error of levels from their least and largest values over those reached."""
    return float(np.abs(np.concatenate([part for end in ends for part in end]) - 1).max())


def _excludes(tone: Tone, scaled: Scaled, error: float) -> bool:
    """Return whether it is proved that no drive meets the specification, if levels have a relative error.

    A drive for the plate would reach levels less by up to the error, in limits that its power or sound exceeds by it;
    with all forces less by it, it keeps them.
    """
    if error > LARGEST_ERROR:
        return False
    return tone.solve(scaled, 1 - 2 * error, slack=None, searches=1).bound > 1 + 2 * error


def _pareto(tone: Tone, scaled: Scaled, drive: np.ndarray) -> list[tuple[float, LeastScale]]:
    """Return multiples of the wanted levels, and the least scale of each; a drive starts their searches.

    Where all levels elsewhere are relative, a drive for a level serves lower ones, so that scales never fall with the
    level: between two levels of one scale all have it.
    """
    relative = tone.requirements.relative.all()
    results: dict[int, LeastScale] = {}

    def fill(low: int, high: int) -> None:
        for k in {low, high} - results.keys():
            check_interrupt()
            results[k] = tone.solve(scaled, PARETO[k], slack=None, start=PARETO[k] * drive, searches=0)
        if relative and results[high].scale <= results[low].scale * (1 + SAME):
            results.update(dict.fromkeys(range(low, high), results[low]))
        elif high - low > 1:
            fill(low, (low + high) // 2)
            fill((low + high) // 2, high)

    fill(0, len(PARETO) - 1)
    return [(level, results[k]) for k, level in enumerate(PARETO.tolist())]


def _effort(tone: Tone, level: float, effort: float) -> float:
    """Return the least multiple of the limits that meets the specification for a multiple of the wanted levels, from
    that for these levels, to which it is proportional where all levels elsewhere are relative."""
    if tone.requirements.relative.all():
        return level * effort
    return tone.solve("actuators", level, slack=None, searches=0).scale


def _least_effort(known: tuple[float, float], others: Sequence[Tone]) -> tuple[float, float]:
    """Return the least multiple of the limits that meets the specification, and its frequency [Hz], of the ``known``
    one and those of other tones."""
    efforts = [one.solve("actuators", slack=None, searches=0).scale for one in others]
    if min(efforts, default=math.inf) >= known[0]:
        return known
    best = others[int(np.argmin(efforts))]
    finer = refined(best, {best.frequency}, FINER)
    return min(known, (finer.solve("actuators", slack=OF_EFFORT).scale, best.frequency))


def _margins(tone: Tone, drive: np.ndarray, levels: Ratios, limits: np.ndarray) -> list[Margin]:
    in_aims, in_rests = (part.tolist() for part in levels)
    margins = []
    for aim, wanted, ratio in zip(tone.requirements.aims, tone.wanted.tolist(), in_aims, strict=True):
        name = f"{aim.name}, {aim.level.measure} point".replace("mean point", "mean")
        (limit, unit), (value, _) = (aim.level.shown(peak, tone.frequency) for peak in (wanted, wanted * ratio))
        margins.append(Margin(name, limit, value, unit, decibels(ratio)))
    for rest, allowed, ratio in zip(tone.requirements.rests, tone.allowed.tolist(), in_rests, strict=True):
        name = f"{rest.name}, {rest.allowance.measure} point".replace("mean point", "mean")
        at = (tone.frequency, float(tone.wanted.min()))
        (limit, unit), (value, _) = (rest.allowance.shown_over(peak, *at) for peak in (allowed, allowed * ratio))
        margins.append(Margin(name, limit, value, unit, -decibels(ratio)))
    scene, parts = tone.plate.scene, np.abs(drive).tolist()
    for actuator, limit, part, unit in zip(scene.actuators, limits.tolist(), parts, scene.limit_units, strict=True):
        margins.append(Margin(actuator.name, limit, limit * part, unit, -decibels(part)))
    for one in tone.limited:
        square = one.of(drive)
        limit, value = one.shown(one.limit), one.shown(square)
        margins.append(Margin(one.name, limit, value, one.unit, -decibels(square / one.limit) / 2))
    return margins


def _stronger(
    tone: Tone, scaled: Scaled, drive: np.ndarray, ends: tuple[Ratios, Ratios], levels: Ratios
) -> tuple[np.ndarray, float, Ratios]:
    """Return a drive that reaches the wanted levels whatever the numerical error, if there is one, by how much it is
    above those at a phase, and all its levels.

    It is the drive times a factor, where its limits and, with their error, the levels allowed elsewhere leave room.
    """
    limited = [math.sqrt(one.of(drive) / one.limit) for one in tone.limited]
    room = 1 / np.concatenate([np.abs(drive), levels[1] * ends[1][1], limited]).max()
    wanted = 1 / max(_least_level(tone, ends[0][0], levels, 1.0), 1 - LARGEST_ERROR)
    if room < wanted:
        other = tone.solve(scaled, wanted, start=drive, searches=0)
        if other.start is not None and other.scale <= 1:
            return other.drive, wanted, tone.reached(other.drive)
    factor = float(max(1.0, min(wanted, room)))
    return factor * drive, factor, (factor * levels[0], factor * levels[1])


def _least_level(tone: Tone, in_aims: np.ndarray, levels: Ratios, in_phase: float) -> float:
    """Return the least level of a drive over the wanted one, at an end (aims,) of the numerical error.

    Levels that are wanted at a phase count by their part at this phase, which is ``in_phase`` times the wanted one.
    """
    least = np.where([tone.fixed_phase(aim) is not None for aim in tone.requirements.aims], in_phase, levels[0])
    return max(float((least + levels[0] * (in_aims - 1)).min()), 0.0)


def _interval(tone: Tone, ends: tuple[Ratios, Ratios], levels: Ratios, in_phase: float) -> tuple[float, float]:
    """Return the contrast [dB] of a drive, or its least level over the wanted one, with its numerical error."""
    lowest, highest = (_least_level(tone, in_aims, levels, in_phase) for in_aims, _ in ends)
    if not tone.requirements.rests:
        return lowest, highest
    least, most = ((levels[1] * in_rests).max() for _, in_rests in ends)
    nearest = nearest_rest(levels)
    return contrast_of(tone, least / highest, nearest), contrast_of(tone, most / max(lowest, 1e-300), nearest)


def _gains(result: LeastScale, limits: np.ndarray) -> np.ndarray:
    """Return the (actuators,) decibels by which the contrast falls for each unit of an actuator's limit, from the
    multipliers."""
    scaled = sum(part.sum() for part in result.allowed[1:])
    return np.asarray(20 / math.log(10) * result.allowed[0] / (scaled * result.scale) / limits)


def _obstacles(
    tone: Tone,
    binding: Sequence[tuple[str, float]],
    excluded: bool,
    contrast: float,
    effort: tuple[float, float],
    whole: LeastScale,
) -> list[str]:
    """Return sentences on what excludes each other, if it is ``excluded`` that a drive exists, and what would do: an
    ``effort`` in multiples of the limits and its frequency [Hz]."""
    total = sum(part for _, part in binding) or 1.0
    scene, limits = tone.plate.scene, tone.largest * tone.plate.scene.unit_drives
    shown = zip(scene.actuators, limits, scene.limit_units, strict=True)
    names = {actuator.name: f"{limit:.3g} {unit} at {actuator.name}" for actuator, limit, unit in shown}
    named = [names.get(text, text) for text, part in sorted(binding, key=lambda row: -row[1]) if part > NAMED * total]
    if len(named) == 1:  # no actuator alone has a large part of the proof
        named.append("the limits of all actuators")
    sentences = []
    if named:
        proved = "exclude each other" if excluded else "were not met together"
        sentences.append(f"{', '.join(named[:-1])} and {named[-1]} {proved}")
    scale, frequency = effort
    if math.isfinite(scale):
        alike = len(set(scene.limit_units)) == 1
        largest = f", {scale * limits.max():.3g} {scene.limit_units[0]}" if alike else ""
        sentences.append(f"{scale:.3g} times the limits would do at {frequency:.5g} Hz{largest}")
    elif math.isfinite(contrast):
        sentences.append(f"larger limits alone do not help; the contrast is {contrast:.2f} dB")
    if _are_neighbours(tone):
        sentences.append("points right beside a target move as it does: write a specification.guard around it")
    if tone.requirements.rests and math.isnan(contrast):
        sentences.append(f"the limits allow {1 / whole.scale:.3g} of the wanted level")
    return sentences


def _are_neighbours(tone: Tone) -> bool:
    """Return whether points right beside a target may move less than the target must."""
    requirements = tone.requirements
    return any(
        rest.allowance.measure == "worst" and allowed < wanted and rest.region.shape.intersects(aim.region.shape)
        for rest, allowed in zip(requirements.rests, tone.allowed, strict=True)
        for aim, wanted in zip(requirements.aims, tone.wanted, strict=True)
        if aim.level.measure == "weakest"
    )


def _field(tone: Tone, drive: np.ndarray) -> np.ndarray:
    """Return the (ny, nx) acceleration under a drive over the least wanted level [dB]."""
    size = tone.plate.scene.plate.size
    x, y = (np.linspace(0, side, max(9, round(MAP_POINTS * side / max(size)))) for side in size)
    with np.errstate(divide="ignore"):
        return np.asarray(20 * np.log10(np.abs(tone.field(drive, x, y)) / tone.wanted.min()))
