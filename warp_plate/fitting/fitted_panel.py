"""The free numbers of a scene, and the fitted scene with the uncertainty of its values, for all kinds of measurements.

Free numbers are scaled so that the range of each is 0 ... 1. Ranges above 0 are scaled by logarithms, so that
stiffnesses of any size are fitted alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from warp_plate.fitting.least_squares import Prediction, Residuals, Weigh, exchangeable, fit_least_squares
from warp_plate.fitting.verdict import Verdict
from warp_plate.scene.errors import SceneError, under
from warp_plate.scene.keys import resolved_key, value_of
from warp_plate.scene.model import Scene

# Step of differences of scenes, relative to a value above 0, or else to its range.
STEP = 1e-3
# Correlation of two errors from which on it is remarked.
STRONG = 0.9
# Half-width of an interval, in ranges, from which on a number is not determined.
WIDEST = 1.0


@dataclass(frozen=True, eq=False)
class FreeNumbers:
    """The numbers of ``[fit.free]``."""

    scene: Scene
    keys: tuple[str, ...]
    low: np.ndarray  # (p,) lowest values
    high: np.ndarray  # (p,) highest values

    def values(self, fractions: np.ndarray) -> np.ndarray:
        """Return the values at fractions (p,) of the ranges."""
        ratio = np.where(self.low > 0, self.high, 1.0) / np.where(self.low > 0, self.low, 1.0)
        with np.errstate(over="ignore"):  # of the intervals' ends
            return np.where(self.low > 0, self.low * ratio**fractions, self.low + fractions * (self.high - self.low))

    def scene_at(self, fractions: np.ndarray) -> Scene:
        """Return the scene with the values at fractions (p,), or raise a SceneError if they do not fit together."""
        return self.panel_at(fractions).model_copy(update={"fit": self.scene.fit})

    def panel_at(self, fractions: np.ndarray) -> Scene:
        """Return the same without the table ``[fit]``, whose check takes time."""
        return self._panel_with(self.values(fractions))

    def _panel_with(self, values: np.ndarray) -> Scene:
        panel = self.scene.model_copy(update={"fit": None})
        with under("fit.free: a range reaches too far"):
            return panel.with_values(dict(zip(self.keys, values.tolist(), strict=True)))

    def neighbours(self, fractions: np.ndarray, index: int, central: bool) -> tuple[Scene, Scene | None, float]:
        """Return scenes with a larger and a smaller value of a number, whose difference is the derivative by its
        fraction, and the factor of that; None for the value itself."""
        values, low, high = self.values(fractions), self.low[index], self.high[index]
        step = STEP * (values[index] if low > 0 else high - low)
        ends = min(values[index] + step, high), max(values[index] - step, low)
        if not central:
            ends = (ends[0], values[index]) if ends[0] > values[index] else (values[index], ends[1])
        slope = values[index] * np.log(high / low) if low > 0 else high - low
        above, below = (
            None if end == values[index] else self._panel_with(np.where(np.arange(len(values)) == index, end, values))
            for end in ends
        )
        return above or self._panel_with(values), below, float(slope / (ends[0] - ends[1]))

    def mirror_pairs(self) -> list[list[tuple[int, int]]]:
        """Return indices of the same numbers of opposite edges within equal ranges, for each pair of edges."""
        groups = []
        for one, other in (("left", "right"), ("bottom", "top")):
            names = {key: key.replace(f"edges.{one}", f"edges.{other}") for key in self.keys if f"edges.{one}" in key}
            pairs = [(self.keys.index(key), self.keys.index(name)) for key, name in names.items() if name in self.keys]
            same = all(self.low[i] == self.low[j] and self.high[i] == self.high[j] for i, j in pairs)
            groups += [pairs] if pairs and same else []
        return groups

    def starts(self, count: int, seed: int) -> np.ndarray:
        """Return (count, p) fractions: those of the scene's own values, then a Latin hypercube."""
        random = np.random.default_rng(seed)
        cells = np.tile(np.arange(count - 1), (len(self.keys), 1))
        drawn = (random.permuted(cells, axis=1).T + random.random((count - 1, len(self.keys)))) / max(count - 1, 1)
        return np.vstack([self._scene_fractions(), drawn])

    def _scene_fractions(self) -> np.ndarray:
        """Return the fractions of the scene's values within the ranges, and 1/2 for absent ones."""
        stated = [value_of(self.scene, key) for key in self.keys]
        values = np.array([np.nan if value is None else value for value in stated], dtype=float)
        values = np.clip(values, self.low, self.high)
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithmic = np.log(values / self.low) / np.log(self.high / self.low)
            fractions = np.where(self.low > 0, logarithmic, (values - self.low) / (self.high - self.low))
        return np.nan_to_num(fractions, nan=0.5)


def free_numbers(scene: Scene) -> FreeNumbers:
    """Return the free numbers of a scene, or raise a SceneError if it has none."""
    if scene.fit is None:
        raise SceneError('fit: is missing; write [fit.free] with lines such as "plate.young_modulus" = [6e10, 8e10]')
    keys = tuple(resolved_key(scene, name) for name in scene.fit.free)
    low, high = np.array(list(scene.fit.free.values()), dtype=float).T
    return FreeNumbers(scene, keys, low, high)


