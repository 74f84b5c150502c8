"""One plate under one drive, as a result."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.problem.evaluate_cases import cases_from_run, reference_phasors
from warp_plate.problem.parametrization import magnitude_unit
from warp_plate.result.crosstalk import target_regions
from warp_plate.result.model import Result
from warp_plate.result.store import load_result
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.peak import run_with_peak
from warp_plate.solve.solver import PlateSolver, Progress
from warp_plate.studies.localize import device_name, estimated, resolve, versions


def simulate(
    scene: Scene,
    source: str = "",
    drive: str = "scene",
    device: str = "auto",
    path: str = "auto",
    progress: Progress | None = None,
    estimate: bool = True,
    allow_unstable: bool = False,
) -> Result:
    """Run the scene under one drive and keep what it names under ``[record]``.

    Args:
        drive: "scene" (the magnitudes and phases of the scene's actuators), "equal", "single" (the best single
            actuator), or the name of a result file, whose best drive is taken.
        progress: called with (node-steps done, in all).
        estimate: whether to estimate the error of the localization factor at the end.
        allow_unstable: see :class:`PlateSolver`.

    A scene with ``grid.accuracy`` gets the grid that keeps it first.

    Raises:
        SceneError: see :class:`PlateSolver`; a drive that is none of these or that has other actuators.
    """
    file_drive = None if drive in ("scene", "equal", "single") else drive_of_file(drive, scene)
    named = scene_phasors(scene) if drive == "scene" else file_drive
    scene, accuracy, seconds, stage = resolve(scene, device, None if named is None else named[None])
    areas = target_regions(scene)
    solver = PlateSolver(scene, device, path, allow_unstable=allow_unstable, areas=areas)
    started = time.perf_counter()
    if file_drive is not None:
        phasors = file_drive
    elif drive == "scene":
        phasors = scene_phasors(scene)
    elif drive == "equal":
        phasors = np.full(len(scene.actuators), magnitude_unit(scene), dtype=complex)
    else:
        phasors = reference_phasors(scene, lambda drives: solver.run(drives).energy)[drive]
    run, peak = run_with_peak(solver, phasors[None], progress)
    seconds |= {"compile": solver.compile_seconds, "solve": time.perf_counter() - started}
    drives = {"drive": phasors}
    if estimate and run.finite.all():
        accuracy |= estimated(scene, drives, run, seconds, device, stage)
    return Result(
        command="simulate",
        source=source,
        scene=scene,
        device=device_name(solver.device),
        seed=scene.search.seed,
        effects=solver.effects,
        path=solver.describe_path(bool(scene.record.points)),
        cases=cases_from_run(drives, run),
        times=run.times,
        trace_times=run.trace_times,
        seconds=seconds,
        node_steps=solver.node_steps,
        versions=versions(),
        accuracy=accuracy,
        peak_displacement=peak,
    )


def drive_of_file(name: str, scene: Scene) -> np.ndarray:
    """(actuators,) the best drive of a result file, in the unit of the scene's drives.

    Raises:
        SceneError: not a drive's name or result file, or a result for another number of actuators or in another unit.
    """
    if not name.endswith(".h5"):
        raise SceneError(f"--drive {name}: is none of scene, equal, single and no result file (.h5)")
    result, actuators = load_result(Path(name)), len(scene.actuators)
    drive = result.main_case.phasors
    if drive.shape != (actuators,):
        raise SceneError(f"--drive {name}: holds {drive.size} actuators, the scene has {actuators}")
    if result.scene.drive_unit != scene.drive_unit:
        raise SceneError(
            f"--drive {name}: holds magnitudes in {result.scene.drive_unit}, those of the scene are in "
            f"{scene.drive_unit}; take a result of a scene that is driven alike, or the scene's own drive"
        )
    return drive
