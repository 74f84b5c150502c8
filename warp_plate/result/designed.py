"""A designed panel: its scene, and what it can do beside the panel that the design began with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from warp_plate.plate.section import laminate_of
from warp_plate.scene.model import Scene

# Part by which rounding may pass a limit.
EXCESS = 1e-6


@dataclass(frozen=True)
class PanelValues:
    """Values of a panel, by all modes of other commands."""

    bound: float  # largest localization factor of any drive
    value: float  # what is maximised: the least of all cases of the bound, or of what the scene's drive does
    # by what part each limit of the design is passed, by name; 0 or less where it is kept
    excess: Mapping[str, float] = field(default_factory=dict)

    @property
    def kept(self) -> bool:
        """True if all limits are kept."""
        return all(excess <= EXCESS for excess in self.excess.values())


@dataclass(frozen=True)
class StepCheck:
    """Localization factor of one drive of the designed panel by modes, and by time steps on ever finer grids."""

    modes: float
    steps: float = math.nan  # extrapolated from the grids; NaN without
    error: float = math.inf  # its error, as by Richardson's extrapolation
    reason: str = ""  # why there are no time steps

    @property
    def agrees(self) -> bool:
        """True if the modes are within the error of the time steps."""
        return abs(self.modes - self.steps) <= self.error


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
    left_out: tuple[str, ...] = ()  # keys in the original of the tables that ``[design.count]`` leaves out
    relaxed: float | None = None  # largest value of panels with all candidates of it, no bound; None without
    ceiling: float | None = None  # proved bound on the localization factor of all panels; None where none is known
    interrupted: bool = False  # True if the search ended before its last start
    check: StepCheck | None = None  # the designed panel in time steps; None if that was not asked for

    @property
    def improved(self) -> bool:
        """True if the designed scene is another one than the original."""
        return self.after is not self.before

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
