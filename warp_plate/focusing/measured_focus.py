"""Waveforms that focus motion at points of a measured panel: the methods of :mod:`warp_plate.focusing.methods`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.focusing.figures import Figures
from warp_plate.focusing.methods import (
    Convolution,
    find_gains,
    limits_of,
    make_waveforms,
    scale_to_limits,
)
from warp_plate.focusing.wishes import make_wish
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.measured_plate import POWERS, MeasuredPlate
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import Focus

UNEVEN = 1e-6  # relative difference of the distances between frequencies that counts as none


@dataclass(frozen=True, eq=False)
class MeasuredWaveforms:
    """Waveforms of one method and what they do to the panel."""

    waveforms: np.ndarray  # (foci, actuators, samples), held between samples, in the unit of the drives
    peak: np.ndarray  # (foci,) motion at the focus at its moment [m or m/s]
    contrast_db: np.ndarray  # (foci,) peak over the root mean square of all scanned points at that moment [dB]
    crosstalk_db: np.ndarray  # (foci,) largest motion of the other foci over the peak [dB]; −∞ for one focus
    misfit: np.ndarray  # (foci,) relative difference from the nearest multiple of what is wished
    gap: np.ndarray  # (foci,) part of the bound of all waveforms within the limits that the peak lacks


@dataclass(frozen=True, eq=False)
class MeasuredFocus:
    """Waveforms for each point of ``[focus]``, by all methods."""

    table: Focus
    bound: np.ndarray  # (foci,) no waveforms within the limits move the focus more [m or m/s]
    methods: Mapping[str, MeasuredWaveforms]


def focus_measured(plate: MeasuredPlate) -> MeasuredFocus:
    """Return the waveforms that focus at the points of a scene's ``[focus]``.

    Raises:
        SceneError: A point is off the panel, or the responses end before the motion does.
    """
    table = plate.scene.focus
    assert table is not None
    wish = make_wish(table, plate.scene.folder, len(plate.largest))
    h = _responses(plate, table, wish.recorded)
    at_foci = np.einsum("fp,aps->afs", _places(plate, table), h)
    gains, limits = find_gains(at_foci, table, wish), limits_of(table)
    made = make_waveforms(at_foci, table, wish, gains)
    convolution, methods = Convolution(at_foci, wish.samples), {}
    for name, raw in made.items():
        waveforms = scale_to_limits(raw, *limits)
        figures = Figures.measure(convolution.move(waveforms), wish)
        others = [_at_moment(h, *pair) for pair in zip(waveforms, wish.moments.tolist(), strict=True)]
        contrast = [
            20 * math.log10(max(abs(peak), 1e-300) / max(float(np.sqrt(np.mean(field**2))), 1e-300))
            for peak, field in zip(figures.peak.tolist(), others, strict=True)
        ]
        methods[name] = MeasuredWaveforms(
            waveforms, figures.peak, np.array(contrast), figures.crosstalk_db, figures.misfit, gains.gap(waveforms)
        )
    return MeasuredFocus(table, gains.bound, methods)


def _places(plate: MeasuredPlate, table: Focus) -> np.ndarray:
    """Return the (foci, points) interpolation to the foci."""
    for index, point in enumerate(table.points):
        if not plate.holds(point):
            raise SceneError(f"focus.points[{index}]: {list(point)} is off the measured panel, {plate.extent}")
    return plate.interpolation(np.array(table.points))


def _responses(plate: MeasuredPlate, table: Focus, samples: int) -> np.ndarray:
    """Return h (actuators, points, samples): motion l + 1 samples after the beginning of a unit drive of one sample."""
    matrix, quantity = plate.matrix, plate.scene.measured.quantity
    moved = len(matrix.points) * len(matrix.names) * samples
    waves = 0 if matrix.impulses is not None else len(matrix.frequencies) * samples
    what = f"focus.time = {table.time:g}: the motion of {len(matrix.points)} points at {samples} samples"
    refuse_beyond_memory(16.0 * (moved + waves) + 8.0 * moved * (waves > 0), what)
    if matrix.impulses is not None:
        wanted = {"displacement": "receptance", "velocity": "mobility"}[table.quantity]
        if matrix.rate != table.rate or quantity != wanted:
            held = f"{matrix.rate:g} samples a second of a {quantity}"
            raise SceneError(f"focus: the file has impulse responses with {held}; write rate and quantity to match")
        given = matrix.impulses[..., :samples]
        return np.pad(given, ((0, 0), (0, 0), (0, samples - given.shape[2])))
    spacing = np.diff(matrix.frequencies)
    if len(spacing) < 2 or np.ptp(spacing) > UNEVEN * matrix.frequencies[-1]:
        raise SceneError("focus: takes responses at evenly spaced frequencies")
    step = float(spacing.mean())
    if samples / table.rate > 1 / step:
        last = f"their {samples / table.rate:.3g} s of motion need frequencies at most {table.rate / samples:.3g} Hz"
        raise SceneError(f"focus.time = {table.time:g}: {last} apart, not {step:.3g} Hz")
    if matrix.frequencies[0] > max(table.lowest, 1.5 * step):
        raise SceneError(f"focus.lowest = {table.lowest:g}: responses begin at {matrix.frequencies[0]:g} Hz")
    used = matrix.frequencies <= table.highest
    if not used.any() or matrix.frequencies[-1] < table.highest - step:
        raise SceneError(f"focus.highest = {table.highest:g}: responses end at {matrix.frequencies[-1]:g} Hz")
    jw = 2j * math.pi * matrix.frequencies[used]
    power = POWERS[quantity] - POWERS["receptance" if table.quantity == "displacement" else "mobility"]
    spectrum = (1 - np.exp(-jw / table.rate)) / jw * jw**power * 2 * step
    waves = spectrum[:, None] * np.exp(np.outer(jw, np.arange(1, samples + 1) / table.rate))
    rows = np.moveaxis(matrix.responses[used], 0, 2)  # (points, actuators, n)
    return np.asarray((rows.real @ waves.real - rows.imag @ waves.imag).swapaxes(0, 1))


def _at_moment(h: np.ndarray, waveform: np.ndarray, moment: int) -> np.ndarray:
    """Return the motion of all points (points,) at the end of a sample under a waveform (actuators, samples)."""
    count = min(moment + 1, waveform.shape[1])
    lags = moment - np.arange(count)
    return np.asarray(np.einsum("apn,an->p", h[..., lags], waveform[:, :count]))
