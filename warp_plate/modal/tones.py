"""Gram matrices of plates under tones that start from rest, with shared work for all plates.

As :mod:`warp_plate.modal.energy`, for plates that differ in frequencies and places. What depends on free motions alone
is computed once, with those that last into the window wherever actuators are: so no plate depends on its neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy

from warp_plate.modal.energy import lasting_poles, mean_exponential, real_form
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles
from warp_plate.modal.steady import as_sparse, multiply_modes
from warp_plate.plate.designs import actuator_spaces, per_plate_of
from warp_plate.plate.signals import actuator_frequencies
from warp_plate.scene.model import Window

# Places along each side at which forces are tried to see which free motions count.
PLACES = 8
# Numbers in a block of plates that are computed at once.
BLOCK_NUMBERS = 2**20


class ToneMatrices:
    """Gram matrices of the regions of a plate under tones that start from rest.

    Args:
        plate: Modes.
        regions: Mass matrices (modes, modes) of the regions.
        window: Window of the energies.
        quantity: "velocity" or "displacement".
    """

    def __init__(
        self, plate: ModalPlate, regions: Sequence[np.ndarray], window: Window, quantity: str = "velocity"
    ) -> None:
        self.plate, self.regions, self.window, self.quantity = plate, list(regions), window, quantity

    def matrices(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (plates, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²].

        Args:
            frequency: (plates, M) [Hz].
            forces: (plates or 1, modes, M) modal forces of the actuators' unit pressures.
        """
        matrices, block = [], max(1, BLOCK_NUMBERS // (forces.shape[1] * frequency.shape[1]))
        for first in range(0, len(frequency), block):
            rows = slice(first, first + block)
            matrices.append(self._block_matrices(frequency[rows], forces[rows] if len(forces) > 1 else forces))
        return np.concatenate(matrices)

    def _block_matrices(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        plates = max(len(frequency), len(forces))
        if (frequency == frequency[:, :1]).all():  # means of one tone serve all actuators, and all plates
            frequency = frequency[:, :1] if (frequency != frequency[0]).any() else frequency[:1, :1]
        window, drive = self.window, self.poles.shift_rates(2j * math.pi * frequency, self.window.end)
        states, gains = 1 / (drive[:, None, :] - self.poles.values[:, None]), self.poles.gains(forces)
        forced, free = self.poles.forced(states, forces, gains), -(gains * states)[:, self.kept]
        poles = self.poles.part(self.kept)
        if self.quantity == "velocity":
            forced, free = forced * drive[:, None, :], free * poles.values[:, None]
        turns = drive, drive.conj()
        of_tones = [mean_exponential(turn[:, :, None], drive[:, None, :], window) for turn in turns]
        across = [mean_exponential(turn[:, None, :], poles.values[:, None], window) for turn in turns]
        matrices = []
        for region, forms in zip(self._sparse_regions, self._free_forms, strict=True):
            moved = multiply_modes(region, forced)
            pressed = poles.project(moved), poles.project(moved, conjugate=True).conj()
            crossed = [(inner * mean).mT @ free for inner, mean in zip(pressed, across, strict=True)]
            alone = [multiply_modes(form, free) for form in forms]
            plain = (forced.mT @ moved) * of_tones[0] + crossed[0] + crossed[0].mT + free.mT @ alone[0]
            mixed = (forced.conj().mT @ moved) * of_tones[1]
            mixed = mixed + crossed[1] + crossed[1].conj().mT + free.conj().mT @ alone[1]
            matrices.append(real_form(plain, mixed))
        shape = (plates, len(matrices), *matrices[0].shape[1:])
        return np.broadcast_to(np.stack(matrices, axis=1), shape)

    @cached_property
    def _sparse_regions(self) -> list[np.ndarray | scipy.sparse.csr_array]:
        return [as_sparse(region) for region in self.regions]

    @cached_property
    def poles(self) -> Poles:
        """Poles of the plate, for times up to the end of the window."""
        return self.plate.poles(self.window.end)

    @cached_property
    def kept(self) -> np.ndarray:
        """Indices of the poles whose free motions matter in the window, for any places of actuators."""
        scene, poles, end = self.plate.scene, self.poles, self.window.end
        searched = scene.search.frequency
        tones = {*actuator_frequencies(scene).tolist(), *(searched.range if searched is not None else ())}
        drive = poles.shift_rates(2j * math.pi * np.array(sorted(tones))[:, None], end)
        forced = 1 / (drive[:, None, :] - poles.values[:, None])
        free, velocity = -forced, self.quantity == "velocity"
        if velocity:
            forced, free = forced * drive[:, None, :], free * poles.values[:, None]
        gains = poles.gains(trial_forces(self.plate))[None]
        return lasting_poles(poles, gains, free, forced[..., None], drive[..., None], self.window, end, velocity)

    @cached_property
    def _free_forms(self) -> list[list[np.ndarray | scipy.sparse.csr_array]]:
        """ψᵀGψ and ψ̄ᵀGψ times the means of the free motions' products, of each region G."""
        poles, forms = self.poles.part(self.kept), []
        rates = poles.values, poles.values.conj()
        means = [mean_exponential(rate[:, None], poles.values, self.window) for rate in rates]
        for region in self.regions:
            moved = poles.observe(region)
            products = [poles.project(moved, bool(conjugate)) * mean for conjugate, mean in enumerate(means)]
            forms.append([as_sparse(product) for product in products])
        return forms


def trial_forces(plate: ModalPlate) -> np.ndarray:
    """Return (modes, trials) modal forces of the actuators where they are, and wherever a search may place them."""
    scene = plate.scene
    if scene.piezo:
        return plate.actuator_forces()
    areas = np.array([actuator.area for actuator in scene.actuators])
    half = np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1) / 2
    spaces = actuator_spaces(scene, per_plate_of(scene))
    low, high = spaces[:, [0, 2]] + half, spaces[:, [1, 3]] - half
    parts = (np.arange(PLACES) + 0.5) / PLACES
    centre = low + np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 1, 2) * (high - low)
    placed = np.stack([centre - half, centre + half], axis=-1).reshape(-1, 4)
    return plate.patch_forces(np.unique(np.concatenate([areas, placed]).round(9), axis=0))
