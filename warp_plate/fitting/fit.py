"""Fit a scene's free numbers to measured natural frequencies and damping ratios, or to measured frequency responses.

Shapes of modes are compared by the modal assurance criterion, MAC (Allemang, Brown, Proc. 1st IMAC, 1982).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from warp_plate.fitting.fitted_panel import FittedPanel, FreeNumbers, PanelProblem, fit_panel, free_numbers
from warp_plate.fitting.least_squares import Differenced, fit_least_squares
from warp_plate.fitting.measured_modes import MeasuredModes, read_modes
from warp_plate.fitting.measured_responses import MeasuredResponses, read_responses
from warp_plate.fitting.panel_responses import PanelResponses
from warp_plate.fitting.response_errors import WIDTHS, LogErrors, ResponsePrediction, ShapeErrors, weigh
from warp_plate.fitting.taps import read_tap
from warp_plate.fitting.verdict import ModesToJudge, judge_modes, judge_responses
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.scene.errors import SceneError, check_type
from warp_plate.scene.fit import Measurement
from warp_plate.scene.model import Scene, SceneSource

# Functions along each side, relative to those of other commands: frequencies are right to 5e-6, in a third of the time.
DENSITY = 0.5
# Modes of a free plate that are rigid motions.
RIGID = 3
# Part of the next frequency below which those of rigid motions are.
GAP = 0.1
# Modes computed for pairing by nearest frequencies: a multiple of the measured ones, plus a number.
SPARE = 2, 8
# Part of the ratio of frequencies in pairs by shapes: it decides between modes whose shapes are alike at the sensors.
TIE = 0.1
# Smallest and largest weight of damping ratios against frequencies.
WEIGHTS = 1e-4, 1e4
# Starts and frequencies for finding out why a model does not describe its data.
MOST_STARTS, MOST_FREQUENCIES = 4, 400
# Lowest and highest decay rate of an exponential window that is looked for, over the lowest angular frequency.
DECAYS = 1e-4, 0.3


def fit(scene: SceneSource, data: str | Path | Sequence[str | Path]) -> ModeFit | ResponseFit:
    """Fit the keys under ``[fit.free]`` of a scene to measurements, with 95 % intervals.

    Args:
        scene: Scene with ``[fit.free]``, the ranges of the fitted values; for responses also ``[[measurement]]``.
        data: File of natural frequencies, or one or several files of frequency responses if the scene has tables
            ``[[measurement]]``; see :func:`read_modes` and :func:`read_responses`.

    Raises:
        SceneError: A file cannot be read, or does not fit the scene; or see :func:`fit_panel`.
    """
    loaded = Scene.load(scene)
    check_type("data", data, str, Path, Sequence)
    paths = [Path(data)] if isinstance(data, str | Path) else [Path(path) for path in data]
    if loaded.measurement:
        return fit_responses(loaded, read_responses(paths, len(loaded.measurement), loaded.fit, loaded.measurement))
    if len(paths) != 1:
        named = f"data {paths[1]}" if paths else "data"
        raise SceneError(f"{named}: must be one file, for the scene has no tables [[measurement]]")
    if paths[0].suffix.lower() == ".wav":
        return _fit_tap(loaded, read_tap(paths[0], loaded.fit.range if loaded.fit else None))
    return fit_modes(loaded, read_modes(paths[0], loaded.fit))


@dataclass(frozen=True, eq=False, repr=False)
class ModeFit(FittedPanel):
    """A scene fitted to measured modes."""

    measured: MeasuredModes  # what was measured
    numbers: np.ndarray  # (n,) number of the mode that each frequency was paired with, from 1
    frequencies: np.ndarray  # (n,) fitted natural frequencies [Hz]
    damping: np.ndarray  # (n,) fitted damping ratios ζ

    @property
    def errors(self) -> np.ndarray:
        """(n,) relative errors of the fitted frequencies."""
        return self.frequencies / self.measured.frequencies - 1


def fit_modes(scene: Scene, measured: MeasuredModes) -> ModeFit:
    """Fit a scene to measured modes, by relative errors of frequencies and of damping ratios."""
    measured = without_rigid_motions(scene, measured)
    damped = np.flatnonzero(np.isfinite(measured.damping))
    count = len(measured.frequencies)

    def weigh(errors: np.ndarray, leverage: np.ndarray) -> np.ndarray:
        """Scale errors of damping ratios to the size of those of frequencies."""
        sizes = [
            math.sqrt(np.sum(errors[rows] ** 2) / max(1.0, np.sum(1 - leverage[rows])))
            for rows in (slice(count), slice(count, None))
        ]
        ratio = sizes[0] / sizes[1] if sizes[1] else 1.0
        return np.where(np.arange(len(errors)) < count, 1.0, np.clip(ratio, *WEIGHTS))

    free = free_numbers(scene)
    pairing = _pairing(free.scene, measured)
    problem = PanelProblem(
        free,
        measured.source,
        Differenced(lambda unknowns: _paired_modes(free.panel_at(unknowns), measured, pairing)),
        [_RelativeErrors(measured, damped)],
        count + len(damped),
        weigh if len(damped) else None,
    )

    def refit(changed: MeasuredModes) -> np.ndarray:
        predict = Differenced(lambda unknowns: _paired_modes(free.panel_at(unknowns), changed, "order"))
        residuals = _RelativeErrors(changed, damped[:0])
        return residuals(predict(fit_least_squares(predict, [residuals], _few_starts(free)).unknowns))

    def describe(fitted: Scene, at_limit: Sequence[str]) -> dict[str, Any]:
        numbers, frequencies, damping = _paired_modes(fitted, measured, pairing)
        modes: dict[str, Any] = {"numbers": numbers.astype(int), "frequencies": frequencies, "damping": damping}
        plate = _lowest_modes(fitted, int(numbers.max()) + SPARE[1])
        elastic = np.flatnonzero(plate.frequencies > 0)
        judged = ModesToJudge(measured, modes["numbers"], frequencies, plate.frequencies[elastic])
        if pairing == "mac":
            of_points = partial(_mean_assurance, measured, plate.part(elastic))
            mac = of_points(_points(scene, measured), modes["numbers"])
            judged = replace(judged, mac=mac, assurance=of_points)
        modes["verdict"] = judge_modes(fitted, judged, refit, at_limit)
        return {"measured": measured, "remarks": measured.remarks, **modes}

    return fit_panel(ModeFit, problem, describe)


def _lowest_modes(scene: Scene, count: int) -> ModalPlate:
    """Return so many modes of a panel, rigid ones counted, as fits compute them."""
    return solve_modes(linear_part(scene), highest=0.0, count=count, density=DENSITY)


def _fit_tap(scene: Scene, measured: MeasuredModes) -> ModeFit:
    """Fit to modes of a tap, but not to damping ratios of those that may be two modes of the panel as one."""
    fitted = fit_modes(scene, measured)
    count, measured = int(fitted.numbers.max()) + SPARE[1], fitted.measured
    plate = _lowest_modes(fitted.scene, count + RIGID)
    others = np.delete(plate.frequencies[plate.frequencies > 0], fitted.numbers - 1)
    nearest = others[np.abs(others - fitted.frequencies[:, None]).argmin(axis=1)]
    two = np.flatnonzero(np.abs(nearest - fitted.frequencies) < 2 * measured.damping * fitted.frequencies)
    if not two.size or not fitted.verdict.describes:
        return fitted
    said = [
        f"The mode at {measured.frequencies[at]:.6g} Hz may be two: the panel has one at {nearest[at]:.5g} Hz besides "
        f"{fitted.frequencies[at]:.5g} Hz; its damping ratio, {measured.damping[at]:.3g}, is not fitted"
        for at in two.tolist()
    ]
    damping = measured.damping.copy()
    damping[two] = math.nan
    return fit_modes(scene, replace(measured, damping=damping, remarks=(*measured.remarks, *said)))


def assurance(scene: Scene, measured: MeasuredModes, numbers: np.ndarray) -> np.ndarray | None:
    """Return (n, n) MAC of measured shapes and those of the modes with these numbers, from 1; None without shapes."""
    if measured.shapes is None:
        return None
    points = _points(scene, measured)
    plate = solve_modes(linear_part(scene), highest=0.0, count=int(numbers.max()) + RIGID)
    elastic = np.flatnonzero(plate.frequencies > 0)[numbers - 1]
    return modal_assurance(measured.shapes, plate.at_points(points)[elastic])


def _mean_assurance(
    measured: MeasuredModes, plate: ModalPlate, points: np.ndarray, numbers: np.ndarray | None = None
) -> float:
    """Return the mean MAC of measured shapes, at other points, and modes of a plate by numbers or the most alike."""
    assert measured.shapes is not None
    alike = modal_assurance(measured.shapes, plate.at_points(points))
    pairs = scipy.optimize.linear_sum_assignment(-alike) if numbers is None else (range(len(numbers)), numbers - 1)
    return float(alike[pairs].mean())


def modal_assurance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (m, n) |a·b*|² / (a·a* b·b*) of shapes (m, points) and (n, points); 0 for a shape that does not move."""
    products = np.abs(first @ second.conj().T) ** 2
    sizes = np.outer(np.sum(np.abs(first) ** 2, axis=1), np.sum(np.abs(second) ** 2, axis=1))
    return np.divide(products, sizes, out=np.zeros_like(sizes), where=sizes > 0)


