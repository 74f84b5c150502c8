"""Waveforms of drives: tones, sweeps and the envelopes of bursts, and signals from files, resampled to the steps.

A sampled signal s(t) has no phase to shift, but its analytic signal a = s + i·H(s) has, H being the Hilbert transform:
Re(Z·a) lags behind s by the phase lag of Z at every frequency at once (Gabor, J. IEE 93(III), 1946, pp. 429-457).
"""

import io
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from warp_plate.plate.files import read_numbers
from warp_plate.scene.drive import Burst, Chirp, SampledFile, SampledSignal
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import read_beside

# Each sample takes some 100 bytes while it is read: six minutes at 44.1 kHz.
MOST_SAMPLES = 2**24
# Samples per step of the run; more are a mistake, and a filter of as many products.
MOST_A_STEP = 1000
LOUDEST = 1e30
FASTEST, SLOWEST = 1e7, 1e-3  # samples per second
# Interpolation filter: half-width in samples of the slower rate, and Kaiser's β for 80 dB. It passes nine tenths of the
# slower rate's band, is at one half at PASSED of it, and stops from its end on.
HALF_WIDTH, BETA, PASSED = 50, 7.857, 0.95
TABLE_STEPS = 1024  # entries of the tabulated filter per sample
PRODUCTS_AT_ONCE = 2**21  # number of products in memory
# Part of a step by which times in a CSV, which are rounded, may be off an even spacing.
UNEVEN = 0.05


def tone(chirp: Chirp | None, frequency: np.ndarray | float, time_step: float, steps: int) -> np.ndarray:
    """Return (..., steps) complex tones, or sweeps, that begin at frequencies (..., 1) or () [Hz]."""
    if chirp is None:
        angle = 2 * math.pi * frequency * time_step * np.arange(steps)
    else:
        angle = sweep(chirp, np.asarray(frequency), time_step * np.arange(steps))
    return np.cos(angle) + 1j * np.sin(angle)


