"""The figures that a sweep takes of a scene: what each command finds, as numbers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.analysis.check import check
from warp_plate.optimize.exact import best_position
from warp_plate.optimize.optimizer import MethodError, minimize
from warp_plate.plate.modes import natural_modes, refuse_many_nodes
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import at_highest_frequency
from warp_plate.problem.evaluate_cases import reference_phasors
from warp_plate.problem.problem import Problem
from warp_plate.problem.robust import make_problem
from warp_plate.result.sweep import SweepOutput
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.studies.driver import searcher_of
from warp_plate.studies.localize import resolve
from warp_plate.studies.simulate import simulate

# By name: one number, or (count,) where the output has an axis.
Values = dict[str, float | np.ndarray]


@dataclass(frozen=True)
class Options:
    """device, path: see :class:`PlateSolver`; count: length of the outputs' own axis."""

    device: str = "auto"
    path: str = "auto"
    count: int = 6


@dataclass(frozen=True)
class Figures:
    """outputs: by name, the one that matters most first; of: their values in a scene, which raises SceneError where the
    scene is refused."""

    outputs: Mapping[str, SweepOutput]
    of: Callable[[Scene, Options], Values]


def localize_figures(scene: Scene, options: Options) -> Values:
    """Of equal drive, the best single actuator and the best drive, and the bound, NaN where none is claimed; of several
    targets for the first.

    Where energies are quadratic forms of the drives they come from Gram matrices; the best drive is then the
    eigenvector, where the search's variables reach it, else what the scene's own search finds.
    """
    one = scene.model_copy(update={"targets": ()})
    chosen = resolve(at_highest_frequency(one), options.device)[0]
    problem = make_problem(chosen.model_copy(update={"actuators": one.actuators}), options.device, options.path)
    if problem.response is not None and scene.search.robust is None:
        problem = replace(problem, evaluator_name="response")
    drives = np.array(list(reference_phasors(problem.scene, problem.energies_of_phasors).values()))
    equal, single = localization_factor(problem.energies_of_phasors(drives)).tolist()
    if not np.isfinite([equal, single]).any():
        _refuse_fault(problem, drives)
    position, best = _best_position(problem), single
    if position is not None:
        best = float(localization_factor(problem.energies(problem.parametrization.designs(position[None])))[0])
    return {"equal": equal, "single": single, "best": best, "bound": np.nan if problem.bound is None else problem.bound}


def simulate_figures(scene: Scene, options: Options) -> Values:
    """Of the magnitudes and phases that the scene gives its actuators."""
    result = simulate(scene, device=options.device, path=options.path, estimate=False)
    case = result.cases["drive"]
    if case.status != "ok":
        raise SceneError(case.status)
    return {
        "localization_factor": case.localization_factor,
        "energy_plate": case.energy["plate"],
        "energy_target": case.energy["target"],
        "peak_displacement": np.nan if result.peak_displacement is None else result.peak_displacement,
    }


def modes_figures(scene: Scene, options: Options) -> Values:
    """The lowest natural frequencies; NaN beyond those that the grid has."""
    resolved = resolve(scene, options.device)[0]
    refuse_many_nodes(resolved)
    found = natural_modes(resolved, options.count).frequencies
    return {"frequency": np.pad(found, (0, options.count - len(found)), constant_values=np.nan)}


def check_figures(scene: Scene, options: Options) -> Values:
    """What the scene asks of numbers."""
    found = check(resolve(scene, options.device)[0], options.device)
    return {
        "time_step": found.time_step,
        "limit": found.limit.time_step,
        "steps_a_period": found.steps_a_period,
        "points_a_wavelength": found.points_a_wavelength,
    }


QUANTITIES: Mapping[str, Figures] = {
    "localize": Figures(
        {
            "best": SweepOutput("1", "localization factor, best drive"),
            "bound": SweepOutput("1", "localization factor, bound"),
            "single": SweepOutput("1", "localization factor, best single actuator"),
            "equal": SweepOutput("1", "localization factor, equal drive"),
        },
        localize_figures,
    ),
    "simulate": Figures(
        {
            "localization_factor": SweepOutput("1", "localization factor"),
            "energy_plate": SweepOutput("J", "kinetic energy of the plate"),
            "energy_target": SweepOutput("J", "kinetic energy of the target"),
            "peak_displacement": SweepOutput("m", "largest displacement"),
        },
        simulate_figures,
    ),
    "modes": Figures({"frequency": SweepOutput("Hz", "natural frequency", "mode")}, modes_figures),
    "check": Figures(
        {
            "limit": SweepOutput("s", "time step, largest stable"),
            "time_step": SweepOutput("s", "time step, taken"),
            "steps_a_period": SweepOutput("1", "resolution, steps in a period of the drive"),
            "points_a_wavelength": SweepOutput("1", "resolution, nodes in a bending wavelength"),
        },
        check_figures,
    ),
}


def _best_position(problem: Problem) -> np.ndarray | None:
    """What the search is to find; None where one actuator leaves no choice, or nothing was found."""
    if problem.scene.search.robust is None and problem.only_localization and problem.space.dimension:
        try:
            return best_position(problem.space, problem.quadratic)
        except MethodError:  # a limit, a range or a held number keeps the drive from it: it must be sought
            pass
    searcher = searcher_of(problem, problem.scene.search.seed)
    if searcher is None:
        return None
    minimize(searcher, problem.losses)
    return searcher.result.xbest


def _refuse_fault(problem: Problem, drives: np.ndarray) -> None:
    """Refuse a scene whose plates have no energies, by what went wrong with them; where nothing did, they rest."""
    fault = problem.drive_solver.run(drives[:1]).fault(0)
    if fault != "ok":
        raise SceneError(fault)
