"""Waves that plates have of their own: tones of other frequencies, bursts that begin at other times.

    load of plate k at step n = Σ_t wave[k, n, t]·loads[t, k]

Where all plates share their waves, ``wave`` is one plate's with a stride of zero from plate to plate. Here are the ones
that differ, with the two terms cos ωt and sin ωt for each carrier, under the envelope of a burst; all is worked out in
float64. The host has the same in ``plate/signals.py``.
"""

from functools import cache

import warp as wp


@wp.struct
class Envelope:
    """Duration, ramp and period of a burst [s]; period: zero for a single burst."""

    duration: wp.float64
    ramp: wp.float64
    period: wp.float64


@wp.func
def risen(time: wp.float64, ramp: wp.float64):
    """Integral of the rise ½(1 − cos πt/ramp) from 0 to ``time``, within 0 ... ramp."""
    total = wp.float64(0.0)
    if ramp > wp.float64(0.0):
        turn = wp.float64(wp.static(wp.PI)) / ramp
        total = (time - wp.sin(turn * time) / turn) / wp.float64(2.0)
    return total


@wp.func
def envelope_until(time: wp.float64, e: Envelope):
    """Integral of the bursts' envelope up to ``time`` after the first one's start."""
    zero = wp.float64(0.0)
    half_ramp = e.ramp / wp.float64(2.0)
    flat = wp.max(e.duration - wp.float64(2.0) * e.ramp, zero)
    past = zero
    if e.period > zero:
        past = wp.max(wp.floor(time / e.period), zero)
    inside = time - past * e.period
    rise = risen(wp.clamp(inside, zero, e.ramp), e.ramp)
    top = wp.clamp(inside - e.ramp, zero, flat)
    falling = wp.clamp(inside - (e.duration - e.ramp), zero, e.ramp)
    return past * (flat + e.ramp) + rise + top + (half_ramp - risen(e.ramp - falling, e.ramp))


@cache
def make_tones(real, burst):
    """Writes the waves; launch over (plates, steps, carriers). ``burst``: whether the tones have an envelope.

    frequency [Hz], delay [s]: (plates, carriers); wave: (plates, steps, 2·carriers).
    """

    @wp.kernel(module="unique", enable_backward=False)
    def tones(
        frequency: wp.array2d[wp.float64],
        delay: wp.array2d[wp.float64],
        time_step: wp.float64,
        envelope: Envelope,
        wave: wp.array3d[real],
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
            size = (envelope_until(high - start, envelope) - envelope_until(low - start, envelope)) / (high - low)
        if n == 0:
            size *= wp.float64(0.5)
        angle = wp.float64(wp.static(2.0 * wp.PI)) * frequency[k, carrier] * time_step * step
        wave[k, n, 2 * carrier] = real(size * wp.cos(angle))
        wave[k, n, 2 * carrier + 1] = real(size * wp.sin(angle))

    return tones


@cache
def make_running_sums(real):
    """Replaces waves by their running sums over the steps, below two in size; launch over (plates, terms).

    sizes: (plates, terms) powers of two by which the sums were divided.
    """

    @wp.kernel(module="unique", enable_backward=False)
    def running_sums(wave: wp.array3d[real], sizes: wp.array2d[wp.float64]):
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

    return running_sums
