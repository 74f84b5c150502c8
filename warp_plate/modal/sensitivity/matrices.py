"""Matrices of a plate on which its motion depends, as dense arrays, and slopes by them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from warp_plate.modal.assemble import Galerkin, unit_loads
from warp_plate.modal.coils import coil_numbers


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
