"""Quantities that a sweep computes for each scene: the results of each command as numbers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from warp_plate.analysis.check import check
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.solver import MODAL
from warp_plate.optimize.optimizer import MethodError, minimize
from warp_plate.optimize.quadratic import best_position
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.evaluate_cases import reference_phasors
from warp_plate.problem.methods import with_method
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.result.sweep import SweepOutput
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.studies.driver import search_optimizer
from warp_plate.studies.frequency_response import respond_to_drive
from warp_plate.studies.grid_choice import resolve_grid, resolve_search_grid
from warp_plate.studies.polish import finish_search
from warp_plate.studies.simulate import simulate

# By name: one number, or an array along the output's axis.
Values = dict[str, float | np.ndarray]


@dataclass(frozen=True)
class Settings:
    """Settings for the computation of quantities.

    Attributes:
        device, path: See :class:`PlateSolver`.
        evaluator: "modal" for the modes of the plate, "direct" for time steps.
        count: Number of modes.
        frequencies: (frequencies,) frequencies of responses [Hz].
    """

    device: str = "auto"
    path: str = "auto"
    evaluator: str = MODAL
    count: int = 6
    frequencies: tuple[float, ...] = ()


@dataclass(frozen=True)
class Quantities:
    """The quantities of one command.

    Attributes:
        outputs: Quantities by name, the most important first.
        compute: Function that computes them for a scene or raises SceneError.
        evaluators: Evaluators that can compute them, the default first.
    """

    outputs: Mapping[str, SweepOutput]
    compute: Callable[[Scene, Settings], Values]
    evaluators: tuple[str, ...] = (MODAL, "direct")


def _localization_quantities(scene: Scene, settings: Settings) -> Values:
    """Return the localization factors of the equal drive, the best single actuator and the best drive, and the bound
    (NaN if none is claimed); for the first of several targets.

    Gram matrices are used where they apply. The best drive is then an eigenvector if the search may choose it;
    otherwise it is searched as the scene says.
    """
    device, evaluator = settings.device, settings.evaluator
    scene = with_method(scene.model_copy(update={"targets": ()}))
    resolved = resolve_search_grid(scene, device, evaluator).scene
    # With time steps, the default evaluator uses Gram matrices for robust searches.
    problem = make_problem(resolved, device, settings.path, MODAL if evaluator == MODAL else None)
    if problem.response is not None and scene.search.robust is None:
        problem = replace(problem, evaluator_name="response")
    phasors = np.array(list(reference_phasors(problem.scene, problem.plates.energies_of_phasors).values()))
    equal, single = localization_factor(problem.plates.energies_of_phasors(phasors)).tolist()
    if not np.isfinite([equal, single]).any() and (fault := problem.drive_solver.run(phasors[:1]).fault(0)) != "ok":
        raise SceneError(fault)  # rather than at rest
    position, best = _best_position(problem), single
    if position is not None:
        best = float(localization_factor(problem.plates.energies(problem.parametrization.designs(position[None])))[0])
    return {"equal": equal, "single": single, "best": best, "bound": np.nan if problem.bound is None else problem.bound}


def _best_position(problem: Problem) -> np.ndarray | None:
    """Return the best position (dimension,), or None if there is nothing to search or nothing was found."""
    if problem.scene.search.robust is None and problem.objectives.only_localization and problem.space.dimension:
        try:
            return best_position(problem.space, problem.quadratic)
        except MethodError:  # a limit or a fixed number keeps the search from the eigenvector
            pass
    seed = problem.scene.search.seed
    optimizer = search_optimizer(problem, seed)
    if optimizer is not None:
        minimize(optimizer, problem.losses)
    return finish_search(optimizer, problem, seed, interrupted=False)[0]


def _simulation_quantities(scene: Scene, settings: Settings) -> Values:
    """Return the localization factor, energies and peak displacement under the scene's own drive."""
    path = settings.path
    if settings.evaluator == MODAL:
        path = MODAL
    elif scene.grid.accuracy is not None:  # a grid for time steps, because an accuracy might choose modes
        scene = resolve_grid(scene, settings.device, scene_phasors(scene)[None]).scene
    result = simulate(scene, device=settings.device, path=path, estimate=False)
    case = result.cases["drive"]
    if case.status != "ok":
        raise SceneError(case.status)
    return {
        "localization_factor": case.localization_factor,
        "energy_plate": case.energy["plate"],
        "energy_target": case.energy["target"],
        "peak_displacement": np.nan if result.peak_displacement is None else result.peak_displacement,
    }


def _modal_quantities(scene: Scene, settings: Settings) -> Values:
    """Return the lowest natural frequencies; NaN beyond those that are solved for."""
    count = settings.count
    found = solve_modes(linear_part(scene), highest=0.0, count=count).frequencies[:count]
    return {"frequency": np.pad(found, (0, count - len(found)), constant_values=np.nan)}


def _response_quantities(scene: Scene, settings: Settings) -> Values:
    """Return the response to the scene's own drive at each frequency."""
    velocity, factor, bound = respond_to_drive(scene, np.array(settings.frequencies))
    return {"mean_square_velocity": velocity, "localization_factor": factor, "bound": bound}


def _numerical_quantities(scene: Scene, settings: Settings) -> Values:
    """Return the time step and its limit, and the resolution in time and space."""
    found = check(resolve_grid(scene, settings.device).scene, settings.device)
    return {
        "time_step": found.time_step,
        "limit": found.limit.time_step,
        "steps_a_period": found.steps_a_period,
        "points_a_wavelength": found.points_a_wavelength,
    }


def _output(name: str, case: str = "", axis: Literal["frequency"] | None = None) -> SweepOutput:
    quantity = REGION_QUANTITIES[name]
    return SweepOutput(quantity.unit, f"{quantity.meaning}, {case}" if case else quantity.meaning, axis)


QUANTITIES: Mapping[str, Quantities] = {
    "localize": Quantities(
        {
            "best": _output("localization", "best drive"),
            "bound": _output("localization", "bound"),
            "single": _output("localization", "best single actuator"),
            "equal": _output("localization", "equal drive"),
        },
        _localization_quantities,
    ),
    "simulate": Quantities(
        {
            "localization_factor": _output("localization"),
            "energy_plate": _output("energy_plate"),
            "energy_target": _output("energy_target"),
            "peak_displacement": SweepOutput("m", "largest displacement"),
        },
        _simulation_quantities,
    ),
    "modes": Quantities({"frequency": SweepOutput("Hz", "natural frequency", "mode")}, _modal_quantities, (MODAL,)),
    "frf": Quantities(
        {
            "mean_square_velocity": _output("mean_square_velocity", axis="frequency"),
            "localization_factor": _output("localization", "drive", "frequency"),
            "bound": _output("localization", "bound", "frequency"),
        },
        _response_quantities,
        (MODAL,),
    ),
    "check": Quantities(
        {
            "limit": SweepOutput("s", "time step, largest stable"),
            "time_step": SweepOutput("s", "time step, taken"),
            "steps_a_period": SweepOutput("1", "resolution, steps in a period of the drive"),
            "points_a_wavelength": SweepOutput("1", "resolution, nodes in a bending wavelength"),
        },
        _numerical_quantities,
        ("direct",),
    ),
}
