"""Splines along one side of a plate against SciPy's."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from warp_plate.effects.edges import Edges
from warp_plate.modal.spaces import splines as of_sides
from warp_plate.modal.spaces.chords import LocalSplines
from warp_plate.modal.spaces.splines import make_splines
from warp_plate.modal.spaces.tensor_splines import _places
from warp_plate.plate.outline_grid import outline_grid
from warp_plate.scene.outline import PlateOutline, outline_of

ENDS = {("free", "free"): (0, 0), ("clamped", "supported"): (2, 1)}
CORNERS = (0.05, 1), (0.1, 2), (0.1001, 3)


@pytest.mark.parametrize("ends", ENDS)
@pytest.mark.parametrize("degree", [4, 6, 7])
def test_splines_are_those_of_scipy(ends: tuple[str, str], degree: int) -> None:
    splines = make_splines(0.21, ends, 18, degree, CORNERS)
    count = splines.knots.size - degree - 1
    curves, kept = BSpline(splines.knots, np.eye(count), degree), slice(ENDS[ends][0], count - ENDS[ends][1])
    x = np.concatenate([np.random.default_rng(1).uniform(0, 0.21, 200), [0.0, 0.05, 0.1, 0.21]])
    for derivative in range(3):
        expected = (curves.derivative(derivative) if derivative else curves)(x).T[kept]
        assert np.allclose(splines.values(x, derivative), expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    local = LocalSplines(replace(splines, left_out=(0, 0))).dense(x).T[kept]
    assert np.allclose(local, splines.values(x), rtol=0, atol=1e-13)
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


def arrays_in(value: object) -> list[np.ndarray]:
    """Return the arrays that a value is or holds, in tuples, data classes and sparse matrices."""
    if isinstance(value, np.ndarray):
        return [value]
    parts = value if isinstance(value, tuple) else getattr(value, "__dict__", {}).values()
    return [array for part in parts for array in arrays_in(part)]


def test_what_is_kept_for_later_callers_cannot_be_written_to() -> None:
    side = make_splines(0.21, ("free", "clamped"), 8, 5)
    disc = outline_of(PlateOutline(disc=(0.1, 0.1, 0.1)), (), Edges())
    kept = {
        "make_splines": side,
        "breaks": side.breaks,
        "gauss": of_sides._leggauss(4),
        "side_products": of_sides.side_products(side, 1, 1),
        "end_products": of_sides.end_products(side, True, 1),
        "unordered": of_sides._unordered(side),
        "overlapping_pairs": of_sides.overlapping_pairs(side),
        "places": _places(side, side),
        "outline_grid": outline_grid(disc, (0.2, 0.2), (17, 17)),
    }
    for name, value in kept.items():
        arrays = arrays_in(value)
        assert arrays, name
        assert not any(array.flags.writeable for array in arrays), name
