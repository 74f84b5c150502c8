"""Quadratic forms of the motion of a plate: energies, sound and power of its drives, by name."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from warp_plate.modal.coils import feeding
from warp_plate.modal.gram import Means, ToneMatrices, real_form
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import WeightedSound
from warp_plate.scene.model import Scene

# Derivatives by time of the displacement in each form of a region, and the index of the region.
REGIONAL = {"plate": (1, 0), "target": (1, 1), "displacement": (0, 1), "acceleration": (2, 1)}


class PlateForms:
    """Quadratic forms of unit drives of a plate at the tone of its scene, by name, as means over the window or, in a
    ``steady`` state, over all time:

        plate, target    kinetic energy [J], without that of what is attached
        displacement     ½ ∫ ρH u² dA of the target [J s²]
        acceleration     ½ ∫ ρH ü² dA of the target [J/s²], in a steady state, as all that follow
        sound            A-weighted sound power [W]
        power            power that drives feed, of coils the electrical one [W]

    Attributes:
        plate: Modes that the motion is a sum of.
        window: Window of a plate that starts from rest; None in a steady state.
    """

    def __init__(self, plate: ModalPlate, steady: bool = False) -> None:
        self.plate, self.window = plate, None if steady or plate.scene.steady else plate.scene.window
        self._omega = plate.scene.drive.angular_frequency
        self._forms: dict[str, np.ndarray] = {}

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.plate.scene

    @cached_property
    def _regions(self) -> np.ndarray:
        return np.stack([self.plate.kinetic_matrix(), self.plate.kinetic_matrix(self.scene.target)])

    @cached_property
    def _forces(self) -> np.ndarray:
        return self.plate.actuator_forces()

    @cached_property
    def _amplitudes(self) -> np.ndarray:
        """(modes, M) steady response to unit drives."""
        frequency = np.full((1, self._forces.shape[1]), self.scene.drive.frequency)
        return self.plate.respond_to_drives(frequency, self._forces[None])[0]

    @cached_property
    def _radiating(self) -> np.ndarray:
        """(rows, modes) F of the A-weighted sound ½ ‖F q̇‖² [W]."""
        return WeightedSound(self.plate, self.scene.drive.frequency).factor(self.scene.drive.frequency)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the (2M, 2M) matrix of a form, see :mod:`warp_plate.modal.gram`."""
        if name not in self._forms:
            self._forms[name] = self._from_rest_form(name) if self.window is not None else self._steady_form(name)
        return self._forms[name]

    def _from_rest_form(self, name: str) -> np.ndarray:
        order, region = REGIONAL[name]
        means = Means(self.plate, [self._regions[region]], self.window, velocity=order == 1)
        frequency = np.full((1, self._forces.shape[1]), self.scene.drive.frequency)
        return np.asarray(ToneMatrices(means).matrices(frequency, self._forces[None])[0, 0])

    def _steady_form(self, name: str) -> np.ndarray:
        if name == "power":
            own, fed = feeding(self.scene, self._omega)
            mixed = np.diag(own) + fed[:, None] * (self._forces.T @ self._amplitudes)
            mixed = mixed + mixed.conj().T
        elif name == "sound":
            rows = self._omega * self._radiating @ self._amplitudes
            mixed = 2 * rows.conj().T @ rows
        else:
            order, region = REGIONAL[name]
            motion = self._omega**order * self._amplitudes
            mixed = motion.conj().T @ (self._regions[region] @ motion)
        return real_form(np.zeros_like(mixed), mixed)
