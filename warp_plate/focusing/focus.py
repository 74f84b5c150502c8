"""Waveforms of all actuators that focus motion at points of a linear plate, and their results."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from warp_plate.focusing import methods
from warp_plate.focusing.convolution import Convolution
from warp_plate.focusing.figures import PICTURED, field_at_end, measure_focus
from warp_plate.focusing.responses import HeldResponses
from warp_plate.focusing.rest import quiet_optimum
from warp_plate.focusing.wishes import wished_motion, wished_pulse
from warp_plate.modal.modes import modes_below
from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import Focus
from warp_plate.scene.model import Scene, SceneSource

# A limit is attained to this part of it.
ATTAINED = 1e-9


def focus(scene: SceneSource, played: FocusResult | None = None) -> FocusResult:
    """Return the waveforms that focus motion at each point of ``[focus]``, by all methods.

    Args:
        scene: Linear scene with a table ``[focus]``; its grid, window and drive play no part.
        played: Waveforms made for another panel, which are played on this one (default: they are made for this one).

    Raises:
        SceneError: There is no ``[focus]``, the scene has no motion in time by modes, or no mode up to
            ``focus.highest``; a point does not move; or the waveforms do not fit the scene.
    """
    scene, started = Scene.load(scene), time.perf_counter()
    table = _table(scene)
    if played is not None:
        _check_fit(scene, table, played)
    plate = modes_below(scene, table.highest, "focus.highest")
    solved = time.perf_counter()
    responses = HeldResponses(plate, table.rate, table.recorded, table.quantity == "velocity")
    h = responses.at_points(table.points)
    for still in np.flatnonzero(~h.any(axis=(0, 2)))[:1].tolist():
        x, y = table.points[still]
        raise SceneError(f"focus.points[{still}]: nothing moves at {x:g}, {y:g}, where an edge holds the plate")
    convolution = Convolution(h, table.samples)
    gains, made, bound = _waveforms(h, convolution, table, played)
    quiet = [False] * len(table.points)
    if table.rest is not None and played is None:
        waveforms, quiet = quiet_optimum(responses, table, gains)
        made["quiet"] = methods.scale_to_limits(waveforms, *_limits(table))
    ended = time.perf_counter()
    reached = {
        name: _reached(responses, table, waveforms, convolution.move(waveforms), _gap(gains, waveforms, bound))
        for name, waveforms in made.items()
    }
    if "quiet" in reached:
        pairs = zip(reached["quiet"].limits, quiet, strict=True)
        limits = tuple(", ".join([*filter(None, [others]), *["rest"] * bound]) for others, bound in pairs)
        reached["quiet"] = replace(reached["quiet"], limits=limits)
    seconds = {"modes": solved - started, "waveforms": ended - solved, "figures": time.perf_counter() - ended}
    return FocusResult(
        scene=scene,
        modes=plate.frequencies.size,
        times=np.arange(1, table.recorded + 1) / table.rate,
        bound=bound,
        methods=reached,
        seconds=seconds,
    )


def _table(scene: Scene) -> Focus:
    """Return the scene's ``[focus]``, or refuse a scene without it, or one without modal transients."""
    if scene.focus is None:
        raise SceneError("focus: there is no such table; write [focus] with points = [[x, y]] and highest, in Hz")
    if scene.nonlinear_table is not None:
        raise SceneError(f"{scene.nonlinear_table}: waveforms are focused on a linear plate without it")
    if scene.steady:
        raise SceneError("effects.loss_factor: has no motion in time; take viscous damping or effects.modal_damping")
    return scene.focus


def _check_fit(scene: Scene, table: Focus, played: FocusResult) -> None:
    """Raise a SceneError unless waveforms that were made for another scene can be played in this one."""
    assert played.scene.focus is not None
    kept = {"points": table.points, "time": table.time, "rate": table.rate, "burst": table.burst}
    for key, value in kept.items():
        if (other := getattr(played.scene.focus, key)) != value:
            raise SceneError(f"focus.{key}: the waveforms were made with another one, {other}")
    names, others = ([actuator.name for actuator in each.actuators] for each in (scene, played.scene))
    if names != others:
        raise SceneError(f"actuators: the waveforms were made for others, {', '.join(others)}")


