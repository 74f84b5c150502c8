"""Drives for wanted and allowed levels at the points of a scan, of least effort and of least motion elsewhere.

As in :mod:`warp_plate.problem.specified_drives`, but at scanned points only, and with the errors of the measurement in
all levels elsewhere, ‖v‖² + e², so that no drive counts on motions that cancel by less than these.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from warp_plate.optimize.cones import Block, LeastScale, least_scale_of_squares
from warp_plate.problem.measured_plate import Forms, MeasuredPlate
from warp_plate.problem.requirements import guarded_shape, hermitian_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.specification import Level

# Programs ask for this much more than the levels, so that their rounding does not violate them.
MARGIN = 2e-8
NOTHING = 1e-7  # relative violation that counts as none


@dataclass(frozen=True)
class ReachedLevel:
    """A level of a region under a drive, as peak acceleration [m/s²]."""

    name: str
    wanted: float  # least level of a target, largest level elsewhere
    reached: float
    uncertainty: float  # of the root mean square over the region, by noise and by places between the points


@dataclass(frozen=True, eq=False)
class MeasuredLevels:
    """The drive of least effort for wanted levels and allowed ones elsewhere, and what no drive can do."""

    frequency: float  # [Hz]
    drive: np.ndarray  # (actuators,) complex amplitudes, in parts of the largest ones; NaN where no drive reaches them
    effort: float  # least multiple of the largest drives; infinite if no drive of any size meets the levels
    effort_bound: float  # proved: no drive takes less
    levels: Sequence[ReachedLevel]
    contrast_db: float  # least level elsewhere over the lowest wanted one within the largest drives; NaN without any
    contrast_bound_db: float  # proved: no drive within them has less
    contrast_drive: np.ndarray  # (actuators,) the drive of that contrast

    @property
    def feasible(self) -> bool:
        """True if the drive meets the levels within the largest drives."""
        return self.effort <= 1 + NOTHING

    @property
    def proved(self) -> bool:
        """True if it does, or if it is proved that none does at this frequency."""
        return self.feasible or self.effort_bound > 1


@dataclass(frozen=True, eq=False)
class _Zone:
    """A region at a frequency, in accelerations [m/s²] under the largest drives."""

    name: str
    forms: Forms
    rows: np.ndarray  # (points, actuators)
    errors: np.ndarray  # (points, actuators) standard deviations of the rows

    @property
    def factor(self) -> np.ndarray:
        """R (rows, actuators): ‖R z‖ is the root mean square with its error."""
        return hermitian_factor((self.forms.square + self.forms.error) / self.forms.area)

    @property
    def blocks(self) -> np.ndarray:
        """(points, rows, actuators) G: ‖G z‖ is the level of each point with its error."""
        deviations = self.errors[:, :, None] * np.eye(self.errors.shape[1])
        return np.concatenate([self.rows[:, None], deviations], axis=1) if self.errors.any() else self.rows[:, None]


def meet_levels(plate: MeasuredPlate, line: int) -> MeasuredLevels:
    """Return the drive of least effort for a scene's specification at a frequency, by its index.

    Raises:
        SceneError: A region holds no scanned points.
    """
    specification = plate.scene.specification
    assert specification is not None
    frequency = float(plate.matrix.frequencies[line])
    names = [level.target or next(iter(plate.targets)) for level in specification.levels]
    aims = [_zone(plate, line, name, plate.targets[name]) for name in names]
    wanted = [level.peak_acceleration(frequency) for level in specification.levels]
    guarded, rests = guarded_shape([plate.targets[name] for name in names], specification.guard), []
    for allowance in specification.allowances:
        x0, x1, y0, y1 = allowance.area or (*plate.shape.bounds[::2], *plate.shape.bounds[1::2])
        shape = shapely.difference(shapely.intersection(shapely.box(x0, y0, x1, y1), plate.shape), guarded)
        rests.append(_zone(plate, line, allowance.place, shape))
    allowed = [allowance.largest(frequency, min(wanted)) for allowance in specification.allowances]
    measures = [allowance.measure for allowance in specification.allowances]
    rows: list[np.ndarray] = [np.empty((0, len(plate.largest)), dtype=complex)]
    squares: list[np.ndarray] = []
    for asked, aim, value in zip(specification.levels, aims, wanted, strict=True):
        _ask(asked, aim, value * (1 + MARGIN), rows, squares)

    def blocks(scaled: bool) -> list[Block]:
        parts = zip(rests, allowed, measures, strict=True)
        made = [(rest.factor[None] if how == "mean" else rest.blocks, value) for rest, value, how in parts]
        return [Block(part / (value * (1 - MARGIN)), scaled) for part, value in made]

    stacked = np.concatenate(rows)
    least = least_scale_of_squares(stacked, squares, blocks(False), actuators_scaled=True)
    quiet = least_scale_of_squares(stacked, squares, blocks(True)) if rests else None
    loosest = max(allowed, default=math.nan) / min(wanted)
    levels = []
    if least.start is not None:
        of_aims = [level.measure for level in specification.levels]
        asked_of = zip([*aims, *rests], [*of_aims, *measures], [*wanted, *allowed], strict=True)
        levels = [_reached(zone, how, value, least.drive) for zone, how, value in asked_of]
    return MeasuredLevels(
        frequency=frequency,
        drive=least.drive,
        effort=least.scale,
        effort_bound=least.bound,
        levels=levels,
        contrast_db=_decibels(quiet, "scale", loosest),
        contrast_bound_db=_decibels(quiet, "bound", loosest),
        contrast_drive=np.full(len(plate.largest), np.nan) if quiet is None else quiet.drive,
    )


def _zone(plate: MeasuredPlate, line: int, name: str, shape: shapely.Geometry) -> _Zone:
    indices = plate.points_in(shape)
    if not indices.size or not shape.area > 0:
        raise SceneError(f"specification: no scanned point is in {name}; write a larger region, or a narrower guard")
    factor = plate.to_acceleration(line)
    forms, variance = plate.forms(shape, line), plate.matrix.variance
    forms = replace(forms, square=forms.square * factor**2, error=forms.error * factor**2)
    rows = plate.rows(line)[indices] * factor
    deviations = np.zeros(rows.shape) if variance is None else np.sqrt(variance[line][indices]) * plate.largest * factor
    return _Zone(name, forms, rows, deviations)


def _ask(level: Level, aim: _Zone, value: float, rows: list[np.ndarray], squares: list[np.ndarray]) -> None:
    """Add what a level wants of a drive: rows with a phase, or factors of mean squares."""
    if level.measure == "mean":
        squares.append(hermitian_factor(aim.forms.square / aim.forms.area) / value)
    elif level.phase == "free":
        squares += list(aim.rows[:, None] / value)
    else:
        rows.append(np.exp(1j * level.phase) * aim.rows / value)


def _reached(zone: _Zone, measure: str, wanted: float, drive: np.ndarray) -> ReachedLevel:
    sizes = np.abs(zone.rows @ drive)
    values = {"mean": zone.forms.root(drive), "weakest": float(sizes.min()), "worst": float(sizes.max())}
    return ReachedLevel(f"{zone.name}, {measure}", wanted, values[measure], zone.forms.uncertainty(drive))


def _decibels(result: LeastScale | None, name: str, loosest: float) -> float:
    scale = math.nan if result is None else float(getattr(result, name)) * loosest
    return 20 * math.log10(scale) if 0 < scale < math.inf else math.nan
