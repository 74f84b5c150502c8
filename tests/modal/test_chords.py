"""Gauss's rule on chords: exact areas and moments, positive weights, points on the plate."""

import math
from dataclasses import replace

import numpy as np
import pytest

from warp_plate.modal.spaces.chords import LocalSplines, make_chords
from warp_plate.modal.spaces.splines import make_splines, overlapping_pairs
from warp_plate.outline.outline import make_outline
from warp_plate.outline.pieces import ellipse, rounded, straight

SPLINES = tuple(make_splines(2.0, ("free", "free"), count, 5, ((0.7, 2),)) for count in (9, 7))
LOCAL = tuple(LocalSplines(splines) for splines in SPLINES)


def disc(x, y, radius):
    return [ellipse((x, y), (radius, radius), 0.0, "free", "outline")]


def test_local_polynomials_are_the_splines():
    x = np.linspace(0.01, 1.99, 57)
    for derivative in (0, 1, 2):
        values = SPLINES[0].values(x, derivative).T
        assert LOCAL[0].dense(x, derivative) == pytest.approx(values, abs=1e-11 * np.abs(values).max())


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.1])
def test_moments_of_an_ellipse(angle):
    loop = [ellipse((1.0, 1.0), (0.9, 0.6), angle, "free", "outline")]
    chords = make_chords(make_outline({"outline": loop}), LOCAL, (8, 9))
    assert chords.weights.min() > 0
    assert chords.weights.sum() == pytest.approx(math.pi * 0.54, rel=1e-11)
    x, y = chords.x - 1, chords.y - 1
    along = x * math.cos(angle) + y * math.sin(angle)
    assert (chords.weights * along**2).sum() == pytest.approx(math.pi * 0.9**3 * 0.6 / 4, rel=1e-11)
    assert (chords.weights * along**6).sum() == pytest.approx(5 * math.pi * 0.9**7 * 0.6 / 64, rel=1e-11)


def test_rounded_corners_holes_and_regions():
    corners = straight([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], "free", "outline")
    outline = make_outline({"outline": rounded(corners, 0.2), "hole": disc(0.5, 0.5, 0.2)})
    chords = make_chords(outline, LOCAL, (6, 7))
    assert chords.weights.sum() == pytest.approx(outline.area, rel=1e-9)
    assert outline.contains(np.stack([chords.x, chords.y], axis=-1)).all()
    # Two discs of radius 1 at a distance of 1 share a lens.
    lens = make_chords(make_outline({"outline": disc(1, 1, 1)}), LOCAL, (6, 7), curves=[disc(2, 1, 1)])
    assert lens.weights.sum() == pytest.approx(2 * math.pi / 3 - math.sqrt(3) / 2, rel=1e-11)
    apart = make_chords(make_outline({"outline": disc(1, 1, 0.4)}), LOCAL, (6, 7), curves=[disc(1.9, 1.9, 0.1)])
    assert apart.weights.size == 0


@pytest.mark.parametrize("place", [0.3, 1.7])
def test_areas_of_discs_that_touch_the_edge_but_for_rounding(place):
    """As of a disc that lies within: the chords end there as a square root does."""
    plate, areas = make_outline({"outline": straight([(0, 0), (2, 0), (2, 2), (0, 2)], "free", "outline")}), []
    for over in (-1e-16, 0.0, 1e-16):
        touching = disc(1.0, place + math.copysign(over, place - 1), 0.3)
        areas.append(make_chords(plate, LOCAL, (8, 9), curves=[touching]).weights.sum())
    assert areas == pytest.approx([math.pi * 0.3**2] * 3, rel=1e-8)


@pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-6, 1e-4])
def test_areas_of_discs_whose_middle_is_near_a_knot(apart):
    """The crossing of the knot is then near the lowest point, but not at it."""
    plate = make_outline({"outline": straight([(0, 0), (2, 0), (2, 2), (0, 2)], "free", "outline")})
    chords = make_chords(plate, LOCAL, (8, 9), curves=[disc(LOCAL[0].breaks[3] + apart, 1.0, 0.06)])
    assert chords.weights.sum() == pytest.approx(math.pi * 0.06**2, rel=1e-9)


@pytest.mark.parametrize("block", [2**14, 7])
def test_forms_are_sums_over_the_points(block):
    """Also where not all segments are in one block."""
    chords = replace(make_chords(make_outline({"outline": disc(1, 1, 1)}), LOCAL, (6, 7)), block=block)
    u = np.random.default_rng(0).normal(size=(SPLINES[1].functions, SPLINES[0].functions))
    blocks = [values for _, values in chords.sums(u[None], ((2, 0), (0, 2)))]
    xx, yy = (
        np.concatenate([values[0] for values in of_order]).reshape(chords.x.shape)
        for of_order in zip(*blocks, strict=True)
    )
    field = 1 + chords.x * chords.y
    (row_x, column_x), (row_y, column_y) = (overlapping_pairs(splines) for splines in SPLINES)
    values = chords.form(field, (2, 0), (0, 2))
    total = (values * u[row_y[:, None], row_x] * u[column_y[:, None], column_x]).sum()
    assert total == pytest.approx((chords.weights * field * xx * yy).sum(), rel=1e-11)
    integrals = chords.integrals(field, x=2)
    assert (integrals * u).sum() == pytest.approx((chords.weights * field * xx).sum(), rel=1e-11)


@pytest.mark.parametrize("beyond", [-1e-9, 1e-9, 0.5])
def test_integrals_about_a_place_next_to_a_knot(beyond):
    """∫ dA/r over a rectangle of sides a and b, with a corner at the place, is a asinh b/a + b asinh a/b."""
    sizes = 0.2 * np.array([0.3, 0.09, 0.0225, 0.005, 0.001, 1e-4])
    x, y = 1.02, LOCAL[1].breaks[3] - sizes[2] * (1 + beyond)
    plate = make_outline({"outline": straight([(0, 0), (2, 0), (2, 2), (0, 2)], "free", "outline")})
    chords = make_chords(plate, LOCAL, (6, 7), near=[(x, y, size) for size in sizes])
    corners = [(a, b) for a in (x, 2 - x) for b in (y, 2 - y)]
    expected = sum(a * math.asinh(b / a) + b * math.asinh(a / b) for a, b in corners)
    assert (chords.weights / np.hypot(chords.x - x, chords.y - y)).sum() == pytest.approx(expected, rel=3e-6)
