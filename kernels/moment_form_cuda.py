"""Moment form, resident path on CUDA: all steps in one launch, a block per plate, over flat ranges of nodes.

The equations of ``update``. Node i of the plate, counted row after row, belongs to thread i modulo the threads.
Planes that neighbours read (u, mx, my, mxy) are in the block's shared memory where they fit, else in device memory;
what a node alone reads and writes (rate, its sum of rate², its rigidities) is in the thread's registers, as far as they
reach. A node on an edge selects its inner neighbour twice, which costs less than reading a factor. Threads with no node
left have one of zeros beyond the plate, so that no pass needs a bounds check.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.coils import make_coil_force
from warp_plate.kernels.cuda import LANES, barrier, cuda_kernel, make_from_lane, opaque, shared_memory
from warp_plate.kernels.edges import BOTTOM, FLAG_BITS, LEFT, LOADED, RIGHT, TOP, make_edges
from warp_plate.kernels.plans import MATERIAL_PLANES, NODES_PER_WORD, material_planes, workspace_layout
from warp_plate.kernels.update import (
    make_add_local_forces,
    make_attached_force,
    make_material,
    make_membrane_tension,
    make_moment,
    make_parameters,
    make_state,
    make_travelling_pressure,
    make_update,
)  # fmt: skip


@cache
def make_run_steps(effects, real, nx, ny, stride, attached, block, coils=0):
    """Make the kernel that runs steps ``start`` … ``stop`` − 1; launch over (plates × threads,) in blocks."""
    update, add_local_forces = make_update(effects, real), make_add_local_forces(effects, real)
    moment, attached_force = make_moment(effects, real), make_attached_force(real)
    membrane_tension, travelling_pressure = make_membrane_tension(real), make_travelling_pressure(real)
    from_lane, Parameters, coil_force = make_from_lane(real), make_parameters(real), make_coil_force(effects, real)
    Material, (Forcing, Fields) = make_material(real), make_state(real)
    edge_flags, sum_of_neighbours, twist_factor = make_edges(real, nx, ny)
    fused, size = make_fused(real), wp.types.type_size_in_bytes(real)
    threads, nodes_per_thread, held, shared = block.threads, block.nodes, block.in_registers, material_planes(effects)
    count, padded, warps = nx * ny, threads * nodes_per_thread, -(-threads // LANES)
    state_size, words = ny * stride, -(-nodes_per_thread // NODES_PER_WORD)
    offsets = workspace_layout(nx, attached + coils, block)
    u_at, mx_at, my_at, mxy_at = (offsets[name] for name in ("u", "mx", "my", "mxy"))
    retarded_at, curvature_at = offsets.get("retarded_u", u_at), offsets.get("membrane_curvature", 0)
    partial_sums, totals, workspace_size = offsets["partial_sums"], offsets["totals"], offsets["end"]
    row = {name: index for index, name in enumerate(held)}
    u_row, rate_row, squares_row, centre_force_row, curvature_row = (
        row.get(name, 0) for name in ("u", "rate", "squares", "centre_force", "membrane_curvature")
    )
    first_shared = min((row[name] for name in held if name in shared), default=0)
    held_shared = sum(name in shared for name in held)
    Held = wp.types.matrix(shape=(max(1, len(held)), nodes_per_thread if held else 1), dtype=real)

    def make_read(name, first):
        """Make a function that reads a plane at node i, from registers if held there, else from values[first + i]."""

        @wp.func
        def read_register(h: Held, values: wp.array[real], m: int, i: int):
            return h[wp.static(row.get(name, 0)), m]

        @wp.func
        def read_memory(h: Held, values: wp.array[real], m: int, i: int):
            return values[i + first]

        return read_register if name in held else read_memory

    def make_read_material(name):
        return make_read(name, shared.index(name) * padded if name in shared else 0)

    read_u, read_curvature = make_read("u", u_at), make_read("membrane_curvature", curvature_at)
    (
        read_inverse_mass, read_bend_xx, read_bend_xy, read_bend_yy, read_twist, read_decay, read_spring, read_weight,
        read_pressure_gain, read_centre_x, read_centre_y,
    ) = map(make_read_material, MATERIAL_PLANES)  # fmt: skip

    @wp.func
    def own_factors(h: Held, planes: wp.array[real], m: int, i: int):
        """Return the factors of the node itself in its curvatures along x and y."""
        if wp.static(effects.outline):
            return read_centre_x(h, planes, m, i), read_centre_y(h, planes, m, i)
        else:
            return real(2.0), real(2.0)

    @wp.func
    def sum_of_warp(value: real, lane: int):
        total = value
        if wp.static(threads > 1):
            for power in range(5):
                total += from_lane(total, lane ^ (1 << power))
        return total

    @wp.func
    def state_index(i: int):
        """Return the index of a node in the plate's part of the state; nodes beyond the plate stand for the last."""
        node = wp.min(i, wp.static(count - 1))
        return node + node // nx * wp.static(stride - nx)

    @wp.func
    def state_array(address: wp.uint64):
        return wp.array(ptr=address, shape=(state_size,), dtype=real)

    @wp.func
    def read_rate(h: Held, rates: wp.array[real], m: int, i: int):
        if wp.static("rate" in held):
            return h[rate_row, m]
        else:
            return rates[state_index(i)]

    @wp.func
    def load_value(address: wp.uint64, at: int):
        return state_array(address)[at]

    @wp.func
    def centre_force(mx: real, my: real, mxy: real, factor: real, own_x: real, own_y: real, aspect: real):
        """Return the share of the force on a node by its own moments and the cell to its upper right."""
        return fused(factor, mxy, -own_x * mx) - own_y * aspect * my

    @wp.func
    def finish_sum(d: Forcing, f: Fields, p: Material, x: wp.array[real], k: int, which: int):
        """Compute the force of an attached mass, and move it, or the membrane's tension, from the sums of the warps."""
        first = partial_sums + 2 * which * warps
        total = real(0.0)
        for w in range(warps):
            total += x[first + w]
        if which < attached:
            total_rate = real(0.0)
            for w in range(warps):
                total_rate += x[first + warps + w]
            x[totals + which] = attached_force(f, p, k, which, total, total_rate)
        else:
            x[totals + which] = membrane_tension(d, p, k, total)

    @wp.func
    def finish_coil(d: Forcing, f: Fields, p: Material, x: wp.array[real], k: int, c: int, n: int):
        """Compute the force of a coil from the sums of the warps, and move its magnet."""
        first = wp.static(partial_sums + (2 * attached + 1) * warps) + 2 * c * warps
        patch_u = real(0.0)
        patch_rate = real(0.0)
        for w in range(warps):
            patch_u += x[first + w]
            patch_rate += x[first + warps + w]
        x[wp.static(totals + attached + 1) + c] = coil_force(d, f, p, k, c, n, patch_u, patch_rate)

    @cuda_kernel(block.registers, max_unroll=max(5, nodes_per_thread if held else 1))
    def run_steps(
        # parameters
        p: Material,
        shared_planes: wp.array2d[real],  # (material planes, threads × nodes), zero beyond the plate
        patches: wp.array2d[real],  # (attached masses, coils; threads × nodes) shares of nodes, zero beyond the plate
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        start: int,
        stop: int,
        # inputs
        d: Forcing,
        wave: wp.array3d[real],  # d.wave, d.loads, f.nodes: fields of structs are fetched anew wherever they are used
        loads: wp.array4d[real],
        nodes: wp.array2d[int],
        # outputs
        f: Fields,
        trace: wp.array3d[real],  # f.trace
        workspace: wp.array2d[real],  # (plates, size by ``workspace_layout``) where it is not shared memory
    ):
        k = wp.tid() // threads
        thread = wp.tid() % threads
        lane = thread % LANES
        warp = thread // LANES
        if wp.static(block.on_chip):
            reserved = wp.tile_empty(shape=(workspace_size,), dtype=real, storage="shared")
            x_address = shared_memory()
        else:
            x_address = workspace.ptr + wp.uint64(k) * wp.uint64(wp.static(workspace_size * size))
        x = wp.array(ptr=x_address, shape=(workspace_size,), dtype=real)
        # In memory even where registers would do: values derived from them would be carried from pass to pass.
        flag_words = wp.array(
            ptr=x_address + wp.uint64(wp.static(offsets["flags"] * size)),
            shape=(wp.static(words * threads),),
            dtype=int,
        )
        planes = wp.array(ptr=shared_planes.ptr, shape=(wp.static(len(shared) * padded),), dtype=real)
        plane = (wp.uint64(k) * wp.uint64(wp.static(ny + 2)) + wp.uint64(1)) * wp.uint64(wp.static(stride * size))
        plate_u = state_array(f.u.ptr + plane)
        plate_rate = state_array(f.rate.ptr + plane)
        plate_squares = state_array(f.squares.ptr + plane)
        term = wp.uint64(loads.shape[1]) * wp.uint64(wp.static((ny + 2) * stride * size))

        # Clear what was left in memory: it may be NaN, which a factor of zero does not remove.
        for i in range(thread, workspace_size, threads):
            x[i] = real(0.0)
        barrier()
        h = Held()
        for m in range(nodes_per_thread):
            i = thread + m * threads
            for q in range(held_shared):
                h[first_shared + q, m] = planes[i + q * padded]
            if i < count:
                at = state_index(i)
                here = plate_u[at]
                x[i + u_at] = here
                if wp.static("u" in held):
                    h[u_row, m] = here
                if wp.static("rate" in held):
                    h[rate_row, m] = plate_rate[at]
                if wp.static("squares" in held):
                    h[squares_row, m] = plate_squares[at]
                if wp.static(effects.retarded):
                    x[i + retarded_at] = here + p.retardation * plate_rate[at]
                flags = edge_flags(i)
                for t in range(wp.static(effects.terms)):
                    if load_value(loads.ptr + plane + wp.uint64(t) * term, at) != real(0.0):
                        flags = flags | LOADED
                word_at = m // NODES_PER_WORD * threads + thread
                flag_words[word_at] = flag_words[word_at] | (flags << (FLAG_BITS * (m % NODES_PER_WORD)))
        barrier()

        for n in range(start, stop):
            first = opaque(thread)
            word = int(0)
            stretched = real(0.0)
            for m in range(nodes_per_thread):
                i = first + m * threads
                if m % NODES_PER_WORD == 0:
                    word = flag_words[m // NODES_PER_WORD * threads + first]
                flags = word >> (FLAG_BITS * (m % NODES_PER_WORD))
                at = i + retarded_at
                here = read_u(h, x, m, i)
                c = here
                if wp.static(effects.retarded):
                    c = x[at]
                e = x[at + 1]
                up = x[at + nx]
                own_x, own_y = own_factors(h, planes, m, i)
                along_x = sum_of_neighbours(x, at, LEFT, RIGHT, flags, 1) - own_x * c
                along_y = p.aspect * (sum_of_neighbours(x, at, BOTTOM, TOP, flags, nx) - own_y * c)
                bend_xy = read_bend_xy(h, planes, m, i)
                mx = moment(read_bend_xx(h, planes, m, i), along_x, bend_xy, along_y, p.in_plane_x, here)
                my = moment(read_bend_yy(h, planes, m, i), along_y, bend_xy, along_x, p.in_plane_y, here)
                mxy = read_twist(h, planes, m, i) * (p.root_aspect * ((x[at + wp.static(nx + 1)] - e) - (up - c)))
                x[i + mx_at] = mx
                x[i + my_at] = my
                x[i + mxy_at] = mxy
                if wp.static("centre_force" in held):
                    factor = twist_factor(flags, p.root_aspect)
                    h[centre_force_row, m] = centre_force(mx, my, mxy, factor, own_x, own_y, p.aspect)
                if wp.static(effects.membrane):
                    u_xx = sum_of_neighbours(x, i + u_at, LEFT, RIGHT, flags, 1) - real(2.0) * here
                    u_yy = sum_of_neighbours(x, i + u_at, BOTTOM, TOP, flags, nx) - real(2.0) * here
                    curvature = fused(p.aspect * p.stretch_ratio, u_yy, u_xx)
                    if wp.static("membrane_curvature" in held):
                        h[curvature_row, m] = curvature
                    else:
                        x[i + curvature_at] = curvature
                    stretched -= read_weight(h, planes, m, i) * here * curvature
            if wp.static(effects.membrane):
                stretched = sum_of_warp(stretched, lane)
                if lane == 0:
                    x[wp.static(partial_sums + 2 * attached * warps) + warp] = stretched
            if wp.static(effects.attached):
                for o in range(attached):
                    patch_u = real(0.0)
                    patch_rate = real(0.0)
                    for m in range(nodes_per_thread):
                        i = thread + m * threads
                        share = patches[o, i]
                        if share != real(0.0):
                            patch_u += share * x[i + u_at]
                            patch_rate += share * read_rate(h, plate_rate, m, i)
                    patch_u = sum_of_warp(patch_u, lane)
                    patch_rate = sum_of_warp(patch_rate, lane)
                    if lane == 0:
                        x[partial_sums + 2 * o * warps + warp] = patch_u
                        x[wp.static(partial_sums + warps) + 2 * o * warps + warp] = patch_rate
            barrier()
            if wp.static(effects.membrane or effects.attached):
                # A thread for each attached mass, and one for the membrane.
                for which in range(thread, wp.static(attached + int(effects.membrane)), threads):
                    finish_sum(d, f, p, x, k, which)
                barrier()

            summed = n >= window[0] and n < window[1]
            tension = x[wp.static(totals + attached)]
            first = opaque(thread)
            word = int(0)
            for m in range(nodes_per_thread):
                i = first + m * threads
                if m % NODES_PER_WORD == 0:
                    word = flag_words[m // NODES_PER_WORD * threads + first]
                flags = word >> (FLAG_BITS * (m % NODES_PER_WORD))
                factor = twist_factor(flags, p.root_aspect)
                bending = real(0.0)
                if wp.static("centre_force" in held):
                    bending = h[centre_force_row, m]
                else:
                    own_x, own_y = own_factors(h, planes, m, i)
                    bending = centre_force(x[i + mx_at], x[i + my_at], x[i + mxy_at], factor, own_x, own_y, p.aspect)
                bending += sum_of_neighbours(x, i + mx_at, LEFT, RIGHT, flags, 1)
                bending += p.aspect * sum_of_neighbours(x, i + my_at, BOTTOM, TOP, flags, nx)
                bending += factor * ((x[i + mxy_at - nx - 1] - x[i + mxy_at - 1]) - x[i + mxy_at - nx])

                here = read_u(h, x, m, i)
                before = read_rate(h, plate_rate, m, i)
                load = real(0.0)
                if (flags & LOADED) != 0:
                    for t in range(wp.static(effects.terms)):
                        load += wave[k, n, t] * load_value(loads.ptr + plane + wp.uint64(t) * term, state_index(i))
                inverse_mass = read_inverse_mass(h, planes, m, i)
                spring = real(0.0)
                curvature = real(0.0)
                if wp.static(effects.springs):
                    spring = read_spring(h, planes, m, i)
                if wp.static(effects.membrane):
                    curvature = read_curvature(h, x, m, i)
                load = add_local_forces(load, inverse_mass, spring, here, tension, curvature)
                if wp.static(effects.attached or effects.travelling):
                    pressure = real(0.0)
                    if wp.static(effects.travelling):
                        line = i // nx
                        if line < wp.static(ny):
                            column = i - line * nx
                            pressure = travelling_pressure(d, p, k, n, line, column)
                    if wp.static(effects.attached):
                        for o in range(attached):
                            pressure += patches[o, i] * x[totals + o]
                    load += read_pressure_gain(h, planes, m, i) * pressure
                parameters = Parameters()
                if wp.static(effects.damping):
                    parameters.decay = read_decay(h, planes, m, i)
                new = update(before, bending, load, inverse_mass, parameters)
                if wp.static("rate" in held):
                    h[rate_row, m] = new
                elif i < count:
                    plate_rate[state_index(i)] = new
                if wp.static(not effects.coils):
                    if wp.static("u" in held):
                        h[u_row, m] = here + new
                    x[i + u_at] = here + new
                    if wp.static(effects.retarded):
                        x[i + retarded_at] = (here + new) + p.retardation * new
                    if summed:
                        if wp.static("squares" in held):
                            h[squares_row, m] = h[squares_row, m] + new * new
                        elif i < count:
                            plate_squares[state_index(i)] = plate_squares[state_index(i)] + new * new
            barrier()
            if wp.static(effects.coils):
                for c in range(coils):
                    patch_u = real(0.0)
                    patch_rate = real(0.0)
                    for m in range(nodes_per_thread):
                        i = thread + m * threads
                        patch_u += patches[attached + c, i] * x[i + u_at]
                        patch_rate += patches[attached + c, i] * read_rate(h, plate_rate, m, i)
                    patch_u = sum_of_warp(patch_u, lane)
                    patch_rate = sum_of_warp(patch_rate, lane)
                    if lane == 0:
                        x[wp.static(partial_sums + (2 * attached + 1) * warps) + 2 * c * warps + warp] = patch_u
                        x[wp.static(partial_sums + (2 * attached + 2) * warps) + 2 * c * warps + warp] = patch_rate
                barrier()
                for c in range(thread, coils, threads):
                    finish_coil(d, f, p, x, k, c, n)
                barrier()
                for m in range(nodes_per_thread):
                    i = thread + m * threads
                    pressure = real(0.0)
                    for c in range(coils):
                        pressure += patches[attached + c, i] * x[wp.static(totals + attached + 1) + c]
                    here = read_u(h, x, m, i)
                    new = read_rate(h, plate_rate, m, i) + read_pressure_gain(h, planes, m, i) * pressure
                    if wp.static("rate" in held):
                        h[rate_row, m] = new
                    elif i < count:
                        plate_rate[state_index(i)] = new
                    if wp.static("u" in held):
                        h[u_row, m] = here + new
                    x[i + u_at] = here + new
                    if wp.static(effects.retarded):
                        x[i + retarded_at] = (here + new) + p.retardation * new
                    if summed:
                        if wp.static("squares" in held):
                            h[squares_row, m] = h[squares_row, m] + new * new
                        elif i < count:
                            plate_squares[state_index(i)] = plate_squares[state_index(i)] + new * new
                barrier()
            for traced in range(thread, nodes.shape[0], threads):
                # A row of zeros lies below the plate.
                trace[k, traced, n] = x[u_at + (nodes[traced, 0] - 1) * nx + nodes[traced, 1]]

        for m in range(nodes_per_thread):
            i = thread + m * threads
            if i < count:
                at = state_index(i)
                plate_u[at] = x[i + u_at]
                if wp.static("rate" in held):
                    plate_rate[at] = h[rate_row, m]
                if wp.static("squares" in held):
                    plate_squares[at] = h[squares_row, m]

    return run_steps
