"""Particle swarm search, as in the source paper, and the loop that runs it or any search of the same shape.

Source: Jo, Yang, Shin, J. Inf. Commun. Converg. Eng. 22(2), 2024, section II.C, equations (7) and (8). For a
particle with position X, velocity V and own best position P, and with G the best position of all,

    V(l+1) = w k^l V(l) + c1 U (P - X) + c2 U (G - X)        w inertia, k decay, c1 cognitive, c2 social
    X(l+1) = X(l) + V(l+1)                                   l = 1, 2, ...; U uniform in [0, 1)

Where the paper is read otherwise than printed, or leaves a choice:

- (7) is printed without "- X". Particles would then be thrown past the best positions, not drawn to them.
- w = 4 with k = 0.99 keeps w k^l above 1 for all 80 iterations, and velocities grow without end. The default
  is 0.4; 4 may still be given.
- The paper does not say whether U is one number for a particle or one for each component. The default is one
  for each component; `random_numbers="particle"` is the other reading.
- Evaluating the first swarm is iteration 1: 80 iterations of 20 particles are 1600 evaluations.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

STATE_FORMAT = "swarm 1"
ARRAYS = ("positions", "velocities", "personal_positions", "personal_losses")
HISTORY = ("best", "mean", "worst", "nonfinite")
# Ranges and speeds end here, so that the positions of a swarm that flies apart stay finite numbers.
LARGEST = 1e100


@dataclass(frozen=True)
class SwarmSettings:
    """What a swarm search is told before it starts; all checked, and kept as plain numbers and tuples.

    `position_range` and `velocity_range` are the (lowest, highest) values that the first positions and
    velocities are drawn from; `bounds` are the (lower, upper) limits of positions, infinite where there is
    none. Each end is one number or `dimension` numbers, and so is `velocity_limit`, the largest size of a
    velocity component. `start`, shape (up to `particles`, `dimension`), replaces the first drawn positions.
    The search stops after `iterations`, or after `stall` of them in a row that together lower the best loss
    by no more than `stall_tolerance`.

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

    def __post_init__(self) -> None:
        for name, least in (("dimension", 1), ("particles", 1), ("iterations", 1), ("seed", 0), ("stall", 1)):
            if name != "stall" or self.stall is not None:
                self._keep(name, _whole(name, getattr(self, name), least))
        for name in ("inertia", "decay", "cognitive", "social", "stall_tolerance"):
            self._keep(name, _real(name, getattr(self, name), 1.0 if name == "decay" else 1e6))
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

    def _keep(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of positions, each of shape (dimension,); infinite without bounds."""
        lower, upper = (-math.inf, math.inf) if self.bounds is None else self.bounds
        return np.full(self.dimension, lower), np.full(self.dimension, upper)


@dataclass(frozen=True)
class SwarmResult:
    """The best position found, shape (dimension,), and its loss; None and infinity before any finite loss.

    The first four names are pycma's. `nonfinite` counts the losses that were infinite or not a number.
    """

    xbest: np.ndarray | None
    fbest: float
    evaluations: int
    iterations: int
    nonfinite: int


class Swarm:
    """The paper's particle swarm; it minimises. `ask`, `tell`, `stop` and `result` are called as pycma's are.

    `positions`, `velocities` and `personal_positions` have shape (particles, dimension), `personal_losses`
    (particles,); a personal loss is infinite until its particle has had a finite one.
    """

    def __init__(self, settings: SwarmSettings) -> None:
        self.settings = settings
        self.random = np.random.default_rng(settings.seed)
        self._draw()
        if settings.start is not None:
            start = np.array(settings.start)
            self.positions[: len(start)] = start
        self.personal_positions = self.positions.copy()
        self.personal_losses = np.full(settings.particles, np.inf)
        self._history: list[list[float]] = []  # a row of HISTORY for each iteration
        self._asked = False
        self._improved_loss = math.inf
        self._improved_at = 0

    @property
    def iterations(self) -> int:
        """How many times the swarm has been told its losses."""
        return len(self._history)

    @property
    def history(self) -> dict[str, np.ndarray]:
        """Arrays with one entry for each iteration.

        `evaluations` so far; `best` loss so far; of the iteration itself the `mean` and `worst` of its finite
        losses (nan if it has none) and `nonfinite`, the count of the others.
        """
        columns = np.array(self._history, dtype=float).reshape(-1, len(HISTORY)).T
        history = dict(zip(HISTORY, columns, strict=True))
        history["nonfinite"] = history["nonfinite"].astype(int)
        return {"evaluations": self.settings.particles * np.arange(1, self.iterations + 1), **history}

    @property
    def result(self) -> SwarmResult:
        """The best so far."""
        best = int(np.argmin(self.personal_losses))
        loss = float(self.personal_losses[best])
        position = self.personal_positions[best].copy() if math.isfinite(loss) else None
        evaluations, nonfinite = self.settings.particles * self.iterations, self.history["nonfinite"].sum()
        return SwarmResult(position, loss, evaluations, self.iterations, int(nonfinite))

    def ask(self) -> np.ndarray:
        """Positions to evaluate, shape (particles, dimension); the same ones until their losses are told."""
        if not self._asked:
            if self.iterations:
                self._move()
            self._asked = True
        return self.positions.copy()

    def tell(self, solutions: ArrayLike, losses: ArrayLike) -> None:
        """Take the losses, shape (particles,), of the positions that `ask` gave. Not finite counts as worst.

        Raises ValueError if `solutions` are not those positions or `losses` has another shape.
        """
        if not self._asked or not np.array_equal(np.asarray(solutions), self.positions):
            raise ValueError("tell: solutions must be the positions that the last ask() gave, told once")
        told = np.array(losses, dtype=float)
        if told.shape != (self.settings.particles,):
            raise ValueError(f"tell: losses of shape {told.shape}: must be ({self.settings.particles},)")
        finite = np.isfinite(told)
        told[~finite] = np.inf
        # A particle without a finite loss yet has no place to return to: its own best is where it is.
        better = (told < self.personal_losses) | np.isinf(self.personal_losses)
        self.personal_positions[better] = self.positions[better]
        self.personal_losses[better] = told[better]
        self._record(told[finite])
        self._asked = False

    def stop(self) -> dict[str, int]:
        """Why to stop: {"iterations": how many}, {"stall": how many without improvement}; empty to go on."""
        reasons = {}
        if self.iterations >= self.settings.iterations:
            reasons["iterations"] = self.iterations
        stalled = self.iterations - self._improved_at
        if self.settings.stall is not None and stalled >= self.settings.stall:
            reasons["stall"] = stalled
        return reasons

    def _draw(self) -> None:
        """Draw positions, from the part of their range that is within the bounds, and then velocities."""
        settings = self.settings
        shape = (settings.particles, settings.dimension)
        lower, upper = settings.limits()
        lowest, highest = np.clip(np.array(settings.position_range), lower, upper)
        slowest, fastest = np.array(settings.velocity_range)
        # The sum may round up past the upper limit, so clip once more.
        self.positions = np.clip(lowest + (highest - lowest) * self.random.random(shape), lower, upper)
        self.velocities = self._limited(slowest + (fastest - slowest) * self.random.random(shape))

    def _move(self) -> None:
        """Equations (7) and (8). A particle that would leave the bounds stops at the wall."""
        settings = self.settings
        best = int(np.argmin(self.personal_losses))
        if math.isinf(self.personal_losses[best]):
            # No finite loss so far, so nothing to be drawn to: look elsewhere.
            self._draw()
            return
        width = settings.dimension if settings.random_numbers == "component" else 1
        own, common = self.random.random((2, settings.particles, width))
        self.velocities = self._limited(
            settings.inertia * settings.decay**self.iterations * self.velocities
            + settings.cognitive * own * (self.personal_positions - self.positions)
            + settings.social * common * (self.personal_positions[best] - self.positions)
        )
        lower, upper = settings.limits()
        moved = self.positions + self.velocities
        self.velocities[(moved < lower) | (moved > upper)] = 0.0
        self.positions = np.clip(moved, lower, upper)

    def _limited(self, velocities: np.ndarray) -> np.ndarray:
        limit = LARGEST if self.settings.velocity_limit is None else np.array(self.settings.velocity_limit)
        return np.clip(velocities, -limit, limit)

    def _record(self, finite_losses: np.ndarray) -> None:
        best = float(self.personal_losses.min())
        mean = worst = math.nan
        if finite_losses.size:
            with np.errstate(over="ignore"):
                mean, worst = float(finite_losses.mean()), float(finite_losses.max())
        self._history.append([best, mean, worst, float(self.settings.particles - finite_losses.size)])
        # Compared with the last loss that counted, so that many small steps together do count.
        if best < self._improved_loss - self.settings.stall_tolerance:
            self._improved_loss = best
            self._improved_at = self.iterations

    def state(self, plain: bool = True) -> dict[str, Any]:
        """Everything the search needs to go on, in strict JSON types; numbers not finite are text ("inf").

        With ``plain`` false arrays stay arrays, and numbers numbers.
        """
        kept = _plain if plain else copy.deepcopy
        return {
            "format": STATE_FORMAT,
            "settings": kept(asdict(self.settings)),
            "random": self.random.bit_generator.state,
            **{name: kept(getattr(self, name)) for name in ARRAYS},
            "asked": self._asked,
            "history": kept(self._history),
            "improved_loss": kept(self._improved_loss),
            "improved_at": self._improved_at,
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> Swarm:
        """The swarm that `state()` was taken from, bit for bit. Raises ValueError for anything else."""
        if state.get("format") != STATE_FORMAT:
            raise _refusal("swarm state: format", state.get("format"), repr(STATE_FORMAT))
        try:
            swarm = cls(SwarmSettings(**state["settings"]))
            swarm.random.bit_generator.state = state["random"]
            for name in ARRAYS:
                values, shape = np.array(state[name], dtype=float), getattr(swarm, name).shape
                if values.shape != shape:
                    raise ValueError(f"swarm state: {name} of shape {values.shape}: must be {shape}")
                setattr(swarm, name, values)
            swarm._asked = bool(state["asked"])
            swarm._history = [[float(value) for value in row] for row in state["history"]]
            swarm._improved_loss = float(state["improved_loss"])
            swarm._improved_at = int(state["improved_at"])
        except (KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"swarm state: {error} is missing or of a wrong kind") from None
        return swarm


class Searcher(Protocol):
    """What the loop needs of a search. `Swarm` has it, and so has pycma's CMAEvolutionStrategy."""

    def ask(self) -> Any: ...

    def tell(self, solutions: Any, losses: Any, /) -> Any: ...

    def stop(self) -> Any: ...

    @property
    def result(self) -> Any: ...


def optimize(
    searcher: Searcher,
    objective: Callable[[np.ndarray], ArrayLike],
    callback: Callable[[Any], object] | None = None,
) -> Any:
    """Run a search until its `stop()` names a reason or `callback(searcher)` returns something true.

    `objective` takes positions, shape (particles, dimension), and returns losses to minimise, shape
    (particles,). `callback` is called after each iteration; a search that it ended goes on when this is
    called again. Returns `searcher.result`.
    """
    while not searcher.stop():
        solutions = searcher.ask()
        # A copy, which the objective is free to change.
        searcher.tell(solutions, objective(np.array(solutions, dtype=float)))
        if callback is not None and callback(searcher):
            break
    return searcher.result


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists, and each number that JSON does not have as text that float() reads back."""
    if isinstance(value, np.ndarray):
        # Large swarms: no walk through the numbers where all are finite.
        return value.tolist() if np.isfinite(value).all() else _plain(value.tolist())
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


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
