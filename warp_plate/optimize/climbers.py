"""Maxima of a field near places of the plane or of lines, by patterns of points whose steps are shortened.

Each climber steps to the best point of the pattern around it or to the summit of the quadratic function, or parabola,
through the nearest of them. Its steps are shortened once this is near; far away they keep their length, so that it
follows ridges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

# Rounds of steps, how often they are shortened in a thorough search and in others, by what factor, and the steps along
# a line and around a point.
ROUNDS, SHRINKS, FEW_SHRINKS, SHRINKING = 30, 7, 3, 4.0
ALONG = np.array([0.0, -1.0, 1.0, -2.0, 2.0])[:, None]
AROUND = np.array([(i, j) for i in ALONG.ravel() for j in ALONG.ravel()])
NEAREST = [5 * i + j for i in (1, 0, 2) for j in (1, 0, 2)]  # rows of AROUND
# How often steps are shortened before a climber ends that gains little, and rounds before one ends that is too low.
SURELY = 2
# Largest distance of a summit from the middle of its nine points [steps].
REACH = 8.0


@dataclass
class Climbers:
    """Places that move to maxima: points (places, 2) [m], or lengths along a line (places, 1) [m]."""

    places: np.ndarray
    first: np.ndarray | float  # (2,) or one first steps [m]
    stencil: np.ndarray  # (n, 1 or 2) places that are tried [steps], the middle first
    at: Callable[[np.ndarray], np.ndarray]  # the points (..., 2) [m] at places (..., 1 or 2)
    summits: Callable[[np.ndarray], np.ndarray]  # (places, 1 or 2) [steps], from values (places, n) on the stencils
    least: float = 0.0  # gain below which a climber has arrived: 0 where the field has kinks, as at corners of lines

    def __post_init__(self) -> None:
        self.shrunk = np.zeros(len(self.places), dtype=int)  # (places,) times that the steps were shortened

    @property
    def steps(self) -> np.ndarray:
        """(places, 1 or 2) steps [m]."""
        return self.first * SHRINKING ** -self.shrunk[:, None]

    def trials(self) -> np.ndarray:
        """Return the (places, n, 1 or 2) places of the stencils."""
        return self.places[:, None] + self.stencil * self.steps[:, None]

    def tops(self, levels: np.ndarray) -> np.ndarray:
        """Return the (places, 1, 1 or 2) summits near the places, from values (places, n) on the stencils."""
        return (self.places + self.summits(levels) * self.steps)[:, None]

    def move(self, trials: np.ndarray, levels: np.ndarray, lowest: float, shrinks: int) -> np.ndarray:
        """Move to the best of trials (places, m, 1 or 2) by their levels (places, m), and shorten the steps where it is
        near, so many times. Leave out climbers that have arrived or are below ``lowest``, and return their points
        (n, 2) [m]."""
        best, rows = levels.argmax(axis=1), np.arange(len(levels))
        highest, places = levels[rows, best], trials[rows, best]
        far = (np.abs(places - self.places) > 1.5 * self.steps).any(axis=1)
        within = np.isfinite(levels).all(axis=1)  # at an edge, shorter steps may gain
        arrived = (self.shrunk >= SURELY) & within & (highest < levels[:, 0] + self.least)
        ended = ((arrived | (self.shrunk + 1 >= shrinks)) & ~far) | (highest < lowest)
        self.places, self.shrunk = places[~ended], (self.shrunk + ~far)[~ended]
        return self.at(places[ended])


def climb(
    climbers: Sequence[Climbers], levels_at: Callable[[np.ndarray], np.ndarray], missed: float, shrinks: int = SHRINKS
) -> np.ndarray:
    """Return the maxima (points, 2) [m] that climbers reach, in any order.

    Args:
        climbers: Climbers in the plane and on lines, which are moved.
        levels_at: Function from points (points, 2) [m] to the field (points,), minus infinity where they may not go.
        missed: Climbers that are so much lower than the highest one are left where they are after some rounds.
        shrinks: How often steps are shortened.
    """

    def levels_of(trials: Sequence[np.ndarray]) -> list[np.ndarray]:
        on = [each.at(trial) for each, trial in zip(climbers, trials, strict=True)]
        levels = levels_at(np.concatenate([part.reshape(-1, 2) for part in on]))
        ends = np.cumsum([part.size // 2 for part in on])[:-1]
        return [level.reshape(part.shape[:2]) for level, part in zip(np.split(levels, ends), on, strict=True)]

    ended, highest = [], -math.inf
    for number in range(ROUNDS):
        trials = [each.trials() for each in climbers]
        levels = levels_of(trials)
        tops = [each.tops(level) for each, level in zip(climbers, levels, strict=True)]
        of_tops = levels_of(tops)
        highest = max(highest, *(part.max(initial=-math.inf) for part in (*levels, *of_tops)))
        lowest = highest - missed if number >= SURELY else -math.inf
        for each, *parts in zip(climbers, trials, tops, levels, of_tops, strict=True):
            tried, reached = (np.concatenate(pair, axis=1) for pair in (parts[:2], parts[2:]))
            ended.append(each.move(tried, reached, lowest, shrinks))
        if not any(len(each.places) for each in climbers):
            break
    return np.concatenate([*ended, *(each.at(each.places) for each in climbers)])


def bends(levels: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the slopes x and y, and the second derivatives xx, yy and xy, (points,) of the quadratic functions through
    values (points, 25) at AROUND, per step."""
    sw, w, nw, s, middle, n, se, e, ne = levels[:, NEAREST].T
    return (e - w) / 2, (n - s) / 2, e + w - 2 * middle, n + s - 2 * middle, (ne - nw - se + sw) / 4


def quadratic_summits(levels: np.ndarray) -> np.ndarray:
    """Return the (points, 2) summits [steps] of the quadratic functions through values (points, 25) at AROUND, at
    most REACH away; 0 where there is none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, xx, yy, xy = bends(levels)
        summits = np.stack([xy * y - yy * x, xy * x - xx * y], axis=1) / (xx * yy - xy**2)[:, None]
        summits *= np.minimum(1.0, REACH / np.abs(summits).max(axis=1, keepdims=True))
        curved = (xx < 0) & (xx * yy > xy**2) & np.isfinite(summits).all(axis=1)
    return np.where(curved[:, None], summits, 0.0)


def parabolic_summits(levels: np.ndarray) -> np.ndarray:
    """Return the (points, 1) summits [steps] of the parabolas through values (points, 5) at ALONG, at most REACH away;
    0 where there is none."""
    middle, before, after = levels[:, :3].T
    bend = before + after - 2 * middle
    with np.errstate(invalid="ignore", divide="ignore"):
        summits = np.clip((before - after) / (2 * bend), -REACH, REACH)
    return np.where((bend < 0) & np.isfinite(summits), summits, 0.0)[:, None]
