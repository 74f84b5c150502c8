"""Whether plates moved as bounded ones do: a word for each.

At a stable step the energy of the scheme grows by the load's work alone, so that after n steps no rate is above n times
the norm of a step's load, but for factors that the nearness of the limit and unequal masses bring. What is above that
by SLACK and more grew by itself.
"""

from __future__ import annotations

from functools import reduce

import numpy as np

from warp_plate.plate.row_blocks import over_blocks
from warp_plate.solve.specialize import Specialized

OK = "ok"
NO_DRIVE = "drive is not finite"
GREW = "grew without bound"
OUT_OF_RANGE = "energy is out of the range of numbers"
FAULTS = (OK, OUT_OF_RANGE, GREW, NO_DRIVE)

# Room for a step next to the limit, where rates are some ten times what the load's work gives, and for unequal masses.
SLACK = 1e3
# Where growth is possible, plates are looked at after so many steps, or so many node-steps for large batches.
WATCHED_STEPS, WATCHED_NODE_STEPS = 16, {"cpu": 2e7, "cuda": 2e9}


def fastest_per_step(specialized: Specialized) -> float:
    """The rate, in the kernels' numbers, that no bounded plate reaches per step since the start."""
    patches = specialized.patches.numpy().astype(float)
    # Waves are below two in size and coefficients at most one.
    sizes = np.linalg.norm(patches, axis=1)
    if specialized.per_plate.centre:
        sizes = np.maximum(sizes, largest_patches(specialized))
    load = 2 * specialized.signals.terms * sizes.sum()
    if specialized.moving is not None:
        load += np.sqrt(specialized.interior_nodes)
    return SLACK * float(load)


def largest_patches(specialized: Specialized) -> np.ndarray:
    """(actuators,) what the norm of an actuator's load field is at most, wherever it is."""
    areas = np.array([actuator.area for actuator in specialized.scene.actuators])
    sides = np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1)
    covered = (sides / specialized.scheme.spacing + 2).prod(axis=1)
    largest: np.ndarray = specialized.share.max() * np.sqrt(covered)
    return largest


def watched_steps(specialized: Specialized, plates: int) -> int | None:
    """After how many steps to look at plates that may grow: above the limit, or where they stretch; None: never."""
    if not specialized.scheme.stable:
        return WATCHED_STEPS
    if not specialized.effects.stretching:
        return None
    work = WATCHED_NODE_STEPS["cuda" if specialized.device.is_cuda else "cpu"]
    return max(WATCHED_STEPS, int(work / (plates * specialized.interior_nodes)))


def outgrown(rate: np.ndarray, fastest: float) -> np.ndarray:
    """(plates,) whether some rate (plates, rows, columns) is above ``fastest`` or no number."""
    largest = np.maximum(rate.max(axis=(1, 2)), -rate.min(axis=(1, 2)))
    grown: np.ndarray = ~(largest <= fastest)
    return grown


def judge_plates(
    drives: np.ndarray,
    scale: np.ndarray,
    caught: np.ndarray,
    sums: np.ndarray,
    unit: float,
    most: float,
    energy: np.ndarray,
) -> dict[int, str]:
    """Write energies [J], NaN where a plate went wrong; returns of those plates what it was.

    drives: (plates, actuators); scale: (plates,) pressures that plates are scaled by, not finite where a drive is not;
    caught: (plates,) step at which growth was seen, or −1; sums: (plates, regions) of rate² over the window; unit: [J]
    of a sum at a scale of one; most: the largest sum of a bounded plate. energy: (plates, regions), written.
    """
    faults = np.zeros(len(drives), dtype=np.int8)  # places in FAULTS

    def judge(rows: slice) -> None:
        total, size = sums[rows], scale[rows]
        with np.errstate(invalid="ignore", over="ignore"):  # of plates that left the finite numbers
            joules = total * unit * size[:, None] ** 2
            grew = (caught[rows] >= 0) | ~_every(total <= most)
        energy[rows] = joules
        sound = _every(np.isfinite(joules) & ~((total > 0) & (joules == 0)))
        faults[rows] = np.where(grew & np.isfinite(size), FAULTS.index(GREW), ~sound)

    over_blocks(judge, len(drives))
    unscaled = np.flatnonzero(~np.isfinite(scale))
    faults[unscaled[~np.isfinite(drives[unscaled]).all(axis=1)]] = FAULTS.index(NO_DRIVE)
    wrong = np.flatnonzero(faults)
    energy[wrong] = np.nan
    return {int(plate): FAULTS[faults[plate]] for plate in wrong}


def _every(good: np.ndarray) -> np.ndarray:
    """(rows,) whether all of a row (rows, columns); column by column, for NumPy is slow along short rows."""
    every: np.ndarray = reduce(np.logical_and, good.T)
    return every