def _points(scene: Scene, measured: MeasuredModes) -> np.ndarray:
    """Return the points of the shapes, or raise a SceneError if one is off the plate."""
    points, size = measured.points, np.array(scene.plate.size)
    assert points is not None
    if np.any((points < 0) | (points > size)):
        advice, reach = "fit.origin and fit.unit place the file's coordinates", np.abs(points).max(axis=0)
        if np.all(reach <= (0.5 + 1e-9) * size):
            advice = f"if they are about its centre, write fit.origin = {(size / 2).tolist()}"
        elif np.all(reach * 1e-3 <= (1 + 1e-9) * size):
            advice = 'if they are in millimetres, write fit.unit = "mm"'
        raise SceneError(f"{measured.source}: a point of the shapes is off the plate of {size.tolist()} m; {advice}")
    return points


def without_rigid_motions(scene: Scene, measured: MeasuredModes) -> MeasuredModes:
    """Leave out the lowest modes if they are rigid motions: as many as the plate has at most, far below the next.

    Numbers of modes that count them are lowered.
    """
    plate = _lowest_modes(scene, RIGID)
    rising, rigid = np.sort(measured.frequencies), int((plate.frequencies == 0).sum())
    gaps = [count for count in range(1, min(rigid, len(rising) - 1) + 1) if rising[count - 1] < GAP * rising[count]]
    if not gaps:
        return measured
    moving = measured.frequencies >= rising[gaps[-1]]
    numbers = None if measured.numbers is None else measured.numbers[moving]
    if numbers is not None and numbers.min() > gaps[-1]:
        numbers = numbers - gaps[-1]
    said = f"{gaps[-1]} modes up to {rising[gaps[-1] - 1]:.3g} Hz are rigid motions, which are not fitted"
    shapes = None if measured.shapes is None else measured.shapes[moving]
    each = {"frequencies": measured.frequencies[moving], "damping": measured.damping[moving]}
    if measured.damping_bars is not None:
        each["damping_bars"] = measured.damping_bars[moving]
    return replace(measured, **each, numbers=numbers, shapes=shapes, remarks=(*measured.remarks, said))


