"""The paths of scenes that ask for more than the plain plate: all effects, on every device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import moment_form_cpu as general_cpu
from warp_plate.kernels import moment_form_cuda as general_blocks
from warp_plate.kernels import moment_form_plan as general_plan
from warp_plate.kernels import moment_form_streaming as general_passes
from warp_plate.kernels.moment_form import make_structs
from warp_plate.plate.bending import oscillator_shares
from warp_plate.solve.cpu import compiler_flags, shared_among_threads
from warp_plate.solve.launches import Launcher
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State
from warp_plate.solve.streaming import step_by_step


def material_of(specialized: Specialized) -> Any:
    """What all plates share, in the kernels' scaled numbers."""
    scene, scheme = specialized.scene, specialized.scheme
    bending, (hx, hy), step = scheme.bending, scheme.spacing, scheme.time_step
    assert bending is not None
    effects = scene.effects
    unit = step**2 / scheme.surface_density  # acceleration's part of a step, per pressure
    loss = scheme.viscous * step / bending.mass
    ratio = bending.mass / scheme.surface_density
    gain = np.ones_like(loss) if scheme.backward else 1 / (1 + loss / 2)
    shares = oscillator_shares(scene)
    on_plate = unit / (hx * hy)
    oscillators = [
        (
            one.stiffness * on_plate,
            one.damping * on_plate / step,
            scheme.surface_density * hx * hy / one.mass if one.mass else 0.0,
            0.0,
        )
        for one in effects.oscillators
    ]
    material = make_structs(specialized.real)[0]()
    arrays = {
        "bend_xx": bending.bend_xx * unit / hx**4,
        "bend_xy": bending.bend_xy * unit / hx**4,
        "bend_yy": bending.bend_yy * unit / hx**4,
        "twist": bending.twist * unit / hx**4,
        "mobility": bending.moves * gain / ratio,
        "decay": 1 - loss if scheme.backward else (1 - loss / 2) / (1 + loss / 2),
        "spring": bending.spring * unit,
        "weight": bending.weight,
        "holds": shares,
        "oscillators": np.array(oscillators).reshape(-1, 4),
    }
    for name, values in arrays.items():
        setattr(material, name, specialized.to_device(values))
    strength, along_x, along_y = _travel(specialized)
    material.strength, material.along_x, material.along_y = map(specialized.to_device, (strength, along_x, along_y))
    material.aspect = scheme.aspect
    material.root_aspect = hx / hy
    material.tension_x, material.tension_y = (pull * unit / hx**2 for pull in bending.tension)
    material.retardation = effects.material_damping.time / step if effects.material_damping else 0.0
    material.stretching = bending.berger * (hy / hx) * unit / hx**2
    material.stretch_ratio = bending.stretch_ratio
    return material


