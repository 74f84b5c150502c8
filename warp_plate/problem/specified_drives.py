"""Drives that meet a specification at one frequency, the best of them, and what no drive can do.

Everything is a peak acceleration [m/s²] of steady motion, linear in the drive z, whose parts are what each actuator may
have: a(x, y) = h(x, y) z. Points of targets and of the rest are added where a drive falls short of what is wanted or
passes what is allowed, between the points of any grid (``worst_points``), until nothing does. A program over some
points allows more than the specification, so that its bound is one of the specification.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal, TypeAlias

import numpy as np

from warp_plate.modal.modes import ModalPlate
from warp_plate.optimize.cones import STEPS, Block, LeastScale, least_scale_of_squares
from warp_plate.problem.requirements import Aim, Limited, Requirements, hermitian_factor, limited_quantities
from warp_plate.problem.worst_points import FEWEST, Care, Region, Values, in_units, shortfall
from warp_plate.result.specified import RegionLevels
from warp_plate.scene.errors import SceneError

# An aim or a rest, by its index.
Key = tuple[Literal["aim", "rest"], int]
# What a program scales: the levels elsewhere, the limits of the actuators, or these without any level elsewhere.
Scaled = Literal["elsewhere", "actuators", "actuators alone"]
# Largest violation between the points of a program, at samples alone; and rounds.
TOLERANCE, COARSE, ROUNDS = 1e-8, 1e-4, 60
# Relative gain of a scale by a new search that is worth more rounds, most of such searches, and their steps at first.
GAIN, SEARCHES, FEW_STEPS, FEW_ROUNDS = 1e-5, 3, 1, 8
# Growth of the scale from which on a search begins anew: points that chase a zero through a target make it ever larger.
CHASED = 1.3
# Programs ask for this much more than the specification, so that their rounding does not violate it.
MARGIN = 2e-8
# Multiplier of a point, relative to the largest, from which on a result depends on it.
ESSENTIAL = 1e-6
# Samples of a region that programs begin with, at least, and for each actuator, as about two points for each hold it.
FIRST, FIRST_EACH = 16, 2
AT = " at ({:.4g}, {:.4g}) m"
# Parts of the largest change and of the largest level of a region by which all of it may be off besides.
ELSEWHERE, ROUNDING = 0.2, 1e-6
# Levels over those wanted (aims,), and over those allowed (rests,).
Ratios: TypeAlias = "tuple[np.ndarray, np.ndarray]"


@dataclass
class Tone:
    """Drives of a plate at one frequency; points that programs added stay for later ones."""

    plate: ModalPlate
    requirements: Requirements
    frequency: float  # [Hz]
    largest: np.ndarray  # (actuators,) largest magnitudes, in the unit of the scene's drives
    rotation: float = 0.0  # phase lag [rad] of the targets' motion whose phase is 0
    reach: float = 1.0  # multiple of the wanted levels that programs ask for; relative levels follow
    points: dict[Key, np.ndarray] = field(default_factory=dict)  # points of aims and rests in programs
    # Rows (points, actuators) of points of programs; (samples, actuators), and ends, of regions by their identity.
    _known: dict[Key, np.ndarray] = field(default_factory=dict, init=False)
    _samples: dict[int, np.ndarray] = field(default_factory=dict, init=False)
    _ends: dict[tuple[int, bytes, float], tuple[float, tuple[float, ...]]] = field(default_factory=dict, init=False)

    @cached_property
    def accelerations(self) -> np.ndarray:
        """(modes, actuators) modal accelerations [√kg·m/s²] of the actuators' largest drives."""
        plate, omega = self.plate, 2 * math.pi * self.frequency
        forces = plate.actuator_forces() * self.largest
        if plate.proportional or plate.coils is not None or plate.air is not None:
            amplitudes = -(omega**2) * plate.respond_to_drives(np.array([[self.frequency]]), forces[None])[0]
            if not np.isfinite(amplitudes).all():
                what = "is a natural frequency of an undamped plate; write damping, or another frequency"
                raise SceneError(f"{self.requirements.specification.frequency_key}: {self.frequency:g} Hz {what}")
            return amplitudes
        # One solution takes less time than the poles of all modes.
        stiffness = np.diag(plate.angular_frequencies**2 - omega**2) + 1j * (omega * plate.damping + plate.hysteretic)
        return np.asarray(-(omega**2) * np.linalg.solve(stiffness, forces))

    @cached_property
    def _coefficients(self) -> np.ndarray:
        """(unknowns, actuators) the same of the functions of the space [m/s²]."""
        return self.plate.vectors[: self.plate.space.unknowns] @ self.accelerations

    def rows(self, points: np.ndarray) -> np.ndarray:
        """Return (points, actuators) accelerations at points (points, 2) [m] under the actuators' largest drives."""
        return self._at(self._coefficients, points)

    def _at(self, coefficients: np.ndarray, points: np.ndarray) -> np.ndarray:
        parts = np.concatenate([coefficients.real, coefficients.imag], axis=1)
        real, imaginary = np.split(self.plate.space.sums_at_points(parts.T, points).T, 2, axis=1)
        return np.asarray(real + 1j * imaginary)

    def field(self, drive: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (..., ny, nx) complex accelerations [m/s²] under drives (actuators, ...) on a grid of x, y [m]."""
        whole = (self._coefficients @ drive).T
        real, imaginary = self.plate.space.on_grid(np.stack([whole.real, whole.imag]), x, y)
        return np.asarray(real + 1j * imaginary)

    def mean_factor(self, region: Region) -> np.ndarray:
        """Return the factor R (rows, actuators): ‖R z‖ is the root mean square [m/s²] over a region, by mass."""
        return hermitian_factor(self._coefficients.conj().T @ (region.mean_matrix @ self._coefficients))

    @cached_property
    def limited(self) -> list[Limited]:
        """Limited quantities besides the actuators' drives."""
        return limited_quantities(self.requirements, self.plate, self.frequency, self.largest, self.accelerations)

    @cached_property
    def wanted(self) -> np.ndarray:
        """(aims,) wanted peak accelerations [m/s²]."""
        return self.requirements.wanted(self.frequency)

    @cached_property
    def allowed(self) -> np.ndarray:
        """(rests,) allowed peak accelerations [m/s²]."""
        return self.requirements.allowed(self.frequency)

    def solve(
        self,
        scaled: Scaled,
        level: float = 1.0,
        slack: float | None = TOLERANCE,
        start: np.ndarray | None = None,
        searches: int = SEARCHES,
    ) -> LeastScale:
        """Return the least scale for this tone alone, see :func:`solve_together`."""
        return solve_together([self], scaled, level, slack, start, searches)

    def program(self, scaled: Scaled, level: float) -> tuple[np.ndarray, list[np.ndarray], list[Block]]:
        """Return the wanted rows (rows, actuators), the factors of wanted mean squares and the limited blocks."""
        wanted, squares, level = [np.empty((0, len(self.largest)), dtype=complex)], [], level * self.reach
        for index, aim in enumerate(self.requirements.aims):
            unit = level * self.wanted[index] * (1 + MARGIN)
            if aim.level.measure == "mean":
                squares.append(self.mean_factor(aim.region) / unit)
                continue
            rows = self._rows_of(("aim", index), aim.region) / unit
            if (phase := self._phase(aim)) == "free":
                squares += list(rows[:, None])
            else:
                wanted.append(np.exp(1j * phase) * rows)
        units, blocks = self.allowed_for(level) * (1 - MARGIN), []
        for index, rest in enumerate(self.requirements.rests if scaled != "actuators alone" else ()):
            mean = rest.allowance.measure == "mean"
            rows = self.mean_factor(rest.region)[None] if mean else self._rows_of(("rest", index), rest.region)[:, None]
            blocks.append(Block(rows / units[index], scaled == "elsewhere"))
        blocks += [Block(one.factor[None] / math.sqrt(one.limit), scaled != "elsewhere") for one in self.limited]
        return np.concatenate(wanted), squares, blocks

    def allowed_for(self, level: float) -> np.ndarray:
        """Return what is allowed of the (rests,) for a multiple of the wanted levels, which relative levels follow."""
        return self.allowed * np.where(self.requirements.relative, level, 1.0)

    def _phase(self, aim: Aim) -> float | Literal["free"]:
        return "free" if aim.level.phase == "free" else aim.level.phase + self.rotation

    def _rows_of(self, key: Key, region: Region) -> np.ndarray:
        """Return the rows of the points of a region that programs have so far, which are only added to."""
        points, rows = self._points(key, region), self._known.get(key)
        if rows is None or len(rows) < len(points):
            more = self.rows(points[0 if rows is None else len(rows) :])
            self._known[key] = more if rows is None else np.concatenate([rows, more])
        return self._known[key]

    def essential_points(self, result: LeastScale) -> dict[Key, np.ndarray]:
        """Return the points of programs, of those elsewhere only what a result for scaled levels there depends on."""
        points = dict(self.points)
        for index, part in enumerate(result.allowed[1 : len(self.requirements.rests) + 1]):
            key: Key = ("rest", index)
            if part.any() and len(part) == len(points.get(key, ())):
                points[key] = points[key][part > ESSENTIAL * part.max()]
        return points

    def _points(self, key: Key, region: Region) -> np.ndarray:
        """Return the points of a region that programs have so far: at first some of its samples."""
        if key not in self.points:
            first = max(FIRST, FIRST_EACH * len(self.largest))
            self.points[key] = region.samples[:: max(1, len(region.samples) // first)]
        return self.points[key]

    def add_points(self, result: LeastScale, scaled: Scaled, level: float, care: Care, slack: float | None) -> bool:
        """Add points at which a drive falls short or passes its scale; return whether there are any."""
        added, scale, level = False, result.scale if scaled == "elsewhere" else 1.0, level * self.reach
        slack = COARSE if slack is None or care == Care.SAMPLES else slack
        for index, aim in enumerate(self.requirements.aims):
            if aim.level.measure == "weakest":
                measure = partial(shortfall, level * self.wanted[index], self._phase(aim))
                added |= self._add(("aim", index), aim.region, result.drive, measure, 0.0, slack, care)
        for index, rest in enumerate(self.requirements.rests if scaled != "actuators alone" else ()):
            if rest.allowance.measure == "worst":
                measure = partial(in_units, float(self.allowed_for(level)[index] * (1 - MARGIN)))
                added |= self._add(("rest", index), rest.region, result.drive, measure, scale, slack, care)
        return added

    def _add(
        self, key: Key, region: Region, drive: np.ndarray, measure: Values, limit: float, slack: float, care: Care
    ) -> bool:
        """Add the points of a region where a measure of the acceleration passes a limit."""
        peaks, most = self._peaks(region, drive, measure, care), limit + slack * (limit or 1.0)
        beyond = peaks[measure(self.rows(peaks) @ drive) > most]
        free = key[0] == "aim" and self._phase(self.requirements.aims[key[1]]) == "free"
        if care == Care.THOROUGH and free and not len(beyond):  # only then, for at a zero the motion has no phase
            dips = self._dips(region, drive, peaks)
            beyond = dips[measure(self.rows(dips) @ drive) > most]
        self.points[key] = np.concatenate([self.points[key], beyond])
        return len(beyond) > 0

    def _peaks(self, region: Region, drive: np.ndarray, measure: Values, care: Care) -> np.ndarray:
        """Return points (points, 2) [m] where a measure of the acceleration under a drive is largest."""
        levels, fewest = measure(self._sampled(region, drive)), max(FEWEST, len(self.largest))
        return region.peaks(levels, lambda points: measure(self._motion(drive, points)), care, fewest)

    def _dips(self, region: Region, drive: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return points (n, 2) [m] near others where the acceleration under a drive is smallest."""
        return region.dips(points, partial(self._motion, drive), self._sampled(region, drive))

    def _motion(self, drive: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the (points,) complex accelerations [m/s²] under a drive at points (points, 2) [m]."""
        return self._at((self._coefficients @ drive)[:, None], points)[:, 0]

    def _sampled(self, region: Region, drive: np.ndarray) -> np.ndarray:
        """Return the (samples,) complex accelerations [m/s²] of a region under a drive."""
        if id(region) not in self._samples:
            inside = self.field(np.eye(len(self.largest)), region.x, region.y)[:, region.inside].T
            self._samples[id(region)] = np.concatenate([inside, self.rows(region.samples[len(inside) :])])
        return np.asarray(self._samples[id(region)] @ drive)

    def rotated(self, drive: np.ndarray) -> Tone:
        """Return a copy with the rotation and the reach at which a drive moves targets; its points are shared."""
        tone = copy(self)  # with what is computed already
        for index, aim in enumerate(self.requirements.aims):
            if self.fixed_phase(aim) is not None:
                motion = (self._rows_of(("aim", index), aim.region) @ drive).mean()
                tone.rotation = float(-np.angle(motion) - aim.level.phase)
                break
        if self.requirements.rests and self.requirements.relative.all():
            tone.reach = max(1.0, min(map(partial(tone._reached, drive), range(len(self.wanted)))))
        return tone

    def _reached(self, drive: np.ndarray, index: int) -> float:
        """Return the level of an aim at the samples, at its phase, over that wanted."""
        aim = self.requirements.aims[index]
        if aim.level.measure == "mean":
            return self._mean(aim.region, drive) / float(self.wanted[index])
        motion, phase = self._sampled(aim.region, drive) / self.wanted[index], self._phase(aim)
        return float((np.abs(motion) if phase == "free" else (np.exp(1j * phase) * motion).real).min())

    def binding(self, result: LeastScale) -> list[tuple[str, float]]:
        """Return what the proof of a program of this tone alone rests on, in words, with its part of the proof."""
        named, place = [], 0
        for index, aim in sorted(enumerate(self.requirements.aims), key=lambda row: self.fixed_phase(row[1]) is None):
            points = self.points.get(("aim", index), np.empty((0, 2)))
            count = 1 if aim.level.measure == "mean" else len(points)
            part = result.wanted[place : place + count]
            at = "" if aim.level.measure == "mean" or not len(part) else AT.format(*points[part.argmax()])
            named.append((f"{aim.level.text} in {aim.name}{at}", float(part.sum())))
            place += count
        for index, (rest, part) in enumerate(zip(self.requirements.rests, result.allowed[1:], strict=False)):
            points = self.points.get(("rest", index), np.empty((0, 2)))
            at = AT.format(*points[part.argmax()]) if rest.allowance.measure == "worst" else " in the mean"
            named.append((f"{rest.allowance.text} {rest.name}{at}", float(part.sum())))
        parts = [float(part.sum()) for part in result.allowed[len(result.allowed) - len(self.limited) :]]
        named += [(f"the limit of {one.name}", part) for one, part in zip(self.limited, parts, strict=False)]
        parts = result.allowed[0].tolist() if result.allowed else []
        return named + list(zip([actuator.name for actuator in self.plate.scene.actuators], parts, strict=False))

    def fixed_phase(self, aim: Aim) -> float | None:
        """Return the phase lag [rad] at which a level is wanted at all points, if there is one."""
        return None if aim.level.measure == "mean" or (phase := self._phase(aim)) == "free" else phase

    def extremes(self, drive: np.ndarray) -> list[RegionLevels]:
        """Return the peak accelerations in all regions under a drive."""
        regions: dict[str, Region] = {aim.name: aim.region for aim in self.requirements.aims}
        regions |= {rest.name: rest.region for rest in self.requirements.rests}
        levels = []
        for name, region in regions.items():
            (worst, worst_at), (weakest, weakest_at) = (self._end(region, drive, sign) for sign in (1.0, -1.0))
            levels.append(RegionLevels(name, worst, self._mean(region, drive), weakest, worst_at, weakest_at))
        return levels

    def reached(self, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the levels under a drive over those wanted (aims,), and over those allowed (rests,)."""
        in_aims, in_rests = self._per_region(lambda measure, region, _: self._measured(measure, region, drive))
        return in_aims / self.wanted, in_rests / self.allowed

    def _per_region(self, function: Callable[[str, Region, float | None], float | list[float]]) -> Ratios:
        """Return a function of measure, region and fixed phase, or None, for all (aims,) and (rests,)."""
        aims = [function(aim.level.measure, aim.region, self.fixed_phase(aim)) for aim in self.requirements.aims]
        rests = [function(rest.allowance.measure, rest.region, None) for rest in self.requirements.rests]
        return np.array(aims), np.array(rests)

    def errors(self, other: Tone, drive: np.ndarray, caution: float) -> tuple[Ratios, Ratios]:
        """Return the least and the largest levels under a drive, over those reached: of the (aims,) and (rests,), if
        accelerations, or their parts at a fixed phase, may be off by ``caution`` times their changes to another
        solution and a part of the largest."""

        def ends(measure: str, region: Region, phase: float | None) -> list[float]:
            values = self._sampled(region, drive)
            changes = np.abs(other.rows(region.samples) @ drive - values)
            changes = caution * (changes + ELSEWHERE * changes.max()) + ROUNDING * np.abs(values).max()
            size = np.abs(values) if phase is None else (np.exp(1j * phase) * values).real
            sizes = [size + sign * changes for sign in (0, -1, 1)]
            if measure == "mean":
                middle, change = (float(np.sqrt(np.mean(part**2))) for part in (sizes[0], changes))
                others = [middle - change, middle + change]
            else:
                middle, *others = (float(part.max() if measure == "worst" else part.min()) for part in sizes)
            return [max(1 + (end - middle) / self._measured(measure, region, drive), 0.0) for end in others]

        (low_aims, high_aims), (low_rests, high_rests) = (part.reshape(-1, 2).T for part in self._per_region(ends))
        return (low_aims, low_rests), (high_aims, high_rests)

    def is_met(self, drive: np.ndarray, tolerance: float) -> bool:
        """Return whether a drive meets the specification to a relative tolerance; levels that are relative to the
        targets' are so to the lowest of those that the drive reaches."""
        in_aims, in_rests = self.reached(drive)
        lowest = float(in_aims.min())
        parts = [in_rests / np.where(self.requirements.relative, lowest, 1.0)]
        parts += [np.abs(drive), 1 / in_aims, np.sqrt([one.of(drive) / one.limit for one in self.limited])]
        return bool((np.concatenate(parts) <= 1 + tolerance).all())

    def _measured(self, measure: str, region: Region, drive: np.ndarray) -> float:
        sign = 1.0 if measure == "worst" else -1.0
        return self._mean(region, drive) if measure == "mean" else self._end(region, drive, sign)[0]

    def _mean(self, region: Region, drive: np.ndarray) -> float:
        return float(np.linalg.norm(self.mean_factor(region) @ drive))

    def _end(self, region: Region, drive: np.ndarray, sign: float) -> tuple[float, tuple[float, ...]]:
        """Return the largest or, with a negative sign, the smallest acceleration of a region, and its point."""
        if (key := (id(region), drive.tobytes(), sign)) in self._ends:
            return self._ends[key]
        unit = float(np.abs(self._sampled(region, drive)).max()) or 1.0
        measure: Values = partial(in_units, unit) if sign > 0 else partial(shortfall, unit, "free")
        peaks = self._peaks(region, drive, measure, Care.THOROUGH)
        if sign < 0:
            peaks = np.concatenate([peaks, self._dips(region, drive, peaks)])
        sizes = np.abs(self.rows(peaks) @ drive)
        at = int(np.argmax(sign * sizes))
        self._ends[key] = float(sizes[at]), tuple(peaks[at].tolist())
        return self._ends[key]


def solve_together(
    tones: Sequence[Tone],
    scaled: Scaled,
    level: float = 1.0,
    slack: float | None = TOLERANCE,
    start: np.ndarray | None = None,
    searches: int = SEARCHES,
) -> LeastScale:
    """Return the least scale, for the wanted levels or a multiple of them, that one drive needs for all tones.

    Args:
        tones: Tones with the same actuators.
        scaled: What is scaled; the bound holds for each tone's ``rotation``, which does not matter to one tone alone.
        level: Multiple of the wanted levels.
        slack: Largest violation between the samples of the regions, of the scale; None to look at samples alone.
        start: Drive (actuators,) to start from if the problem is not convex.
        searches: Most searches from the relaxation if the problem is not convex; 0 for none, without a bound.
    """
    care, settled, done, drive, first = Care.SAMPLES, False, 0, start, math.inf
    best: LeastScale | None = None
    for number in range(ROUNDS):
        parts = [tone.program(scaled, level) for tone in tones]
        wanted = np.concatenate([part[0] for part in parts])
        squares, blocks = [item for part in parts for item in part[1]], [item for part in parts for item in part[2]]
        program = partial(least_scale_of_squares, wanted, squares, blocks, scaled != "elsewhere")
        drive = drive if squares else None  # programs that are convex need no start
        result = program(drive, STEPS if settled or number >= FEW_ROUNDS else FEW_STEPS)
        if result.start is None:
            if drive is None or done >= searches:
                return best or result
            drive, done = None, done + 1  # this one leads nowhere with the added points
            continue
        if drive is None or not number:
            first = result.scale
        elif searches and result.scale > CHASED * first:
            drive = None  # others may lose less by the added points
            continue
        added = [tone.add_points(result, scaled, level, care, slack) for tone in tones]
        while slack is not None and not any(added) and care < Care.THOROUGH:
            care = Care(care + 1)
            added = [tone.add_points(result, scaled, level, care, slack) for tone in tones]
        care = min(care, Care.QUICK)
        if not any(added) and (settled or drive is None):
            if drive is None or not searches:
                return result
            if best is None or result.scale < best.scale:
                best = result
            relaxed = program()
            if relaxed.scale >= best.scale * (1 - GAIN) or done >= searches:
                return replace(best, bound=min(relaxed.bound, best.scale))
            drive, done = None, done + 1
            continue
        settled, drive = not any(added), result.drive
    result = best or result
    return replace(result, bound=min(program().bound, result.scale)) if squares and searches else result
