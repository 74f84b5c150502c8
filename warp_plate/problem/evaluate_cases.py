"""The drives that a result is about, each run once more for its pictures: two references, and the best one found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.objective import unit_of_drives
from warp_plate.problem.problem import Energies, Problem
from warp_plate.result.crosstalk import regions_of_targets
from warp_plate.result.model import Case
from warp_plate.scene.model import Scene
from warp_plate.solve.peak import run_and_look
from warp_plate.solve.run import Run
from warp_plate.solve.solver import PlateSolver


@dataclass(frozen=True)
class LastRuns:
    """cases: by name, "equal", "single" and "best". scene, drives, run: of the best, or of all three where these differ
    in nothing but their drives; peak: see ``Result``; node_steps: of solvers beside the problem's."""

    cases: dict[str, Case]
    scene: Scene
    drives: dict[str, np.ndarray]
    run: Run
    peak: float
    node_steps: int


def last_runs(problem: Problem, single: int, position: np.ndarray | None) -> LastRuns:
    """Run the references at the scene's own frequency and places, and the best position, None: there is none.

    single: index of the best single actuator.
    """
    scene = problem.scene
    singles = unit_of_drives(scene) * np.eye(len(scene.actuators), dtype=complex)
    drives = {"equal": singles.sum(axis=0), "single": singles[single]}
    if problem.variables.only_drives or position is None:
        best = drives["single"] if position is None else problem.variables.designs(position[None]).drives[0]
        drives["best"] = best
        run, peak = run_and_look(problem.plain, np.array(list(drives.values())))
        return LastRuns(cases_of(drives, run), scene, drives, run, peak, 0)
    run, _ = run_and_look(problem.plain, np.array(list(drives.values())))
    # The scene that was found, run as ``simulate`` runs it: what is written is what was judged.
    found, designs = problem.variables.scene_of(position), problem.variables.designs(position[None])
    solver = PlateSolver(found, problem.plain.device.alias, problem.path, areas=regions_of_targets(found))
    best = {"best": scene_phasors(found)}
    own, peak = run_and_look(solver, best["best"][None])
    cases = cases_of(drives, run)
    frequency, centre, delay = (
        None if values is None else values[0] for values in (designs.frequency, designs.centre, designs.delay)
    )
    case = replace(cases_of(best, own)["best"], frequency=frequency, centre=centre, delay=delay)
    return LastRuns({**cases, "best": case}, found, best, own, peak, solver.node_steps)


def reference_drives(scene: Scene, energies: Energies) -> dict[str, np.ndarray]:
    """The drives that the search is compared with: all actuators alike, and the best single one."""
    singles = unit_of_drives(scene) * np.eye(len(scene.actuators), dtype=complex)
    best = int(np.argmax(np.nan_to_num(localization_factor(energies(singles)), nan=-1.0)))
    return {"equal": singles.sum(axis=0), "single": singles[best]}


def cases_of(drives: dict[str, np.ndarray], run: Run) -> dict[str, Case]:
    """The plates of a run by the names of their drives."""
    with np.errstate(over="ignore"):  # beyond float32's range a displacement becomes infinite
        displacement, trace = run.displacement.astype(np.float32), run.trace.astype(np.float32)
    return {
        name: Case(
            drive=drive,
            energy=dict(zip(run.regions, run.energy[index].tolist(), strict=True)),
            displacement=displacement[index],
            trace=trace[index],
            status=run.fault(index),
        )
        for index, (name, drive) in enumerate(drives.items())
    }
