"""Localization factors over a range of frequencies, and the plate's resonances in it."""

import math

import numpy as np

from warp_plate.modal.modes import solve_modes
from warp_plate.modal.poles import adaptive_frequencies
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.allowed_drives import allowed_drives
from warp_plate.problem.bounds import bound_localization
from warp_plate.problem.parametrization import Parametrization, parametrization_of
from warp_plate.problem.problem import Problem
from warp_plate.resolve import Resolved
from warp_plate.result.case import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response, count_unit_drives, response_of, unit_drives
from warp_plate.solve.solver import PlateSolver

# Limits of the number of frequencies by time steps, between which their plates cost about as much as the search.
FEWEST, MOST = 61, 201
# Most actuators with a bound at each frequency: it takes about 0.03 s for as many, and grows as the fourth power.
MOST_BOUNDED = 20


def make_spectrum(problem: Problem, best: Case) -> dict[str, np.ndarray]:
    """Return ``Result.spectrum`` at the positions and delays of the best case; empty without frequencies."""
    scene, frequencies = problem.scene, spectrum_frequencies(problem)
    if not frequencies.size:
        return {}
    factors = factors_over(problem.resolved, frequencies, best.centre, best.delay)
    return {"frequency": frequencies, **factors, "resonances": resonances(scene, frequencies[0], frequencies[-1])}


def has_spectrum(problem: Problem) -> bool:
    """Return whether a common frequency of all actuators is searched, and the scene is linear in the drives."""
    search = problem.scene.search.frequency
    return search is not None and not search.own and search.actuators is None and problem.scene.linear


def spectrum_frequencies(problem: Problem) -> np.ndarray:
    """Return the frequencies of a result's spectrum [Hz]; empty without one."""
    scene = problem.scene
    search = scene.search.frequency
    if search is None or not has_spectrum(problem):
        return np.empty(0)
    # By modes they follow every resonance, unless limits on magnitudes make the bound at each too dear.
    if problem.resolved.by_modes and not allowed_drives(parametrization_of(scene)).limits_ratios:
        plate = solve_modes(scene, search.range[1], key="search.frequency.range")
        return adaptive_frequencies(*plate.resonances, *search.range)
    evaluations, units = scene.search.particles * scene.search.iterations, count_unit_drives(len(scene.actuators))
    return np.linspace(*search.range, min(MOST, max(FEWEST, evaluations // units)))


def factors_over(
    resolved: Resolved, frequencies: np.ndarray, centre: np.ndarray | None = None, delay: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Return localization factors (n,) at frequencies [Hz], for places (actuators, 2) and delays (actuators,): "equal";
    "single", the best single actuator; "best", a bound over the drives that the search may choose."""
    scene = resolved.scene
    exact, singles = resolved.with_scene(scene.in_float64()), np.eye(len(scene.actuators), dtype=complex)
    solver = exact.solver(exact.grid_for(per_plate_of(exact.scene)))
    parametrization = parametrization_of(scene)
    rows = []
    for response in _responses(solver, frequencies, centre, delay):
        equal, of_singles = (localization_factor(response.energy(d)) for d in (singles.sum(axis=0)[None], singles))
        rows.append((equal[0], np.nanmax(of_singles), _best_factor(response, parametrization)))
    return dict(zip(("equal", "single", "best"), np.array(rows, dtype=float).T, strict=True))


def _responses(
    solver: PlateSolver | ModalSolver, frequencies: np.ndarray, centre: np.ndarray | None, delay: np.ndarray | None
) -> list[Response]:
    """Return the responses at (n,) frequencies [Hz]."""
    actuators = len(solver.scene.actuators)
    units = np.zeros((1, actuators)) if isinstance(solver, ModalSolver) else unit_drives(actuators)
    phasors = np.tile(units, (len(frequencies), 1))
    repeated = np.repeat(frequencies, len(units))[:, None] * np.ones(actuators)
    shared = (
        None if values is None else np.broadcast_to(values, (len(phasors), *values.shape)) for values in (centre, delay)
    )
    designs = Designs(phasors, repeated, *shared)
    if isinstance(solver, ModalSolver):
        return [Response(matrices) for matrices in solver.gram_matrices(designs)]
    energy = solver.run(designs).energy.reshape(len(frequencies), len(units), -1)
    return [response_of(energy_at_frequency, actuators) for energy_at_frequency in energy]


def _best_factor(response: Response, parametrization: Parametrization) -> float:
    """Return the bound over the drives that the search may choose; if it chooses none, the factor of the scene's."""
    if not any(number.kind in ("magnitude", "phase") for number in parametrization.variables):
        drive = parametrization.designs(np.zeros((1, len(parametrization.variables)))).drives
        return float(localization_factor(response.energy(drive))[0])
    bound = bound_localization(response, allowed_drives(parametrization), MOST_BOUNDED)
    return math.nan if bound is None else bound.value


def resonances(scene: Scene, low: float, high: float) -> np.ndarray:
    """Return the natural frequencies [Hz] of a linear scene's plate from ``low`` to ``high``; none if too many are."""
    try:
        natural = solve_modes(scene, highest=high).frequencies
    except SceneError:
        return np.empty(0)
    return natural[(natural >= low) & (natural <= high)]
