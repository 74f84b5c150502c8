"""Energies of many plates under tones, from the matrices that all of them share.

As :mod:`warp_plate.modal.energy`, for plates that differ in drives, frequencies and places: here the drive of a plate
is known, so that its motion is one sum of exponentials, and what depends on free motions alone is computed once. With
v the complex rates, E = ¼ Re⟨vᵀ G v⟩ + ¼ ⟨v̄ᵀ G v⟩.

At one frequency of all plates and actuators the energy is a quadratic form of the modal forces. Where damping does not
couple the modes, each moves as a function of time of its own, q_r = f_r m_r(t), and with plain and conjugate means the
form has the blocks ½ G_rs ⟨Re ṁ_r Re ṁ_s⟩ and so on. It is factored once, E = |L f|², and a plate costs one product.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from warp_plate.modal.energy import mean_exponential, real_form
from warp_plate.modal.modes import ModalPlate, times
from warp_plate.modal.poles import Poles, make_poles
from warp_plate.scene.model import Window

# Directions of the modal forces that add less than this part of the largest energy are left out.
NEGLIGIBLE = 1e-8
# Free motions that after the start of the window have less than this part of the largest energy are left out.
DECAYED = 1e-8
# Places along each side at which forces are tried to see what counts.
PLACES = 8
BLOCK_NUMBERS = 2**22


class ToneEnergies:
    """Energies of the regions of a plate under tones, from rest or steady.

    Args:
        plate: Modes.
        regions: Mass matrices (modes, modes) of the regions.
        window: Window of a plate that starts from rest; None for the steady state.
        quantity: "velocity" or "displacement".
    """

    def __init__(
        self, plate: ModalPlate, regions: Sequence[np.ndarray], window: Window | None, quantity: str = "velocity"
    ) -> None:
        self.plate, self.regions, self.window, self.quantity = plate, list(regions), window, quantity
        self._factors: dict[float, list[np.ndarray]] = {}

    def energies(self, phasors: np.ndarray, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return energies (plates, regions) [J].

        Args:
            phasors: (plates, M) drives.
            frequency: (plates, M) [Hz].
            forces: (plates or 1, modes, M) modal forces of the actuators' unit pressures.
        """
        common = frequency.size and (frequency == frequency[0, 0]).all()
        if common and self.plate.proportional and self.window is not None:
            loads = (forces @ phasors[:, :, None])[:, :, 0]
            numbers = np.concatenate([loads.real, -loads.imag], axis=1)
            return np.stack(
                [((numbers @ factor) ** 2).sum(axis=1) for factor in self._factors_at(float(frequency[0, 0]))], axis=1
            )
        energy = np.empty((len(phasors), len(self.regions)))
        block = max(1, BLOCK_NUMBERS // (2 * len(self.plate.frequencies)) // phasors.shape[1])
        for first in range(0, len(phasors), block):
            rows = slice(first, first + block)
            loads = forces[rows] if len(forces) > 1 else forces
            energy[rows] = self._of_block(phasors[rows], frequency[rows], loads)
        return energy

    def _of_block(self, phasors: np.ndarray, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        window, all_forces, all_phasors, own = self.window, forces, phasors, frequency
        if (frequency == frequency[:, :1]).all():  # one tone a plate
            forces, phasors, frequency = forces @ phasors[:, :, None], np.ones((len(phasors), 1)), frequency[:, :1]
        drive = 2j * math.pi * frequency
        forced = self.plate.respond_each(frequency, forces) * phasors[:, None, :]
        forced = forced * drive[:, None, :] if self.quantity == "velocity" else forced
        if window is None:
            same = frequency[:, :, None] == frequency[:, None, :]
            products = [forced.conj().mT @ times(region, forced) for region in self.regions]
            return np.stack([(product * same).sum(axis=(1, 2)).real / 4 for product in products], axis=1)
        poles, shared = self._free_motion
        start = (poles.inputs @ all_forces) / (2j * math.pi * own[:, None, :] - poles.values[:, None])
        free = -(start @ all_phasors[:, :, None])[:, :, 0]
        free = free * poles.values if self.quantity == "velocity" else free
        energies = []
        for region, (moved_shapes, *forms) in zip(self.regions, shared, strict=True):
            moved, total = times(region, forced), np.zeros(len(phasors))
            sides = (forced, drive, free), (forced.conj(), drive.conj(), free.conj())
            for form, (first, turn, amplitude) in zip(forms, sides, strict=True):
                means = mean_exponential(turn[:, :, None], drive[:, None, :], window)
                total += ((first.mT @ moved) * means).sum(axis=(1, 2)).real
                across = (first.mT @ moved_shapes) * mean_exponential(turn[:, :, None], poles.values, window)
                total += 2 * np.einsum("nkp,np->n", across, free, optimize=True).real
                total += ((amplitude @ form) * free).sum(axis=1).real
            energies.append(total / 4)
        return np.stack(energies, axis=1)

    @cached_property
    def _poles(self) -> Poles:
        assert self.window is not None
        return make_poles(self.plate, self.window.end)

    @cached_property
    def _free_motion(self) -> tuple[Poles, list[tuple[np.ndarray, ...]]]:
        """Free motions that last into the window; of each region G, Gψ, and ψᵀGψ and ψ̄ᵀGψ with their means."""
        assert self.window is not None
        loads = np.abs(self._poles.inputs @ self._trial_forces()).max(axis=1)
        begun = loads * np.linalg.norm(self._poles.vectors, axis=0)
        left = begun * np.exp(self._poles.values.real * self.window.start)
        poles = self._poles.part(np.flatnonzero(left**2 > DECAYED * (begun**2).max()))
        means = [
            mean_exponential(rate[:, None], poles.values, self.window) for rate in (poles.values, poles.values.conj())
        ]
        shared = []
        for region in self.regions:
            moved = poles.moved(region)
            forms = (poles.pressed(moved, bool(conjugate)) * mean for conjugate, mean in enumerate(means))
            shared.append((moved, *forms))
        return poles, shared

    def _trial_forces(self) -> np.ndarray:
        """Return (modes, trials) modal forces of the actuators at their places and all over the plate."""
        scene = self.plate.scene
        areas = np.array([actuator.area for actuator in scene.actuators])
        half = np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1) / 2
        parts = (np.arange(PLACES) + 0.5) / PLACES
        grid = np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 1, 2)
        centre = half + grid * (np.array(scene.plate.size) - 2 * half)
        tried = np.stack([centre - half, centre + half], axis=-1).reshape(-1, 4)
        return self.plate.patch_forces(np.concatenate([areas, tried]))

    def _factors_at(self, frequency: float) -> list[np.ndarray]:
        """Return L (2 modes, directions) of each region, for plates at rest before and proportional damping."""
        if frequency not in self._factors:
            assert self.window is not None
            forces = self._trial_forces()
            scale = np.tile(np.sqrt((forces**2).mean(axis=1)), 2)
            means = self._mode_means(2j * math.pi * frequency, self.window)
            factors = []
            for region in self.regions:
                form = real_form(*(region * mean for mean in means)) * np.outer(scale, scale)
                values, vectors = np.linalg.eigh(form)
                kept = values > NEGLIGIBLE * values[-1]
                factors.append(vectors[:, kept] * np.sqrt(values[kept]) / np.where(scale > 0, scale, 1)[:, None])
            self._factors = {frequency: factors}
        return self._factors[frequency]

    def _mode_means(self, drive: complex, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Return (modes, modes) ⟨ṁ_r ṁ_s⟩ and the same with the conjugate of the first."""
        poles, count = self._poles, len(self.plate.frequencies)
        weights = (poles.vectors**2).sum(axis=0)
        slow, fast = poles.values[:count], poles.values[count:]
        exponents = np.stack([np.full(count, drive), slow, fast])
        free = -weights.reshape(2, count) / (drive - exponents[1:])
        amplitudes = np.stack([-free.sum(axis=0), *free])
        if self.quantity == "velocity":
            amplitudes = amplitudes * exponents
        means = [np.zeros((count, count), dtype=complex) for _ in range(2)]
        for a, s in zip(amplitudes, exponents, strict=True):
            for b, t in zip(amplitudes, exponents, strict=True):
                means[0] += np.outer(a, b) * mean_exponential(s[:, None], t, window)
                means[1] += np.outer(a.conj(), b) * mean_exponential(s.conj()[:, None], t, window)
        return means[0], means[1]
