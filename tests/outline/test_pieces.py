"""Pieces of outlines: points, extremes, crossings, arc lengths, and arcs at corners."""

import math

import numpy as np
import pytest
import scipy

from warp_plate.outline.pieces import Arc, Straight, ellipse, rounded, straight

TURNED = ellipse((0.3, 0.2), (0.25, 0.1), 0.7, "free", "outline")
PIECES = [
    Straight("free", "outline", "side", np.array([(0.1, 0.2), (0.4, -0.3)])),
    TURNED,
    TURNED.part(0.1, 0.65),
    TURNED.reversed().part(0.3, 0.9),
]


@pytest.mark.parametrize("piece", PIECES)
def test_crossings_and_extremes_lie_where_the_coordinate_says(piece):
    for axis in (0, 1):
        samples = piece.points(np.linspace(0, 1, 4001))[:, axis]
        values = np.linspace(samples.min(), samples.max(), 7)[1:-1] + 1e-9
        t = piece.crossings(axis, values)
        assert np.abs(piece.points(t)[:, axis][:, None] - values).min(axis=1) == pytest.approx(0, abs=1e-12)
        changes = (np.diff(np.sign(samples[:, None] - values), axis=0) != 0).sum()
        assert t.size == changes
        extremes = piece.points(np.array([0.0, 1.0, *piece.extremes(axis)]))[:, axis]
        assert (extremes.min(), extremes.max()) == pytest.approx((samples.min(), samples.max()), abs=1e-7)


@pytest.mark.parametrize("piece", PIECES)
def test_monotone_parts_return_the_points_of_the_curve(piece):
    t = np.linspace(0.01, 0.99, 31)
    points = piece.points(t)
    for axis in (0, 1):
        parts = list(piece.monotone(axis))
        for point in points:
            found = [part.across(point[axis : axis + 1])[0] for part in parts if part.low <= point[axis] <= part.high]
            assert np.abs(np.array(found) - point[1 - axis]).min() < 1e-12


@pytest.mark.parametrize("piece", PIECES)
def test_tangents_are_slopes_and_normals_are_to_their_right(piece):
    t, step = np.linspace(0.1, 0.9, 9), 1e-6
    slopes = (piece.points(t + step) - piece.points(t - step)) / (2 * step)
    assert piece.tangents(t) == pytest.approx(slopes, abs=1e-8)
    normals = piece.normals(t)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1)
    assert (slopes[:, 0] * normals[:, 1] - slopes[:, 1] * normals[:, 0] < 0).all()


def test_lengths_and_areas():
    first, second = 0.25, 0.1
    assert TURNED.length == pytest.approx(4 * first * scipy.special.ellipe(1 - (second / first) ** 2), rel=1e-12)
    assert TURNED.area == pytest.approx(math.pi * first * second, rel=1e-12)
    assert TURNED.reversed().area == -TURNED.area
    assert TURNED.part(0, 0.3).length + TURNED.part(0.3, 1).length == pytest.approx(TURNED.length, rel=1e-12)


def test_the_nearest_point_of_a_circle_is_towards_its_centre():
    circle = ellipse((0.0, 0.0), (1.0, 1.0), 0.0, "free", "outline")
    t, distance = circle.nearest((2.0, 2.0))
    assert circle.points(t) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)), abs=1e-6)
    assert distance == pytest.approx(math.sqrt(8) - 1, rel=1e-9)


def test_arcs_at_corners_join_without_a_kink():
    loop = rounded(straight([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], "free", "outline"), 0.2)
    assert sum(isinstance(piece, Arc) for piece in loop) == 6
    for before, after in zip(loop, loop[1:] + loop[:1], strict=True):
        assert before.end == pytest.approx(after.start, abs=1e-14)
        assert before.normals(1.0) == pytest.approx(after.normals(0.0), abs=1e-12)
    # Five arcs take from the area, one at a re-entrant corner adds to it.
    assert sum(piece.area for piece in loop) == pytest.approx(3 - 4 * 0.2**2 * (1 - math.pi / 4), rel=1e-12)
    with pytest.raises(ValueError, match=r"both ends of side 1 need 1\.2 m of it"):
        rounded(straight([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], "free", "outline"), 0.6)
