"""The discretized scene: its grid, time steps, loads and regions, made once and handed to whoever needs them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_plate.plate.designs import NO_PER_PLATE, PerPlate, carriers_of
from warp_plate.plate.moving_load import MovingWeights, moving_weights
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.plate.section import make_section
from warp_plate.plate.signals import Signals, make_signals
from warp_plate.plate.weights import patches, region_weights
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class Discretization:
    """A scene on its grid, in host memory and double precision; no device is involved."""

    scene: Scene  # The scene, which has a grid
    per_plate: PerPlate  # What may differ between the plates of a batch
    carriers: int  # Number of carriers that each plate has of its own; 0 if all plates share the scene's
    scheme: Scheme  # Steps, coefficients, stability limit and, in moment form, the fields of the plate
    region_weights: np.ndarray  # (2, ny, nx) weights of the plate and of the target, in cells
    signals: Signals  # Waves of the drive and how phasors mix them
    moving: MovingWeights | None  # Factors of the moving load; None without one

    @cached_property
    def patches(self) -> np.ndarray:
        """(actuators, ny, nx) share of each node's cell that each actuator loads, for time steps alone.

        Raises:
            SceneError: An actuator covers no node that can move.
        """
        return patches(self.scene)

    @cached_property
    def surface_density(self) -> np.ndarray:
        """(ny, nx) mass per area [kg/m²], with layers and variation."""
        bending = self.scheme.bending
        return make_section(self.scene).mass if bending is None else bending.mass

    @property
    def cell(self) -> float:
        """Area of a cell of the grid [m²]."""
        return self.scheme.spacing[0] * self.scheme.spacing[1]

    def with_scene(self, scene: Scene) -> Discretization:
        """Return this discretization for a scene that differs in ``grid.precision``, ``record`` or ``search`` alone."""
        return replace(self, scene=scene)


def discretize(scene: Scene, per_plate: PerPlate = NO_PER_PLATE, allow_unstable: bool = False) -> Discretization:
    """Discretize a scene.

    Args:
        per_plate: What may differ between the plates of a batch.
        allow_unstable: Accept a time step above the stability limit.

    Raises:
        SceneError: ``make_scheme``, ``region_weights`` or ``make_signals`` refuse the scene, or it cannot have what
            ``per_plate`` asks for.
    """
    carriers = carriers_of(scene, per_plate)
    scheme = make_scheme(scene, allow_unstable, moment_form=carriers > 1)
    return Discretization(
        scene=scene,
        per_plate=per_plate,
        carriers=carriers,
        scheme=scheme,
        region_weights=region_weights(scene),
        signals=make_signals(scene, scheme.time_step, scheme.steps, scene.folder, per_actuator=carriers > 1),
        moving=moving_weights(scene, scheme.time_step, scheme.steps) if scene.effects.moving_load else None,
    )
