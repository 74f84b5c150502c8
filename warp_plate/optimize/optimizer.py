"""Search spaces, and the base of all search methods: ask for positions, tell their losses, stop, history and state.

Methods minimise.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

# Numbers of evaluations that are exact as floats.
MOST_EVALUATIONS = 2**53
COLUMNS = ("best", "mean", "evaluations")
# No search goes so far; squares of such numbers are still finite.
FARTHEST = 1e150
# A search stalls when ``stall`` iterations lower the best loss by at most this fraction of its size.
STALL_TOLERANCE = 1e-6


class MethodError(ValueError):
    """A method does not fit its problem, or needs a library that is not installed."""


@dataclass(frozen=True)
class SearchSpace:
    """The components of a position, without their meaning."""

    names: tuple[str, ...]  # (dimension,) names for people, such as "phase of upper left"
    lower: np.ndarray  # (dimension,) lower limits; −∞ where there is none
    upper: np.ndarray  # (dimension,) upper limits; ∞ where there is none
    initial_lower: np.ndarray  # (dimension,) lower ends of the ranges in which a search begins
    initial_upper: np.ndarray  # (dimension,) upper ends of these ranges
    period: np.ndarray  # (dimension,) periods of numbers that wrap, which have no limits; ∞ for all others

    @property
    def dimension(self) -> int:
        """Number of components of a position."""
        return len(self.names)

    @cached_property
    def span(self) -> np.ndarray:
        """(dimension,) lengths of the initial ranges; 1 for a range of no length."""
        return np.where(self.initial_upper > self.initial_lower, self.initial_upper - self.initial_lower, 1.0)

    def wrap(self, positions: np.ndarray) -> None:
        """Shift the numbers that wrap into one period from the lower ends of their ranges on, in place."""
        self._shift(positions, np.floor, self.initial_lower)

    def shorten(self, differences: np.ndarray) -> None:
        """Shift differences of positions to the shorter way round where numbers wrap, in place."""
        self._shift(differences, np.rint, np.zeros(self.dimension))

    def _shift(self, values: np.ndarray, rounding: np.ufunc, lowest: np.ndarray) -> None:
        for column in np.flatnonzero(np.isfinite(self.period)):
            periods = values[:, column] - lowest[column]
            periods /= self.period[column]
            rounding(periods, out=periods)
            periods *= self.period[column]
            values[:, column] -= periods

    def from_unit(self, points: np.ndarray, wrap: bool = True) -> np.ndarray:
        """Return the positions (n, dimension) of points that are 0 and 1 at the ends of the initial ranges."""
        positions = self.initial_lower + self.span * points
        if wrap:
            self.wrap(positions)
        return np.asarray(np.clip(positions, self.lower, self.upper))

    def to_unit(self, positions: np.ndarray) -> np.ndarray:
        """Return the points (n, dimension) of positions: 0 and 1 at the ends of the initial ranges."""
        return (positions - self.initial_lower) / self.span


@dataclass(frozen=True)
class SearchSettings:
    """Settings that all methods share."""

    particles: int = 20  # positions in an iteration; of CMA-ES in the first population, of descents at most
    iterations: int = 80  # particles × iterations is the largest number of evaluations
    restarts: int = 0  # largest number of restarts; of descents, of each
    stall: int | None = None  # iterations without progress after which a search restarts or ends; None: it does not
    seed: int = 0
    loss_scale: float = 1.0  # see ``tolerance_scale``

    @property
    def evaluations(self) -> int:
        """Largest number of evaluations."""
        return self.particles * self.iterations


@dataclass(frozen=True)
class SearchResult:
    """Best position of a search, with counts; named as pycma's."""

    xbest: np.ndarray | None  # (dimension,); None before any finite loss
    fbest: float  # its loss; infinity before any finite loss
    evaluations: int
    iterations: int


def tolerance_scale(loss: float, loss_scale: float) -> float:
    """Return the size that relative tolerances of a loss refer to: its magnitude, or ``loss_scale`` near zero."""
    return max(abs(loss), loss_scale)


