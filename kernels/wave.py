"""Waves in time that differ from plate to plate: tones of other frequencies, bursts that begin at other times.

    load of plate k at step n = Σ_t wave[k, n, t]·loads[t, k]

Waves that all plates share are one plate's, with a stride of zero from plate to plate. The waves made here have two
terms for each carrier, cos ωt and sin ωt, under the envelope of a burst, and are computed in float64, as on the host in
``plate/signals.py``.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel


@wp.struct
class Envelope:
    """Burst: duration, ramp and repetition period [s]; period 0 for a single burst."""

    duration: wp.float64
    ramp: wp.float64
    period: wp.float64


@wp.func
def integrate_ramp(time: wp.float64, ramp: wp.float64):
    """Integrate the rise ½(1 − cos πt/ramp) from 0 to ``time``, which is within 0 … ramp."""
    total = wp.float64(0.0)
    if ramp > wp.float64(0.0):
        turn = wp.float64(wp.static(wp.PI)) / ramp
        total = (time - wp.sin(turn * time) / turn) / wp.float64(2.0)
    return total


@wp.func
def integrate_envelope(time: wp.float64, e: Envelope):
    """Integrate the envelope of the bursts from the start of the first one to ``time`` after it."""
    zero = wp.float64(0.0)
    half_ramp = e.ramp / wp.float64(2.0)
    flat = wp.max(e.duration - wp.float64(2.0) * e.ramp, zero)
    past = zero
    if e.period > zero:
        past = wp.max(wp.floor(time / e.period), zero)
    inside = time - past * e.period
    rise = integrate_ramp(wp.clamp(inside, zero, e.ramp), e.ramp)
    top = wp.clamp(inside - e.ramp, zero, flat)
    falling = wp.clamp(inside - (e.duration - e.ramp), zero, e.ramp)
    return past * (flat + e.ramp) + rise + top + (half_ramp - integrate_ramp(e.ramp - falling, e.ramp))


@cache
def make_write_tones(real, burst):
    """Make the kernel that writes tones, under an envelope if ``burst``; launch over (plates, steps, carriers)."""

    @portable_kernel()
    def write_tones(
        # inputs
        frequency: wp.array2d[wp.float64],  # (plates, carriers) [Hz]
        delay: wp.array2d[wp.float64],  # (plates, carriers) [s]
        time_step: wp.float64,
        envelope: Envelope,
        # outputs
        wave: wp.array3d[real],  # (plates, steps, 2·carriers)
    ):
        k, n, carrier = wp.tid()
        step = wp.float64(n)
        size = wp.float64(1.0)
        if wp.static(burst):
            # The mean over the step around t_n; the first step has only the later half.
            half = wp.float64(0.5)
            low = wp.max(step - half, wp.float64(0.0)) * time_step
            high = (step + half) * time_step
            start = delay[k, carrier]
            size = (integrate_envelope(high - start, envelope) - integrate_envelope(low - start, envelope)) / (
                high - low
            )
        if n == 0:
            size *= wp.float64(0.5)
        angle = wp.float64(wp.static(2.0 * wp.PI)) * frequency[k, carrier] * time_step * step
        wave[k, n, 2 * carrier] = real(size * wp.cos(angle))
        wave[k, n, 2 * carrier + 1] = real(size * wp.sin(angle))

    return write_tones


@cache
def make_accumulate_waves(real):
    """Make the kernel that replaces waves by their running sums over the steps, each divided by a power of two that
    makes it smaller than two; launch over (plates, terms)."""

    @portable_kernel()
    def accumulate_waves(
        # outputs
        wave: wp.array3d[real],  # (plates, steps, terms)
        sizes: wp.array2d[wp.float64],  # (plates, terms) divisors
    ):
        k, t = wp.tid()
        total = wp.float64(0.0)
        largest = wp.float64(0.0)
        for n in range(wave.shape[1]):
            total += wp.float64(wave[k, n, t])
            largest = wp.max(largest, wp.abs(total))
            wave[k, n, t] = real(total)
        size = wp.float64(1.0)
        while wp.float64(2.0) * size <= largest:
            size *= wp.float64(2.0)
        for n in range(wave.shape[1]):
            wave[k, n, t] = wave[k, n, t] * real(wp.float64(1.0) / size)
        sizes[k, t] = size

    return accumulate_waves
