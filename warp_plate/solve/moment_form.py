"""Paths of scenes that need more than the plain plate, see ``kernels.update``."""

from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import moment_form_blocking, moment_form_cpu, moment_form_cuda, plans, temporal_blocking
from warp_plate.kernels import update as structs
from warp_plate.kernels.cuda import LANES
from warp_plate.plate.weights import cell_shares
from warp_plate.solve import cuda
from warp_plate.solve.cpu import distribute
from warp_plate.solve.specialize import Specialized, coil_numbers
from warp_plate.solve.state import Advance, State, attached_masses
from warp_plate.solve.streaming import Launcher, loaded_ahead, several_steps_a_launch

# Temporal blocking: rows of a tile that adds up sums.
SUMMED_ROWS = 64


def make_material(specialized: Specialized) -> Any:
    """Return the struct of what all plates share, in the kernels' scaled units."""
    scheme = specialized.scheme
    bending, (hx, hy), step = scheme.bending, scheme.spacing, scheme.time_step
    assert bending is not None
    unit = step**2 / scheme.surface_density  # rate gained in a step per pressure
    loss = scheme.viscous * step / bending.mass
    ratio = bending.mass / scheme.surface_density
    gain = np.ones_like(loss) if scheme.backward else 1 / (1 + loss / 2)
    on_plate = unit / (hx * hy)
    # Kernels know nodes that own a whole cell, or half of one on an edge; of a plate with an outline or supports they
    # get the energies and masses of each node's own area.
    weight = cell_shares(loss.shape)
    area = bending.weight / weight
    centre_x, centre_y = (np.full_like(loss, 2),) * 2 if bending.grid is None else bending.grid.centres
    attached = [
        (
            attachment.stiffness * on_plate,
            attachment.damping * on_plate / step,
            scheme.surface_density * hx * hy / attachment.mass if attachment.mass else 0.0,
            0.0,
        )
        for attachment in bending.attachments
    ]
    moving = specialized.discretization.moving
    arrays = {
        "bend_xx": area * bending.bend_xx * unit / hx**4,
        "bend_xy": area * bending.bend_xy * unit / hx**4,
        "bend_yy": area * bending.bend_yy * unit / hx**4,
        "twist": bending.twist * unit / hx**4,
        "inverse_mass": bending.moves * gain / (ratio * area),
        "decay": 1 - loss if scheme.backward else (1 - loss / 2) / (1 + loss / 2),
        "spring": area * bending.spring * unit,
        "weight": weight,
        "centre_x": centre_x,
        "centre_y": centre_y,
        "attached_shares": bending.patch_shares,
        "attached": np.array(attached).reshape(-1, 4),
        "strength": moving.wave / moving.largest if moving else np.zeros(1),
        "along_x": moving.along_x if moving else np.zeros((1, 1)),
        "along_y": moving.along_y if moving else np.zeros((1, 1)),
    }
    arrays["coils"] = coil_numbers(scheme, bending.coils, arrays["inverse_mass"] / weight)
    material = structs.make_material(specialized.real)()
    actuators = [coil.actuator for coil in bending.coils]
    material.coil_actuators = wp.array(np.array(actuators, dtype=np.int32), dtype=int, device=specialized.device)
    for name, values in arrays.items():
        setattr(material, name, specialized.to_device(values))
    material.aspect = scheme.aspect
    material.root_aspect = hx / hy
    material.in_plane_x, material.in_plane_y = (force * unit / hx**2 for force in bending.membrane)
    material.retardation = bending.retardation / step
    material.membrane = bending.berger * (hy / hx) * unit / hx**2
    material.stretch_ratio = bending.stretch_ratio
    return material


def takes_blocks(specialized: Specialized) -> bool:
    """Return whether temporal blocking has the effects: not those that act on patches at every step, nor outlines."""
    effects = specialized.effects
    return specialized.device.is_cuda and not (
        effects.attached or effects.coils or effects.travelling or effects.outline
    )


