"""Matrices of a plate on which its motion depends, and forms of its drives by name: energies, sound and power."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from warp_plate.modal.assemble import Galerkin, unit_loads
from warp_plate.modal.coils import coil_numbers, feeding
from warp_plate.modal.gram import Means, ToneMatrices, real_form
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import WeightedSound
from warp_plate.scene.model import Scene

# Derivatives by time of the displacement in each form of a region, and the index of the region.
REGIONAL = {"plate": (1, 0), "target": (1, 1), "displacement": (0, 1), "acceleration": (2, 1)}


@dataclass(frozen=True)
class PlateMatrices:
    """Matrices of a plate over its unknowns; or slopes of a number by their entries, for symmetric changes."""

    mass: np.ndarray  # (n, n) M [kg]
    bending: np.ndarray  # (n, n) B [N/m]
    support: np.ndarray  # (n, n) K − B [N/m]
    damping: np.ndarray  # (n, n) C without that of the material and of modes [N·s/m]
    regions: np.ndarray  # (2, n, n) mass of the plate without what is attached, and of the target [kg]
    forces: np.ndarray  # (n, M) loads of unit drives of the actuators, of 1 N of coils
    # (3, coils) numbers of :func:`warp_plate.modal.coils.coil_numbers`, of slopes their complex conjugates
    coils: np.ndarray

    def __sub__(self, other: PlateMatrices) -> PlateMatrices:
        return PlateMatrices(*(mine - others for mine, others in zip(self._arrays, other._arrays, strict=True)))

    def product(self, other: PlateMatrices) -> float:
        """Return the sum of the products of all entries: the change of a number by slopes and changes."""
        pairs = zip(self._arrays, other._arrays, strict=True)
        return float(sum(np.vdot(mine, others).real for mine, others in pairs))

    @property
    def _arrays(self) -> list[np.ndarray]:
        return [getattr(self, field.name) for field in fields(self)]


def plate_matrices(galerkin: Galerkin) -> PlateMatrices:
    """Return the matrices of a scene over a space as dense arrays."""
    scene, masses = galerkin.scene, [attachment.mass for attachment in galerkin.masses]
    mass = galerkin.mass.toarray()
    plate = mass.copy()
    plate[np.diag_indices_from(plate)] -= np.pad(masses, (len(mass) - len(masses), 0))
    return PlateMatrices(
        mass=mass,
        bending=galerkin.bending.toarray(),
        support=galerkin.support.toarray(),
        damping=galerkin.damping.toarray(),
        regions=np.stack([plate, galerkin.region_matrix(scene.target).toarray()]),
        forces=np.pad(unit_loads(galerkin), ((0, len(masses)), (0, 0))),
        coils=coil_numbers(scene, scene.drive.angular_frequency),
    )


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
