"""The functions of all panels of a design, and the air beside them."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from warp_plate.modal.air import Shapes, Waves
from warp_plate.modal.assemble import Galerkin, make_galerkin, make_space
from warp_plate.modal.radiation import FarField, air_of
from warp_plate.modal.sensitivity.adjoint import AirBeside
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.knots import intervals_for
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.modal.spaces.trimmed_splines import TrimmedSplines
from warp_plate.plate.section import laminate_of
from warp_plate.quantities.sound_levels import a_weight
from warp_plate.scene.model import Scene

# Functions along each side, relative to those of other commands.
DENSITY = 0.7


class PanelFunctions:
    """Functions of a scene's panels, which follow neither the map nor patches, so that values are smooth.

    Args:
        scene: Scene, with an even map of thickness where that is free.
        highest: Highest frequency of its drives [Hz].
    """

    def __init__(self, scene: Scene, highest: float) -> None:
        self._scene, self._highest = scene, highest
        self._air: dict[float, AirBeside] = {}

    @cached_property
    def space(self) -> TensorSplines | TrimmedSplines:
        """The space of these functions on the scene's own plate."""
        scene, finer = self._scene, self._scene.grid.modal_density
        wave = mean_wave_frequency(laminate_of(scene))
        sides = intervals_for(scene.plate.size, scene.outline, finer * self._highest, wave, finer * DENSITY)
        space = make_space(scene, sides)
        assert isinstance(space, TensorSplines | TrimmedSplines)
        return space

    def galerkin(self, scene: Scene) -> Galerkin:
        """Return the matrices of a panel."""
        if isinstance(self.space, TrimmedSplines):
            return make_galerkin(scene, TrimmedSplines(scene, self.space.intervals, fixed=self.space))
        return make_galerkin(scene, TensorSplines(scene, self.space.intervals, self.space.along))

    def air(self, frequency: float) -> AirBeside:
        """Return the air beside the functions at a frequency [Hz]; see :mod:`warp_plate.modal.air`."""
        if frequency not in self._air:
            space, air, table = self.space, air_of(self._scene), self._scene.effects.air
            finest = np.max(np.array(space.shape[::-1]) / self._scene.plate.size) ** 2
            highest = np.array([mean_wave_frequency(space.laminate) * finest])
            shapes, k = Shapes(self._scene, space, highest, np.eye(space.unknowns)), float(air.wavenumber(frequency))
            rows = math.sqrt(air.density * air.sound_speed) * k * FarField(shapes, k).resistance_factor(k)
            impedance = None
            if table is not None:
                masses = air.density * Waves(shapes).masses_per_density(k)
                sides = 2 if table.sides == "both" else 1
                impedance = sides * (rows.T @ rows + 2j * math.pi * frequency * masses)
            self._air[frequency] = AirBeside(a_weight(frequency) * rows, impedance)
        return self._air[frequency]