def _waveforms(
    h: np.ndarray, convolution: Convolution, table: Focus, played: FocusResult | None
) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
    """Return the gains and each method's waveforms, (foci, actuators, samples), and (foci,) bounds of their product."""
    energy, peak = _limits(table)
    foci, banded = np.eye(len(table.points))[:, :, None], convolution
    if table.lowest:
        banded = Convolution(methods.keep_above(h, table.rate, table.lowest), table.samples)
    gains = banded.reverse(foci * wished_motion(table))
    best, bounds = zip(*(methods.optimum(g, energy, peak) for g in gains), strict=True)
    if played is not None:
        return gains, {name: method.waveforms for name, method in played.methods.items()}, np.array(bounds)
    unscaled = {
        "time_reversal": gains,
        "one_bit": np.sign(gains),
        "inverse_filter": methods.inverse_filter(convolution, foci * wished_pulse(table), table.condition),
    }
    scaled = {name: methods.scale_to_limits(waveforms, energy, peak) for name, waveforms in unscaled.items()}
    return gains, {**scaled, "optimum": np.stack(best)}, np.array(bounds)


def _limits(table: Focus) -> tuple[float | None, float | None]:
    """Return the largest Σ w² and |w|."""
    return None if table.energy is None else table.energy * table.rate, table.peak_limit


def _gap(gains: np.ndarray, waveforms: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Return the parts (foci,) of the bounds that waveforms lack; 0 at a focus that nothing moves."""
    reached = np.einsum("fan,fan->f", gains, waveforms)
    return 1 - np.divide(reached, bound, out=np.ones_like(bound), where=bound > 0)


def _reached(
    responses: HeldResponses,
    table: Focus,
    waveforms: np.ndarray,
    motion: np.ndarray,
    gap: np.ndarray,
) -> FocusedWaveforms:
    """Return what waveforms (foci, actuators, samples) reach, whose motion at the foci is (foci, foci, samples)."""
    plate, foci = responses.plate, np.arange(len(table.points))
    size, at_focus = plate.scene.plate.size, motion[foci, foci]
    peak = at_focus[:, table.moment]
    fields, areas, contrasts = [], [], []
    states = responses.states(waveforms[..., : table.moment + 1])
    for amplitudes, point, reached in zip(responses.amplitudes(states), table.points, peak.tolist(), strict=True):
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
        misfit=None if table.burst is None else _misfit(at_focus, wished_motion(table)),
        electrical_energy=_electrical_energy(plate.scene, waveforms),
    )


def _electrical_energy(scene: Scene, waveforms: np.ndarray) -> np.ndarray | None:
    """Return (foci,) energies [J] of voltages (foci, actuators, samples) on capacitors from 0; None without these.

    That is Σ ∫ C V dV/dt dt over the times at which |V| rises, ½ C V² for each rise from 0 to V: no amplifier gets back
    what capacitors return while |V| falls.
    """
    capacitances = [actuator.capacitance for actuator in scene.actuators if actuator.capacitance is not None]
    if len(capacitances) < len(scene.actuators):
        return None
    before = np.concatenate([np.zeros_like(waveforms[..., :1]), waveforms[..., :-1]], axis=2)
    left = np.where(before * waveforms > 0, before**2, 0.0)  # through 0, where the sign changes
    rises = np.maximum(waveforms**2 - left, 0)
    return np.asarray(rises.sum(axis=2) @ np.array(capacitances) / 2)


def _misfit(motion: np.ndarray, wished: np.ndarray) -> np.ndarray:
    """Return (foci,) relative differences of motion (foci, samples) from the multiples of a waveform nearest to it."""
    nearest = np.outer(motion @ wished / (wished @ wished), wished)
    size = np.linalg.norm(nearest, axis=1)
    return np.divide(np.linalg.norm(motion - nearest, axis=1), size, out=np.full_like(size, np.nan), where=size > 0)


def _attained(table: Focus, energy: float, peak: float) -> str:
    """Return the limits that waveforms of an energy and a peak attain."""
    pairs = {"energy": (energy, table.energy), "peak": (peak, table.peak_limit)}
    return ", ".join(name for name, (has, limit) in pairs.items() if limit and has >= limit * (1 - ATTAINED))
