"""Localization factors over a range of frequencies, and the plate's resonances in it."""

from __future__ import annotations

import math
import time

import numpy as np

from warp_plate.analysis.warnings import MOST_SIDE
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.bounds import bound_localization
from warp_plate.problem.loss_bounds import allowed_drives
from warp_plate.problem.parametrization import Parametrization, parametrization_of
from warp_plate.problem.problem import Problem, in_float64
from warp_plate.result.model import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response, response_of, unit_drives
from warp_plate.solve.solver import PlateSolver

# Frequencies: so many that their plates cost about what the search itself did, within these.
FEWEST, MOST = 61, 201
# Up to so many actuators a frequency's bound takes some 0.03 s; it grows as the fourth power.
MOST_BOUNDED = 20
# Natural frequencies are looked for among so many modes, twice as many while the range may hold more.
MODES, MOST_MODES = 16, 256


def make_spectrum(problem: Problem, best: Case, seconds: dict[str, float]) -> dict[str, np.ndarray]:
    """See ``Result.spectrum``, with the places and starts of the best case; nothing where no frequency of all actuators
    is searched, where drives do not superpose, or where Ctrl-C came first. Adds its seconds."""
    free, scene = problem.scene.search.frequency, problem.scene
    if free is None or free.own or free.actuators is not None or not scene.linear:
        return {}
    started = time.perf_counter()
    tried, units = scene.search.particles * scene.search.iterations, len(unit_drives(len(scene.actuators)))
    frequencies = np.linspace(*free.range, min(MOST, max(FEWEST, tried // units)))
    try:
        factors = factors_over(
            scene, frequencies, best.centre, best.delay, problem.drive_solver.device.alias, problem.path
        )
        made = {"frequency": frequencies, **factors, "resonances": resonances(scene, *free.range)}
    except (KeyboardInterrupt, SceneError):  # a result is not lost for want of a picture
        return {}
    seconds["spectrum"] = time.perf_counter() - started
    return made


def factors_over(
    scene: Scene,
    frequencies: np.ndarray,
    centre: np.ndarray | None = None,
    delay: np.ndarray | None = None,
    device: str = "auto",
    path: str = "auto",
) -> dict[str, np.ndarray]:
    """Localization factors at each of (n,) frequencies [Hz]: "equal", "single" (the best one there), and "best", which
    no drive passes that the search may choose there, from the Gram matrices of that frequency. All plates run in one
    batch.

    centre, delay: (actuators, 2) [m] and (actuators,) [s], see :class:`Designs`; None: the scene's.

    Raises:
        SceneError: see :class:`PlateSolver`; a scene without a search for the frequency, or not linear in its drives.
    """
    exact = in_float64(scene)
    solver, actuators = PlateSolver(exact, device, path, per_plate=per_plate_of(exact)), len(scene.actuators)
    units, singles, variables = unit_drives(actuators), np.eye(actuators, dtype=complex), parametrization_of(scene)
    drives = np.tile(units, (len(frequencies), 1))
    own = np.repeat(frequencies, len(units))[:, None] * np.ones(actuators)
    others = (None if one is None else np.broadcast_to(one, (len(drives), *one.shape)) for one in (centre, delay))
    designs = Designs(drives, own, *others)
    energy = solver.run(designs).energy.reshape(len(frequencies), len(units), -1)
    found: dict[str, list[float]] = {"equal": [], "single": [], "best": []}
    for one in energy:
        response = response_of(one, actuators)
        found["equal"].append(_factor(response, singles.sum(axis=0)))
        found["single"].append(float(np.nanmax(localization_factor(response.energy(singles)))))
        found["best"].append(_best(response, variables))
    return {name: np.array(values) for name, values in found.items()}


def _factor(response: Response, drive: np.ndarray) -> float:
    """Localization factor under a drive (actuators,)."""
    return float(localization_factor(response.energy(drive[None]))[0])


def _best(response: Response, variables: Parametrization) -> float:
    """What no drive passes that the search may choose; where it may choose none, what the scene's own has."""
    if not any(one.kind in ("magnitude", "phase") for one in variables.variables):
        return _factor(response, variables.designs(np.zeros((1, len(variables.variables)))).drives[0])
    bound = bound_localization(response, allowed_drives(variables), MOST_BOUNDED)
    return math.nan if bound is None else bound.value


def resonances(scene: Scene, low: float, high: float) -> np.ndarray:
    """Natural frequencies [Hz] of the plate from ``low`` to ``high``, on a grid of at most ``MOST_SIDE`` a side."""
    nodes = tuple(min(count, MOST_SIDE) for count in scene.grid.nodes)
    grid = scene.grid.model_dump() | {"nodes": nodes, "time_step": None}
    coarse, count = scene.with_tables(grid=grid), MODES
    while True:
        found = natural_modes(coarse, count).frequencies
        if len(found) < count or found[-1] > high or count >= MOST_MODES:
            return found[(found >= low) & (found <= high)]
        count *= 2
