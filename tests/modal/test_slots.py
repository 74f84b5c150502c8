"""Plates with slots and other free holes, against finite elements.

Those are triangles with polynomials of degree 4 whose slopes a penalty joins (S. C. Brenner, L.-Y. Sung, J. Sci.
Comput. 22, 2005), graded towards the corners of the hole: 20 000 unknowns, the same to 1e-4 for two sizes of elements.
"""

import math

import numpy as np
import pytest
import shapely
import shapely.affinity

from support.derivatives import errors_of_derivatives
from support.scenes import MATERIAL
from support.scenes_of_outlines import dimensionless, outlined
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.spaces import slots
from warp_plate.modal.spaces.added import ties_banks

HARD = {**MATERIAL, "poisson_ratio": 0.3}
SQUARE = {"rectangle": (0.2, 0.2)}
LONG = np.array([(0.06, 0.08), (0.13, 0.11)])


def with_hole(hole, edge="clamped", **tables):
    """Return a unit square of 0.2 m with a free hole."""
    tables = {"actuators": [(0.01, 0.02, 0.01, 0.02)], **tables}
    return outlined(SQUARE, edge, [{"edge": "free", **hole}], material=HARD, **tables)


def slot(length, width, centre, angle):
    """Return a hole in parts of the square's side."""
    return {"rectangle": (0.2 * length, 0.2 * width), "centre": (0.2 * centre[0], 0.2 * centre[1]), "angle": angle}


@pytest.mark.parametrize("index", range(2))
def test_derivatives_are_differences(index):
    away = np.array([(0.001, 0.002), (0.0005, 0.001)])
    function = (
        lambda: slots.along_middle(LONG, 4, 2, (0.01,)),
        lambda: slots.at_poles(np.array([0.1, 0.1]), away, (0.01,)),
    )[index]()
    x, y = np.random.default_rng(0).uniform(0.03, 0.17, (2, 40))
    for count, errors in errors_of_derivatives(function, x, y, 1e-6):
        assert function.functions == count
        assert np.median(errors) < 1e-5


@pytest.mark.parametrize(
    ("hole", "edge", "exact"),
    [
        pytest.param(
            slot(0.4, 0.04, (0.5, 0.5), math.pi / 4),
            "clamped",
            [33.69605, 63.04592, 72.35321, 103.22277, 125.41598],
            marks=pytest.mark.slow,
        ),
        (slot(0.3, 0.005, (0.4, 0.6), 1.2), "free", [0.0, 0.0, 0.0, 13.36412, 19.3027, 23.15538]),
        pytest.param(
            {**slot(0.4, 0.04, (0.45, 0.55), 0.6), "corner_radius": 0.00399},
            "clamped",
            [34.02447, 64.36539, 72.52814, 100.80614, 119.05216],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            slot(0.1, 0.1, (0.45, 0.55), 0.3),
            "clamped",
            [35.75729, 72.96849, 73.02988, 107.27588, 130.18938],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_plates_with_holes(hole, edge, exact):
    scene = with_hole(hole, edge)
    frequencies = dimensionless(scene, solve_modes(scene, 0.0, 20).frequencies[: len(exact)], 0.2)
    assert frequencies == pytest.approx(exact, rel=5e-4, abs=1e-3)


def test_middle_lines():
    """Of a slot between the middles of its ends, of an ellipse between its foci; not of circles and hollow holes."""
    (hole,) = with_hole(slot(0.4, 0.04, (0.5, 0.5), 0.3)).outline.loops[1:]
    along = np.array([math.cos(0.3), math.sin(0.3)])
    assert np.abs((slots.middle_line(hole) - 0.1) @ along) == pytest.approx([0.038, 0.038])
    (hole,) = with_hole({"ellipse": (0.1, 0.1, 0.05, 0.03, 0.0)}).outline.loops[1:]
    assert np.sort(slots.middle_line(hole), axis=0) == pytest.approx(np.array([(0.06, 0.1), (0.14, 0.1)]))
    bent = [(0.05, 0.05), (0.15, 0.05), (0.15, 0.06), (0.06, 0.06), (0.06, 0.15), (0.05, 0.15)]
    for other in (
        {"polygon": bent},
        {"disc": (0.1, 0.1, 0.01)},
        {**slot(0.4, 0.04, (0.5, 0.5), 0.3), "edge": "clamped"},
    ):
        (hole,) = with_hole(other).outline.loops[1:]
        assert slots.middle_line(hole) is None


def test_slots_that_splines_tie():
    """Slanted slots have functions about them if they are free, convex, few, and in an isotropic plate."""
    free = slot(0.4, 0.04, (0.5, 0.5), 0.3)
    scene = with_hole(free)
    assert not ties_banks(scene)
    assert ties_banks(with_hole({**free, "edge": "clamped"}))
    assert ties_banks(with_hole(free, effects={"orthotropic": {"Dx": 0.02, "Dy": 0.01, "D1": 0.003, "Dxy": 0.005}}))
    three = [{**slot(0.3, 0.02, (0.5, y), 0.3), "edge": "free"} for y in (0.3, 0.5, 0.7)]
    assert ties_banks(outlined(SQUARE, "clamped", three, material=HARD))
    assert not ties_banks(outlined(SQUARE, "clamped", three[:2], material=HARD))


def test_middle_lines_lie_in_the_hole():
    rng = np.random.default_rng(0)
    for _ in range(20):
        corners = shapely.MultiPoint(rng.uniform(-1, 1, (6, 2)) * [0.05, 0.05 * 10 ** rng.uniform(-2, 0)]).convex_hull
        turned = shapely.affinity.rotate(shapely.affinity.translate(corners, 0.1, 0.1), rng.uniform(0, 180))
        outline = with_hole({"polygon": list(turned.exterior.coords)[:-1]}).outline
        (hole,) = outline.loops[1:]
        assert turned.contains(shapely.LineString(slots.middle_line(hole)))
        places = [place for function in slots.around_slot(outline, hole, 0.015) for place in function.places]
        assert len(places) == 2 + len(hole)


def test_middle_lines_have_one_direction():
    """Whatever the size and place of a hole, or functions about it would be others."""
    rng = np.random.default_rng(0)
    for turn in (0.0, 0.3, math.pi / 2):
        along = np.array([math.cos(turn), math.sin(turn)])
        for size, x in rng.uniform([0.3, 0.45], [0.4, 0.55], (20, 2)):
            (hole,) = with_hole(slot(size, 0.04, (x, 0.5), turn)).outline.loops[1:]
            assert np.diff(slots.middle_line(hole), axis=0) @ along > 0
