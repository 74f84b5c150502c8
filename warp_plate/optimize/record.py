"""What a search was told so far, in the shape that all methods share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

COLUMNS = ("best", "mean", "worst", "nonfinite", "evaluations")
# A search stalls when so many iterations lower the best loss by no more than this part of its size.
STALL_TOLERANCE = 1e-6


@dataclass(frozen=True)
class SearchResult:
    """The best position found, shape (dimension,), and its loss; None and infinity before any finite loss.

    The first four names are pycma's. `nonfinite` counts the losses that were infinite or not a number.
    """

    xbest: np.ndarray | None
    fbest: float
    evaluations: int
    iterations: int
    nonfinite: int


def tolerance_scale(loss: float, least: float) -> float:
    """What tolerances of a loss are parts of, so that its unit and its weight change no search: its magnitude, or
    ``least`` where that is larger, for losses that pass zero (``objective.loss_scale``)."""
    return max(abs(loss), least)


class Record:
    """The best position and a row of COLUMNS for each iteration; loss_scale: see ``tolerance_scale``."""

    def __init__(self, dimension: int, loss_scale: float = 1.0) -> None:
        self._least_size = loss_scale
        self.position = np.full(dimension, np.nan)
        self.loss = math.inf
        self.rows: list[list[float]] = []

    @property
    def iterations(self) -> int:
        """How many times losses were told."""
        return len(self.rows)

    @property
    def evaluations(self) -> int:
        """How many losses were told."""
        return int(self.rows[-1][-1]) if self.rows else 0

    @property
    def history(self) -> dict[str, np.ndarray]:
        """As ``Swarm.history``: arrays with one entry for each iteration."""
        history = dict(zip(COLUMNS, np.array(self.rows, dtype=float).reshape(-1, len(COLUMNS)).T, strict=True))
        return history | {name: history[name].astype(int) for name in ("nonfinite", "evaluations")}

    @property
    def result(self) -> SearchResult:
        """The best so far."""
        found = self.position.copy() if math.isfinite(self.loss) else None
        nonfinite = sum(int(row[COLUMNS.index("nonfinite")]) for row in self.rows)
        return SearchResult(found, self.loss, self.evaluations, self.iterations, nonfinite)

    def stalled(self, stall: int | None, since: int = 0) -> bool:
        """Whether the last ``stall`` iterations, all after iteration ``since``, improved the best loss by nothing."""
        if stall is None or self.iterations - since <= stall:
            return False
        earlier = self.rows[-1 - stall][0]
        if not math.isfinite(self.loss):
            return True
        return not earlier - self.loss > STALL_TOLERANCE * tolerance_scale(self.loss, self._least_size)

    def tell(self, asked: np.ndarray | None, solutions: ArrayLike, losses: ArrayLike) -> np.ndarray:
        """Keep the losses of positions (n, dimension) that were asked for; returns them, infinite where not finite.

        Raises ValueError if `solutions` are not those positions or `losses` has another shape.
        """
        if asked is None or not np.array_equal(np.asarray(solutions), asked):
            raise ValueError("tell: solutions must be the positions that the last ask() gave, told once")
        told = np.array(losses, dtype=float)
        if told.shape != (len(asked),):
            raise ValueError(f"tell: losses of shape {told.shape}: must be ({len(asked)},)")
        finite = np.isfinite(told)
        told[~finite] = np.inf
        best = int(np.argmin(told))
        if told[best] < self.loss:
            self.position, self.loss = np.array(asked[best]), float(told[best])
        mean, worst = (float(told[finite].mean()), float(told[finite].max())) if finite.any() else (math.nan, math.nan)
        counted = len(told) - int(finite.sum()), self.evaluations + len(told)
        self.rows.append([self.loss, mean, worst, *map(float, counted)])
        return told

    def state(self) -> dict[str, Any]:
        """Arrays and numbers, for a searcher's own state."""
        history = np.array(self.rows, dtype=float).reshape(-1, len(COLUMNS))
        return {"best_position": self.position.copy(), "best_loss": self.loss, "history": history}

    def load(self, state: dict[str, Any]) -> None:
        """What ``state`` gave. Raises ValueError for another shape."""
        self.position = shaped(state, "best_position", self.position.shape)
        self.loss = float(state["best_loss"])
        self.rows = shaped(state, "history", (-1, len(COLUMNS))).tolist()


class Recorded:
    """What methods that keep a ``Record`` say of it."""

    _record: Record

    @property
    def iterations(self) -> int:
        """How many times losses were told."""
        return self._record.iterations

    @property
    def history(self) -> dict[str, np.ndarray]:
        """See ``Record.history``."""
        return self._record.history

    @property
    def result(self) -> SearchResult:
        """The best so far."""
        return self._record.result


def check_format(state: dict[str, Any], wanted: str) -> None:
    """Raise ValueError unless a state is of this format, KeyError where it has none."""
    if state["format"] != wanted:
        raise ValueError(f"search state: format = {state['format']!r}: must be {wanted!r}")


def shaped(state: dict[str, Any], name: str, shape: tuple[int, ...]) -> np.ndarray:
    """An array of a state as float64 numbers; −1 in its shape: any length. Raises ValueError for another shape."""
    values = np.array(state[name], dtype=float)
    if values.size == 0 and 0 in values.shape[:1] and shape[0] == -1:
        return values.reshape(0, *shape[1:])  # in JSON an array without rows has lost its columns
    if values.ndim != len(shape) or any(want not in (-1, have) for want, have in zip(shape, values.shape, strict=True)):
        raise ValueError(f"search state: {name} of shape {values.shape}: must be {shape}")
    return values


def plain(value: Any) -> Any:
    """Arrays and tuples as lists, and each number that JSON does not have as text that float() reads back."""
    if isinstance(value, np.ndarray):
        # Large swarms: no walk through the numbers where all are finite.
        return value.tolist() if np.isfinite(value).all() else plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value
