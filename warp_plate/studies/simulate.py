"""Simulation of one plate under one drive."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.problem.evaluate_cases import cases_from_run, reference_phasors
from warp_plate.problem.parametrization import magnitude_unit
from warp_plate.result import load_result
from warp_plate.result.model import Result
from warp_plate.result.targets import target_regions
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.peak import run_with_peak
from warp_plate.solve.solver import PlateSolver, Progress
from warp_plate.studies.grid_choice import estimate_error, resolve_grid
from warp_plate.studies.provenance import device_name, versions


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
    """Run a scene under one drive and record what it asks for under ``[record]``.

    The grid of a scene with ``grid.accuracy`` is chosen first.

    Args:
        drive: "scene" (the magnitudes and phases of the scene's actuators), "equal", "single" (the best single
            actuator), or the name of a result file, whose best drive is taken.
        progress: called with (node-steps done, in all).
        estimate: whether to estimate the error of the localization factor.
        allow_unstable: see :class:`PlateSolver`.

    Raises:
        SceneError: see :class:`PlateSolver` and :func:`phasors_from_file`.
    """
    phasors = None
    if drive not in ("equal", "single"):
        phasors = scene_phasors(scene) if drive == "scene" else phasors_from_file(drive, scene)
    resolved = resolve_grid(scene, device, None if phasors is None else phasors[None])
    scene, accuracy = resolved.scene, dict(resolved.accuracy)
    solver = PlateSolver(scene, device, path, allow_unstable=allow_unstable, areas=target_regions(scene))
    started = time.perf_counter()
    if drive == "scene":
        phasors = scene_phasors(scene)
    elif drive == "equal":
        phasors = np.full(len(scene.actuators), magnitude_unit(scene), dtype=complex)
    elif phasors is None:
        phasors = reference_phasors(scene, lambda phasors: solver.run(phasors).energy)[drive]
    run, peak = run_with_peak(solver, phasors[None], progress)
    solved = time.perf_counter()
    seconds = {**resolved.seconds, "compile": solver.compile_seconds, "solve": solved - started}
    if estimate and run.finite.all():
        with suppress(KeyboardInterrupt, SceneError):  # the result is kept without an error estimate
            accuracy |= estimate_error(scene, {"drive": phasors}, run, seconds["solve"], device, resolved.reference)
            seconds["estimate"] = time.perf_counter() - solved
    return Result(
        command="simulate",
        source=source,
        scene=scene,
        device=device_name(solver.device),
        seed=scene.search.seed,
        effects=solver.effects,
        path=solver.describe_path(bool(scene.record.points)),
        cases=cases_from_run({"drive": phasors}, run),
        times=run.times,
        trace_times=run.trace_times,
        seconds=seconds,
        node_steps=solver.node_steps,
        versions=versions(),
        accuracy=accuracy,
        peak_displacement=peak,
    )


def phasors_from_file(name: str, scene: Scene) -> np.ndarray:
    """Return the phasors (actuators,) of the best drive in a result file, in the unit of the scene's drives."""
    if not name.endswith(".h5"):
        raise SceneError(f"--drive {name}: must be scene, equal, single or a result file (.h5)")
    result, unit = load_result(Path(name)), scene.drive_unit
    phasors = result.main_case.phasors
    if phasors.size != len(scene.actuators):
        raise SceneError(f"--drive {name}: holds {phasors.size} actuators, the scene has {len(scene.actuators)}")
    if result.scene.drive_unit != unit:
        raise SceneError(
            f"--drive {name}: holds magnitudes in {result.scene.drive_unit}, those of the scene are in {unit}; take a "
            "result of a scene with the same kind of drive, or the scene's own drive"
        )
    return phasors
