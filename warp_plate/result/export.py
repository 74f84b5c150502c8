"""Results in the formats of other programs.

Fields over time become a VTKHDF file for ParaView, written without VTK: the plate is flat image data in the plane
z = 0, with point data such as ``displacement_best`` [m] and the fractions of each node's cell that lie in the
``target`` and under the ``actuators``. See "VTKHDF format specification" (temporal image data) of VTK.

Traces become CSV, and drives WAV or CSV for an amplifier, with a channel for each actuator. Channel k of a drive holds
w_k cos(2πft − φ_k) divided by the full scale, so that 1.0 stands for the same pressure [N/m²] or voltage in every
channel, or for the same force [N] if the scene gives a force for every actuator. It lasts a whole number of periods, so
that it can be played in a loop.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np

from warp_plate.effects.table import TRAVELLING
from warp_plate.plate.weights import REGIONS, node_positions, region_weights
from warp_plate.result.atomic_io import atomic_paths, write_table
from warp_plate.result.case import Case
from warp_plate.result.hdf5 import create_hdf5
from warp_plate.result.model import Result
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

Format = Literal["vtkhdf", "traces-csv", "drive-wav", "drive-csv"]
# Units of exported fields, by the first word of their names.
UNITS = {"displacement": "m", "velocity": "m/s", "rms": "m/s", "target": "1", "actuators": "1"}
HIDDEN = 2  # of vtkGhostType: points that programs leave out
ROWS_AT_ONCE = 2**16  # rows that are composed at once
Encoding = Literal["float32", "pcm16", "pcm24"]
# WAVE_FORMAT and bytes a sample.
FORMATS: dict[Encoding, tuple[int, int]] = {"float32": (3, 4), "pcm16": (1, 2), "pcm24": (1, 3)}
# Code of WAVE_FORMAT_EXTENSIBLE and the common end of the GUIDs of the formats in it.
EXTENSIBLE, GUID_END = 0xFFFE, bytes.fromhex("0000 1000 8000 00aa 0038 9b71")
WAV_BYTES = 2**32 - 2**20  # a WAV file counts its bytes with 32 bits; 2**20 for the chunks before the samples
OVER_SCALE = 1e-9  # by which a drive may pass full scale: a force of 2 N becomes 2.0000000000000004 N
TRIED_PERIODS = 10_000  # lengths that are compared to find the loop whose end is nearest to a sample


def write_vtkhdf(scene: Scene, times: np.ndarray, fields: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write all times into one .vtkhdf file, for ParaView 5.12 and later; return its path.

    Args:
        times: (times,) times [s].
        fields: (times, ny, nx) fields, or (1, ny, nx) constant ones, by names that begin with a word of ``UNITS``; the
            first one is active.

    Raises:
        SceneError: there are no times, or the file cannot be written.
    """
    constant = {name: field[None] for name, field in _constant_fields(scene, times).items()}
    with create_hdf5(path) as file:
        root = file.create_group("VTKHDF")
        nx, ny = scene.grid.nodes
        root.attrs["Version"] = np.array([2, 0])
        root.attrs["Type"] = np.bytes_("ImageData")
        root.attrs["WholeExtent"] = np.array([0, nx - 1, 0, ny - 1, 0, 0])
        root.attrs["Origin"] = np.zeros(3)
        root.attrs["Spacing"] = np.array([*scene.spacing, 1.0])
        root.attrs["Direction"] = np.eye(3).ravel()
        points = root.create_group("PointData")
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = len(times)
        steps["Values"] = times.astype(float)
        offsets = steps.create_group("PointDataOffsets")
        # Arrays are (time, y, x): the format leaves out the axis of a flat image's thickness.
        on_plate = _nodes_on_plate(scene)
        for name, field in {**fields, **constant}.items():
            points[name] = np.where(on_plate, field, np.nan).astype("<f4")
            points[name].attrs["units"] = UNITS[name.split("_")[0]]
            offsets[name] = np.minimum(np.arange(len(times)), len(field) - 1)
        # The active array, for older readers and for those of version 2.6 of the format.
        if not on_plate.all():
            points["vtkGhostType"] = np.where(on_plate, 0, HIDDEN).astype("u1")[None]
            offsets["vtkGhostType"] = np.zeros(len(times), dtype=int)
        active = next(iter(fields))
        points.attrs["Scalars"] = np.bytes_(active.encode())
        points[active].attrs["Attribute"] = "Scalars"
    return [path]


