"""Particle swarm search, as in the source paper.

Source: Jo, Yang, Shin, J. Inf. Commun. Converg. Eng. 22(2), 2024, section II.C, equations (7) and (8). For a particle
with position X, velocity V and personal best position P, and with G the best position of all,

    V(l+1) = w k^l V(l) + c1 U (P - X) + c2 U (G - X)        w inertia, k decay, c1 cognitive, c2 social        (7)
    X(l+1) = X(l) + V(l+1)                                   l = 1, 2, ...; U uniform in [0, 1)                 (8)

Deviations from the printed text, and choices that it leaves open:

- (7) is printed without "- X". Particles would then be thrown past the best positions, not drawn to them.
- w = 4 with k = 0.99 keeps w k^l above 1 for all 80 iterations, and velocities grow without end. The default is 0.4;
  4 may still be given.
- The paper does not say whether U is one number for a particle or one for each component. It is one for each component.
- Evaluating the first swarm is iteration 1: 80 iterations of 20 particles are 1600 evaluations.

Beyond the paper: constriction (Clerc and Kennedy), a ring of neighbours (Kennedy and Mendes, IEEE CEC 2002, "lbest"),
numbers that wrap, and restarts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_plate.optimize.optimizer import STALL_TOLERANCE, Optimizer, SearchSettings, SearchSpace, tolerance_scale
from warp_plate.row_blocks import over_blocks

# Largest velocity, so that the positions of a swarm that flies apart stay finite.
LARGEST = 1e100


@dataclass(frozen=True)
class SwarmSettings(SearchSettings):
    """Settings of a particle swarm, besides those of all methods."""

    inertia: float = 0.4  # w of equation (7)
    decay: float = 0.99  # k
    cognitive: float = 2.0  # c1
    social: float = 2.0  # c2
    velocity_limit: float | None = None  # largest size of a velocity component
    ring: bool = False  # G is the best of the particle and its two neighbours in a ring, not of all particles

    @classmethod
    def constriction(cls, **others: Any) -> SwarmSettings:
        """Return the settings of Clerc and Kennedy, IEEE Trans. Evol. Comput. 6(1), 2002, type 1'': with φ = c₁ + c₂,

            V ← χ (V + c₁ U (P − X) + c₂ U (G − X)),     χ = 2/(φ − 2 + √(φ² − 4φ)) = 0.7298 for c₁ = c₂ = 2.05

        as an inertia χ that does not decay and the factors χ c₁ and χ c₂.
        """
        factor, total = 2.05, 4.1
        inertia = 2 / (total - 2 + math.sqrt(total * (total - 4)))
        return cls(inertia=inertia, decay=1.0, cognitive=inertia * factor, social=inertia * factor, **others)


class Swarm(Optimizer):
    """The paper's particle swarm; ``positions`` are X.

    Attributes:
        velocities: (particles, dimension) V, by which the particles moved last.
        personal_positions: (particles, dimension) P, where each particle's loss was smallest.
        personal_losses: (particles,) that loss; infinite until a particle has had a finite one.
        leader: index of the particle with the best personal loss, the first of equals.
    """

    FORMAT = "swarm 3"
    STATE = (
        "random", "velocities", "personal_positions", "personal_losses", "improved_loss", "improved_at",
        "earlier_loss", "restarts", "restarted_at",
    )  # fmt: skip
    settings: SwarmSettings
    improved_loss: float

    def __init__(self, space: SearchSpace, settings: SwarmSettings, start: np.ndarray | None = None) -> None:
        """Draw the first swarm, of which one particle is at ``start`` (dimension,)."""
        super().__init__(space, settings)
        self.random = np.random.default_rng(settings.seed)
        self.restarts = self.restarted_at = 0
        self.earlier_loss = math.inf  # best of the swarms before the last restart
        self._draw()
        if start is not None:
            self.positions[0] = start
        self._begin()

    def stop(self) -> dict[str, int]:
        """Return {"iterations": number}, {"stall": iterations without progress}, or nothing to go on."""
        reasons = {}
        if self.iterations >= self.settings.iterations:
            reasons["iterations"] = self.iterations
        if self.stalled() and self.restarts >= self.settings.restarts:
            reasons["stall"] = self.iterations - self.improved_at
        return reasons

    def _propose(self) -> np.ndarray:
        if self.stalled() and self.restarts < self.settings.restarts:
            self.restarts, self.restarted_at, self.earlier_loss = self.restarts + 1, self.iterations, self.best_loss
            self._draw()
            self._begin()
        elif self.iterations and math.isinf(self.personal_losses[self.leader]):
            self._draw()  # no finite loss so far, so there is no best position to move towards
        elif self.iterations:
            self._move()
        return self.positions

    def _learn(self, losses: np.ndarray) -> None:
        # A particle without a finite loss so far has no place to return to: its personal best is where it is.
        better = np.flatnonzero((losses < self.personal_losses) | np.isinf(self.personal_losses))
        self.personal_positions[better] = self.positions.take(better, axis=0)  # three times as fast as an index
        self.personal_losses[better] = losses[better]
        self.leader = int(np.argmin(self.personal_losses))
        best = float(self.personal_losses[self.leader])
        if best < self.earlier_loss:
            self.best_position = self.personal_positions[self.leader].copy()
        # Compared with the loss at the last progress, so that small improvements add up to progress.
        least = STALL_TOLERANCE * tolerance_scale(best, self.settings.loss_scale)
        if best < self.improved_loss - least:
            self.improved_loss, self.improved_at = best, self.iterations

    def stalled(self, since: int = 0) -> bool:
        """Return whether ``settings.stall`` iterations in a row made no progress, together and since a restart."""
        return self.settings.stall is not None and self.iterations - self.improved_at >= self.settings.stall

    def _draw(self) -> None:
        """Draw positions, from the part of their ranges that is within the limits, and then velocities.

        In the source paper both ranges are −2 ... 2: a velocity goes at most half-way across.
        """
        space, shape = self.space, (self.settings.particles, self.space.dimension)
        lowest, highest = np.clip([space.initial_lower, space.initial_upper], space.lower, space.upper)
        # The sum may round up past the upper limit, so clip once more.
        self.positions = np.clip(lowest + (highest - lowest) * self.random.random(shape), space.lower, space.upper)
        slowest, fastest = (sign * (space.initial_upper - space.initial_lower) / 2 for sign in (-1, 1))
        self.velocities = slowest + (fastest - slowest) * self.random.random(shape)
        self._limit(self.velocities)

    def _begin(self) -> None:
        """Forget the personal bests of the swarm before."""
        self.personal_positions = self.positions.copy()
        self.personal_losses = np.full(self.settings.particles, np.inf)
        # Best of this swarm when it last made progress, and the iteration of that.
        self.leader, self.improved_loss, self.improved_at = 0, math.inf, self.iterations

    def _move(self) -> None:
        """Apply equations (7) and (8). A particle that would leave the limits stops at the wall."""
        settings, space, personal = self.settings, self.space, self.personal_positions
        inertia = settings.inertia * settings.decay ** (self.iterations - self.restarted_at)
        leaders = personal[self._best_neighbours() if settings.ring else self.leader]
        leaders = np.broadcast_to(leaders, personal.shape)
        before, self.positions = self.positions, np.empty_like(personal)

        def move(rows: slice) -> None:
            positions, velocities = self.positions[rows], self.velocities[rows]
            velocities *= inertia
            terms = ((settings.cognitive, personal, 0), (settings.social, leaders, personal.size))
            for factor, goals, drawn in terms:
                difference = goals[rows] - before[rows]
                space.shorten(difference)
                draws = self._numbers_after(drawn + rows.start * space.dimension, difference.shape)
                draws *= factor
                difference *= draws
                velocities += difference
            self._limit(velocities)
            np.add(before[rows], velocities, out=positions)
            for column in np.flatnonzero(np.isfinite(space.lower) | np.isfinite(space.upper)):
                numbers, lower, upper = positions[:, column], space.lower[column], space.upper[column]
                velocities[(numbers < lower) | (numbers > upper), column] = 0.0
                np.clip(numbers, lower, upper, out=numbers)
            space.wrap(positions)

        over_blocks(move, len(personal))
        source: Any = self.random.bit_generator
        source.advance(2 * personal.size)

    def _numbers_after(self, skipped: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return the uniform numbers that the generator would draw after ``skipped`` others, leaving it as it is."""
        source: Any = np.random.PCG64(0)
        source.state = self.random.bit_generator.state
        return np.random.Generator(source.advance(skipped)).random(shape)

    def _best_neighbours(self) -> np.ndarray:
        """Return (particles,) the index of the best of a particle and its two neighbours; itself if equal."""
        itself = np.arange(self.settings.particles)
        group = np.stack([itself, np.roll(itself, 1), np.roll(itself, -1)])
        return group[np.argmin(self.personal_losses[group], axis=0), itself]

    def _limit(self, velocities: np.ndarray) -> None:
        limit = LARGEST if self.settings.velocity_limit is None else self.settings.velocity_limit
        np.clip(velocities, -limit, limit, out=velocities)

    def _restore(self, state: Mapping[str, Any]) -> None:
        super()._restore(state)
        self.leader = int(np.argmin(self.personal_losses))
