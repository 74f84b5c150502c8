"""The cases of a result: two references and the best drive, each run once more for its pictures and objectives."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.modal.solver import ModalGrid
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.scheme import Discretization
from warp_plate.plate.signals import actuator_frequencies
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import single_drives
from warp_plate.problem.problem import Energies, Problem
from warp_plate.quantities.region_quantities import LEAST_REST, PLATE, REGION_QUANTITIES, TARGET, RegionSizes
from warp_plate.result.case import Case, RegionMotion
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.run import Run, run_with_peaks


@dataclass(frozen=True)
class EvaluatedCases:
    """Cases of a result and the run that gave the best of them."""

    cases: dict[str, Case]  # cases by name: "equal", "single" and "best"
    scene: Scene  # scene of ``run``
    # (actuators,) phasors of the plates of ``run``: of the best case, or of all that differ in nothing else
    phasors: dict[str, np.ndarray]
    run: Run
    peak: float  # largest displacement of the best case [m], see ``Result``
    node_steps: int  # node-steps of solvers beside the problem's


def evaluate_cases(problem: Problem, single: int, position: np.ndarray | None) -> EvaluatedCases:
    """Run the reference drives at the scene's own frequency and places, and the best position (dimension,), or the best
    single actuator, of index ``single``, if that is None."""
    scene, grid, parametrization = problem.scene, problem.resolved.grid, problem.parametrization
    singles = single_drives(scene)
    phasors = {"equal": singles.sum(axis=0), "single": singles[single]}
    if position is None:
        phasors["best"] = phasors["single"]
    elif parametrization.only_drives:
        phasors["best"] = parametrization.drive(position)
    if position is None or parametrization.only_drives:
        run, peaks = run_with_peaks(problem.drive_solver, np.array(list(phasors.values())))
        cases = cases_from_run(phasors, run, grid, peaks)
        return EvaluatedCases(cases, scene, phasors, run, float(peaks[-1].max()), 0)
    # The best scene runs as in ``simulate``, so that the stored numbers can be reproduced.
    best_scene, designs = parametrization.scene_of(position), parametrization.designs(position[None])
    solver = problem.resolved.with_scene(best_scene).solver(areas=best_scene.target_regions)
    best = {"best": scene_phasors(best_scene)}
    best_run, best_peaks = run_with_peaks(solver, best["best"][None])
    drives, recorded = np.array(list(phasors.values())), best_run.times.tolist()
    run, peaks = run_with_peaks(problem.drive_solver, drives, recorded=recorded)
    cases = cases_from_run(phasors, run, grid, peaks)
    names = ("frequency", "centre", "delay")
    varied = {name: values[0] for name in names if (values := getattr(designs, name)) is not None}
    cases["best"] = replace(cases_from_run(best, best_run, solver.discretization, best_peaks)["best"], **varied)
    return EvaluatedCases(cases, best_scene, best, best_run, float(best_peaks.max()), solver.node_steps)


def reference_phasors(singles: np.ndarray, energies: Energies) -> dict[str, np.ndarray]:
    """Return the drives that a search is compared with: "equal" on all actuators, and the best of ``single_drives``."""
    best = int(np.argmax(np.nan_to_num(localization_factor(energies(singles)), nan=-1.0)))
    return {"equal": singles.sum(axis=0), "single": singles[best]}


def cases_from_run(
    phasors: dict[str, np.ndarray], run: Run, grid: Discretization | ModalGrid, peaks: np.ndarray
) -> dict[str, Case]:
    """Return the plates of a run as cases, by the names of their phasors; ``peaks``: see ``run_with_peaks``."""
    motions = region_motions(grid, run, peaks)
    with np.errstate(over="ignore"):  # beyond float32's range a displacement becomes infinite
        displacement = run.displacement.astype(np.float32)
        trace = run.trace[..., : run.trace_times.size].astype(np.float32)
    return {
        name: Case(
            phasors=values,
            energy=dict(zip(run.regions, run.energy[index].tolist(), strict=True)),
            displacement=displacement[index],
            trace=trace[index],
            status=run.fault(index),
            motion=motions[index],
        )
        for index, (name, values) in enumerate(phasors.items())
    }


def region_motions(grid: Discretization | ModalGrid, run: Run, peaks: np.ndarray) -> list[RegionMotion]:
    """Return the motion of target and rest of each plate of a run."""
    areas, masses = (
        np.stack([values[..., TARGET], values[..., PLATE] - values[..., TARGET]], axis=-1)
        for values in (grid.region_weights.sum(axis=(1, 2)), run.masses)
    )
    exists = areas > LEAST_REST * areas.sum()
    sizes = RegionSizes(np.where(exists, areas, np.nan), np.where(exists, masses, np.nan))
    velocity, contrast = REGION_QUANTITIES["velocity"], REGION_QUANTITIES["contrast"]
    assert velocity.of_rest is not None
    velocities = velocity.evaluate(run.energy, sizes).tolist(), velocity.of_rest(run.energy, sizes).tolist()
    scene = grid.scene
    omega = (
        2 * math.pi * float(actuator_frequencies(scene)[0]) if scene.linear and scene.nonharmonic_key is None else None
    )
    return [
        RegionMotion(
            velocity=(target, rest),
            displacement=(float(peak[0]), float(peak[1])),
            acceleration=None if omega is None else (omega * target, omega * rest),
            contrast=float(level),
        )
        for target, rest, peak, level in zip(
            *velocities, np.where(exists, peaks, np.nan), contrast.evaluate(run.energy, sizes), strict=True
        )
    ]


def evaluate_objectives(problem: Problem, cases: Mapping[str, Case]) -> tuple[dict[str, dict[str, float]], int]:
    """Return ``Objectives.values`` by objective of cases that were not optimised for them, by case, and node-steps;
    empty if only the localization factor counts, if each of several targets has its objectives, or if Ctrl-C interrupts
    it."""
    objectives, solver = problem.objectives, problem.drive_solver
    if objectives.plain or problem.scene.targets:
        return {}, 0
    displacement_energy, node_steps = None, 0
    try:
        if objectives.needs_displacement:
            solver = problem.resolved.solver(areas=objectives.regions, quantity="displacement")
            run = solver.run(np.array([case.phasors for case in cases.values()]))
            displacement_energy, node_steps = run.energy, run.node_steps
    except (KeyboardInterrupt, SceneError):  # a failing comparison does not lose the result
        return {}, 0
    energy = np.array([list(case.energy.values()) for case in cases.values()])
    values = objectives.values(energy, displacement_energy)
    by_case = {name: {kind: float(column[at]) for kind, column in values.items()} for at, name in enumerate(cases)}
    return by_case, node_steps
