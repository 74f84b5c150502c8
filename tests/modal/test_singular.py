"""Functions that are added to splines at corners, points, lines, rings and round holes.

Exponents of clamped corners of 3π/2 are those of M. L. Williams' equation sin²((α - 1)ω) = (α - 1)² sin²ω; between a
clamped and a free edge of one line they are 1/2 + k ± i ln √((3 + ν)/(1 - ν))/π.
"""

import math

import numpy as np
import pytest
import scipy

from support.derivatives import errors_of_derivatives
from support.scenes import MATERIAL
from support.scenes_of_outlines import dimensionless, outlined
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.spaces import singular
from warp_plate.modal.spaces.trimmed_splines import TrimmedSplines
from warp_plate.outline.pieces import ellipse

HARD = {**MATERIAL, "poisson_ratio": 0.3}
DISC = {"disc": (0.1, 0.1, 0.1)}
CORNER = [(0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0.1, 0.2), (0, 0.2)]
HOLE = ellipse((0.1, 0.1), (0.03, 0.03), 0.0, "free", "holes[0]")
# ωa²√(ρH/D) of a clamped disc of radius a, with a clamped hole of radius a/20, and
# held along the ring of radius a/2: zeros of determinants of Bessel functions.
SMALL_HOLE = [24.5464757446, 26.0659571159, 26.0659571159, 35.3162800207, 35.3162800207, 51.0426863121]
RING = [30.627551215, 60.625608165, 60.625608165, 74.97937419, 76.941633045]


def lowest(scene, count):
    return solve_modes(scene, 0.0, count).frequencies[:count]


def exponents(angle, kinds):
    return [exponent for exponent, _ in singular._exponents(angle, kinds, 0.3)]


def test_exponents_of_corners():
    angle = 1.5 * math.pi
    for exponent in exponents(angle, ("clamped", "clamped")):
        beta = exponent - 1
        assert abs(np.sin(beta * angle) ** 2 - (beta * math.sin(angle)) ** 2) < 1e-6 * abs(np.sin(beta * angle)) ** 2
    assert exponents(angle, ("clamped", "clamped"))[0].real == pytest.approx(1.544484, abs=1e-6)
    turn = math.log(3.3 / 0.7) / (2 * math.pi)
    for order, exponent in enumerate(exponents(math.pi, ("clamped", "free")), 1):
        assert exponent == pytest.approx(order + 0.5 + 1j * turn, abs=1e-6)
    assert exponents(2 * math.pi / 3, ("supported", "supported"))[0] == pytest.approx(1.5, abs=1e-6)


@pytest.mark.parametrize("kinds", [("clamped", "clamped"), ("clamped", "free"), ("free", "free")])
def test_functions_of_a_corner_follow_its_angle(kinds):
    def values(angle):
        function = singular.at_corner(np.zeros(2), 0.0, angle, kinds, 0.3, 0.01, 1.0)
        return function.values(0.02 * np.cos(turns), 0.02 * np.sin(turns), [(0, 0)])[0]

    turns = np.linspace(0.1, 4.0, 20)
    for angle in np.random.default_rng(0).uniform(4.2, 4.5, 30):
        assert values(angle + 1e-7) == pytest.approx(values(angle), abs=1e-4)


@pytest.mark.parametrize("index", range(5))
def test_derivatives_are_differences(index):
    centre, line = np.array([0.1, 0.1]), np.array([(0.05, 0.07), (0.12, 0.1)])
    outline = outlined(DISC).outline
    function = (
        lambda: singular.at_point(centre, 0.01),
        lambda: singular.at_corner(centre, 0.3, 4.7, ("clamped", "free"), 0.3, 0.01, 0.08),
        lambda: singular.along_line(line, (True, False), 5, outline, 0.01),
        lambda: singular.along_ring(HOLE, 3),
        lambda: singular.around_hole(HOLE, 0.01),
    )[index]()
    x, y = np.random.default_rng(0).uniform(0.06, 0.14, (2, 40))
    for _, errors in errors_of_derivatives(function, x, y, 1e-5):
        assert np.median(errors) < 1e-5


