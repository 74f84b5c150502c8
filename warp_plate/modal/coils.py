"""Coils on a plate in steady motion, see :mod:`warp_plate.effects.coil`; each is eliminated at every frequency.

Let k_b = k + iω(r + Bl²/Ze) be the dynamic stiffness between patch and magnet, without Bl²/Ze where the current is
given, m_b = κ + iωρ − ω²M that of the magnet, infinite if it is fixed, and F = Bl U/Ze or Bl i the force of the blocked
coil. With the compliance c = 1/(k_b + m_b), the stroke between patch and magnet and the force on the plate are

    ū − z = (1 − k_b c) ū + c F,     f = (1 − k_b c) F − S ū,     S = k_b (1 − k_b c) − ω² m.

With the receptance A of the plate without coils, modal forces p and means B of the modes over the patches, the plate
moves by q = (A⁻¹ + B S Bᵀ)⁻¹ p. By Woodbury's formula this takes a system of as many unknowns as there are coils.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.effects.coil import Coil
from warp_plate.modal.radiation import BarePlate
from warp_plate.plate.weights import CoilRegion
from warp_plate.scene.model import Scene

# Modes, from the lowest, whose resonances with coils are computed, and largest half-width of one over its frequency.
# Half-widths below a part of the frequency are rounding.
MOST_MODES, WIDEST, ROUNDING = 300, 0.9, 1e-10
# Relative distance of the frequency that is taken for a natural one of an undamped plate.
BESIDE = 1e-8


@dataclass(frozen=True)
class CoilMotion:
    """Steady motion of coils, complex amplitudes (n, coils, drives)."""

    omega: np.ndarray  # (n,) [rad/s]
    voltage: np.ndarray  # [V] at the terminals
    current: np.ndarray  # [A]
    stroke: np.ndarray  # ū − z [m]
    magnet: np.ndarray  # z [m]
    force_factor: np.ndarray  # (coils,) Bl [N/A]

    @property
    def electrical_power(self) -> np.ndarray:
        """(n, coils, drives) mean power into the terminals [W]."""
        return np.asarray((self.voltage * self.current.conj()).real / 2)

    @property
    def mechanical_power(self) -> np.ndarray:
        """(n, coils, drives) mean power of the force Bl i on patch and magnet [W]."""
        velocity = 1j * self.omega[:, None, None] * self.stroke
        return np.asarray((self.force_factor[:, None] * self.current * velocity.conj()).real / 2)


@dataclass(frozen=True)
class _Elements:
    """Numbers (n, coils) of the coils at n frequencies."""

    blocked: np.ndarray  # Ze [Ω]
    ratio: np.ndarray  # 1 − k_b c = m_b c
    compliance: np.ndarray  # c [m/N]
    stiffness: np.ndarray  # S [N/m]


class Coils:
    """The coils of a scene on the modes of its plate.

    Args:
        plate: Plate of a scene with coils.
        means: (modes, coils) mean shapes over their patches [1/√kg].
    """

    def __init__(self, plate: BarePlate, means: np.ndarray) -> None:
        self._plate, self.indices, self.means = plate, plate.scene.coil_indices, means
        actuators = [plate.scene.actuators[index] for index in self.indices]
        self.names = tuple(actuator.name for actuator in actuators)
        self.numbers: list[Coil] = [actuator.coil for actuator in actuators]
        self.by_voltage = np.array([actuator.voltage is not None for actuator in actuators])
        self.force_factor = np.array([coil.force_factor for coil in self.numbers])
        self._actuators = len(plate.scene.actuators)

    def respond(self, omega: np.ndarray, forces: np.ndarray, opened: bool = False) -> np.ndarray:
        """Return (n, modes, loads) amplitudes under modal forces (n, modes, loads) at ω (n,) [rad/s].

        Terminals of voltages are shorted and those of currents open, or all are open if ``opened``.
        """
        count, stiffness = forces.shape[2], self._elements(omega, opened).stiffness[:, :, None]
        loads = np.concatenate([forces, np.broadcast_to(self.means, (len(omega), *self.means.shape))], axis=2)
        both = self._plate.respond_alone(omega, loads)
        alone, patches = both[:, :, :count], both[:, :, count:]
        infinite = ~np.isfinite(both).all(axis=(1, 2))
        both[infinite] = 0
        system = np.eye(len(self.numbers)) + stiffness * (self.means.T @ patches)
        amplitudes = alone - patches @ np.linalg.solve(system, stiffness * (self.means.T @ alone))
        if infinite.any():  # at natural frequencies of an undamped plate, which the coils may damp
            amplitudes[infinite] = self.respond(omega[infinite] * (1 + BESIDE), forces[infinite], opened)
        return np.asarray(amplitudes)

    def gains(self, omega: np.ndarray) -> np.ndarray:
        """Return (n, actuators) forces [N] on patches per volt or ampere at ω (n, actuators or 1) [rad/s]; 1 for other
        actuators."""
        gains = np.ones((len(omega), self._actuators), dtype=complex)
        omega = np.broadcast_to(omega, gains.shape)
        for index, coil, by_voltage in zip(self.indices, self.numbers, self.by_voltage.tolist(), strict=True):
            blocked, ratio, *_ = _element(coil, omega[:, index], by_voltage)
            gains[:, index] = coil.force_factor * ratio / (blocked if by_voltage else 1.0)
        return gains

    def motion(self, omega: np.ndarray, amplitudes: np.ndarray, drives: np.ndarray) -> CoilMotion:
        """Return the motion of the coils at ω (n,) [rad/s] where the plate has amplitudes (n, modes, drives) under
        phasors (actuators, drives) of the sources."""
        elements, source = self._elements(omega), drives[self.indices]
        blocked, by_voltage = elements.blocked[:, :, None], self.by_voltage[:, None]
        factor, patches = self.force_factor[:, None], self.means.T @ amplitudes
        force = factor * source / np.where(by_voltage, blocked, 1)
        stroke = elements.ratio[:, :, None] * patches + elements.compliance[:, :, None] * force
        induced = 1j * omega[:, None, None] * factor * stroke
        current = np.where(by_voltage, (source - induced) / blocked, source)
        voltage = np.where(by_voltage, source, blocked * current + induced)
        return CoilMotion(omega, voltage, current, stroke, patches - stroke, self.force_factor)

    def rows(self, frequency: np.ndarray, amplitudes: np.ndarray, regions: Sequence[CoilRegion]) -> list[np.ndarray]:
        """Return the numbers (designs, M) of each region under unit drives, at frequencies (designs, M or 1) [Hz] and
        modal amplitudes (designs, modes, M): the squares of their sums over phasors are the quantities limited."""
        omega = np.broadcast_to(2 * math.pi * frequency, amplitudes[:, 0].shape)
        units = np.eye(amplitudes.shape[2])
        motions = [self.motion(omega[:, j], amplitudes[:, :, [j]], units[:, [j]]) for j in range(len(units))]
        rows = []
        for region in regions:
            name = "current" if region.quantity == "heat" else region.quantity
            row = np.concatenate([getattr(motion, name)[:, region.coil] for motion in motions], axis=1)
            if region.quantity == "heat":
                row = row * np.sqrt(self.numbers[region.coil].blocked_impedance(omega).real / 2)
            rows.append(row)
        return rows

    def impedance(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the impedances (n, coils, coils) [Ω] at ω (n,) [rad/s], voltage by current, the terminals of all other
        coils being open, and the amplitudes (n, modes, coils) of the plate per ampere."""
        elements = self._elements(omega, opened=True)
        forces = self.means * (self.force_factor * elements.ratio)[:, None, :]
        amplitudes = self.respond(omega, forces, opened=True)
        strokes = elements.ratio[:, :, None] * (self.means.T @ amplitudes)
        diagonal = np.eye(len(self.numbers)) * (elements.compliance * self.force_factor)[:, None, :]
        induced = 1j * omega[:, None, None] * self.force_factor[:, None] * (strokes + diagonal)
        return induced + np.eye(len(self.numbers)) * elements.blocked[:, None, :], amplitudes

    def resonances(self, opened: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies, rising, and half-widths [Hz] of the resonances with the coils.

        Those beyond the lowest MOST_MODES modes are the plate's alone. All terminals are open if ``opened``; otherwise
        those of voltages are shorted, without inductance.
        """
        count = min(len(self._plate.angular_frequencies), MOST_MODES)
        shorted = [
            coil.force_factor**2 / coil.resistance if by_voltage and not opened else 0.0
            for coil, by_voltage in zip(self.numbers, self.by_voltage, strict=True)
        ]
        mass, loss, stiff, _ = self.matrices(count, shorted)
        nothing, one = np.zeros_like(mass), np.eye(len(mass))
        system = np.block([[nothing, one], [-np.linalg.solve(mass, np.hstack([stiff, loss]))]])
        poles = scipy.linalg.eigvals(system) / (2j * math.pi)
        poles = poles[(poles.real > 0) & (poles.imag < WIDEST * np.abs(poles))]
        omega = self._plate.angular_frequencies[count:]
        lost = np.diag(self._plate.damping)[count:] + np.diag(self._plate.hysteretic)[count:] / omega
        poles = np.concatenate([poles, (omega + 0.5j * lost) / (2 * math.pi)])
        poles = poles[np.argsort(poles.real)]
        return poles.real, np.where(poles.imag > ROUNDING * poles.real, poles.imag, 0)

    def matrices(self, count: int, shorted: Sequence[float]) -> tuple[np.ndarray, ...]:
        """Return mass, loss, stiffness (unknowns, unknowns) and the strokes ū − z (unknowns, coils) over the lowest
        ``count`` modes and the magnets of all coils, between whose ends there are also dampers ``shorted`` [N·s/m].

        The unknown of a magnet that is fixed moves nothing.
        """
        size = count + len(self.numbers)
        low, one = np.ix_(range(count), range(count)), np.eye(size)
        mass, loss, stiff = (np.zeros((size, size), dtype=complex) for _ in range(3))
        mass[low], loss[low] = np.eye(count), self._plate.damping[low]
        stiff[low] = np.diag(self._plate.angular_frequencies[:count] ** 2) + 1j * self._plate.hysteretic[low]
        strokes = np.zeros((size, len(self.numbers)))
        for index, (coil, damper) in enumerate(zip(self.numbers, shorted, strict=True)):
            patch, magnet = np.pad(self.means[:count, index], (0, len(self.numbers))), one[count + index]
            between, of_magnet = (patch - magnet, coil.magnet_mass) if coil.magnet_mass else (patch, 1.0)
            strokes[:, index] = between
            parts = (
                (mass, coil.moving_mass, of_magnet, 0.0),
                (loss, 0.0, coil.magnet_damping, coil.suspension_damping + damper),
                (stiff, 0.0, coil.magnet_stiffness, coil.suspension_stiffness),
            )
            for matrix, *factors in parts:
                for factor, row in zip(factors, (patch, magnet, between), strict=True):
                    matrix += factor * np.outer(row, row)
        return mass, loss, stiff, strokes

    def _elements(self, omega: np.ndarray, opened: bool = False) -> _Elements:
        shorted = self.by_voltage & (not opened)
        columns = [_element(coil, omega, short) for coil, short in zip(self.numbers, shorted.tolist(), strict=True)]
        return _Elements(*(np.stack(rows, axis=1) for rows in zip(*columns, strict=True)))


def _element(coil: Coil, omega: np.ndarray, shorted: bool) -> tuple[np.ndarray, ...]:
    """Return the numbers (n,) of a coil in the order of :class:`_Elements`."""
    rate, blocked = 1j * omega, coil.blocked_impedance(omega)
    losses = coil.suspension_damping + (coil.force_factor**2 / blocked if shorted else 0)
    between = coil.suspension_stiffness + rate * losses
    ratio, compliance = np.ones(omega.shape, dtype=complex), np.zeros(omega.shape, dtype=complex)
    if coil.magnet_mass > 0:
        of_magnet = coil.magnet_stiffness + rate * coil.magnet_damping - omega**2 * coil.magnet_mass
        compliance = 1 / (between + of_magnet)
        ratio = of_magnet * compliance
    return blocked, ratio, compliance, between * ratio - omega**2 * coil.moving_mass


def coil_numbers(scene: Scene, omega: float) -> np.ndarray:
    """Return (3, coils) the numbers of a scene's coils at ω [rad/s] on which the motion depends: stiffness S on the
    plate [N/m], force per drive [N], and current per voltage or voltage per current of a plate at rest."""
    columns = []
    for actuator in (scene.actuators[index] for index in scene.coil_indices):
        coil, by_voltage = actuator.coil, actuator.voltage is not None
        numbers = _element(coil, np.array([omega]), by_voltage)
        blocked, ratio, compliance, stiffness = (complex(values[0]) for values in numbers)
        induced = 1j * omega * coil.force_factor**2 * compliance  # voltage per ampere
        force = coil.force_factor * ratio
        if by_voltage:
            columns.append([stiffness, force / blocked, (1 - induced / blocked) / blocked])
        else:
            columns.append([stiffness, force, blocked + induced])
    return np.array(columns, dtype=complex).reshape(-1, 3).T


def feeding(scene: Scene, omega: float) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers a and b (actuators,) of the mean power ½ Re Z̄ (a Z + b ū) that drives Z feed at ω [rad/s], with ū
    the integral of the displacement that a unit drive loads, of coils the mean over the patch."""
    own, fed = np.zeros(len(scene.actuators), dtype=complex), np.full(len(scene.actuators), 1j * omega)
    _, gains, own[scene.coil_indices] = coil_numbers(scene, omega)
    voltages = np.array([scene.actuators[index].voltage is not None for index in scene.coil_indices], dtype=bool)
    fed[scene.coil_indices] *= np.where(voltages, -1, 1) * gains
    return own, fed