def streaming_path(specialized: Specialized) -> Advance:
    """Return the path of temporal blocking on CUDA, for effects that it takes."""
    effects, real, (nx, ny) = specialized.effects, specialized.real, specialized.scheme.nodes
    # More steps per launch than this cost registers that there are not; a membrane needs a sum before each step.
    most_levels = 1 if effects.membrane or real is wp.float64 else 2 if effects.retarded else 3
    names, material = plans.material_planes(effects), make_material(specialized)
    planes = np.stack([_material_plane(material, name) for name in names])
    alike = moment_form_blocking.rows_alike(planes)
    kernels = {
        (levels, summed): moment_form_blocking.make_advance_tiles(
            effects, real, nx, ny, specialized.stride, names, alike, levels, summed
        )
        for levels in (1, most_levels)
        for summed in (False, True)
    }
    specialized.load(*kernels.values(), block_dim=moment_form_blocking.BLOCK)
    constants = {levels: [material, *_planes_of_lanes(specialized, planes, levels)] for levels in (1, most_levels)}

    # Sums must not depend on the number of plates.
    summed_tiles = max(1, ny // SUMMED_ROWS)
    parts = temporal_blocking.strips(nx, moment_form_blocking.margin_of(effects, 1)) * summed_tiles

    def sums_of(state: State) -> list[wp.array]:
        """Return the sums that a launch reads and those that it writes, which alternate with the fields."""
        sums = state.scratch("membrane_sums", 2, state.capacity, parts)
        exchanged = state.u.ptr != state.fields_memory.ptr
        return [sums[int(exchanged)], sums[int(not exchanged)]]

    def launch_tiles(
        launch: Launcher, state: State, plates: int, clock: wp.array, offset: int, levels: int, summed: bool
    ) -> None:
        strips = plates * temporal_blocking.strips(nx, moment_form_blocking.margin_of(effects, levels))
        tiles = summed_tiles if effects.membrane else cuda.tiles_of(specialized, strips, ny)
        sums = sums_of(state)
        launch(
            kernels[levels, summed],
            dim=strips * tiles * LANES,
            inputs=[*constants[levels], clock, offset, tiles, -(-ny // tiles)]
            + [state.drive, state.drive.wave, state.loads, state.fields, sums[0]],
            outputs=[state.next_fields, sums[1]],
            device=specialized.device,
            block_dim=moment_form_blocking.BLOCK,
        )

    steps = several_steps_a_launch(specialized, most_levels, launch_tiles)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        sums = state.scratch("membrane_sums", 2, state.capacity, parts)  # not allocated while launches are recorded
        if start == 0:
            sums.zero_()
        steps(state, plates, start, stop)

    return advance


def _planes_of_lanes(specialized: Specialized, planes: np.ndarray, levels: int) -> list[wp.array]:
    """Return the material planes by pairs of columns, zero beyond the plate, and the loaded rows, for tiles."""
    effects, (nx, ny), columns = specialized.effects, specialized.scheme.nodes, temporal_blocking.COLUMNS
    margin = moment_form_blocking.margin_of(effects, levels)
    width = moment_form_blocking.plane_width(effects, nx, levels)
    beyond = 2 * margin + 1
    padded = np.pad(planes, ((0, 0), (beyond, beyond), (margin, width - nx - margin)))
    pairs = padded.reshape(len(planes), ny + 2 * beyond, width // columns, columns)
    Row = wp.types.vector(length=columns, dtype=specialized.real)
    material: wp.array = wp.array(pairs, dtype=Row, device=specialized.device)
    ahead = moment_form_blocking.ROUND - moment_form_blocking.REACH
    return [material, loaded_ahead(specialized, margin, margin + ahead)]


def resident_path(specialized: Specialized) -> Advance:
    """Return the path that runs all steps in one launch: per thread on CPU, a block per plate on CUDA.

    On CUDA it is compiled for few plates and for many where their plans differ.
    """
    if specialized.device.is_cpu:
        return _cpu_path(specialized)
    few_plan, many_plan = (plan_of(specialized, few) for few in (True, False))
    many = block_path(specialized, many_plan)
    few = many if few_plan == many_plan else block_path(specialized, few_plan)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        (few if plates <= specialized.device.sm_count else many)(state, plates, start, stop)

    return advance


def plan_of(specialized: Specialized, few: bool) -> plans.BlockPlan:
    """Return the distribution of a plate over a block of the CUDA device, see ``plan_block``."""
    (nx, ny), sums = specialized.scheme.nodes, attached_masses(specialized) + len(specialized.coils)
    real, effects, shared_bytes = specialized.real, specialized.effects, specialized.shared_bytes
    return plans.plan_block(nx, ny, real, effects, sums, few, shared_bytes)


def block_path(specialized: Specialized, plan: plans.BlockPlan) -> Advance:
    """Return the path with a block per plate, distributed over its threads by a plan."""
    (nx, ny), real = specialized.scheme.nodes, specialized.real
    effects, masses, coils = specialized.effects, attached_masses(specialized), len(specialized.coils)
    kernel = moment_form_cuda.make_run_steps(effects, real, nx, ny, specialized.stride, masses, plan, coils)
    specialized.load(kernel, block_dim=plan.threads)
    material = make_material(specialized)

    def lines(planes: np.ndarray) -> wp.array:
        """Return (planes, threads × nodes), node after node without padding between rows."""
        beyond = plan.threads * plan.nodes - nx * ny
        return specialized.to_device(np.pad(planes.reshape(len(planes), nx * ny), ((0, 0), (0, beyond))))

    planes = np.stack([_material_plane(material, name) for name in plans.material_planes(effects)])
    shared = [material, lines(planes), lines(material.attached_shares.numpy())]
    shared.append(wp.vec2i(*specialized.scheme.window))
    workspace_size = 0 if plan.on_chip else plans.workspace_layout(nx, masses + coils, plan)["end"]

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        workspace = state.scratch(f"workspace of {plan}", state.capacity, workspace_size)
        inputs = [*shared, start, stop, state.drive, state.drive.wave, state.loads, state.nodes]
        outputs = [state.fields, state.trace, workspace]
        dim, device, threads = plates * plan.threads, specialized.device, plan.threads
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device, block_dim=threads)

    return advance


def _material_plane(material: Any, name: str) -> np.ndarray:
    """Return a plane (ny, nx) of the material; pressure_gain is the rate that a pressure on a node's cell adds."""
    gain = name == "pressure_gain"
    plane = material.inverse_mass.numpy() / material.weight.numpy() if gain else getattr(material, name).numpy()
    return np.pad(plane, [(0, whole - size) for whole, size in zip(material.weight.shape, plane.shape, strict=True)])


def _cpu_path(specialized: Specialized) -> Advance:
    device, real, (nx, ny) = specialized.device, specialized.real, specialized.scheme.nodes
    rows, stride = specialized.rows, specialized.stride
    kernel = moment_form_cpu.make_run_steps(specialized.effects, real, ny, stride)
    specialized.load(kernel)
    material = make_material(specialized)
    planes = np.stack([_shared_plane(material, name) for name in moment_form_cpu.SHARED_PLANES])
    patches = material.attached_shares.numpy()
    shared = [specialized.to_device(np.pad(values, ((0, 0), (1, 1), (0, stride - nx)))) for values in (planes, patches)]
    patch_rows = [np.flatnonzero(patch.any(axis=1))[[0, -1]] + [0, 1] for patch in patches]
    shared.append(wp.array(np.reshape(patch_rows, (-1, 2)), dtype=wp.vec2i, device=device))
    along_x = material.along_x.numpy()
    material.along_x = specialized.to_device(np.pad(along_x, ((0, 0), (0, stride - along_x.shape[1]))))
    window = wp.vec2i(*specialized.scheme.window)
    # The last thread's passes read beyond its workspace.
    shape = (specialized.threads + 1, len(moment_form_cpu.WORKSPACE_PLANES), rows, stride)
    workspace = wp.zeros(shape, dtype=real, device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        def run_share(thread: int, first: int, last: int) -> None:
            inputs = [material, *shared, window, start, stop, first, thread, state.drive]
            wp.launch(kernel, dim=last - first, inputs=inputs, outputs=[state.fields, workspace], device=device)

        distribute(specialized.threads, plates, run_share)

    return advance


def _shared_plane(material: Any, name: str) -> np.ndarray:
    """Return a plane (ny, nx) of factors of each node's neighbours or cells, or of the material, by name."""
    ny, nx = material.weight.shape
    # On an edge, neighbours and cells are mirror images: the one inside counts twice, the one beyond it not at all.
    low_x, low_y = (np.array([0.0, *[1.0] * (count - 2), 2.0]) for count in (nx, ny))
    planes = {
        "west": np.tile(low_x, (ny, 1)),
        "east": np.tile(low_x[::-1], (ny, 1)),
        "south": material.aspect * np.tile(low_y, (nx, 1)).T,
        "north": material.aspect * np.tile(low_y[::-1], (nx, 1)).T,
        "cells": np.outer(np.maximum(low_y, low_y[::-1]), np.maximum(low_x, low_x[::-1])),
    }
    return planes[name] if name in planes else _material_plane(material, name)
