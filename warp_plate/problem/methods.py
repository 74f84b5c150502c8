"""The search method that a scene names."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warp_plate.optimize.cma_es import CovarianceSearch
from warp_plate.optimize.gradient import GradientSearch, Slopes
from warp_plate.optimize.optimizer import MethodError, Optimizer, SearchSettings, SearchSpace
from warp_plate.optimize.pso import Swarm, SwarmSettings
from warp_plate.optimize.quadratic import ExactSearch, Quadratic, best_position, starting_position
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.allowed_drives import allowed_drives, searches_only_frequency
from warp_plate.problem.objectives import loss_scale
from warp_plate.problem.parametrization import parametrization_of
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.resolve import Resolved, resolve
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import SWARMS, Search

# A swarm with restarts but without ``stall`` restarts after this many iterations without progress.
RESTART_AFTER = 20
# Bytes for each number of a particle: positions, velocities, personal bests, random numbers, drives; for each entry of
# a descent's inverse Hessian; for each particle; and for each iteration.
NUMBER_BYTES, MATRIX_BYTES, PARTICLE_BYTES, ITERATION_BYTES = 120.0, 32.0, 100.0, 250.0

# The keys of ``[search]`` that not every method reads, and the methods that do; docs/methods.md has the same table.
READ_BY = {
    **dict.fromkeys(("particles", "iterations", "restarts", "stall"), (*SWARMS, "cma", "gradient")),
    "velocity_limit": SWARMS,
    **dict.fromkeys(("inertia", "decay", "cognitive", "social"), ("pso",)),
}


def make_optimizer(
    search: Search,
    space: SearchSpace,
    seed: int,
    problem: Quadratic | None = None,
    state: Mapping[str, Any] | None = None,
    slopes: Slopes | None = None,
    start: np.ndarray | None = None,
    candidates: np.ndarray | None = None,
) -> Optimizer:
    """Return the method of a table ``[search]``, at its beginning or in a state that ``Optimizer.state`` returned.

    "exact" and "gradient" need a problem whose losses follow from quadratic forms of the drive; for "gradient" slopes
    of losses will do. Swarms and clouds contain the position ``start`` (dimension,), and descents begin there too;
    "exact" takes the best of ``candidates`` (n, dimension) if there are some.
    SceneError: the method does not fit the problem, is not installed or takes too much memory.
    ValueError: the state is not that of such a search.
    """
    if slopes is None and problem is not None:
        slopes = problem.losses_and_slopes
    method, dimension = search.method or "pso", space.dimension
    refuse_many_particles(search, dimension)
    if method == "gradient" and problem is not None:
        start = starting_position(space, problem)
    makers: dict[str, Callable[[], Optimizer]] = {
        "exact": lambda: ExactSearch(space, best_position(space, problem)[None] if candidates is None else candidates),
        "cma": lambda: CovarianceSearch(space, _settings(search, seed), start),
        "gradient": lambda: GradientSearch(space, slopes, _settings(search, seed), start),
    }
    try:
        optimizer = makers.get(method, lambda: Swarm(space, swarm_settings(search, seed), start))()
    except MethodError as error:
        raise SceneError(f"search.method = {method!r}: {error}") from None
    if state is not None:
        optimizer.restore(state)
    return optimizer


def optimizer_bytes(search: Search, dimension: int) -> float:
    """Return the bytes that a method takes for its particles, with their drives and losses."""
    if search.method == "exact":
        return 0.0
    number_bytes = NUMBER_BYTES + (MATRIX_BYTES * dimension if search.method == "gradient" else 0.0)
    return search.particles * (number_bytes * dimension + PARTICLE_BYTES)


def history_bytes(search: Search) -> float:
    """Return the bytes of the history of a method that runs all iterations; others may stop after few."""
    return ITERATION_BYTES * search.iterations if search.method in SWARMS and search.stall is None else 0.0


def refuse_many_particles(search: Search, dimension: int) -> None:
    """Raise a SceneError if the particles of a search take more memory than there is."""
    if needed := optimizer_bytes(search, dimension):
        refuse_beyond_memory(needed, f"search.particles = {search.particles} with {dimension} numbers each")


def unread_keys(search: Search) -> list[str]:
    """Return a sentence for each key that differs from its default and that the method does not read."""
    method = search.method or "pso"
    return [
        f"search.{key} = {getattr(search, key)}: method = {method!r} does not read it, only "
        f"{', '.join(map(repr, methods))}; delete it, or write another method."
        for key, methods in READ_BY.items()
        if method not in methods and getattr(search, key) != type(search).model_fields[key].default
    ]


def with_method(scene: Scene) -> Scene:
    """Return the scene with a method of search, the default one where it names none."""
    search = scene.search
    if search.method is not None:
        return scene
    bounded_by = REGION_QUANTITIES[search.objectives[0].kind].bounded_by if len(search.objectives) == 1 else None
    method = "pso"
    if _is_plain(search) and bounded_by is not None and scene.linear and len(scene.actuators) > 1:
        parametrization = parametrization_of(scene)
        if parametrization.only_drives:
            free = bounded_by == "localization" and allowed_drives(parametrization).free and not scene.limited_levels
            method = "exact" if free else "gradient"
    return scene.with_keys("search", method=method)


def _is_plain(search: Search) -> bool:
    """Return whether a search is not robust and has no key of a swarm."""
    return all(getattr(search, key) == Search.model_fields[key].default for key in (*READ_BY, "robust"))


def resolve_search(written: Scene, device: str, path: str = "auto", evaluator: str | None = None) -> Resolved:
    """Return a scene resolved for its search, with a method; SceneError: see :func:`resolve`, or too many particles."""
    scene = with_method(written)
    refuse_many_particles(scene.search, len(parametrization_of(scene).variables))
    exact = written.search.method is None and scene.search.method == "exact"
    resolved = resolve(scene, device, purpose="exact" if exact else "search", path=path, evaluator=evaluator)
    return with_method_of_engine(resolved, written.search)


def with_method_of_engine(resolved: Resolved, written: Search) -> Resolved:
    """Return a scene with the method "exact" if its search, as written, names none and modes find its frequency."""
    scene = with_method(resolved.scene)
    free = resolved.by_modes and written.method is None and _is_plain(written)
    if free and searches_only_frequency(parametrization_of(scene)):
        scene = scene.with_keys("search", method="exact")
    return resolved.with_scene(scene)


def swarm_settings(search: Search, seed: int) -> SwarmSettings:
    """Return the settings of the swarm of "pso", "constriction" or "ring"."""
    common = vars(_settings(search, seed)) | {"velocity_limit": search.velocity_limit}
    if search.restarts and not search.stall:
        common["stall"] = RESTART_AFTER
    if search.method in ("pso", None):
        weights = {name: getattr(search, name) for name in ("inertia", "decay", "cognitive", "social")}
        return SwarmSettings(**weights, **common)
    return SwarmSettings.constriction(ring=search.method == "ring", **common)


def _settings(search: Search, seed: int) -> SearchSettings:
    keys = {name: getattr(search, name) for name in ("particles", "iterations", "restarts", "stall")}
    return SearchSettings(**keys, seed=seed, loss_scale=loss_scale(search.objectives))
