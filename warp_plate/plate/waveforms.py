"""Waveforms of drives over the steps of a run: tones, sweeps and the envelopes of bursts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from warp_plate.scene.drive import Burst, Chirp


def tone(chirp: Chirp | None, frequency: np.ndarray | float, time_step: float, steps: int) -> np.ndarray:
    """Return (..., steps) complex tones, or sweeps, that begin at frequencies (..., 1) or () [Hz]."""
    if chirp is None:
        angle = 2 * math.pi * frequency * time_step * np.arange(steps)
    else:
        angle = _sweep(chirp, np.asarray(frequency), time_step * np.arange(steps))
    return np.cos(angle) + 1j * np.sin(angle)


def _sweep(chirp: Chirp, start: np.ndarray, times: np.ndarray) -> np.ndarray:
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
    """Return (..., steps) means over a step of the envelope to a power, 1 or 2.

    Its ramps are ½(1 − cos πt/ramp); ``start`` (..., 1) or a number [s] replaces the burst's own.
    """
    duration, ramp = burst.duration, burst.ramp
    whole_ramp = ramp / 2 if power == 1 else 3 * ramp / 8

    def risen(time: np.ndarray) -> np.ndarray:  # the integral of the rise up to a time within 0 ... ramp
        if not ramp:
            return 0 * time
        turn = math.pi / ramp
        if power == 1:
            return (time - np.sin(turn * time) / turn) / 2
        return 3 * time / 8 - np.sin(turn * time) / (2 * turn) + np.sin(2 * turn * time) / (16 * turn)

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
    """Return (steps,) means of a function over the step around each t_n, of n = 0 over the later half alone.

    A jump between two steps is then right to second order, as the scheme is.

    Args:
        integral: Integral of the function from a fixed time on.
    """
    edges = time_step * np.concatenate([[0.0], np.arange(steps) + 0.5])
    means: np.ndarray = np.diff(integral(edges)) / np.diff(edges)
    return means
