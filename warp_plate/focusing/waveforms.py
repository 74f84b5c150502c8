"""Waveforms by all methods for responses of the foci to the actuators, and what the optimum bounds."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from warp_plate.focusing import methods
from warp_plate.focusing.convolution import Convolution
from warp_plate.focusing.wishes import Wish
from warp_plate.scene.focus import Focus

METHODS = ("time_reversal", "one_bit", "inverse_filter", "optimum")


@dataclass(frozen=True)
class Gains:
    """How well the motion of each focus goes with its wish.

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
        reached = np.einsum("fan,fan->f", self.values, waveforms)
        return 1 - np.divide(reached, self.bound, out=np.ones_like(self.bound), where=self.bound > 0)


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
    made = {
        "time_reversal": lambda: gains.values,
        "one_bit": lambda: np.sign(gains.values),
        "inverse_filter": lambda: methods.inverse_filter(*least_squares(h, wish), condition),
        "optimum": lambda: gains.optimum,
    }
    return {name: methods.scale_to_limits(made[name](), *limits_of(table)) for name in METHODS if name in names}


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