def test_functions_are_biharmonic():
    """The Laplacian of all but those that are cut off is harmonic: its mean over a circle is that at the middle."""
    line = np.array([(0.05, 0.07), (0.12, 0.1)])
    corner = singular.at_corner(np.array([0.1, 0.1]), 0.3, 4.7, ("clamped", "free"), 0.3, 0.01, math.inf)
    functions = [
        corner,
        singular.along_line(line, (True, True), 5, outlined(DISC).outline, 0.01),
        singular.along_ring(HOLE, 3),
        singular.around_hole(HOLE, 0.01),
    ]
    turn = np.linspace(0, 2 * np.pi, 33)[:-1]
    x, y = 0.11 + 0.01 * np.append(np.cos(turn), 0), 0.15 + 0.01 * np.append(np.sin(turn), 0)
    for function in functions:
        bends = function.values(x, y, [(2, 0), (0, 2)])
        laplacian, size = bends.sum(axis=0), np.abs(bends).max(axis=(0, 2))
        assert (laplacian[:, :-1].mean(axis=1) - laplacian[:, -1]) / size == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize(
    ("edge", "exact", "error"),
    [
        ("clamped", [81.874, 105.1405, 122.0873], 2e-4),
        ("free", [0.0, 0.0, 0.0, 15.7089, 17.0036, 27.22, 33.6153, 60.1518], 1e-5),
    ],
)
def test_re_entrant_corners(edge, exact, error):
    angle = 0.5
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    corners = np.array(CORNER) @ turn
    scene = outlined({"polygon": (corners - corners.min(axis=0)).tolist()}, edge, material=HARD)
    assert dimensionless(scene, lowest(scene, 8), 0.2)[: len(exact)] == pytest.approx(exact, rel=error, abs=1e-4)


def test_a_slanted_line_makes_two_triangles_of_a_square():
    """Odd modes are those of a triangle with supported edges, even ones those of one whose longest side is clamped."""
    line = {"line": ((0.0, 0.0), (0.2, 0.2))}
    scene = outlined({"rectangle": (0.2, 0.2)}, "supported", supports=[line], material=HARD)
    part = {"edge": "clamped", "from_point": (0.2, 0.0), "to_point": (0.0, 0.2)}
    triangle = {"polygon": [(0, 0), (0.2, 0), (0, 0.2)]}
    half = outlined(triangle, "supported", parts=[part], material=HARD, actuators=[(0.02, 0.04, 0.02, 0.04)])
    odd = math.pi**2 * np.array([5, 10, 13])
    exact = np.sort(np.concatenate([odd, dimensionless(half, lowest(half, 3), 0.2)]))
    assert dimensionless(scene, lowest(scene, 6), 0.2) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(
    ("height", "angle", "lines", "exact"),
    [
        (
            0.7,
            0.4,
            [((0.3, 0.25), (0.8, 0.25))],
            [69.7665532, 95.4209037, 138.287896, 174.618777, 188.469788, 213.544785],
        ),
        (
            0.8,
            0.0,
            [((0.0, 0.3), (0.55, 0.3))],
            [55.3429280, 75.0606251, 100.648119, 134.440467, 143.415157, 173.055000],
        ),
        (
            0.8,
            0.4,
            [((0.15, 0.4), (0.47, 0.4)), ((0.5, 0.4), (0.85, 0.4))],
            [71.5546319, 101.163445, 103.871577, 128.066190, 150.511467, 171.561098],
        ),
        (
            0.8,
            0.0,
            [((0.1, 0.35), (0.6, 0.35)), ((0.5, 0.38), (0.9, 0.38))],
            [79.8899880, 101.092339, 115.697518, 136.841792, 152.118860, 183.946536],
        ),
        (
            0.8,
            0.4,
            [((0.0, 0.35), (1.0, 0.35)), ((0.45, 0.4),)],
            [78.5317881, 96.1900647, 116.644554, 140.903531, 149.488501, 186.912374],
        ),
    ],
)
def test_lines_that_end_on_the_plate_or_pass_a_place(height, angle, lines, exact):
    """Of supported rectangles with a side of 1; a point is written as a line of one place.

    The forces of the lines, second derivatives of √(1 - t²) Uₙ(t) with 1/√(1 - t²) and t/√(1 - t²), do no work by what
    they move, as Fourier's series of at least 10 000 waves along them; lines are parted beside other places."""
    turn = 0.2 * np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    corners = np.array([(0, 0), (1, 0), (1, height), (0, height)]) @ turn
    least = corners.min(axis=0)
    x, y = corners.mean(axis=0) - least
    places = [(np.array(line) @ turn - least).tolist() for line in lines]
    supports = [{"line": ends} if len(ends) == 2 else {"point": ends[0]} for ends in places]
    scene = outlined(
        {"polygon": (corners - least).tolist()},
        "supported",
        material=HARD,
        supports=supports,
        actuators=[(x - 0.01, x + 0.01, y - 0.01, y + 0.01)],
    )
    assert dimensionless(scene, lowest(scene, 6), 0.2) == pytest.approx(exact, rel=5e-6)


def test_a_ring_in_a_clamped_disc():
    scene = outlined(DISC, "clamped", supports=[{"ring": (0.1, 0.1, 0.05)}], material=HARD)
    assert dimensionless(scene, lowest(scene, 5), 0.1) == pytest.approx(RING, rel=1e-6)


