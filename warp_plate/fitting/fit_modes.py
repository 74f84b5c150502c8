"""Fit a scene's free numbers to measured natural frequencies and damping ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.fitting.free_numbers import free_numbers
from warp_plate.fitting.least_squares import fit_least_squares
from warp_plate.fitting.measured_modes import MeasuredModes
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Functions along each side, relative to those of other commands: frequencies are right to 5e-6, in a third of the time.
DENSITY = 0.5
# Modes of a free plate that are rigid motions.
RIGID = 3
# For pairs by nearest frequencies: so many times as many modes as measured, and so many more.
SPARE = 2, 8


@dataclass(frozen=True, eq=False)
class ModeFit:
    """A scene fitted to measured modes.

    Attributes:
        scene: The scene with the fitted numbers.
        measured: What was measured.
        keys: (p,) keys of the free numbers.
        values: (p,) fitted values.
        low: (p,) lower ends of the 95 % intervals, NaN for numbers that the data do not tell.
        high: (p,) upper ends.
        at_limit: (p,) True where a value is an end of its range.
        correlations: (p, p) correlations of values, or of their logarithms where ranges are above 0; else NaN.
        inseparable: Keys that these data cannot tell apart, group by group; a key alone has no influence on them.
        numbers: (n,) number of the mode that each frequency was paired with, from 1.
        frequencies: (n,) fitted natural frequencies [Hz].
        damping: (n,) fitted damping ratios ζ.
        evaluations: Number of plates whose modes were computed.
    """

    scene: Scene
    measured: MeasuredModes
    keys: tuple[str, ...]
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_limit: np.ndarray
    correlations: np.ndarray
    inseparable: tuple[tuple[str, ...], ...]
    numbers: np.ndarray
    frequencies: np.ndarray
    damping: np.ndarray
    evaluations: int

    @property
    def errors(self) -> np.ndarray:
        """(n,) relative errors of the fitted frequencies."""
        return self.frequencies / self.measured.frequencies - 1


def fit_modes(scene: Scene, measured: MeasuredModes) -> ModeFit:
    """Return the scene whose numbers under ``[fit.free]`` make its modes those that were measured.

    Residuals are relative errors of frequencies and of damping ratios. The size of the errors of both is estimated from
    the residuals.

    Raises:
        SceneError: The scene has no ``[fit]``, there are too few data, or a range leads to a scene that is refused.
    """
    free = free_numbers(scene)
    assert scene.fit is not None
    damped = np.flatnonzero(np.isfinite(measured.damping))
    count = len(measured.frequencies)
    if count + len(damped) <= len(free.keys):
        given = f"{count + len(damped)} numbers do not determine {len(free.keys)} free ones and their errors"
        raise SceneError(f"{measured.source}: {given}; measure more modes, or free fewer keys in [fit.free]")

    def residuals(fractions: np.ndarray) -> np.ndarray:
        _, frequencies, damping = _paired_modes(free.scene_at(fractions), measured)
        errors = damping[damped] / measured.damping[damped] - 1
        return np.append(frequencies / measured.frequencies - 1, errors)

    kinds = [np.arange(count), *([count + np.arange(len(damped))] if len(damped) else [])]
    found = fit_least_squares(residuals, free.starts(scene.fit.starts, scene.fit.seed), kinds)
    fitted, width = free.scene_at(found.unknowns), found.student * found.deviations
    numbers, frequencies, damping = _paired_modes(fitted, measured)
    return ModeFit(
        scene=fitted,
        measured=measured,
        keys=free.keys,
        values=free.values(found.unknowns),
        low=free.values(found.unknowns - width),
        high=free.values(found.unknowns + width),
        at_limit=np.abs(found.unknowns - 0.5) > 0.5 - 1e-6,
        correlations=found.correlations,
        inseparable=tuple(tuple(free.keys[index] for index in group) for group in found.inseparable),
        numbers=numbers,
        frequencies=frequencies,
        damping=damping,
        evaluations=found.evaluations,
    )


def _paired_modes(scene: Scene, measured: MeasuredModes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the number, frequency [Hz] and damping ratio of the mode for each measured one."""
    assert scene.fit is not None
    count = len(measured.frequencies)
    nearest = measured.numbers is None and scene.fit.pairing == "nearest"
    numbers = np.arange(1, count + 1) if measured.numbers is None else measured.numbers
    wanted = SPARE[0] * count + SPARE[1] if nearest else int(numbers.max())
    plate = solve_modes(linear_part(scene), highest=0.0, count=wanted + RIGID, density=DENSITY)
    moving = np.flatnonzero(plate.frequencies > 0)[:wanted]
    frequencies = plate.frequencies[moving]
    if nearest:
        distances = np.abs(np.log(measured.frequencies[:, None] / frequencies))
        numbers = 1 + scipy.optimize.linear_sum_assignment(distances)[1]
    return numbers, frequencies[numbers - 1], plate.damping_ratios[moving][numbers - 1]
