"""Fit a scene's free numbers to measured frequency responses.

Residuals are log(H / Hₘ): the real part is the ratio of amplitudes, the imaginary part the difference of phases. Sharp
resonances give them many local minima, so that responses, computed and measured alike, are first averaged over
frequencies around each, with the weights of a resonance curve that becomes narrower from stage to stage.

Many plates are computed, so the search takes coarse ones: few functions, damping that couples the lowest modes alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.fitting.fitted_panel import FittedPanel, fit_panel
from warp_plate.fitting.least_squares import Function
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.modal.steady import coupled_poles
from warp_plate.result.frequency_response import DERIVATIVES
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import Measurement
from warp_plate.scene.model import Scene

# Half-widths of the averages relative to the frequency; 0 for none.
WIDTHS = 0.2, 0.05, 0.01, 0.0
# Residuals beyond so many times their usual size count less, as the absolute value and not the square.
USUAL = 2.0
# Coarse plates: functions along each side, relative to those of other commands; modes that damping couples, those up to
# REACH times the highest frequency and FURTHER ones; rigid motions count as slower than the fastest by SLOWEST.
DENSITY, REACH, FURTHER, SLOWEST = 0.5, 1.5, 12, 1e-9
# Modes up to the highest frequency.
MOST_MODES = 200


@dataclass(frozen=True, eq=False)
class ResponseFit(FittedPanel):
    """A scene fitted to measured frequency responses.

    Attributes:
        measured: What was measured.
        responses: (measurements, n) fitted responses.
    """

    measured: MeasuredResponses
    responses: np.ndarray

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
    """Fit the keys under ``[fit.free]`` of a scene to measured frequency responses.

    Raises:
        SceneError: The panel has no damping, or see :func:`fit_panel`.
    """
    stages = [_residuals(measured, width) for width in WIDTHS]
    count = 2 * measured.responses.size
    found = fit_panel(
        scene,
        measured.source,
        count,
        lambda each: _responses(each, measured, coarse=True),
        stages,
        _weigh,
        lambda each: _responses(each, measured),
    )
    return ResponseFit(**vars(found), measured=measured, responses=_responses(found.scene, measured))


def _residuals(measured: MeasuredResponses, width: float) -> Function:
    """Return the function of (measurements, n) responses that returns (2 · measurements · n,) residuals."""
    average = _average(measured.frequencies, width).T if width else 1.0
    smooth = np.dot(measured.responses, average)

    def residuals(responses: np.ndarray) -> np.ndarray:
        errors = np.log(np.dot(responses, average) / smooth).ravel()
        return np.concatenate([errors.real, errors.imag])

    return residuals


def _average(frequencies: np.ndarray, width: float) -> np.ndarray:
    """Return (n, n) weights of the average over frequencies around each, for a half-width relative to it."""
    distance = (frequencies - frequencies[:, None]) / (width * frequencies[:, None])
    weights = np.gradient(frequencies) / (1 + distance**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _weigh(residuals: np.ndarray, leverage: np.ndarray) -> np.ndarray:
    """Return Huber's weights of residuals, amplitude and phase of each response together."""
    sizes = np.hypot(*residuals.reshape(2, -1))
    usual = USUAL * np.median(sizes)
    return np.tile(np.sqrt(usual / np.maximum(sizes, usual)) if usual else np.ones_like(sizes), 2)


def _responses(scene: Scene, measured: MeasuredResponses, coarse: bool = False) -> np.ndarray:
    """Return (measurements, n) responses of a scene."""
    highest, density = measured.frequencies[-1], DENSITY if coarse else 1.0
    key = f"{measured.source}: highest frequency {highest:g} Hz, which fit.range can lower"
    plate = solve_modes(linear_part(scene), highest, density=density, most=MOST_MODES, key=key)
    if not plate.loss_factors.any():
        raise SceneError("effects: responses of a panel without damping are not finite; write [effects.loss_factor]")
    forces = np.stack([_force(plate, each) for each in scene.measurement], axis=1)
    shapes = plate.at_points([each.point for each in scene.measurement])
    respond = _respond_coarsely if coarse and not plate.proportional else ModalPlate.respond
    amplitudes = respond(plate, measured.frequencies, forces)
    turn, powers = 2j * np.pi * measured.frequencies, [DERIVATIVES[each.quantity] for each in scene.measurement]
    gains = np.array([each.gain for each in scene.measurement])[:, None] * turn ** np.array(powers)[:, None]
    responses = gains * np.einsum("fmk,mk->kf", amplitudes, shapes)
    for row in np.flatnonzero(~responses.any(axis=1))[:1].tolist():
        raise SceneError(f"measurement[{row}]: an edge holds the panel where it is driven or sensed; move the point")
    return responses


def _respond_coarsely(plate: ModalPlate, frequencies: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the amplitudes of :meth:`ModalPlate.respond` without the coupling of high modes."""
    turn, count = 2j * np.pi * frequencies[:, None], FURTHER + int((plate.frequencies < REACH * frequencies[-1]).sum())
    low, squares = np.s_[:count, :count], plate.angular_frequencies[:count] ** 2
    stiffness = np.diag(squares) + 1j * plate.hysteretic[low]
    unit = np.sqrt(np.maximum(squares, SLOWEST**2 * squares[-1]))
    poles, motions, inputs = coupled_poles(stiffness, plate.damping[low], unit)
    amplitudes = np.asarray(forces / plate.dynamic_stiffness(turn[:, 0].imag)[:, :, None])
    shares = (inputs @ forces[:count]) / (turn - poles)[:, :, None]
    amplitudes[:, :count] = motions @ shares
    return amplitudes


def _force(plate: ModalPlate, measurement: Measurement) -> np.ndarray:
    """Return the (modes,) modal forces [1/√kg] of 1 N, evenly over an actuator or at a point."""
    if measurement.force_at is not None:
        return plate.at_points([measurement.force_at])[:, 0]
    area = next(each.area for each in plate.scene.actuators if each.name == measurement.actuator)
    return plate.patch_forces([area])[:, 0] / ((area[1] - area[0]) * (area[3] - area[2]))
