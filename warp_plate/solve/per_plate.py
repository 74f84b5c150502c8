"""What plates have of their own, beside drives, made on the device: their waves, and where their actuators press."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels.load import make_spread_moved_drives, make_weigh_along
from warp_plate.kernels.wave import Envelope, make_running_sums, make_tones
from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.signals import waves_per_plate
from warp_plate.plate.weights import CUBICS, node_positions
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State

# (state, values) → (1 or plates, terms) powers of two by which the waves are divided.
PutWaves = Callable[[State, PerPlateValues], np.ndarray]
# (state, edges (plates, actuators, 4) [m]): weighs the patches of the plates.
PutPlaces = Callable[[State, np.ndarray], None]
# Numbers that the host makes at once.
HOST_NUMBERS = 2**24


@dataclass(frozen=True)
class PerPlateKernels:
    """What a solver needs to give plates what is their own; compiled when it is made."""

    put_waves: PutWaves
    put_places: PutPlaces
    spread_moved_drives: wp.Kernel
    inputs: list[Any]


def make_per_plate_kernels(specialized: Specialized) -> PerPlateKernels:
    """Compile what ``specialized.discretization.per_plate`` asks for, or read it from Warp's cache."""
    spread = make_spread_moved_drives(specialized.real)
    if specialized.discretization.per_plate.centre:
        wp.load_module(module=spread.module, device=specialized.device)
    share: wp.array = wp.array(specialized.share, dtype=wp.float64, device=specialized.device)
    return PerPlateKernels(_waves(specialized), _places(specialized), spread, [specialized.support, share])


def _waves(specialized: Specialized) -> PutWaves:
    """Tones are made on the device; sweeps, and what squares of voltages make of tones, on the host."""
    scene, scheme, device = specialized.scene, specialized.scheme, specialized.device
    drive, burst = scene.drive, scene.drive.burst
    tones = make_tones(specialized.real, burst is not None)
    add_up = make_running_sums(specialized.real)
    if specialized.discretization.carriers:
        for kernel in (tones, add_up):
            wp.load_module(module=kernel.module, device=device)
    envelope = Envelope()
    if burst is not None:
        envelope.duration, envelope.ramp, envelope.period = burst.duration, burst.ramp, burst.period or 0.0
    on_device = drive.chirp is None and drive.electrostatic is None

    def put(state: State, values: PerPlateValues) -> np.ndarray:
        frequency, delay = values.frequency, values.delay
        if frequency is None:
            state.wave = state.shared_wave
            return specialized.sizes[None]
        state.wave, plates = state.plate_waves, len(frequency)
        if on_device:
            late = np.zeros_like(frequency) if delay is None else delay
            inputs: list[Any] = [wp.array(one, dtype=wp.float64, device=device) for one in (frequency, late)]
            wp.launch(
                tones,
                dim=(plates, scheme.steps, specialized.discretization.carriers),
                inputs=[*inputs, scheme.time_step, envelope],
                outputs=[state.plate_waves],
                device=device,
            )
        else:
            block = max(1, HOST_NUMBERS // (scheme.steps * specialized.discretization.signals.terms))
            for first in range(0, plates, block):
                some = slice(first, min(first + block, plates))
                made = waves_per_plate(
                    scene, scheme.time_step, scheme.steps, frequency[some], None if delay is None else delay[some]
                )
                state.plate_waves[some].assign(made.astype(scene.grid.precision))
        if specialized.quantity == "velocity":
            return np.ones((1, specialized.discretization.signals.terms))
        sizes = wp.zeros((plates, specialized.discretization.signals.terms), dtype=wp.float64, device=device)
        wp.launch(add_up, dim=sizes.shape, inputs=[state.plate_waves], outputs=[sizes], device=device)
        return np.asarray(sizes.numpy())

    return put


def _places(specialized: Specialized) -> PutPlaces:
    scene, device = specialized.scene, specialized.device
    weigh_along = make_weigh_along(scene.grid.load == "moments")
    if specialized.discretization.per_plate.centre:
        wp.load_module(module=weigh_along.module, device=device)
    positions: list[wp.array] = [wp.array(axis, dtype=wp.float64, device=device) for axis in node_positions(scene)]
    to_weights = wp.mat44d(*np.linalg.inv(CUBICS).ravel().tolist())

    def put(state: State, edges: np.ndarray) -> None:
        rectangles: wp.array = wp.array(edges, dtype=wp.float64, device=device)
        for first, axis, along in ((0, positions[0], state.along_x), (2, positions[1], state.along_y)):
            inputs = [rectangles, first, axis, to_weights]
            wp.launch(weigh_along, dim=edges.shape[:2], inputs=inputs, outputs=[along], device=device)

    return put
