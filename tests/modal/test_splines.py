"""Splines along one side of a plate against SciPy's."""

import math

import numpy as np
import pytest
from scipy.interpolate import BSpline

from warp_plate.modal.spaces.splines import make_splines

ENDS = {("free", "free"): (0, 0), ("clamped", "supported"): (2, 1)}
CORNERS = (0.05, 1), (0.1, 2), (0.1001, 3)


@pytest.mark.parametrize("ends", ENDS)
@pytest.mark.parametrize("degree", [4, 6, 7])
def test_splines_are_those_of_scipy(ends: tuple[str, str], degree: int) -> None:
    splines = make_splines(0.21, ends, 18, degree, CORNERS)
    count = splines.knots.size - degree - 1
    curves, kept = BSpline(splines.knots, np.eye(count), degree), slice(ENDS[ends][0], count - ENDS[ends][1])
    x = np.concatenate([np.random.default_rng(1).uniform(0, 0.21, 200), [0.0, 0.05, 0.1, 0.21]])
    for derivative in range(2):
        expected = (curves.derivative(derivative) if derivative else curves)(x).T[kept]
        assert np.allclose(splines.values(x, derivative), expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert np.allclose(splines.values_by_pieces(x), splines.values(x), rtol=0, atol=1e-13)
    whole = curves.antiderivative()
    expected = (whole(x) - whole(np.full(x.shape, 0.03))).T[kept]
    assert np.allclose(splines.integrals(np.full(x.shape, 0.03), x), expected, rtol=0, atol=1e-15)


def test_pieces_of_integrals_are_their_polynomials() -> None:
    splines = make_splines(0.21, ("clamped", "free"), 18, 6, CORNERS)
    starts, widths = splines.breaks[:-1], np.diff(splines.breaks)
    powers = (0.3 * widths)[:, None] ** np.arange(7, -1, -1)
    sums = np.einsum("ifp,ip->fi", splines.integral_pieces, powers)
    expected = splines.integrals(np.zeros(starts.shape), starts + 0.3 * widths)
    assert np.allclose(sums, expected, rtol=0, atol=1e-15)
    assert math.isclose(splines.integral_pieces[0, 0, -1], 0.0)
