"""The drives that a result is about, each run once more for its pictures: two references, and the best one found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.objectives import make_objectives
from warp_plate.problem.parametrization import magnitude_unit
from warp_plate.problem.problem import Energies, Problem, summed_regions
from warp_plate.result.crosstalk import target_regions
from warp_plate.result.model import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.peak import run_with_peak
from warp_plate.solve.run import Run
from warp_plate.solve.solver import PlateSolver

CaseValues = dict[str, dict[str, float]]


@dataclass(frozen=True)
class EvaluatedCases:
    """cases: by name, "equal", "single" and "best". scene, drives, run: of the best, or of all three where these differ
    in nothing but their drives; peak: see ``Result``; node_steps: of solvers beside the problem's."""

    cases: dict[str, Case]
    scene: Scene
    drives: dict[str, np.ndarray]
    run: Run
    peak: float
    node_steps: int


def evaluate_cases(problem: Problem, single: int, position: np.ndarray | None) -> EvaluatedCases:
    """Run the references at the scene's own frequency and places, and the best position, None: there is none.

    single: index of the best single actuator.
    """
    scene = problem.scene
    singles = magnitude_unit(scene) * np.eye(len(scene.actuators), dtype=complex)
    drives = {"equal": singles.sum(axis=0), "single": singles[single]}
    if problem.parametrization.only_drives or position is None:
        best = drives["single"] if position is None else problem.parametrization.designs(position[None]).drives[0]
        drives["best"] = best
        run, peak = run_with_peak(problem.drive_solver, np.array(list(drives.values())))
        return EvaluatedCases(cases_from_run(drives, run), scene, drives, run, peak, 0)
    run, _ = run_with_peak(problem.drive_solver, np.array(list(drives.values())))
    # The scene that was found, run as ``simulate`` runs it: what is written is what was judged.
    found, designs = problem.parametrization.scene_of(position), problem.parametrization.designs(position[None])
    solver = PlateSolver(found, problem.drive_solver.device.alias, problem.path, areas=target_regions(found))
    best = {"best": scene_phasors(found)}
    own, peak = run_with_peak(solver, best["best"][None])
    cases = cases_from_run(drives, run)
    frequency, centre, delay = (
        None if values is None else values[0] for values in (designs.frequency, designs.centre, designs.delay)
    )
    case = replace(cases_from_run(best, own)["best"], frequency=frequency, centre=centre, delay=delay)
    return EvaluatedCases({**cases, "best": case}, found, best, own, peak, solver.node_steps)


def reference_phasors(scene: Scene, energies: Energies) -> dict[str, np.ndarray]:
    """The drives that the search is compared with: all actuators alike, and the best single one."""
    singles = magnitude_unit(scene) * np.eye(len(scene.actuators), dtype=complex)
    best = int(np.argmax(np.nan_to_num(localization_factor(energies(singles)), nan=-1.0)))
    return {"equal": singles.sum(axis=0), "single": singles[best]}


def cases_from_run(drives: dict[str, np.ndarray], run: Run) -> dict[str, Case]:
    """The plates of a run by the names of their drives."""
    with np.errstate(over="ignore"):  # beyond float32's range a displacement becomes infinite
        displacement, trace = run.displacement.astype(np.float32), run.trace.astype(np.float32)
    return {
        name: Case(
            phasors=drive,
            energy=dict(zip(run.regions, run.energy[index].tolist(), strict=True)),
            displacement=displacement[index],
            trace=trace[index],
            status=run.fault(index),
        )
        for index, (name, drive) in enumerate(drives.items())
    }


def evaluate_objectives(scene: Scene, cases: Mapping[str, Case], device: str, path: str) -> tuple[CaseValues, int]:
    """For each case at the scene's own frequency and places, by its name: ``Objectives.worth`` of its drive; and
    node-steps.
    Their energies are those of a solver of ``summed_regions``.

    Nothing where the localization factor is all that is sought, which a case has, where each of several targets has
    objectives of its own, or where Ctrl-C came first.
    """
    try:
        judge = make_objectives(scene)
        if judge.only_localization or scene.targets:
            return {}, 0
        moved, node_steps = None, 0
        if judge.needs_displacement:
            solver = PlateSolver(scene, device, path, areas=summed_regions(scene, judge), quantity="displacement")
            run = solver.run(np.array([case.phasors for case in cases.values()]))
            moved, node_steps = run.energy, run.node_steps
    except (KeyboardInterrupt, SceneError):  # a result is not lost for want of what it is compared with
        return {}, 0
    worth = judge.values(np.array([list(case.energy.values()) for case in cases.values()]), moved)
    each = {name: {kind: float(values[index]) for kind, values in worth.items()} for index, name in enumerate(cases)}
    return each, node_steps
