"""The requirements of a specification over the regions of a plate: levels wanted in targets and allowed elsewhere, and
limits on quadratic quantities of a drive: powers, sound, and what coils may bear."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from warp_plate.modal.coils import CoilMotion
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import Radiation, pressure_rows
from warp_plate.problem.worst_points import Region, make_region, shape_of
from warp_plate.quantities.sound_levels import POWER_REFERENCE, PRESSURE_REFERENCE, a_weight
from warp_plate.scene.errors import SceneError
from warp_plate.scene.specification import Allowance, Level, Specification

# Samples along a bending wave, along the longer side of the plate, and along a side of a target, at least.
PER_WAVE, PER_PLATE, PER_TARGET = 24, 80, 9
# Distance [of the longer side] by which outlines may be off where their mean is only shown.
SHOWN = 1e-4
QUARTER = 256  # sides of a quarter turn of a guard


@dataclass(frozen=True)
class Aim:
    """A level wanted in a target."""

    name: str  # name of the target
    level: Level
    region: Region


@dataclass(frozen=True)
class Rest:
    """A level allowed in the rest of the plate."""

    name: str
    allowance: Allowance
    region: Region


@dataclass(frozen=True)
class Requirements:
    """A specification over the regions of a plate."""

    specification: Specification
    aims: tuple[Aim, ...]
    rests: tuple[Rest, ...]
    plate: ModalPlate

    @cached_property
    def radiation(self) -> Radiation:
        """The sound of the plate's modes."""
        return Radiation(self.plate, self.plate.highest)

    @property
    def phases_free(self) -> bool:
        """True if some points have levels at any phase, so that the motion may be zero between samples."""
        return any(aim.level.measure == "weakest" and aim.level.phase == "free" for aim in self.aims)

    @property
    def relative(self) -> np.ndarray:
        """(rests,) true where the level elsewhere is relative to that of the targets."""
        return np.array([rest.allowance.relative_db is not None for rest in self.rests], dtype=bool)

    def wanted(self, frequency: float) -> np.ndarray:
        """Return the (aims,) wanted peak accelerations [m/s²] at a frequency [Hz]."""
        return np.array([aim.level.peak_acceleration(frequency) for aim in self.aims])

    def allowed(self, frequency: float) -> np.ndarray:
        """Return the (rests,) allowed peak accelerations [m/s²] at a frequency [Hz]."""
        least = self.wanted(frequency).min()
        return np.array([rest.allowance.largest(frequency, least) for rest in self.rests])


def make_requirements(plate: ModalPlate) -> Requirements:
    """Return the requirements of a scene's specification over the regions of its plate.

    Raises:
        SceneError: A region is empty, or a mask.
    """
    scene = plate.scene
    specification, keys = scene.specification, scene.targets_by_key
    assert specification is not None
    longer = max(scene.plate.size)
    spacing = min(longer / PER_PLATE, _wavelength(plate) / PER_WAVE)
    names = {row.name: f"targets[{index}]" for index, row in enumerate(scene.targets)}
    labels = {key: name for name, key in names.items()} | {"target": "target"}
    aims, aimed = [], []
    for level in specification.levels:
        key = next(iter(keys)) if level.target is None else names[level.target]
        around = shape_of(key, keys[key], 1)
        x0, y0, x1, y1 = around.bounds
        fine = min(spacing, max(x1 - x0, y1 - y0) / PER_TARGET)
        aims.append(Aim(labels[key], level, make_region(plate, around, fine, PER_TARGET, keys[key])))
        aimed.append(shape_of(key, keys[key], -1))
    guarded, rests = guarded_shape(aimed, specification.guard), []
    for index, allowance in enumerate(specification.allowances):
        x0, x1, y0, y1 = allowance.area or (0.0, scene.plate.size[0], 0.0, scene.plate.size[1])
        shape = shapely.difference(shapely.box(x0, y0, x1, y1), guarded)
        if shape.is_empty and allowance.area is not None:
            raise SceneError(f"specification.elsewhere[{index}].area: nothing of it is outside targets and their guard")
        coarser = 0.0 if allowance.measure == "mean" else SHOWN * longer
        rests.append(Rest(allowance.place, allowance, make_region(plate, shape, spacing, coarser=coarser)))
    return Requirements(specification, tuple(aims), tuple(rests), plate)


def guarded_shape(targets: Iterable[shapely.Geometry], guard: float) -> shapely.Geometry:
    """Return the shape of targets with the rim around them [m] that does not belong to the rest."""
    return shapely.union_all([shapely.buffer(target, guard, quad_segs=QUARTER) for target in targets])


def _wavelength(plate: ModalPlate) -> float:
    """Return the bending wavelength [m] at the highest frequency of a plate's responses, of an even plate of its mass
    and stiffness."""
    return 2 * math.pi * math.sqrt(plate.scene.plate.kappa / (2 * math.pi * plate.highest))


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
