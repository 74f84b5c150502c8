"""The result of a run of plates."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.solve.status import OK

SOUND = (OK, math.nan)
# Called with (node-steps done, node-steps in all) between launches.
Progress = Callable[[int, int], None]


class PlateRunner(Protocol):
    """Solvers that run plates, by time steps or by modes; see :class:`PlateSolver`."""

    @property
    def scene(self) -> Scene:
        """The scene."""

    def run(self, drives: Any, times: Any = ..., points: Any = ..., progress: Any = ..., peak_times: Any = ...) -> Run:
        """Return energies and records of a batch of plates."""


@dataclass(frozen=True, eq=False)
class Run:
    """Energies, records and faults of a batch of plates."""

    # (plates, regions) kinetic energy ½∫ρH v² averaged over the window [J]; of a solver of displacements the same
    # with u in place of v [kg·m²]. NaN for a faulty plate.
    energy: np.ndarray
    regions: tuple[str, ...]  # Names of the regions
    masses: np.ndarray  # (regions,) masses [kg]
    displacement: np.ndarray  # (plates, times, ny, nx) [m]
    times: np.ndarray  # (times,) times of the grid nearest to those asked for [s]
    # (plates, rows, columns) largest magnitude of the displacement at ``peak_times`` [m], at the nodes, or by modes on
    # a finer grid; 0 for none
    peak: np.ndarray
    trace: np.ndarray  # (plates, points, steps) displacement [m]
    trace_times: np.ndarray  # (steps,) [s]
    node_steps: int  # Nodes updated × steps × plates
    # Fault of each faulty plate (see ``solve.status``), and the time at which it was found to grow without
    # bound [s], NaN if it was not
    faults: dict[int, tuple[str, float]]
    outline_peak: np.ndarray | None = None  # (plates,) the same as ``peak`` on the target's outline; None by time steps

    @property
    def finite(self) -> np.ndarray:
        """(plates,) true where all energies of a plate are finite."""
        return np.isfinite(self.energy).all(axis=1)

    @property
    def mean_square(self) -> np.ndarray:
        """(plates, regions) velocity² [m²/s²] or displacement² [m²], averaged over the window and the region's mass."""
        return 2 * self.energy / self.masses

    @property
    def status(self) -> np.ndarray:
        """(plates,) "ok" or the fault."""
        return np.array([self.faults.get(plate, SOUND)[0] for plate in range(len(self.energy))], dtype=object)

    @property
    def growth_time(self) -> np.ndarray:
        """(plates,) time at which a plate was found to grow without bound [s], otherwise NaN."""
        return np.array([self.faults.get(plate, SOUND)[1] for plate in range(len(self.energy))], dtype=float)

    def fault(self, plate: int) -> str:
        """Return the fault of a plate with its time, or "ok"."""
        fault, seen = self.faults.get(plate, SOUND)
        return f"{fault} by t = {seen:.4g} s" if math.isfinite(seen) else fault