@dataclass(frozen=True, eq=False, repr=False)
class FittedPanel:
    """A scene with fitted numbers."""

    scene: Scene  # the scene with the fitted numbers
    keys: tuple[str, ...]  # (p,) keys of the free numbers
    values: np.ndarray  # (p,) fitted values
    low: np.ndarray  # (p,) lower ends of the 95 % intervals, NaN if not identifiable
    high: np.ndarray  # (p,) upper ends
    at_limit: np.ndarray  # (p,) True where a value is an end of its range
    correlations: np.ndarray  # (p, p) correlations of values, or of their logarithms where ranges are above 0; else NaN
    # groups of keys that these data cannot distinguish; a group of one key has no influence on the data
    inseparable: tuple[tuple[str, ...], ...]
    # groups of keys of opposite edges whose numbers may change places without a change of the data
    mirrored: tuple[tuple[str, ...], ...]
    evaluations: int  # number of plates that were computed
    remarks: tuple[str, ...]  # what was converted in the measurements or left out
    verdict: Verdict  # whether the model describes the measurements; if not, there are no intervals
    undetermined: tuple[str, ...]  # keys whose interval would be wider than their range, and which have none

    def __repr__(self) -> str:
        values = (f"{key} = {value:.5g}" for key, value in zip(self.keys, self.values, strict=True))
        return f"<{type(self).__name__} {', '.join(values)}>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        lines = [*self.remarks, *self.verdict.lines]
        for group in self.inseparable:
            alike = "cannot be distinguished by these data; fix all but one"
            lines.append(f"{' and '.join(group)}: {alike if len(group) > 1 else 'has no influence here'}")
        for group in self.mirrored:
            lines.append(f"{' and '.join(group)}: interchangeable; give them different ranges, or measure off centre")
        for key, limited in zip(self.keys, self.at_limit, strict=True):
            if limited:
                lines.append(f"{key}: is at an end of its range, so it has no interval; widen the range")
        lines += [f"{key}: is not determined: its error is larger than its range" for key in self.undetermined]
        for first, second in np.argwhere(np.triu(np.abs(self.correlations) > STRONG, 1)):
            value = self.correlations[first, second]
            lines.append(f"{self.keys[first]} and {self.keys[second]}: their errors are correlated by {value:+.3f}")
        return tuple(lines)


F = TypeVar("F", bound=FittedPanel)


@dataclass(frozen=True, eq=False)
class PanelProblem:
    """Measurements of a panel and how its free numbers follow from them, see :func:`fit_least_squares`."""

    free: FreeNumbers
    source: str  # file of the measurements, for errors
    predict: Prediction  # what is measured, as a function of fractions of the ranges
    residuals: Sequence[Residuals]
    count: int  # number of data
    weigh: Weigh | None
    exact: Prediction | None = None  # prediction that takes more time
    series: int | None = None  # residuals are so many series over frequency, whose errors may be correlated


def fit_panel(cls: type[F], problem: PanelProblem, describe: Callable[[Scene, Sequence[str]], dict[str, Any]]) -> F:
    """Fit a scene by least squares to measurements; ``describe`` returns further attributes, with the verdict, for the
    fitted scene and its keys at ends of ranges."""
    free = problem.free
    fit = free.scene.fit
    assert fit is not None
    if problem.count <= len(free.keys):
        given = f"{problem.count} numbers do not determine {len(free.keys)} free ones and their errors"
        raise SceneError(f"{problem.source}: {given}; measure more, or free fewer keys in [fit.free]")
    starts = free.starts(fit.starts, fit.seed)
    optimum = fit_least_squares(
        problem.predict, problem.residuals, starts, problem.weigh, problem.exact, problem.series
    )
    mirrored = [pairs for pairs in free.mirror_pairs() if exchangeable(optimum, pairs)]
    scene, at_limit = free.scene_at(optimum.unknowns), optimum.at_limit
    described = describe(scene, [key for key, limited in zip(free.keys, at_limit, strict=True) if limited])
    width = optimum.student * optimum.deviations
    wide = width > WIDEST
    width[wide | (not described["verdict"].describes)] = np.nan
    return cls(
        scene=scene,
        keys=free.keys,
        values=free.values(optimum.unknowns),
        low=free.values(optimum.unknowns - width),
        high=free.values(optimum.unknowns + width),
        at_limit=at_limit,
        correlations=optimum.correlations,
        inseparable=tuple(tuple(free.keys[index] for index in group) for group in optimum.inseparable),
        mirrored=tuple(tuple(free.keys[index] for pair in pairs for index in pair) for pairs in mirrored),
        evaluations=problem.predict.evaluations + (problem.exact.evaluations if problem.exact else 0),
        undetermined=tuple(key for key, too_wide in zip(free.keys, wide, strict=True) if too_wide),
        **described,
    )
