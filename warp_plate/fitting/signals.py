"""Frequency responses from time signals of a force and of the motion that it causes.

With spectral densities S averaged over segments, x the force and y the motion (Bendat, Piersol, Random Data, ch. 6):

    H1 = S_xy / S_xx        noise in the motion averages out
    H2 = S_yy / S_yx        noise in the force averages out
    Hv = S_xy / |S_xy| · √(S_yy / S_xx)        noise in both, alike in relation to each
    γ² = |S_xy|² / (S_xx S_yy)        coherence: 1 without noise, leakage and nonlinearity
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warp_plate.plate.files import number_rows
from warp_plate.plate.waveforms import LOUDEST, MOST_SAMPLES, even_step, wav_channels
from warp_plate.scene.fit import TimeSignals


def read_signals(path: Path) -> tuple[np.ndarray, float]:
    """Return (channels, samples) values and samples per second of a WAV file, or of a CSV file with times [s] first.

    Raises:
        ValueError: The file is damaged, too large, or holds fewer than two channels.
    """
    if path.suffix.lower() == ".wav":
        values, rate = wav_channels(path.read_bytes())
    else:
        table = np.array([row for _, row in number_rows(path.read_bytes())], dtype=float)
        if len(table) < 2 or table.shape[1] < 3:
            raise ValueError("needs the columns time, and a signal in each of at least two others")
        values, rate = table[:, 1:].T, 1 / even_step(table[:, 0])
    if values.size > MOST_SAMPLES:
        raise ValueError(f"{values.size} samples; at most {MOST_SAMPLES} are read")
    if len(values) < 2 or not np.abs(values).max(initial=0) <= LOUDEST or not rate > 0:
        raise ValueError(f"needs a channel with the force and one or more with a motion, numbers up to {LOUDEST:g}")
    return values, rate


def estimate_responses(values: np.ndarray, rate: float, table: TimeSignals) -> tuple[np.ndarray, np.ndarray | None]:
    """Return (1 + sensors, n) frequencies [Hz] and responses, and their (sensors, n) coherence.

    Args:
        values: (channels, samples) signals.
        rate: Samples per second.
        table: Which channel is the force, and how its responses are estimated.

    Returns:
        Frequencies and responses; the coherence, or None if there is a single segment.

    Raises:
        ValueError: A segment is longer than the signals or shorter than two samples, or there is no such channel.
    """
    from scipy.signal import csd, welch

    samples, length = values.shape[1], round(min(table.segment * rate, 1e18))
    if not 2 <= length <= samples:
        given = f"{samples / rate:g} s at {rate:g} samples a second"
        raise ValueError(f"holds {given}; fit.signals.segment = {table.segment:g} s must have 2 to {samples} samples")
    if table.force_channel > len(values):
        raise ValueError(f"has {len(values)} channels; fit.signals.force_channel = {table.force_channel}")
    overlap = length // 2 if table.window == "hann" else 0
    options = {"fs": rate, "window": table.window, "nperseg": length, "noverlap": overlap}
    force = values[table.force_channel - 1] / table.force_gain
    motion = np.delete(values, table.force_channel - 1, axis=0)
    frequencies, of_force = welch(force, **options)
    of_motion, crossed = welch(motion, **options)[1], csd(force, motion, **options)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        responses = {
            "H1": crossed / of_force,
            "H2": of_motion / crossed.conj(),
            "Hv": crossed / np.abs(crossed) * np.sqrt(of_motion / of_force),
        }[table.estimator]
        coherence = np.abs(crossed) ** 2 / (of_force * of_motion)
    several = samples >= 2 * length - overlap
    return np.vstack([frequencies, responses]), np.minimum(coherence, 1.0) if several else None
