"""The grid of a scene that asks for an accuracy, and the estimated error of a result."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.estimate import estimate
from warp_plate.accuracy.reference_solution import ReferenceSolution
from warp_plate.modal.solver import MODAL
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import at_highest_frequency
from warp_plate.scene.model import Grid, Scene
from warp_plate.solve.run import Run


@dataclass(frozen=True)
class ResolvedGrid:
    """A scene with a grid.

    Attributes:
        scene: the scene, with a grid in place of an accuracy.
        accuracy: the accuracy asked for, the expected error and the reason for the grid; empty if the scene has a grid.
        seconds: the time that the choice took, under "choose".
        reference: reference solution that the choice computed.
    """

    scene: Scene
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    reference: ReferenceSolution | None = None


def resolve_grid(scene: Scene, device: str, phasors: np.ndarray | None = None) -> ResolvedGrid:
    """Choose the cheapest grid that keeps the scene's ``grid.accuracy``; a scene with a grid is returned as it is.

    Args:
        phasors: (drives, actuators) drives whose errors count (default: those that ``choose`` takes).
    """
    if scene.grid.accuracy is None:
        return ResolvedGrid(scene)
    started = time.perf_counter()
    choice = choose(scene, scene.grid.accuracy, device, phasors)
    accuracy = {"asked": scene.grid.accuracy, "expected": choice.error, "reason": choice.reason}
    return ResolvedGrid(choice.scene, accuracy, {"choose": time.perf_counter() - started}, choice.reference)


def resolve_search_grid(scene: Scene, device: str, evaluator: str | None = None) -> ResolvedGrid:
    """Choose the grid for a search by its highest frequency, which is the most demanding.

    The evaluator "modal" needs a grid for pictures alone, which is the default one.
    """
    if evaluator == MODAL or scene.modal_only_key is not None:
        return ResolvedGrid(scene.model_copy(update={"grid": Grid()}) if scene.grid.accuracy is not None else scene)
    resolved = resolve_grid(at_highest_frequency(scene), device)
    return replace(resolved, scene=resolved.scene.model_copy(update={"actuators": scene.actuators}))


def estimate_error(
    scene: Scene,
    phasors: Mapping[str, np.ndarray],
    run: Run,
    solve_seconds: float,
    device: str,
    reference: ReferenceSolution | None = None,
) -> dict[str, Any]:
    """Estimate the errors of a run of the named drives; return them as entry "estimate" of ``Result.accuracy``.

    The time for the estimate is limited by ``solve_seconds``, which the result took.
    """
    drives, factors = np.array(list(phasors.values())), localization_factor(run.energy)
    found = estimate(scene, drives, factors, solve_seconds, device, run.times, run.displacement, reference)
    return {"estimate": {"cases": list(phasors), **found.as_json(), "line": found.line()}}
