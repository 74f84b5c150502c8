"""Waveforms of actuators that focus at a moment: plain NumPy over impulse responses.

A waveform w of samples n = 0 ... N − 1, held between them, moves focus f at the moment t = N/rate by

    u_f(T) = Σ_a Σ_n h[a, f, N − 1 − n] w[a, n] = g_f · w

with h[a, f, l] the response l + 1 samples after the beginning of one sample. Time reversal plays g_f itself, which of
all waveforms of one energy moves the focus most (Cauchy and Schwarz); one-bit time reversal plays its signs, which do
so of all waveforms of one peak.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

# Halvings of the interval of the multiplier.
HALVINGS = 200


def time_reversal(h: np.ndarray) -> np.ndarray:
    """Return g (foci, actuators, samples): responses (actuators, foci, samples), the last sample first."""
    return np.moveaxis(h, 1, 0)[..., ::-1]


def keep_above(h: np.ndarray, rate: int, lowest: float) -> np.ndarray:
    """Return responses (..., samples) without frequencies below ``lowest`` [Hz], by a Fourier transform with zeros."""
    length = scipy.fft.next_fast_len(2 * h.shape[-1], real=True)
    spectrum = scipy.fft.rfft(h, length)
    spectrum[..., scipy.fft.rfftfreq(length, 1 / rate) < lowest] = 0.0
    return np.asarray(scipy.fft.irfft(spectrum, length)[..., : h.shape[-1]])


def scale_to_limits(waveforms: np.ndarray, energy: float | None, peak: float | None) -> np.ndarray:
    """Return waveforms (foci, actuators, samples), those of each focus times the largest factor within the limits."""
    axes = (1, 2)
    largest, squares = np.abs(waveforms).max(axis=axes, keepdims=True), (waveforms**2).sum(axis=axes, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_peak = math.inf if peak is None else peak / largest
        by_energy = math.inf if energy is None else np.sqrt(energy / squares)
        return np.asarray(np.where(largest > 0, waveforms * np.minimum(by_peak, by_energy), 0.0))


def optimum(gains: np.ndarray, energy: float | None, peak: float | None) -> tuple[np.ndarray, float]:
    """Return the waveforms w of largest g·w under Σ w² ≤ energy and |w| ≤ peak, and an upper bound of g·w.

    With a multiplier λ ≥ 0 of the energy, w = clip(g / 2λ, ±peak), and for every λ no g·w exceeds
    λ energy + Σ max_w (g w − λ w²), the maximum over |w| ≤ peak.

    Args:
        gains: (actuators, samples) g.
        energy: Largest Σ w²; None for no limit.
        peak: Largest |w|; None for no limit, if there is one of the energy.
    """
    size = float(np.linalg.norm(gains))
    if energy is None or (peak is not None and peak**2 * np.count_nonzero(gains) <= energy):
        assert peak is not None
        return peak * np.sign(gains), peak * float(np.abs(gains).sum())
    if size == 0.0:
        return np.zeros_like(gains), 0.0
    low, high = 0.0, size / (2 * math.sqrt(energy))
    limit = math.inf if peak is None else peak
    for _ in range(HALVINGS if peak is not None else 0):
        middle = (low + high) / 2
        spent = float((np.minimum(np.abs(gains) / (2 * middle), limit) ** 2).sum())
        low, high = (middle, high) if spent > energy else (low, middle)
        if middle in (low, high) and high - low <= np.spacing(high):
            break
    best = np.clip(gains / (2 * high), -limit, limit)
    return best, high * energy + float((gains * best - high * best**2).sum())
