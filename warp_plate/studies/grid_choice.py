"""The engine and grid of a scene that asks for an accuracy, and the estimated error of a result."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice, product
from typing import Any, Literal

import numpy as np

from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.configurations import bending_wavelength, configuration_of, longest_time_step, scene_with
from warp_plate.accuracy.estimate import estimate, estimate_modal
from warp_plate.accuracy.more_functions import MoreFunctions
from warp_plate.modal.solver import MODAL, has_modes
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import at_highest_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import CELLS_A_WAVE, Grid
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import Plan
from warp_plate.solve.run import Run
from warp_plate.studies.kept_choices import kept

# Most corners of the ranges of a sweep that are looked at.
MOST_CORNERS = 64


@dataclass(frozen=True)
class ResolvedGrid:
    """A scene with a grid.

    Attributes:
        scene: the scene, with a grid in place of an accuracy.
        evaluator: "modal" if modes were chosen, else that asked for or that of time steps; None for the default.
        accuracy: the accuracy asked for, the expected error and the reason for the choice; empty if the scene has a
            grid.
        seconds: the time that the choice took, under "choose".
        reference: more functions that the choice compared modes with, if it was made just now.
    """

    scene: Scene
    evaluator: str | None = None
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    reference: MoreFunctions | None = None


def resolve_grid(
    scene: Scene,
    device: str,
    phasors: np.ndarray | None = None,
    engine: Literal["any", "modes", "steps"] = "steps",
) -> ResolvedGrid:
    """Choose the cheapest engine and grid within the scene's ``grid.accuracy``; a scene with a grid is returned
    unchanged.

    A choice is kept for the next command, see :mod:`warp_plate.studies.kept_choices`.

    Args:
        phasors: (drives, actuators) drives whose errors matter (default: those of ``choose``).
        engine: engine that may be chosen.
    """
    if scene.grid.accuracy is None:
        return ResolvedGrid(scene, accuracy=_by_waves(scene))
    if engine == "steps":
        scene.check_stepped()
    started, asked = time.perf_counter(), scene.grid.accuracy
    compared: list[MoreFunctions] = []

    def find() -> dict[str, Any]:
        choice = choose(scene, asked, device, phasors, engine)
        if isinstance(choice.reference, MoreFunctions):
            compared.append(choice.reference)
        grid = choice.scene.grid.model_dump(exclude={"accuracy"})
        accuracy = {"asked": asked, "expected": choice.error, "reason": choice.reason}
        return {"grid": grid, "accuracy": accuracy, "by_modes": choice.by_modes}

    known = kept(scene, device, phasors, engine, find)
    chosen = scene.model_copy(update={"grid": Grid(**known["grid"])})
    if not known["by_modes"]:
        chosen = scene_with(chosen, configuration_of(chosen))  # damping is centred too
    seconds = {"choose": time.perf_counter() - started}
    evaluator = MODAL if known["by_modes"] else None
    return ResolvedGrid(chosen, evaluator, known["accuracy"], seconds, compared[0] if compared else None)


def _by_waves(scene: Scene) -> dict[str, str]:
    """Return the reason for the grid of a scene that is not linear and has no ``[grid]``; empty for others."""
    if not scene.gridded_by_waves:
        return {}
    (nx, ny), table = scene.grid.nodes, scene.nonlinear_table
    reason = f"time steps: {nx} × {ny} nodes, {CELLS_A_WAVE:g} cells a bending wave; no error is known with {table}"
    return {"reason": reason}


def resolve_search_grid(scene: Scene, device: str, evaluator: str | None = None, path: str = "auto") -> ResolvedGrid:
    """Choose the engine and grid for a search by its highest frequency, which is the most demanding.

    An evaluator or a path that is named keeps its engine.
    """
    if scene.grid.accuracy is None:
        return ResolvedGrid(scene, evaluator, _by_waves(scene))
    engine: Literal["any", "modes", "steps"] = "steps"
    if evaluator == MODAL or scene.modal_only_key is not None:
        engine = "modes"
    elif evaluator is None and path == "auto" and has_modes(scene):
        engine = "any"
    resolved = resolve_grid(at_highest_frequency(scene), device, engine=engine)
    gridded = resolved.scene.model_copy(update={"actuators": scene.actuators})
    # The default evaluator of time steps; of robust searches it may be another.
    steps = "direct" if scene.search.robust is None else None
    return replace(resolved, scene=gridded, evaluator=resolved.evaluator or evaluator or steps)


def resolve_for_sweep(scene: Scene, plan: Plan, device: str, evaluator: str) -> Scene:
    """Choose the grid for all points of a sweep: at the corner of its ranges where bending waves are shortest.

    The scene is returned unchanged if the grid is varied, or if the accuracy cannot be reached at that corner; points
    then choose for themselves.
    """
    if scene.grid.accuracy is None or any(key.startswith("grid.") for key in plan.keys):
        return scene
    ends = [np.unique(values)[[0, -1]] if values.dtype.kind in "iuf" else np.unique(values)
            for values in plan.coordinates]  # fmt: skip
    corners = []
    for values in islice(product(*(end.tolist() for end in ends)), MOST_CORNERS):
        with suppress(SceneError):
            corners.append(at_highest_frequency(scene.with_values(dict(zip(plan.keys, values, strict=True)))))
    with suppress(SceneError, ValueError):  # refused, or without corners
        hardest = max(corners, key=lambda corner: math.sqrt(math.prod(corner.plate.size)) / bending_wavelength(corner))
        chosen = resolve_grid(hardest, device, engine="modes" if evaluator == MODAL else "steps").scene
        if evaluator == MODAL:
            return scene.model_copy(update={"grid": chosen.grid})
        grid = configuration_of(chosen)  # stable at all corners
        grid = replace(grid, time_step=min(longest_time_step(each, grid.order, grid.nodes) for each in corners))
        return scene_with(scene, grid)
    return scene


def estimate_error(
    scene: Scene,
    phasors: Mapping[str, np.ndarray],
    run: Run,
    device: str,
    reference: MoreFunctions | None = None,
    by_modes: bool = False,
) -> dict[str, Any]:
    """Estimate the errors of a run of the named drives; return them as entry "estimate" of ``Result.accuracy``."""
    drives, factors = np.array(list(phasors.values())), localization_factor(run.energy)
    try:
        if by_modes:
            found = estimate_modal(scene, drives, factors, run.times, run.displacement, reference)
        else:
            found = estimate(scene, drives, factors, device, run.times, run.displacement)
    except SceneError as error:
        return {"estimate": {"cases": list(phasors), "line": f"no error estimate: {error}"}}
    return {"estimate": {"cases": list(phasors), **found.as_json(), "line": found.line()}}
