"""Quasi-Newton descent from many places at once, for losses that are functions of quadratic forms.

Source: Nocedal and Wright, Numerical Optimization, 2nd ed., 2006: BFGS (6.17) with the first scaling (6.20), steps
shortened until the loss falls enough (3.4); limits by Bertsekas, SIAM J. Control Optim. 20(2), 1982: a number that
would leave its range is held, and the others go on. Each descent asks for one position an iteration and is told its
loss, so that evaluations are counted as any other method's; the slope there is known from the matrices. A descent that
has come to rest begins anew elsewhere while ``restarts`` are left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.record import Record, Recorded, check_format, plain, shaped
from warp_plate.optimize.space import Space

STATE_FORMAT = "gradient 1"
# The loss must fall by this part of what the slope promises; a step that does not is shortened by a factor in between.
ENOUGH, SHORTEST, LONGEST = 1e-4, 0.1, 0.5
# The first step, in first ranges; a descent rests where the slope promises no more than this part of the loss, or,
# where that is nearly zero, of this part of its least size.
FIRST_STEP, REST = 0.2, 1e-14
TRIES = 30
ARRAYS = ("base", "loss", "slope", "inverse", "way", "step", "tries", "left")


@dataclass(frozen=True)
class GradientSettings:
    """starts: descents side by side; evaluations: in all, never passed; restarts: of each descent, at most;
    loss_scale: see ``record.tolerance_scale``."""

    starts: int
    evaluations: int
    restarts: int = 0
    stall: int | None = None
    seed: int = 0
    loss_scale: float = 1.0


class GradientSearch(Recorded):
    """Descents in units of the first ranges. Arrays have a row for each: where it is (base), its loss and slope there,
    the inverse Hessian, the way that it tries and what part of it (step), how many tries failed; left: how many
    restarts are (−1: it rests for good). An infinite loss is a base that has not been evaluated."""

    def __init__(self, space: Space, problem: Quadratic, settings: GradientSettings) -> None:
        self.space, self.problem, self.settings = space, problem, settings
        self._random = np.random.default_rng(settings.seed)
        self._span = np.where(space.initial_upper > space.initial_lower, space.initial_upper - space.initial_lower, 1.0)
        self._limits = tuple((end - space.initial_lower) / self._span for end in (space.lower, space.upper))
        self._record = Record(space.dimension, settings.loss_scale)
        starts, dimension = settings.starts, space.dimension
        self.base, self.loss = np.zeros((starts, dimension)), np.full(starts, np.inf)
        self.slope, self.way = np.zeros((starts, dimension)), np.zeros((starts, dimension))
        self.inverse = np.zeros((starts, dimension, dimension))
        self.step, self.tries = np.ones(starts), np.zeros(starts)
        self.left = np.full(starts, float(settings.restarts))
        self._draw(np.arange(starts))
        self._active = np.empty(0, dtype=int)
        self._points = self.positions = np.empty((0, dimension))
        self._asked = False

    def ask(self) -> np.ndarray:
        """The next position of each descent that does not rest, (up to starts, dimension); the same until told."""
        if not self._asked:
            self._ask()
        return self.positions.copy()

    def tell(self, solutions: ArrayLike, losses: ArrayLike) -> None:
        """Take the losses of the positions that ``ask`` gave, for the record; descents go by those of the matrices,
        which fit the slopes to the last digit.

        Raises ValueError if `solutions` are not those positions or `losses` has another shape.
        """
        self._record.tell(self.positions if self._asked else None, solutions, losses)
        found, slopes = self.problem.losses_and_slopes(
            self._place(self._points, wrap=False), self._span, self.space.lower, self.space.upper
        )
        slopes = slopes * self._span
        good = np.isfinite(found) & np.isfinite(slopes).all(axis=1)
        found, slopes = np.where(good, found, np.inf), np.where(good[:, None], slopes, 0.0)
        rows, moved = self._active, self._points - self.base[self._active]
        first = np.isinf(self.loss[rows])
        with np.errstate(invalid="ignore"):
            falls = found <= self.loss[rows] + ENOUGH * (self.slope[rows] * moved).sum(axis=1)
        taken = np.where(first, good, falls & good)
        self._learn(rows[taken & ~first], moved[taken & ~first], slopes[taken & ~first])
        self._shorten(rows[~taken & ~first], found[~taken & ~first], moved[~taken & ~first])
        self.base[rows[taken]], self.loss[rows[taken]] = self._points[taken], found[taken]
        self.slope[rows[taken]], self.tries[rows[taken]] = slopes[taken], 0
        self._turn(rows[taken])
        self._rest(rows[first & ~good])
        self._asked = False

    def stop(self) -> dict[str, int]:
        """Why to stop: {"evaluations": how many}, {"rest": how many descents}, {"stall": ...}; empty to go on."""
        reasons = {}
        if self._record.evaluations >= self.settings.evaluations:
            reasons["evaluations"] = self._record.evaluations
        if not (self.left >= 0).any():
            reasons["rest"] = self.settings.starts
        if self.settings.stall is not None and self._record.stalled(self.settings.stall):
            reasons["stall"] = self.settings.stall
        return reasons

    def state(self, plain_numbers: bool = True) -> dict[str, Any]:
        """All that the search needs to go on; strict JSON types, or with False arrays as arrays."""
        state = {
            "format": STATE_FORMAT,
            "random": self._random.bit_generator.state,
            **{name: getattr(self, name).copy() for name in ARRAYS},
            **self._record.state(),
            "asked": self._asked,
        }
        return plain(state) if plain_numbers else state

    @classmethod
    def from_state(
        cls, space: Space, problem: Quadratic, settings: GradientSettings, state: dict[str, Any]
    ) -> GradientSearch:
        """The search that ``state()`` was taken from, bit for bit. Raises ValueError for anything else."""
        search = cls(space, problem, settings)
        try:
            check_format(state, STATE_FORMAT)
            search._random.bit_generator.state = state["random"]
            for name in ARRAYS:
                setattr(search, name, shaped(state, name, getattr(search, name).shape))
            search._record.load(state)
            if state["asked"]:
                search._ask()
        except (KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"search state: {error} is missing or of a wrong kind") from None
        return search

    def _ask(self) -> None:
        """Follows from the arrays alone, so that a state need not hold it."""
        room = self.settings.evaluations - self._record.evaluations
        self._active = np.flatnonzero(self.left >= 0)[: max(room, 0)]
        rows = self._active
        self._points = np.clip(self.base[rows] + self.step[rows, None] * self.way[rows], *self._limits)
        self.positions = self._place(self._points)
        self._asked = True

    def _place(self, points: np.ndarray, wrap: bool = True) -> np.ndarray:
        """Positions of points in units of the first ranges."""
        space = self.space
        positions = space.initial_lower + self._span * points
        wraps = np.isfinite(space.period) & wrap
        period, lowest = space.period[wraps], space.initial_lower[wraps]
        positions[:, wraps] -= period * np.floor((positions[:, wraps] - lowest) / period)
        clipped: np.ndarray = np.clip(positions, space.lower, space.upper)
        return clipped

    def _draw(self, rows: np.ndarray) -> None:
        """New places for descents."""
        self.base[rows] = np.clip(self._random.random((len(rows), self.space.dimension)), *self._limits)
        self.loss[rows], self.way[rows], self.step[rows], self.tries[rows] = np.inf, 0.0, 1.0, 0
        self.inverse[rows] = 0.0

    def _learn(self, rows: np.ndarray, moved: np.ndarray, slopes: np.ndarray) -> None:
        """BFGS: the inverse Hessian from how the slope changed along the way."""
        bent = slopes - self.slope[rows]
        curved, length = (moved * bent).sum(axis=1), (bent * bent).sum(axis=1)
        kept = curved > 1e-12 * np.sqrt(length * (moved * moved).sum(axis=1))
        rows, moved, bent, curved, length = rows[kept], moved[kept], bent[kept], curved[kept], length[kept]
        inverse = self.inverse[rows]
        unknown = ~inverse.any(axis=(1, 2))
        inverse[unknown] = np.eye(self.space.dimension) * (curved / length)[unknown, None, None]
        bent_inverse = np.einsum("pij,pj->pi", inverse, bent)
        factor = (1 + (bent * bent_inverse).sum(axis=1) / curved) / curved
        mixed = moved[:, :, None] * bent_inverse[:, None, :]
        inverse += factor[:, None, None] * moved[:, :, None] * moved[:, None, :]
        inverse -= (mixed + mixed.transpose(0, 2, 1)) / curved[:, None, None]
        self.inverse[rows] = inverse

    def _turn(self, rows: np.ndarray) -> None:
        """The way to try next from the base; where it promises nothing, the descent rests."""
        base, slope, inverse = self.base[rows], self.slope[rows], self.inverse[rows]
        lower, upper = self._limits
        free = ~(((base <= lower) & (slope > 0)) | ((base >= upper) & (slope < 0)))
        slope = np.where(free, slope, 0.0)
        unknown = ~inverse.any(axis=(1, 2))
        way = np.where(free, -np.einsum("pij,pj->pi", inverse, slope), 0.0)
        size = np.sqrt((slope * slope).sum(axis=1))
        way[unknown] = -FIRST_STEP * slope[unknown] / np.where(size > 0, size, 1.0)[unknown, None]
        promised = -(way * slope).sum(axis=1)
        self.way[rows], self.step[rows] = way, 1.0
        sizes = np.maximum(np.abs(self.loss[rows]), REST * self.settings.loss_scale)
        self._rest(rows[~(promised > REST * sizes)])

    def _shorten(self, rows: np.ndarray, found: np.ndarray, moved: np.ndarray) -> None:
        """The loss did not fall enough: a shorter step, by the parabola through what is known."""
        promised = (self.slope[rows] * moved).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = -promised / (2 * (found - self.loss[rows] - promised))
        self.step[rows] *= np.clip(np.nan_to_num(factor, nan=SHORTEST), SHORTEST, LONGEST)
        self.tries[rows] += 1
        tired = rows[self.tries[rows] >= TRIES]
        known = self.inverse[tired].any(axis=(1, 2))
        self._rest(tired[~known])
        # What was learnt misleads: once more straight down.
        again = tired[known]
        self.inverse[again], self.tries[again] = 0.0, 0
        self._turn(again)

    def _rest(self, rows: np.ndarray) -> None:
        """Descents that found their minimum begin elsewhere, or end."""
        self.left[rows] -= 1
        self._draw(rows[self.left[rows] >= 0])
