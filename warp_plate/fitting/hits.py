"""Hits of a hammer in a long record: found, judged, windowed and averaged.

A block begins just before a hit and lasts ``fit.signals.segment``. A force window leaves the hit and silence after it.
An exponential window exp(−t/τ) over force and motion alike lets a lightly damped panel come to rest within the block.
It adds the decay rate 1/τ to all motion, and takes the responses from s = iω to s = iω + 1/τ exactly:

    ∫ y exp(−t/τ) exp(−iωt) dt = Y(iω + 1/τ)

so that a fit computes its responses there, and finds the damping of the panel without that of the window.
"""

from __future__ import annotations

import logging
import math

import numpy as np

from warp_plate.scene.fit import TimeSignals

# A hit passes this part of the largest one, and this many deviations of the noise.
LEAST_HIT, NOISE = 0.1, 8.0
# A pulse ends where the force falls below this part of its peak; a second hit in a block passes that part.
END, SECOND = 0.02, 0.05
# Time before a hit and fall of the force window after it, over the width of the pulse.
BEFORE, FALL = 1.0, 1.0
# Samples in a row at one extreme value that are an overload, and steps of the numbers by which they are entered; or so
# many at that value anywhere; relative differences of numbers that are alike.
FLAT, PLATEAU, OFTEN, ROUNDED = 3, 4.0, 8, 1e-9


def hit_spectra(
    force: np.ndarray, motion: np.ndarray, rate: float, table: TimeSignals
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """Return frequencies [Hz], the mean densities of force (n,), motion (channels, n) and both (channels, n), and the
    number of hits, of a force (samples,) and motions (channels, samples).

    Hits that are doubled, overloaded or cut off by the end of the record are left out, with a warning.

    Raises:
        ValueError: No hit is left.
    """
    length = round(table.segment * rate)
    force, motion = force - np.median(force), motion - np.median(motion, axis=1, keepdims=True)
    hits = find_hits(force, length)
    faults = [_fault(force, motion, *hit, length) for hit in hits]
    good = [hit for hit, fault in zip(hits, faults, strict=True) if not fault]
    bad = [f"{peak / rate:.4g} s ({fault})" for (_, peak, _), fault in zip(hits, faults, strict=True) if fault]
    if bad:
        shown = ", ".join(bad[:6]) + (", ..." if len(bad) > 6 else "")
        logging.getLogger("warp_plate").warning("%d of %d hits are left out: %s", len(bad), len(bad) + len(good), shown)
    if not good:
        raise ValueError(f"has no hit that can be used: {', '.join(bad[:3]) or 'the force is at rest'}")
    decay = 1.0 if table.exponential is None else np.exp(-np.arange(length) / (table.exponential * rate))
    spectra = []
    for start, _, end in good:
        pulse, fall = end - start, max(1, math.ceil(FALL * (end - start)))
        window = np.zeros(length)
        window[:pulse] = 1.0
        ahead = window[pulse : pulse + fall]
        ahead += 0.5 + 0.5 * np.cos(math.pi * np.arange(len(ahead)) / fall)
        rows = np.vstack([force[start : start + length] * window, motion[:, start : start + length]])
        spectra.append(np.fft.rfft(rows * decay))
    forces, motions = np.stack(spectra)[:, 0], np.stack(spectra)[:, 1:]
    crossed = np.mean(forces.conj()[:, None] * motions, axis=0)
    densities = np.mean(np.abs(forces) ** 2, axis=0), np.mean(np.abs(motions) ** 2, axis=0), crossed
    return np.fft.rfftfreq(length, 1 / rate), *densities, len(good)


def find_hits(force: np.ndarray, length: int) -> list[tuple[int, int, int]]:
    """Return the first sample of the block, the peak and the end of the pulse of each hit that begins a block."""
    sizes = np.abs(force)
    noise = float(np.median(sizes)) / 0.6745
    threshold = max(LEAST_HIT * float(sizes.max(initial=0.0)), NOISE * noise)
    over = np.flatnonzero(sizes > threshold)
    hits: list[tuple[int, int, int]] = []
    at = 0
    while at < over.size:
        first = int(over[at])
        stop = first
        while stop < sizes.size and sizes[stop] > threshold:
            stop += 1
        peak = first + int(sizes[first:stop].argmax())
        low = max(END * sizes[peak], 2 * noise)
        below = np.flatnonzero(sizes[peak:] < low)
        end = peak + int(below[0]) if below.size else sizes.size
        before = np.flatnonzero(sizes[:peak] < low)
        begin = int(before[-1]) if before.size else 0
        start = max(0, begin - max(2, math.ceil(BEFORE * (end - begin))))
        hits.append((start, peak, end))
        at = int(np.searchsorted(over, max(start + length, stop)))
    return hits


def _fault(force: np.ndarray, motion: np.ndarray, start: int, peak: int, end: int, length: int) -> str:
    """Return why a hit cannot be used, or ""."""
    if start + length > force.size:
        return "the record ends within its block"
    if end > start + length:
        return "it lasts longer than its block"
    block, sizes = slice(start, start + length), np.abs(force)
    pulse = end - start
    after = sizes[end + pulse // 2 : start + length]
    noise = float(np.median(sizes)) / 0.6745
    if after.size and after.max() > max(SECOND * sizes[peak], NOISE * noise):
        return "double hit"
    for name, row in (("force", force), *((f"sensor {number}", row) for number, row in enumerate(motion, 1))):
        if is_clipped(row[block]):
            return f"overload of the {name}"
    return ""


def is_clipped(row: np.ndarray) -> bool:
    """Return whether a signal (samples,) is cut off by an overload.

    It then enters a plateau at its largest or smallest value by more than the steps of its numbers, or takes this value
    often and those next to it hardly ever.
    """
    steps = np.abs(np.diff(row))
    if not steps.any():
        return False  # a channel that was not connected
    least = float(steps[steps > 0].min())
    for sizes in (row, -row):
        extreme = sizes.max()
        if extreme < np.abs(row).max() / 2:
            continue  # a side on which the signal rests
        flat = sizes == extreme
        edges = np.flatnonzero(np.diff(np.concatenate([[0], flat.astype(int), [0]])))
        for first, behind in edges.reshape(-1, 2).tolist():
            beside = [steps[at] for at in (first - 1, behind - 1) if 0 <= at < steps.size]
            if behind - first >= FLAT and max(beside, default=0.0) > PLATEAU * least:
                return True
        below = sizes[sizes < extreme - max(PLATEAU * least, ROUNDED * extreme)]
        near = sizes.size - below.size - flat.sum() + (below == below.max(initial=-math.inf)).sum()
        if flat.sum() >= OFTEN and flat.sum() > PLATEAU * near:
            return True
    return False
