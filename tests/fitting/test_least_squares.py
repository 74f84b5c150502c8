"""Intervals of linear problems: correlated errors, unknowns at a limit, and unknowns that the data hardly determine."""

import numpy as np
import pytest

from warp_plate.fitting.least_squares import Differenced, correlated_products, fit_least_squares

COUNT, TRUTH = 400, np.array([0.4, 0.6])
COLUMNS = np.stack([np.ones(COUNT), np.linspace(-1, 1, COUNT)], axis=1)


class Against:
    """Residuals of predictions against data."""

    def __init__(self, data):
        self.data = data

    def __call__(self, predicted):
        return predicted - self.data

    def slopes(self, predicted, changes):
        return changes


def fitted(data, series, columns=COLUMNS):
    return fit_least_squares(
        Differenced(lambda unknowns: columns @ unknowns), [Against(data)], np.full((1, 2), 0.5), None, None, series
    )


def noise(random, memory):
    """Return errors that follow each other, e_k = ρ e_{k−1} + white noise, of standard deviation 0.05."""
    errors = random.normal(size=COUNT)
    for at in range(1, COUNT):
        errors[at] = memory * errors[at - 1] + np.sqrt(1 - memory**2) * errors[at]
    return 0.05 * errors


@pytest.mark.parametrize(
    ("memory", "series", "least", "most"), [(0, 2, 180, 199), (0.9, 2, 165, 199), (0.9, None, 0, 130)]
)
def test_intervals_hold_with_correlated_errors(memory, series, least, most, random):
    """Of 100 sets of errors, two numbers each; intervals for white errors are too narrow."""
    held = 0
    for _ in range(100):
        found = fitted(COLUMNS @ TRUTH + noise(random, memory), series)
        held += np.sum(np.abs(found.unknowns - TRUTH) < found.student * found.deviations)
    assert least <= held <= most


def test_products_with_the_covariance(random):
    """Against the sum over all pairs of a Toeplitz matrix for each series."""
    residuals, vectors = np.cumsum(random.normal(size=40)), random.normal(size=(40, 3))
    expected = np.zeros((3, 3))
    rows = residuals.reshape(2, 20)
    shared = np.array([sum((row[: 20 - lag] * row[lag:]).sum() for row in rows) for lag in range(20)])
    reach = max(1, min(2 * int(np.flatnonzero(shared <= 0.05 * shared[0])[0]), 10))
    for row, part in zip(rows, vectors.reshape(2, 20, 3), strict=True):
        products = [(row[: 20 - lag] * row[lag:]).sum() / 20 * max(0, 1 - lag / reach) for lag in range(20)]
        expected += part.T @ np.array([[products[abs(i - j)] for j in range(20)] for i in range(20)]) @ part
    np.testing.assert_allclose(correlated_products(residuals, vectors, 2), expected, rtol=1e-10, atol=1e-10)


def test_an_unknown_at_its_limit_has_no_interval(random):
    """The other one has that of a problem in which the first is given."""
    data = COLUMNS @ [1.5, 0.6] + noise(random, 0)
    found = fitted(data, None)
    assert found.at_limit.tolist() == [True, False]
    assert found.inseparable == ()
    assert np.isnan(found.deviations[0])
    rest = data - COLUMNS[:, 0]
    slope = COLUMNS[:, 1] @ rest / (COLUMNS[:, 1] @ COLUMNS[:, 1])
    error = np.linalg.norm(rest - slope * COLUMNS[:, 1]) / np.sqrt((COUNT - 1) * (COLUMNS[:, 1] @ COLUMNS[:, 1]))
    assert found.unknowns[1] == pytest.approx(slope, rel=1e-5)
    assert found.deviations[1] == pytest.approx(error, rel=1e-5)