class Optimizer(ABC):
    """Base of the search methods.

    Attributes:
        positions: (n, dimension) positions that :meth:`ask` gave last, read-only.
        asked: whether their losses are still to be told.
        best_position: (dimension,) best position so far; NaN before any finite loss.
        best_loss: its loss; infinity before any finite loss.
        rows: for each iteration the values of COLUMNS.
    """

    FORMAT: ClassVar[str]
    # Names of the attributes of a state besides those of this class: arrays, numbers, and random generators.
    STATE: ClassVar[tuple[str, ...]] = ()

    def __init__(self, space: SearchSpace, settings: SearchSettings) -> None:
        self.space, self.settings = space, settings
        self.positions, self.asked = np.empty((0, space.dimension)), False
        self.best_position, self.best_loss = np.full(space.dimension, np.nan), math.inf
        self.rows: list[list[float]] = []

    @property
    def iterations(self) -> int:
        """Number of iterations whose losses are known."""
        return len(self.rows)

    @property
    def evaluations(self) -> int:
        """Number of losses so far."""
        return int(self.rows[-1][-1]) if self.rows else 0

    @property
    def history(self) -> dict[str, np.ndarray]:
        """`evaluations`, `best` loss so far, and `mean` of an iteration's finite losses (NaN if it has none)."""
        best, mean, evaluations = np.array(self.rows, dtype=float).reshape(-1, len(COLUMNS)).T
        return {"evaluations": evaluations.astype(int), "best": best, "mean": mean}

    @property
    def result(self) -> SearchResult:
        """Best position so far, with counts."""
        best = self.best_position.copy() if math.isfinite(self.best_loss) else None
        return SearchResult(best, self.best_loss, self.evaluations, self.iterations)

    def stalled(self, since: int = 0) -> bool:
        """Return whether the last ``settings.stall`` iterations, all after iteration ``since``, made no progress."""
        stall = self.settings.stall
        if stall is None or self.iterations - since <= stall:
            return False
        if not math.isfinite(self.best_loss):
            return True
        fall = self.rows[-1 - stall][0] - self.best_loss
        return not fall > STALL_TOLERANCE * tolerance_scale(self.best_loss, self.settings.loss_scale)

    def ask(self) -> np.ndarray:
        """Return positions to evaluate, (n, dimension), read-only; the same ones until ``tell`` is called."""
        if not self.asked:
            self.positions = self._propose()
            self.positions.flags.writeable = False
            self.asked = True
        return self.positions

    def tell(self, solutions: ArrayLike, losses: ArrayLike) -> None:
        """Take the losses (n,) of the positions that :meth:`ask` gave; losses that are not finite are worst."""
        same = self.asked and (solutions is self.positions or np.array_equal(np.asarray(solutions), self.positions))
        if not same:
            raise ValueError("tell: solutions must be the positions that the last ask() gave, told once")
        values = np.array(losses, dtype=float)
        if values.shape != (len(self.positions),):
            raise ValueError(f"tell: losses of shape {values.shape}: must be ({len(self.positions)},)")
        finite = np.isfinite(values)
        values[~finite] = np.inf
        best = int(np.argmin(values))
        if values[best] < self.best_loss:
            self.best_position, self.best_loss = np.array(self.positions[best]), float(values[best])
        with np.errstate(over="ignore"):
            mean = float(values[finite].mean()) if finite.any() else math.nan
        self.rows.append([self.best_loss, mean, self.evaluations + len(values)])
        self._learn(values)
        self.asked = False

    @abstractmethod
    def stop(self) -> dict[str, Any]:
        """Return the reasons to stop, with a number for each; empty to go on."""

    def state(self) -> dict[str, Any]:
        """Return all that the search needs to go on: arrays, numbers, texts, and states of random generators."""
        history = np.array(self.rows, dtype=float).reshape(-1, len(COLUMNS))
        state = {"format": self.FORMAT, "history": history, "positions": self.positions.copy(), "asked": self.asked}
        for name in ("best_position", "best_loss", *self.STATE):
            value = getattr(self, name)
            state[name] = value.bit_generator.state if isinstance(value, np.random.Generator) else copy(value)
        return state

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a result of :meth:`state`, bit for bit, or raise a ValueError if it is not one of such a search."""
        try:
            if state["format"] != self.FORMAT:
                raise ValueError(f"search state: format = {state['format']!r}: must be {self.FORMAT!r}")
            self._restore(state)
        except (KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"search state: {error} is missing or of a wrong kind") from None

    def _restore(self, state: Mapping[str, Any]) -> None:
        history = as_shape(state, "history", (-1, len(COLUMNS)), may_be_nan=True)
        best, counts = history[:, 0], history[:, 2]
        if np.isnan(best).any() or not (counts < MOST_EVALUATIONS).all() or (np.diff(counts, prepend=0) <= 0).any():
            raise ValueError("search state: history: best losses must be numbers, and numbers of evaluations grow")
        self.rows = history.tolist()
        self.positions = as_shape(state, "positions", (-1, self.space.dimension))
        self.asked = bool(state["asked"])
        for name in ("best_position", "best_loss", *self.STATE):
            value = getattr(self, name)
            if isinstance(value, np.random.Generator):
                value.bit_generator.state = state[name]
            elif isinstance(value, np.ndarray):
                setattr(self, name, as_shape(state, name, value.shape, may_be_nan=name == "best_position"))
            else:
                setattr(self, name, self._as_number(name, type(value)(state[name])))
        reached = self.best_position if math.isfinite(self.best_loss) else 0.0
        for name, positions in {"positions": self.positions, "best_position": reached}.items():
            if not (np.abs(positions) < FARTHEST).all():
                raise ValueError(f"search state: {name}: must be numbers below {FARTHEST:g}")

    def _as_number(self, name: str, value: float) -> float:
        """Return a number of a state, or raise a ValueError if it is NaN or an impossible count of iterations."""
        if math.isnan(value) or (isinstance(value, int) and not 0 <= value <= self.iterations):
            raise ValueError(
                f"search state: {name} = {value}: must be a number, and of restarts one of {self.iterations} iterations"
            )
        return value

    @abstractmethod
    def _propose(self) -> np.ndarray:
        """Return the next positions (n, dimension)."""

    @abstractmethod
    def _learn(self, losses: np.ndarray) -> None:
        """Take the losses (n,) of ``positions``, infinite where they were not finite; they are recorded already."""


def as_shape(state: Mapping[str, Any], name: str, shape: tuple[int, ...], may_be_nan: bool = False) -> np.ndarray:
    """Return an array of a state as float64 numbers; raises ValueError unless its shape fits, −1 being any length."""
    values = np.array(state[name], dtype=float)
    if values.ndim != len(shape) or any(want not in (-1, have) for want, have in zip(shape, values.shape, strict=True)):
        raise ValueError(f"search state: {name} of shape {values.shape}: must be {shape}")
    if not may_be_nan and np.isnan(values).any():
        raise ValueError(f"search state: {name}: must not be NaN")
    return values


def minimize(
    optimizer: Optimizer, objective: Callable[[np.ndarray], ArrayLike], callback: Callable[[Any], object] | None = None
) -> SearchResult:
    """Run an :class:`Optimizer` on an objective of positions (n, dimension), and return its ``result``.

    ``callback`` takes the optimizer after each iteration, and ends the loop by returning true.
    """
    while not optimizer.stop():
        solutions = optimizer.ask()
        optimizer.tell(solutions, objective(solutions))
        if callback is not None and callback(optimizer):
            break
    return optimizer.result


def minimum_near(
    function: Callable[[float], float], tried: np.ndarray, at: int, accuracy: float, most: int = 500
) -> tuple[float, float, int]:
    """Return the least value's place between the neighbours of one of rising places tried (n,), the value, and the
    evaluations.

    Args:
        function: Function of one number.
        tried: Places.
        at: Index of the place with the least value.
        accuracy: Relative accuracy of the returned place.
        most: Largest number of iterations.
    """
    bounds = (float(tried[max(at - 1, 0)]), float(tried[min(at + 1, len(tried) - 1)]))
    options = {"xatol": accuracy * float(tried[at]), "maxiter": most}
    with np.errstate(invalid="ignore"):  # values may be infinite
        result = scipy.optimize.minimize_scalar(function, bounds=bounds, method="bounded", options=options)
    return float(result.x), float(result.fun), int(result.nfev)
