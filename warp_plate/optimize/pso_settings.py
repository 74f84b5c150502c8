"""What a particle swarm is told before it starts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# Ranges and speeds end here, so that the positions of a swarm that flies apart stay finite numbers.
LARGEST = 1e100
# Whole numbers, and the least that each may be.
WHOLE = {"dimension": 1, "particles": 1, "iterations": 1, "seed": 0, "stall": 1, "neighbours": 1, "restarts": 0}


@dataclass(frozen=True)
class SwarmSettings:
    """What a swarm search is told before it starts; all checked, and kept as plain numbers and tuples.

    `position_range` and `velocity_range` are the (lowest, highest) values that the first positions and
    velocities are drawn from; `bounds` are the (lower, upper) limits of positions, infinite where there is
    none. Each end is one number or `dimension` numbers, and so is `velocity_limit`, the largest size of a
    velocity component. `start`, shape (up to `particles`, `dimension`), replaces the first drawn positions.
    Positions with a `period`, finite for numbers that wrap, are kept within one period from the lower end of
    their range on, and are drawn to others by the shorter way round. `neighbours`: each particle is drawn to
    the best of itself and of so many on each side in the ring of all; None: to the best of all.

    The search stops after `iterations`, or after `stall` of them in a row that together lower the best loss
    by no more than `stall_tolerance`, as a part of that loss, or of `loss_scale` where the loss is smaller; as
    long as there are `restarts` left, the swarm is drawn anew instead.

    Raises ValueError, one line with the setting's name, its value and what would be right.
    """

    dimension: int
    particles: int = 20
    iterations: int = 80
    inertia: float = 0.4
    decay: float = 0.99
    cognitive: float = 2.0
    social: float = 2.0
    seed: int = 0
    position_range: tuple[ArrayLike, ArrayLike] = (-2.0, 2.0)
    velocity_range: tuple[ArrayLike, ArrayLike] = (-2.0, 2.0)
    bounds: tuple[ArrayLike, ArrayLike] | None = None
    velocity_limit: ArrayLike | None = None
    start: ArrayLike | None = None
    stall: int | None = None
    stall_tolerance: float = 1e-6
    random_numbers: str = "component"
    period: ArrayLike | None = None
    neighbours: int | None = None
    restarts: int = 0
    loss_scale: float = 1.0

    def __post_init__(self) -> None:
        for name, least in WHOLE.items():
            if getattr(self, name) is not None or name not in ("stall", "neighbours"):
                self._keep(name, _whole(name, getattr(self, name), least))
        for name in ("inertia", "decay", "cognitive", "social", "stall_tolerance"):
            self._keep(name, _real(name, getattr(self, name), 1.0 if name == "decay" else 1e6))
        self._keep("loss_scale", _real("loss_scale", self.loss_scale, LARGEST))
        if self.random_numbers not in ("component", "particle"):
            raise _refusal("random_numbers", self.random_numbers, "'component' or 'particle'")
        for name, largest in (("position_range", LARGEST), ("velocity_range", LARGEST), ("bounds", math.inf)):
            if name != "bounds" or self.bounds is not None:
                self._keep(name, _pair(name, getattr(self, name), self.dimension, largest))
        lower, upper = self.limits()
        lowest, highest = np.array(self.position_range)
        if np.any((lowest > upper) | (highest < lower)):
            raise _refusal("position_range", self.position_range, f"one that meets bounds = {self.bounds}")
        if self.velocity_limit is not None:
            limit = _numbers("velocity_limit", self.velocity_limit, self.dimension)
            if not np.all((limit > 0) & (limit <= LARGEST)):
                raise _refusal("velocity_limit", self.velocity_limit, f"above 0 and at most {LARGEST:g}")
            self._keep("velocity_limit", tuple(limit.tolist()))
        if self.start is not None:
            self._keep("start", _start(self.start, self.particles, lower, upper))
        if self.period is not None:
            self._keep("period", _period(self.period, lower, upper))
        if self.restarts and self.stall is None:
            raise _refusal("restarts", self.restarts, "0 without stall, which says when to start anew")

    def _keep(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def constriction(
        cls, dimension: int, cognitive: float = 2.05, social: float = 2.05, **others: Any
    ) -> SwarmSettings:
        """The swarm of Clerc and Kennedy, IEEE Trans. Evol. Comput. 6(1), 2002, type 1'': with φ = c₁ + c₂ > 4,

            V ← χ (V + c₁ U (P − X) + c₂ U (G − X)),     χ = 2/(φ − 2 + √(φ² − 4φ)), which is 0.7298 for φ = 4.1

        as an inertia χ that does not decay and the factors χ c₁ and χ c₂.
        """
        total = cognitive + social
        if not total > 4:
            raise _refusal("cognitive + social", total, "above 4 for a constriction")
        factor = 2 / (total - 2 + math.sqrt(total * (total - 4)))
        return cls(dimension, inertia=factor, decay=1.0, cognitive=factor * cognitive, social=factor * social, **others)

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of positions, each of shape (dimension,); infinite without bounds."""
        lower, upper = (-math.inf, math.inf) if self.bounds is None else self.bounds
        return np.full(self.dimension, lower), np.full(self.dimension, upper)


def _refusal(name: str, value: object, right: str) -> ValueError:
    shown = " ".join(repr(value).split())
    return ValueError(f"{name} = {shown if len(shown) < 80 else shown[:76] + ' ...'}: must be {right}")


def _whole(name: str, value: Any, least: int) -> int:
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < least:
        raise _refusal(name, value, f"a whole number, at least {least}")
    return int(value)


def _real(name: str, value: Any, most: float) -> float:
    if not isinstance(value, (int, float, np.integer, np.floating)) or not 0 <= value <= most:
        raise _refusal(name, value, f"a number from 0 to {most:g}")
    return float(value)


def _numbers(name: str, value: Any, dimension: int) -> np.ndarray:
    try:
        return np.broadcast_to(np.asarray(value, dtype=float), (dimension,))
    except (TypeError, ValueError):
        raise _refusal(name, value, f"one number or {dimension} numbers") from None


def _pair(name: str, value: Any, dimension: int, largest: float) -> tuple[tuple[float, ...], ...]:
    if not isinstance(value, (tuple, list, np.ndarray)) or len(value) != 2:
        raise _refusal(name, value, "a pair (lowest, highest)")
    lowest, highest = (_numbers(name, end, dimension) for end in value)
    if not np.all((-largest <= lowest) & (lowest <= highest) & (highest <= largest)):
        raise _refusal(name, value, f"(lowest, highest) in this order, from {-largest:g} to {largest:g}")
    return tuple(lowest.tolist()), tuple(highest.tolist())


def _start(value: Any, particles: int, lower: np.ndarray, upper: np.ndarray) -> tuple[tuple[float, ...], ...]:
    right = f"finite numbers within the bounds, of shape (1 to {particles}, {len(lower)})"
    try:
        start = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise _refusal("start", value, right) from None
    shaped = start.ndim == 2 and 1 <= len(start) <= particles and start.shape[1] == len(lower)
    if not shaped or not np.all(np.isfinite(start) & (start >= lower) & (start <= upper)):
        raise _refusal("start", value, right)
    return tuple(tuple(row) for row in start.tolist())


def _period(value: Any, lower: np.ndarray, upper: np.ndarray) -> tuple[float, ...]:
    period = _numbers("period", value, len(lower))
    wraps = np.isfinite(period)
    if not np.all(period > 0) or np.any(wraps & (np.isfinite(lower) | np.isfinite(upper))):
        raise _refusal("period", value, "above 0, and infinite for numbers that have bounds")
    return tuple(period.tolist())
