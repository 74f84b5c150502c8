"""Paths of scenes that need more than the plain plate, see ``kernels.moment_form``."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import (
    moment_form_blocking,
    moment_form_cpu,
    moment_form_cuda,
    moment_form_plan,
    temporal_blocking,
)
from warp_plate.kernels.cuda import LANES
from warp_plate.kernels.moment_form import make_passes, make_structs
from warp_plate.solve import cuda
from warp_plate.solve.cpu import distribute
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State
from warp_plate.solve.streaming import Launcher, loaded_ahead, several_steps_a_launch, step_by_step

# Temporal blocking: threads per block, and rows of a tile that adds up sums.
BLOCKING_BLOCK, SUMMED_ROWS = 128, 64


def attached_count(specialized: Specialized) -> int:
    """Return the number of patches with something attached."""
    assert specialized.scheme.bending is not None
    return len(specialized.scheme.bending.attachments)


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
        "bend_xx": bending.bend_xx * unit / hx**4,
        "bend_xy": bending.bend_xy * unit / hx**4,
        "bend_yy": bending.bend_yy * unit / hx**4,
        "twist": bending.twist * unit / hx**4,
        "inverse_mass": bending.moves * gain / ratio,
        "decay": 1 - loss if scheme.backward else (1 - loss / 2) / (1 + loss / 2),
        "spring": bending.spring * unit,
        "weight": bending.weight,
        "oscillator_shares": bending.shares,
        "oscillators": np.array(attached).reshape(-1, 4),
        "strength": moving.wave / moving.largest if moving else np.zeros(1),
        "along_x": moving.along_x if moving else np.zeros((1, 1)),
        "along_y": moving.along_y if moving else np.zeros((1, 1)),
    }
    material = make_structs(specialized.real)[0]()
    for name, values in arrays.items():
        setattr(material, name, specialized.to_device(values))
    material.aspect = scheme.aspect
    material.root_aspect = hx / hy
    material.tension_x, material.tension_y = (force * unit / hx**2 for force in bending.membrane)
    material.retardation = bending.retardation / step
    material.stretching = bending.berger * (hy / hx) * unit / hx**2
    material.stretch_ratio = bending.stretch_ratio
    return material


def _make_fields(specialized: Specialized, state: State) -> Any:
    """Return the struct of a state's fields, with those that only the passes of a step use."""
    effects = specialized.effects
    (nx, ny), device, real = specialized.scheme.nodes, specialized.device, specialized.real
    oscillators = attached_count(specialized)

    def zeros(*shape: int) -> wp.array:
        return wp.zeros((state.capacity, *shape), dtype=real, device=device)

    fields = make_structs(real)[1]()
    fields.loads = state.loads[:, :, 1 : ny + 1, :nx]
    for name in ("u", "rate", "squares"):
        setattr(fields, name, getattr(state, name)[:, 1 : ny + 1, :nx])
    fields.mx, fields.my, fields.mxy = (zeros(ny, nx) for _ in range(3))
    fields.membrane_curvature = zeros(ny, nx) if effects.stretching else zeros(1, 1)
    fields.row_sums = zeros(oscillators + int(effects.stretching), 2, ny)
    fields.tension = zeros()
    fields.oscillator_force, fields.oscillator_state = zeros(oscillators), zeros(oscillators, 2)
    return fields


