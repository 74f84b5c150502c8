"""The method that a scene names, in the one shape that all have: ask, tell, stop, result, history and state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np

from warp_plate.optimize.cma_es import CovarianceSearch, CovarianceSettings
from warp_plate.optimize.exact import ExactSearch
from warp_plate.optimize.gradient import GradientSearch, GradientSettings
from warp_plate.optimize.pso import Swarm
from warp_plate.optimize.pso_settings import SwarmSettings
from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.record import SearchResult
from warp_plate.optimize.space import Space
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.row_blocks import GrowingRows
from warp_plate.problem.objectives import loss_scale
from warp_plate.scene.errors import SceneError
from warp_plate.scene.search import Search

# A swarm with restarts, and no word on when, starts anew after so many iterations without progress.
RESTART_AFTER = 20
# Bytes a particle and number: positions, velocities, own bests, random numbers, drives; and what a descent keeps.
SWARM_BYTES, MATRIX_BYTES = 120.0, 32.0

# The keys of ``[search]`` that not every method reads, and those that do; docs/methods.md has the same table.
_SWARMS = ("pso", "constriction", "ring")
READ_BY = {
    **dict.fromkeys(("particles", "iterations", "restarts", "stall"), (*_SWARMS, "cma", "gradient")),
    "velocity_limit": _SWARMS,
    **dict.fromkeys(("inertia", "decay", "cognitive", "social"), ("pso",)),
}


class Optimizer(Protocol):
    """A search between two iterations; states are flat: plain numbers, texts, arrays, and one of random numbers."""

    @property
    def iterations(self) -> int: ...

    @property
    def history(self) -> dict[str, np.ndarray]: ...

    @property
    def result(self) -> SearchResult: ...

    def ask(self) -> np.ndarray | GrowingRows: ...

    def tell(self, solutions: Any, losses: Any, /) -> None: ...

    def stop(self) -> dict[str, Any]: ...

    def state(self, plain: bool = True, /) -> dict[str, Any]: ...


def make_optimizer(search: Search, space: Space, seed: int, problem: Quadratic | None = None) -> Optimizer:
    """The method of a table ``[search]`` at its beginning.

    problem: where losses are functions of quadratic forms of the drive, which "gradient" and "exact" need.

    Raises:
        SceneError: the method does not fit the problem or takes more memory than there is; pycma is missing.
    """
    return _made(search, space, seed, problem, None)


def optimizer_from_state(
    search: Search, space: Space, seed: int, state: Mapping[str, Any], problem: Quadratic | None = None
) -> Optimizer:
    """The same, where its ``state`` was taken, bit for bit.

    Raises:
        SceneError: as :func:`make_optimizer`.
        ValueError: the state is not that of such a search.
    """
    return _made(search, space, seed, problem, dict(state))


def unread_keys(search: Search) -> list[str]:
    """A sentence for each key that is not as the default has it, and that the method does not read."""
    return [
        f"search.{key} = {getattr(search, key)}: method = {search.method!r} does not read it, only "
        f"{', '.join(map(repr, methods))}; delete it, or write another method."
        for key, methods in READ_BY.items()
        if search.method not in methods and getattr(search, key) != type(search).model_fields[key].default
    ]


def swarm_settings(search: Search, space: Space, seed: int) -> SwarmSettings:
    """What the swarm of "pso", "constriction" or "ring" is told.

    Raises:
        SceneError: it takes more memory than there is.
    """
    _refuse_beyond_memory(search, space, SWARM_BYTES * space.dimension)
    span = space.initial_upper - space.initial_lower
    common: dict[str, Any] = {
        "particles": search.particles,
        "iterations": search.iterations,
        "velocity_limit": search.velocity_limit,
        "stall": search.stall if search.stall or not search.restarts else RESTART_AFTER,
        "restarts": search.restarts,
        "loss_scale": loss_scale(search.objectives),
        "seed": seed,
        "position_range": (space.initial_lower, space.initial_upper),
        # In the source paper both ranges are −2 ... 2: a velocity goes at most half-way across.
        "velocity_range": (-span / 2, span / 2),
        "bounds": (space.lower, space.upper) if np.isfinite([space.lower, space.upper]).any() else None,
        "period": space.period if np.isfinite(space.period).any() else None,
    }
    if search.method == "pso":
        own = {name: getattr(search, name) for name in ("inertia", "decay", "cognitive", "social")}
        return SwarmSettings(space.dimension, **own, **common)
    return SwarmSettings.constriction(space.dimension, neighbours=1 if search.method == "ring" else None, **common)


def _made(
    search: Search, space: Space, seed: int, problem: Quadratic | None, state: dict[str, Any] | None
) -> Optimizer:
    if search.method == "exact":
        return ExactSearch(space, problem) if state is None else ExactSearch.from_state(space, problem, state)
    evaluations, least = search.particles * search.iterations, loss_scale(search.objectives)
    if search.method == "gradient":
        if problem is None:
            raise SceneError(
                "search.method = 'gradient': needs losses that follow from quadratic forms of the drives; write 'cma'"
            )
        _refuse_beyond_memory(search, space, (SWARM_BYTES + MATRIX_BYTES * space.dimension) * space.dimension)
        descents = GradientSettings(search.particles, evaluations, search.restarts, search.stall, seed, least)
        if state is None:
            return GradientSearch(space, problem, descents)
        return GradientSearch.from_state(space, problem, descents, state)
    if search.method == "cma":
        _refuse_beyond_memory(search, space, SWARM_BYTES * space.dimension)
        population = max(search.particles, 4 + int(3 * math.log(space.dimension)))
        cloud = CovarianceSettings(population, evaluations, search.restarts, search.stall, seed, least)
        return CovarianceSearch(space, cloud) if state is None else CovarianceSearch.from_state(space, cloud, state)
    settings = swarm_settings(search, space, seed)
    return Swarm(settings) if state is None else Swarm.from_state({**state, "settings": asdict(settings)})


def _refuse_beyond_memory(search: Search, space: Space, each: float) -> None:
    what = f"search.particles = {search.particles} with {space.dimension} numbers each"
    refuse_beyond_memory(search.particles * (each + 100.0), what)
