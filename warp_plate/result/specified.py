"""The answer to a specification: a drive that meets it, or what is in its way."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.plate.designs import scene_with
from warp_plate.scene.errors import printable, under
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class RegionLevels:
    """Peak accelerations of a region [m/s²] under the drive."""

    name: str  # name of a target, "elsewhere" or the rectangle of an allowance
    worst: float  # largest
    mean: float  # root mean square over the region, by mass
    weakest: float  # smallest
    worst_at: tuple[float, ...]  # point x, y [m] of the largest
    weakest_at: tuple[float, ...]  # point x, y [m] of the smallest


@dataclass(frozen=True)
class Margin:
    """Margin by which a requirement is kept."""

    requirement: str
    wanted: float  # limit, in ``unit``
    reached: float  # value under the drive, in ``unit``
    unit: str
    margin_db: float  # at least 0 if it is kept


@dataclass(frozen=True)
class Scatter:
    """Case of the tolerances."""

    changes: Mapping[str, float]  # factors of the scene's numbers by key
    nominal_level: float  # reached over wanted level of the worst target, under the drive of the nominal scene
    nominal_db: float  # contrast of that drive [dB]
    robust_level: float  # the same of the one drive for all cases
    robust_db: float
    best_db: float  # contrast of the best drive for this case alone [dB]
    met: bool  # true if the one drive for all cases meets the specification in this case

    @property
    def text(self) -> str:
        """The changes, for people."""
        return ", ".join(f"{key} × {factor:g}" for key, factor in self.changes.items())


@dataclass(frozen=True, eq=False)
class SpecifiedDrive:
    """A drive for a specification, and what is known of all others.

    ``contrast_db`` is the level elsewhere over the level of the targets, by the measures of the specification: -14 says
    that all else moves 14 dB less.
    """

    scene: Scene
    feasible: bool  # true if the drive meets the specification
    proved: bool  # true if it does; or if it is proved that none does at any frequency tried, or at one of a band
    frequency: float  # frequency of the drive [Hz]
    drive: np.ndarray  # (actuators,) complex amplitudes, in ``units``; NaN if no drive reaches the levels
    limits: np.ndarray  # (actuators,) largest amplitudes, in ``units``
    units: tuple[str, ...]  # (actuators,) "N", "V" or "A"
    levels: Sequence[RegionLevels]
    margins: Sequence[Margin]
    contrast_db: float  # least contrast that the levels and limits allow [dB]; NaN without levels elsewhere
    bound_db: float  # proved lower bound of it [dB]
    allowed_db: float  # largest contrast allowed [dB]; NaN where the level elsewhere is not relative to the targets'
    interval: tuple[float, float]  # contrast of the drive with its numerical error [dB]; level / wanted without a rest
    effort: float  # least multiple of the limits that meets the specification; infinite if none does
    largest_level: float  # largest multiple of the wanted levels that the limits allow
    obstacles: Sequence[str]  # what is in the way, in sentences
    gains: np.ndarray  # (actuators,) dB that the contrast falls for each unit of an actuator's limit
    frequencies: np.ndarray  # (n,) frequencies that were tried [Hz]
    contrasts: np.ndarray  # (n,) least contrast at each [dB]; NaN where the levels are not reached
    efforts: np.ndarray  # (n,) least multiple of the limits that reaches the levels at each
    pareto_levels: np.ndarray  # (m,) multiples of the wanted levels
    pareto_contrasts: np.ndarray  # (m,) least contrast at each [dB]; NaN where the limits do not allow the level
    # (m,) least multiple of the limits that meets the specification at each; infinite if none does
    pareto_efforts: np.ndarray
    # (ny, nx) acceleration of the nominal plate over the least wanted level [dB]; with tolerances, under the one drive
    field_db: np.ndarray
    guard: Sequence[np.ndarray]  # closed outlines (points, 2) [m] of where levels elsewhere hold
    scatter: Sequence[Scatter]
    robust_frequency: float  # frequency of the one drive for all cases [Hz]; NaN without tolerances
    robust_drive: np.ndarray  # (actuators,) this drive, in ``units``; NaN without tolerances
    notes: Sequence[str]  # what should be known of the answer, in sentences

    @property
    def unit(self) -> str:
        """Unit of all drives and limits; several are joined, as "V or N"."""
        return " or ".join(dict.fromkeys(self.units))

    @property
    def least_wanted(self) -> float:
        """Lowest level that is wanted in a target, peak [m/s²]."""
        specification = self.scene.specification
        assert specification is not None
        return min(level.peak_acceleration(self.frequency) for level in specification.levels)

    @property
    def peaks(self) -> dict[str, float]:
        """Peak forces [N], voltages [V] or currents [A] by the names of the actuators."""
        return self._named(np.abs(self.drive))

    @property
    def phases(self) -> dict[str, float]:
        """Phase lags [rad], -π to π, by the names of the actuators."""
        return self._named(-np.angle(self.drive))

    @property
    def robust_peaks(self) -> dict[str, float]:
        """Peaks of the one drive for all cases of the tolerances, as ``peaks``."""
        return self._named(np.abs(self.robust_drive))

    @property
    def robust_phases(self) -> dict[str, float]:
        """Phase lags of the one drive for all cases of the tolerances, as ``phases``."""
        return self._named(-np.angle(self.robust_drive))

    def _named(self, values: np.ndarray) -> dict[str, float]:
        return dict(zip((actuator.name for actuator in self.scene.actuators), values.tolist(), strict=True))

    def driven_scene(self) -> Scene:
        """Return the scene with the drive and its frequency; with tolerances, the one drive for all cases."""
        frequency, drive = (self.robust_frequency, self.robust_drive) if self.scatter else (self.frequency, self.drive)
        scene = self.scene.replace("drive.frequency", frequency)
        with under("specification.level"):  # of a size that takes drives beyond all numbers of scenes
            return scene_with(scene, np.abs(drive) / self.scene.unit_drives, -np.angle(drive))

    @property
    def verdict(self) -> str:
        """Sentence that says if a drive meets the specification, and if one drive meets all cases of its tolerances."""
        if not self.scatter:
            return self._verdict
        met, cases = sum(case.met for case in self.scatter), len(self.scatter)
        several = f"in all {cases} cases" if met == cases else f"in {met} of {cases} cases"
        return f"{self._verdict}; within tolerances one drive at {self.robust_frequency:.6g} Hz meets it {several}"

    @property
    def _verdict(self) -> str:
        at, tried = f"at {self.frequency:.6g} Hz", len(self.frequencies)
        specification = self.scene.specification
        band = specification is not None and specification.band
        if self.feasible and band:
            return (
                f"at each of the {tried} frequencies tried a drive meets the specification; {at} with the least margin"
            )
        if self.feasible:
            return f"{at} a drive meets the specification"
        if not self.proved:
            return f"{at} no drive was found that meets the specification; it is not proved that there is none"
        if band:
            return f"no drive meets the specification in the whole band: {at} there is none"
        if tried > 1:
            return f"no drive meets the specification at any of the {tried} frequencies tried; {at} is the nearest"
        return f"{at} no drive meets the specification"

    @property
    def where_elsewhere(self) -> str | None:
        """Sentence that says where the levels elsewhere hold; None without any."""
        specification = self.scene.specification
        if specification is None or not specification.allowances:
            return None
        if specification.guard == 0:
            return "Levels elsewhere hold right beside the targets: specification.guard is 0."
        return f"Levels elsewhere hold {1e3 * specification.guard:g} mm from the targets (the guard) and farther."

    @property
    def robust(self) -> bool:
        """True if one drive meets the specification in all cases of the tolerances."""
        return bool(self.scatter) and all(case.met for case in self.scatter)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        return tuple(f"{line[:1].upper()}{line[1:]}." for line in (*self.obstacles, *self.notes))

    def __str__(self) -> str:
        drives = zip(self.peaks.items(), self.phases.values(), self.limits, self.units, strict=True)
        lines = [
            f"{name}: {peak:.4g} of {limit:.4g} {unit}, phase lag {math.degrees(phase):.1f}°"
            for (name, peak), phase, limit, unit in drives
        ]
        lines += [
            f"{row.requirement}: {row.reached:.4g}, limit {row.wanted:.4g} {row.unit}, margin {row.margin_db:+.2f} dB"
            for row in self.margins
            if row.requirement not in self.peaks
        ]
        if math.isfinite(self.contrast_db):
            least = f"no drive within the limits has less than {self.bound_db:.2f} dB"
            lines.append(f"contrast: {self.contrast_db:.2f} dB; {least}")
        if self.scatter:
            compared = math.isfinite(self.contrast_db)
            robust = zip(self.robust_peaks.items(), self.robust_phases.values(), self.units, strict=True)
            lines.append(f"one drive for all cases, at {self.robust_frequency:.6g} Hz:")
            lines += [
                f"{name}: {peak:.4g} {unit}, phase lag {math.degrees(phase):.1f}°"
                for (name, peak), phase, unit in robust
            ]
            lines += [
                f"{case.text}: level {case.robust_level:.3f}, "
                f"{f'contrast {case.robust_db:.2f} dB, ' if compared else ''}{'met' if case.met else 'not met'}"
                for case in self.scatter
            ]
        return printable("\n".join([self.verdict, *lines, *(f"! {line}" for line in self.warnings)]))

    def __repr__(self) -> str:
        word = "feasible" if self.feasible else "infeasible" if self.proved else "not met"
        contrast = "" if np.isnan(self.contrast_db) else f", contrast {self.contrast_db:.2f} dB"
        return f"<SpecifiedDrive {word} at {self.frequency:g} Hz{contrast}>"
