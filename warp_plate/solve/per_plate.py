"""Waves and actuator places that differ from plate to plate, computed on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels.load import make_weigh_spans, make_write_placed_loads
from warp_plate.kernels.wave import Envelope, make_accumulate_waves, make_write_tones
from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.signals import waves_per_plate
from warp_plate.plate.weights import CUBICS, node_positions
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State

# (state, values) → (1 or plates, terms) powers of two by which the waves are divided.
PutWaves = Callable[[State, PerPlateValues], np.ndarray]
# (state, edges (plates, actuators, 4) [m]): compute the weights of the plates' patches.
PutPlaces = Callable[[State, np.ndarray], None]
# Most numbers of waves that the host computes at once.
HOST_NUMBERS = 2**24


@dataclass(frozen=True)
class PerPlateKernels:
    """Compiled kernels for what differs from plate to plate.

    Attributes:
        put_waves: Writes the waves of a run.
        put_places: Writes the weights of patches.
        write_placed_loads: Kernel of the load fields of such patches.
        inputs: Its second and third argument.
    """

    put_waves: PutWaves
    put_places: PutPlaces
    write_placed_loads: wp.Kernel
    inputs: list[Any]


def make_per_plate_kernels(specialized: Specialized) -> PerPlateKernels:
    """Compile the kernels that ``specialized.discretization.per_plate`` needs, or load them from Warp's cache."""
    write_placed_loads = make_write_placed_loads(specialized.real)
    if specialized.discretization.per_plate.centre:
        wp.load_module(module=write_placed_loads.module, device=specialized.device)
    share: wp.array = wp.array(specialized.share, dtype=wp.float64, device=specialized.device)
    inputs = [specialized.support, share]
    return PerPlateKernels(_make_put_waves(specialized), _make_put_places(specialized), write_placed_loads, inputs)


def _make_put_waves(specialized: Specialized) -> PutWaves:
    """Return the writer of waves: tones on the device; sweeps, and squares of voltages, on the host."""
    scene, scheme, device = specialized.scene, specialized.scheme, specialized.device
    drive, burst = scene.drive, scene.drive.burst
    carriers, terms = specialized.discretization.carriers, specialized.discretization.signals.terms
    write_tones = make_write_tones(specialized.real, burst is not None)
    accumulate_waves = make_accumulate_waves(specialized.real)
    if carriers:
        for kernel in (write_tones, accumulate_waves):
            wp.load_module(module=kernel.module, device=device)
    envelope = Envelope()
    if burst is not None:
        envelope.duration, envelope.ramp, envelope.period = burst.duration, burst.ramp, burst.period or 0.0
    on_device = drive.chirp is None and drive.electrostatic is None

    def put_on_device(state: State, frequency: np.ndarray, delay: np.ndarray | None) -> None:
        tones = (frequency, np.zeros_like(frequency) if delay is None else delay)
        inputs: list[Any] = [wp.array(values, dtype=wp.float64, device=device) for values in tones]
        wp.launch(
            write_tones,
            dim=(len(frequency), scheme.steps, carriers),
            inputs=[*inputs, scheme.time_step, envelope],
            outputs=[state.plate_waves],
            device=device,
        )

    def put_from_host(state: State, frequency: np.ndarray, delay: np.ndarray | None) -> None:
        block = max(1, HOST_NUMBERS // (scheme.steps * terms))
        for first in range(0, len(frequency), block):
            some = slice(first, min(first + block, len(frequency)))
            delays = None if delay is None else delay[some]
            waves = waves_per_plate(scene, scheme.time_step, scheme.steps, frequency[some], delays)
            state.plate_waves[some].assign(waves.astype(scene.grid.precision))

    def put_waves(state: State, values: PerPlateValues) -> np.ndarray:
        if values.frequency is None:
            state.wave = state.shared_wave
            return specialized.sizes[None]
        state.wave = state.plate_waves
        (put_on_device if on_device else put_from_host)(state, values.frequency, values.delay)
        if specialized.quantity == "velocity":
            return np.ones((1, terms))
        sizes = wp.zeros((len(values.frequency), terms), dtype=wp.float64, device=device)
        wp.launch(accumulate_waves, dim=sizes.shape, inputs=[state.plate_waves], outputs=[sizes], device=device)
        return np.asarray(sizes.numpy())

    return put_waves


def _make_put_places(specialized: Specialized) -> PutPlaces:
    scene, device = specialized.scene, specialized.device
    weigh_spans = make_weigh_spans(scene.grid.load == "moments")
    if specialized.discretization.per_plate.centre:
        wp.load_module(module=weigh_spans.module, device=device)
    positions: list[wp.array] = [wp.array(axis, dtype=wp.float64, device=device) for axis in node_positions(scene)]
    to_weights = wp.mat44d(*np.linalg.inv(CUBICS).ravel().tolist())

    def put_places(state: State, edges: np.ndarray) -> None:
        rectangles: wp.array = wp.array(edges, dtype=wp.float64, device=device)
        for first, axis, along in ((0, positions[0], state.along_x), (2, positions[1], state.along_y)):
            inputs = [rectangles, first, axis, to_weights]
            wp.launch(weigh_spans, dim=edges.shape[:2], inputs=inputs, outputs=[along], device=device)

    return put_places
