"""The general plate on CPU: all steps in one launch, a plate a thread, over flat ranges of memory.

The same equations as ``general``, which see, in the form that LLVM turns into vector instructions (see
``resident_cpu_passes``). A pass walks all rows of the plate at once, padding included. Beyond an edge the tensors hold
zeros, and mirror images are factors: on an edge the inner neighbour counts twice and the outer one not at all. So each
node has four factors for its neighbours and one for its cells, planes of numbers like its rigidities.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.denormals import flush_denormals, restore_denormals
from warp_plate.kernels.fused import make_fused
from warp_plate.kernels.load import make_moving_load
from warp_plate.kernels.moment_form import make_hang, make_moment, make_other_forces
from warp_plate.kernels.update import make_parameters, make_update

# Planes of a plate's own room: mx, my, mxy, u_xx + κu_yy, what strains, what oscillators and a moving load press with,
# and the load where it has more than two terms.
ROOM = ("mx", "my", "mxy", "pull", "strained", "pressed", "loaded")
# Planes that all plates share, in this order in one array.
SHARED = (
    "west", "east", "south", "north", "cells", "bend_xx", "bend_xy", "bend_yy", "twist",
    "mobility", "decay", "spring", "weight", "press",
)  # fmt: skip


@cache
def make_run(effects, real, ny, stride, compiler_flags):
    """Steps ``start`` ... ``stop`` − 1 of the plates from ``first`` on; launch over (plates,).

    shared: (len(SHARED), rows, stride) planes; west ... north factors of the neighbours, those along y times (hx/hy)²;
    cells: of the cells around a node; press: mobility / weight; room: (threads, len(ROOM), rows, stride), of which the
    launch uses line ``thread``; holds: (oscillators, rows, stride); oscillators: (oscillators, 4) as in ``general``;
    loads: (terms, plates and a spare one, rows, stride); window, nodes, trace: as in ``resident_cpu``; wave:
    (plates, steps, terms); strength, along_y, along_x, moving, tension_x ... stretch_ratio: as in ``general``, along_x
    with padding to ``stride``.
    """
    update = make_update(effects, real)
    other_forces = make_other_forces(effects, real)
    moment, hang = make_moment(effects, real), make_hang(real)
    moving_load = make_moving_load(real)
    fused = make_fused(real)
    Parameters = make_parameters(real)
    size = wp.types.type_size_in_bytes(real)
    count = ny * stride
    plane_bytes = (ny + 2) * stride * size
    row_bytes = stride * size
    longest = count + 2 * stride + 2

    @wp.func
    def numbers(address: wp.uint64):
        return wp.array(ptr=address, shape=(wp.static(longest),), dtype=real)

    @wp.func
    def shared_plane(base: wp.uint64, index: int):
        return numbers(base + wp.uint64(index) * wp.uint64(wp.static(plane_bytes)) + wp.uint64(wp.static(row_bytes)))

    @wp.func
    def strain(u_at: wp.uint64, rate_at: wp.uint64, strained_at: wp.uint64, retardation: real):
        u = numbers(u_at)
        rate = numbers(rate_at)
        strained = numbers(strained_at)
        for i in range(wp.static(count)):
            strained[i] = u[i] + retardation * rate[i]

    @wp.func
    def bend(
        s: wp.uint64, u_at: wp.uint64, strained_at: wp.uint64, mx_at: wp.uint64, my_at: wp.uint64, mxy_at: wp.uint64,
        aspect: real, root_aspect: real, tension_x: real, tension_y: real,
    ):
        """Moments and twists; the addresses are those of the first row, and ``strained`` may be u itself."""
        west = shared_plane(s, 0)
        east = shared_plane(s, 1)
        south = shared_plane(s, 2)
        north = shared_plane(s, 3)
        bend_xx = shared_plane(s, 5)
        bend_xy = shared_plane(s, 6)
        bend_yy = shared_plane(s, 7)
        twist = shared_plane(s, 8)
        u = numbers(u_at)
        # From the lowest neighbour on, so that all lie at positive distances.
        v = numbers(strained_at - wp.uint64(wp.static((stride + 1) * size)))
        mx = numbers(mx_at)
        my = numbers(my_at)
        mxy = numbers(mxy_at)
        for i in range(wp.static(count)):
            c = v[i + wp.static(stride + 1)]
            e = v[i + wp.static(stride + 2)]
            n = v[i + wp.static(2 * stride + 1)]
            along_x = west[i] * v[i + wp.static(stride)] + (east[i] * e - real(2.0) * c)
            along_y = south[i] * v[i + 1] + (north[i] * n - real(2.0) * aspect * c)
            mx[i] = moment(bend_xx[i], along_x, bend_xy[i], along_y, tension_x, u[i])
            my[i] = moment(bend_yy[i], along_y, bend_xy[i], along_x, tension_y, u[i])
            mxy[i] = twist[i] * root_aspect * ((v[i + wp.static(2 * stride + 2)] - e) - (n - c))

    @wp.func
    def pull_of(s: wp.uint64, u_at: wp.uint64, pull_at: wp.uint64, aspect: real, stretch_ratio: real):
        west = shared_plane(s, 0)
        east = shared_plane(s, 1)
        south = shared_plane(s, 2)
        north = shared_plane(s, 3)
        u = numbers(u_at - wp.uint64(wp.static((stride + 1) * size)))
        pull = numbers(pull_at)
        for i in range(wp.static(count)):
            c = u[i + wp.static(stride + 1)]
            along_x = west[i] * u[i + wp.static(stride)] + (east[i] * u[i + wp.static(stride + 2)] - real(2.0) * c)
            along_y = south[i] * u[i + 1] + (north[i] * u[i + wp.static(2 * stride + 1)] - real(2.0) * aspect * c)
            pull[i] = along_x + stretch_ratio * along_y

    @wp.func
    def sum_of_products(a_at: wp.uint64, b_at: wp.uint64, columns_at: wp.uint64):
        """Σ a·b over the plate, columns first."""
        columns = numbers(columns_at)
        for i in range(wp.static(stride)):
            columns[i] = real(0.0)
        for row in range(wp.static(ny)):
            a = numbers(a_at + wp.uint64(row) * wp.uint64(wp.static(row_bytes)))
            b = numbers(b_at + wp.uint64(row) * wp.uint64(wp.static(row_bytes)))
            for i in range(wp.static(stride)):
                columns[i] = columns[i] + a[i] * b[i]
        total = real(0.0)
        for i in range(wp.static(stride)):
            total += columns[i]
        return total

    @wp.func
    def products(a_at: wp.uint64, b_at: wp.uint64, out_at: wp.uint64):
        a = numbers(a_at)
        b = numbers(b_at)
        out = numbers(out_at)
        for i in range(wp.static(count)):
            out[i] = a[i] * b[i]

    @wp.func
    def add_times(factor: real, plane_at: wp.uint64, sum_at: wp.uint64):
        plane = numbers(plane_at)
        total = numbers(sum_at)
        for i in range(wp.static(count)):
            total[i] = total[i] + factor * plane[i]

    @wp.func
    def press_moving(strength: real, along_y: wp.array[real], along_x: wp.array[real], pressed_at: wp.uint64):
        for row in range(wp.static(ny)):
            if along_y[row] != real(0.0):
                pressed = numbers(pressed_at + wp.uint64(row) * wp.uint64(wp.static(row_bytes)))
                for i in range(wp.static(stride)):
                    pressed[i] = pressed[i] + moving_load(strength, along_y[row], along_x[i])

    @wp.func
    def clear(at: wp.uint64):
        values = numbers(at)
        for i in range(wp.static(count)):
            values[i] = real(0.0)

    @wp.func
    def move(
        s: wp.uint64, mx_at: wp.uint64, my_at: wp.uint64, mxy_at: wp.uint64, pull_at: wp.uint64, pressed_at: wp.uint64,
        cosine_at: wp.uint64, sine_at: wp.uint64, loaded_at: wp.uint64,
        u_at: wp.uint64, rate_at: wp.uint64, squares_at: wp.uint64,
        wave_cosine: real, wave_sine: real, summed: real, tension: real, aspect: real, root_aspect: real,
    ):
        """Rate and displacement half a step and a step later; summed: one in the window, else zero."""
        west = shared_plane(s, 0)
        east = shared_plane(s, 1)
        south = shared_plane(s, 2)
        north = shared_plane(s, 3)
        cells = shared_plane(s, 4)
        mobility = shared_plane(s, 9)
        decay = shared_plane(s, 10)
        spring = shared_plane(s, 11)
        press = shared_plane(s, 13)
        mx = numbers(mx_at - wp.uint64(wp.static(size)))
        my = numbers(my_at - wp.uint64(wp.static(stride * size)))
        mxy = numbers(mxy_at - wp.uint64(wp.static((stride + 1) * size)))
        pull = numbers(pull_at)
        pressed = numbers(pressed_at)
        cosine = numbers(cosine_at)
        sine = numbers(sine_at)
        loaded = numbers(loaded_at)
        u = numbers(u_at)
        rate = numbers(rate_at)
        squares = numbers(squares_at)
        p = Parameters()
        for i in range(wp.static(count)):
            bending = west[i] * mx[i] + (east[i] * mx[i + 2] - real(2.0) * mx[i + 1])
            bending += south[i] * my[i] + (
                north[i] * my[i + wp.static(2 * stride)] - real(2.0) * aspect * my[i + wp.static(stride)]
            )
            twisting = (mxy[i + wp.static(stride + 1)] - mxy[i + wp.static(stride)]) - (mxy[i + 1] - mxy[i])
            bending += cells[i] * root_aspect * twisting
            here = u[i]
            if wp.static(effects.terms == 2):  # noqa: SIM108, one of the two is compiled
                load = wave_cosine * cosine[i] + wave_sine * sine[i]
            else:
                load = loaded[i]
            held = real(0.0)
            pulled = real(0.0)
            if wp.static(effects.foundation):
                held = spring[i]
            if wp.static(effects.stretching):
                pulled = pull[i]
            load = other_forces(load, mobility[i], held, here, tension, pulled)
            if wp.static(effects.oscillators or effects.moving_load):
                load += press[i] * pressed[i]
            if wp.static(effects.damping):
                p.decay = decay[i]
            new = update(rate[i], bending, load, mobility[i], p)
            rate[i] = new
            u[i] = here + new
            squares[i] = fused(summed * new, new, squares[i])

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": 1},
    )
    def run(
        shared: wp.array3d[real],
        wave: wp.array3d[real],
        strength: wp.array[real],
        along_x: wp.array2d[real],
        along_y: wp.array2d[real],
        window: wp.vec2i,
        aspect: real,
        root_aspect: real,
        tension_x: real,
        tension_y: real,
        retardation: real,
        stretching: real,
        stretch_ratio: real,
        oscillators: wp.array2d[real],
        holds: wp.array3d[real],
        units: wp.array[real],
        moving: wp.array[real],
        start: int,
        stop: int,
        first: int,
        thread: int,
        nodes: wp.array2d[int],
        loads: wp.array4d[real],
        room: wp.array4d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
        hung: wp.array3d[real],
        trace: wp.array3d[real],
    ):
        before = flush_denormals()
        k = first + wp.tid()
        row = wp.uint64(wp.static(row_bytes))
        plane = wp.uint64(k) * wp.uint64(wp.static(plane_bytes)) + row
        own = room.ptr + wp.uint64(thread) * wp.uint64(wp.static(len(ROOM) * plane_bytes)) + row
        step = wp.uint64(wp.static(plane_bytes))
        mx = own
        my = mx + step
        mxy = my + step
        pull = mxy + step
        strained = pull + step
        pressed = strained + step
        loaded = pressed + step
        term = wp.uint64(loads.shape[1]) * step
        first_load = loads.ptr + plane
        u_at = u.ptr + plane
        rate_at = rate.ptr + plane
        tension = real(0.0)
        for n in range(start, stop):
            strained_at = u_at
            if wp.static(effects.material_damping):
                strain(u_at, rate_at, strained, retardation)
                strained_at = strained
            bend(shared.ptr, u_at, strained_at, mx, my, mxy, aspect, root_aspect, tension_x, tension_y)
            if wp.static(effects.stretching):
                pull_of(shared.ptr, u_at, pull, aspect, stretch_ratio)
                weighed = shared.ptr + wp.uint64(wp.static(12 * plane_bytes)) + row
                # pressed is free until the oscillators press: it holds weight · u for a moment.
                products(weighed, u_at, pressed)
                tension = -stretching * units[k] * units[k] * sum_of_products(pressed, pull, strained)
            if wp.static(effects.oscillators or effects.moving_load):
                clear(pressed)
            if wp.static(effects.moving_load):
                press_moving(moving[k] * strength[n], along_y[n], along_x[n], pressed)
            if wp.static(effects.terms != 2):
                clear(loaded)
                for t in range(wp.static(effects.terms)):
                    add_times(wave[k, n, t], first_load + wp.uint64(t) * term, loaded)
            if wp.static(effects.oscillators):
                for o in range(oscillators.shape[0]):
                    hold = holds.ptr + wp.uint64(o) * step + row
                    total = sum_of_products(hold, u_at, strained)
                    speed = sum_of_products(hold, rate_at, strained)
                    push, place, pace = hang(hung[k, o, 0], hung[k, o, 1], total, speed, oscillators, o)
                    hung[k, o, 0] = place
                    hung[k, o, 1] = pace
                    add_times(push, hold, pressed)
            summed = real(0.0)
            if n >= window[0] and n < window[1]:
                summed = real(1.0)
            move(
                shared.ptr, mx, my, mxy, pull, pressed, first_load, first_load + term, loaded,
                u_at, rate_at, squares.ptr + plane, wave[k, n, 0], wave[k, n, 1], summed, tension, aspect, root_aspect,
            )
            for m in range(nodes.shape[0]):
                trace[k, m, n] = u[k, nodes[m, 0], nodes[m, 1]]
        restore_denormals(before)

    return run
