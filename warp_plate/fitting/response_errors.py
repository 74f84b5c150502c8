"""Predicted responses and their errors log(H / Hₘ), for the search.

The real part is the ratio of amplitudes, the imaginary part the difference of phases. Sharp resonances give them many
local minima, so that responses, computed and measured alike, are first averaged over frequencies around each, with the
weights of a resonance curve that becomes narrower from stage to stage. Many plates are computed, so the search takes
coarse ones: few functions, damping that couples the lowest modes alone.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from warp_plate.fitting.fitted_panel import FreeNumbers
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.panel_responses import PanelResponses

# Half-widths of the averages of responses relative to the frequency; 0 for none.
WIDTHS = 0.2, 0.05, 0.01, 0.0
# Residuals of responses beyond so many times their usual size count less, as the absolute value and not the square.
USUAL = 2.0
# Plates that are cached, the best and the last one.
CACHED = 2


class ResponsePrediction:
    """Responses at fractions of the ranges of free numbers, see :class:`Prediction`."""

    def __init__(self, free: FreeNumbers, measured: MeasuredResponses, coarse: bool) -> None:
        self.evaluations = 0
        self._free, self._measured, self._coarse = free, measured, coarse
        self._cached = lru_cache(CACHED)(self._compute)

    def __call__(self, unknowns: np.ndarray) -> np.ndarray:
        return self._cached(tuple(unknowns.tolist())).values

    def slopes(self, unknowns: np.ndarray, central: bool) -> np.ndarray:
        neighbours = (self._free.neighbours(unknowns, index, central) for index in range(len(unknowns)))
        return self._cached(tuple(unknowns.tolist())).slopes(list(neighbours))

    def _compute(self, unknowns: tuple[float, ...]) -> PanelResponses:
        self.evaluations += 1
        return PanelResponses(self._free.panel_at(np.array(unknowns)), self._measured, self._coarse)


class LogErrors:
    """Residuals log(H / Hₘ) of averages over frequencies, real parts first, see :class:`Residuals`."""

    def __init__(self, measured: MeasuredResponses, width: float) -> None:
        self._average = _average(measured.frequencies, width).T if width else None
        self._measured = self._averaged(measured.responses)

    def __call__(self, predicted: np.ndarray) -> np.ndarray:
        errors = np.log(self._averaged(predicted) / self._measured).ravel()
        return np.concatenate([errors.real, errors.imag])

    def slopes(self, predicted: np.ndarray, changes: np.ndarray) -> np.ndarray:
        errors = (self._averaged(changes) / self._averaged(predicted)).reshape(len(changes), -1)
        return np.concatenate([errors.real, errors.imag], axis=1)

    def _averaged(self, responses: np.ndarray) -> np.ndarray:
        return responses if self._average is None else responses @ self._average


class ShapeErrors(LogErrors):
    """The same without factors and powers of the frequency in each response, which leave resonances alone."""

    def __init__(self, measured: MeasuredResponses, width: float) -> None:
        super().__init__(measured, width)
        powers = np.stack([np.ones(len(measured.frequencies)), np.log(measured.frequencies)], axis=1)
        self._powers = np.linalg.qr(powers)[0]

    def __call__(self, predicted: np.ndarray) -> np.ndarray:
        errors = np.log(self._averaged(predicted) / self._measured)
        turns = np.exp(1j * errors.imag)
        phases = np.angle(turns / np.mean(turns, axis=1, keepdims=True))
        return np.concatenate([self._without_powers(errors.real).ravel(), phases.ravel()])

    def slopes(self, predicted: np.ndarray, changes: np.ndarray) -> np.ndarray:
        errors = self._averaged(changes) / self._averaged(predicted)
        phases = errors.imag - errors.imag.mean(axis=-1, keepdims=True)
        parts = (self._without_powers(errors.real), phases)
        return np.concatenate([part.reshape(len(changes), -1) for part in parts], axis=1)

    def _without_powers(self, levels: np.ndarray) -> np.ndarray:
        return levels - (levels @ self._powers) @ self._powers.T


def _average(frequencies: np.ndarray, width: float) -> np.ndarray:
    """Return (n, n) weights of the average over frequencies around each, for a half-width relative to it."""
    distance = (frequencies - frequencies[:, None]) / (width * frequencies[:, None])
    weights = np.gradient(frequencies) / (1 + distance**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def weigh(residuals: np.ndarray, leverage: np.ndarray) -> np.ndarray:
    """Return Huber's weights of residuals, amplitude and phase of each response together."""
    sizes = np.hypot(*residuals.reshape(2, -1))
    usual = USUAL * np.median(sizes)
    return np.tile(np.sqrt(usual / np.maximum(sizes, usual)) if usual else np.ones_like(sizes), 2)
