"""The problem of a scene: its space, its losses, and the bound where there is one."""

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate import PlateSolver, SceneError
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve
from warp_plate.solve.response import measure_response

SMALL = {"nodes": (9, 9), "window": (0.004, 0.006)}


def positions(problem, count=6):
    return np.random.default_rng(4).uniform(-2, 2, (count, problem.space.dimension))


@pytest.fixture(scope="module")
def problem():
    return make_problem(resolve(scene_of(**SMALL, precision="float32"), "cpu"))


def test_the_bound_and_the_matrices_are_those_of_float64(problem):
    """Matrices that are known are not measured again."""
    response = measure_response(PlateSolver(scene_of(**SMALL), "cpu"))
    np.testing.assert_array_equal(problem.plates.matrices, response.matrices)
    assert problem.bound == response.bound()
    asked = positions(problem)
    losses = problem.losses(asked)
    assert problem.bound >= (1 - losses).max() - 1e-6
    known = make_problem(resolve(problem.scene, "cpu", evaluator="response"), matrices=problem.plates.matrices)
    assert np.allclose(known.losses(asked), losses, atol=1e-5)
    assert known.node_steps == 0
    with pytest.raises(SceneError, match=r"^matrices: of 1 regions; must be 2"):
        make_problem(resolve(problem.scene, "cpu"), matrices=problem.plates.matrices[:1])


def test_kinds_of_bounds(problem):
    """Limits of drives lower the bound; places and frequencies have none."""
    limited = make_problem(
        resolve(scene_of(**SMALL, search={"limits": {"equal_magnitudes": True}, "phase": {}}), "cpu")
    )
    assert limited.bound == 1 - limited.loss_bound.value < limited.response.bound()
    searched = make_problem(resolve(scene_of(**SMALL, search={"frequency": {"range": (200.0, 400.0)}}), "cpu"))
    assert searched.bound is None
    kinds = [made.bound_kind for made in (problem, limited, searched)]
    assert kinds == ["attained", "attained within limits", ""]
    assert problem.objective_values(positions(problem)[0]) == {}


def test_the_response_is_refused_where_it_does_not_hold():
    stretching = scene_of(**SMALL, effects={"stretching": {}})
    with pytest.raises(SceneError, match=r"evaluator = 'response': effects.stretching is not linear"):
        make_problem(resolve(stretching, "cpu", evaluator="response"))
    searched = scene_of(**SMALL, search={"phase": {}, "position": {}})
    with pytest.raises(SceneError, match=r"evaluator = 'response': no Gram matrix holds where x, y is searched"):
        make_problem(resolve(searched, "cpu", evaluator="response"))
