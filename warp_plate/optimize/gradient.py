"""Quasi-Newton descents from many starting points at once, for losses with known gradients.

Source: Nocedal and Wright, Numerical Optimization, 2nd ed., 2006: BFGS (6.17) with the first scaling (6.20), steps
shortened until the loss falls enough (3.4); limits by Bertsekas, SIAM J. Control Optim. 20(2), 1982: a variable that
would leave its range is fixed, and the others continue. Each descent evaluates one position an iteration, so that
evaluations are counted as any other method's; the slope there is known by formula. A descent that has converged begins
again elsewhere while it has restarts left.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warp_plate.optimize.optimizer import MethodError, Optimizer, SearchSettings, SearchSpace

# The loss must fall by this fraction of the predicted decrease; otherwise the step is shortened by a factor in between.
SUFFICIENT_DECREASE, SHORTEST, LONGEST = 1e-4, 0.1, 0.5
# The first step, in initial ranges.
FIRST_STEP = 0.2
# A descent has converged where the slope promises no more than this part of the loss, or, where that is nearly zero, of
# this part of its scale.
CONVERGED = 1e-14
MOST_TRIES = 30

# Function from positions (n, dimension) of a space to losses (n,) and their slopes (n, dimension).
Slopes = Callable[[np.ndarray, SearchSpace], tuple[np.ndarray, np.ndarray]]


class GradientSearch(Optimizer):
    """Descents side by side, in units of the initial ranges; arrays have a row for each descent.

    Attributes:
        base: (starts, dimension) where the descent is.
        loss: (starts,) loss there; infinite before the base has been evaluated.
        slope: (starts, dimension) gradient there.
        inverse: (starts, dimension, dimension) inverse Hessian; zero while nothing is known of it.
        direction: (starts, dimension) direction of the search along a line.
        step: (starts,) part of ``direction`` that is tried next.
        tries: (starts,) number of steps from this base that failed.
        restarts_left: (starts,) restarts left; −1 for a descent that has ended.
    """

    FORMAT = "gradient 2"
    STATE = ("random", "base", "loss", "slope", "inverse", "direction", "step", "tries", "restarts_left")

    def __init__(
        self, space: SearchSpace, slopes: Slopes | None, settings: SearchSettings, start: np.ndarray | None = None
    ) -> None:
        """Draw the first places, of which ``start`` (dimension,) is one; raises MethodError without slopes."""
        super().__init__(space, settings)
        if slopes is None:
            raise MethodError("needs the slopes of energies, which time steps do not have; write 'cma'")
        self._slopes = slopes
        self.random = np.random.default_rng(settings.seed)
        self._limits = space.to_unit(space.lower), space.to_unit(space.upper)
        starts, dimension = settings.particles, space.dimension
        self.base, self.slope, self.direction = np.zeros((3, starts, dimension))
        self.inverse = np.zeros((starts, dimension, dimension))
        self.loss, self.step, self.tries = np.full(starts, np.inf), np.ones(starts), np.zeros(starts)
        self.restarts_left = np.full(starts, float(settings.restarts))
        self._draw(np.arange(starts))
        if start is not None:
            self.base[0] = space.to_unit(start)

    def stop(self) -> dict[str, int]:
        """Return {"evaluations": number}, {"converged": descents}, {"stall": iterations}, or nothing to go on."""
        reasons = {
            "evaluations": self.evaluations if self.evaluations >= self.settings.evaluations else None,
            "converged": None if (self.restarts_left >= 0).any() else self.settings.particles,
            "stall": self.settings.stall if self.stalled() else None,
        }
        return {reason: number for reason, number in reasons.items() if number is not None}

    def _propose(self) -> np.ndarray:
        """Return the next position of each descent that has not ended, as far as the budget goes."""
        room = max(self.settings.evaluations - self.evaluations, 0)
        self._active = rows = np.flatnonzero(self.restarts_left >= 0)[:room]
        self._points = np.clip(self.base[rows] + self.step[rows, None] * self.direction[rows], *self._limits)
        return self.space.from_unit(self._points)

    def _learn(self, losses: np.ndarray) -> None:
        """Advance the descents by the losses that come with the slopes, and fit them to the last digit."""
        loss, slope = self._slopes(self.space.from_unit(self._points, wrap=False), self.space)
        slope = slope * self.space.span
        good = np.isfinite(loss) & np.isfinite(slope).all(axis=1)
        loss, slope = np.where(good, loss, np.inf), np.where(good[:, None], slope, 0.0)
        rows, steps = self._active, self._points - self.base[self._active]
        first = np.isinf(self.loss[rows])
        with np.errstate(invalid="ignore"):
            falls = loss <= self.loss[rows] + SUFFICIENT_DECREASE * (self.slope[rows] * steps).sum(axis=1)
        taken = np.where(first, good, falls & good)
        later, failed = taken & ~first, ~taken & ~first
        self._update_inverse(rows[later], steps[later], slope[later])
        self._shorten(rows[failed], loss[failed], steps[failed])
        self.base[rows[taken]], self.loss[rows[taken]] = self._points[taken], loss[taken]
        self.slope[rows[taken]], self.tries[rows[taken]] = slope[taken], 0
        self._set_direction(rows[taken])
        self._restart(rows[first & ~good])

    def _draw(self, rows: np.ndarray) -> None:
        """Draw new places for descents."""
        self.base[rows] = np.clip(self.random.random((len(rows), self.space.dimension)), *self._limits)
        self.loss[rows], self.direction[rows], self.step[rows], self.tries[rows] = np.inf, 0.0, 1.0, 0
        self.inverse[rows] = 0.0

    def _update_inverse(self, rows: np.ndarray, steps: np.ndarray, slope: np.ndarray) -> None:
        """Apply the BFGS formula: the inverse Hessian from how the slope changed along the step."""
        change = slope - self.slope[rows]
        curved, length = (steps * change).sum(axis=1), (change * change).sum(axis=1)
        good = curved > 1e-12 * np.sqrt(length * (steps * steps).sum(axis=1))
        rows, steps, change, curved, length = (values[good] for values in (rows, steps, change, curved, length))
        inverse = self.inverse[rows]
        unknown = ~inverse.any(axis=(1, 2))
        inverse[unknown] = np.eye(self.space.dimension) * (curved / length)[unknown, None, None]
        product = np.einsum("pij,pj->pi", inverse, change)
        factor = (1 + (change * product).sum(axis=1) / curved) / curved
        mixed = steps[:, :, None] * product[:, None, :]
        inverse += factor[:, None, None] * steps[:, :, None] * steps[:, None, :]
        self.inverse[rows] = inverse - (mixed + mixed.transpose(0, 2, 1)) / curved[:, None, None]

    def _set_direction(self, rows: np.ndarray) -> None:
        """Choose the direction to try next from the base; where it promises nothing, the descent has converged."""
        base, slope, inverse = self.base[rows], self.slope[rows], self.inverse[rows]
        lower, upper = self._limits
        inside = ~(((base <= lower) & (slope > 0)) | ((base >= upper) & (slope < 0)))
        slope = np.where(inside, slope, 0.0)
        unknown = ~inverse.any(axis=(1, 2))
        direction = np.where(inside, -np.einsum("pij,pj->pi", inverse, slope), 0.0)
        size = np.sqrt((slope * slope).sum(axis=1))
        direction[unknown] = -FIRST_STEP * slope[unknown] / np.where(size > 0, size, 1.0)[unknown, None]
        promised = -(direction * slope).sum(axis=1)
        self.direction[rows], self.step[rows] = direction, 1.0
        sizes = np.maximum(np.abs(self.loss[rows]), CONVERGED * self.settings.loss_scale)
        self._restart(rows[~(promised > CONVERGED * sizes)])

    def _shorten(self, rows: np.ndarray, loss: np.ndarray, steps: np.ndarray) -> None:
        """Shorten steps with too small a decrease of the loss, by parabolic interpolation."""
        promised = (self.slope[rows] * steps).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = -promised / (2 * (loss - self.loss[rows] - promised))
        self.step[rows] *= np.clip(np.nan_to_num(factor, nan=SHORTEST), SHORTEST, LONGEST)
        self.tries[rows] += 1
        tired = rows[self.tries[rows] >= MOST_TRIES]
        informed = self.inverse[tired].any(axis=(1, 2))
        self._restart(tired[~informed])
        # The inverse Hessian misleads: once more along the slope.
        again = tired[informed]
        self.inverse[again], self.tries[again] = 0.0, 0
        self._set_direction(again)

    def _restart(self, rows: np.ndarray) -> None:
        """Let descents that have converged begin elsewhere, or end."""
        self.restarts_left[rows] -= 1
        self._draw(rows[self.restarts_left[rows] >= 0])

    def _restore(self, state: Mapping[str, Any]) -> None:
        super()._restore(state)
        if self.asked:
            self._propose()
