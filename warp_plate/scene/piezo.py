"""Piezo patches: ``kind = "piezo"`` of ``[[actuators]]``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from warp_plate.effects.layers import Layer
from warp_plate.scene.actuator import Actuator

if TYPE_CHECKING:
    from warp_plate.scene.model import Scene


def piezo_moments(scene: Scene) -> list[float]:
    """Return the bending moment per length and volt [N/V] of each piezo patch of a scene.

    It is E d31 / (1 − ν) times the distance of the patch's middle from the neutral plane: the plate's own, or that of
    plate and patch if the patch has a density and so counts as a layer. Poisson's ratio is the plate's.
    """
    plate, moments = scene.plate, []
    for patch in scene.actuators:
        assert patch.d31 is not None
        assert patch.thickness is not None
        assert patch.young_modulus is not None
        stretch, added = plate.young_modulus * plate.thickness, 0.0
        if patch.density is not None:
            added = patch.young_modulus * patch.thickness
        distance = (plate.thickness + patch.thickness) / 2 * stretch / (stretch + added)
        moments.append(patch.young_modulus * patch.d31 / (1 - plate.poisson_ratio) * distance)
    return moments


def piezo_layers(actuators: Iterable[Actuator]) -> list[Layer]:
    """Return the bodies of the patches that have a density."""
    keys, bodies = ("area", "thickness", "young_modulus", "density"), (a for a in actuators if a.density is not None)
    return [Layer(**{key: getattr(body, key) for key in keys}) for body in bodies]


def check_piezo(scene: Scene) -> None:
    """Raise ValueError, naming the key, unless a scene with piezo patches has nothing that these exclude."""
    if not scene.piezo:
        return
    for index, actuator in enumerate(scene.actuators):
        if actuator.thickness is None:
            raise ValueError(f'actuators[{index}].kind: "pressure" beside "piezo"; all must be of one kind')
        scene.plate.check_thin(actuator.thickness, f"actuators[{index}].thickness: ")
    tables = {"drive.electrostatic": scene.drive.electrostatic, "search.position": scene.search.position}
    excluded = [key for key, table in tables.items() if table is not None]
    excluded += [key for key in scene.effects.section_keys if not key.endswith(".density")]
    for key in excluded:
        raise ValueError(f"{key}: not with piezo patches; delete it")
