"""Loads: actuator pressures as a few fields per plate, so that a step costs the same for any number of actuators.

    load(n) = Σ_t wave[n, t]·loads[t, plate],   loads[t, plate] = Σ_k coefficients[plate, t, k]·patch_k

One tone has two terms, cos ωt and sin ωt, with the coefficients Re Z and −Im Z. Where each plate has actuators in
places of its own, their patches are computed here, as products of weights along x and y (see ``plate/weights.py``).
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel


@cache
def make_scale_drives(real, given):
    """Make the kernel that writes the coefficients of drives that are on the device; launch over plates.

    Each plate's are in units of its largest pressure, and NaN where that is out of range.
    """

    @wp.func
    def pressure(
        drives: wp.array3d[given], factors: wp.array3d[wp.float64], plate: int, term: int, actuator: int
    ) -> wp.float64:
        real_part = wp.float64(drives[plate, actuator, 0])
        imaginary_part = wp.float64(drives[plate, actuator, 1])
        total = factors[term, 0, actuator] * real_part - factors[term, 1, actuator] * imaginary_part
        if factors.shape[1] > 2:
            real_square = real_part * real_part
            imaginary_square = imaginary_part * imaginary_part
            total += factors[term, 2, actuator] + factors[term, 3, actuator] * (real_square + imaginary_square)
            total += factors[term, 4, actuator] * (real_square - imaginary_square)
            total -= factors[term, 5, actuator] * (wp.float64(2.0) * real_part * imaginary_part)
        return total

    @portable_kernel()
    def scale_drives(
        # inputs
        drives: wp.array3d[given],  # (plates, actuators, 2) Re Z, Im Z
        factors: wp.array3d[wp.float64],  # (terms, features, actuators), see ``plate.signals``
        least: wp.float64,  # pressure that all plates have beside their drives [N/m²]
        smallest: wp.float64,  # range of pressures [N/m²]
        largest: wp.float64,
        load_scale: wp.float64,  # displacement [m] of a unit of u under a pressure of 1 N/m²
        # outputs
        coefficients: wp.array3d[real],  # (plates, terms, actuators)
        scale: wp.array[wp.float64],  # (plates,) largest pressure [N/m²]
        units: wp.array[real],  # (plates,) displacement [m] of a unit of u
        moving: wp.array[real],  # (plates,) ``least`` in units of each plate's pressure
    ):
        plate = wp.tid()
        size = least
        for term in range(factors.shape[0]):
            for actuator in range(factors.shape[2]):
                value = wp.abs(pressure(drives, factors, plate, term, actuator))
                if value > size or wp.isnan(value):
                    size = value
        if size != wp.float64(0.0) and not (size >= smallest and size <= largest):
            size = wp.float64(wp.nan)
        scale[plate] = size
        units[plate] = real(size * load_scale)
        if size == wp.float64(0.0):
            size = wp.float64(1.0)
        moving[plate] = real(least / size)
        for term in range(factors.shape[0]):
            for actuator in range(factors.shape[2]):
                coefficients[plate, term, actuator] = real(pressure(drives, factors, plate, term, actuator) / size)

    return scale_drives


@cache
def make_write_loads(real):
    """Make the kernel that writes the load fields where actuators are; launch over (plates, terms, covered nodes)."""

    @portable_kernel()
    def write_loads(
        # inputs
        coefficients: wp.array3d[real],  # (plates, terms, actuators)
        covered: wp.array2d[int],  # (covered nodes, 2) row, column
        patches: wp.array2d[real],  # (actuators, covered nodes)
        # outputs
        loads: wp.array4d[real],  # (terms, plates, rows, columns)
    ):
        plate, term, node = wp.tid()
        total = real(0.0)
        for actuator in range(patches.shape[0]):
            total += patches[actuator, node] * coefficients[plate, term, actuator]
        loads[term, plate, covered[node, 0], covered[node, 1]] = total

    return write_loads


@cache
def make_write_placed_loads(real):
    """Make the kernel that does the same where each plate has patches in places of its own."""

    @portable_kernel()
    def write_placed_loads(
        # inputs
        coefficients: wp.array3d[real],  # (plates, terms, actuators)
        covered: wp.array2d[int],  # (nodes that may be covered, 2) row, column
        share: wp.array[wp.float64],  # (nodes that may be covered,) load of a unit pressure on the node's whole cell
        along_x: wp.array3d[wp.float64],  # (plates, actuators, nx)
        along_y: wp.array3d[wp.float64],  # (plates, actuators, ny)
        # outputs
        loads: wp.array4d[real],  # (terms, plates, rows, columns)
    ):
        plate, term, node = wp.tid()
        row = covered[node, 0]
        column = covered[node, 1]
        total = real(0.0)
        for actuator in range(along_x.shape[1]):
            # A row of zeros lies below the plate.
            weight = along_y[plate, actuator, row - 1] * along_x[plate, actuator, column] * share[node]
            total += real(weight) * coefficients[plate, term, actuator]
        loads[term, plate, row, column] = total

    return write_placed_loads


@cache
def make_weigh_spans(by_moments):
    """Make the kernel that weighs nodes along an axis for the span of each actuator; launch over (plates, actuators).

    By overlap, a weight is the covered part of the node's cell; ``by_moments``, the integral over the span of the
    node's Lagrange polynomial through four nodes.
    """

    @wp.func
    def overlap(positions: wp.array[wp.float64], low: wp.float64, high: wp.float64, node: int):
        half = (positions[1] - positions[0]) / wp.float64(2.0)
        left = wp.max(positions[node] - half, wp.max(low, positions[0]))
        right = wp.min(positions[node] + half, wp.min(high, positions[positions.shape[0] - 1]))
        return wp.max(right - left, wp.float64(0.0)) / (wp.float64(2.0) * half)

    @wp.func
    def moments_between(start: wp.float64, stop: wp.float64):
        """Return ∫ (1, x, x², x³) dx."""
        moments = wp.vec4d()
        low = wp.float64(1.0)
        high = wp.float64(1.0)
        for power in range(4):
            low *= start
            high *= stop
            moments[power] = (high - low) / wp.float64(power + 1)
        return moments

    @portable_kernel()
    def weigh_spans(
        # inputs
        edges: wp.array3d[wp.float64],  # (plates, actuators, 4) x0, x1, y0, y1 [m]
        first: int,  # the span is edges[..., first : first + 2]
        positions: wp.array[wp.float64],  # (nodes,) [m]
        to_weights: wp.mat44d,  # from moments about the middle of four nodes, in spacings, to their weights
        # outputs
        weights: wp.array3d[wp.float64],  # (plates, actuators, nodes)
    ):
        plate, actuator = wp.tid()
        low = edges[plate, actuator, first]
        high = edges[plate, actuator, first + 1]
        nodes = positions.shape[0]
        if wp.static(by_moments):
            spacing = positions[1] - positions[0]
            last = wp.float64(nodes - 1)
            begin = wp.clamp((low - positions[0]) / spacing, wp.float64(0.0), last)
            end = wp.clamp((high - positions[0]) / spacing, wp.float64(0.0), last)
            for node in range(nodes):
                weights[plate, actuator, node] = wp.float64(0.0)
            for interval in range(int(begin), wp.min(int(wp.ceil(end)), nodes - 1)):
                # First of the four nodes whose cubic is integrated over this interval.
                node = wp.min(wp.max(interval - 1, 0), nodes - 4)
                middle = wp.float64(node) + wp.float64(1.5)
                left = wp.clamp(begin, wp.float64(interval), wp.float64(interval + 1)) - middle
                right = wp.clamp(end, wp.float64(interval), wp.float64(interval + 1)) - middle
                cubic_weights = to_weights * moments_between(left, right)
                for place in range(4):
                    weights[plate, actuator, node + place] += cubic_weights[place]
        else:
            for node in range(nodes):
                weights[plate, actuator, node] = overlap(positions, low, high, node)

    return weigh_spans


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
        omega = wp.float64(wp.static(wp.PI)) / ramp
        total = (time - wp.sin(omega * time) / omega) / wp.float64(2.0)
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