def _nodes_on_plate(scene: Scene) -> np.ndarray:
    """Return (ny, nx), true for nodes that are not beyond an outline or in a hole."""
    if scene.outline is None:
        return np.ones(scene.grid.nodes[::-1], dtype=bool)
    return scene.outline.contains(np.stack(np.meshgrid(*node_positions(scene)), axis=-1))


def _constant_fields(scene: Scene, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the (ny, nx) covered fractions of each node's cell by name; refuse a series without times."""
    if not len(times):
        raise SceneError("holds no displacements; add record.times = [...] (seconds) to its scene and run it again")
    areas = {str(index): actuator for index, actuator in enumerate(scene.actuators)}
    weights = region_weights(scene.with_keys("grid", load="overlap"), areas)
    actuators = np.minimum(weights[len(REGIONS) :].sum(axis=0), 1)
    return {"target": weights[REGIONS.index("target")], "actuators": actuators}


@dataclass(frozen=True, eq=False)
class Signal:
    """Signals of all actuators."""

    names: tuple[str, ...]
    full_scale: float  # value of 1.0, in ``unit``
    unit: str
    rate: int  # [1/s]
    samples: int
    about: str  # for the comment of a WAV file

    @property
    def full_scale_text(self) -> str:
        return f"{self.full_scale:.9g} {self.unit.replace('²', '^2')}"

    def blocks(self) -> Iterator[np.ndarray]:
        """Yield (samples, 1 + actuators) blocks of the time [s] and the signals over the full scale."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class DriveSignal(Signal):
    """Signals of all actuators over a whole number of periods."""

    phasors: np.ndarray  # (actuators,) complex amplitudes relative to ``full_scale``
    frequency: float  # [Hz]
    periods: int
    seam: float  # phase jump [degrees] where the end meets the beginning; 0 for a whole number of samples

    def blocks(self) -> Iterator[np.ndarray]:
        for start in range(0, self.samples, ROWS_AT_ONCE):
            time = np.arange(start, min(start + ROWS_AT_ONCE, self.samples)) / self.rate
            rotation = np.exp(2j * np.pi * np.mod(self.frequency * time, 1))
            yield np.column_stack([time, (rotation[:, None] * self.phasors).real])


@dataclass(frozen=True, eq=False)
class WaveformSignal(Signal):
    """Waveforms of all actuators, of any shape."""

    waveforms: np.ndarray  # (actuators, samples) [unit]

    def blocks(self) -> Iterator[np.ndarray]:
        yield np.column_stack([np.arange(self.samples) / self.rate, self.waveforms.T / self.full_scale])


def make_drive_signal(
    scene: Scene, case: Case, rate: int, duration: float, full_scale: float | None = None
) -> DriveSignal:
    """Return the signals of a case at a rate [1/s] over at most a duration [s], or refuse what cannot be played.

    Full scale is in newtons if the scene gives a force for every actuator, else in the unit of its magnitudes (default:
    the largest of them).
    """
    if (key := scene.nonperiodic_key) is not None and key != TRAVELLING:
        raise SceneError(f"{key}: only tones of drive.frequency are written, which this drive is not")
    frequency, phasors, unit = scene.drive.frequency, case.phasors, scene.drive_unit
    if all(actuator.force is not None for actuator in scene.actuators):
        phasors, unit = phasors * [actuator.amplitude_area for actuator in scene.actuators], "N"
    largest = float(np.abs(phasors).max())
    full_scale = full_scale_of(full_scale, largest, unit)
    if rate <= 2 * frequency:
        raise SceneError(f"--rate {rate}: {frequency:g} Hz takes more than {2 * frequency:g} samples a second")
    if not 1 <= duration * frequency < float("inf"):
        raise SceneError(f"--duration {duration:g}: must be at least a period, {1 / frequency:.3g} s")
    if duration * rate * len(scene.actuators) * FORMATS["float32"][1] > WAV_BYTES:
        raise SceneError(f"--duration {duration:g}: {len(scene.actuators)} channels take more than 4 GiB; write less")
    periods, samples, seam = whole_periods(frequency, rate, duration)
    names = tuple(actuator.name for actuator in scene.actuators)
    return DriveSignal(
        names, full_scale, unit, rate, samples, f"{frequency!r} Hz", phasors / full_scale, frequency, periods, seam
    )


def full_scale_of(asked: float | None, largest: float, unit: str) -> float:
    """Return the number that 1.0 stands for (default: the largest of the drive), which the largest may pass by rounding
    only."""
    if not largest > 0:
        raise SceneError("its drive is zero: there is nothing to play")
    if asked is not None and not largest * (1 - OVER_SCALE) <= asked < float("inf"):
        raise SceneError(f"--full-scale {asked:g}: must be at least the largest of the drive, {largest:.9g} {unit}")
    return max(asked or 0.0, largest)


def whole_periods(frequency: float, rate: int, duration: float) -> tuple[int, int, float]:
    """Return the periods, samples and seam [degrees] of the loop with the smallest seam, the longest of equal ones.

    Loops last from half of ``duration`` [s] to all of it. Frequencies are exact decimals, such as 290.1 Hz.
    """
    exact = Fraction(repr(float(frequency)))
    period_samples = rate / exact
    most = int(Fraction(repr(float(duration))) * exact)
    tried = range(most, max(most // 2, most - TRIED_PERIODS, 0), -1)
    periods = min(tried, key=lambda count: abs(round(count * period_samples) - count * period_samples))
    samples = round(periods * period_samples)
    return periods, samples, float(360 * (samples / period_samples - periods))


def write_traces(result: Result, cases: Mapping[str, Case], path: Path) -> list[Path]:
    """Write the time [s], and the displacement [m] of each case at each recorded point; return the path."""
    points = result.scene.record.points
    if not points or not result.trace_times.size:
        raise SceneError("holds no traces; add record.points = [[x, y], ...] (metres) to its scene and run it again")
    columns = [f"{name} u(x={x!r} y={y!r}) [m]" for name in cases for x, y in points]
    rows = np.column_stack([result.trace_times, *(case.trace.T for case in cases.values())])
    return write_table(path, ["time [s]", *columns], [rows])


def write_drive_csv(signal: Signal, path: Path) -> list[Path]:
    """Write the time [s] and each actuator's signal, with the full scale in the header; return the path."""
    heading = ["time [s]", *(f"{name} [1 = {signal.full_scale_text}]" for name in signal.names)]
    return write_table(path, heading, signal.blocks())


def write_wav(signal: Signal, path: Path, encoding: Encoding = "float32") -> list[Path]:
    """Write a WAV file with a channel for each actuator, without loudspeaker positions; return its path.

    Its comment (LIST INFO ICMT) names the channels, the frequency or point, and the full scale.
    """
    (code, size), channels = FORMATS[encoding], len(signal.names)
    if channels * size >= 2**16:
        raise SceneError(f"holds {channels} actuators; a WAV file has room for {(2**16 - 1) // size} channels")
    if signal.rate * channels * size >= 2**32:
        raise SceneError(f"--rate {signal.rate}: too many for a WAV file of {channels} channels")
    head, length = _wav_head(signal, code, size), signal.samples * channels * size
    padding = length % 2  # chunks begin at even bytes
    with atomic_paths(path) as (temporary,), temporary.open("wb") as file:
        file.write(struct.pack("<4sI4s", b"RIFF", 4 + len(head) + 8 + length + padding, b"WAVE"))
        file.write(head + struct.pack("<4sI", b"data", length))
        for block in signal.blocks():
            file.write(_encode(block[:, 1:], encoding))
        file.write(bytes(padding))
    return [path]


def _encode(values: np.ndarray, encoding: Encoding) -> bytes:
    """Return samples (samples, channels) as little-endian bytes; integers take 1.0 as their largest number."""
    if encoding == "float32":
        return values.astype("<f4").tobytes()
    size = FORMATS[encoding][1]
    integers = np.rint(values * (2 ** (8 * size - 1) - 1)).astype("<i4")
    return integers.reshape(-1, 1).view(np.uint8)[:, :size].tobytes()


def _wav_head(signal: Signal, code: int, size: int) -> bytes:
    """Return the chunks before the samples: format, number of samples, comment."""
    frame = len(signal.names) * size
    layout = struct.pack("<HHIIHH", EXTENSIBLE, len(signal.names), signal.rate, signal.rate * frame, frame, 8 * size)
    layout += struct.pack("<HHII", 22, 8 * size, 0, code) + GUID_END
    channels = ", ".join(f"channel {number} = {name}" for number, name in enumerate(signal.names, 1))
    comment = f"{channels}; {signal.about}; full scale = {signal.full_scale_text}\0"
    fact, about = _chunk(b"fact", struct.pack("<I", signal.samples)), _chunk(b"ICMT", comment.encode())
    return _chunk(b"fmt ", layout) + fact + _chunk(b"LIST", b"INFO" + about)


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack("<4sI", name, len(content)) + content + b"\0" * (len(content) % 2)
