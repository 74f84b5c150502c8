"""What waveforms reach: motion and field at the foci, energies and limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warp_plate.focusing.convolution import Convolution
from warp_plate.focusing.figures import PICTURED, field_at_end, measure_focus, misfit
from warp_plate.focusing.responses import HeldResponses
from warp_plate.focusing.waveforms import Gains
from warp_plate.focusing.wishes import Wish
from warp_plate.result.focus import FocusedWaveforms
from warp_plate.scene.focus import Focus
from warp_plate.scene.model import Scene

# A limit is attained to this part of it.
ATTAINED = 1e-9


def what_is_reached(
    responses: HeldResponses, wish: Wish, waveforms: np.ndarray, convolution: Convolution, gains: Gains
) -> FocusedWaveforms:
    """Return what waveforms (foci, actuators, samples) reach."""
    plate, table, motion = responses.plate, responses.plate.scene.focus, convolution.move(waveforms)
    assert table is not None
    foci, size = np.arange(len(table.points)), plate.scene.plate.size
    at_focus = motion[foci, foci]
    peak = at_focus[foci, wish.moments]
    fields, areas, contrasts = [], [], []
    moved = responses.amplitudes(responses.states_at(waveforms, wish.moments))
    for amplitudes, point, reached in zip(moved, table.points, peak.tolist(), strict=True):
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
        gap=gains.gap(waveforms),
        limits=tuple(_attained(table, *each) for each in zip(energy, np.abs(waveforms).max(axis=(1, 2)), strict=True)),
        misfit=misfit(at_focus, wish.motion) if wish.shaped else None,
        electrical_energy=_electrical_energy(plate.scene, waveforms),
    )


def with_rest(reached: FocusedWaveforms, attained: list[bool]) -> FocusedWaveforms:
    """Return what is reached with "rest" among the limits of the foci where the bound of the rest is attained."""
    pairs = zip(reached.limits, attained, strict=True)
    limits = (", ".join([*filter(None, [others]), *["rest"] * bound]) for others, bound in pairs)
    return replace(reached, limits=tuple(limits))


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


def _attained(table: Focus, energy: float, peak: float) -> str:
    """Return the limits that waveforms of an energy and a peak attain."""
    pairs = {"energy": (energy, table.energy), "peak": (peak, table.peak_limit)}
    return ", ".join(name for name, (has, limit) in pairs.items() if limit and has >= limit * (1 - ATTAINED))
