"""Gram matrices of plates under tones, for modes that damping does not couple; the formulas are those of
``warp_plate/modal/gram.py``.

Matrices have a row for each mode, or for each free motion in time: the real and the imaginary part of exp(st) of a mode
that oscillates, or its two decays. They have a column for each actuator of each plate. Regions mix rows, as products of
matrices; all else is done for each plate alone. Complex numbers are pairs. Matrices are filled up with zeros to whole
tiles of the dense product.
"""

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel

# Rows, inner numbers and columns of the tiles of a product of matrices, and threads that share a tile.
ROWS, INNER, COLUMNS = 64, 32, 64
THREADS = 128
# Products by Warp's own code: MathDx is slower to compile by a minute, and faster to run by a fifth at most.
TILE_OPTIONS = {"enable_mathdx_gemm": False}


@wp.func
def conjugate(a: wp.vec2d):
    return wp.vec2d(a[0], -a[1])


@wp.func
def multiply(a: wp.vec2d, b: wp.vec2d):
    return wp.vec2d(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.func
def divide(a: wp.vec2d, b: wp.vec2d):
    return multiply(a, conjugate(b)) / wp.dot(b, b)


@wp.func
def exponential(a: wp.vec2d):
    return wp.exp(a[0]) * wp.vec2d(wp.cos(a[1]), wp.sin(a[1]))


@wp.func
def mean_exponential(rate: wp.vec2d, window: wp.vec2d):
    """Return the mean of exp(rate·t) over the window."""
    phase = (window[1] - window[0]) * rate
    early = exponential(window[0] * rate)
    mean = divide(exponential(window[1] * rate) - early, phase)
    if wp.length(phase) < wp.float64(1e-3):  # where the difference would cancel
        one = wp.vec2d(wp.float64(1.0), wp.float64(0.0))
        series = one + multiply(phase, one + phase / wp.float64(4.0)) / wp.float64(3.0)
        mean = multiply(early, one + multiply(phase, series) / wp.float64(2.0))
    return mean


@wp.func
def integral_to(
    x: wp.float64, breaks: wp.array[wp.float64], pieces: wp.array3d[wp.float64], function: int
) -> wp.float64:
    interval = wp.clamp(wp.lower_bound(breaks, x) - 1, 0, breaks.shape[0] - 2)
    total = wp.float64(0.0)
    for power in range(pieces.shape[2]):
        total = total * (x - breaks[interval]) + pieces[interval, function, power]
    return total


@portable_kernel()
def integrate_patches(
    # parameters
    breaks_x: wp.array[wp.float64],  # (intervals + 1,) [m]
    breaks_y: wp.array[wp.float64],
    pieces_x: wp.array3d[wp.float64],  # (intervals, functions, powers) of x from the interval's start, highest first
    pieces_y: wp.array3d[wp.float64],
    # inputs
    areas: wp.array3d[wp.float64],  # (plates, actuators, 4) x0, x1, y0, y1 [m]
    # outputs
    integrals: wp.array2d[wp.float64],  # (functions of y · functions of x, columns) [m²]
):
    """Integrate products of splines over actuators; launch over (products, plates, actuators)."""
    row, k, a = wp.tid()
    i = row % pieces_x.shape[1]
    j = row // pieces_x.shape[1]
    along_x = integral_to(areas[k, a, 1], breaks_x, pieces_x, i) - integral_to(areas[k, a, 0], breaks_x, pieces_x, i)
    along_y = integral_to(areas[k, a, 3], breaks_y, pieces_y, j) - integral_to(areas[k, a, 2], breaks_y, pieces_y, j)
    integrals[row, k * areas.shape[1] + a] = along_x * along_y


@portable_kernel(**TILE_OPTIONS)
def multiply_dense(
    # inputs
    left: wp.array2d[wp.float64],
    right: wp.array2d[wp.float64],
    # outputs
    product: wp.array2d[wp.float64],
):
    """Multiply matrices; launch over tiles of columns and of rows, with THREADS threads each."""
    column, row = wp.tid()
    total = wp.tile_zeros(shape=(ROWS, COLUMNS), dtype=wp.float64)
    for k in range(left.shape[1] // INNER):
        first, second = (row * ROWS, k * INNER), (k * INNER, column * COLUMNS)
        a = wp.tile_load(left, (ROWS, INNER), first, storage="shared", bounds_check=False, aligned=True)
        b = wp.tile_load(right, (INNER, COLUMNS), second, storage="shared", bounds_check=False, aligned=True)
        wp.tile_matmul(a, b, total)
    wp.tile_store(product, total, offset=(row * ROWS, column * COLUMNS), bounds_check=False, aligned=True)


@portable_kernel()
def multiply_sparse(
    # inputs
    starts: wp.array[int],  # (rows + 1,) compressed sparse rows
    places: wp.array[int],
    values: wp.array[wp.float64],
    right: wp.array2d[wp.vec2d],
    # outputs
    product: wp.array2d[wp.vec2d],
):
    """Multiply a sparse matrix and a complex one; launch over all numbers of the product."""
    row, column = wp.tid()
    total = wp.vec2d()
    for k in range(starts[row], starts[row + 1]):
        total += values[k] * right[places[k], column]
    product[row, column] = total


@portable_kernel()
def write_drives(
    # inputs
    frequency: wp.array2d[wp.float64],  # (plates, actuators) [Hz]
    undamped: wp.array[wp.vec2d],  # (poles,) those without damping [1/s]
    apart: wp.float64,  # [1/s]
    # outputs
    drive: wp.array2d[wp.vec2d],  # (plates, actuators) exponents [1/s]
):
    """Write iω, weighted if it meets a pole; launch over (plates, actuators)."""
    plate, actuator = wp.tid()
    rate = wp.vec2d(wp.float64(0.0), wp.float64(wp.static(2.0 * wp.PI)) * frequency[plate, actuator])
    shift = wp.float64(0.0)
    for pole in range(undamped.shape[0]):
        if wp.length(rate - undamped[pole]) < apart:
            shift = apart
    drive[plate, actuator] = rate + wp.vec2d(shift, wp.float64(0.0))


@portable_kernel()
def write_motions(
    # parameters
    poles: wp.array2d[wp.vec2d],  # (2, modes) s [1/s]
    sizes: wp.array2d[wp.vec2d],  # (2, modes) ψ² [s]
    free_sizes: wp.array2d[wp.vec2d],  # (2, modes) −ψ², or 0 of free motions that have died away
    oscillates: wp.array[int],  # (modes,) 1 if the poles are conjugate
    place: wp.array[int],  # (modes,) row of the mode's first free motion; −1 if both have died away
    lasting: int,  # modes whose free motions have not
    velocity: int,  # 1 for rates
    window: wp.vec2d,  # start and end [s]
    # inputs
    drive: wp.array2d[wp.vec2d],  # (plates, actuators) exponents [1/s]
    forces: wp.array2d[wp.float64],  # (modes, columns)
    distinct: int,  # columns of ``forces``: those of one plate serve all
    # outputs
    forced: wp.array2d[wp.vec2d],  # (modes, columns) amplitudes of exp(drive·t)
    free: wp.array2d[wp.vec2d],  # (free motions, columns) amplitudes
    means: wp.array2d[wp.vec2d],  # (free motions, columns) means of free motions times exp(drive·t)
):
    """Write the motion of modes under unit phasors; launch over (modes, plates, actuators)."""
    mode, plate, actuator = wp.tid()
    column = plate * drive.shape[1] + actuator
    force = forces[mode, column % distinct]
    rate = drive[plate, actuator]
    state_1 = divide(wp.vec2d(force, wp.float64(0.0)), rate - poles[0, mode])
    state_2 = divide(wp.vec2d(force, wp.float64(0.0)), rate - poles[1, mode])
    amplitude = multiply(sizes[0, mode], state_1) + multiply(sizes[1, mode], state_2)
    free_1 = multiply(free_sizes[0, mode], state_1)
    free_2 = multiply(free_sizes[1, mode], state_2)
    if velocity == 1:
        amplitude = multiply(amplitude, rate)
        free_1 = multiply(free_1, poles[0, mode])
        free_2 = multiply(free_2, poles[1, mode])
    forced[mode, column] = amplitude
    row = place[mode]
    if row >= 0:
        mean_1 = mean_exponential(rate + poles[0, mode], window)
        mean_2 = mean_exponential(rate + poles[1, mode], window)
        if oscillates[mode] == 1:
            i = wp.vec2d(wp.float64(0.0), wp.float64(1.0))
            difference = multiply(i, free_1 - free_2)
            free_1 = free_1 + free_2
            free_2 = difference
            difference = multiply(i, mean_2 - mean_1) / wp.float64(2.0)
            mean_1 = (mean_1 + mean_2) / wp.float64(2.0)
            mean_2 = difference
        free[row, column] = free_1
        means[row, column] = mean_1
        free[row + lasting, column] = free_2
        means[row + lasting, column] = mean_2


@portable_kernel()
def contract(
    # parameters
    lasting_modes: wp.array[int],  # (free motions,) their modes
    steady: int,  # 1 for means over the periods of equal frequencies
    window: wp.vec2d,  # start and end [s]
    # inputs; matrices with the columns of the plates' actuators
    drive: wp.array2d[wp.vec2d],  # (plates, actuators) exponents [1/s]
    forced: wp.array2d[wp.vec2d],  # see ``write_motions``
    free: wp.array2d[wp.vec2d],
    means: wp.array2d[wp.vec2d],
    weighted: wp.array2d[wp.vec2d],  # the region's mass matrix times ``forced``
    formed: wp.array2d[wp.vec2d],  # the region's form of free motions times ``free``
    region: int,
    # outputs
    matrices: wp.array4d[wp.float64],  # (plates, regions, 2·actuators, 2·actuators)
):
    """Write the energies of pairs of actuators; launch over (plates, actuators, actuators)."""
    plate, k, m = wp.tid()
    count = drive.shape[1]
    if k > m:
        return  # the other of two that are equal writes both
    first = plate * count + k
    second = plate * count + m
    plain = wp.vec2d()  # mean of v_k v_m
    mixed = wp.vec2d()  # mean of conj(v_k) v_m
    for row in range(forced.shape[0]):
        a = forced[row, first]
        b = weighted[row, second]
        plain += multiply(a, b)
        mixed += multiply(conjugate(a), b)
    if steady == 1:
        plain = wp.vec2d()
        if drive[plate, k][1] != drive[plate, m][1]:
            mixed = wp.vec2d()
    else:
        plain = multiply(plain, mean_exponential(drive[plate, k] + drive[plate, m], window))
        mixed = multiply(mixed, mean_exponential(conjugate(drive[plate, k]) + drive[plate, m], window))
    for row in range(lasting_modes.shape[0]):
        a = free[row, first]
        b = free[row, second]
        across_a = multiply(weighted[lasting_modes[row], first], means[row, first])
        across_b = multiply(weighted[lasting_modes[row], second], means[row, second])
        both = across_b + formed[row, second]
        plain += multiply(across_a, b) + multiply(a, both)
        mixed += multiply(conjugate(across_a), b) + multiply(conjugate(a), both)
    quarter = wp.float64(0.25)
    both = quarter * (mixed + plain)
    less = quarter * (mixed - plain)
    matrices[plate, region, k, m] = both[0]
    matrices[plate, region, m, k] = both[0]
    matrices[plate, region, count + k, count + m] = less[0]
    matrices[plate, region, count + m, count + k] = less[0]
    matrices[plate, region, k, count + m] = both[1]
    matrices[plate, region, count + m, k] = both[1]
    matrices[plate, region, m, count + k] = -less[1]
    matrices[plate, region, count + k, m] = -less[1]
