"""Paths of scenes that need more than the plain plate, see ``kernels.moment_form``."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import moment_form_cpu, moment_form_cuda, moment_form_plan, moment_form_streaming
from warp_plate.kernels.moment_form import make_structs
from warp_plate.plate.bending import oscillator_shares
from warp_plate.solve.cpu import compiler_flags, distribute
from warp_plate.solve.launches import Launcher
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State
from warp_plate.solve.streaming import step_by_step


def make_material(specialized: Specialized) -> Any:
    """Return the struct of what all plates share, in the kernels' scaled units."""
    scene, scheme, effects = specialized.scene, specialized.scheme, specialized.scene.effects
    bending, (hx, hy), step = scheme.bending, scheme.spacing, scheme.time_step
    assert bending is not None
    unit = step**2 / scheme.surface_density  # rate gained in a step per pressure
    loss = scheme.viscous * step / bending.mass
    ratio = bending.mass / scheme.surface_density
    gain = np.ones_like(loss) if scheme.backward else 1 / (1 + loss / 2)
    on_plate = unit / (hx * hy)
    oscillators = [
        (
            oscillator.stiffness * on_plate,
            oscillator.damping * on_plate / step,
            scheme.surface_density * hx * hy / oscillator.mass if oscillator.mass else 0.0,
            0.0,
        )
        for oscillator in effects.oscillators
    ]
    material = make_structs(specialized.real)[0]()
    strength, along_x, along_y = _moving_load(specialized)
    arrays = {
        "bend_xx": bending.bend_xx * unit / hx**4,
        "bend_xy": bending.bend_xy * unit / hx**4,
        "bend_yy": bending.bend_yy * unit / hx**4,
        "twist": bending.twist * unit / hx**4,
        "inverse_mass": bending.moves * gain / ratio,
        "decay": 1 - loss if scheme.backward else (1 - loss / 2) / (1 + loss / 2),
        "spring": bending.spring * unit,
        "weight": bending.weight,
        "oscillator_shares": oscillator_shares(scene),
        "oscillators": np.array(oscillators).reshape(-1, 4),
        "strength": strength,
        "along_x": along_x,
        "along_y": along_y,
    }
    for name, values in arrays.items():
        setattr(material, name, specialized.to_device(values))
    material.aspect = scheme.aspect
    material.root_aspect = hx / hy
    material.tension_x, material.tension_y = (tension * unit / hx**2 for tension in bending.tension)
    material.retardation = effects.material_damping.time / step if effects.material_damping else 0.0
    material.stretching = bending.berger * (hy / hx) * unit / hx**2
    material.stretch_ratio = bending.stretch_ratio
    return material


def _moving_load(specialized: Specialized) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return strength (steps,) relative to its largest, and shares along x and y, of the moving load."""
    moving = specialized.discretization.moving
    if moving is None:
        return np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1))
    return moving.wave / moving.largest, moving.along_x, moving.along_y


def _make_fields(specialized: Specialized, state: State) -> Any:
    """Return the struct of a state's fields, with those that only the passes of a step use."""
    effects = specialized.effects
    (nx, ny), device, real = specialized.scheme.nodes, specialized.device, specialized.real
    oscillators = len(specialized.scene.effects.oscillators)
    sums = oscillators + int(effects.stretching)

    def zeros(*shape: int) -> wp.array:
        return wp.zeros((state.capacity, *shape), dtype=real, device=device)

    fields = make_structs(real)[1]()
    fields.loads = state.loads[:, :, 1 : ny + 1, :nx]
    for name in ("u", "rate", "squares"):
        setattr(fields, name, getattr(state, name)[:, 1 : ny + 1, :nx])
    fields.mx, fields.my, fields.mxy = (zeros(ny, nx) for _ in range(3))
    fields.membrane_curvature = zeros(ny, nx) if effects.stretching else zeros(1, 1)
    fields.row_sums = zeros(sums, 2, ny)
    fields.tension = zeros()
    fields.oscillator_force, fields.oscillator_state = zeros(oscillators), zeros(oscillators, 2)
    return fields


def streaming_path(specialized: Specialized) -> Advance:
    """Return the path with a launch for each pass of a step."""
    device, effects = specialized.device, specialized.effects
    kernels = moment_form_streaming.make_passes(effects, specialized.real)
    for kernel in kernels:
        wp.load_module(module=kernel.module, device=device)
    compute_moments, sum_rows, finish_sums, update_nodes = kernels
    (nx, ny), window = specialized.scheme.nodes, wp.vec2i(*specialized.scheme.window)
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


