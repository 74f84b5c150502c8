"""The method for cone programs with full matrices, against Clarabel, and in programs of many actuators."""

import clarabel
import numpy as np
import pytest
import scipy

from warp_plate.optimize.cones import LARGE, Block, least_scale
from warp_plate.optimize.second_order import solve_cones

RNG = np.random.default_rng(11)


def random_rows(*shape):
    return RNG.normal(size=shape) + 1j * RNG.normal(size=shape)


def solve_by_clarabel(cost, matrix, limits, cones):
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    kinds = [
        kind
        for count, size in cones
        for kind in ([clarabel.NonnegativeConeT(count)] if size == 1 else [clarabel.SecondOrderConeT(size)] * count)
    ]
    sparse = scipy.sparse.csc_matrix
    empty = sparse((len(cost), len(cost)))
    return clarabel.DefaultSolver(empty, cost, sparse(matrix), limits, kinds, settings).solve()


@pytest.mark.parametrize("unknowns", [3, 12, 40])
def test_the_solution_is_that_of_a_conic_solver(unknowns):
    """The limits have an interior, and so have the multipliers, so that there is a solution."""
    cones = [(unknowns, 1), (2 * unknowns, 3), (2, 7)]
    rows = sum(count * size for count, size in cones)
    matrix = RNG.normal(size=(rows, unknowns))
    inside = np.concatenate([np.tile(np.append(2.0 * size, np.ones(size - 1)), count) for count, size in cones])
    limits, cost = matrix @ RNG.normal(size=unknowns) + inside, -matrix.T @ inside
    x, multipliers = solve_cones(cost, matrix, limits, cones)
    assert cost @ x == pytest.approx(solve_by_clarabel(cost, matrix, limits, cones).obj_val, rel=1e-7)
    assert -limits @ multipliers == pytest.approx(cost @ x, rel=1e-7)
    assert np.abs(cost + matrix.T @ multipliers).max() < 1e-7 * np.abs(cost).max()


def test_programs_without_a_solution_have_none():
    """x ≥ 1 and |(x, y)| ≤ 1/2 exclude each other."""
    matrix = np.array([[-1.0, 0.0], [0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]])
    assert solve_cones(np.array([1.0, 0.0]), matrix, np.array([-1.0, 0.5, 0.0, 0.0]), [(1, 1), (1, 3)]) is None


def test_programs_of_many_actuators_are_proved():
    inputs = LARGE
    wanted, rest = random_rows(4, inputs), random_rows(300, 1, inputs)
    result = least_scale(wanted, [Block(rest, True)])
    assert (wanted @ result.drive).real.min() > 1 - 1e-7
    assert np.abs(result.drive).max() < 1 + 1e-7
    assert np.abs(rest[:, 0] @ result.drive).max() == pytest.approx(result.scale, rel=1e-6)
    assert result.bound == pytest.approx(result.scale, rel=1e-5)