def streaming_path(specialized: Specialized) -> Advance:
    """Return the path of several steps per launch on CUDA, where the effects allow it, else with one for each pass."""
    if specialized.device.is_cuda and takes_blocks(specialized):
        return _blocking_path(specialized)
    device, (nx, ny), window = specialized.device, specialized.scheme.nodes, wp.vec2i(*specialized.scheme.window)
    kernels = make_passes(specialized.effects, specialized.real)
    specialized.load(*kernels)
    compute_moments, sum_rows, finish_sums, update_nodes = kernels
    material = make_material(specialized)

    def step(launch: Launcher, state: State, plates: int, clock: wp.array, offset: int) -> None:
        inputs = [state.beside[compute_moments], material]
        sums = inputs[0].row_sums.shape[1]
        launch(compute_moments, dim=(plates, ny, nx), inputs=inputs, device=device)
        if sums:
            launch(sum_rows, dim=(plates, sums, ny), inputs=inputs, device=device)
            launch(finish_sums, dim=(plates, sums), inputs=inputs, device=device)
        launch(update_nodes, dim=(plates, ny, nx), inputs=[*inputs, window, clock, offset], device=device)

    steps = step_by_step(specialized, step)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if compute_moments not in state.beside:
            state.beside[compute_moments] = _make_fields(specialized, state)
        fields = state.beside[compute_moments]
        fields.units, fields.moving, fields.wave = state.units, state.moving, state.wave
        if start == 0:  # oscillators are at rest
            fields.oscillator_state.zero_()
            fields.oscillator_force.zero_()
        steps(state, plates, start, stop)

    return advance


def takes_blocks(specialized: Specialized) -> bool:
    """Return whether temporal blocking has the effects: not those that act on patches at every step."""
    return not (specialized.effects.oscillators or specialized.effects.moving_load)


