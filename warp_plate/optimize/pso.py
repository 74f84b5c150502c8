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

Beyond the paper (`SwarmSettings`): constriction, neighbours in a ring (Kennedy and Mendes, CEC 2002, "lbest"), numbers
that wrap, and restarts.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict
from functools import partial
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from warp_plate.optimize.pso_settings import LARGEST, SwarmSettings
from warp_plate.optimize.record import SearchResult, tolerance_scale
from warp_plate.optimize.record import plain as as_plain
from warp_plate.plate.row_blocks import GrowingRows, in_blocks, meanwhile

STATE_FORMAT = "swarm 2"
ARRAYS = ("positions", "velocities", "personal_positions", "personal_losses", "kept_position")
NUMBERS = {
    "asked": bool,
    "improved_loss": float,
    "improved_at": int,
    "kept_loss": float,
    "restarts": int,
    "restarted_at": int,
}
HISTORY = ("best", "mean", "worst", "nonfinite")


class Swarm:
    """The paper's particle swarm; it minimises. `ask`, `tell`, `stop` and `result` are called as pycma's are.

    A large one moves its particles when their positions are looked at: those of the first plates are there at once, and
    while these are simulated, the others follow.
    """

    _positions: np.ndarray
    _velocities: np.ndarray
    _personal_positions: np.ndarray
    _personal_losses: np.ndarray
    _best: int
    _best_loss: float
    _given: np.ndarray | GrowingRows  # by ask
    _told: np.ndarray | None  # losses that are not kept yet
    _moving: GrowingRows | None  # positions after a move that is not done yet
    _moving_at: np.ndarray  # its velocities

    def __init__(self, settings: SwarmSettings) -> None:
        self.settings = settings
        self.random = np.random.default_rng(settings.seed)
        self._lower, self._upper = settings.limits()
        self._period = np.full(settings.dimension, np.inf if settings.period is None else settings.period)
        self._wraps = np.flatnonzero(np.isfinite(self._period))
        # What the next move will draw: a large swarm does so while its losses are found, from a twin of ``random``.
        self._ahead: Future[np.ndarray] | None = None
        self._twin: np.random.Generator | None = None
        self._draw()
        if settings.start is not None:
            start = np.array(settings.start)
            self._positions[: len(start)] = start
        self._history: list[list[float]] = []  # a row of HISTORY for each iteration
        self._begin()
        self._kept_position = np.full(settings.dimension, np.nan)  # the best of the swarms before a restart
        self._kept_loss = math.inf
        self._asked = False
        self._restarts = self._restarted_at = 0

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
    def result(self) -> SearchResult:
        """The best so far."""
        self._keep(slice(self._best, self._best + 1))
        position, loss = self._personal_positions[self._best], self._best_loss
        if not loss < self._kept_loss:
            position, loss = self._kept_position, self._kept_loss
        evaluations, nonfinite = self.settings.particles * self.iterations, sum(row[-1] for row in self._history)
        found = position.copy() if math.isfinite(loss) else None
        return SearchResult(found, loss, evaluations, self.iterations, int(nonfinite))

    @property
    def positions(self) -> np.ndarray:
        """(particles, dimension) where the particles are."""
        self._arrive()
        return self._positions

    @property
    def velocities(self) -> np.ndarray:
        """(particles, dimension) by how much they moved last."""
        self._arrive()
        return self._velocities

    @property
    def personal_positions(self) -> np.ndarray:
        """(particles, dimension) where each one's loss was smallest."""
        self._arrive()
        return self._personal_positions

    @property
    def personal_losses(self) -> np.ndarray:
        """(particles,) that loss; infinite until a particle has had a finite one."""
        self._arrive()
        return self._personal_losses

    def ask(self) -> np.ndarray | GrowingRows:
        """Positions to evaluate, shape (particles, dimension), read-only; the same ones until their losses are told.

        Those of a large swarm are made when slices of them, or all, are looked at.
        """
        if not self._asked:
            if self._stalled() and self._restarts < self.settings.restarts:
                self._restart()
            elif self.iterations:
                self._move()
            self._asked = True
            if in_blocks(self.settings.particles):
                self._twin = self._twin or copy.deepcopy(self.random)
                self._ahead = meanwhile(partial(self._pulls, self._twin))
            self._given = self._positions if self._moving is None else self._moving
        self._positions.flags.writeable = False  # they are never changed in place, so that these need not be a copy
        return self._given

    def tell(self, solutions: ArrayLike | GrowingRows, losses: ArrayLike) -> None:
        """Take the losses, shape (particles,), of the positions that `ask` gave. Not finite counts as worst.

        Raises ValueError if `solutions` are not those positions or `losses` has another shape.
        """
        same = self._asked and (solutions is self._given or np.array_equal(np.asarray(solutions), self.positions))
        if not same:
            raise ValueError("tell: solutions must be the positions that the last ask() gave, told once")
        told = np.array(losses, dtype=float)
        if told.shape != (self.settings.particles,):
            raise ValueError(f"tell: losses of shape {told.shape}: must be ({self.settings.particles},)")
        self._arrive()
        finite = np.isfinite(told)
        sound = told if finite.all() else told[finite]
        if sound is not told:
            told[~finite] = np.inf
        best = int(np.argmin(told))
        if (told[best], best) < (self._best_loss, self._best):  # of equals the first
            self._best, self._best_loss = best, float(told[best])
        self._record(sound)
        self._told = told
        self._asked = False

    def stop(self) -> dict[str, int]:
        """Why to stop: {"iterations": how many}, {"stall": how many without improvement}; empty to go on."""
        reasons = {}
        if self.iterations >= self.settings.iterations:
            reasons["iterations"] = self.iterations
        if self._stalled() and self._restarts >= self.settings.restarts:
            reasons["stall"] = self.iterations - self._improved_at
        return reasons

    def _arrive(self) -> None:
        """Have all particles moved, and their bests kept."""
        if self._moving is None:
            self._keep(slice(None))
        else:
            self._positions, self._velocities, self._moving = self._moving[:], self._moving_at, None
        self._told = None

    def _keep(self, rows: slice) -> None:
        """Keep what was better than ever before; ``tell`` leaves that to the next pass over the particles."""
        if self._told is None:
            return
        new, own = self._told[rows], self._personal_losses[rows]
        # A particle without a finite loss yet has no place to return to: its own best is where it is.
        better = np.flatnonzero((new < own) | np.isinf(own))
        self._personal_positions[rows][better] = self._positions[rows].take(better, axis=0)
        own[better] = new[better]

    def _stalled(self) -> bool:
        return self.settings.stall is not None and self.iterations - self._improved_at >= self.settings.stall

    def _begin(self) -> None:
        """A swarm that was drawn just now has no past."""
        self._personal_positions = self._positions.copy()
        self._personal_losses = np.full(self.settings.particles, np.inf)
        self._best, self._best_loss = 0, math.inf
        self._told = self._moving = None
        self._improved_loss, self._improved_at = math.inf, self.iterations

    def _restart(self) -> None:
        """Draw the swarm anew; of the old one the best is kept."""
        best = self.result
        if best.xbest is not None:
            self._kept_position, self._kept_loss = best.xbest, best.fbest
        self._draw()
        self._begin()
        self._restarts, self._restarted_at = self._restarts + 1, self.iterations

    def _draw(self) -> None:
        """Draw positions, from the part of their range that is within the bounds, and then velocities."""
        settings, self._twin = self.settings, None
        shape = (settings.particles, settings.dimension)
        lowest, highest = np.clip(np.array(settings.position_range), self._lower, self._upper)
        slowest, fastest = np.array(settings.velocity_range)
        # The sum may round up past the upper limit, so clip once more.
        drawn = lowest + (highest - lowest) * self.random.random(shape)
        self._positions = np.clip(drawn, self._lower, self._upper)
        self._velocities = slowest + (fastest - slowest) * self.random.random(shape)
        self._limit(self._velocities)

    def _move(self) -> None:
        """Equations (7) and (8). A particle that would leave the bounds stops at the wall."""
        settings, best = self.settings, self._best
        if math.isinf(self._best_loss):
            # No finite loss so far, so nothing to be drawn to: look elsewhere.
            self._arrive()
            self._draw()
            return
        inertia = settings.inertia * settings.decay ** (self.iterations - self._restarted_at)
        leaders = None if settings.neighbours is None else self._best_neighbours(settings.neighbours)
        self._keep(slice(best, best + 1))
        ahead, self._ahead = self._ahead, None
        self._twin = None if ahead is None else self._twin
        pulls = self._pulls(self.random) if ahead is None else ahead.result()
        moved, moving_at = np.empty(self._positions.shape), np.empty(self._velocities.shape)

        def move(rows: slice) -> None:
            self._keep(rows)
            position, own_best = self._positions[rows], self._personal_positions[rows]
            common = self._personal_positions[best if leaders is None else leaders[rows]]
            velocity = np.multiply(self._velocities[rows], inertia, out=moving_at[rows])
            for goal, pull in zip((own_best, common), pulls, strict=True):
                way = goal - position
                self._shorten(way)
                way *= pull[rows]
                velocity += way
            self._limit(velocity)
            np.add(position, velocity, out=moved[rows])
            self._confine(moved[rows], velocity)

        self._moving, self._moving_at = GrowingRows(move, moved), moving_at
        if ahead is not None:
            cast(Any, self.random.bit_generator).advance(pulls.size)  # as the twin did
        if not in_blocks(settings.particles):
            self._arrive()

    def _pulls(self, random: np.random.Generator) -> np.ndarray:
        """c1 U and c2 U of a move: (2, particles, one or each component)."""
        settings = self.settings
        width = settings.dimension if settings.random_numbers == "component" else 1
        pulls = random.random((2, settings.particles, width))
        pulls *= np.reshape([settings.cognitive, settings.social], (2, 1, 1))
        return pulls

    def _best_neighbours(self, reach: int) -> np.ndarray:
        """(particles,) which of itself and ``reach`` others on each side has the best loss; of equals the nearest."""
        each, losses = np.arange(self.settings.particles), self.personal_losses
        best = each
        for distance in range(1, min(reach, self.settings.particles // 2) + 1):
            for other in (np.roll(each, distance), np.roll(each, -distance)):
                best = np.where(losses[other] < losses[best], other, best)
        return best

    def _shorten(self, way: np.ndarray) -> None:
        """Go the shorter way round where numbers wrap, in place."""
        for column in self._wraps:
            period = self._period[column]
            way[:, column] -= period * np.round(way[:, column] / period)

    def _limit(self, velocities: np.ndarray) -> None:
        limit = LARGEST if self.settings.velocity_limit is None else np.array(self.settings.velocity_limit)
        np.clip(velocities, -limit, limit, out=velocities)

    def _confine(self, positions: np.ndarray, velocities: np.ndarray) -> None:
        """Keep to the bounds and within one period, in place."""
        if self.settings.bounds is not None:
            velocities[(positions < self._lower) | (positions > self._upper)] = 0.0
            np.clip(positions, self._lower, self._upper, out=positions)
        for column in self._wraps:
            period, lowest = self._period[column], np.array(self.settings.position_range)[0, column]
            positions[:, column] -= period * np.floor((positions[:, column] - lowest) / period)

    def _record(self, finite_losses: np.ndarray) -> None:
        mean = worst = math.nan
        if finite_losses.size:
            with np.errstate(over="ignore"):
                mean, worst = float(finite_losses.mean()), float(finite_losses.max())
        self._history.append(
            [min(self._best_loss, self._kept_loss), mean, worst, float(self.settings.particles - finite_losses.size)]
        )
        # Compared with the last loss that counted, so that many small steps together do count.
        least = self.settings.stall_tolerance * tolerance_scale(self._best_loss, self.settings.loss_scale)
        if self._best_loss < self._improved_loss - least:
            self._improved_loss = self._best_loss
            self._improved_at = self.iterations

    def state(self, plain: bool = True) -> dict[str, Any]:
        """Everything the search needs to go on, in strict JSON types; numbers not finite are text ("inf").

        With ``plain`` false arrays stay arrays, and numbers numbers.
        """
        kept = as_plain if plain else copy.deepcopy
        self._arrive()
        return {
            "format": STATE_FORMAT,
            "settings": kept(asdict(self.settings)),
            "random": self.random.bit_generator.state,
            **{name: kept(getattr(self, f"_{name}")) for name in ARRAYS},
            **{name: kept(getattr(self, f"_{name}")) for name in NUMBERS},
            "history": kept(np.reshape(self._history, (-1, len(HISTORY)))),
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> Swarm:
        """The swarm that `state()` was taken from, bit for bit. Raises ValueError for anything else."""
        if state.get("format") != STATE_FORMAT:
            raise ValueError(f"swarm state: format = {state.get('format')!r}: must be {STATE_FORMAT!r}")
        try:
            swarm = cls(SwarmSettings(**state["settings"]))
            swarm.random.bit_generator.state = state["random"]
            for name in ARRAYS:
                values, shape = np.array(state[name], dtype=float), getattr(swarm, f"_{name}").shape
                if values.shape != shape:
                    raise ValueError(f"swarm state: {name} of shape {values.shape}: must be {shape}")
                setattr(swarm, f"_{name}", values)
            for name, kind in NUMBERS.items():
                setattr(swarm, f"_{name}", kind(state[name]))
            swarm._best = int(np.argmin(swarm._personal_losses))
            swarm._best_loss = float(swarm._personal_losses[swarm._best])
            swarm._given = swarm._positions
            swarm._history = np.array(state["history"], dtype=float).reshape(-1, len(HISTORY)).tolist()
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
    objective: Callable[[Any], ArrayLike],
    callback: Callable[[Any], object] | None = None,
    whole: bool = True,
) -> Any:
    """Run a search until its `stop()` names a reason or `callback(searcher)` returns something true.

    `objective` takes positions, shape (particles, dimension), and returns losses to minimise, shape (particles,);
    unless `whole`, it takes what `ask` gave, which is made when slices are looked at. `callback` is called after each
    iteration; a search that it ended goes on when this is called again. Returns `searcher.result`.
    """
    while not searcher.stop():
        solutions = searcher.ask()
        # A copy, which the objective is free to change.
        searcher.tell(solutions, objective(np.array(solutions, dtype=float) if whole else solutions))
        if callback is not None and callback(searcher):
            break
    return searcher.result
