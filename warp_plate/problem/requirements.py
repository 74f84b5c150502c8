"""The requirements of a specification over the regions of a plate: wanted levels in targets, allowed ones elsewhere."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
import shapely.affinity

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import Radiation
from warp_plate.problem.worst_points import CORNERS, Region, make_region, shape_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.specification import Allowance, Level, Specification

# Samples along a bending wave, along the longer side of the plate, and along a side of a target, at least.
PER_WAVE, PER_PLATE, PER_TARGET = 24, 80, 9
QUARTER = 64  # corners of a quarter of the rounded corners of a guard
# Factors by which the polygon inside a disc contains the disc, or has its area.
AROUND = 1 / math.cos(math.pi / CORNERS)
OF_EQUAL_AREA = (math.sin(2 * math.pi / CORNERS) * CORNERS / (2 * math.pi)) ** -0.5


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
    def relative(self) -> np.ndarray:
        """(rests,) true where the level elsewhere is relative to that of the targets."""
        return np.array([rest.allowance.relative_db is not None for rest in self.rests], dtype=bool)

    def wanted(self, frequency: float) -> np.ndarray:
        """Return the (aims,) wanted peak accelerations [m/s²] at a frequency [Hz]."""
        return np.array([aim.level.peak_acceleration(frequency) for aim in self.aims])

    def allowed(self, frequency: float) -> np.ndarray:
        """Return the (rests,) allowed peak accelerations [m/s²] at a frequency [Hz]."""
        least = self.wanted(frequency).min()
        return np.array(
            [
                rest.allowance.peak_acceleration(frequency)
                if rest.allowance.relative_db is None
                else least * 10 ** (rest.allowance.relative_db / 20)
                for rest in self.rests
            ]
        )


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
    shapes = {key: shape_of(key, target) for key, target in keys.items()}
    names = {row.name: f"targets[{index}]" for index, row in enumerate(scene.targets)}
    labels = {key: name for name, key in names.items()} | {"target": "target"}
    aims, aimed = [], []
    for level in specification.levels:
        key = next(iter(keys)) if level.target is None else names[level.target]
        x0, y0, x1, y1 = shapes[key].bounds
        fine = min(spacing, max(x1 - x0, y1 - y0) / PER_TARGET)
        shape = shapes[key]
        if keys[key].disc is not None:
            wider = AROUND if level.measure == "weakest" else OF_EQUAL_AREA
            shape = shapely.affinity.scale(shape, wider, wider)
        aims.append(Aim(labels[key], level, make_region(plate, shape, fine, PER_TARGET)))
        aimed.append(shapes[key])
    guarded = shapely.union_all([shapely.buffer(shape, specification.guard, quad_segs=QUARTER) for shape in aimed])
    rests = []
    for index, allowance in enumerate(specification.allowances):
        x0, x1, y0, y1 = allowance.area or (0.0, scene.plate.size[0], 0.0, scene.plate.size[1])
        shape = shapely.difference(shapely.box(x0, y0, x1, y1), guarded)
        if shape.is_empty and allowance.area is not None:
            raise SceneError(f"specification.elsewhere[{index}].area: nothing of it is outside targets and their guard")
        name = "elsewhere" if allowance.area is None else f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} m"
        rests.append(Rest(name, allowance, make_region(plate, shape, spacing)))
    return Requirements(specification, tuple(aims), tuple(rests), plate)


def _wavelength(plate: ModalPlate) -> float:
    """Return the bending wavelength [m] at the highest frequency of a plate's responses, of an even plate of its mass
    and stiffness."""
    return 2 * math.pi * math.sqrt(plate.scene.plate.kappa / (2 * math.pi * plate.highest))