def _blocking_path(specialized: Specialized) -> Advance:
    """Return the path of temporal blocking on CUDA."""
    effects, real, (nx, ny), device = (
        specialized.effects, specialized.real, specialized.scheme.nodes, specialized.device,
    )  # fmt: skip
    # More steps per launch than this cost registers that there are not; stretching needs a sum before each step.
    most_levels = 1 if effects.stretching or real is wp.float64 else 2 if effects.material_damping else 3
    names = moment_form_plan.material_planes(effects)
    kernels = {
        (levels, summed): moment_form_blocking.make_advance_tiles(
            effects, real, nx, ny, specialized.stride, names, levels, summed
        )
        for levels in (1, most_levels)
        for summed in (False, True)
    }
    specialized.load(*kernels.values(), block_dim=BLOCKING_BLOCK)
    material = make_material(specialized)
    planes = np.stack([_material_plane(material, name) for name in names])
    constants = {levels: [material, *_planes_of_lanes(specialized, planes, levels)] for levels in (1, most_levels)}

    # Sums must not depend on the number of plates.
    summed_tiles = max(1, ny // SUMMED_ROWS)
    parts = moment_form_blocking.strips(effects, nx, 1) * summed_tiles if effects.stretching else 0

    def launch_tiles(
        launch: Launcher, state: State, plates: int, clock: wp.array, offset: int, levels: int, summed: bool
    ) -> None:
        strips = plates * moment_form_blocking.strips(effects, nx, levels)
        tiles = summed_tiles if effects.stretching else cuda.tiles_of(specialized, strips, ny)
        sums = state.beside[kernels[1, True]]
        launch(
            kernels[levels, summed],
            dim=strips * tiles * LANES,
            inputs=[*constants[levels], state.wave, state.units, clock, offset, tiles, -(-ny // tiles)]
            + [state.loads, sums[0], state.u, state.rate],
            outputs=[sums[1], state.u_next, state.rate_next, state.squares],
            device=device,
            block_dim=BLOCKING_BLOCK,
        )
        sums.reverse()

    steps = several_steps_a_launch(specialized, most_levels, launch_tiles)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        # Not within a launch, which may be recorded.
        if kernels[1, True] not in state.beside:
            shape = (state.capacity, parts)
            state.beside[kernels[1, True]] = [wp.zeros(shape, dtype=real, device=device) for _ in range(2)]
        if start == 0:
            for sums in state.beside[kernels[1, True]]:
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
    return [material, loaded_ahead(specialized, margin, margin + temporal_blocking.ROUND - temporal_blocking.REACH)]


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


def plan_of(specialized: Specialized, few: bool) -> moment_form_plan.BlockPlan:
    """Return the distribution of a plate over a block of the CUDA device, see ``plan_block``."""
    (nx, ny), oscillators = specialized.scheme.nodes, attached_count(specialized)
    real, effects, shared_bytes = specialized.real, specialized.effects, specialized.shared_bytes
    return moment_form_plan.plan_block(nx, ny, real, effects, oscillators, few, shared_bytes)


def block_path(specialized: Specialized, plan: moment_form_plan.BlockPlan) -> Advance:
    """Return the path with a block per plate, distributed over its threads by a plan."""
    (nx, ny), device, real = specialized.scheme.nodes, specialized.device, specialized.real
    effects, oscillators = specialized.effects, attached_count(specialized)
    kernel = moment_form_cuda.make_run_steps(effects, real, nx, ny, specialized.stride, oscillators, plan)
    specialized.load(kernel, block_dim=plan.threads)
    material = make_material(specialized)

    def lines(planes: np.ndarray) -> wp.array:
        """Return (planes, threads × nodes), node after node without padding between rows."""
        beyond = plan.threads * plan.nodes - nx * ny
        return specialized.to_device(np.pad(planes.reshape(len(planes), nx * ny), ((0, 0), (0, beyond))))

    planes = np.stack([_material_plane(material, name) for name in moment_form_plan.material_planes(effects)])
    shared = [material, lines(planes), lines(material.oscillator_shares.numpy())]
    shared.append(wp.vec2i(*specialized.scheme.window))
    workspace_size = 0 if plan.on_chip else moment_form_plan.workspace_layout(nx, oscillators, plan)["end"]

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if kernel not in state.beside:
            shapes = (state.capacity, workspace_size), (state.capacity, oscillators, 2)
            state.beside[kernel] = [wp.zeros(shape, dtype=real, device=device) for shape in shapes]
        workspace, oscillator_state = state.beside[kernel]
        if start == 0:
            oscillator_state.zero_()
        inputs = [*shared, start, stop, state.wave, state.units, state.moving, state.inner_nodes, state.loads]
        outputs = [workspace, state.u, state.rate, state.squares, oscillator_state, state.trace]
        dim, threads = plates * plan.threads, plan.threads
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device, block_dim=threads)

    return advance


def _material_plane(material: Any, name: str) -> np.ndarray:
    """Return a plane (ny, nx) of the material; pressure_gain is the rate that a pressure on a node's cell adds."""
    gain = name == "pressure_gain"
    plane = material.inverse_mass.numpy() / material.weight.numpy() if gain else getattr(material, name).numpy()
    return np.pad(plane, [(0, whole - size) for whole, size in zip(material.weight.shape, plane.shape, strict=True)])


def _cpu_path(specialized: Specialized) -> Advance:
    device, real, (nx, ny) = specialized.device, specialized.real, specialized.scheme.nodes
    rows, stride, oscillators = specialized.rows, specialized.stride, attached_count(specialized)
    kernel = moment_form_cpu.make_run_steps(specialized.effects, real, ny, stride)
    specialized.load(kernel)
    material = make_material(specialized)
    planes = np.stack([_shared_plane(material, name) for name in moment_form_cpu.SHARED_PLANES])
    shared = [
        specialized.to_device(np.pad(values, ((0, 0), (1, 1), (0, stride - nx))))
        for values in (planes, material.oscillator_shares.numpy())
    ]
    along_x = material.along_x.numpy()
    material.along_x = specialized.to_device(np.pad(along_x, ((0, 0), (0, stride - along_x.shape[1]))))
    window = wp.vec2i(*specialized.scheme.window)
    # The last thread's passes read beyond its workspace.
    shape = (specialized.threads + 1, len(moment_form_cpu.WORKSPACE_PLANES), rows, stride)
    workspace = wp.zeros(shape, dtype=real, device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if start == 0:  # at rest; all plates of a batch begin together
            state.beside[kernel] = wp.zeros((state.capacity, oscillators, 2), dtype=real, device=device)
        oscillator_state = state.beside[kernel]

        def run_share(thread: int, first: int, last: int) -> None:
            inputs = [material, *shared, state.wave, window, state.units, state.moving, start, stop, first, thread]
            inputs += [state.nodes, state.loads]
            outputs = [workspace, state.u, state.rate, state.squares, oscillator_state, state.trace]
            wp.launch(kernel, dim=last - first, inputs=inputs, outputs=outputs, device=device)

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
