"""The accuracy asked for, kept at the places and frequencies that a search by modes found.

The modes of a search are chosen at the places where it begins. Where they are too few for those found, more are chosen
there, and a descent from the answer finds the best drive by them.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.configurations import percent
from warp_plate.problem.evaluate_cases import EvaluatedCases
from warp_plate.problem.problem import Problem, make_problem
from warp_plate.result.model import TargetSearch
from warp_plate.scene.errors import SceneError
from warp_plate.studies.searches import SearchOutcome, polish, with_further_evaluations


def accuracy_may_change(outcome: SearchOutcome) -> bool:
    """Return whether a search for an accuracy moved what its modes were chosen for."""
    problem, moved = outcome.problem, not outcome.problem.parametrization.only_drives
    return "asked" in outcome.checkpoint.accuracy and problem.resolved.by_modes and moved and not outcome.interrupted


def search_by_more_functions(outcome: SearchOutcome, evaluated: EvaluatedCases, error: float) -> SearchOutcome:
    """Return the outcome by as many functions as keep the accuracy asked for at the first target's places, or as many
    as there may be; unchanged where no more may be taken, or in a robust search. ``error`` is that of the outcome."""
    end, problem = outcome.checkpoint, outcome.problem
    asked = end.accuracy["asked"]
    if not error > asked or problem.scenario_losses is not None:
        return outcome
    best = evaluated.phasors["best"][None]
    with suppress(SceneError):  # the functions would be too many
        choice = choose(evaluated.scene, asked, end.device, best, "modes", required=False)
        if choice.scene.grid.modal_density > problem.scene.grid.modal_density:
            grid = problem.scene.grid.model_copy(update={"modal_density": choice.scene.grid.modal_density})
            reason = f"{choice.reason}, at the places or frequency found, where fewer had {percent(error)}"
            return _with_grid(outcome, {"grid": grid}, {**end.accuracy, "expected": choice.error, "reason": reason})
    return outcome


def _with_grid(outcome: SearchOutcome, update: Mapping[str, Any], accuracy: Mapping[str, Any]) -> SearchOutcome:
    """Return an outcome continued by other functions, and with an ``accuracy`` that says so."""
    end, problem, searches, problems = outcome.checkpoint, outcome.problem, list[TargetSearch](), list[Problem]()
    resolved = problem.resolved.with_scene(problem.scene.model_copy(update=update))
    for index, search in enumerate(end.finished_searches):
        scene = resolved.scene.aimed_at(index) if resolved.scene.targets else resolved.scene
        finer = make_problem(resolved.with_scene(scene), pool=problem.pool)
        searches.append(search if search.position is None else _descended(finer, search))
        problems.append(finer)
    checkpoint = replace(end, scene=problems[0].scene, finished_searches=tuple(searches), accuracy=accuracy)
    return replace(outcome, checkpoint=checkpoint, problem=problems[0])


def _descended(problem: Problem, search: TargetSearch) -> TargetSearch:
    """Return a finished search, continued by a descent in another problem with the same design variables."""
    assert search.position is not None
    start = problem.searched.positions_of(problem.parametrization.designs(search.position[None]))[0]
    start = problem.with_best_drive(start)
    position, loss, evaluations = polish(problem, start, float(problem.losses(start[None])[0]), rounds=1)
    position = problem.complete(position)
    return replace(
        search,
        position=position,
        evaluations=search.evaluations + evaluations,
        history=with_further_evaluations(problem, search.history, evaluations, loss),
        objective_values=problem.objective_values(position),
    )
