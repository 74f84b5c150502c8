"""The discretized scene: its grid, time steps, loads and regions, made once and handed to whoever needs them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_plate.plate.designs import NO_PER_PLATE, PerPlate, carriers_of
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.plate.section import make_section
from warp_plate.plate.signals import Signals, make_signals
from warp_plate.plate.travelling import MovingWeights, moving_weights
from warp_plate.plate.weights import patches, region_weights
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class Discretization:
    """A scene on its grid, in host memory and double precision; no device is involved."""

    scene: Scene  # The scene, which has a grid
    per_plate: PerPlate  # Quantities that may differ between the plates of a batch
    carriers: int  # Number of separate carriers of each plate; 0 if all plates share the scene's
    scheme: Scheme  # Steps, coefficients, stability limit and, in moment form, the fields of the plate
    region_weights: np.ndarray  # (2, ny, nx) weights of the plate and of the target, in cells

    @cached_property
    def signals(self) -> Signals:
        """Waves of the drive and their coefficients, only for time steps; see ``make_signals``."""
        scene, scheme = self.scene, self.scheme
        return make_signals(scene, scheme.time_step, scheme.steps, scene.folder, per_actuator=self.carriers > 1)

    @cached_property
    def moving(self) -> MovingWeights | None:
        """Factors of the moving load, only for time steps; None without one."""
        if self.scene.effects.travelling is None:
            return None
        return moving_weights(self.scene, self.scheme.time_step, self.scheme.steps)

    @cached_property
    def patches(self) -> np.ndarray:
        """(actuators, ny, nx) fraction of each node's cell that each actuator loads, only for time steps."""
        return patches(self.scene)

    @cached_property
    def surface_density(self) -> np.ndarray:
        """(ny, nx) mass per area [kg/m²], with layers and maps of factors."""
        bending = self.scheme.bending
        return make_section(self.scene).mass if bending is None else bending.mass

    @property
    def time_step(self) -> float:
        """Time step [s]."""
        return self.scheme.time_step

    @property
    def steps(self) -> int:
        """Number of steps of the whole run."""
        return self.scheme.steps

    @property
    def cell(self) -> float:
        """Area of a cell of the grid [m²]."""
        return self.scheme.spacing[0] * self.scheme.spacing[1]

    def with_scene(self, scene: Scene) -> Discretization:
        """Return this discretization for a scene that differs only in ``grid.precision``, ``record`` or ``search``."""
        return replace(self, scene=scene)


def discretize(
    scene: Scene, per_plate: PerPlate = NO_PER_PLATE, allow_unstable: bool = False, stepped: bool = True
) -> Discretization:
    """Discretize a scene.

    Args:
        per_plate: Quantities that may differ between the plates of a batch.
        allow_unstable: Accept a time step above the stability limit.
        stepped: False for a plate by modes, see ``make_scheme``.

    Raises:
        SceneError: ``make_scheme`` or ``region_weights`` refuse the scene, or it does not support ``per_plate``.
    """
    carriers = carriers_of(scene, per_plate)
    return Discretization(
        scene=scene,
        per_plate=per_plate,
        carriers=carriers,
        scheme=make_scheme(scene, allow_unstable, carriers > 1, stepped),
        region_weights=region_weights(scene),
    )
