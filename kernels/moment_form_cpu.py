"""Moment form, resident path on CPU: all steps in one launch, a plate per thread, over flat ranges of memory.

The equations of ``update`` in a form that LLVM vectorises (see ``resident_cpu``). A pass walks all rows of
the plate at once, padding included. Beyond an edge the tensors hold zeros, and mirror images are factors: on an edge
the inner neighbour counts twice and the outer one not at all. So each node has four factors for its neighbours and one
for its cells, stored as planes like its rigidities.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import flush_denormals, make_fused, portable_kernel, restore_denormals
from warp_plate.kernels.coils import make_coil_force
from warp_plate.kernels.update import (
    make_add_local_forces,
    make_attached_force,
    make_material,
    make_membrane_tension,
    make_moment,
    make_parameters,
    make_state,
    make_update,
)

# Planes of a thread's workspace; retarded_u: displacement that causes stress; pressure: of attached masses and the
# load that travels; load: the sum of the terms where they are not two.
WORKSPACE_PLANES = ("mx", "my", "mxy", "membrane_curvature", "retarded_u", "pressure", "load")
# Planes shared by all plates, in the order of their array; cells: factor of the cells around a node; pressure_gain:
# inverse mass / weight.
SHARED_PLANES = (
    "west", "east", "south", "north", "cells", "bend_xx", "bend_xy", "bend_yy", "twist",
    "inverse_mass", "decay", "spring", "weight", "pressure_gain", "centre_x", "centre_y",
)  # fmt: skip


@cache
def make_run_steps(effects, real, ny, stride):
    """Make the kernel that runs steps ``start`` … ``stop`` − 1 of plates from ``first`` on; launch over (plates,)."""
    update = make_update(effects, real)
    add_local_forces = make_add_local_forces(effects, real)
    moment, attached_force = make_moment(effects, real), make_attached_force(real)
    membrane_tension, coil_force = make_membrane_tension(real), make_coil_force(effects, real)
    fused = make_fused(real)
    Material, Parameters, (Forcing, Fields) = make_material(real), make_parameters(real), make_state(real)
    size = wp.types.type_size_in_bytes(real)
    count = ny * stride
    plane_bytes = (ny + 2) * stride * size
    row_bytes = stride * size
    length = count + 2 * stride + 2
    plane = {name: index for index, name in enumerate(SHARED_PLANES)}

    @wp.func
    def array_at(address: wp.uint64):
        return wp.array(ptr=address, shape=(wp.static(length),), dtype=real)

    @wp.func
    def shared_plane(base: wp.uint64, index: int):
        return array_at(base + wp.uint64(index) * wp.uint64(wp.static(plane_bytes)) + wp.uint64(wp.static(row_bytes)))

    @wp.func
    def compute_retarded_u(u_at: wp.uint64, rate_at: wp.uint64, retarded_at: wp.uint64, retardation: real):
        u = array_at(u_at)
        rate = array_at(rate_at)
        retarded = array_at(retarded_at)
        for i in range(wp.static(count)):
            retarded[i] = u[i] + retardation * rate[i]

    @wp.func
    def compute_moments(
        s: wp.uint64, u_at: wp.uint64, retarded_at: wp.uint64, mx_at: wp.uint64, my_at: wp.uint64, mxy_at: wp.uint64,
        aspect: real, root_aspect: real, in_plane_x: real, in_plane_y: real,
    ):
        """Addresses are those of the first row; ``retarded_at`` may be that of u."""
        west = shared_plane(s, wp.static(plane["west"]))
        east = shared_plane(s, wp.static(plane["east"]))
        south = shared_plane(s, wp.static(plane["south"]))
        north = shared_plane(s, wp.static(plane["north"]))
        bend_xx = shared_plane(s, wp.static(plane["bend_xx"]))
        bend_xy = shared_plane(s, wp.static(plane["bend_xy"]))
        bend_yy = shared_plane(s, wp.static(plane["bend_yy"]))
        twist = shared_plane(s, wp.static(plane["twist"]))
        centre_x = shared_plane(s, wp.static(plane["centre_x"]))
        centre_y = shared_plane(s, wp.static(plane["centre_y"]))
        u = array_at(u_at)
        # From the lowest neighbour on, so that all are at positive distances.
        v = array_at(retarded_at - wp.uint64(wp.static((stride + 1) * size)))
        mx = array_at(mx_at)
        my = array_at(my_at)
        mxy = array_at(mxy_at)
        for i in range(wp.static(count)):
            c = v[i + wp.static(stride + 1)]
            e = v[i + wp.static(stride + 2)]
            n = v[i + wp.static(2 * stride + 1)]
            own_x = real(2.0)
            own_y = real(2.0)
            if wp.static(effects.outline):
                own_x = centre_x[i]
                own_y = centre_y[i]
            along_x = west[i] * v[i + wp.static(stride)] + (east[i] * e - own_x * c)
            along_y = south[i] * v[i + 1] + (north[i] * n - own_y * aspect * c)
            mx[i] = moment(bend_xx[i], along_x, bend_xy[i], along_y, in_plane_x, u[i])
            my[i] = moment(bend_yy[i], along_y, bend_xy[i], along_x, in_plane_y, u[i])
            mxy[i] = twist[i] * root_aspect * ((v[i + wp.static(2 * stride + 2)] - e) - (n - c))

    @wp.func
    def compute_membrane_curvature(
        s: wp.uint64, u_at: wp.uint64, curvature_at: wp.uint64, aspect: real, stretch_ratio: real
    ):
        west = shared_plane(s, wp.static(plane["west"]))
        east = shared_plane(s, wp.static(plane["east"]))
        south = shared_plane(s, wp.static(plane["south"]))
        north = shared_plane(s, wp.static(plane["north"]))
        u = array_at(u_at - wp.uint64(wp.static((stride + 1) * size)))
        curvature = array_at(curvature_at)
        for i in range(wp.static(count)):
            c = u[i + wp.static(stride + 1)]
            along_x = west[i] * u[i + wp.static(stride)] + (east[i] * u[i + wp.static(stride + 2)] - real(2.0) * c)
            along_y = south[i] * u[i + 1] + (north[i] * u[i + wp.static(2 * stride + 1)] - real(2.0) * aspect * c)
            curvature[i] = along_x + stretch_ratio * along_y

    @wp.func
    def sum_of_products(a_at: wp.uint64, b_at: wp.uint64, columns_at: wp.uint64, rows: wp.vec2i):
        """Return Σ a·b over rows of the plate, first and last + 1, columns first."""
        columns = array_at(columns_at)
        for i in range(wp.static(stride)):
            columns[i] = real(0.0)
        for row in range(rows[0], rows[1]):
            a = array_at(a_at + wp.uint64(row) * wp.uint64(wp.static(row_bytes)))
            b = array_at(b_at + wp.uint64(row) * wp.uint64(wp.static(row_bytes)))
            for i in range(wp.static(stride)):
                columns[i] = columns[i] + a[i] * b[i]
        total = real(0.0)
        for i in range(wp.static(stride)):
            total += columns[i]
        return total

    @wp.func
    def multiply_planes(a_at: wp.uint64, b_at: wp.uint64, product_at: wp.uint64):
        a = array_at(a_at)
        b = array_at(b_at)
        product = array_at(product_at)
        for i in range(wp.static(count)):
            product[i] = a[i] * b[i]

    @wp.func
    def add_multiple(factor: real, plane_at: wp.uint64, sum_at: wp.uint64, rows: wp.vec2i):
        values = array_at(plane_at)
        total = array_at(sum_at)
        for i in range(rows[0] * wp.static(stride), rows[1] * wp.static(stride)):
            total[i] = total[i] + factor * values[i]

    @wp.func
    def add_travelling_load(strength: real, along_y: wp.array[real], along_x: wp.array[real], pressure_at: wp.uint64):
        for row in range(wp.static(ny)):
            if along_y[row] != real(0.0):
                pressure = array_at(pressure_at + wp.uint64(row) * wp.uint64(wp.static(row_bytes)))
                for i in range(wp.static(stride)):
                    pressure[i] = pressure[i] + strength * along_y[row] * along_x[i]

    @wp.func
    def clear(at: wp.uint64):
        values = array_at(at)
        for i in range(wp.static(count)):
            values[i] = real(0.0)

    @wp.func
    def update_nodes(
        s: wp.uint64, mx_at: wp.uint64, my_at: wp.uint64, mxy_at: wp.uint64, curvature_at: wp.uint64,
        pressure_at: wp.uint64, cosine_at: wp.uint64, sine_at: wp.uint64, load_at: wp.uint64, u_at: wp.uint64,
        rate_at: wp.uint64, squares_at: wp.uint64, wave_cosine: real, wave_sine: real, summed: real, tension: real,
        aspect: real, root_aspect: real,
    ):
        """``summed``: 1 in the window, else 0."""
        west = shared_plane(s, wp.static(plane["west"]))
        east = shared_plane(s, wp.static(plane["east"]))
        south = shared_plane(s, wp.static(plane["south"]))
        north = shared_plane(s, wp.static(plane["north"]))
        cells = shared_plane(s, wp.static(plane["cells"]))
        inverse_mass = shared_plane(s, wp.static(plane["inverse_mass"]))
        decay = shared_plane(s, wp.static(plane["decay"]))
        spring = shared_plane(s, wp.static(plane["spring"]))
        pressure_gain = shared_plane(s, wp.static(plane["pressure_gain"]))
        centre_x = shared_plane(s, wp.static(plane["centre_x"]))
        centre_y = shared_plane(s, wp.static(plane["centre_y"]))
        mx = array_at(mx_at - wp.uint64(wp.static(size)))
        my = array_at(my_at - wp.uint64(wp.static(stride * size)))
        mxy = array_at(mxy_at - wp.uint64(wp.static((stride + 1) * size)))
        membrane_curvature = array_at(curvature_at)
        pressure = array_at(pressure_at)
        cosine = array_at(cosine_at)
        sine = array_at(sine_at)
        loads = array_at(load_at)
        u = array_at(u_at)
        rate = array_at(rate_at)
        squares = array_at(squares_at)
        p = Parameters()
        for i in range(wp.static(count)):
            own_x = real(2.0)
            own_y = real(2.0)
            if wp.static(effects.outline):
                own_x = centre_x[i]
                own_y = centre_y[i]
            bending = west[i] * mx[i] + (east[i] * mx[i + 2] - own_x * mx[i + 1])
            bending += south[i] * my[i] + (
                north[i] * my[i + wp.static(2 * stride)] - own_y * aspect * my[i + wp.static(stride)]
            )
            twisting = (mxy[i + wp.static(stride + 1)] - mxy[i + wp.static(stride)]) - (mxy[i + 1] - mxy[i])
            bending += cells[i] * root_aspect * twisting
            here = u[i]
            if wp.static(effects.terms == 2):  # noqa: SIM108, one of the two is compiled
                load = wave_cosine * cosine[i] + wave_sine * sine[i]
            else:
                load = loads[i]
            node_spring = real(0.0)
            node_curvature = real(0.0)
            if wp.static(effects.springs):
                node_spring = spring[i]
            if wp.static(effects.membrane):
                node_curvature = membrane_curvature[i]
            load = add_local_forces(load, inverse_mass[i], node_spring, here, tension, node_curvature)
            if wp.static(effects.attached or effects.travelling):
                load += pressure_gain[i] * pressure[i]
            if wp.static(effects.damping):
                p.decay = decay[i]
            new = update(rate[i], bending, load, inverse_mass[i], p)
            rate[i] = new
            if wp.static(not effects.coils):
                u[i] = here + new
                squares[i] = fused(summed * new, new, squares[i])

    @wp.func
    def add_coils(
        s: wp.uint64, pressure_at: wp.uint64, u_at: wp.uint64, rate_at: wp.uint64, squares_at: wp.uint64, summed: real
    ):
        """Finish the step with the pressure of the coils."""
        pressure_gain = shared_plane(s, wp.static(plane["pressure_gain"]))
        pressure = array_at(pressure_at)
        u = array_at(u_at)
        rate = array_at(rate_at)
        squares = array_at(squares_at)
        for i in range(wp.static(count)):
            new = rate[i] + pressure_gain[i] * pressure[i]
            rate[i] = new
            u[i] = u[i] + new
            squares[i] = fused(summed * new, new, squares[i])

    @portable_kernel(max_unroll=1, block_dim=1)
    def run_steps(
        # parameters
        m: Material,  # its along_x padded to ``stride``
        shared: wp.array3d[real],  # (len(SHARED_PLANES), rows, stride); south, north times (hx / hy)²
        patches: wp.array3d[real],  # (attached masses, then coils, rows, stride) shares of the nodes
        patch_rows: wp.array[wp.vec2i],  # (attached masses, then coils) first and last + 1 of the rows with shares
        window: wp.vec2i,  # first and last + 1 of the steps whose rate² is summed
        start: int,
        stop: int,
        first: int,
        thread: int,
        # inputs
        d: Forcing,  # its loads of a spare plate too
        # outputs
        f: Fields,
        workspace: wp.array4d[real],  # (threads + 1, len(WORKSPACE_PLANES), rows, stride); the launch uses [thread]
    ):
        before = flush_denormals()
        k = first + wp.tid()
        row = wp.uint64(wp.static(row_bytes))
        plane_offset = wp.uint64(k) * wp.uint64(wp.static(plane_bytes)) + row
        step = wp.uint64(wp.static(plane_bytes))
        mx = workspace.ptr + wp.uint64(thread) * wp.uint64(wp.static(len(WORKSPACE_PLANES) * plane_bytes)) + row
        my = mx + step
        mxy = my + step
        curvature = mxy + step
        retarded = curvature + step
        pressure = retarded + step
        load = pressure + step
        term = wp.uint64(d.loads.shape[1]) * step
        first_load = d.loads.ptr + plane_offset
        u_at = f.u.ptr + plane_offset
        rate_at = f.rate.ptr + plane_offset
        tension = real(0.0)
        whole = wp.vec2i(0, wp.static(ny))
        for n in range(start, stop):
            strained = u_at
            if wp.static(effects.retarded):
                compute_retarded_u(u_at, rate_at, retarded, m.retardation)
                strained = retarded
            compute_moments(
                shared.ptr, u_at, strained, mx, my, mxy, m.aspect, m.root_aspect, m.in_plane_x, m.in_plane_y
            )
            if wp.static(effects.membrane):
                compute_membrane_curvature(shared.ptr, u_at, curvature, m.aspect, m.stretch_ratio)
                # The pressure plane is not in use yet; it holds weight · u.
                weight = shared.ptr + wp.uint64(wp.static(plane["weight"] * plane_bytes)) + row
                multiply_planes(weight, u_at, pressure)
                tension = membrane_tension(d, m, k, -sum_of_products(pressure, curvature, retarded, whole))
            if wp.static(effects.attached or effects.travelling):
                clear(pressure)
            if wp.static(effects.travelling):
                add_travelling_load(d.travelling[k] * m.strength[n], m.along_y[n], m.along_x[n], pressure)
            if wp.static(effects.terms != 2):
                clear(load)
                for t in range(wp.static(effects.terms)):
                    add_multiple(d.wave[k, n, t], first_load + wp.uint64(t) * term, load, whole)
            if wp.static(effects.attached):
                for o in range(m.attached.shape[0]):
                    shares = patches.ptr + wp.uint64(o) * step + row
                    rows = patch_rows[o]
                    plate_u = sum_of_products(shares, u_at, retarded, rows)
                    plate_rate = sum_of_products(shares, rate_at, retarded, rows)
                    add_multiple(attached_force(f, m, k, o, plate_u, plate_rate), shares, pressure, rows)
            summed = real(0.0)
            if n >= window[0] and n < window[1]:
                summed = real(1.0)
            update_nodes(
                shared.ptr, mx, my, mxy, curvature, pressure, first_load, first_load + term, load, u_at, rate_at,
                f.squares.ptr + plane_offset, d.wave[k, n, 0], d.wave[k, n, 1], summed, tension, m.aspect,
                m.root_aspect,
            )
            if wp.static(effects.coils):
                clear(pressure)
                for c in range(m.coils.shape[0]):
                    shares = patches.ptr + wp.uint64(m.attached.shape[0] + c) * step + row
                    rows = patch_rows[m.attached.shape[0] + c]
                    plate_u = sum_of_products(shares, u_at, retarded, rows)
                    plate_rate = sum_of_products(shares, rate_at, retarded, rows)
                    add_multiple(coil_force(d, f, m, k, c, n, plate_u, plate_rate), shares, pressure, rows)
                add_coils(shared.ptr, pressure, u_at, rate_at, f.squares.ptr + plane_offset, summed)
            for traced in range(f.nodes.shape[0]):
                f.trace[k, traced, n] = f.u[k, f.nodes[traced, 0], f.nodes[traced, 1]]
        restore_denormals(before)

    return run_steps
