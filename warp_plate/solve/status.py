"""Detection of plates that did not move as bounded ones do.

At a stable step the scheme's energy grows only by the work of the load. So after n steps no rate exceeds n times the
norm of a step's load, apart from factors that a step next to the limit and unequal masses bring. A rate above that by
the factor SLACK is unstable growth.
"""

from __future__ import annotations

from functools import reduce

import numpy as np

from warp_plate.solve.specialize import Specialized

OK = "ok"
NO_DRIVE = "drive is not finite"
GREW = "grew without bound"
OUT_OF_RANGE = "energy is out of the range of numbers"
FAULTS = (OK, OUT_OF_RANGE, GREW, NO_DRIVE)

# At a step next to the limit, rates are some ten times what the load's work gives; unequal masses take the rest.
SLACK = 1e3
# Steps, or node-steps of large batches, between two checks of plates that may grow.
CHECK_STEPS, CHECK_NODE_STEPS = 16, {"cpu": 2e7, "cuda": 2e9}


def largest_rate_per_step(specialized: Specialized) -> float:
    """Return the rate, in the kernels' units, that no bounded plate exceeds per step since the start."""
    norms = np.linalg.norm(specialized.patches.numpy().astype(float), axis=1)
    if specialized.discretization.per_plate.centre:  # the largest norms wherever the actuators are
        areas = np.array([actuator.area for actuator in specialized.scene.actuators])
        sides = np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1)
        covered = (sides / specialized.scheme.spacing + 2).prod(axis=1)
        norms = np.maximum(norms, specialized.share.max() * np.sqrt(covered))
    # Waves are below two in size and coefficients at most one.
    load = 2 * specialized.effects.terms * norms.sum()
    if specialized.discretization.moving is not None:
        load += np.sqrt(specialized.interior_nodes)
    return SLACK * float(load)


def steps_between_checks(specialized: Specialized, plates: int) -> int | None:
    """Return after how many steps to check for growth; None for plates that cannot grow.

    Plates may grow above the stability limit, and where they stretch.
    """
    if not specialized.scheme.stable:
        return CHECK_STEPS
    if not specialized.effects.stretching:
        return None
    work = CHECK_NODE_STEPS["cuda" if specialized.device.is_cuda else "cpu"]
    return max(CHECK_STEPS, int(work / (plates * specialized.interior_nodes)))


def exceeds(rate: np.ndarray, largest: float) -> np.ndarray:
    """Return (plates,), true where some rate (plates, rows, columns) is above ``largest`` or not a number."""
    return np.asarray(~(np.maximum(rate.max(axis=(1, 2)), -rate.min(axis=(1, 2))) <= largest))


def find_faults(
    phasors: np.ndarray,
    scale: np.ndarray,
    grown: np.ndarray,
    sums: np.ndarray,
    unit: float,
    largest_sum: float,
    energy: np.ndarray,
) -> dict[int, str]:
    """Write the energies of plates, NaN for faulty ones, and return the faults by plate.

    Args:
        phasors: (plates, actuators) drives.
        scale: (plates,) pressures that plates are scaled by, not finite if a drive is not.
        grown: (plates,) step at which growth was seen, or −1.
        sums: (plates, regions) weighted sums of rate² over the window.
        unit: Energy of a sum of one at a scale of one [J].
        largest_sum: Largest sum of a bounded plate.
        energy: (plates, regions) takes the energies [J].
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