def sweep(chirp: Chirp, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return (..., steps) phases [rad] of sweeps from ``start`` (..., 1) or () [Hz], the integrals of 2πf over time."""
    span, end = chirp.duration, chirp.end_frequency
    inside = np.minimum(times, span)
    cycles = inside * (start + (end - start) / 2 * (inside / span))
    if chirp.law == "logarithmic":
        growth = np.array([math.log(end / low) for low in start.flat]).reshape(start.shape)
        grown = start * span / np.where(growth == 0, 1, growth) * np.expm1(growth * (inside / span))
        cycles = np.where(growth == 0, cycles, grown)
    angle: np.ndarray = 2 * math.pi * (cycles + end * (times - inside))
    return angle


def burst_means(burst: Burst, start: np.ndarray | float, time_step: float, steps: int, power: int) -> np.ndarray:
    """Return (..., steps) means over a step of the envelope to a power, 1 or 2, with ramps ½(1 − cos πt/ramp);
    ``start`` (..., 1) or a number [s] replaces the burst's own."""
    duration, ramp = burst.duration, burst.ramp
    whole_ramp = ramp / 2 if power == 1 else 3 * ramp / 8

    def risen(time: np.ndarray) -> np.ndarray:  # the integral of the rise up to a time within 0 ... ramp
        if not ramp:
            return 0 * time
        omega = math.pi / ramp
        if power == 1:
            return (time - np.sin(omega * time) / omega) / 2
        return 3 * time / 8 - np.sin(omega * time) / (2 * omega) + np.sin(2 * omega * time) / (16 * omega)

    def once(time: np.ndarray) -> np.ndarray:
        top = np.clip(time - ramp, 0, max(duration - 2 * ramp, 0))
        falling = np.clip(time - (duration - ramp), 0, ramp)
        return risen(np.clip(time, 0, ramp)) + top + (whole_ramp - risen(ramp - falling))

    def integral(time: np.ndarray) -> np.ndarray:
        since = time - start
        past = np.zeros(since.shape) if burst.period is None else np.maximum(np.floor(since / burst.period), 0)
        whole = max(duration - 2 * ramp, 0) + 2 * whole_ramp
        return past * whole + once(since - past * (burst.period or 0.0))

    return step_means(integral, time_step, steps)


def step_means(integral: Callable[[np.ndarray], np.ndarray], time_step: float, steps: int) -> np.ndarray:
    """Return (steps,) means over the step around each t_n, for n = 0 over its later half, of the function with an
    integral. A jump between two steps is then right to second order, as the scheme is."""
    edges = time_step * np.concatenate([[0.0], np.arange(steps) + 0.5])
    means: np.ndarray = np.diff(integral(edges)) / np.diff(edges)
    return means


@dataclass(frozen=True)
class Samples:
    """A sampled signal."""

    values: np.ndarray  # (samples,) real, with the gain; (channels, samples) with a channel for each actuator
    rate: float  # Samples per second
    start: float  # Time of the first sample [s]
    repeat: bool  # Repeat the signal instead of silence after its end

    def analytic(self) -> np.ndarray:
        """Return the complex analytic signal, shaped as the values, with silence around them unless they repeat.

        With silence it is a convolution: a Fourier transform of padded samples would repeat them after the zeros, which
        changes low frequencies.
        """
        if self.repeat:
            return np.asarray(scipy.signal.hilbert(self.values))
        lag = np.arange(1 - self.values.shape[-1], self.values.shape[-1])
        kernel = np.divide(2 / math.pi, lag, out=np.zeros(lag.size), where=lag % 2 == 1)
        kernel = kernel.reshape((1,) * (self.values.ndim - 1) + (-1,))
        return self.values + 1j * scipy.signal.fftconvolve(self.values, kernel, "same", axes=-1)

    def highest_frequency(self) -> float:
        """Return the frequency [Hz] below which 99 % of the energy lies; the rest may stem from the file's ends."""
        energy = np.cumsum((np.abs(np.fft.rfft(np.atleast_2d(self.values))) ** 2).sum(axis=0))
        return float(np.searchsorted(energy, 0.99 * energy[-1]) * self.rate / self.values.shape[-1])


def read_samples(table: SampledSignal, folder: Path | None, actuators: int = 1) -> Samples:
    """Return the signal of the file that ``[drive.signal]`` names in the scene's folder; see :func:`read_channels`.

    With ``per_actuator`` the file has a channel for each of the ``actuators``.
    """
    channels = actuators if table.per_actuator else None
    values, rate, start = read_channels("drive.signal", table, folder, channels, "actuator")
    values = values * table.gain
    return Samples(values if table.per_actuator else values[0], rate, start, table.repeat)


def read_channels(
    key: str, table: SampledFile, folder: Path | None, channels: int | None, owner: str
) -> tuple[np.ndarray, float, float]:
    """Return values (channels, samples), rate [1/s] and start [s] of a file in the scene's folder.

    The file has a channel for each owner, "actuator" or "point", or one for all if ``channels`` is None; ``key`` is
    that of its table.

    Raises:
        SceneError: There is no such file, it is too large, or it is not what its ending says.
    """
    data = read_beside(f"{key}.file", table.file, folder)
    try:
        if table.file.lower().endswith(".csv"):
            values, rate, start = _csv(data, key, table.rate, channels, owner)
        else:
            values, rate, start = *wav_channels(data), 0.0
            if len(values) != (channels or 1):
                wanted = f"{channels}, one for each {owner}" if channels else f"one, or per_{owner} = true"
                raise ValueError(f"{len(values)} channels; write {wanted}")
        if values.shape[1] < 2 or values.size > MOST_SAMPLES:
            raise ValueError(f"{values.size} samples; 2 to {MOST_SAMPLES} are possible")
        check_samples(values)
        if not values.any():
            raise ValueError("all samples are zero")
        if not SLOWEST <= rate <= FASTEST:
            raise ValueError(f"{rate:g} samples a second; {SLOWEST:g} to {FASTEST:g} are possible")
    except ValueError as error:
        raise SceneError(f"{key}.file = {table.file!r}: {error}") from None
    return values, rate, start + table.start


def check_samples(values: np.ndarray) -> None:
    """Raise a ValueError unless all samples are numbers whose squares are numbers too."""
    if not np.abs(values).max(initial=0.0) <= LOUDEST:
        raise ValueError(f"a sample is no number, or larger than {LOUDEST:g}")


def resample(samples: Samples, time_step: float, steps: int, band: float = 1.0) -> np.ndarray:
    """Return (..., steps) analytic signal at t = n·time_step, low-passed to ``band`` of the steps' Nyquist frequency.

    Each value is the sum of the samples around it under a sinc with a Kaiser window, as wide as the slower rate asks.
    Frequencies up to 0.9 of the lower band limit pass within 1e-3; those above the limit are 80 dB down.
    """
    if samples.rate * time_step > MOST_A_STEP:
        raise SceneError(
            f"drive.signal.file: {samples.rate:g} samples a second are {samples.rate * time_step:.3g} for each step of "
            f"{time_step:g} s; at most {MOST_A_STEP} are possible: lower its rate, or write a smaller grid.time_step"
        )
    return sample_at(samples, time_step * np.arange(steps), min(1.0, band / (samples.rate * time_step)))


def sample_at(samples: Samples, times: np.ndarray, band: float = 1.0) -> np.ndarray:
    """Return (..., times) analytic signal at times from 0 on [s], as :func:`resample` does."""
    analytic = samples.analytic()
    reach = np.arange(-math.ceil(HALF_WIDTH / band), math.ceil(HALF_WIDTH / band) + 2)
    distance = np.linspace(0, HALF_WIDTH, HALF_WIDTH * TABLE_STEPS + 1)
    window = np.i0(BETA * np.sqrt(1 - (distance / HALF_WIDTH) ** 2)) / np.i0(BETA)
    table = PASSED * band * np.sinc(PASSED * distance) * window
    *channels, count = analytic.shape
    carrier = np.zeros((*channels, times.size), dtype=complex)
    block = max(1, PRODUCTS_AT_ONCE // (reach.size * math.prod(channels)))
    for first in range(0, times.size, block):
        index_of = np.arange(first, min(first + block, times.size))
        place = (times[index_of] - samples.start) * samples.rate
        heard = place >= 0 if samples.repeat else (place > reach[0]) & (place < count + reach[-1])
        index_of, place = index_of[heard], place[heard]
        index = np.floor(place).astype(np.int64)[:, None] + reach
        weight = np.interp(np.abs(place[:, None] - index) * band, distance, table, right=0.0)
        if not samples.repeat:
            weight *= (index >= 0) & (index < count)
        carrier[..., index_of] = np.einsum("...nm,nm->...n", analytic[..., index % count], weight)
    return carrier


@np.errstate(invalid="ignore")  # of signalling NaN, which are NaN once converted
def wav_channels(data: bytes) -> tuple[np.ndarray, float]:
    """Return values (channels, samples) and rate of a RIFF WAVE file; ValueError: it is none, or is damaged."""
    if data[:4] != b"RIFF" or data[8:12] != b"WAVE":
        raise ValueError("not a WAV file")
    stated = int.from_bytes(data[4:8], "little") + 8
    if len(data) < stated < 2**32 - 2**16:  # recorders that do not know the end yet write the largest number
        raise ValueError("the WAV file ends too early")
    at = len(b"RIFF....WAVE")
    while at + 8 <= len(data):  # through the chunks: name, size, content to a whole word
        name, size = data[at : at + 4], int.from_bytes(data[at + 4 : at + 8], "little")
        if name == b"data" and len(data) - at - 8 < size < 2**31 - 2**16:
            raise ValueError(f"states {size} bytes of samples and holds {len(data) - at - 8}")
        at += 8 + size + size % 2 if name != b"data" else len(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of chunks that SciPy does not know
            rate, samples = scipy.io.wavfile.read(io.BytesIO(data))
    except Exception as error:  # of many kinds, for files of any content
        reason = " ".join(str(error).split())
        raise ValueError(f"a WAV file without samples, or damaged: {reason}") from None
    if samples.size > MOST_SAMPLES:
        raise ValueError(f"{samples.size} samples; at most {MOST_SAMPLES} are read")
    if rate == 0:
        raise ValueError("states 0 samples a second")
    values = np.atleast_2d(samples.T).astype(float)
    if samples.dtype.kind != "f":
        values = (values - 128 * (samples.dtype == np.uint8)) / 2.0 ** (8 * samples.dtype.itemsize - 1)
    return values, float(rate)


def _csv(
    data: bytes, key: str, rate: float | None, channels: int | None, owner: str
) -> tuple[np.ndarray, float, float]:
    """Return values (channels, samples), rate and start of a text table; see :func:`read_channels`."""
    table = read_numbers(data)
    if len(table) < 2:
        raise ValueError(f"{len(table)} samples; at least 2 are needed")
    columns = table.shape[1]
    if columns - (channels or 1) not in (0, 1):
        wanted = f"{channels or 1}, or time first; per_{owner} = true takes one for each {owner}"
        raise ValueError(f"{columns} columns instead of {wanted}")
    if columns == (channels or 1):
        if rate is None:
            raise ValueError(f"no column of times; write {key}.rate, the samples a second")
        return table.T, rate, 0.0
    if rate is not None:
        raise ValueError(f"has a column of times; delete {key}.rate")
    times = table[:, 0]
    step = even_step(times)
    if times[0] < 0:
        raise ValueError(f"starts at {times[0]:g} s; the run starts at 0")
    return table[:, 1:].T, 1 / step, float(times[0])


def even_step(times: np.ndarray) -> float:
    """Return the distance [s] of sampling times (samples,), or raise a ValueError unless they are evenly spaced."""
    if not np.isfinite(times).all() or np.abs(times).max() > LOUDEST:
        raise ValueError("a time is no number")
    step = float(times[-1] - times[0]) / (times.size - 1)
    if not step > 1e-30:
        raise ValueError("times do not rise")
    off = np.abs(times - times[0] - step * np.arange(times.size))
    if off.max() > UNEVEN * step:
        raise ValueError(f"times are not evenly spaced (sample {int(off.argmax()) + 1}); write one step throughout")
    return step