@dataclass(frozen=True, eq=False)
class _RelativeErrors:
    """Residuals of frequencies, then of damping ratios with the indices ``damped``, see :class:`Residuals`."""

    measured: MeasuredModes
    damped: np.ndarray

    def __call__(self, predicted: np.ndarray) -> np.ndarray:
        return self.slopes(predicted, predicted) - 1

    def slopes(self, predicted: np.ndarray, changes: np.ndarray) -> np.ndarray:
        frequencies = changes[..., 1, :] / self.measured.frequencies
        damping = changes[..., 2, self.damped] / self.measured.damping[self.damped]
        return np.concatenate([frequencies, damping], axis=-1)


def _pairing(scene: Scene, measured: MeasuredModes) -> str:
    """Return "mac", "nearest", or "order", by the numbers of the modes if they are known."""
    assert scene.fit is not None
    if scene.fit.pairing != "mac":
        return "order" if measured.numbers is not None else scene.fit.pairing
    if measured.shapes is None:
        raise SceneError(f'{measured.source}: has no shapes with points; fit.pairing = "mac" needs them')
    _points(scene, measured)
    return "mac"


def _paired_modes(scene: Scene, measured: MeasuredModes, pairing: str) -> np.ndarray:
    """Return (3, n) number, frequency [Hz] and damping ratio of the mode for each measured one."""
    count = len(measured.frequencies)
    numbers = np.arange(1, count + 1) if measured.numbers is None else measured.numbers
    wanted = int(numbers.max()) if pairing == "order" else SPARE[0] * max(count, int(numbers.max())) + SPARE[1]
    plate = _lowest_modes(scene, wanted + RIGID)
    elastic = np.flatnonzero(plate.frequencies > 0)[:wanted]
    frequencies = plate.frequencies[elastic]
    if pairing != "order":
        distances = np.abs(np.log(measured.frequencies[:, None] / frequencies))
        if pairing == "mac":
            assert measured.shapes is not None
            assert measured.points is not None
            shapes = plate.at_points(measured.points)[elastic]
            distances = 1 - modal_assurance(measured.shapes, shapes) + TIE * distances
        numbers = 1 + scipy.optimize.linear_sum_assignment(distances)[1]
    return np.stack([numbers, frequencies[numbers - 1], plate.damping_ratios[elastic][numbers - 1]])


@dataclass(frozen=True, eq=False, repr=False)
class ResponseFit(FittedPanel):
    """A scene fitted to measured frequency responses."""

    measured: MeasuredResponses  # what was measured
    responses: np.ndarray  # (measurements, n) fitted responses

    @property
    def errors(self) -> np.ndarray:
        """(measurements, n) log(H / Hₘ)."""
        return np.log(self.responses / self.measured.responses)

    @property
    def rms_decibels(self) -> np.ndarray:
        """(measurements,) root mean square errors of the levels [dB]."""
        return 20 / np.log(10) * np.sqrt(np.mean(self.errors.real**2, axis=1))

    @property
    def rms_degrees(self) -> np.ndarray:
        """(measurements,) root mean square errors of the phases [°]."""
        return np.degrees(np.sqrt(np.mean(self.errors.imag**2, axis=1)))


