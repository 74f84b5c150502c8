"""Desired motions of the foci: pulses, bursts, and waveforms of files and arrays."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from warp_plate.plate.waveforms import Samples, read_channels, sample_at
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST
from warp_plate.scene.focus import AFTER, Focus, FocusBurst

WISH = "focus.wish"


@dataclass(frozen=True)
class Wish:
    """Wished motion of each focus, at the ends of the samples."""

    motion: np.ndarray  # (foci, recorded) motion with which that of a focus is to correlate; one sample for a pulse
    followed: np.ndarray  # (foci, recorded) motion that the inverse filter follows
    samples: int  # number of samples of the waveforms
    shaped: bool  # true if the foci are to follow a waveform, not to move at one moment

    @property
    def recorded(self) -> int:
        """Number of samples of the motion."""
        return self.motion.shape[1]

    @property
    def moments(self) -> np.ndarray:
        """(foci,) samples of the largest wished motion."""
        return np.abs(self.motion).argmax(axis=1)

    def apart(self, motion: np.ndarray) -> np.ndarray:
        """Return (foci, foci, recorded) motion of all foci, each row wishing that of one and rest of the others."""
        return np.asarray(np.eye(len(motion))[:, :, None] * motion[:, None])


def make_wish(table: Focus, folder: Path | None, actuators: int, given: np.ndarray | None = None) -> Wish:
    """Return the wish of a table for so many actuators: (samples,) or (foci, samples) given or in its file, which is in
    a folder, its burst, or a pulse."""
    foci = len(table.points)
    if given is None and table.wish is not None:
        given = _read_file(table, folder, actuators)
    if given is not None:
        if np.asarray(given).dtype.kind not in "fiu":
            raise SceneError("wished: must be real numbers")
        motion = _check_motion(table, actuators, np.asarray(given, dtype=float))
        samples = motion.shape[1]
        motion = np.pad(motion, ((0, 0), (0, round(samples * AFTER))))
        return Wish(motion, motion, samples, shaped=True)
    times = (np.arange(table.recorded) - table.moment) / table.rate
    if table.burst is not None:
        burst = np.tile(_burst(table.burst, times), (foci, 1))
        return Wish(burst, burst, table.samples, shaped=True)
    moment = (np.arange(table.recorded) == table.moment).astype(float)
    return Wish(np.tile(moment, (foci, 1)), np.tile(_pulse(table), (foci, 1)), table.samples, shaped=False)


def _read_file(table: Focus, folder: Path | None, actuators: int) -> np.ndarray:
    """Return the motion (channels, samples) of ``[focus.wish]`` at the ends of the samples, silent before its start."""
    assert table.wish is not None
    channels = len(table.points) if table.wish.per_point else None
    values, rate, start = read_channels(WISH, table.wish, folder, channels, "point")
    samples = max(math.ceil((start + (values.shape[1] - 1) / rate) * table.rate), 2)
    _check_numbers(table, actuators, samples)
    times = np.arange(1, samples + 1) / table.rate
    return sample_at(Samples(values, rate, start, repeat=False), times, min(1.0, table.rate / rate)).real


def _check_motion(table: Focus, actuators: int, motion: np.ndarray) -> np.ndarray:
    """Return a motion (foci, samples), or raise a SceneError, as for what its rows may be."""
    foci = len(table.points)
    rows = motion if motion.ndim > 1 else motion[None]
    if rows.ndim != 2 or len(rows) not in (1, foci) or rows.shape[1] < 2:
        raise SceneError(f"{WISH}: the shape {motion.shape}; must be (samples,) or ({foci}, samples), a row each point")
    largest = np.abs(rows).max(axis=1)
    if not np.all((largest > SMALLEST) & (largest < LARGEST)):
        wrong = f"zero throughout, or a sample is no number; the largest is from {SMALLEST:g} to {LARGEST:g}"
        raise SceneError(f"{WISH}: a wished motion is {wrong}")
    if table.rest is not None:
        raise SceneError("focus.rest: bounds motion at one moment, not that of a wish; delete it")
    _check_numbers(table, actuators, rows.shape[1])
    return np.asarray(np.broadcast_to(rows, (foci, rows.shape[1])))


def _check_numbers(table: Focus, actuators: int, samples: int) -> None:
    try:
        table.check_numbers(samples, actuators, "wish")
    except ValueError as error:
        raise SceneError(str(error)) from None


def _pulse(table: Focus) -> np.ndarray:
    """Return a (recorded,) pulse, 1 at the moment, whose spectrum is a Hann window from ``lowest`` to ``highest``."""
    length = scipy.fft.next_fast_len(2 * table.recorded, real=True)
    part = (scipy.fft.rfftfreq(length, 1 / table.rate) - table.lowest) / (table.highest - table.lowest)
    spectrum = np.where((part > 0) & (part < 1), np.sin(math.pi * part) ** 2, 0.0)
    pulse = scipy.fft.irfft(spectrum, length)
    return np.asarray(np.roll(pulse / pulse[0], table.moment)[: table.recorded])


def _burst(burst: FocusBurst, times: np.ndarray) -> np.ndarray:
    """Return a tone under a Hann window around the time 0."""
    envelope = np.where(np.abs(times) < burst.half, np.cos(math.pi / 2 * times / burst.half) ** 2, 0.0)
    return np.asarray(envelope * np.cos(2 * math.pi * burst.frequency * times))
