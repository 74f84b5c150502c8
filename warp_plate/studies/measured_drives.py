"""Drives from measured responses alone: localization, contrast against fidelity, levels and focus, with bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.fitting.measured_matrix import MeasuredMatrix, blend, read_matrix, reduce_noise
from warp_plate.focusing.measured_focus import MeasuredFocus, focus_measured
from warp_plate.interrupts import check_interrupt
from warp_plate.problem.measured_levels import MeasuredLevels, meet_levels
from warp_plate.problem.measured_plate import (
    Forms,
    Geometry,
    Localized,
    MeasuredPlate,
    localize_measured,
    measured_factor_bound,
)
from warp_plate.problem.trade_off import Compromise, TradeOffCurve
from warp_plate.result.export import WaveformSignal
from warp_plate.scene.errors import SceneError, check_function
from warp_plate.scene.measured import MeasuredScene
from warp_plate.scene.specification import Allowance, Level

# Frequencies of a range for which levels are tried: those of the largest localization factors or, without levels
# elsewhere, of the largest motion of the targets.
TRIED = 24
# Half-width of the interval of a localization factor from which on it is remarked.
WIDE = 0.1


@dataclass(frozen=True, eq=False)
class MeasuredDrives:
    """Drives of a measured panel. Amplitudes are in parts of the largest drives, for motion as exp(iωt)."""

    scene: MeasuredScene
    plate: MeasuredPlate
    frequency: float  # of the drives for the first target [Hz]
    frequencies: np.ndarray  # (n,) that were tried [Hz]
    factors: np.ndarray  # (n,) largest localization factor at each, by the measured responses
    localized: Localized
    curve: Sequence[Compromise]  # least misfit for contrasts up to the largest
    spans: Sequence[Compromise]  # variable span trade-off for 1, 2, ... vectors
    levels: MeasuredLevels | None  # None without a specification
    focus: MeasuredFocus | None  # None without [focus]

    def __repr__(self) -> str:
        factor, (low, high) = self.localized.factor, self.localized.interval
        return f"<MeasuredDrives {self.frequency:g} Hz, localization factor {factor:.4g}, {low:.4g} to {high:.4g}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return self.plate.matrix.names

    @property
    def field(self) -> np.ndarray:
        """(ny, nx) motion in the middles of cells under the best drive, over its largest size."""
        line = int(np.searchsorted(self.plate.matrix.frequencies, self.frequency))
        field = np.abs(self.plate.field(line, self.localized.drive))
        return np.asarray(field / np.nanmax(field))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        low, high = self.localized.interval
        noise = "The noise is not known: the intervals hold for what the points say of each other. Write measured.noise"
        lines = {
            f"{noise}, or measured.averages if the file has coherences.": self.plate.matrix.variance is None,
            "The points are too far apart, or too noisy, for this frequency: the interval is wide.": high - low
            > WIDE * 2,
            "Levels of every point hold at the scanned points; what is between these counts in mean levels alone.": any(
                row.measure != "mean" for row in self._levelled
            ),
        }
        return tuple(line for line, applies in lines.items() if applies)

    @property
    def _levelled(self) -> tuple[Level | Allowance, ...]:
        specification = self.scene.specification
        return () if specification is None else (*specification.levels, *specification.allowances)

    def waveforms(self, beside: Path) -> dict[Path, WaveformSignal]:
        """Return the waveforms of ``[focus]`` by WAV files, a channel for each actuator, full scale the largest."""
        if self.focus is None:
            return {}
        signals, rate, unit = {}, self.focus.table.rate, self.scene.measured.unit
        for name, method in self.focus.methods.items():
            for index, waveform in enumerate(method.waveforms, 1):
                number = f"-{index}" if len(method.waveforms) > 1 else ""
                path = beside.with_name(f"{beside.stem}-{name}{number}.wav")
                scale = float(np.abs(method.waveforms).max())
                if scale > 0:
                    signals[path] = WaveformSignal(self.names, scale, unit, rate, waveform.shape[1], name, waveform)
        return signals


def measured_drives(
    scene: MeasuredScene | str | Path,
    matrix: MeasuredMatrix | None = None,
    on_progress: Callable[[int, int], object] | None = None,
) -> MeasuredDrives:
    """Return drives that follow from measured responses alone.

    Args:
        scene: Scene with a table ``[measured]``, or its file.
        matrix: Responses (default: those of the scene's file).
        on_progress: Function of the number of frequencies with levels that are done, and their total.

    Raises:
        SceneError: The file cannot be read or does not fit the scene.
    """
    scene = MeasuredScene.load(scene)
    check_function("on_progress", on_progress)
    matrix = reduce_noise(read_matrix(scene) if matrix is None else matrix)
    plate = MeasuredPlate(scene, matrix if scene.measured.fitted is None else blend(matrix, scene))
    name, target = next(iter(plate.targets.items()))
    rest = plate.shape.difference(target)
    if not rest.area > 0:
        raise SceneError(f"target: {name} covers the whole panel, so that nothing can be at rest")
    count = len(plate.points_in(target))
    if count == 0:
        raise SceneError(f"target: no scanned point is in {name}; write a larger region")
    lines = _lines(plate, scene.measured.frequency)
    forms = {line: (plate.forms(target, line), plate.forms(rest, line)) for line in lines}
    equal = scene.measured.equal_magnitudes
    factors = np.array([measured_factor_bound(*forms[line], equal) for line in lines])
    best = lines[int(np.nan_to_num(factors).argmax())]
    curve = _trade_off(plate, best, target, *forms[best])
    return MeasuredDrives(
        scene=scene,
        plate=plate,
        frequency=float(plate.matrix.frequencies[best]),
        frequencies=plate.matrix.frequencies[lines],
        factors=factors,
        localized=localize_measured(*forms[best], len(matrix.points), equal),
        curve=curve.curve(),
        spans=curve.spans(scene.trade_off.weight),
        levels=None if scene.specification is None else _levels(plate, lines, factors, on_progress),
        focus=None if scene.focus is None else focus_measured(plate),
    )


def _lines(plate: MeasuredPlate, frequency: float | tuple[float, float] | None) -> list[int]:
    """Return the indices of the frequencies to try: all in a range, or the nearest to one."""
    have = plate.matrix.frequencies
    if frequency is None:
        return list(range(len(have)))
    low, high = frequency if isinstance(frequency, tuple) else (frequency, frequency)
    lines = np.flatnonzero((have >= low) & (have <= high)).tolist()
    if not isinstance(frequency, tuple):
        nearest = int(np.abs(have - frequency).argmin())
        step = float(np.diff(have).max(initial=0.0)) or 1e-6 * frequency
        lines = [nearest] if abs(have[nearest] - frequency) <= step else []
    if not lines:
        held = f"the file has {have[0]:g} to {have[-1]:g} Hz"
        stated = list(frequency) if isinstance(frequency, tuple) else frequency
        raise SceneError(f"measured.frequency = {stated}: no response is there; {held}")
    return lines


def _trade_off(plate: MeasuredPlate, line: int, target: Geometry, inside: Forms, rest: Forms) -> TradeOffCurve:
    """Return the trade-off for the wanted motion of the target; the errors of the rest count as its motion."""
    table, rows, quadrature = plate.scene.trade_off, plate.rows(line), plate.quadrature(target)
    wanted = np.ones(len(rows), dtype=complex)
    if table.like is not None:
        if table.like not in plate.matrix.names:
            raise SceneError(f"trade_off.like = {table.like!r}: must be one of {', '.join(plate.matrix.names)}")
        wanted = rows[:, plate.matrix.names.index(table.like)]
    product = rows.conj().T @ (quadrature @ wanted) / inside.area
    size = float((wanted.conj() @ quadrature @ wanted).real) / inside.area
    return TradeOffCurve(inside.square / inside.area, (rest.square + rest.error) / rest.area, product, size)


def _levels(
    plate: MeasuredPlate, lines: list[int], factors: np.ndarray, on_progress: Callable[[int, int], object] | None
) -> MeasuredLevels:
    """Return the drive of least effort at the best of the frequencies."""
    specification = plate.scene.specification
    assert specification is not None
    if specification.frequency is not None:
        lines = _lines(plate, specification.frequency)
        factors = np.zeros(len(lines))
    promise = factors
    if not specification.allowances or len(promise) != len(lines) or not promise.any():
        promise = np.array([_strength(plate, line) for line in lines])
    tried = [lines[k] for k in np.argsort(-promise, kind="stable")[:TRIED]]
    answers = []
    for done, line in enumerate(tried):
        check_interrupt()
        answers.append(meet_levels(plate, line))
        if on_progress is not None:
            on_progress(done + 1, len(tried))
    return min(answers, key=lambda answer: (answer.effort, answer.contrast_db if answer.levels else math.inf))


def _strength(plate: MeasuredPlate, line: int) -> float:
    """Return the largest mean square acceleration of the targets per drive, but for a factor."""
    forms = plate.forms(plate.all_targets, line)
    return float(np.linalg.eigvalsh(forms.square)[-1] * plate.to_acceleration(line) ** 2)
