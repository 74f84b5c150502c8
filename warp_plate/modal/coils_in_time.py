"""Motion of a plate and its coils in time, without lossy inductance; see :mod:`warp_plate.effects.coil`.

Coils that are driven by a voltage are springs and dampers between patch and magnet with the loss Bl²/R and the force
Bl U/R, without inductance. With one, the charge Q of the coil is a further unknown,

    L Q̈ + R Q̇ + Bl (u̇̄ − ż) = U,     force Bl Q̇,

a coordinate without stiffness that moves nothing by itself, whose coupling to the plate is skew: what one loses the
other gains. So plate, magnets and charges are one system q̈ + C q̇ + Λ q = f, whose modes stand in for the plate's.
"""

import math
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.eigenproblem import all_modes
from warp_plate.modal.modes import STILL, ModalPlate
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.space import Matrix
from warp_plate.scene.fields import Area
from warp_plate.scene.target import Target


@dataclass(frozen=True, eq=False, kw_only=True)
class PlateInTime(ModalPlate):
    """Modes of a plate together with its coils, those of charges first."""

    alone: ModalPlate  # The plate without its coils
    mixing: np.ndarray  # (modes of the plate alone, modes) shares in the modes
    coil_forces: np.ndarray  # (modes, coils) modal forces of 1 V or 1 A

    @property
    def coils(self) -> None:
        """None: the modes contain them."""

    @property
    def coil_columns(self) -> np.ndarray:
        return self.coil_forces

    def kinetic_matrix(self, region: str | Area | Target = "plate", within: Area | None = None) -> np.ndarray:
        return np.asarray(self.mixing.T @ self.alone.kinetic_matrix(region, within) @ self.mixing)


def in_time(plate: ModalPlate) -> ModalPlate:
    """Return a plate for motion from rest: with the modes of plate and coils, if its scene has coils in time."""
    coils, scene = plate.coils, plate.scene
    if coils is None or scene.steady:
        return plate
    modes, each = len(plate.frequencies), list(zip(coils.numbers, coils.by_voltage.tolist(), strict=True))
    charged = [index for index, (coil, driven) in enumerate(each) if driven and coil.inductance > 0]
    losses = [
        coil.force_factor**2 / coil.resistance if driven and index not in charged else 0.0
        for index, (coil, driven) in enumerate(each)
    ]
    mass, loss, stiffness, strokes = coils.matrices(modes, losses)
    moving = np.append(np.ones(modes, dtype=bool), [coil.magnet_mass > 0 for coil, _ in each])
    mass, loss, stiffness = (matrix.real[np.ix_(moving, moving)] for matrix in (mass, loss, stiffness))
    lowest = 2 * math.pi * mean_wave_frequency(plate.space.laminate) / max(scene.plate.size) ** 2
    squares, vectors = all_modes(Matrix(stiffness), Matrix(mass), lowest**2)
    frequencies = np.sqrt(np.maximum(squares, 0)) / (2 * math.pi)
    frequencies[2 * math.pi * frequencies < STILL * lowest] = 0.0
    strokes = vectors.T @ strokes[moving]

    roots = np.sqrt([each[index][0].inductance for index in charged])
    coupling = strokes[:, charged] * coils.force_factor[charged] / roots
    own = np.diag([each[index][0].resistance for index in charged] / roots**2)
    damping = np.block([[own, coupling.T], [-coupling, vectors.T @ loss @ vectors]])
    forces = np.vstack([np.zeros((len(charged), len(each))), strokes * coils.force_factor])
    for index, (coil, driven) in enumerate(each):
        if index in charged:
            forces[:, index] = np.eye(len(forces))[charged.index(index)] / roots[charged.index(index)]
        elif driven:
            forces[:, index] /= coil.resistance
    mixing = np.hstack([np.zeros((modes, len(charged))), vectors[:modes]])
    return PlateInTime(
        galerkin=plate.galerkin,
        frequencies=np.concatenate([np.zeros(len(charged)), frequencies]),
        vectors=plate.vectors @ mixing,
        damping=damping,
        hysteretic=np.zeros(damping.shape),
        highest=plate.highest,
        negligible=plate.negligible,
        alone=plate,
        mixing=mixing,
        coil_forces=forces,
    )
