"""What to play to the actuators: the drive as WAV or CSV for an amplifier, a channel for each actuator.

Channel k holds w_k cos(2πft − φ_k) divided by the full scale, so that 1.0 stands for one and the same pressure [N/m²]
or voltage in every channel. It lasts a whole number of periods, so that it can be played over and over.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np

from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.export.traces import write_table
from warp_plate.result.model import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

Encoding = Literal["float32", "pcm16"]
# WAVE_FORMAT_IEEE_FLOAT and WAVE_FORMAT_PCM, and bytes a sample.
FORMATS: dict[Encoding, tuple[int, int]] = {"float32": (3, 4), "pcm16": (1, 2)}
EXTENSIBLE = 0xFFFE
# The common end of the GUIDs that stand for the formats in WAVE_FORMAT_EXTENSIBLE.
GUID_END = bytes.fromhex("0000 1000 8000 00aa 0038 9b71")
PCM16_FULL_SCALE = 32767
# A WAV file counts its bytes with 32 bits; with room for what stands before the samples.
MOST_BYTES = 2**32 - 2**20
# So many numbers of whole periods are tried for the one that ends nearest to a sample.
TRIED = 10_000
BLOCK = 2**16


@dataclass(frozen=True)
class Signal:
    """The signals of all actuators over a whole number of periods.

    drive: (actuators,) phasors in units of ``full_scale``, which is in ``unit``; frequency [Hz]; rate: samples a
    second; seam: phase jump [degrees] where the end meets the beginning, 0 where a period's multiple is whole in
    samples.
    """

    names: tuple[str, ...]
    drive: np.ndarray
    full_scale: float
    unit: str
    frequency: float
    rate: int
    samples: int
    periods: int
    seam: float

    def blocks(self) -> Iterator[np.ndarray]:
        """(samples, 1 + actuators) pieces of the table: time [s], then the signals."""
        for start in range(0, self.samples, BLOCK):
            time = np.arange(start, min(start + BLOCK, self.samples)) / self.rate
            turns = np.exp(2j * np.pi * np.mod(self.frequency * time, 1))
            yield np.column_stack([time, (turns[:, None] * self.drive).real])


def make_signal(scene: Scene, case: Case, rate: int, duration: float, full_scale: float | None = None) -> Signal:
    """The signals of a case.

    Args:
        rate: samples a second; duration: at most so long [s].
        full_scale: what 1.0 stands for, in the unit of the scene's drives; left out: the drive's largest magnitude.

    Raises:
        SceneError: a drive that does not repeat, is at rest or above the full scale; too few samples or less than a
            period, or no room.
    """
    if (key := scene.nonperiodic_key) is not None and key != "effects.moving_load":
        raise SceneError(f"{key}: only tones of drive.frequency are written, which this drive is not")
    frequency, largest, unit = scene.drive.frequency, float(case.magnitude.max()), scene.drive_unit
    full_scale = largest if full_scale is None else full_scale
    if not largest > 0:
        raise SceneError("its drive is zero: there is nothing to play")
    if not largest <= full_scale < float("inf"):
        raise SceneError(
            f"--full-scale {full_scale:g}: must be at least the drive's largest magnitude, {largest!r} {unit}"
        )
    if rate <= 2 * frequency:
        raise SceneError(f"--rate {rate}: {frequency:g} Hz takes more than {2 * frequency:g} samples a second")
    if not 1 <= duration * frequency < float("inf"):
        raise SceneError(
            f"--duration {duration:g}: must be at least a period of {frequency:g} Hz, {1 / frequency:.3g} s"
        )
    bytes_a_sample = max(size for _, size in FORMATS.values())
    if duration * rate * len(scene.actuators) * bytes_a_sample > MOST_BYTES:
        raise SceneError(f"--duration {duration:g}: {len(scene.actuators)} channels take more than 4 GiB; write less")
    periods, samples, seam = whole_periods(frequency, rate, duration)
    names = tuple(actuator.name for actuator in scene.actuators)
    return Signal(names, case.phasors / full_scale, full_scale, unit, frequency, rate, samples, periods, seam)


def whole_periods(frequency: float, rate: int, duration: float) -> tuple[int, int, float]:
    """Periods and samples of the span that repeats with the smallest seam, and that seam [degrees].

    Of spans between half of ``duration`` [s] and all of it; of several that are as good, the longest. The frequency
    is taken as the decimal number that is written for it, so that 290.1 Hz at 48000 Hz is exact.
    """
    exact = Fraction(repr(float(frequency)))
    a_period = rate / exact  # in samples
    most = int(Fraction(repr(float(duration))) * exact)
    tried = range(most, max(most // 2, most - TRIED, 0), -1)
    periods = min(tried, key=lambda count: abs(round(count * a_period) - count * a_period))
    samples = round(periods * a_period)
    return periods, samples, float(360 * (samples / a_period - periods))


def write_drive_csv(signal: Signal, path: str | Path) -> list[Path]:
    """Write a table: time [s], then each actuator in full scale; the header says what that is. The file written.

    Raises:
        SceneError: the file cannot be written.
    """
    path = Path(path)
    unit = f"[1 = {signal.full_scale:.9g} {signal.unit.replace('²', '^2')}]"
    heading = ["time [s]", *(f"{name} {unit}" for name in signal.names)]
    write_table(path, heading, signal.blocks())
    return [path]


def write_wav(signal: Signal, path: str | Path, encoding: Encoding = "float32") -> list[Path]:
    """Write a WAV file with a channel for each actuator, bound to no loudspeaker position; the file written.

    Its comment (LIST INFO ICMT) names the channels, the frequency and the full scale.

    Raises:
        SceneError: too many actuators for a WAV file, or it cannot be written.
    """
    path = Path(path)
    form, size = FORMATS[encoding]
    channels = len(signal.names)
    if channels * size >= 2**16:
        raise SceneError(f"holds {channels} actuators; a WAV file has room for {(2**16 - 1) // size} channels")
    if signal.rate * channels * size >= 2**32:
        raise SceneError(f"--rate {signal.rate}: too many for a WAV file of {channels} channels")
    with atomic_paths(path) as (temporary,), temporary.open("wb") as file:
        head = _wav_head(signal, form, size)
        length = signal.samples * channels * size
        file.write(struct.pack("<4sI4s", b"RIFF", 4 + len(head) + 8 + length, b"WAVE"))
        file.write(head + struct.pack("<4sI", b"data", length))
        for block in signal.blocks():
            values = block[:, 1:]
            file.write(
                values.astype("<f4").tobytes()
                if encoding == "float32"
                else np.rint(values * PCM16_FULL_SCALE).astype("<i2").tobytes()
            )
    return [path]


def _wav_head(signal: Signal, form: int, size: int) -> bytes:
    """The chunks before the samples: WAVE_FORMAT_EXTENSIBLE without speaker positions, samples, comment."""
    frame = len(signal.names) * size
    layout = struct.pack("<HHIIHH", EXTENSIBLE, len(signal.names), signal.rate, signal.rate * frame, frame, 8 * size)
    layout += struct.pack("<HHII", 22, 8 * size, 0, form) + GUID_END
    channels = ", ".join(f"channel {number} = {name}" for number, name in enumerate(signal.names, 1))
    unit = signal.unit.replace("²", "^2")
    comment = f"{channels}; {signal.frequency!r} Hz; full scale = {signal.full_scale:.9g} {unit}"
    facts = struct.pack("<I", signal.samples)
    return (
        _chunk(b"fmt ", layout)
        + _chunk(b"fact", facts)
        + _chunk(b"LIST", b"INFO" + _chunk(b"ICMT", comment.encode() + b"\0"))
    )


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack("<4sI", name, len(content)) + content + b"\0" * (len(content) % 2)
