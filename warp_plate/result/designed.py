"""A designed panel: its scene, and what it can do beside the panel that the design began with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.plate.section import laminate_of
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class PanelValues:
    """Values of a panel, by all modes of other commands."""

    bound: float  # largest localization factor of any drive
    value: float  # what is maximised: the least of all cases of the bound, or of the factor of the scene's drive


@dataclass(frozen=True, eq=False)
class DesignedPanel:
    """The best panel of a design."""

    original: Scene  # scene that the design began with
    scene: Scene  # the designed scene
    before: PanelValues
    after: PanelValues
    # value of the best panel so far after each iteration, for each start, by the fewer functions of the search
    history: tuple[tuple[float, ...], ...]
    keys: tuple[str, ...]  # (n,) keys of the free numbers and places
    values: tuple[float, ...]  # (n,) their values in the designed scene; of places the middle
    evaluations: int  # number of panels that were solved for, cases of tolerances and frequencies not counted
    interrupted: bool = False  # True if the search ended before its last start

    @property
    def improved(self) -> bool:
        """True if the designed scene is another one than the original."""
        return self.after.value > self.before.value

    @cached_property
    def thickness(self) -> np.ndarray | None:
        """(rows, columns) map of the designed thickness [m]; None if the scene has none."""
        factors = laminate_of(self.scene).maps.get("thickness")
        return None if factors is None else factors * self.scene.plate.thickness

    @property
    def original_thickness(self) -> np.ndarray | None:
        """(rows, columns) thickness [m] of the original at the same points; None if the designed scene has no map."""
        if self.thickness is None:
            return None
        shape = self.thickness.shape
        x, y = (np.linspace(0, side, n) for side, n in zip(self.scene.plate.size, shape[::-1], strict=True))
        return np.asarray(laminate_of(self.original).factors_at(x, y)["thickness"] * self.original.plate.thickness)
