"""Closed outlines with holes: what is inside, chords, parts with other conditions, and what is refused."""

import math

import numpy as np
import pytest
import shapely

from warp_plate.outline.contours import piece_of_row
from warp_plate.outline.outline import make_outline
from warp_plate.outline.pieces import ellipse, rounded, straight


def disc(x, y, radius, condition="free", edge="outline"):
    return [ellipse((x, y), (radius, radius), 0.0, condition, edge)]


def square(x, y, side):
    return straight([(x, y), (x + side, y), (x + side, y + side), (x, y + side)], "free", "outline")


BRACKET = rounded(straight([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], "free", "outline"), 0.2)
PLATES = {
    "disc": {"outline": disc(1, 1, 1)},
    "ring": {"outline": disc(1, 1, 1), "hole": disc(1.1, 0.9, 0.3)},
    "clockwise": {"outline": [piece.reversed() for piece in reversed(square(0, 0, 2))], "hole": square(0.5, 0.5, 0.4)},
    "bracket": {"outline": BRACKET, "hole": disc(0.5, 0.5, 0.2)},
}


# A circle as a drawing program writes it, whose arcs meet within 2e-17.
FOUR_ARCS = (
    (0.10176712181300002, 0.07380447272929999, 0.10090169584020303, 0.073804472729297, -1.570796325877423),
    (0.10090169584100003, 0.0729390467565, 0.10090169584079703, 0.073804472729297, -1.5707963270329275),
    (0.10003626986800003, 0.07380447272929998, 0.10090169584079703, 0.07380447272930299, -1.570796327032927),
    (0.100901695841, 0.07466989870209999, 0.100901695840203, 0.07380447272930299, -1.570796325877423),
)


def test_polygons_of_arcs_that_meet_within_rounding():
    rows = zip(FOUR_ARCS, (*FOUR_ARCS[1:], FOUR_ARCS[0]), strict=True)
    hole = [piece_of_row(row, ahead, "", "free", "holes[0]") for row, ahead in rows]
    outline = make_outline({"outline": square(0, 0, 0.2), "hole": hole})
    assert all(shapely.Polygon(corners).is_valid for corners in outline.polygons())
    covered = np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2)])
    assert outline.share(covered) == pytest.approx(outline.area / 0.04, rel=1e-6)


@pytest.mark.parametrize("name", PLATES)
def test_areas_lengths_and_insides_agree_with_polygons(name):
    outline = make_outline(PLATES[name])
    shell, *holes = outline.polygons(1e-3)
    polygon = shapely.Polygon(shell, holes)
    assert outline.area == pytest.approx(polygon.area, rel=1e-6)
    assert outline.length == pytest.approx(polygon.length, rel=1e-6)
    x0, x1, y0, y1 = outline.bounds
    assert polygon.bounds == pytest.approx((x0, y0, x1, y1), abs=1e-6)
    points = np.random.default_rng(0).uniform((x0 - 0.1, y0 - 0.1), (x1 + 0.1, y1 + 0.1), (4000, 2))
    clear = shapely.distance(polygon.boundary, shapely.points(points)) > 1e-5
    assert (outline.contains(points) == shapely.contains_xy(polygon, *points.T))[clear].all()
    for axis, at in ((0, 0.731), (1, 0.613)):
        length = sum(high - low for low, high in outline.chords(axis, at))
        line = shapely.LineString([(-9, at), (9, at)] if axis == 0 else [(at, -9), (at, 9)])
        assert length == pytest.approx(line.intersection(polygon).length, abs=1e-6)


def test_points_on_the_edge_belong_to_the_plate_at_all_joints():
    outline = make_outline({"outline": BRACKET, "hole": disc(0.5, 0.5, 0.2)})
    for piece in outline.pieces:
        assert outline.contains(piece.points(np.linspace(0, 1, 11))).all()
        assert not outline.contains(piece.points(np.array([0.3])) + 1e-6 * piece.normals(np.array([0.3]))).any()


def test_parts_have_their_own_conditions():
    parts = {"parts[0]": ((2.0, 1.0), (1.0, 2.0), "clamped"), "parts[1]": ((1.0, 0.0), (2.0, 1.0), "supported")}
    outline = make_outline({"outline": disc(1, 1, 1)}, parts)
    lengths = {}
    for piece in outline.pieces:
        lengths[piece.condition] = lengths.get(piece.condition, 0.0) + piece.length
    assert lengths == pytest.approx({"clamped": math.pi / 2, "supported": math.pi / 2, "free": math.pi})
    assert len([angle for *_, angle in outline.corners()]) == 3
    # A part through the first point of the outline, and one between corners of a polygon.
    through = make_outline({"outline": disc(1, 1, 1)}, {"parts[0]": ((1.0, 0.0), (1.0, 2.0), "clamped")})
    assert sum(piece.length for piece in through.pieces if piece.condition == "clamped") == pytest.approx(math.pi)
    sides = make_outline({"outline": square(0, 0, 1)}, {"parts[0]": ((0.0, 1.0), (1.0, 0.0), "clamped")})
    assert [piece.condition for piece in sides.pieces] == ["clamped", "free", "free", "clamped"]


@pytest.mark.parametrize(
    ("loops", "text"),
    [
        ({"outline": straight([(0, 0), (1, 1), (1, 0), (0, 1)], "free", "")}, "side 0 crosses or touches side 2"),
        ({"outline": straight([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)], "free", "")}, "side 0 .*touches .*side"),
        ({"outline": square(0, 0, 1)[:3]}, "outline: is open between side 2 and side 0"),
        ({"outline": disc(1, 1, 1), "hole": disc(3, 1, 0.2)}, "hole: is off the plate"),
        ({"outline": disc(1, 1, 1), "hole": disc(1.9, 1, 0.2)}, "the ellipse crosses or touches the ellipse of hole"),
        ({"outline": disc(1, 1, 1), "hole": disc(1, 1, 0.5), "other": disc(1, 1, 0.2)}, "other: is inside another"),
        ({"outline": straight([(0, 0), (1, 1e-9), (2, 0), (1, 2e-9)], "free", "")}, "outline: "),
    ],
)
def test_invalid_outlines_are_refused_by_the_names_of_their_pieces(loops, text):
    with pytest.raises(ValueError, match=text):
        make_outline(loops)


def test_a_part_that_ends_off_the_outline_is_refused():
    with pytest.raises(ValueError, match=r"edges\.parts\[0\]\.to_point: .*nearest point is \[1, 2\]"):
        make_outline({"outline": disc(1, 1, 1)}, {"parts[0]": ((2.0, 1.0), (1.0, 2.1), "clamped")})


def test_rectangles_on_a_plate():
    ring = make_outline(PLATES["ring"])
    assert ring.holds(0.3, 0.6, 0.8, 1.2)
    for other in ((0.0, 0.5, 0.0, 0.5), (0.6, 1.0, 0.8, 1.0), (0.5, 1.5, 0.5, 1.5), (1.8, 2.1, 0.0, 2.0)):
        assert not ring.holds(*other)
