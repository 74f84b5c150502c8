"""Waves and actuator places that differ from plate to plate, computed on the device."""

from __future__ import annotations

import numpy as np
import warp as wp

from warp_plate.kernels.load import make_weigh_spans, make_write_placed_loads
from warp_plate.kernels.wave import Envelope, make_accumulate_waves, make_write_tones
from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.signals import waves_per_plate
from warp_plate.plate.weights import CUBICS, node_positions
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State

# Most numbers of waves that the host computes at once.
HOST_NUMBERS = 2**24


class PerPlateKernels:
    """The kernels that ``specialized.discretization.per_plate`` needs, compiled or loaded from Warp's cache."""

    def __init__(self, specialized: Specialized) -> None:
        scene, real = specialized.scene, specialized.real
        self._specialized = specialized
        self._write_tones = make_write_tones(real, scene.drive.burst is not None)
        self._accumulate_waves = make_accumulate_waves(real)
        self._weigh_spans = make_weigh_spans(scene.grid.load == "moments")
        self._write_placed_loads = make_write_placed_loads(real)
        if specialized.discretization.carriers:
            specialized.load(self._write_tones, self._accumulate_waves)
        if specialized.discretization.per_plate.centre:
            specialized.load(self._weigh_spans, self._write_placed_loads)
        self._positions = [self._doubles(axis) for axis in node_positions(scene)]
        self._share = self._doubles(specialized.share)

    def _doubles(self, values: np.ndarray) -> wp.array:
        return wp.array(values, dtype=wp.float64, device=self._specialized.device)

    def put_waves(self, state: State, values: PerPlateValues) -> np.ndarray:
        """Write the waves of a run: tones on the device; sweeps, and squares of voltages, on the host.

        Returns:
            (1 or plates, terms) powers of two by which the waves are divided.
        """
        specialized = self._specialized
        if values.frequency is None:
            state.wave = state.shared_wave
            return specialized.sizes[None]
        state.wave = state.plate_waves
        drive = specialized.scene.drive
        put = self._put_tones if drive.chirp is None and drive.electrostatic is None else self._put_host_waves
        put(state, values.frequency, values.delay)
        terms, device = specialized.effects.terms, specialized.device
        if specialized.quantity == "velocity":
            return np.ones((1, terms))
        sizes = wp.zeros((len(values.frequency), terms), dtype=wp.float64, device=device)
        wp.launch(self._accumulate_waves, sizes.shape, inputs=[state.plate_waves], outputs=[sizes], device=device)
        return np.asarray(sizes.numpy())

    def _put_tones(self, state: State, frequency: np.ndarray, delay: np.ndarray | None) -> None:
        scheme, burst, envelope = self._specialized.scheme, self._specialized.scene.drive.burst, Envelope()
        if burst is not None:
            envelope.duration, envelope.ramp, envelope.period = burst.duration, burst.ramp, burst.period or 0.0
        delay = np.zeros_like(frequency) if delay is None else delay
        wp.launch(
            self._write_tones,
            dim=(len(frequency), scheme.steps, self._specialized.discretization.carriers),
            inputs=[self._doubles(frequency), self._doubles(delay), scheme.time_step, envelope],
            outputs=[state.plate_waves],
            device=self._specialized.device,
        )

    def _put_host_waves(self, state: State, frequency: np.ndarray, delay: np.ndarray | None) -> None:
        scene, scheme = self._specialized.scene, self._specialized.scheme
        block = max(1, HOST_NUMBERS // (scheme.steps * self._specialized.effects.terms))
        for first in range(0, len(frequency), block):
            some = slice(first, min(first + block, len(frequency)))
            delays = None if delay is None else delay[some]
            waves = waves_per_plate(scene, scheme.time_step, scheme.steps, frequency[some], delays)
            state.plate_waves[some].assign(waves.astype(scene.grid.precision))

    def put_places(self, state: State, edges: np.ndarray) -> tuple[wp.Kernel, list[wp.array]]:
        """Compute the weights of patches with ``edges`` (plates, actuators, 4) [m].

        Returns:
            The kernel of their load fields, and its inputs after the coefficients.
        """
        device, rectangles = self._specialized.device, self._doubles(edges)
        to_weights = wp.mat44d(*np.linalg.inv(CUBICS).ravel().tolist())
        for first, positions, along in zip((0, 2), self._positions, (state.along_x, state.along_y), strict=True):
            inputs = [rectangles, first, positions, to_weights]
            wp.launch(self._weigh_spans, edges.shape[:2], inputs=inputs, outputs=[along], device=device)
        return self._write_placed_loads, [self._specialized.support, self._share, state.along_x, state.along_y]
