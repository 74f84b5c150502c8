"""What a solver gives back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.solve.status import OK


@dataclass(frozen=True)
class Run:
    """What the plates did.

    energy: (plates, regions) kinetic energy ½∫ρH v² averaged over the window [J]; of a solver of displacements the same
    with u in place of v [kg·m²], u being that at the end of each of the window's steps. NaN for a plate that went
    wrong, such as one whose drive is of a size beyond SMALLEST_DRIVE ... LARGEST_DRIVE. regions: their names; masses:
    (regions,) [kg]. displacement: (plates, times, ny, nx) [m]; times: (times,) [s], those of the grid that lie nearest
    to the ones asked for. trace: (plates, points, steps) [m]; trace_times: (steps,) [s]. node_steps: nodes updated ×
    steps × plates. faults: of the plates that went wrong, by their places in the batch, what it was, see
    ``solve.status``, and the time at which the plate was seen to grow without bound [s], NaN where it was not.
    """

    energy: np.ndarray
    regions: tuple[str, ...]
    masses: np.ndarray
    displacement: np.ndarray
    times: np.ndarray
    trace: np.ndarray
    trace_times: np.ndarray
    node_steps: int
    faults: Mapping[int, tuple[str, float]]

    @property
    def finite(self) -> np.ndarray:
        """(plates,) whether a plate's energies are numbers."""
        return np.isfinite(self.energy).all(axis=1)

    @property
    def mean_square(self) -> np.ndarray:
        """(plates, regions) velocity² [m²/s²], or displacement² [m²]: mean over the window and the region's mass."""
        return 2 * self.energy / self.masses

    @property
    def status(self) -> np.ndarray:
        """(plates,) "ok" or what went wrong."""
        status = np.full(len(self.energy), OK, dtype=object)
        for plate, (word, _) in self.faults.items():
            status[plate] = word
        return status

    @property
    def caught(self) -> np.ndarray:
        """(plates,) time at which a plate was seen to grow without bound [s], NaN where it was not."""
        caught = np.full(len(self.energy), math.nan)
        for plate, (_, seen) in self.faults.items():
            caught[plate] = seen
        return caught

    def fault(self, plate: int) -> str:
        """What went wrong with a plate, for people; "ok" where nothing did."""
        word, caught = self.faults.get(plate, (OK, math.nan))
        return f"{word} by t = {caught:.4g} s" if math.isfinite(caught) else word