def _travel(specialized: Specialized) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strength (steps,) as a part of its largest, and shares along x and y, of a load that moves."""
    moving = specialized.discretization.moving
    if moving is None:
        return np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1))
    return moving.wave / moving.largest, moving.along_x, moving.along_y


def make_fields(specialized: Specialized, state: State) -> Any:
    """The struct of all fields of a state, with those of its own that the passes of a step take."""
    effects = specialized.effects
    (nx, ny), device, real = specialized.scheme.nodes, specialized.device, specialized.real
    hanging = len(specialized.scene.effects.oscillators)
    sums = hanging + int(effects.stretching)

    def zeros(*shape: int) -> wp.array:
        return wp.zeros((state.capacity, *shape), dtype=real, device=device)

    fields = make_structs(real)[1]()
    fields.loads = state.loads[:, :, 1 : ny + 1, :nx]
    for name in ("u", "rate", "squares"):
        setattr(fields, name, getattr(state, name)[:, 1 : ny + 1, :nx])
    fields.mx, fields.my, fields.mxy = (zeros(ny, nx) for _ in range(3))
    fields.pull = zeros(ny, nx) if effects.stretching else zeros(1, 1)
    fields.row_sums = zeros(sums, 2, ny)
    fields.tension, fields.push, fields.hung = zeros(), zeros(hanging), zeros(hanging, 2)
    return fields


def streaming_path(specialized: Specialized) -> Advance:
    """A launch for each pass of a step."""
    device, effects = specialized.device, specialized.effects
    bend, sum_rows, finish_sums, move = general_passes.make_passes(effects, specialized.real)
    for kernel in (bend, sum_rows, finish_sums, move):
        wp.load_module(module=kernel.module, device=device)
    (nx, ny), window = specialized.scheme.nodes, wp.vec2i(*specialized.scheme.window)
    material = material_of(specialized)

    def step(launch: Launcher, state: State, plates: int, clock: wp.array, offset: int) -> None:
        fields = state.beside[bend]
        sums = fields.row_sums.shape[1]
        launch(bend, dim=(plates, ny, nx), inputs=[fields, material], device=device)
        if sums:
            launch(sum_rows, dim=(plates, sums, ny), inputs=[fields, material], device=device)
            launch(finish_sums, dim=(plates, sums), inputs=[fields, material], device=device)
        launch(move, dim=(plates, ny, nx), inputs=[fields, material, window, clock, offset], device=device)

    steps = step_by_step(specialized, step)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if bend not in state.beside:
            state.beside[bend] = make_fields(specialized, state)
        fields = state.beside[bend]
        fields.units, fields.moving, fields.wave = state.units, state.moving, state.wave
        if start == 0:  # what hangs on the plates is at rest
            fields.hung.zero_()
            fields.push.zero_()
        steps(state, plates, start, stop)

    return advance


def resident_path(specialized: Specialized) -> Advance:
    """All steps in one launch: plates shared among the cores on CPU, a block a plate on CUDA."""
    return _blocks(specialized) if specialized.device.is_cuda else _threads(specialized)


def _blocks(specialized: Specialized) -> Advance:
    """Compiled twice, for few plates and for many, where the two differ."""
    (nx, ny), device, hanging = specialized.scheme.nodes, specialized.device, len(specialized.scene.effects.oscillators)
    few_plan, many_plan = (
        general_plan.plan(nx, ny, specialized.real, specialized.effects, hanging, few) for few in (True, False)
    )
    many = blocks_path(specialized, many_plan)
    few = many if few_plan == many_plan else blocks_path(specialized, few_plan)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        (few if plates <= device.sm_count else many)(state, plates, start, stop)

    return advance


def blocks_path(specialized: Specialized, blocks: general_plan.Blocks) -> Advance:
    """A block a plate, shared among its threads as ``blocks`` says."""
    (nx, ny), stride, device, real = specialized.scheme.nodes, specialized.stride, specialized.device, specialized.real
    effects, hanging = specialized.effects, len(specialized.scene.effects.oscillators)
    kernel = general_blocks.make_run(effects, real, nx, ny, stride, hanging, blocks)
    wp.load_module(module=kernel.module, device=device, block_dim=blocks.threads)
    material = material_of(specialized)
    named = {name: getattr(material, name).numpy() for name in general_plan.SHARED if name != "press"}
    named["press"] = named["mobility"] / named["weight"]

    def lines(planes: list[np.ndarray]) -> wp.array:
        """(planes, threads × nodes), node after node without padding between rows."""
        values = np.zeros((len(planes), blocks.threads * blocks.nodes))
        for line, plane in zip(values, planes, strict=True):
            line[: nx * ny] = np.pad(plane, ((0, ny - plane.shape[0]), (0, nx - plane.shape[1]))).ravel()
        return specialized.to_device(values)

    shared = [material, lines([named[name] for name in general_plan.used(effects)])]
    shared += [lines(list(material.holds.numpy())), wp.vec2i(*specialized.scheme.window)]
    room_size = 0 if blocks.on_chip else general_plan.layout(nx, hanging, blocks)["end"]

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        if kernel not in state.beside:
            shapes = (state.capacity, room_size), (state.capacity, hanging, 2)
            state.beside[kernel] = [wp.zeros(shape, dtype=real, device=device) for shape in shapes]
        room, hung = state.beside[kernel]
        if start == 0:  # at rest; all plates of a chunk begin together
            hung.zero_()
        inputs = [*shared, start, stop, state.wave, state.units, state.moving, state.inner_nodes, state.loads]
        outputs = [room, state.u, state.rate, state.squares, hung, state.trace]
        dim, threads = plates * blocks.threads, blocks.threads
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device, block_dim=threads)

    return advance


def _threads(specialized: Specialized) -> Advance:
    device, real, rows, stride = specialized.device, specialized.real, specialized.rows, specialized.stride
    ny = specialized.scheme.nodes[1]
    kernel = general_cpu.make_run(specialized.effects, real, ny, stride, compiler_flags())
    wp.load_module(module=kernel.module, device=device)
    material, hanging = material_of(specialized), len(specialized.scene.effects.oscillators)
    numbers = [material.aspect, material.root_aspect, material.tension_x, material.tension_y]
    numbers += [material.retardation, material.stretching, material.stretch_ratio]
    strength, along_x, along_y = _travel(specialized)
    along_x = np.pad(along_x, ((0, 0), (0, stride - along_x.shape[1])))
    travel = map(specialized.to_device, (strength, along_x, along_y))
    planes = _planes(specialized, material)
    shared: list[Any] = [*travel, wp.vec2i(*specialized.scheme.window), *numbers]
    holds = np.array([_padded(specialized, one) for one in material.holds.numpy()]).reshape(-1, rows, stride)
    shared += [material.oscillators, specialized.to_device(holds)]
    # A pass reads a node beyond the last row of its plane.
    room = wp.zeros((specialized.threads + 1, len(general_cpu.ROOM), rows, stride), dtype=real, device=device)
    hung: wp.array = wp.zeros((0, hanging, 2), dtype=real, device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        nonlocal hung
        if start == 0:  # at rest; all plates of a chunk begin together
            hung = wp.zeros((state.capacity, hanging, 2), dtype=real, device=device)

        def share(thread: int, first: int, last: int) -> Callable[[], None]:
            inputs = [planes, state.wave, *shared, state.units, state.moving, start, stop, first, thread]
            inputs += [state.nodes, state.loads]
            outputs = [room, state.u, state.rate, state.squares, hung, state.trace]
            return lambda: wp.launch(kernel, dim=last - first, inputs=inputs, outputs=outputs, device=device)

        shared_among_threads(specialized.threads, plates, share)

    return advance


def _padded(specialized: Specialized, values: np.ndarray) -> np.ndarray:
    """(rows, stride) of (ny, nx) or less, zeros around."""
    plane = np.zeros((specialized.rows, specialized.stride))
    plane[1 : 1 + values.shape[0], : values.shape[1]] = values
    return plane


def _planes(specialized: Specialized, material: Any) -> wp.array:
    """(len(SHARED), rows, stride) what ``general_cpu`` reads for each node."""
    nx, ny = specialized.scheme.nodes
    inner_x, inner_y = (np.ones(count) for count in (nx, ny))
    low_x, high_x, low_y, high_y = inner_x.copy(), inner_x.copy(), inner_y.copy(), inner_y.copy()
    for low, high in ((low_x, high_x), (low_y, high_y)):
        low[[0, -1]], high[[0, -1]] = (0, 2), (2, 0)
    twice_x, twice_y = inner_x.copy(), inner_y.copy()
    twice_x[[0, -1]] = twice_y[[0, -1]] = 2
    own = {name: getattr(material, name).numpy() for name in ("mobility", "weight")}
    planes = {
        "west": np.outer(inner_y, low_x),
        "east": np.outer(inner_y, high_x),
        "south": material.aspect * np.outer(low_y, inner_x),
        "north": material.aspect * np.outer(high_y, inner_x),
        "cells": np.outer(twice_y, twice_x),
        "press": own["mobility"] / own["weight"],
    }
    values = [planes[name] if name in planes else getattr(material, name).numpy() for name in general_cpu.SHARED]
    return specialized.to_device(np.stack([_padded(specialized, plane) for plane in values]))
