"""Waveforms of all actuators that focus motion at points of a linear plate, and what they reach."""

from __future__ import annotations

import time

import numpy as np
import scipy

from warp_plate.focusing import methods
from warp_plate.focusing.figures import PICTURED, field_at_end, measure_focus
from warp_plate.focusing.responses import HeldResponses
from warp_plate.modal.modes import ModalPlate, modes_below
from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import Focus
from warp_plate.scene.model import Scene, SceneSource

# Part of the waveforms' duration for which responses go on after the focus.
AFTER = 0.2
# A limit is attained to this part of it.
ATTAINED = 1e-9


def focus(scene: SceneSource) -> FocusResult:
    """Return the waveforms that focus motion at each point of ``[focus]``, by all methods.

    Args:
        scene: Linear scene with a table ``[focus]``; its grid, window and drive play no part.

    Raises:
        SceneError: There is no ``[focus]``, the scene has no motion in time by modes, or no mode up to
            ``focus.highest``.
    """
    scene, started = Scene.load(scene), time.perf_counter()
    table = _table(scene)
    plate = modes_below(scene, table.highest)
    samples, found = table.samples, time.perf_counter()
    later = round(samples * (1 + AFTER))
    responses = HeldResponses(plate, table.rate, later, table.quantity == "velocity")
    h = responses.at_points(table.points)
    wanted = methods.keep_above(h[..., :samples], table.rate, table.lowest) if table.lowest else h[..., :samples]
    gains = methods.time_reversal(wanted)
    made, bound = _waveforms(gains, table)
    solved = time.perf_counter()
    reached = {
        name: _reached(responses, plate, table, waveforms, respond(h, waveforms), _gap(gains, waveforms, bound))
        for name, waveforms in made.items()
    }
    seconds = {"modes": found - started, "waveforms": solved - found, "figures": time.perf_counter() - solved}
    return FocusResult(
        scene=scene,
        modes=plate.frequencies.size,
        times=np.arange(1, later + 1) / table.rate,
        bound=bound,
        methods=reached,
        seconds=seconds,
    )


def respond(h: np.ndarray, waveforms: np.ndarray) -> np.ndarray:
    """Return motion (sets, foci, samples of h) under sets of waveforms (sets, actuators, samples).

    Args:
        h: (actuators, foci, samples) responses to one sample.
    """
    length = scipy.fft.next_fast_len(h.shape[-1] + waveforms.shape[-1] - 1, real=True)
    spectra = np.einsum("saw,afw->sfw", scipy.fft.rfft(waveforms, length), scipy.fft.rfft(h, length), optimize=True)
    return np.asarray(scipy.fft.irfft(spectra, length)[..., : h.shape[-1]])


def _table(scene: Scene) -> Focus:
    """Return the scene's ``[focus]``, or refuse a scene without one, or one whose motion is no sum over modes."""
    if scene.focus is None:
        raise SceneError("focus: there is no such table; write [focus] with points = [[x, y]] and highest, in Hz")
    if scene.nonlinear_table is not None:
        raise SceneError(f"{scene.nonlinear_table}: waveforms are focused on a linear plate without it")
    if scene.steady:
        raise SceneError("effects.loss_factor: has no motion in time; take viscous damping or effects.modal_damping")
    return scene.focus


def _waveforms(gains: np.ndarray, table: Focus) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the waveforms of each method, shaped as the gains (foci, actuators, samples), and (foci,) upper bounds."""
    energy, peak = None if table.energy is None else table.energy * table.rate, table.peak_limit
    best, bounds = zip(*(methods.optimum(g, energy, peak) for g in gains), strict=True)
    plain = {"time_reversal": gains, "one_bit": np.sign(gains)}
    scaled = {name: methods.scale_to_limits(waveforms, energy, peak) for name, waveforms in plain.items()}
    return {**scaled, "optimum": np.stack(best)}, np.array(bounds)


def _gap(gains: np.ndarray, waveforms: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Return the parts (foci,) of the bounds that waveforms lack; 0 at a focus that nothing moves."""
    reached = np.einsum("fan,fan->f", gains, waveforms)
    return 1 - np.divide(reached, bound, out=np.ones_like(bound), where=bound > 0)


def _reached(
    responses: HeldResponses,
    plate: ModalPlate,
    table: Focus,
    waveforms: np.ndarray,
    motion: np.ndarray,
    gap: np.ndarray,
) -> FocusedWaveforms:
    """Return what waveforms (foci, actuators, samples) reach, whose motion at the foci is (foci, foci, samples)."""
    size, foci = plate.scene.plate.size, np.arange(len(table.points))
    peak = motion[foci, foci, table.samples - 1]
    fields, areas, contrasts = [], [], []
    for amplitudes, point, reached in zip(responses.amplitudes(waveforms), table.points, peak.tolist(), strict=True):
        fine = field_at_end(plate, amplitudes)
        area, contrast = measure_focus(fine, size, point, reached)
        fields.append(fine[PICTURED // 2 :: PICTURED, PICTURED // 2 :: PICTURED])
        areas.append(area)
        contrasts.append(contrast)
    energy = (waveforms**2).sum(axis=(1, 2)) / table.rate
    return FocusedWaveforms(
        waveforms=waveforms,
        responses=motion,
        fields=np.stack(fields),
        peak=peak,
        focus_area=np.array(areas),
        contrast_db=np.array(contrasts),
        energy=energy,
        gap=gap,
        limits=tuple(_attained(table, *each) for each in zip(energy, np.abs(waveforms).max(axis=(1, 2)), strict=True)),
    )


def _attained(table: Focus, energy: float, peak: float) -> str:
    """Return the limits that waveforms of an energy and a peak attain."""
    pairs = {"energy": (energy, table.energy), "peak": (peak, table.peak_limit)}
    return ", ".join(name for name, (has, limit) in pairs.items() if limit and has >= limit * (1 - ATTAINED))
