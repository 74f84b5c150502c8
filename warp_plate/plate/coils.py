"""Coils of a scene on its grid, for time steps; see :mod:`warp_plate.effects.coil`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

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
    def branches(self) -> tuple[tuple[float, float], ...]:
        """Resistances and inductances of shunted inductors; none where the current is given."""
        return self.coil.eddy_branches if self.by_voltage else ()

    @property
    def springs(self) -> Joint:
        """Suspension and magnet; dampers are centred in time and do not count for the stability limit."""
        return Joint(self.coil.magnet_mass, self.coil.suspension_stiffness, 0.0, "coil")


def rational_keys(coil: Coil, low: float, high: float, count: int = 6) -> tuple[dict[str, Any], float]:
    """Return the keys of a coil whose lossy inductance is that of shunted inductors, and the largest error of its
    impedance at rest between two frequencies [Hz], relative to it.

    The corner frequencies of ``count`` inductors are evenly spaced on a logarithmic axis. Resistances are those of
    least squares, none negative, so that the coil stays passive. Powers that no passive circuit has
    leave a large error.
    """
    omega = 2 * np.pi * np.geomspace(low, high, 200)
    exact, corners = coil.blocked_impedance(omega), np.geomspace(omega[0], omega[-1], count)
    rate = 1j * omega[:, None]
    parts = np.hstack([rate / (rate + corners), rate / omega[-1], np.ones_like(rate)]) / exact[:, None]
    wanted = 1 - coil.resistance / exact
    system, right = (np.concatenate([part.real, part.imag]) for part in (parts, wanted))
    shares, _ = scipy.optimize.nnls(system, right)
    branches = [
        (share, share / corner) for share, corner in zip(shares[:count].tolist(), corners.tolist(), strict=True)
    ]
    keys = {
        "resistance": coil.resistance + float(shares[-1]),
        "inductance": float(shares[-2] / omega[-1]),
        "eddy_branches": tuple(branch for branch in branches if branch[0] > 0),
    }
    return keys, float(np.abs(parts @ shares - wanted).max())


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
