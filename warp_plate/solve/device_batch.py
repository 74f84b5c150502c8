"""Batches whose drives and energies stay on the device, in arrays of any library that has DLPack."""

from __future__ import annotations

import numpy as np
import warp as wp

from warp_plate.kernels.energy import write_energies
from warp_plate.kernels.load import make_scale_drives
from warp_plate.scene.errors import SceneError
from warp_plate.solve.batching import LARGEST_DRIVE, SMALLEST_DRIVE, Batch, energy_unit
from warp_plate.solve.engine import Engine
from warp_plate.solve.state import State

# Exceptions of producers and Warp for arrays that cannot be shared.
REFUSALS = (AttributeError, BufferError, IndexError, RuntimeError, TypeError, ValueError)


class DeviceBatch(Batch):
    """A batch under drives that are on the device.

    Args:
        drives: (plates, actuators, 2) Re Z and Im Z, float32 or float64.
    """

    def __init__(self, engine: Engine, state: State, drives: wp.array) -> None:
        super().__init__(engine, state, len(drives))
        specialized = engine.specialized
        moving, device = specialized.discretization.moving, specialized.device
        least = moving.largest if moving else 0.0
        state.wave = state.shared_wave
        self._scale = wp.empty(self.plates, dtype=wp.float64, device=device)
        wp.launch(
            make_scale_drives(specialized.real, drives.dtype),
            dim=self.plates,
            inputs=[drives, specialized.drive_factors, least, SMALLEST_DRIVE, LARGEST_DRIVE]
            + [specialized.scheme.load_scale],
            outputs=[state.coefficients, self._scale, state.units, state.moving],
            device=device,
        )
        engine.write_loads(state, self.plates)
        state.clear(self.plates)

    def write_energies(self, energy: wp.array) -> None:
        """Write the energies (plates, regions) [J] of the window's steps so far, NaN for faulty plates."""
        specialized = self.engine.specialized
        if (self.grown >= 0).any():
            self._scale.assign(np.where(self.grown >= 0, np.nan, self._scale.numpy()))
        self.engine.sum_regions(self.state, self.plates)
        inputs = [self.state.energy, self._scale, energy_unit(specialized), self.largest_sum]
        wp.launch(write_energies, dim=self.plates, inputs=inputs, outputs=[energy], device=specialized.device)


def import_drives(drives: object, actuators: int, device: wp.Device) -> wp.array:
    """Return drives as a Warp array (plates, actuators, 2) over the same memory, which the array keeps alive.

    Warp's current stream of the device waits for what the producer has queued on its own.

    Raises:
        SceneError: They are no such array of float32 or float64, or on another device.
    """
    right = f"write Re Z and Im Z as (plates, {actuators}, 2) of float32 or float64"
    try:
        pairs = wp.from_dlpack(drives)
    except REFUSALS as error:
        raise SceneError(f"drives: not an array for a device ({' '.join(str(error).split())}); {right}") from None
    if not isinstance(pairs, wp.array) or pairs.dtype not in (wp.float32, wp.float64):
        raise SceneError(f"drives: an array of {pairs.dtype.__name__}; {right}")
    if pairs.ndim != 3 or pairs.shape[1:] != (actuators, 2):
        raise SceneError(f"drives: shape {pairs.shape}; {right}")
    if pairs.device != device:
        raise SceneError(f"drives: on {pairs.device}, but the solver is on {device}; make both on one device")
    return pairs
