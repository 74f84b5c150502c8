"""Desired motions of a focus."""

from __future__ import annotations

import math

import numpy as np
import scipy

from warp_plate.scene.focus import Focus, FocusBurst


def wished_motion(table: Focus) -> np.ndarray:
    """Return the (recorded,) motion that gains are of: the burst of the table, or one sample at the moment."""
    if table.burst is not None:
        return _burst(table.burst, _times(table))
    motion = np.zeros(table.recorded)
    motion[table.moment] = 1.0
    return motion


def wished_pulse(table: Focus) -> np.ndarray:
    """Return the (recorded,) motion that the inverse filter follows: the burst, or a pulse from lowest to highest.

    The pulse has its largest value, 1, at the moment, and a spectrum that is a Hann window over these frequencies.
    """
    if table.burst is not None:
        return _burst(table.burst, _times(table))
    length = scipy.fft.next_fast_len(2 * table.recorded, real=True)
    part = (scipy.fft.rfftfreq(length, 1 / table.rate) - table.lowest) / (table.highest - table.lowest)
    spectrum = np.where((part > 0) & (part < 1), np.sin(math.pi * part) ** 2, 0.0)
    pulse = scipy.fft.irfft(spectrum, length)
    return np.asarray(np.roll(pulse / pulse[0], table.moment)[: table.recorded])


def _times(table: Focus) -> np.ndarray:
    """Return the (recorded,) times from the moment on [s]."""
    return (np.arange(table.recorded) - table.moment) / table.rate


def _burst(burst: FocusBurst, times: np.ndarray) -> np.ndarray:
    """Return a tone under a Hann window around the time 0."""
    envelope = np.where(np.abs(times) < burst.half, np.cos(math.pi / 2 * times / burst.half) ** 2, 0.0)
    return np.asarray(envelope * np.cos(2 * math.pi * burst.frequency * times))