def test_small_clamped_holes():
    hole = {"disc": (0.1, 0.1, 0.005), "edge": "clamped"}
    scene = outlined(DISC, "clamped", [hole], material=HARD, actuators=[(0.02, 0.04, 0.09, 0.11)])
    assert dimensionless(scene, lowest(scene, 6), 0.1) == pytest.approx(SMALL_HOLE, rel=2e-6)


def test_energy_about_a_point_does_not_feel_another_support():
    """∫ (Δ r² log r)² over a disc about the point, of distances by intervals of 0.02 m. The rule about the other
    support is cut near the point."""
    near = [(0.1, 0.1), (0.12, 0.1 + 0.2935 * 0.02)]
    scene = outlined(DISC, "free", supports=[{"point": point} for point in near], material=HARD)
    space = TrimmedSplines(scene, (10, 10))
    index = space.count - len(near)
    pairs = [("xx", "xx"), ("yy", "yy"), ("xx", "yy"), ("yy", "xx")]
    energy = 0.02**4 * sum(space.form(1.0, factors)[index, index] for factors in pairs)
    exact, _ = scipy.integrate.quad(lambda r: 32 * math.pi * r * (math.log(r / 0.02) + 1) ** 2, 0, 0.1, epsrel=1e-12)
    assert energy == pytest.approx(exact, rel=1e-8)


def test_orthotropic_plates_have_dense_knots_instead():
    """The same rigidities, written as those of an orthotropic plate."""
    point = [{"point": (0.07, 0.11)}]
    plain = outlined(DISC, "clamped", supports=point)
    rigidity, ratio = plain.plate.rigidity, plain.plate.poisson_ratio
    table = {"Dx": rigidity, "Dy": rigidity, "D1": ratio * rigidity, "Dxy": (1 - ratio) / 2 * rigidity}
    other = outlined(DISC, "clamped", supports=point, effects={"orthotropic": table})
    assert lowest(other, 6) == pytest.approx(lowest(plain, 6), rel=2e-5)


def sector(angle, edge):
    end = (0.1 + 0.1 * math.cos(angle), 0.1 + 0.1 * math.sin(angle))
    path = [(0.1, 0.1), (0.2, 0.1, 0.1, 0.1, angle), end]
    return outlined({"path": path}, edge, material=HARD, actuators=[(0.1, 0.12, 0.12, 0.14)])


@pytest.mark.parametrize(
    ("angle", "edge", "error"), [(4.2, "clamped", 2e-5), pytest.param(5.8, "free", 1e-6, marks=pytest.mark.slow)]
)
def test_sectors(angle, edge, error):
    scene = sector(angle, edge)
    finer = scene.with_tables(grid={"modal_density": 1.4})
    assert lowest(scene, 6) == pytest.approx(lowest(finer, 6), rel=error, abs=1e-3)


def test_both_sides_of_a_notch_move_apart():
    """A clamped sector of 5.8 rad, whose notch is narrower than the splines' intervals. Exact are particular solutions
    of Bessel functions with orders near the corner's exponents (T. Betcke, L. N. Trefethen, SIAM Review 47, 2005)."""
    scene = sector(5.8, "clamped")
    exact = [22.93932, 26.35114, 33.09332, 41.12374, 50.02834]
    assert dimensionless(scene, lowest(scene, 5), 0.1) == pytest.approx(exact, rel=2e-5)


def test_slivers_take_little_memory():
    """A strip of 40 : 1, turned, has about the frequency of a clamped beam of its width across."""
    length, width, turn = 0.2, 0.005, 0.7
    along, across = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    corners = np.array([0 * along, length * along, length * along + width * across, width * across])
    corners = corners - corners.min(axis=0)
    middle = corners.mean(axis=0)
    area = tuple(np.repeat(middle, 2) + np.tile([-0.01, 0.01], 2))
    scene = outlined({"polygon": corners.tolist()}, "clamped", material=HARD, actuators=[area])
    plate = solve_modes(scene, 0.0, 1)
    assert plate.space.basis.shape[0] < 1200
    assert dimensionless(scene, plate.frequencies[:1], width) == pytest.approx([22.3733], rel=1e-3)


@pytest.mark.parametrize(
    ("hole", "slanted"),
    [
        ({"disc": (0.1, 0.1, 0.01)}, False),
        ({"rectangle": (0.02, 0.02), "centre": (0.1, 0.1), "angle": 0.7}, False),
        ({"rectangle": (0.08, 0.008), "centre": (0.1, 0.1)}, False),
        ({"rectangle": (0.08, 0.008), "centre": (0.1, 0.1), "angle": 0.3}, True),
    ],
)
def test_slanted_slits(hole, slanted):
    assert bool(outlined({"rectangle": (0.2, 0.2)}, "clamped", [hole]).outline.slanted_slits) is slanted
