"""Natural frequencies and damping ratios of a panel from the sound or motion after a tap, without its force.

After a tap the panel moves as a sum of decaying tones, Σ a exp(s t) with s = −ζω + iω√(1 − ζ²). Bands of the record are
shifted to 0 Hz, filtered and decimated; a filter without recursion leaves sums of exponentials what they are. In each
band ESPRIT finds s: the rows of the leading singular vectors of the Hankel matrix of the samples, without the last and
without the first, differ by a matrix with the eigenvalues exp(s Δ) (R. Roy and T. Kailath, IEEE Trans. Acoust. Speech
Signal Process. 37, 1989, pp. 984-995; on decaying sounds J. Laroche, J. Acoust. Soc. Am. 94, 1993, pp. 1958-1965).
Poles that several orders of the model agree on are refined by least squares, whose covariance σ² (JᴴJ)⁻¹ tells which of
them the record determines; others are left out.

Two modes closer than their widths may appear as one pole, their mean s̄ with the amplitudes a as weights, and leave

    Σ a exp(s t) − A exp(s̄ t) ≈ A v t²/2 exp(s̄ t),     A = Σ a,     v = Σ a (s − s̄)² / A,

of which v is estimated for each pole. Where it is larger than the noise lets it be, the pole may be two, with the
distance √|v| from the stronger: that is its bar then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy

from warp_plate.fitting.hits import is_clipped
from warp_plate.fitting.measured_modes import MOST_MODES, MeasuredModes, check_file
from warp_plate.plate.waveforms import MOST_SAMPLES, check_samples, wav_channels
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import SMALLEST

# Contact of a tap, after which the panel is free [s]; lowest frequency [Hz].
CONTACT, LOWEST = 3e-3, 20.0
# Samples of a band at most, rate of a band over its width, and taps of its filter over the decimation.
MOST, OVERSAMPLING, TAPS = 700, 2.0, 8
# Shape and cutoff of that filter over the rate of the band, −90 dB from 0.75, where frequencies fold into the band; and
# amplitude of the faintest mode that is told, over the largest sample.
ATTENUATION, CUTOFF, FAINT = 9.0, 0.39, 1e-3
# Widths of bands [Hz] from the duration: a band has so many samples.
NARROWEST = 25.0
# Orders of the model, and of how many a pole must be a part, to these relative differences of frequency and decay.
ORDERS, AGREE, ALIKE = range(6, 37, 3), 4, (2e-3, 0.1)
# Largest standard deviations, relative to frequency and damping ratio, of modes that are told.
DEVIATIONS = 2e-4, 0.0125
# Bar over the standard deviation; probability that noise causes so large a v, below which the bar is the distance of
# two modes; relative bars of frequency and damping ratio from which on a mode is said to be two.
BAR, CHANCE, WIDE = 3.5, 0.1, (1e-3, 0.05)
# Relative deviation of a decay rate from which on its pole is dropped at first, gain of the sum of squares, in those of
# single samples, for which a pole is split, most splits, steps of the least squares, and the relative gain at which
# they end.
UNDETERMINED, SPLIT, MOST_SPLITS, STEPS, GAIN = 0.3, 16.0, 3, 8, 1e-5
MOST_DAMPING, RANK = 0.2, 1e-12
TAP_BYTES = 2**28


@dataclass(frozen=True, eq=False)
class TapModes:
    """Modes that the decay after a tap determines, with rising frequencies."""

    frequencies: np.ndarray  # (n,) [Hz]
    damping: np.ndarray  # (n,) damping ratios ζ
    frequency_bars: np.ndarray  # (n,) errors that they hardly exceed [Hz]
    damping_bars: np.ndarray  # (n,) the same of the damping ratios
    pairs: np.ndarray  # (n,) True for modes that may be two that are closer than their widths


def read_tap(path: Path, band: tuple[float, float] | None = None) -> MeasuredModes:
    """Return the modes that a WAV file of a tap determines, within a band [Hz] (default: all).

    Raises:
        SceneError: The file cannot be read, or its decay determines no mode.
    """
    try:
        check_file(path, TAP_BYTES)
        values, rate = wav_channels(path.read_bytes())
        if values.size > MOST_SAMPLES:
            raise ValueError(f"{values.size} samples; at most {MOST_SAMPLES} are read")
        modes = tap_modes(values, float(rate), band)
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    frequencies, damping, bars = (
        numbers[:MOST_MODES] for numbers in (modes.frequencies, modes.damping, modes.damping_bars)
    )
    remarks = [
        f"The mode at {frequencies[at]:.6g} Hz may be two closer than their widths; its damping ratio, "
        f"{damping[at]:.3g} ± {bars[at]:.2g}, is not fitted"
        for at in np.flatnonzero(modes.pairs[:MOST_MODES]).tolist()
    ]
    damping, bars = (np.where(modes.pairs[:MOST_MODES], math.nan, numbers) for numbers in (damping, bars))
    return MeasuredModes(str(path), frequencies, damping, remarks=tuple(remarks), damping_bars=bars)


def tap_modes(values: np.ndarray, rate: float, band: tuple[float, float] | None = None) -> TapModes:
    """Return the modes in records (channels, samples) of one tap, within a band [Hz] (default: all).

    Raises:
        ValueError: There is no decay, or it determines no mode.
    """
    free = free_decay(values, rate)
    low, high = max(band[0] if band else LOWEST, LOWEST), min(band[1] if band else math.inf, 0.45 * rate)
    duration = free.shape[1] / rate
    width = max(NARROWEST, MOST / duration / OVERSAMPLING)
    width = min(width, rate / 4)
    loudest = float(np.abs(free).max())
    bands = [
        _in_band(free, rate, centre, width, loudest)
        for centre in np.arange(low + width / 2, high + width / 2, width)
        if centre < rate / 2
    ]
    poles, bars, pairs = np.concatenate([np.empty((3, 0)), *bands], axis=1)
    sizes = np.abs(poles)
    order = np.argsort(sizes)
    inside = order[(sizes[order] >= 2 * math.pi * low) & (sizes[order] <= 2 * math.pi * high)]
    if not inside.size:
        raise ValueError("no mode is determined by its decay; record longer, nearer, or choose a band by fit.range")
    poles, bars, sizes = poles[inside], bars.real[inside], sizes[inside]
    turns = 2 * math.pi
    return TapModes(sizes / turns, -poles.real / sizes, bars / turns, bars / sizes, pairs.real[inside] > 0)


def free_decay(values: np.ndarray, rate: float) -> np.ndarray:
    """Return what follows the largest sample of records (channels, samples) by more than a contact, without means.

    Of channels that are clipped, the last clipped sample counts as the largest.
    """
    check_samples(values)
    heard = np.ptp(values, axis=1) >= SMALLEST if values.size else []
    values = values[np.flatnonzero(heard)]  # silent channels would seem to lower the noise
    if not len(values):
        raise ValueError(f"holds no sound; its samples differ by less than {SMALLEST:g}")
    clipped = [np.abs(row) == np.abs(row).max() for row in values if is_clipped(row)]
    values = values - values.mean(axis=1, keepdims=True)
    power = (values**2).sum(axis=0)
    start = max([int(power.argmax()), *(int(np.flatnonzero(flat)[-1]) for flat in clipped)])
    start += math.ceil(CONTACT * rate)
    if values.shape[1] - start < 4 * rate / LOWEST:
        raise ValueError(f"holds less than {4 / LOWEST:g} s after its largest sample; a tap and its decay are needed")
    return values[:, start:]


def _in_band(free: np.ndarray, rate: float, centre: float, width: float, loudest: float) -> np.ndarray:
    """Return (3, n) poles of a band around a centre [Hz] that the decay determines, their bars [1/s], 1 for pairs.

    The largest sample is the ``loudest``; modes that are faint beside it are left out.
    """
    step = max(1, int(rate / (OVERSAMPLING * width)))
    taps = (
        scipy.signal.firwin(TAPS * step | 1, CUTOFF * rate / step, fs=rate, window=("kaiser", ATTENUATION))
        if step > 1
        else [1.0]
    )
    free = free[:, : (MOST - 1) * step + len(taps)]  # all that the first samples of the band depend on
    shifted = free * np.exp(-2j * math.pi * centre / rate * np.arange(free.shape[1]))
    share = step * float(np.sum(np.square(taps)))
    samples = scipy.signal.oaconvolve(shifted, np.atleast_2d(taps), mode="valid", axes=1)[:, ::step][:, :MOST]
    interval = step / rate
    if samples.shape[1] < 3 * ORDERS[0]:
        return np.empty((3, 0))
    rows = samples.shape[1] // 2
    hankel = np.concatenate([scipy.linalg.hankel(row[:rows], row[rows - 1 :]) for row in samples], axis=1)
    if len(samples) > 1:  # a triangle with the same left vectors
        hankel = np.asarray(np.linalg.qr(hankel.conj().T, mode="r")).conj().T
    vectors, sizes, _ = scipy.linalg.svd(hankel, full_matrices=False)
    if not sizes[0] > 0:
        return np.empty((3, 0))
    orders = [order for order in ORDERS if order < rows // 2]
    stable = _stable([_esprit(vectors[:, :order]) / interval for order in orders], 2 * math.pi * centre)
    fit = _refine(_Sum(stable, samples, interval, share))
    poles, deviations, (apart, spread) = fit.poles, fit.deviations, fit.pairs
    absolute = poles + 2j * math.pi * centre
    decay, size = -poles.real, np.abs(absolute)
    told = (np.abs(poles.imag) <= math.pi * width) & (decay > 0) & (decay < MOST_DAMPING * size)
    told &= (deviations < DEVIATIONS[0] * size) & (deviations < DEVIATIONS[1] * decay)
    told &= _Sum(poles, samples, interval, share).strengths > FAINT * loudest
    bars = np.maximum(np.where(spread, apart, 0.0), BAR * deviations)
    return np.stack([absolute, bars, (bars > WIDE[0] * size) | (bars > WIDE[1] * decay)])[:, told]


def _esprit(vectors: np.ndarray) -> np.ndarray:
    """Return the logarithms of the eigenvalues between the rows of signal vectors (rows, order)."""
    values = np.linalg.eigvals(np.linalg.lstsq(vectors[:-1], vectors[1:], rcond=None)[0])
    return np.asarray(np.log(values[np.abs(values) > 0]))


def _stable(poles: list[np.ndarray], shift: float) -> np.ndarray:
    """Return the medians of the poles [1/s] that enough models have in common; ``shift`` [1/s] is that of the band."""
    groups: list[list[complex]] = []
    for model in reversed(poles):
        for pole in model[model.real < 0]:
            for group in groups:
                middle = group[-1]
                if (
                    abs(pole.imag - middle.imag) < ALIKE[0] * abs(shift + middle.imag)
                    and abs(pole.real / middle.real - 1) < (ALIKE[1])
                ):
                    group.append(pole)
                    break
            else:
                groups.append([pole])
    shared = [group for group in groups if len(group) >= AGREE]
    return np.array([complex(np.median(np.real(group)), np.median(np.imag(group))) for group in shared], dtype=complex)


def _refine(fit: _Sum) -> _Sum:
    """Return the waves of least squares near others, with channels weighted by their noise.

    Poles that the samples do not determine are dropped; those are split in two that describe the samples clearly better
    so.
    """
    fit = fit.refined().weighted()
    while fit.poles.size:
        deviations = fit.deviations / np.abs(fit.poles.real)
        if deviations.max() < UNDETERMINED:
            break
        fit = fit.with_poles(np.delete(fit.poles, deviations.argmax()))
    fit = fit.refined()
    for _ in range(MOST_SPLITS):
        told = np.flatnonzero(fit.deviations < 2 * DEVIATIONS[1] * np.abs(fit.poles.real))
        halves = [fit.split(index).refined() for index in told.tolist()]
        best = min(halves, key=lambda half: half.residual, default=fit)
        if fit.residual - best.residual < SPLIT * fit.residual / fit.freedom:
            break
        fit = best
    return fit


class _Sum:
    """Decaying waves with poles [1/s], with the amplitudes of the least squares for samples (channels, n).

    Only a share of the samples is independent in the band, because its filter is narrower than their rate.
    """

    def __init__(self, poles: np.ndarray, samples: np.ndarray, interval: float, share: float) -> None:
        self.poles, self._samples, self._interval, self._share = poles, samples, interval, share
        self._times = interval * np.arange(samples.shape[1])
        self._waves = np.exp(np.outer(self._times, poles))
        self._amplitudes = np.linalg.lstsq(self._waves, samples.T, rcond=None)[0]
        self._rest = (samples.T - self._waves @ self._amplitudes).T.ravel()
        self.residual = float(np.linalg.norm(self._rest) ** 2)
        self.freedom = max(1, share * samples.size - poles.size * (1 + len(samples)))

    @property
    def strengths(self) -> np.ndarray:
        """(poles,) amplitudes at the beginning, of the strongest channel."""
        return np.asarray(np.abs(self._amplitudes).max(axis=1, initial=0.0))

    @property
    def _slopes(self) -> np.ndarray:
        """(channels · n, poles) derivatives by poles, with the amplitudes of least squares for each."""
        by_poles = self._times[:, None] * self._waves * self._amplitudes.T[:, None]
        return np.concatenate(by_poles - self._basis @ (self._basis.conj().T @ by_poles))

    @cached_property
    def _basis(self) -> np.ndarray:
        """(n, poles) orthonormal sums of the waves."""
        return np.asarray(np.linalg.qr(self._waves)[0])

    @property
    def deviations(self) -> np.ndarray:
        """(poles,) standard deviations of real and imaginary parts [1/s]."""
        slopes = self._slopes
        size = np.linalg.norm(slopes, axis=0)
        slopes = slopes / np.where(size > 0, size, 1.0)
        covariance = np.diag(np.linalg.pinv(slopes.conj().T @ slopes)).real / np.where(size > 0, size, 1.0) ** 2
        return np.asarray(np.sqrt(np.maximum(covariance, 0) * self.residual / self.freedom / 2))

    @property
    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """(poles,) distances √|v| [1/s] of the modes in a pole, of all channels; whether noise hardly causes them."""
        by_poles, count = np.linalg.qr(self._slopes)[0], len(self._times)
        squares, gains = np.zeros(self.poles.size), np.zeros(self.poles.size)
        for channel, amplitudes in enumerate(self._amplitudes.T):
            rows = slice(channel * count, (channel + 1) * count)
            waves = self._times[:, None] ** 2 / 2 * self._waves * amplitudes
            square = np.linalg.norm(waves, axis=0) ** 2
            for basis in (self._basis, by_poles[rows]):
                square -= np.linalg.norm(basis.conj().T @ waves, axis=0) ** 2
            square = np.maximum(square, RANK * np.linalg.norm(waves, axis=0) ** 2 + 1e-300)
            squares += square
            gains += np.abs(waves.conj().T @ self._rest[rows]) ** 2 / square
        noise = max(self.residual / self.freedom, 1e-300)
        return (gains / squares) ** 0.25, scipy.special.gammaincc(len(self._samples), gains / noise) < CHANCE

    def split(self, index: int) -> _Sum:
        """Return the waves with two poles, half a decay rate apart, in place of one."""
        apart = np.array([-0.25, 0.25]) * 1j * self.poles[index].real
        return self.with_poles(np.append(np.delete(self.poles, index), self.poles[index] + apart))

    def refined(self) -> _Sum:
        """Return the waves of the least squares nearby, by Gauss and Newton's method."""
        best = self
        for _ in range(STEPS if self.poles.size else 0):
            change = np.linalg.lstsq(best._slopes, best._rest, rcond=None)[0]
            for part in (1.0, 0.5, 0.25, 0.1):
                tried = best.poles + part * change
                if (tried.real < 0).all() and (np.abs(part * change) < np.abs(best.poles.real)).all():
                    following = self.with_poles(tried)
                    if following.residual < best.residual:
                        break
            else:
                return best
            gain, best = 1 - following.residual / best.residual, following
            if gain < GAIN:
                return best
        return best

    def weighted(self) -> _Sum:
        """Return the waves for samples in units of each channel's noise, times the least noise."""
        noise = np.linalg.norm(self._rest.reshape(self._samples.shape), axis=1, keepdims=True)
        weights = noise.min() / noise if noise.min() > 0 else 1.0
        return _Sum(self.poles, self._samples * weights, self._interval, self._share)

    def with_poles(self, poles: np.ndarray) -> _Sum:
        """Return the waves with other poles."""
        return _Sum(poles, self._samples, self._interval, self._share)
