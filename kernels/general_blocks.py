"""The general plate on CUDA: all steps in one launch, a block a plate, over flat ranges of nodes.

The same equations as ``general``, which see. Node i of the plate, row after row, belongs to thread i modulo the
threads. Planes that neighbours read (u, mx, my, mxy) lie in the block's shared memory where they fit, else in memory;
what a node alone reads and writes (rate, its sum of rate², its rigidities) is held in the thread's registers, as much
of it as they take. A node on an edge puts one neighbour in the other's place by a selection, which costs less than to
read a factor. Threads with no node left have one of zeros beyond the plate, so that no pass asks.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from warp_plate.kernels.cuda import LANES, anew, barrier, make_from_lane, shared_memory
from warp_plate.kernels.general import make_hang, make_moment, make_other_forces, make_structs
from warp_plate.kernels.load import make_moving_load
from warp_plate.kernels.update import make_parameters, make_update

# What a node alone reads of what all plates share, in this order; press: mobility / weight.
SHARED = ("mobility", "bend_xx", "bend_xy", "bend_yy", "twist", "decay", "spring", "weight", "press")
# What pays most in registers first: numbers that change, then what both passes read. ``middle`` is a node's own share
# in the force on it.
FIRST = ("rate", "squares", "middle", "u")
# Bits of a node's kind, and how many kinds fit in a word of 32 bits.
LEFT, RIGHT, BOTTOM, TOP, LOADED, BITS, A_WORD = 1, 2, 4, 8, 16, 5, 6
# Of one multiprocessor of sm_90: registers, the most a thread can hold, and bytes of shared memory a block can take.
REGISTERS, THREAD_REGISTERS, SHARED_BYTES = 65536, 255, 224 * 1024
# Registers for addresses, neighbours and the like; and the most nodes a thread that are written out one by one.
OVERHEAD, MOST_NODES = 30, 16


@dataclass(frozen=True)
class Blocks:
    """How a plate is shared: threads a block, nodes a thread, names of the planes held in registers, and of those in
    the block's own room; on_chip: whether that is shared memory; registers: at most so many a thread."""

    threads: int
    nodes: int
    held: tuple[str, ...]
    planes: tuple[str, ...]
    on_chip: bool
    registers: int


