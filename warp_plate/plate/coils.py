"""Coils of a scene on its grid, for time steps; see :mod:`warp_plate.effects.coil`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.effects.coil import Coil
from warp_plate.effects.effect import Joint
from warp_plate.plate.weights import covered_cells, on_plate
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class MountedCoil:
    """A coil on its patch."""

    coil: Coil
    actuator: int  # Index of the actuator
    by_voltage: bool  # True for a voltage, False for a current
    share: np.ndarray  # (ny, nx) shares of the nodes in the mean displacement of the patch

    @property
    def springs(self) -> Joint:
        """Suspension and magnet; dampers are centred in time and do not count for the stability limit."""
        return Joint(self.coil.magnet_mass, self.coil.suspension_stiffness, 0.0, "coil")


def mounted_coils(scene: Scene) -> tuple[MountedCoil, ...]:
    """Return the coils that move in time."""
    if not scene.coils_in_time:
        return ()
    mounted = []
    for index in scene.coil_indices:
        actuator = scene.actuators[index]
        share = on_plate(scene, covered_cells(scene, actuator))
        mounted.append(MountedCoil(actuator.coil, index, actuator.voltage is not None, share / share.sum()))
    return tuple(mounted)


def check_apart(scene: Scene, coils: Sequence[MountedCoil]) -> None:
    """Raise a SceneError if two coils load a node of the grid, for which each would need the other's force."""
    for index, coil in enumerate(coils):
        for other in coils[:index]:
            if (coil.share * other.share).any():
                raise SceneError(
                    f"actuators[{coil.actuator}].kind: the coil shares nodes of the grid with that of actuators"
                    f'[{other.actuator}]; move them apart, use more nodes, or the evaluator "modal"'
                )
