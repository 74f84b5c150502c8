"""Searches in which each position has its best drive: against eigenvalues, random drives and patches drawn by hand."""

from itertools import combinations

import numpy as np
import pytest
import scipy

from support.scenes import areas_of, scene_of
from warp_plate import SceneError, localize
from warp_plate.modal.solver import ModalSolver
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve

DRIVES = {"magnitude": {"range": [0.0, 2.0]}, "phase": {}}
FREQUENCY = {"frequency": {"range": [100.0, 300.0]}}
SEARCHES = {
    "places": {**DRIVES, "position": {"actuators": ["0", "2"]}},
    "frequency and places": {**DRIVES, **FREQUENCY, "position": {}},
    "own frequencies": {**DRIVES, "frequency": {"range": [100.0, 300.0], "own": True}},
    "contrast": {**DRIVES, **FREQUENCY, "objectives": [{"kind": "contrast", "weight": 0.5}]},
}


def projected_search(search, nodes=(9, 9), **tables):
    tables = {"damping": 60.0, "window": (0.03, 0.05)} | tables
    return scene_of(nodes=nodes, search={"particles": 6, "iterations": 4, "method": "constriction", **search}, **tables)


@pytest.mark.parametrize("name", SEARCHES)
def test_the_loss_of_a_position_is_that_of_its_best_drive(name, random):
    problem = make_problem(resolve(projected_search(SEARCHES[name]), "cpu"))
    assert problem.evaluator_name == "modal"
    assert not any("magnitude" in each or "phase" in each for each in problem.space.names)
    positions = problem.space.from_unit(random.random((30, problem.space.dimension)))
    losses = problem.losses(positions)
    apart = np.flatnonzero(losses == problem.losses_without_clearance(positions))[:3]
    assert apart.size == 3
    for position, loss in zip(positions[apart], losses[apart], strict=True):
        full = problem.complete(position)
        designs = problem.parametrization.designs(full[None])
        assert problem.design_losses(designs)[0] == pytest.approx(loss, abs=1e-7)
        assert np.abs(designs.drives).max() == pytest.approx(2.0)
        plate, target = response_at(problem, full)
        ratio = scipy.linalg.eigh(target, plate, eigvals_only=True)[-1]
        assert loss == pytest.approx(
            1 - ratio if name != "contrast" else -5 * np.log10(ratio / (1 - ratio) * 3), abs=1e-6
        )


def test_losses_do_not_depend_on_how_many_positions_are_in_memory(random, monkeypatch):
    problem = make_problem(resolve(projected_search(SEARCHES["frequency and places"]), "cpu"))
    positions = problem.space.from_unit(random.random((7, problem.space.dimension)))
    losses = problem.losses(positions)
    monkeypatch.setattr("warp_plate.problem.problem.DESIGN_NUMBERS", 1)
    np.testing.assert_allclose(problem.losses(positions), losses, rtol=1e-9)
    assert problem.losses(positions[:0]).shape == (0,)


def response_at(problem, position):
    return ModalSolver(problem.parametrization.scene_of(position)).response.matrices


def overlapping(areas, clearance):
    """Return whether two rectangles of areas (actuators, 2, 2) have less room than the clearance on both axes."""
    return any(
        all(max(one[axis][0], other[axis][0]) < min(one[axis][1], other[axis][1]) + clearance - 1e-8 for axis in (0, 1))
        for one, other in combinations(areas, 2)
    )


@pytest.mark.parametrize(
    ("clearance", "evaluator"),
    [
        (0.02, "modal"),
        (0.0, "direct"),
        *(pytest.param(*pair, marks=pytest.mark.slow) for pair in [(0.0, "modal"), (0.02, "direct")]),
    ],
)
def test_patches_keep_their_clearance(clearance, evaluator, random):
    area = [0.0, 0.12, 0.0, 0.12]
    scene = projected_search(
        {"phase": {}, "position": {"area": area, "clearance": clearance}, "particles": 12, "iterations": 2},
        actuators=[(0.0, 0.04, 0.0, 0.04), (0.06, 0.1, 0.06, 0.1), (0.07, 0.1, 0.01, 0.05)],
    )
    problem = make_problem(resolve(scene, "cpu", evaluator=evaluator))
    positions = problem.space.from_unit(random.random((20, problem.space.dimension)))
    near = problem.losses(positions) > 2
    scenes = [problem.parametrization.scene_of(position) for position in positions]
    assert near.tolist() == [overlapping(areas_of(found), clearance) for found in scenes]
    result = localize(scene, device="cpu", evaluator=evaluator, estimate=False)
    assert not overlapping(areas_of(result.driven_scene(result.cases["best"])), clearance)


def test_a_clearance_without_room_is_refused():
    with pytest.raises(SceneError, match=r"^search.position.clearance = 0.1: no places were found"):
        localize(projected_search({"phase": {}, "position": {"clearance": 0.1}}), device="cpu", estimate=False)


GRADIENTS = {
    "projected": {**DRIVES, **FREQUENCY, "position": {}},
    "frequencies and phases": {"phase": {}, "frequency": {"range": [100.0, 300.0], "own": True}},
    "two objectives": {
        **DRIVES,
        "position": {"actuators": ["1"]},
        "objectives": [{"kind": "localization"}, {"kind": "displacement", "weight": 1e4}],
    },
}


@pytest.mark.parametrize("name", GRADIENTS)
def test_slopes_are_those_of_differences(name, random):
    problem = make_problem(resolve(projected_search(GRADIENTS[name]), "cpu", evaluator="modal"))
    space, steps = problem.space, 1e-4 * np.diag(problem.space.span)
    positions = space.from_unit(random.uniform(0.05, 0.95, (12, space.dimension)))
    position = positions[np.argmin(problem.losses(positions))]
    losses, slopes = problem.slopes(position[None], space)
    assert losses[0] == pytest.approx(problem.losses(position[None])[0], abs=1e-6)
    differences = (problem.losses(position + steps) - problem.losses(position - steps)) / (2 * np.diag(steps))
    np.testing.assert_allclose(slopes[0] * space.span, differences * space.span, rtol=1e-3, atol=1e-5)


@pytest.mark.slow
def test_descents_push_patches_apart_and_end_in_a_minimum():
    search = {**DRIVES, **FREQUENCY, "position": {"clearance": 0.01}, "method": "gradient", "iterations": 30}
    result = localize(projected_search(search), device="cpu", estimate=False)
    assert not overlapping(areas_of(result.driven_scene(result.cases["best"])), 0.01)
    assert result.cases["best"].localization_factor > result.history["best"][0] + 0.05
