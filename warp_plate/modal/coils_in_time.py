"""Motion of a plate and its coils in time, without powers of the frequency; see :mod:`warp_plate.effects.coil`.

Coils that are driven by a voltage are springs and dampers between patch and magnet with the loss Bl²/R and the force
Bl U/R, without inductance. With one, the charge Q of the coil is a further unknown,

    L Q̈ + R Q̇ + Bl (u̇̄ − ż) = U,     force Bl Q̇,

a coordinate without stiffness that moves nothing by itself, whose coupling to the plate is skew: what one loses the
other gains; and each shunted inductor has the charge of its own current. So plate, magnets and charges are one system
q̈ + C q̇ + Λ q = f, whose modes stand in for the plate's.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.effects.coil import Coil
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


@dataclass(frozen=True)
class _Circuit:
    """Charges of a coil that is driven by a voltage, scaled to unit inductances."""

    damping: np.ndarray  # (charges, charges) [1/s]
    source: np.ndarray  # (charges,) acceleration by a volt
    conductance: float  # current that follows a voltage at once [1/Ω]


_NO_CIRCUIT = _Circuit(np.zeros((0, 0)), np.zeros(0), 0.0)


def _circuit(coil: Coil) -> _Circuit:
    shunts, inductances = np.array(coil.eddy_branches).reshape(-1, 2).T
    total = coil.resistance + shunts.sum()
    if coil.inductance > 0:
        inductances = np.append(coil.inductance, inductances)
        damping = np.diag(np.append(total, shunts))
        damping[0, 1:] = damping[1:, 0] = -shunts
        source, conductance = np.eye(len(damping))[0], 0.0
    else:  # the current of the coil follows those of the inductors
        damping = np.diag(shunts) - np.outer(shunts, shunts) / total
        source, conductance = shunts / total, 1 / total
    roots = np.sqrt(inductances)
    return _Circuit(damping / np.outer(roots, roots), source / roots, conductance)


def in_time(plate: ModalPlate) -> ModalPlate:
    """Return a plate for motion from rest: with the modes of plate and coils, if its scene has coils in time."""
    coils, scene = plate.coils, plate.scene
    if coils is None or scene.steady:
        return plate
    modes, each = len(plate.frequencies), list(zip(coils.numbers, coils.by_voltage.tolist(), strict=True))
    circuits = [_circuit(coil) if driven else _NO_CIRCUIT for coil, driven in each]
    losses = [coil.force_factor**2 * circuit.conductance for (coil, _), circuit in zip(each, circuits, strict=True)]
    mass, loss, stiffness, strokes = coils.matrices(modes, losses)
    moving = np.append(np.ones(modes, dtype=bool), [coil.magnet_mass > 0 for coil, _ in each])
    mass, loss, stiffness = (matrix.real[np.ix_(moving, moving)] for matrix in (mass, loss, stiffness))
    lowest = 2 * math.pi * mean_wave_frequency(plate.space.laminate) / max(scene.plate.size) ** 2
    squares, vectors = all_modes(Matrix(stiffness), Matrix(mass), lowest**2)
    frequencies = np.sqrt(np.maximum(squares, 0)) / (2 * math.pi)
    frequencies[2 * math.pi * frequencies < STILL * lowest] = 0.0
    strokes = vectors.T @ strokes[moving]

    sources = scipy.linalg.block_diag(*(circuit.source[:, None] for circuit in circuits))  # (charges, coils)
    pushes = strokes * coils.force_factor
    coupling = pushes @ sources.T
    own = scipy.linalg.block_diag(*(circuit.damping for circuit in circuits))
    damping = np.block([[own, coupling.T], [-coupling, vectors.T @ loss @ vectors]])
    by_source = [circuit.conductance if driven else 1.0 for circuit, (_, driven) in zip(circuits, each, strict=True)]
    forces = np.vstack([sources, pushes * by_source])
    charges = len(sources)
    mixing = np.hstack([np.zeros((modes, charges)), vectors[:modes]])
    return PlateInTime(
        galerkin=plate.galerkin,
        frequencies=np.concatenate([np.zeros(charges), frequencies]),
        vectors=plate.vectors @ mixing,
        damping=damping,
        hysteretic=np.zeros(damping.shape),
        highest=plate.highest,
        negligible=plate.negligible,
        alone=plate,
        mixing=mixing,
        coil_forces=forces,
    )
