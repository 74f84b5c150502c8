"""Fit a scene's free numbers to measured natural frequencies and damping ratios.

Shapes are compared by the modal assurance criterion, MAC (Allemang, Brown, Proc. 1st IMAC, 1982).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from warp_plate.fitting.fitted_panel import FittedPanel, PanelProblem, fit_panel, free_numbers
from warp_plate.fitting.least_squares import Differenced
from warp_plate.fitting.measured_modes import MeasuredModes
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Functions along each side, relative to those of other commands: frequencies are right to 5e-6, in a third of the time.
DENSITY = 0.5
# Modes of a free plate that are rigid motions.
RIGID = 3
# Modes computed for pairing by nearest frequencies: a multiple of the measured ones, plus a number.
SPARE = 2, 8
# Part of the ratio of frequencies in pairs by shapes: it decides between modes whose shapes are alike at the sensors.
TIE = 0.1
# Smallest and largest weight of damping ratios against frequencies.
WEIGHTS = 1e-4, 1e4


@dataclass(frozen=True, eq=False)
class ModeFit(FittedPanel):
    """A scene fitted to measured modes.

    Attributes:
        measured: What was measured.
        numbers: (n,) number of the mode that each frequency was paired with, from 1.
        frequencies: (n,) fitted natural frequencies [Hz].
        damping: (n,) fitted damping ratios ζ.
    """

    measured: MeasuredModes
    numbers: np.ndarray
    frequencies: np.ndarray
    damping: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """(n,) relative errors of the fitted frequencies."""
        return self.frequencies / self.measured.frequencies - 1


def fit_modes(scene: Scene, measured: MeasuredModes) -> ModeFit:
    """Fit the keys under ``[fit.free]`` of a scene to measured modes.

    Residuals are relative errors of frequencies and of damping ratios. The size of the errors of both is estimated from
    the residuals.

    Raises:
        SceneError: Shapes are missing that ``fit.pairing`` needs, or see :func:`fit_panel`.
    """
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
        [np.arange(count)[:, None], np.arange(count, count + len(damped))[:, None]],
        weigh if len(damped) else None,
    )

    def describe(fitted: Scene) -> dict[str, Any]:
        numbers, frequencies, damping = _paired_modes(fitted, measured, pairing)
        return {
            "measured": measured,
            "numbers": numbers.astype(int),
            "frequencies": frequencies,
            "damping": damping,
        }

    return fit_panel(ModeFit, problem, describe)


def assurance(scene: Scene, measured: MeasuredModes, numbers: np.ndarray) -> np.ndarray | None:
    """Return (n, n) MAC of measured shapes and of those of the scene's modes with these numbers, from 1; None without.

    Raises:
        SceneError: A point of the shapes is off the plate.
    """
    if measured.shapes is None or measured.points is None:
        return None
    _check_points(scene, measured)
    plate = solve_modes(linear_part(scene), highest=0.0, count=int(numbers.max()) + RIGID)
    elastic = np.flatnonzero(plate.frequencies > 0)[numbers - 1]
    return modal_assurance(measured.shapes, plate.at_points(measured.points)[elastic])


def modal_assurance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (m, n) |a·b*|² / (a·a* b·b*) of shapes (m, points) and (n, points); 0 for a shape that does not move."""
    products = np.abs(first @ second.conj().T) ** 2
    sizes = np.outer(np.sum(np.abs(first) ** 2, axis=1), np.sum(np.abs(second) ** 2, axis=1))
    return np.divide(products, sizes, out=np.zeros_like(sizes), where=sizes > 0)


def _check_points(scene: Scene, measured: MeasuredModes) -> None:
    """Raise a SceneError if a point of the shapes is off the plate."""
    if measured.points is not None and np.any((measured.points < 0) | (measured.points > scene.plate.size)):
        raise SceneError(f"{measured.source}: a point of the shapes is off the plate of {list(scene.plate.size)} m")


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
    if measured.shapes is None or measured.points is None:
        raise SceneError(f'{measured.source}: has no shapes with points; fit.pairing = "mac" needs them')
    _check_points(scene, measured)
    return "mac"


def _paired_modes(scene: Scene, measured: MeasuredModes, pairing: str) -> np.ndarray:
    """Return (3, n) number, frequency [Hz] and damping ratio of the mode for each measured one."""
    count = len(measured.frequencies)
    numbers = np.arange(1, count + 1) if measured.numbers is None else measured.numbers
    wanted = int(numbers.max()) if pairing == "order" else SPARE[0] * max(count, int(numbers.max())) + SPARE[1]
    plate = solve_modes(linear_part(scene), highest=0.0, count=wanted + RIGID, density=DENSITY)
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
