"""The result of a run of plates, their faults, and the largest displacements of each plate over its run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Protocol

import numpy as np

from warp_plate.plate.signals import SAMPLES_A_PERIOD, highest_frequency, sample_times
from warp_plate.plate.weights import region_weights
from warp_plate.scene.fields import SMALLEST
from warp_plate.scene.model import Scene

OK = "ok"
NO_DRIVE = "drive is not finite"
GREW = "grew without bound"
OUT_OF_RANGE = "energy is out of the range of numbers"
FAULTS = (OK, OUT_OF_RANGE, GREW, NO_DRIVE)
SOUND = (OK, math.nan)
# Samples in a quarter of a period.
QUARTER = SAMPLES_A_PERIOD // 4
# Most bytes of the fields of a plate among which the largest is recorded.
PEAK_BYTES = 2**27
# Fault and time [s] by faulty plate
Faults = dict[int, tuple[str, float]]
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
    # Fault of each faulty plate, and the time at which it was found to grow without
    # bound [s], NaN if it was not
    faults: Faults
    # (regions, 2M, 2M) matrices that the energies are quadratic forms of, see ``Response``; None by time steps
    matrices: np.ndarray | None = None
    outline_peak: np.ndarray | None = None  # (plates,) the same as ``peak`` on the target's outline; None by time steps

    def __repr__(self) -> str:
        return f"<Run {len(self.energy)} plates, {len(self.faults)} of them faulty>"

    @property
    def finite(self) -> np.ndarray:
        """(plates,) true where all energies of a plate are finite."""
        return np.isfinite(self.energy).all(axis=1)

    @property
    def status(self) -> np.ndarray:
        """(plates,) "ok" or the fault."""
        return np.array([self.faults.get(plate, SOUND)[0] for plate in range(len(self.energy))], dtype=object)

    def fault(self, plate: int) -> str:
        """Return the fault of a plate with its time, or "ok"."""
        fault, seen = self.faults.get(plate, SOUND)
        return f"{fault} by t = {seen:.4g} s" if math.isfinite(seen) else fault


def find_faults(
    phasors: np.ndarray,
    scale: np.ndarray,
    grown: np.ndarray,
    sums: np.ndarray,
    unit: float,
    largest_sum: float,
    energy: np.ndarray,
) -> dict[int, str]:
    """Write the energies [J] (plates, regions) of plates, NaN for faulty ones, and return the faults by plate.

    ``grown`` has the step at which growth was seen, or −1; ``unit`` is the energy of a sum of one at a scale of one.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        energy[:] = sums * unit * scale[:, None] ** 2
        if (grown < 0).all() and sums.max(initial=0.0) <= largest_sum and ((energy > 0) & (energy < np.inf)).all():
            return {}
        grew = (grown >= 0) | ~_all_in_row(sums <= largest_sum)
    sound = _all_in_row(np.isfinite(energy) & ~((sums > 0) & (energy == 0)))
    faults = np.where(grew & np.isfinite(scale), FAULTS.index(GREW), ~sound)  # indices into FAULTS
    unscaled = np.flatnonzero(~np.isfinite(scale))
    faults[unscaled[~np.isfinite(phasors[unscaled]).all(axis=1)]] = FAULTS.index(NO_DRIVE)
    faulty = np.flatnonzero(faults)
    energy[faulty] = np.nan
    return {int(plate): FAULTS[faults[plate]] for plate in faulty}


def _all_in_row(values: np.ndarray) -> np.ndarray:
    """Return (rows,) ``values.all(axis=1)``, column by column because NumPy is slow along short rows."""
    every: np.ndarray = reduce(np.logical_and, values.T)
    return every


def run_with_peaks(
    solver: PlateRunner, phasors: np.ndarray, progress: Progress | None = None, recorded: Sequence[float] = ()
) -> tuple[Run, np.ndarray]:
    """Run phasors (plates, actuators) with the scene's records, or with displacements at other times ``recorded`` [s].

    Without any, the instant of the last plate's largest displacement is recorded, and if the drive is periodic, a
    quarter period before it. Also return the largest displacements (plates, 2) [m] in the target and in the rest.
    """
    scene = solver.scene
    recorded, samples = recorded or scene.record.times, sample_times(scene)
    tried = recorded or _candidates(solver, samples)
    run = solver.run(phasors, tried, scene.record.points, progress, (*tried, *samples))
    if not recorded:
        last = np.nan_to_num(np.abs(run.displacement[-1]).max(axis=(1, 2)), nan=0.0, posinf=0.0)
        if scene.nonperiodic_key:
            chosen = [int(last.argmax())]
        else:
            chosen = [latest := int(last[QUARTER:].argmax()), latest + QUARTER]
        run = replace(run, displacement=run.displacement[:, chosen], times=run.times[chosen])
    plate, target = region_weights(scene.with_keys("grid", nodes=run.peak.shape[:0:-1]))
    half = 2 * target >= np.maximum(plate, SMALLEST)  # of a node's cell is in the target
    target = half if half.any() else target > 0
    peaks = np.stack([run.peak[:, nodes].max(axis=1, initial=0.0) for nodes in (target, ~target)], axis=1)
    return run, peaks if run.outline_peak is None else np.maximum(peaks, run.outline_peak[:, None])


def _candidates(solver: PlateRunner, samples: tuple[float, ...]) -> tuple[float, ...]:
    """Return the times [s] among which that of the largest displacement is recorded.

    They are those of the last period of the highest frequency, after a quarter period, so that under a tone no node
    passes zero at both recorded times; of other drives than periodic ones, ``samples`` of the whole run.
    """
    scene, end = solver.scene, solver.scene.window.end
    if scene.nonperiodic_key:
        most = max(2, int(PEAK_BYTES / (8 * math.prod(scene.grid.nodes))))
        return tuple(sorted(samples)[:: math.ceil(len(samples) / most)])
    before = np.arange(SAMPLES_A_PERIOD + QUARTER - 1, -1, -1) / SAMPLES_A_PERIOD / highest_frequency(scene)
    return tuple(np.maximum(end - before, 0.0).tolist())
