"""Mean energies of regions of a plate by its modes: values, Gram matrices and slopes, of one design or of many.

Energies over a window are quadratic forms of the drives, whose matrices are exact in time under tones and bursts
(:mod:`warp_plate.modal.gram`) and by Gauss's rule otherwise (:mod:`warp_plate.modal.quadrature`), as in batches of
bursts. Slopes are formulas (:mod:`warp_plate.modal.slopes`). Batches of tones are computed on a CUDA device where there
is one (:mod:`warp_plate.modal.device_tones`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.modal.assemble import rectangular
from warp_plate.modal.gram import Means, ToneMatrices, gram_matrices
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.motion import make_excitation
from warp_plate.modal.quadrature import WaveformEnergies, quadrature_matrices
from warp_plate.modal.radiation import WeightedSound
from warp_plate.modal.slopes import EnergySlopes, energy_slopes
from warp_plate.optimize.quadratic import quadratic_forms, real_parts
from warp_plate.plate.signals import actuator_frequencies
from warp_plate.plate.weights import CoilRegion

if TYPE_CHECKING:
    import warp as wp

    from warp_plate.modal.device_tones import DeviceToneMatrices

# Numbers in a block of designs that are computed at once, which caches hold.
AMPLITUDES_AT_ONCE = 2**16


class ModalEnergies:
    """Mean energies of regions of a plate, by their mass matrices, over the scene's window or a period of the steady
    state.

    Designs differ in what their actuators have: frequency (designs, M) [Hz], areas (designs or 1, M, 4) x0, x1, y0, y1
    [m], and delay (designs, M), the starts of their bursts [s]. A quantity of "displacement" is ½ ∫ ρH u² dA. The
    device is for batches of designs under tones; everything else is computed on the CPU. Sounds and quantities of coils
    follow the regions.
    """

    def __init__(
        self,
        plate: ModalPlate,
        regions: Sequence[np.ndarray],
        quantity: str = "velocity",
        device: wp.Device | None = None,
        sounds: Sequence[WeightedSound] = (),
        coils: Sequence[CoilRegion] = (),
    ) -> None:
        self.plate, self.regions, self.quantity = plate, regions, quantity
        window = None if plate.scene.steady else plate.scene.window
        self._means = Means(plate, regions, window, quantity == "velocity", sounds, coils)
        on_device = device is not None and device.is_cuda and plate.proportional and plate.scene.outline is None
        on_device = on_device and rectangular(plate.scene) and not plate.scene.coil_indices
        on_device = on_device and plate.scene.effects.air is None and not sounds
        self._device = device if on_device else None
        self._tones = plate.scene.drive.waveform_key is None

    def scene_matrices(self) -> np.ndarray:
        """Return (regions, 2M, 2M) matrices of mean energies [J per (N/m²)²] at the scene's frequencies and places."""
        forces, frequency = self.plate.actuator_forces()[None], actuator_frequencies(self.plate.scene)[None]
        return self._matrices(frequency, forces)[0]

    def matrices(self, frequency: np.ndarray, areas: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Return (designs, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²] of designs."""
        if self._device is not None and self._tones:
            return self._device_tones.matrices(frequency, areas)
        forces = self._forces(areas)
        if not self._tones:
            return self._waveforms.matrices(frequency, forces, delay)
        block = max(1, AMPLITUDES_AT_ONCE // (forces.shape[1] * frequency.shape[1]))
        matrices = []
        for first in range(0, len(frequency), block):
            rows = slice(first, first + block)
            matrices.append(self._matrices(frequency[rows], forces[rows] if len(forces) > 1 else forces))
        return np.concatenate(matrices)

    def values(self, phasors: np.ndarray, frequency: np.ndarray, areas: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Return (designs, regions) energies [J] of designs under phasors (designs, M) [N/m²]."""
        if not self._tones:
            return self._waveforms.energies(phasors, frequency, self._forces(areas), delay)
        columns = real_parts(phasors)[:, None, :, None]
        return np.asarray((columns.mT @ self.matrices(frequency, areas, delay) @ columns)[:, :, 0, 0])

    def scene_values(self, phasors: np.ndarray) -> np.ndarray:
        """Return (drives, regions) energies [J] under phasors (drives, M) of the scene as it is, and its moving
        load."""
        scene = self.plate.scene
        if scene.linear:
            return quadratic_forms(self.scene_matrices(), phasors)
        excitation = make_excitation(self.plate, scene.window.end)
        matrices = quadrature_matrices(excitation, phasors, self.regions, scene.window, self._means.velocity)
        return np.diagonal(matrices, axis1=1, axis2=2).T.copy()

    def slopes(self, phasors: np.ndarray, frequency: np.ndarray, areas: np.ndarray, delay: np.ndarray) -> EnergySlopes:
        """Return energies of designs under phasors (designs, M), and their slopes; not of sweeps and files."""
        return energy_slopes(self._means, phasors, frequency, areas, delay)

    def _matrices(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        if self._means.window is not None and self._tones:
            return self._tone_matrices.matrices(frequency, forces)
        return gram_matrices(self._means, forces, frequency)

    def _forces(self, areas: np.ndarray) -> np.ndarray:
        """Return (designs or 1, modes, M) modal forces of the actuators' unit pressures."""
        forces = self.plate.drive_forces(areas)
        return np.moveaxis(forces.reshape(len(forces), *areas.shape[:2]), 0, 1)

    @cached_property
    def _tone_matrices(self) -> ToneMatrices:
        return ToneMatrices(self._means)

    @cached_property
    def _device_tones(self) -> DeviceToneMatrices:
        from warp_plate.modal.device_tones import DeviceToneMatrices  # declares kernels

        assert self._device is not None
        return DeviceToneMatrices(self._means, self._device)

    @cached_property
    def _waveforms(self) -> WaveformEnergies:
        return WaveformEnergies(self.plate, self.regions, self.quantity)
