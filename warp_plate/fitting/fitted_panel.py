"""A fitted scene and the uncertainty of its values, for all kinds of measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.fitting.free_numbers import FreeNumbers
from warp_plate.fitting.least_squares import Prediction, Residuals, Weigh, fit_least_squares
from warp_plate.fitting.refits import bootstrap, exchangeable, profile
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Quantiles of 95 % intervals.
TAILS = 0.025, 0.975


@dataclass(frozen=True, eq=False)
class FittedPanel:
    """A scene with fitted numbers.

    Attributes:
        scene: The scene with the fitted numbers.
        keys: (p,) keys of the free numbers.
        values: (p,) fitted values.
        low: (p,) lower ends of the 95 % intervals, NaN for numbers that the data do not tell.
        high: (p,) upper ends.
        at_limit: (p,) True where a value is an end of its range.
        correlations: (p, p) correlations of values, or of their logarithms where ranges are above 0; else NaN.
        inseparable: Groups of keys that these data cannot distinguish; a group of one key has no influence on the data.
        mirrored: Groups of keys of opposite edges whose numbers may change places without a change of the data.
        evaluations: Number of plates that were computed.
        bootstrap: (2, p) ends of the 95 % intervals by the bootstrap; None if it was not asked for.
        profiles: (2, p, points) values of each number, and by how much χ² rises if the number is fixed there and the
            others are fitted; None if they were not asked for.
        rise: Rise of χ² at the ends of a 95 % interval.
    """

    scene: Scene
    keys: tuple[str, ...]
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_limit: np.ndarray
    correlations: np.ndarray
    inseparable: tuple[tuple[str, ...], ...]
    mirrored: tuple[tuple[str, ...], ...]
    evaluations: int
    bootstrap: np.ndarray | None
    profiles: np.ndarray | None
    rise: float


def fit_panel(
    free: FreeNumbers,
    source: str,
    count: int,
    predict: Prediction,
    residuals: Sequence[Residuals],
    weigh: Weigh | None,
    kinds: Sequence[np.ndarray],
    exact: Prediction | None = None,
) -> FittedPanel:
    """Fit a scene by least squares to measurements.

    Args:
        free: Free numbers of the scene.
        source: File of the measurements, for errors.
        count: Number of residuals.
        predict: What is measured, as a function of fractions of the ranges.
        residuals: Residuals of predictions, see :func:`fit_least_squares`.
        weigh: Weights, see the same.
        kinds: Residuals that are drawn together and from each other, see :func:`bootstrap`.
        exact: Prediction that takes more time, see the same.

    Raises:
        SceneError: There are too few data, or a range leads to a scene that is refused.
    """
    fit = free.scene.fit
    assert fit is not None
    if count <= len(free.keys):
        given = f"{count} numbers do not determine {len(free.keys)} free ones and their errors"
        raise SceneError(f"{source}: {given}; measure more, or free fewer keys in [fit.free]")
    found = fit_least_squares(predict, residuals, free.starts(fit.starts, fit.seed), weigh, exact)
    samples = profiles = None
    if fit.bootstrap:
        drawn = bootstrap(found, kinds, weigh, fit.bootstrap, fit.seed)
        samples = np.where(np.isnan(found.deviations), np.nan, np.quantile(drawn, TAILS, axis=0))
    if fit.profile:
        grids, rises = profile(found, fit.profile)
        profiles = np.stack([np.array([free.values(column) for column in grids.T]).T, rises])
    mirrored = [pairs for pairs in free.mirror_pairs() if exchangeable(found, pairs)]
    width = found.student * found.deviations
    return FittedPanel(
        scene=free.scene_at(found.unknowns),
        keys=free.keys,
        values=free.values(found.unknowns),
        low=free.values(found.unknowns - width),
        high=free.values(found.unknowns + width),
        at_limit=np.abs(found.unknowns - 0.5) > 0.5 - 1e-6,
        correlations=found.correlations,
        inseparable=tuple(tuple(free.keys[index] for index in group) for group in found.inseparable),
        mirrored=tuple(tuple(free.keys[index] for pair in pairs for index in pair) for pairs in mirrored),
        evaluations=predict.evaluations + (exact.evaluations if exact else 0),
        bootstrap=None if samples is None else np.array([free.values(row) for row in samples]),
        profiles=profiles,
        rise=found.student**2,
    )
