"""Limits of a specification on quadratic quantities of a drive: powers, sound, and what coils may bear."""

import math
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.coils import CoilMotion
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import pressure_rows
from warp_plate.problem.requirements import Requirements
from warp_plate.quantities.sound_levels import POWER_REFERENCE, PRESSURE_REFERENCE, a_weight


@dataclass(frozen=True)
class Limited:
    """A limited quantity: a power, a sound, or the amplitude of a coil."""

    name: str
    unit: str  # unit in which it is shown: W, dB(A), or V, A or mm of an amplitude
    limit: float  # power [W], or square of an amplitude in SI units; of sound over its reference, A-weighted
    factor: np.ndarray  # (rows, actuators) F: ‖F z‖² is the power or the square of parts z of the largest drives

    def shown(self, square: float) -> float:
        """Return a power [W], or an amplitude from its square, in the unit."""
        if self.unit == "dB(A)":
            return 10 * math.log10(max(square, 1e-300))
        return square if self.unit == "W" else math.sqrt(square) * (1e3 if self.unit == "mm" else 1.0)

    def of(self, drive: np.ndarray) -> float:
        """Return the power [W], or the square of the amplitude, of a drive (actuators,)."""
        return float(np.linalg.norm(self.factor @ drive) ** 2)


def limited_quantities(
    requirements: Requirements, plate: ModalPlate, frequency: float, largest: np.ndarray, accelerations: np.ndarray
) -> list[Limited]:
    """Return what a specification limits besides the actuators' drives, at a frequency [Hz].

    ``largest`` (actuators,) are the largest drives, ``accelerations`` (modes, actuators) the modal ones under each.
    """
    limits, omega = requirements.specification.limits, 2 * math.pi * frequency
    velocity, quantities = accelerations / (1j * omega), []
    motion = None  # of the coils under the largest drive of each actuator (1, coils, actuators)
    if plate.coils is not None:
        motion = plate.coils.motion(np.array([omega]), -accelerations[None] / omega**2, np.diag(largest))
    if limits.power is not None:
        admittance = (plate.actuator_forces() * largest).T @ velocity
        if plate.coils is not None and motion is not None:
            # The force of a coil acts on patch and magnet.
            force = plate.coils.force_factor[:, None] * motion.current[0]
            admittance[plate.coils.indices] = 0
            admittance = admittance + force.conj().T @ (1j * omega * motion.stroke[0])
        quantities.append(Limited("power", "W", limits.power, hermitian_factor((admittance + admittance.conj().T) / 4)))
    weight = a_weight(frequency)
    if limits.sound is not None:
        radiated = velocity.conj().T @ (requirements.radiation.resistances(np.array([frequency]))[0] @ velocity)
        factor = weight / math.sqrt(POWER_REFERENCE) * hermitian_factor(radiated / 2)
        quantities.append(Limited("sound", "dB(A)", 10 ** (limits.sound / 10), factor))
    for row in limits.pressures:
        pressure = pressure_rows(plate, frequency, np.array([row.point])) @ velocity
        rows = weight / (math.sqrt(2) * PRESSURE_REFERENCE) * pressure
        quantities.append(Limited(row.name, "dB(A)", 10 ** (row.level / 10), rows))
    if motion is not None:
        quantities += _of_coils(requirements, plate, omega, motion)
    return quantities


def _of_coils(requirements: Requirements, plate: ModalPlate, omega: float, motion: CoilMotion) -> list[Limited]:
    """Return the limited voltages, currents, heats and strokes of the coils."""
    assert plate.coils is not None
    limits, quantities = requirements.specification.limits, []
    for row, (index, name) in enumerate(zip(plate.coils.indices, plate.coils.names, strict=True)):
        actuator = plate.scene.actuators[index]
        resistance = float(actuator.coil.blocked_impedance(np.array([omega]))[0].real)
        rows = {
            # What drives a coil is limited as that of any actuator.
            ("voltage", "V"): (limits.voltage if actuator.voltage is None else None, motion.voltage),
            ("current", "A"): (limits.current if actuator.current is None else None, motion.current),
            ("stroke", "mm"): (limits.stroke, motion.stroke),
        }
        for (quantity, unit), (limit, values) in rows.items():
            if limit is not None:
                quantities.append(Limited(f"{quantity} of {name}", unit, limit**2, values[0, [row]]))
        if limits.heat is not None:
            factor = math.sqrt(resistance / 2) * motion.current[0, [row]]
            quantities.append(Limited(f"heat of {name}", "W", limits.heat, factor))
    return quantities


def hermitian_factor(matrix: np.ndarray) -> np.ndarray:
    """Return R (rows, n) with RᴴR the part of a Hermitian matrix (n, n) that is not negative."""
    values, vectors = np.linalg.eigh((matrix + matrix.conj().T) / 2)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0))).conj().T)
