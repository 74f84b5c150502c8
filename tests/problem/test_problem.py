"""A scene's search as one thing that methods ask: its space, its losses, and the bound where there is one."""

import numpy as np
import pytest
from conftest import scene_of

from warp_plate import PlateSolver, SceneError
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.parametrization import paper_phasors
from warp_plate.problem.problem import make_problem
from warp_plate.solve.response import measure_response

STRETCHING = {"effects": {"stretching": {}}}


def positions(problem, count=6):
    return np.random.default_rng(4).uniform(-2, 2, (count, problem.space.dimension))


@pytest.fixture(scope="module")
def problem():
    return make_problem(scene_of(nodes=(9, 9), window=(0.004, 0.006), precision="float32"), "cpu")


def test_losses_are_those_of_the_papers_reading_to_the_last_bit(problem):
    """1 − LF of the drives of ``objective.paper_phasors``."""
    asked = positions(problem)
    energy = PlateSolver(problem.scene, "cpu").run(paper_phasors(asked)).energy
    assert np.array_equal(problem.losses(asked), 1 - localization_factor(energy))
    assert problem.design_solver is problem.drive_solver


def test_the_bound_and_the_matrices_are_those_of_float64(problem):
    exact = scene_of(nodes=(9, 9), window=(0.004, 0.006))
    response = measure_response(PlateSolver(exact, "cpu"))
    assert problem.bound == response.bound()
    assert problem.bound >= (1 - problem.losses(positions(problem))).max() - 1e-6


def test_known_matrices_are_not_measured_again(problem):
    known = make_problem(problem.scene, "cpu", evaluator="response", matrices=problem.response.matrices)
    assert known.node_steps == 0
    asked = positions(problem)
    assert np.allclose(known.losses(asked), problem.losses(asked), atol=1e-5)
    assert known.node_steps == 0


def test_no_bound_is_claimed_where_none_is_proved():
    assert make_problem(scene_of(nodes=(9, 9), window=(0.004, 0.006), **STRETCHING), "cpu").bound is None


def test_the_response_is_refused_where_it_does_not_hold():
    with pytest.raises(SceneError, match=r"evaluator = 'response': effects.stretching is not linear"):
        make_problem(scene_of(nodes=(9, 9), **STRETCHING), "cpu", evaluator="response")
    searched = scene_of(nodes=(9, 9), search={"phase": {}, "position": {}})
    with pytest.raises(SceneError, match=r"evaluator = 'response': no Gram matrix holds where x, y is searched"):
        make_problem(searched, "cpu", evaluator="response")


def test_only_the_free_phases_are_searched():
    """Magnitudes stay the scene's; the bound over all drives is above what phases alone can reach."""
    problem = make_problem(scene_of(nodes=(9, 9), window=(0.004, 0.006), search={"phase": {}}), "cpu")
    assert problem.space.dimension == 2
    factors = 1 - problem.losses(np.random.default_rng(2).uniform(0, 6, (20, 2)))
    assert np.all(factors <= problem.bound)
