"""Simulation of one plate under one drive, and the estimated error of a result."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.accuracy.estimate import estimate, estimate_modal
from warp_plate.analysis.result_warnings import result_warnings
from warp_plate.modal.solver import MODAL
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import magnitude_unit, single_drives
from warp_plate.problem.evaluate_cases import cases_from_run, reference_phasors
from warp_plate.resolve import Resolved, resolve
from warp_plate.result.model import Result, load_result
from warp_plate.scene.errors import SceneError, check_function, check_type
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.solve.response import Response
from warp_plate.solve.run import Progress, Run, run_with_peaks
from warp_plate.studies.unfinished import device_name, run_fields, versions


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
    warnings: bool = True,
) -> Result:
    """Run a scene under one drive with the engine for its ``grid.accuracy``, and record the outputs of ``[record]``.

    Args:
        path: see :class:`PlateSolver`, or "modal" for the modes of a linear scene, without grid error; "auto" uses
            modes for scenes with damping that only they support, and if they keep ``grid.accuracy``.
        drive: "scene" (the magnitudes and phases of its actuators), "equal", "single" (the best single actuator), or
            the name of a result file, whose best drive is taken.
        progress: called with (node-steps done, in all).
        estimate, allow_unstable: see ``localize`` and :class:`PlateSolver`.
        warnings: whether to look for warnings, which may need the plate's first mode.

    Raises:
        SceneError: see :class:`PlateSolver` and :func:`phasors_from_file`.
    """
    scene = Scene.load(scene)
    for key, value in {"source": source, "drive": drive, "path": path}.items():
        check_type(key, value, str)
    for key, flag in {"estimate": estimate, "allow_unstable": allow_unstable, "warnings": warnings}.items():
        check_type(key, flag, bool)
    check_function("progress", progress)
    phasors = _phasors(scene, drive)
    drives = None if phasors is None else phasors[None]
    resolved = resolve(scene, device, purpose="simulate", path=path, phasors=drives, allow_unstable=allow_unstable)
    scene = resolved.scene
    solver = resolved.solver(areas=scene.target_regions)
    started, compiled = time.perf_counter(), solver.compile_seconds
    if phasors is None:
        phasors = reference_phasors(single_drives(scene), lambda phasors: solver.run(phasors).energy)["single"]
    run, peaks = run_with_peaks(solver, phasors[None], progress)
    solved = time.perf_counter() - started - (solver.compile_seconds - compiled)
    seconds = {**resolved.seconds, "compile": solver.compile_seconds, "solve": solved}
    accuracy = dict(resolved.accuracy)
    if estimate and run.finite.all():
        with optional_part(seconds, "estimate"):
            accuracy |= estimate_error(resolved, {"drive": phasors}, run)
    result = Result(
        command="simulate",
        source=source,
        scene=scene,
        device=device_name(solver.device),
        seed=scene.search.seed,
        cases=cases_from_run({"drive": phasors}, run, solver.discretization, peaks),
        seconds=seconds,
        node_steps=solver.node_steps,
        versions=versions(),
        accuracy=accuracy,
        peak_displacement=float(peaks[0].max()),
        evaluator=MODAL if resolved.by_modes else "direct",
        **run_fields(solver, run),
    )
    return replace(result, warnings=result_warnings(result)) if warnings else result


def _phasors(scene: Scene, drive: str) -> np.ndarray | None:
    """Return the phasors (actuators,) of a drive; None for the best single actuator, which simulation shows."""
    if drive == "single":
        return None
    if drive == "equal":
        return np.full(len(scene.actuators), magnitude_unit(scene), dtype=complex)
    return scene_phasors(scene) if drive == "scene" else phasors_from_file(drive, scene)


@contextmanager
def optional_part(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Add the seconds of a part of a result, which is left out if it is refused or if Ctrl-C interrupts it."""
    started = time.perf_counter()
    with suppress(KeyboardInterrupt, SceneError):
        yield
        seconds[name] = time.perf_counter() - started


def phasors_from_file(name: str, scene: Scene) -> np.ndarray:
    """Return the phasors (actuators,) of the best drive in a result file, in the unit of the scene's drives."""
    if not name.endswith(".h5"):
        raise SceneError(
            f"--drive {name}: must be scene, equal, single or a result file (.h5); a .toml file is a scene of its own"
        )
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


def estimate_error(
    resolved: Resolved,
    phasors: Mapping[str, np.ndarray],
    run: Run,
    bound: float | None = None,
    bound_by: Callable[[Response], float | None] = lambda response: None,
) -> dict[str, Any]:
    """Estimate the errors of a run of the named drives, and of a bound, which is a function of Gram matrices; return
    them as entry "estimate" of ``Result.accuracy``."""
    scene, drives, factors = resolved.scene, np.array(list(phasors.values())), localization_factor(run.energy)
    try:
        if resolved.by_modes:
            result = estimate_modal(scene, drives, run, resolved.reference)
        else:
            of_run = resolved.device, run.times, run.displacement
            result = estimate(scene, drives, factors, *of_run, time_step=resolved.grid.time_step)
    except SceneError as error:
        return {"estimate": {"cases": list(phasors), "line": f"no error estimate: {error}"}}
    fields = {"cases": list(phasors), **result.as_json(), "line": result.line()}
    of_bound = None if bound is None else result.of_bound(bound, bound_by)
    if of_bound is not None:
        (interval,) = of_bound.intervals.tolist()
        fields["bound"] = {"error": of_bound.error, "interval": interval, "line": of_bound.line(quantity="bound")}
    return {"estimate": fields}
