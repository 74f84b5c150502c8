"""Figures of merit of waveforms: motion, area and contrast of foci, energies and limits; and the moving plate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.focusing.methods import Convolution
from warp_plate.focusing.responses import HeldResponses
from warp_plate.focusing.wishes import Wish
from warp_plate.modal.modes import ModalPlate
from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.result.motion import Motion
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import Focus
from warp_plate.scene.model import Scene

# Cells of the raster between two lines of the plate's splines, which follow its shortest waves; a picture takes the
# middle of each square of PICTURED² of them.
CELLS, PICTURED = 6, 3
HALF = 0.5  # −6 dB
# A limit is attained to this part of it.
ATTAINED = 1e-9
# Points of a movie's picture between two lines of the splines; periods of the highest frequency that are shown on both
# sides of a pulse; frames, and most bytes of them.
POINTS, PERIODS, FRAMES, FRAMES_BYTES = 2, 10, 60, 2**30


@dataclass(frozen=True)
class Figures:
    """Figures of merit of the motion of the foci."""

    peak: np.ndarray  # (foci,) motion of each focus at its moment
    # (foci,) largest motion of the other foci over a focus's peak [dB]; −∞ if there is one focus
    crosstalk_db: np.ndarray
    misfit: np.ndarray  # (foci,) relative differences of motion from the nearest multiple of what is wished

    @staticmethod
    def measure(motion: np.ndarray, wish: Wish) -> Figures:
        """Return the figures of motion (sets, foci, samples), each set made for one focus."""
        foci = np.arange(len(motion))
        peak, followed = motion[foci, foci, wish.moments], motion[foci, foci]
        others = np.abs(motion).max(axis=2) * (1 - np.eye(len(motion)))
        with np.errstate(divide="ignore", invalid="ignore"):
            crosstalk_db = 20 * np.log10(others.max(axis=1) / np.abs(peak))
        factor = (followed * wish.motion).sum(axis=1) / (wish.motion**2).sum(axis=1)
        nearest = factor[:, None] * wish.motion
        size, error = (np.linalg.norm(rows, axis=1) for rows in (nearest, followed - nearest))
        misfit = np.divide(error, size, out=np.full_like(size, np.nan), where=size > 0)
        return Figures(peak, np.asarray(crosstalk_db), misfit)


def describe_waveforms(
    responses: HeldResponses, convolution: Convolution, wish: Wish, waveforms: np.ndarray, gap: np.ndarray
) -> FocusedWaveforms:
    """Return waveforms (foci, actuators, samples) and what they attain; ``gap`` (foci,) is what the bounds leave."""
    plate, table, motion = responses.plate, responses.table, convolution.move(waveforms)
    figures = Figures.measure(motion, wish)
    fields, measured = [], []
    amplitudes = responses.amplitudes(responses.states_at(waveforms, wish.moments))
    for of_focus, point, peak in zip(amplitudes, table.points, figures.peak.tolist(), strict=True):
        field = _field(plate, of_focus)
        measured.append(measure_focus(field, plate.scene.plate.size, point, peak))
        fields.append(field[PICTURED // 2 :: PICTURED, PICTURED // 2 :: PICTURED])
    areas, contrasts = zip(*measured, strict=True)
    energy, largest = (waveforms**2).sum(axis=(1, 2)) / table.rate, np.abs(waveforms).max(axis=(1, 2))
    return FocusedWaveforms(
        waveforms=waveforms,
        responses=motion,
        fields=np.stack(fields),
        peak=figures.peak,
        focus_area=np.array(areas),
        contrast_db=np.array(contrasts),
        energy=energy,
        gap=gap,
        limits=tuple(_attained_limits(table, *pair) for pair in zip(energy, largest, strict=True)),
        misfit=figures.misfit if wish.shaped else None,
        electrical_energy=_electrical_energy(plate.scene, waveforms),
    )


def _field(plate: ModalPlate, amplitudes: np.ndarray) -> np.ndarray:
    """Return the (ny, nx) field of amplitudes (modes,) in the middles of equal cells."""
    counts = [CELLS * count for count in plate.space.shape[::-1]]
    sides = zip(plate.scene.plate.size, counts, strict=True)
    return plate.displacement(amplitudes, *(side * (np.arange(count) + 0.5) / count for side, count in sides))


def measure_focus(
    field: np.ndarray, size: tuple[float, float], point: tuple[float, float], peak: float
) -> tuple[float, float]:
    """Return the area of the focus [m²], and its contrast [dB], of a field (ny, nx) in the middles of equal cells.

    The focus is the part of the plate around the point that moves at least half as far as the point does; its contrast
    is that of the point's motion to the root mean square over the rest of the plate.
    """
    i, j = (
        min(int(at / side * count), count - 1) for at, side, count in zip(point, size, field.shape[::-1], strict=True)
    )
    inside = np.abs(field) >= HALF * abs(peak)
    inside[j, i] = True  # the point itself, which the middle of its cell may just miss
    parts, _ = scipy.ndimage.label(inside)
    focus = parts == parts[j, i]
    rest = math.sqrt(float(np.mean(field[~focus] ** 2))) if not focus.all() else 0.0
    contrast = 20 * math.log10(abs(peak) / rest) if peak and rest else math.nan
    return float(focus.mean()) * math.prod(size), contrast


def _electrical_energy(scene: Scene, waveforms: np.ndarray) -> np.ndarray | None:
    """Return (foci,) energies [J] of voltages (foci, actuators, samples) on capacitors from 0; None without these.

    That is Σ ∫ C V dV/dt dt while |V| rises: no amplifier gets back what capacitors return while |V| falls.
    """
    capacitances = [actuator.capacitance for actuator in scene.actuators if actuator.capacitance is not None]
    if len(capacitances) < len(scene.actuators):
        return None
    before = np.concatenate([np.zeros_like(waveforms[..., :1]), waveforms[..., :-1]], axis=2)
    left = np.where(before * waveforms > 0, before**2, 0.0)  # through 0, where the sign changes
    rises = np.maximum(waveforms**2 - left, 0)
    return np.asarray(rises.sum(axis=2) @ np.array(capacitances) / 2)


def _attained_limits(table: Focus, energy: float, peak: float) -> str:
    """Return the limits that waveforms of an energy and a peak attain."""
    pairs = {"energy": (energy, table.energy), "peak": (peak, table.peak_limit)}
    return ", ".join(name for name, (value, limit) in pairs.items() if limit and value >= limit * (1 - ATTAINED))


def focus_motions(
    result: FocusResult, methods: Sequence[str] = (), span: tuple[float, float] | None = None, frames: int = FRAMES
) -> list[Motion]:
    """Return the motion of the plate under the waveforms of methods (default: all) for the first point, over its
    largest displacement, which is in the name.

    Frames are at the samples nearest to even times, one of them at the moment, in a span from start to end [s]
    (default: ten periods of ``focus.highest`` around the moment, or the burst).

    Raises:
        SceneError: A method is unknown, or the span holds fewer than two samples or lies outside the responses.
    """
    table, names = result.scene.focus, list(methods or result.methods)
    assert table is not None
    if unknown := [name for name in names if name not in result.methods]:
        raise SceneError(f"case = {unknown[0]!r}: must be one of {', '.join(result.methods)}")
    recorded, moment = result.times.size, table.moment
    responses = HeldResponses.of_scene(result.scene, recorded, velocity=False)
    plate = responses.plate
    x, y = (
        np.linspace(0, side, POINTS * count + 1)
        for side, count in zip(result.scene.plate.size, plate.space.shape[::-1], strict=True)
    )
    if result.wished is not None:
        moment = int(np.abs(result.wished[0]).argmax())
    steps = _samples(table.rate, recorded, moment, span or _usual_span(result), frames)
    if (size := 8 * len(names) * steps.size * x.size * y.size) > FRAMES_BYTES:
        raise SceneError(f"frames = {steps.size}: take {size} bytes; at most {FRAMES_BYTES} are possible")
    played = np.stack([result.methods[name].waveforms[0] for name in names])
    pressures = np.pad(played, ((0, 0), (0, 0), (0, recorded - played.shape[2])))
    states, fields = responses.states(pressures[..., : steps[0] + 1]), []
    for sample in range(steps[0], steps[-1] + 1):
        if sample > steps[0]:
            states = responses.next_states(states, pressures[..., sample])
        if sample in steps:
            both = [plate.displacement(responses.amplitudes(states, rates), x, y) for rates in (False, True)]
            fields.append(np.stack(both).astype(np.float32))
    displacement, velocity = np.stack(fields, axis=2)
    largest = [float(np.abs(field).max()) or 1.0 for field in displacement]
    mass = plate.space.density(x, y)
    return [
        Motion(
            name=f"{name.replace('_', ' ')}: {_length(largest[index])}",
            frequency=table.burst.frequency if table.burst else (table.lowest + table.highest) / 2,
            span=(float(steps[0] + 1) / table.rate, float(steps[-1] + 2) / table.rate),
            times=(steps + 1) / table.rate,
            displacement=displacement[index] / largest[index],
            velocity=velocity[index] / largest[index],
            surface_density=mass,
        )
        for index, name in enumerate(names)
    ]


def _length(value: float) -> str:
    """Return a displacement [m] in nanometres or micrometres."""
    return f"{1e6 * value:.3g} µm" if value >= 1e-6 else f"{1e9 * value:.3g} nm"


def _usual_span(result: FocusResult) -> tuple[float, float]:
    table, end = result.scene.focus, float(result.times[-1])
    assert table is not None
    if result.wished is not None:
        return 0.0, end
    half = PERIODS / table.highest if table.burst is None else table.burst.half
    return max(table.time - half, 0.0), min(table.time + half, end)


def _samples(rate: int, recorded: int, moment: int, span: tuple[float, float], frames: int) -> np.ndarray:
    """Return the indices of the samples at the ends of which there are frames, including the moment of the focus."""
    if not 0 <= span[0] < span[1] <= recorded / rate * (1 + 1e-9):
        end = recorded / rate
        raise SceneError(f"start = {span[0]:g}, end = {span[1]:g}: must lie within the motion, from 0 to {end:g} s")
    wanted = np.rint(np.linspace(*span, frames) * rate).astype(int) - 1
    steps = np.unique(np.clip(wanted, 0, recorded - 1))
    if steps[0] < moment < steps[-1]:
        steps[np.abs(steps - moment).argmin()] = moment
    if steps.size < 2:
        raise SceneError(f"{span[0]:g} ... {span[1]:g} s: contains fewer than two samples at {rate} Hz")
    return steps