def fit_responses(scene: Scene, measured: MeasuredResponses) -> ResponseFit:
    """Fit the keys under ``[fit.free]`` of a scene to measured frequency responses."""
    if scene.effects.air is not None:
        raise SceneError("effects.air: responses are fitted without it; delete it, its mass counts as the panel's")
    if scene.coil_indices:
        key = f"actuators[{scene.coil_indices[0]}].kind"
        raise SceneError(f"{key}: responses are fitted without coils; measure the panel before they are mounted")
    free = free_numbers(scene)
    coarse, exact = (ResponsePrediction(free, measured, coarse) for coarse in (True, False))
    stages = [LogErrors(measured, width) for width in WIDTHS]
    size = measured.responses.size
    problem = PanelProblem(
        free, measured.source, coarse, stages, 2 * size, weigh, exact, series=2 * len(measured.responses)
    )

    def describe(fitted: Scene, at_limit: Sequence[str]) -> dict[str, Any]:
        responses = PanelResponses(fitted, measured).values
        errors = np.log(responses / measured.responses)
        verdict = judge_responses(fitted, errors, _Alternatives(scene, measured), at_limit)
        return {"measured": measured, "remarks": measured.remarks, "responses": responses, "verdict": verdict}

    return fit_panel(ResponseFit, problem, describe)


class _Alternatives:
    """Responses at other places, and fits to other data, see :class:`Alternatives`; plates are coarse."""

    def __init__(self, scene: Scene, measured: MeasuredResponses) -> None:
        few = slice(None, None, -(-len(measured.frequencies) // MOST_FREQUENCIES))
        self.measured = replace(measured, frequencies=measured.frequencies[few], responses=measured.responses[:, few])
        self._scene = scene

    @cached_property
    def _unknowns(self) -> np.ndarray:
        """The free numbers by the shape of the responses over frequency."""
        free = free_numbers(self._scene)
        stages = [ShapeErrors(self.measured, width) for width in WIDTHS]
        return fit_least_squares(ResponsePrediction(free, self.measured, True), stages, _few_starts(free)).unknowns

    def respond(self, rows: Sequence[Measurement]) -> np.ndarray:
        """Return responses (m, n) between the places of rows."""
        return ResponsePrediction(self._free(rows), self.measured, True)(self._unknowns)

    def refit(self, rows: Sequence[Measurement], responses: np.ndarray) -> np.ndarray:
        """Return errors (m, n) of a fit between the places of rows to other responses (m, n)."""
        free, data = self._free(rows), replace(self.measured, responses=responses)
        predict, stages = ResponsePrediction(free, data, True), [LogErrors(data, width) for width in WIDTHS]
        found = fit_least_squares(predict, stages, self._unknowns[None], weigh).unknowns
        return np.asarray(np.log(predict(found) / responses))

    def of_data(self, responses: np.ndarray) -> _Alternatives:
        """Return the same for other responses (m, n), whose resonances may differ."""
        return _Alternatives(self._scene, replace(self.measured, responses=responses))

    def refit_decay(self, scene: Scene) -> tuple[float, np.ndarray]:
        """Return the decay rate [1/s] that the data have and a fitted scene lacks, and errors (m, n) with it."""
        free, (low, high) = free_numbers(scene), 2 * np.pi * self.measured.frequencies[0] * np.array(DECAYS)

        def rate(unknowns: np.ndarray) -> float:
            return float(low * (high / low) ** unknowns[-1])

        def respond(unknowns: np.ndarray, coarse: bool = True) -> np.ndarray:
            data = replace(self.measured, decay=self.measured.decay + rate(unknowns))
            return PanelResponses(free.panel_at(unknowns[:-1]), data, coarse).values

        fitted, stages = free.starts(1, 0)[0], [LogErrors(self.measured, width) for width in WIDTHS]
        starts = np.array([[*fitted, part] for part in np.linspace(0.1, 0.9, 5)])
        found = fit_least_squares(Differenced(respond), stages, starts, weigh).unknowns
        return rate(found), np.log(respond(found, coarse=False) / self.measured.responses)

    def _free(self, rows: Sequence[Measurement]) -> FreeNumbers:
        return free_numbers(self._scene.model_copy(update={"measurement": tuple(rows)}))


def _few_starts(free: FreeNumbers) -> np.ndarray:
    assert free.scene.fit is not None
    return free.starts(min(free.scene.fit.starts, MOST_STARTS), free.scene.fit.seed)