def room_of(nx, hanging, blocks):
    """Numbers in a block's room: planes with a margin around each, then the sums of its warps, what they make, and
    the nodes' kinds."""
    margin, sums, words = nx + 1, 2 * hanging + 1, -(-blocks.nodes // A_WORD)
    planes = len(blocks.planes) * (blocks.threads * blocks.nodes + margin) + margin
    return planes + sums * (-(-blocks.threads // LANES) + 1) + words * blocks.threads


def used(effects):
    """Names of the shared planes that the effects read at every step."""
    asked = {
        "decay": effects.damping,
        "spring": effects.foundation,
        "weight": effects.stretching,
        "press": effects.oscillators or effects.moving_load,
    }
    return tuple(name for name in SHARED if asked.get(name, True))


def share(nx, ny, real, effects, hanging, threads, blocks):
    """How ``threads`` threads share a plate, of which so many ``blocks`` shall run on a multiprocessor."""
    words = 1 if real is wp.float32 else 2
    nodes = -(-nx * ny // threads)
    registers = min(THREAD_REGISTERS, REGISTERS // (threads * blocks) // 8 * 8)
    wanted = [*FIRST, *(["pull"] if effects.stretching else []), *used(effects)]
    most = max(0, registers - OVERHEAD) // (words * nodes) if nodes <= MOST_NODES else 0
    held = tuple(wanted[:most])
    planes = ["u", "mx", "my", "mxy"]
    planes += ["strained"] if effects.material_damping else []
    planes += ["pull"] if effects.stretching and "pull" not in held else []
    made = Blocks(threads, nodes, held, tuple(planes), True, registers)
    if 4 * words * room_of(nx, hanging, made) <= SHARED_BYTES:
        return made
    return Blocks(threads, nodes, held, tuple(planes), False, registers)


def plan(nx, ny, real, effects, hanging, few):
    """How to share a plate among threads; few: there are fewer plates than multiprocessors.

    Few plates: what counts is how soon a plate has made a step, so that all threads which a block can have take part.
    Many: what counts is that while one block waits at a barrier another works, and that much is held in registers.
    """
    warps = -(-nx * ny // LANES)
    if few:
        threads, blocks = LANES * min(32, warps), 1
    else:
        nodes = 3 if warps <= 3 * 12 else 6
        threads = LANES * min(32, -(-warps // nodes))
        blocks = max(1, 1024 // threads)
    return share(nx, ny, real, effects, hanging, threads, blocks)


@cache
def make_run(effects, real, nx, ny, stride, hanging, blocks):
    """Steps ``start`` ... ``stop`` − 1; launch over (plates × threads,) with blocks of ``blocks.threads`` threads.

    shared_planes: (planes that are ``used``, threads × nodes), holds: (hanging, threads × nodes) shares of the
    oscillators' patches, both with zeros beyond the plate; room: (plates, room_of(...)) where it is not shared memory;
    loads: (terms, plates, rows, stride); u, rate, squares: (plates, rows, stride); hung: (plates, hanging, 2); nodes:
    (traced nodes, 2), row of the plate and column; trace: (plates, traced nodes, steps).
    """
    update, other_forces = make_update(effects, real), make_other_forces(effects, real)
    moment, hang, moving_load = make_moment(effects, real), make_hang(real), make_moving_load(real)
    from_lane, Material, Parameters = make_from_lane(real), make_structs(real)[0], make_parameters(real)
    size = wp.types.type_size_in_bytes(real)
    threads, mine, held = blocks.threads, blocks.nodes, blocks.held
    count, padded, warps = nx * ny, threads * mine, -(-threads // LANES)
    margin = nx + 1
    room_size = room_of(nx, hanging, blocks)
    place = {name: margin + index * (padded + margin) for index, name in enumerate(blocks.planes)}
    slots = margin + len(blocks.planes) * (padded + margin)
    results = slots + (2 * hanging + 1) * warps
    kinds_at = results + 2 * hanging + 1
    unrolled = bool(held)
    together = threads > 1
    bent = place["strained"] if effects.material_damping else place["u"]
    row = {name: index for index, name in enumerate(held)}
    shared = used(effects)
    first_shared = min((row[name] for name in held if name in shared), default=0)
    held_shared = sum(name in shared for name in held)
    Held = wp.types.matrix(shape=(max(1, len(held)), mine if held else 1), dtype=real)
    words = -(-mine // A_WORD)
    Waves = wp.types.vector(length=effects.terms, dtype=real)

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

    mobility_of, bend_xx_of, bend_xy_of, bend_yy_of, twist_of = map(make_own, SHARED[:5])
    decay_of, spring_of, weight_of, press_of = map(make_own, SHARED[5:])

    @wp.func
    def sum_of_warp(value: real, lane: int):
        total = value
        if wp.static(together):
            for power in range(5):
                total += from_lane(total, lane ^ (1 << power))
        return total

    @wp.func
    def state_at(i: int):
        """Where the state has a node; one beyond the plate stands for the last."""
        node = wp.min(i, wp.static(count - 1))
        return node + node // wp.static(nx) * wp.static(stride - nx)

    @wp.func
    def edges_of(i: int):
        """LEFT ... TOP of a node."""
        line = i // wp.static(nx)
        column = i - line * wp.static(nx)
        edges = int(0)
        if column == 0:
            edges = edges | LEFT
        if column == wp.static(nx - 1):
            edges = edges | RIGHT
        if line == 0:
            edges = edges | BOTTOM
        if line == wp.static(ny - 1):
            edges = edges | TOP
        return edges

    @wp.func
    def across(x: wp.array[real], at: int, low: int, high: int, kind: int, step: int):
        """Both neighbours of a node together; beyond an edge, ``low`` or ``high`` in its kind, is a mirror image."""
        before = x[at - step]
        after = x[at + step]
        mirrored = after
        if (kind & high) != 0:
            mirrored = before
        if (kind & low) != 0:
            before = after
        return before + mirrored

    @wp.func
    def middle_of(mx: real, my: real, twisting: real, aspect: real):
        """Share in the force on a node of its own moments and of the cell to its upper right."""
        return twisting - real(2.0) * mx - real(2.0) * aspect * my

    @wp.func
    def cells_of(kind: int, root_aspect: real):
        """Factor of the twists around a node: beyond an edge they are mirror images."""
        cells = root_aspect
        if (kind & (LEFT | RIGHT)) != 0:
            cells = real(2.0) * cells
        if (kind & (BOTTOM | TOP)) != 0:
            cells = real(2.0) * cells
        return cells

    @wp.kernel(
        module="unique",
        enable_backward=False,
        grid_stride=False,
        cuda_max_registers=blocks.registers,
        module_options={"max_unroll": max(5, mine if unrolled else 1)},
    )
    def run(
        p: Material,
        shared_planes: wp.array2d[real],
        holds: wp.array2d[real],
        window: wp.vec2i,
        start: int,
        stop: int,
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
        k = wp.tid() // wp.static(threads)
        thread = wp.tid() % wp.static(threads)
        lane = thread % LANES
        warp = thread // LANES
        if wp.static(blocks.on_chip):
            reserved = wp.tile_empty(shape=(wp.static(room_size),), dtype=real, storage="shared")
            own_room = shared_memory()
        else:
            own_room = room.ptr + wp.uint64(k) * wp.uint64(wp.static(room_size * size))
        x = wp.array(ptr=own_room, shape=(wp.static(room_size),), dtype=real)
        # In memory, though registers would do: else what follows from them is carried from pass to pass, in more.
        kinds = wp.array(
            ptr=own_room + wp.uint64(wp.static(kinds_at * size)), shape=(wp.static(words * threads),), dtype=int
        )
        planes = wp.array(ptr=shared_planes.ptr, shape=(wp.static(len(shared) * padded),), dtype=real)
        offset = (wp.uint64(k) * wp.uint64(wp.static(ny + 2)) + wp.uint64(1)) * wp.uint64(wp.static(stride * size))
        own_u = wp.array(ptr=u.ptr + offset, shape=(wp.static(ny * stride),), dtype=real)
        own_rate = wp.array(ptr=rate.ptr + offset, shape=(wp.static(ny * stride),), dtype=real)
        own_squares = wp.array(ptr=squares.ptr + offset, shape=(wp.static(ny * stride),), dtype=real)
        term = wp.uint64(loads.shape[1]) * wp.uint64(wp.static((ny + 2) * stride * size))

        # Numbers left from before would spread as NaN through factors of zero.
        for i in range(thread, wp.static(room_size), wp.static(threads)):
            x[i] = real(0.0)
        barrier()
        h = Held()
        for m in range(wp.static(mine)):
            i = thread + m * wp.static(threads)
            for q in range(wp.static(held_shared)):
                h[wp.static(first_shared) + q, m] = planes[i + q * wp.static(padded)]
            if i < wp.static(count):
                at = state_at(i)
                here = own_u[at]
                x[i + wp.static(place["u"])] = here
                if wp.static("u" in held):
                    h[wp.static(row.get("u", 0)), m] = here
                if wp.static("rate" in held):
                    h[wp.static(row.get("rate", 0)), m] = own_rate[at]
                if wp.static("squares" in held):
                    h[wp.static(row.get("squares", 0)), m] = own_squares[at]
                if wp.static(effects.material_damping):
                    x[i + wp.static(bent)] = here + p.retardation * own_rate[at]
                kind = edges_of(i)
                for t in range(wp.static(effects.terms)):
                    load_at = loads.ptr + offset + wp.uint64(t) * term
                    if wp.array(ptr=load_at, shape=(wp.static(ny * stride),), dtype=real)[at] != real(0.0):
                        kind = kind | LOADED
                kinds_of = m // A_WORD * wp.static(threads) + thread
                kinds[kinds_of] = kinds[kinds_of] | (kind << (BITS * (m % A_WORD)))
        barrier()

        for n in range(start, stop):
            own = anew(thread)
            word = int(0)
            stretched = real(0.0)
            waves = Waves()
            for at_term in range(wp.static(effects.terms)):
                waves[at_term] = p.wave[n, at_term]
            for m in range(wp.static(mine)):
                i = own + m * wp.static(threads)
                if m % A_WORD == 0:
                    word = kinds[m // A_WORD * wp.static(threads) + own]
                kind = word >> (BITS * (m % A_WORD))
                at = i + wp.static(bent)
                c = x[at]
                e = x[at + 1]
                up = x[at + wp.static(nx)]
                here = c
                if wp.static("u" in held):
                    here = h[wp.static(row.get("u", 0)), m]
                    if wp.static(not effects.material_damping):
                        c = here
                elif wp.static(effects.material_damping):
                    here = x[i + wp.static(place["u"])]
                curved_x = across(x, at, LEFT, RIGHT, kind, 1) - real(2.0) * c
                curved_y = across(x, at, BOTTOM, TOP, kind, wp.static(nx)) - real(2.0) * c
                curved_y = p.aspect * curved_y
                bend_xy = bend_xy_of(h, planes, m, i)
                mx = moment(bend_xx_of(h, planes, m, i), curved_x, bend_xy, curved_y, p.tension_x, here)
                my = moment(bend_yy_of(h, planes, m, i), curved_y, bend_xy, curved_x, p.tension_y, here)
                mxy = twist_of(h, planes, m, i) * (p.root_aspect * ((x[at + wp.static(nx + 1)] - e) - (up - c)))
                x[i + wp.static(place["mx"])] = mx
                x[i + wp.static(place["my"])] = my
                x[i + wp.static(place["mxy"])] = mxy
                if wp.static("middle" in held):
                    h[wp.static(row.get("middle", 0)), m] = middle_of(mx, my, cells_of(kind, p.root_aspect) * mxy, p.aspect)
                if wp.static(effects.stretching):
                    pull = curved_x + curved_y
                    if wp.static(effects.material_damping):
                        at_u = i + wp.static(place["u"])
                        pull = across(x, at_u, LEFT, RIGHT, kind, 1) - real(2.0) * here
                        pull_y = across(x, at_u, BOTTOM, TOP, kind, wp.static(nx))
                        pull += p.aspect * (pull_y - real(2.0) * here)
                    if wp.static("pull" in held):
                        h[wp.static(row.get("pull", 0)), m] = pull
                    else:
                        x[i + wp.static(place.get("pull", 0))] = pull
                    stretched -= weight_of(h, planes, m, i) * here * pull
            if wp.static(effects.stretching):
                stretched = sum_of_warp(stretched, lane)
                if lane == 0:
                    x[wp.static(slots + 2 * hanging * warps) + warp] = stretched
            if wp.static(effects.oscillators):
                for o in range(wp.static(hanging)):
                    under = real(0.0)
                    speed = real(0.0)
                    for m in range(wp.static(mine)):
                        i = thread + m * wp.static(threads)
                        hold = holds[o, i]
                        if hold != real(0.0):
                            under += hold * x[i + wp.static(place["u"])]
                            if wp.static("rate" in held):
                                speed += hold * h[wp.static(row.get("rate", 0)), m]
                            else:
                                speed += hold * own_rate[state_at(i)]
                    under = sum_of_warp(under, lane)
                    speed = sum_of_warp(speed, lane)
                    if lane == 0:
                        x[wp.static(slots) + 2 * o * wp.static(warps) + warp] = under
                        x[wp.static(slots + warps) + 2 * o * wp.static(warps) + warp] = speed
            barrier()
            if wp.static(effects.stretching or effects.oscillators):
                # A thread for each oscillator, and one for the stretching.
                for which in range(thread, wp.static(hanging + int(effects.stretching)), wp.static(threads)):
                    under = real(0.0)
                    speed = real(0.0)
                    for w in range(wp.static(warps)):
                        under += x[wp.static(slots) + 2 * which * wp.static(warps) + w]
                        if which < wp.static(hanging):
                            speed += x[wp.static(slots + warps) + 2 * which * wp.static(warps) + w]
                    if which < wp.static(hanging):
                        push, hung_place, pace = hang(
                            hung[k, which, 0], hung[k, which, 1], under, speed, p.oscillators, which
                        )
                        hung[k, which, 0] = hung_place
                        hung[k, which, 1] = pace
                        x[wp.static(results) + which] = push
                    elif wp.static(effects.stretching):
                        x[wp.static(results) + which] = p.stretching * units[k] * units[k] * under
                barrier()

            summed = n >= window[0] and n < window[1]
            tension = x[wp.static(results + hanging)]
            own = anew(thread)
            word = int(0)
            for m in range(wp.static(mine)):
                i = own + m * wp.static(threads)
                if m % A_WORD == 0:
                    word = kinds[m // A_WORD * wp.static(threads) + own]
                kind = word >> (BITS * (m % A_WORD))
                at_mx = i + wp.static(place["mx"])
                at_my = i + wp.static(place["my"])
                at_mxy = i + wp.static(place["mxy"])
                cells = cells_of(kind, p.root_aspect)
                bending = real(0.0)
                if wp.static("middle" in held):
                    bending = h[wp.static(row.get("middle", 0)), m]
                else:
                    bending = middle_of(x[at_mx], x[at_my], cells * x[at_mxy], p.aspect)
                bending += across(x, at_mx, LEFT, RIGHT, kind, 1)
                bending += p.aspect * across(x, at_my, BOTTOM, TOP, kind, wp.static(nx))
                bending += cells * ((x[at_mxy - wp.static(nx + 1)] - x[at_mxy - 1]) - x[at_mxy - wp.static(nx)])

                here = real(0.0)
                before = real(0.0)
                if wp.static("u" in held):
                    here = h[wp.static(row.get("u", 0)), m]
                else:
                    here = x[i + wp.static(place["u"])]
                if wp.static("rate" in held):
                    before = h[wp.static(row.get("rate", 0)), m]
                else:
                    before = own_rate[state_at(i)]
                load = real(0.0)
                if (kind & LOADED) != 0:
                    for t in range(wp.static(effects.terms)):
                        load_at = loads.ptr + offset + wp.uint64(t) * term
                        field = wp.array(ptr=load_at, shape=(wp.static(ny * stride),), dtype=real)
                        load += waves[t] * field[state_at(i)]
                mobility = mobility_of(h, planes, m, i)
                spring = real(0.0)
                pull = real(0.0)
                if wp.static(effects.foundation):
                    spring = spring_of(h, planes, m, i)
                if wp.static(effects.stretching):
                    if wp.static("pull" in held):
                        pull = h[wp.static(row.get("pull", 0)), m]
                    else:
                        pull = x[i + wp.static(place.get("pull", 0))]
                load = other_forces(load, mobility, spring, here, tension, pull)
                if wp.static(effects.oscillators or effects.moving_load):
                    pressed = real(0.0)
                    if wp.static(effects.moving_load):
                        line = i // wp.static(nx)
                        if line < wp.static(ny):
                            column = i - line * wp.static(nx)
                            size_now = moving[k] * p.strength[n]
                            pressed = moving_load(size_now, p.along_y[n, line], p.along_x[n, column])
                    if wp.static(effects.oscillators):
                        for o in range(wp.static(hanging)):
                            pressed += holds[o, i] * x[wp.static(results) + o]
                    load += press_of(h, planes, m, i) * pressed
                parameters = Parameters()
                if wp.static(effects.damping):
                    parameters.decay = decay_of(h, planes, m, i)
                new = update(before, bending, load, mobility, parameters)
                if wp.static("u" in held):
                    h[wp.static(row.get("u", 0)), m] = here + new
                x[i + wp.static(place["u"])] = here + new
                if wp.static(effects.material_damping):
                    x[i + wp.static(bent)] = (here + new) + p.retardation * new
                if wp.static("rate" in held):
                    h[wp.static(row.get("rate", 0)), m] = new
                elif i < wp.static(count):
                    own_rate[state_at(i)] = new
                if summed:
                    if wp.static("squares" in held):
                        h[wp.static(row.get("squares", 0)), m] = h[wp.static(row.get("squares", 0)), m] + new * new
                    elif i < wp.static(count):
                        own_squares[state_at(i)] = own_squares[state_at(i)] + new * new
            barrier()
            for traced in range(thread, nodes.shape[0], wp.static(threads)):
                trace[k, traced, n] = x[wp.static(place["u"]) + nodes[traced, 0] * wp.static(nx) + nodes[traced, 1]]

        for m in range(wp.static(mine)):
            i = thread + m * wp.static(threads)
            if i < wp.static(count):
                at = state_at(i)
                own_u[at] = x[i + wp.static(place["u"])]
                if wp.static("rate" in held):
                    own_rate[at] = h[wp.static(row.get("rate", 0)), m]
                if wp.static("squares" in held):
                    own_squares[at] = h[wp.static(row.get("squares", 0)), m]

    return run
