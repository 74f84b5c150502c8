"""The general plate on CUDA: all steps in one launch, a block a plate, over flat ranges of nodes.

The same equations as ``general``, which see. Node i of the plate, row after row, belongs to thread i modulo the
threads. Planes that neighbours read (u, mx, my, mxy) lie in the block's shared memory where they fit, else in memory;
what a node alone reads and writes (rate, its sum of rate², its rigidities) is held in the thread's registers, as much
of it as they take. A node on an edge puts one neighbour in the other's place by a selection, which costs less than to
read a factor. Threads with no node left have one of zeros beyond the plate, so that no pass asks.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.cuda import LANES, anew, barrier, make_from_lane, shared_memory
from warp_plate.kernels.fused import make_fused
from warp_plate.kernels.load import make_moving_load
from warp_plate.kernels.moment_form import make_hang, make_moment, make_other_forces, make_structs
from warp_plate.kernels.moment_form_edges import BITS, BOTTOM, LEFT, LOADED, RIGHT, TOP, WORD, make_edges
from warp_plate.kernels.moment_form_plan import SHARED, layout, used
from warp_plate.kernels.update import make_parameters, make_update


@cache
def make_run(effects, real, nx, ny, stride, hanging, blocks):
    """Steps ``start`` ... ``stop`` − 1; launch over (plates × threads,) with blocks of ``blocks.threads`` threads.

    shared_planes: (planes that are ``used``, threads × nodes), holds: (hanging, threads × nodes) shares of the
    oscillators' patches, both with zeros beyond the plate; room: (plates, ``layout``'s end) where it is not shared
    memory; wave: (plates, steps, terms); loads: (terms, plates, rows, stride); u, rate, squares: (plates, rows,
    stride); hung: (plates, hanging, 2) place and pace of the masses; nodes: (traced nodes, 2), row of the plate and
    column; trace: (plates, traced nodes, steps).
    """
    update, other_forces = make_update(effects, real), make_other_forces(effects, real)
    moment, hang, moving_load = make_moment(effects, real), make_hang(real), make_moving_load(real)
    from_lane, Material, Parameters = make_from_lane(real), make_structs(real)[0], make_parameters(real)
    edges_of, across, cells_of = make_edges(real, nx, ny)
    fused, size = make_fused(real), wp.types.type_size_in_bytes(real)
    threads, mine, held, shared = blocks.threads, blocks.nodes, blocks.held, used(effects)
    count, padded, warps = nx * ny, threads * mine, -(-threads // LANES)
    state_size, words, sums = ny * stride, -(-mine // WORD), effects.stretching or effects.oscillators
    place = layout(nx, hanging, blocks)
    u_at, mx_at, my_at, mxy_at = (place[name] for name in ("u", "mx", "my", "mxy"))
    bent_at, pull_at = place.get("strained", u_at), place.get("pull", 0)
    slots, results, room_size = place["slots"], place["results"], place["end"]
    row = {name: index for index, name in enumerate(held)}
    u_row, rate_row, squares_row, middle_row, pull_row = (
        row.get(name, 0) for name in ("u", "rate", "squares", "middle", "pull")
    )
    first_shared = min((row[name] for name in held if name in shared), default=0)
    held_shared = sum(name in shared for name in held)
    Held = wp.types.matrix(shape=(max(1, len(held)), mine if held else 1), dtype=real)

    def make_own(name):
        """Reads a shared plane at a node, from registers where it is held."""
        if name in held:

            @wp.func
            def own(h: Held, planes: wp.array[real], m: int, i: int):
                return h[wp.static(row[name]), m]
        else:

            @wp.func
            def own(h: Held, planes: wp.array[real], m: int, i: int):
                return planes[i + wp.static(shared.index(name) * padded if name in shared else 0)]

        return own

    def make_number(name, first):
        """Reads a number of the node's own, from registers where it is held, else from the block's room."""
        if name in held:

            @wp.func
            def number(h: Held, x: wp.array[real], m: int, i: int):
                return h[wp.static(row[name]), m]
        else:

            @wp.func
            def number(h: Held, x: wp.array[real], m: int, i: int):
                return x[i + first]

        return number

    here_of, pull_of = make_number("u", u_at), make_number("pull", pull_at)
    mobility_of, bend_xx_of, bend_xy_of, bend_yy_of, twist_of = map(make_own, SHARED[:5])
    decay_of, spring_of, weight_of, press_of = map(make_own, SHARED[5:])

    @wp.func
    def sum_of_warp(value: real, lane: int):
        total = value
        if wp.static(threads > 1):
            for power in range(5):
                total += from_lane(total, lane ^ (1 << power))
        return total

    @wp.func
    def state_at(i: int):
        """Where the state has a node; one beyond the plate stands for the last."""
        node = wp.min(i, wp.static(count - 1))
        return node + node // nx * wp.static(stride - nx)

    @wp.func
    def part_of(field: wp.uint64, at: int):
        """A plate's part of a field of the state, at a node."""
        return wp.array(ptr=field, shape=(state_size,), dtype=real)[at]

    @wp.func
    def middle_of(mx: real, my: real, mxy: real, cells: real, aspect: real):
        """Share in the force on a node of its own moments and of the cell to its upper right."""
        return fused(cells, mxy, real(-2.0) * mx) - real(2.0) * aspect * my

    @wp.func
    def finish_sum(p: Material, x: wp.array[real], units: wp.array[real], hung: wp.array3d[real], k: int, which: int):
        """From the warps' sums an oscillator's push, and its mass half a step and a step later; or the tension."""
        first = slots + 2 * which * warps
        total = real(0.0)
        for w in range(warps):
            total += x[first + w]
        if which < hanging:
            speed = real(0.0)
            for w in range(warps):
                speed += x[first + warps + w]
            push, hung_place, pace = hang(hung[k, which, 0], hung[k, which, 1], total, speed, p.oscillators, which)
            hung[k, which, 0] = hung_place
            hung[k, which, 1] = pace
            x[results + which] = push
        else:
            x[results + which] = p.stretching * units[k] * units[k] * total

    @wp.kernel(
        module="unique",
        enable_backward=False,
        grid_stride=False,
        cuda_max_registers=blocks.registers,
        module_options={"max_unroll": max(5, mine if held else 1)},
    )
    def run(
        p: Material,
        shared_planes: wp.array2d[real],
        holds: wp.array2d[real],
        window: wp.vec2i,
        start: int,
        stop: int,
        wave: wp.array3d[real],
        units: wp.array[real],
        moving: wp.array[real],
        nodes: wp.array2d[int],
        loads: wp.array4d[real],
        room: wp.array2d[real],
        u: wp.array3d[real],
        rate: wp.array3d[real],
        squares: wp.array3d[real],
        hung: wp.array3d[real],
        trace: wp.array3d[real],
    ):
        k = wp.tid() // threads
        thread = wp.tid() % threads
        lane = thread % LANES
        warp = thread // LANES
        if wp.static(blocks.on_chip):
            reserved = wp.tile_empty(shape=(room_size,), dtype=real, storage="shared")
            own_room = shared_memory()
        else:
            own_room = room.ptr + wp.uint64(k) * wp.uint64(wp.static(room_size * size))
        x = wp.array(ptr=own_room, shape=(room_size,), dtype=real)
        # In memory, though registers would do: else what follows from them is carried from pass to pass, in more.
        kinds = wp.array(
            ptr=own_room + wp.uint64(wp.static(place["kinds"] * size)), shape=(wp.static(words * threads),), dtype=int
        )
        planes = wp.array(ptr=shared_planes.ptr, shape=(wp.static(len(shared) * padded),), dtype=real)
        offset = (wp.uint64(k) * wp.uint64(wp.static(ny + 2)) + wp.uint64(1)) * wp.uint64(wp.static(stride * size))
        own_u = wp.array(ptr=u.ptr + offset, shape=(state_size,), dtype=real)
        own_rate = wp.array(ptr=rate.ptr + offset, shape=(state_size,), dtype=real)
        own_squares = wp.array(ptr=squares.ptr + offset, shape=(state_size,), dtype=real)
        term = wp.uint64(loads.shape[1]) * wp.uint64(wp.static((ny + 2) * stride * size))

        # Numbers left from before would spread as NaN through factors of zero.
        for i in range(thread, room_size, threads):
            x[i] = real(0.0)
        barrier()
        h = Held()
        for m in range(mine):
            i = thread + m * threads
            for q in range(held_shared):
                h[first_shared + q, m] = planes[i + q * padded]
            if i < count:
                at = state_at(i)
                here = own_u[at]
                x[i + u_at] = here
                if wp.static("u" in held):
                    h[u_row, m] = here
                if wp.static("rate" in held):
                    h[rate_row, m] = own_rate[at]
                if wp.static("squares" in held):
                    h[squares_row, m] = own_squares[at]
                if wp.static(effects.material_damping):
                    x[i + bent_at] = here + p.retardation * own_rate[at]
                kind = edges_of(i)
                for t in range(wp.static(effects.terms)):
                    if part_of(loads.ptr + offset + wp.uint64(t) * term, at) != real(0.0):
                        kind = kind | LOADED
                kinds_of = m // WORD * threads + thread
                kinds[kinds_of] = kinds[kinds_of] | (kind << (BITS * (m % WORD)))
        barrier()

        for n in range(start, stop):
            own = anew(thread)
            word = int(0)
            stretched = real(0.0)
            for m in range(mine):
                i = own + m * threads
                if m % WORD == 0:
                    word = kinds[m // WORD * threads + own]
                kind = word >> (BITS * (m % WORD))
                at = i + bent_at
                here = here_of(h, x, m, i)
                c = here
                if wp.static(effects.material_damping):
                    c = x[at]
                e = x[at + 1]
                up = x[at + nx]
                curved_x = across(x, at, LEFT, RIGHT, kind, 1) - real(2.0) * c
                curved_y = p.aspect * (across(x, at, BOTTOM, TOP, kind, nx) - real(2.0) * c)
                bend_xy = bend_xy_of(h, planes, m, i)
                mx = moment(bend_xx_of(h, planes, m, i), curved_x, bend_xy, curved_y, p.tension_x, here)
                my = moment(bend_yy_of(h, planes, m, i), curved_y, bend_xy, curved_x, p.tension_y, here)
                mxy = twist_of(h, planes, m, i) * (p.root_aspect * ((x[at + wp.static(nx + 1)] - e) - (up - c)))
                x[i + mx_at] = mx
                x[i + my_at] = my
                x[i + mxy_at] = mxy
                if wp.static("middle" in held):
                    cells = cells_of(kind, p.root_aspect)
                    h[middle_row, m] = middle_of(mx, my, mxy, cells, p.aspect)
                if wp.static(effects.stretching):
                    pull = across(x, i + u_at, LEFT, RIGHT, kind, 1) - real(2.0) * here
                    pull_y = across(x, i + u_at, BOTTOM, TOP, kind, nx) - real(2.0) * here
                    pull = fused(p.aspect * p.stretch_ratio, pull_y, pull)
                    if wp.static("pull" in held):
                        h[pull_row, m] = pull
                    else:
                        x[i + pull_at] = pull
                    stretched -= weight_of(h, planes, m, i) * here * pull
            if wp.static(effects.stretching):
                stretched = sum_of_warp(stretched, lane)
                if lane == 0:
                    x[wp.static(slots + 2 * hanging * warps) + warp] = stretched
            if wp.static(effects.oscillators):
                for o in range(hanging):
                    under = real(0.0)
                    speed = real(0.0)
                    for m in range(mine):
                        i = thread + m * threads
                        hold = holds[o, i]
                        if hold != real(0.0):
                            under += hold * x[i + u_at]
                            if wp.static("rate" in held):
                                speed += hold * h[rate_row, m]
                            else:
                                speed += hold * own_rate[state_at(i)]
                    under = sum_of_warp(under, lane)
                    speed = sum_of_warp(speed, lane)
                    if lane == 0:
                        x[slots + 2 * o * warps + warp] = under
                        x[wp.static(slots + warps) + 2 * o * warps + warp] = speed
            barrier()
            if wp.static(sums):
                # A thread for each oscillator, and one for the stretching.
                for which in range(thread, wp.static(hanging + int(effects.stretching)), threads):
                    finish_sum(p, x, units, hung, k, which)
                barrier()

            summed = n >= window[0] and n < window[1]
            tension = x[wp.static(results + hanging)]
            own = anew(thread)
            word = int(0)
            for m in range(mine):
                i = own + m * threads
                if m % WORD == 0:
                    word = kinds[m // WORD * threads + own]
                kind = word >> (BITS * (m % WORD))
                cells = cells_of(kind, p.root_aspect)
                bending = real(0.0)
                if wp.static("middle" in held):
                    bending = h[middle_row, m]
                else:
                    bending = middle_of(x[i + mx_at], x[i + my_at], x[i + mxy_at], cells, p.aspect)
                bending += across(x, i + mx_at, LEFT, RIGHT, kind, 1)
                bending += p.aspect * across(x, i + my_at, BOTTOM, TOP, kind, nx)
                bending += cells * ((x[i + mxy_at - nx - 1] - x[i + mxy_at - 1]) - x[i + mxy_at - nx])

                here = here_of(h, x, m, i)
                before = real(0.0)
                if wp.static("rate" in held):  # noqa: SIM108, one of the two is compiled
                    before = h[rate_row, m]
                else:
                    before = own_rate[state_at(i)]
                load = real(0.0)
                if (kind & LOADED) != 0:
                    for t in range(wp.static(effects.terms)):
                        load += wave[k, n, t] * part_of(loads.ptr + offset + wp.uint64(t) * term, state_at(i))
                mobility = mobility_of(h, planes, m, i)
                spring = real(0.0)
                pull = real(0.0)
                if wp.static(effects.foundation):
                    spring = spring_of(h, planes, m, i)
                if wp.static(effects.stretching):
                    pull = pull_of(h, x, m, i)
                load = other_forces(load, mobility, spring, here, tension, pull)
                if wp.static(effects.oscillators or effects.moving_load):
                    pressed = real(0.0)
                    if wp.static(effects.moving_load):
                        line = i // nx
                        if line < wp.static(ny):
                            column = i - line * nx
                            size_now = moving[k] * p.strength[n]
                            pressed = moving_load(size_now, p.along_y[n, line], p.along_x[n, column])
                    if wp.static(effects.oscillators):
                        for o in range(hanging):
                            pressed += holds[o, i] * x[results + o]
                    load += press_of(h, planes, m, i) * pressed
                parameters = Parameters()
                if wp.static(effects.damping):
                    parameters.decay = decay_of(h, planes, m, i)
                new = update(before, bending, load, mobility, parameters)
                if wp.static("u" in held):
                    h[u_row, m] = here + new
                x[i + u_at] = here + new
                if wp.static(effects.material_damping):
                    x[i + bent_at] = (here + new) + p.retardation * new
                if wp.static("rate" in held):
                    h[rate_row, m] = new
                elif i < count:
                    own_rate[state_at(i)] = new
                if summed:
                    if wp.static("squares" in held):
                        h[squares_row, m] = h[squares_row, m] + new * new
                    elif i < count:
                        own_squares[state_at(i)] = own_squares[state_at(i)] + new * new
            barrier()
            for traced in range(thread, nodes.shape[0], threads):
                trace[k, traced, n] = x[u_at + nodes[traced, 0] * nx + nodes[traced, 1]]

        for m in range(mine):
            i = thread + m * threads
            if i < count:
                at = state_at(i)
                own_u[at] = x[i + u_at]
                if wp.static("rate" in held):
                    own_rate[at] = h[rate_row, m]
                if wp.static("squares" in held):
                    own_squares[at] = h[squares_row, m]

    return run
