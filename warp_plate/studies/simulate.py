"""Simulation of one plate under one drive."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.modal.solver import MODAL, ModalSolver
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.problem.design_variables import magnitude_unit
from warp_plate.problem.evaluate_cases import cases_from_run, reference_phasors
from warp_plate.result.model import Result, load_result
from warp_plate.result.targets import target_regions
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.solve.run import Progress, Run, run_with_peaks
from warp_plate.solve.solver import PlateSolver
from warp_plate.studies.grid_choice import ResolvedGrid, estimate_error, resolve_grid
from warp_plate.studies.provenance import device_name, run_fields, versions


def simulate(
    scene: SceneSource,
    *,
    source: str = "",
    drive: str = "scene",
    device: str = "auto",
    path: str = "auto",
    progress: Progress | None = None,
    estimate: bool = True,
    allow_unstable: bool = False,
) -> Result:
    """Run a scene under one drive with the engine for its ``grid.accuracy``, and record the outputs of ``[record]``.

    Args:
        path: see :class:`PlateSolver`, or "modal" for the modes of a linear scene, without grid error; "auto" uses
            modes for scenes with damping that only they support, and if they keep ``grid.accuracy``.
        drive: "scene" (the magnitudes and phases of its actuators), "equal", "single" (the best single actuator), or
            the name of a result file, whose best drive is taken.
        progress: called with (node-steps done, in all).
        estimate, allow_unstable: see ``localize`` and :class:`PlateSolver`.

    Raises:
        SceneError: see :class:`PlateSolver` and :func:`phasors_from_file`.
    """
    scene = Scene.load(scene)
    resolved, phasors = _resolve(scene, drive, device, path)
    scene, by_modes = resolved.scene, resolved.evaluator == MODAL
    solver: PlateSolver | ModalSolver
    if by_modes:
        solver = ModalSolver(scene, device, areas=target_regions(scene))
    else:
        solver = PlateSolver(scene, device, path, allow_unstable=allow_unstable, areas=target_regions(scene))
    started = time.perf_counter()
    if phasors is None:
        phasors = reference_phasors(scene, lambda phasors: solver.run(phasors).energy)["single"]
    run, peaks = run_with_peaks(solver, phasors[None], progress)
    solved = time.perf_counter() - started
    seconds = {**resolved.seconds, "compile": solver.compile_seconds, "solve": solved}
    estimate = estimate and bool(run.finite.all())
    estimated = _estimate(resolved, phasors, run, seconds, device) if estimate else {}
    return Result(
        command="simulate",
        source=source,
        scene=scene,
        device=device_name(solver.device),
        seed=scene.search.seed,
        cases=cases_from_run({"drive": phasors}, run, scene, peaks),
        seconds=seconds,
        node_steps=solver.node_steps,
        versions=versions(),
        accuracy={**resolved.accuracy, **estimated},
        peak_displacement=float(peaks[0].max()),
        evaluator=MODAL if by_modes else "direct",
        **run_fields(solver, run),
    )


def _resolve(scene: Scene, drive: str, device: str, path: str) -> tuple[ResolvedGrid, np.ndarray | None]:
    """Return the scene with an engine and a grid, and the phasors of a drive, None if they are to be found by
    simulation."""
    phasors: np.ndarray | None = None
    if drive == "equal":
        phasors = np.full(len(scene.actuators), magnitude_unit(scene), dtype=complex)
    elif drive != "single":
        phasors = scene_phasors(scene) if drive == "scene" else phasors_from_file(drive, scene)
    drives = None if phasors is None else phasors[None]
    if path == MODAL or (path == "auto" and scene.modal_only_key is not None):
        return replace(resolve_grid(scene, device, drives, "modes"), evaluator=MODAL), phasors
    return resolve_grid(scene, device, drives, "any" if path == "auto" else "steps"), phasors


def _estimate(
    resolved: ResolvedGrid, phasors: np.ndarray, run: Run, seconds: dict[str, float], device: str
) -> dict[str, Any]:
    """Return the estimated error and add its seconds; empty if it is interrupted, as a result is kept."""
    started = time.perf_counter()
    with suppress(KeyboardInterrupt):
        drives = {"drive": phasors}
        by_modes = resolved.evaluator == MODAL
        found = estimate_error(resolved.scene, drives, run, device, resolved.reference, by_modes)
        seconds["estimate"] = time.perf_counter() - started
        return found
    return {}


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