def resident_path(specialized: Specialized) -> Advance:
    """Return the path that runs all steps in one launch: per thread on CPU, a block per plate on CUDA."""
    return _cuda_path(specialized) if specialized.device.is_cuda else _cpu_path(specialized)


def _cuda_path(specialized: Specialized) -> Advance:
    """Return the CUDA path, compiled for few plates and for many where their plans differ."""
    nodes, device, oscillators = specialized.scheme.nodes, specialized.device, specialized.scene.effects.oscillators
    few_plan, many_plan = (
        moment_form_plan.plan_block(*nodes, specialized.real, specialized.effects, len(oscillators), few)
        for few in (True, False)
    )
    many = block_path(specialized, many_plan)
    few = many if few_plan == many_plan else block_path(specialized, few_plan)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        (few if plates <= device.sm_count else many)(state, plates, start, stop)

    return advance


def block_path(specialized: Specialized, plan: moment_form_plan.BlockPlan) -> Advance:
    """Return the path with a block per plate, distributed over its threads by a plan."""
    (nx, ny), stride, device, real = specialized.scheme.nodes, specialized.stride, specialized.device, specialized.real
    effects, oscillators = specialized.effects, len(specialized.scene.effects.oscillators)
    kernel = moment_form_cuda.make_run_steps(effects, real, nx, ny, stride, oscillators, plan)
    wp.load_module(module=kernel.module, device=device, block_dim=plan.threads)
    material = make_material(specialized)

    def lines(planes: list[np.ndarray]) -> wp.array:
        """Return (planes, threads × nodes), node after node without padding between rows."""
        values = np.zeros((len(planes), plan.threads * plan.nodes))
        for line, plane in zip(values, planes, strict=True):
            line[: nx * ny] = np.pad(plane, ((0, ny - plane.shape[0]), (0, nx - plane.shape[1]))).ravel()
        return specialized.to_device(values)

    planes = [_material_plane(material, name) for name in moment_form_plan.material_planes(effects)]
    shared = [material, lines(planes), lines(list(material.oscillator_shares.numpy()))]
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
    """Return a plane of the material by name; pressure_gain is the rate that a pressure on a node's cell adds."""
    if name == "pressure_gain":
        return np.asarray(material.inverse_mass.numpy() / material.weight.numpy())
    return np.asarray(getattr(material, name).numpy())


def _cpu_path(specialized: Specialized) -> Advance:
    device, real, rows, stride = specialized.device, specialized.real, specialized.rows, specialized.stride
    effects, ny = specialized.effects, specialized.scheme.nodes[1]
    kernel = moment_form_cpu.make_run_steps(effects, real, ny, stride, compiler_flags())
    wp.load_module(module=kernel.module, device=device)
    material, oscillators = make_material(specialized), len(specialized.scene.effects.oscillators)
    shares = np.array([_padded(specialized, plane) for plane in material.oscillator_shares.numpy()])
    along_x = material.along_x.numpy()
    padded_along_x = np.pad(along_x, ((0, 0), (0, stride - along_x.shape[1])))
    shared = [_shared_planes(specialized, material), specialized.to_device(shares.reshape(-1, rows, stride))]
    material.along_x = specialized.to_device(padded_along_x)
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


def _padded(specialized: Specialized, values: np.ndarray) -> np.ndarray:
    """Return (rows, stride) from (ny, nx) or less, with zeros around."""
    plane = np.zeros((specialized.rows, specialized.stride))
    plane[1 : 1 + values.shape[0], : values.shape[1]] = values
    return plane


def _shared_planes(specialized: Specialized, material: Any) -> wp.array:
    """Return (len(SHARED_PLANES), rows, stride): factors of each node's neighbours and cells, and its material."""

    def factors(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return factors of the lower and the upper neighbour and of the cells: on an edge, mirror images."""
        low, high, cells = np.ones((3, count))
        low[[0, -1]], high[[0, -1]], cells[[0, -1]] = (0, 2), (2, 0), 2
        return low, high, cells

    nx, ny = specialized.scheme.nodes
    (low_x, high_x, cells_x), (low_y, high_y, cells_y) = factors(nx), factors(ny)
    planes = {
        "west": np.outer(np.ones(ny), low_x),
        "east": np.outer(np.ones(ny), high_x),
        "south": material.aspect * np.outer(low_y, np.ones(nx)),
        "north": material.aspect * np.outer(high_y, np.ones(nx)),
        "cells": np.outer(cells_y, cells_x),
    }
    values = [
        planes[name] if name in planes else _material_plane(material, name) for name in moment_form_cpu.SHARED_PLANES
    ]
    return specialized.to_device(np.stack([_padded(specialized, plane) for plane in values]))
