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

import numpy as np

from warp_plate.modal.energy import mean_exponential, real_form, times
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import make_poles
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
        self.poles = np.empty(0, dtype=complex)
        self.shapes = np.empty((len(plate.frequencies), 0), dtype=complex)
        self.inputs = self.shapes.T
        if window is not None:
            self._prepare_free_motion(window)

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
        block = max(1, BLOCK_NUMBERS // (len(self.plate.frequencies) + self.poles.size) // phasors.shape[1])
        for first in range(0, len(phasors), block):
            rows = slice(first, first + block)
            loads = forces[rows] if len(forces) > 1 else forces
            energy[rows] = self._of_block(phasors[rows], frequency[rows], loads)
        return energy

    def _of_block(self, phasors: np.ndarray, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        drive, free = 2j * math.pi * frequency, None
        if self.window is not None:
            start = (self.inputs @ forces) / (drive[:, None, :] - self.poles[:, None])
            free = -(start @ phasors[:, :, None])[:, :, 0]
            free = free * self.poles if self.quantity == "velocity" else free
        if (frequency == frequency[:, :1]).all():  # one tone a plate
            forces, phasors, drive = forces @ phasors[:, :, None], np.ones((len(phasors), 1)), drive[:, :1]
        forced = self._forced(forces, drive) * phasors[:, None, :]
        forced = forced * drive[:, None, :] if self.quantity == "velocity" else forced
        energies = []
        for region, pairs in zip(self.regions, self._pairs(), strict=True):
            moved = times(region, forced)
            if self.window is None:
                same = drive[:, :, None] == drive[:, None, :]
                energies.append(((forced.conj().mT @ moved) * same).sum(axis=(1, 2)).real / 4)
                continue
            assert free is not None
            total = np.zeros(len(phasors))
            for form, first, turn, amplitude in (
                (pairs[0], forced, drive, free),
                (pairs[1], forced.conj(), drive.conj(), free.conj()),
            ):
                means = mean_exponential(turn[:, :, None], drive[:, None, :], self.window)
                total += ((first.mT @ moved) * means).sum(axis=(1, 2)).real
                across = (first.mT @ pairs[2]) * mean_exponential(turn[:, :, None], self.poles, self.window)
                total += 2 * np.einsum("nkp,np->n", across, free, optimize=True).real
                total += ((amplitude @ form) * free).sum(axis=1).real
            energies.append(total / 4)
        return np.stack(energies, axis=1)

    def _forced(self, forces: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """Return (plates, modes, M) amplitudes of the forced motion."""
        plate = self.plate
        if plate.proportional:
            stiffness = (plate.angular_frequencies**2 + 1j * np.diag(plate.hysteretic))[:, None]
            turn = drive[:, None, :]
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(forces / (stiffness + turn * np.diag(plate.damping)[:, None] + turn**2))
        loads = np.moveaxis(np.broadcast_to(forces, (len(drive), *forces.shape[1:])), 1, 0)
        forced, turns = np.empty(loads.shape, dtype=complex), drive.imag / (2 * math.pi)
        for turn in np.unique(turns):
            forced[:, turns == turn] = plate.respond(np.array([turn]), loads[:, turns == turn])[0]
        return np.moveaxis(forced, 0, 1)

    def _pairs(self) -> list[tuple[np.ndarray, ...]]:
        return self._free_pairs if self.window is not None else [()] * len(self.regions)

    def _prepare_free_motion(self, window: Window) -> None:
        """Compute what free motions contribute, of those that last into the window."""
        poles = make_poles(self.plate, window.end)
        loads = np.abs(poles.inputs @ self._trial_forces()).max(axis=1)
        size = loads * np.linalg.norm(poles.vectors, axis=0) * np.exp(poles.values.real * window.start)
        kept = np.flatnonzero(size**2 > DECAYED * (loads**2 * np.linalg.norm(poles.vectors, axis=0) ** 2).max())
        self.poles, self.shapes, self.inputs = poles.values[kept], poles.vectors[:, kept], poles.inputs[kept]
        self._free_pairs = []
        means = [mean_exponential(first[:, None], self.poles, window) for first in (self.poles, self.poles.conj())]
        for region in self.regions:
            moved = times(region, self.shapes)
            forms = [
                first.T @ moved * mean for first, mean in zip((self.shapes, self.shapes.conj()), means, strict=True)
            ]
            self._free_pairs.append((*forms, moved))

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
        poles = make_poles(self.plate, window.end)
        count = len(self.plate.frequencies)
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
