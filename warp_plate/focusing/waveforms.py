"""Waveforms by all methods for responses of the foci to the actuators, what the optimum bounds, and actuators by rank.

Actuators are left out one by one for a ranking, each time the one whose waveforms have the least energy. That is
backward elimination: other choices of as many actuators may do better, but for time reversal of one point under a limit
of the energy, where it is exact.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from warp_plate.focusing import methods
from warp_plate.focusing.figures import Figures
from warp_plate.focusing.methods import Convolution
from warp_plate.focusing.wishes import Wish
from warp_plate.result.focus import Ranking
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import Focus

METHODS = ("time_reversal", "one_bit", "inverse_filter", "optimum")


@dataclass(frozen=True)
class Gains:
    """Correlation of the motion of each focus with its wish.

    Attributes:
        values: (foci, actuators, samples) g, whose products with the waveforms are those of motion and wish.
        optimum: (foci, actuators, samples) waveforms of largest g·w within the limits.
        bound: (foci,) upper bounds of g·w of all waveforms within the limits.
    """

    values: np.ndarray
    optimum: np.ndarray
    bound: np.ndarray

    def gap(self, waveforms: np.ndarray) -> np.ndarray:
        """Return the parts (foci,) of the bounds that waveforms lack; 0 at a focus that nothing moves."""
        attained = np.einsum("fan,fan->f", self.values, waveforms)
        return 1 - np.divide(attained, self.bound, out=np.ones_like(self.bound), where=self.bound > 0)


def find_gains(h: np.ndarray, table: Focus, wish: Wish) -> Gains:
    """Return the gains of responses h (actuators, foci, recorded), without frequencies below ``focus.lowest``."""
    banded = methods.keep_above(h, table.rate, table.lowest) if table.lowest else h
    values = Convolution(banded, wish.samples).reverse(wish.apart(wish.motion))
    best, bounds = zip(*(methods.optimum(g, *limits_of(table)) for g in values), strict=True)
    return Gains(values, np.stack(best), np.array(bounds))


def make_waveforms(
    h: np.ndarray, table: Focus, wish: Wish, gains: Gains, condition: float, names: Collection[str] = METHODS
) -> dict[str, np.ndarray]:
    """Return the waveforms (foci, actuators, samples) of methods, scaled to the limits."""
    makers = {
        "time_reversal": lambda: gains.values,
        "one_bit": lambda: np.sign(gains.values),
        "inverse_filter": lambda: methods.inverse_filter(*least_squares(h, wish), condition),
        "optimum": lambda: gains.optimum,
    }
    return {name: methods.scale_to_limits(makers[name](), *limits_of(table)) for name in METHODS if name in names}


def least_squares(h: np.ndarray, wish: Wish) -> tuple[Convolution, np.ndarray]:
    """Return A and d of the least squares |A w − d|² that inverse filters minimise, the mean of several panels.

    Args:
        h: (actuators, panels · foci, recorded) responses, the foci of each panel after those of the one before.
    """
    panels = h.shape[1] // len(wish.followed)
    wished = np.tile(wish.apart(wish.followed), (1, panels, 1))
    return Convolution(h / panels**0.5, wish.samples), wished / panels**0.5


def limits_of(table: Focus) -> tuple[float | None, float | None]:
    """Return the largest Σ w² and |w|."""
    return None if table.energy is None else table.energy * table.rate, table.peak_limit


def check_rank(method: str, played: bool) -> None:
    """Raise a SceneError unless actuators can be ranked for a method; not where waveforms are ``played``."""
    if played:
        raise SceneError(f"rank = {method}: not for waveforms of a file, which all actuators were made for")
    if method not in METHODS:
        raise SceneError(f"rank = {method}: must be one of {', '.join(METHODS)}")


def rank_actuators(method: str, names: list[str], h: np.ndarray, table: Focus, wish: Wish, condition: float) -> Ranking:
    """Return the figures of each number of actuators, with waveforms made anew for each.

    Args:
        method: One of METHODS.
        names: (actuators,) names.
        h: (actuators, foci, recorded) responses of the foci.
        condition: Condition of the inverse filter.
    """
    remaining, left_out, rows = list(range(len(names))), [], []
    while remaining:
        part = h[remaining]
        waveforms = make_waveforms(part, table, wish, find_gains(part, table, wish), condition, [method])[method]
        figures = Figures.measure(Convolution(part, wish.samples).move(waveforms), wish)
        rows.append((np.abs(figures.peak).min(), figures.crosstalk_db.max(), figures.misfit.max()))
        left_out.append(remaining.pop(int((waveforms**2).sum(axis=(0, 2)).argmin())))
    peak, crosstalk_db, misfit = np.array(rows[::-1]).T
    order = tuple(names[index] for index in left_out[::-1])
    return Ranking(method, order, peak, crosstalk_db, misfit if wish.shaped else None)
