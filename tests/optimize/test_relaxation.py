"""The relaxation of programs that are not convex, against Clarabel on real matrices, and its proof."""

import math

import clarabel
import numpy as np
import pytest
import scipy

from warp_plate.optimize.relaxation import best_multipliers, make_forms

RNG = np.random.default_rng(8)


def random_rows(*shape):
    return RNG.normal(size=shape) + 1j * RNG.normal(size=shape)


def bound_by_clarabel(wanted, squares, limits):
    """Return the least σ, with the real and imaginary parts of z and 1 in a matrix of one more row than both."""
    size = 2 * wanted.shape[1] + 1
    rows, columns = np.triu_indices(size)
    order = np.lexsort((rows, columns))
    rows, columns = rows[order], columns[order]
    weights = np.where(rows == columns, 1.0, math.sqrt(2))

    def real(factor):
        parts = np.block([[factor.real, -factor.imag], [factor.imag, factor.real]])
        return np.pad(parts.T @ parts, (0, 1))

    def linear(row):
        form = np.zeros((size, size))
        form[-1, :-1] = form[:-1, -1] = np.concatenate([row.real, -row.imag]) / 2
        return form

    one = np.zeros((size, size))
    one[-1, -1] = 1.0
    least, most = [*map(linear, wanted), *map(real, squares)], [*(real(rows) for rows, _ in limits), one]
    scaled = np.array([*(scaled for _, scaled in limits), False], dtype=float)
    forms = np.array([form[rows, columns] * weights for form in [*(-form for form in least), *most]])
    matrix = np.hstack([forms, -np.concatenate([np.zeros(len(least)), scaled])[:, None]])
    cone = np.hstack([-np.eye(len(rows)), np.zeros((len(rows), 1))])
    entries = np.concatenate([-np.ones(len(least)), 1 - scaled, np.zeros(len(rows))])
    cost = np.append(np.zeros(len(rows)), 1.0)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.NonnegativeConeT(len(forms)), clarabel.PSDTriangleConeT(size)]
    square = scipy.sparse.csc_matrix((len(cost), len(cost)))
    stacked = scipy.sparse.csc_matrix(np.vstack([matrix, cone]))
    return clarabel.DefaultSolver(square, cost, stacked, entries, cones, settings).solve().x[-1]


@pytest.mark.parametrize("linear", [0, 2])
@pytest.mark.parametrize("squares", [1, 3])
def test_the_bound_is_that_of_a_conic_solver_and_proved(linear, squares):
    for inputs in (2, 4):
        wanted = 4 * random_rows(linear, inputs)
        factors = [4 * random_rows(1 + k, inputs) for k in range(squares)]
        limits = [(row[None], False) for row in np.eye(inputs, dtype=complex)]
        limits += [(rows, True) for rows in random_rows(6, 2, inputs)]
        forms = make_forms(wanted, factors, limits)
        multipliers, relaxed = best_multipliers(forms)
        bound = forms.gains @ multipliers
        assert bound == pytest.approx(bound_by_clarabel(wanted, factors, limits), rel=1e-6)
        assert multipliers.min() >= 0
        assert multipliers[forms.scaled].sum() == pytest.approx(1, rel=1e-12)
        assert np.linalg.eigvalsh(forms.slack(multipliers))[0] > -1e-9 * bound
        assert np.linalg.eigvalsh(relaxed)[0] > -1e-12
        for row in wanted:
            assert (row @ relaxed[:-1, -1]).real > 1 - 1e-6
        for factor in factors:
            assert np.trace(factor @ relaxed[:-1, :-1] @ factor.conj().T).real > 1 - 1e-6


def test_requirements_that_exclude_each_other_have_a_bound_above_all_limits():
    limits = [(np.eye(2, dtype=complex)[:1], False), (np.eye(2, dtype=complex)[1:], False), (random_rows(1, 2), True)]
    forms = make_forms(np.empty((0, 2)), [np.full((1, 2), 0.1 + 0j)], limits)
    assert forms.gains @ best_multipliers(forms)[0] > 1e6
