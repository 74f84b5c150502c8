"""Plates of any outline by trimmed splines, against exact equations and the rectangle's own splines.

Reference frequencies of discs and rings are zeros of determinants of Bessel functions (A. W. Leissa, NASA SP-160);
those of supported triangles are G. Lamé's.
"""

import math

import numpy as np
import pytest
import scipy

from support.grid_modes import natural_modes
from support.scenes import MATERIAL, refused, scene_of
from support.scenes_of_outlines import dimensionless, outlined
from warp_plate.modal.assemble import make_galerkin, make_space
from warp_plate.modal.modes import errors_of_frequencies, solve_modes
from warp_plate.modal.solver import ModalSolver
from warp_plate.modal.spaces.edge_moments import null_space
from warp_plate.scene.target import Target

DISC = {"disc": (0.1, 0.1, 0.1)}
# ωa²√(ρH/D) of discs of radius a, those without a nodal diameter once, others twice.
CLAMPED = [10.2158262299, *[21.2603976946] * 2, *[34.8770354203] * 2, 39.7711482365, *[51.0300354838] * 2]
SUPPORTED = [4.93514904257, *[13.898165073] * 2, *[25.6132967208] * 2, 29.7200047321]
FREE = [0.0] * 3 + [5.2620369603] * 2 + [9.06889866179] + [12.243894258] * 2 + [20.5130869057] * 2
# Of rings of radii a and a/2: outer and inner edge, ν = 0.3.
RINGS = {
    ("clamped", "free"): [17.71451434, *[22.0145750247] * 2, *[32.1155344637] * 2],
    ("free", "clamped"): [13.0242566622, *[13.2897814102] * 2, *[14.7038124712] * 2],
    ("supported", "free"): [5.07687130784, *[11.6073214115] * 2, *[22.3565694152] * 2],
}
# First axisymmetric mode of a clamped disc whose middle is held: the determinant of J0, Y0, I0, K0 with u(0) = 0.
POINT_OF_DISC = 22.7367744936
HARD = {**MATERIAL, "poisson_ratio": 0.3}


def turned(width, height, angle):
    return {"rectangle": (width, height), "angle": angle}


def lowest(scene, count=20):
    return solve_modes(scene, 0.0, count).frequencies[:count]


@pytest.mark.parametrize(
    ("edge", "ratio", "exact"), [("clamped", 0.3, CLAMPED), ("supported", 0.3, SUPPORTED), ("free", 0.33, FREE)]
)
def test_discs(edge, ratio, exact):
    scene = outlined(DISC, edge, material={**MATERIAL, "poisson_ratio": ratio})
    assert dimensionless(scene, lowest(scene), 0.1)[: len(exact)] == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize(
    "around", [pair if pair[0] == "clamped" else pytest.param(pair, marks=pytest.mark.slow) for pair in RINGS]
)
def test_rings(around):
    outer, inner = around
    hole = {"disc": (0.1, 0.1, 0.05), "edge": inner}
    scene = outlined(DISC, outer, [hole], material=HARD, actuators=[(0.02, 0.04, 0.09, 0.11)])
    values = dimensionless(scene, lowest(scene), 0.1)
    assert values[: len(RINGS[around])] == pytest.approx(RINGS[around], rel=2e-5)


@pytest.mark.parametrize("edge", ["clamped", "supported", "free", {"translation": 3e3, "rotation": 0.4}])
def test_turned_rectangles_have_the_frequencies_of_the_rectangle(edge):
    straight = scene_of(size=(0.2, 0.14), edges=(edge,) * 4, modal_density=1.0)
    scene = outlined(turned(0.2, 0.14, 0.35), edge)
    assert lowest(scene) == pytest.approx(lowest(straight), rel=1e-6, abs=1e-6)


def test_sides_of_different_kinds():
    straight = scene_of(size=(0.2, 0.14), edges=("supported", "supported", "clamped", "supported"), modal_density=1.5)
    part = {"edge": "clamped", "from_point": (0.2, 0.0), "to_point": (0.2, 0.14)}
    scene = outlined({"rectangle": (0.2, 0.14)}, "supported", parts=[part])
    assert lowest(scene) == pytest.approx(lowest(straight), rel=1e-6)


def test_supported_triangle():
    side, turn = 0.2, 0.3
    corners = side * np.array([(0, 0), (1, 0), (0.5, math.sqrt(0.75))])
    corners = corners @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    scene = outlined(
        {"polygon": (corners - corners.min(axis=0)).tolist()}, "supported", actuators=[(0.07, 0.1, 0.08, 0.11)]
    )
    numbers = np.array([m * m + m * n + n * n for m in range(1, 12) for n in range(1, 12)])
    exact = 16 * math.pi**2 / 9 * np.sort(numbers)[:20]
    assert dimensionless(scene, lowest(scene), side) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(
    ("edge", "exact", "error"),
    [("clamped", [81.874, 105.1405, 122.0873], 2e-3), ("free", [0.0] * 3 + [15.7089, 17.0036, 27.22], 3e-4)],
)
def test_re_entrant_corners(edge, exact, error):
    """An L of two squares of side 1/2 and their corner, by splines with the singular functions of the corner."""
    corners = [(0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0.1, 0.2), (0, 0.2)]
    scene = outlined({"polygon": corners}, edge, material=HARD)
    assert dimensionless(scene, lowest(scene, 6), 0.2)[: len(exact)] == pytest.approx(exact, rel=error, abs=0.01)


def test_clamped_ellipse():
    scene = outlined({"ellipse": (0.1, 0.1, 0.1, 0.05, 0.6)}, "clamped", actuators=[(0.09, 0.1, 0.09, 0.1)])
    values = dimensionless(scene, lowest(scene, 6), 0.1)
    assert values[[0, 1]] == pytest.approx([27.377439025, 39.497431839], rel=1e-8)
    assert np.abs(values / 69.857987111 - 1).min() < 1e-8


def test_effects_act_as_on_the_rectangle():
    effects = {
        "foundation": {"stiffness": 1e4, "damping": 3.0},
        "tension": {"x": 5.0, "y": 3.0},
        "oscillators": [{"area": (0.05, 0.08, 0.02, 0.06), "mass": 1e-3, "stiffness": 800.0, "damping": 0.01}],
        "layers": [{"area": (0.1, 0.15, 0.05, 0.1), "thickness": 2e-4, "young_modulus": 2e9, "density": 1500.0}],
        "loss_factor": {"eta": 0.02},
    }
    scenes = [
        scene_of(size=(0.2, 0.14), edges=("free",) * 4, effects=effects, modal_density=1.0),
        outlined({"rectangle": (0.2, 0.14)}, "free", effects=effects, modal_density=0.6),
    ]
    straight, trimmed = (solve_modes(scene, 0.0, 20) for scene in scenes)
    assert trimmed.frequencies[:20] == pytest.approx(straight.frequencies[:20], rel=2e-5, abs=1e-5)
    assert trimmed.loss_factors[3:20] == pytest.approx(straight.loss_factors[3:20], rel=1e-4)
    assert trimmed.space.plate_mass == pytest.approx(straight.space.plate_mass, rel=1e-9)


@pytest.mark.parametrize(
    "region",
    [(0.02, 0.09, 0.03, 0.11), Target(disc=(0.1, 0.07, 0.04)), Target(polygon=[(0.1, 0), (0.2, 0), (0.2, 0.1)])],
)
def test_loads_and_regions_are_those_of_the_rectangle(region):
    """A rectangle by its outline and by its size have the same modes; their energies and loads agree, too."""
    straight = solve_modes(scene_of(size=(0.2, 0.14), edges=("supported",) * 4, modal_density=1.0), 0.0, 10)
    trimmed = solve_modes(outlined({"rectangle": (0.2, 0.14)}, "supported"), 0.0, 10)
    points = [(0.053, 0.041), (0.131, 0.112), (0.09, 0.02)]
    areas = [(0.02, 0.05, 0.03, 0.06), (0.1, 0.16, 0.01, 0.09)]
    signs = np.sign(straight.at_points(points)[:10, 0] / trimmed.at_points(points)[:10, 0])
    assert trimmed.at_points(points)[:10] * signs[:, None] == pytest.approx(straight.at_points(points)[:10], abs=1e-4)
    forces = [plate.patch_forces(areas)[:10] for plate in (straight, trimmed)]
    assert forces[1] * signs[:, None] == pytest.approx(forces[0], abs=1e-8)
    masses = [plate.kinetic_matrix(region)[:10, :10] for plate in (straight, trimmed)]
    assert masses[1] * np.outer(signs, signs) == pytest.approx(masses[0], abs=1e-6)
    within = [plate.kinetic_matrix(region, (0.0, 0.1, 0.0, 0.1))[:10, :10] for plate in (straight, trimmed)]
    assert within[1] * np.outer(signs, signs) == pytest.approx(within[0], abs=1e-6)
    x, y = np.linspace(0, 0.2, 5), np.linspace(0, 0.14, 4)
    assert trimmed.shapes(x, y)[:10] * signs[:, None, None] == pytest.approx(straight.shapes(x, y)[:10], abs=1e-4)


def test_what_lies_outside_the_outline_does_not_press():
    plate = solve_modes(outlined(DISC, "supported"), 0.0, 10)
    whole, crossing = plate.patch_forces([(0.0, 0.2, 0.0, 0.2), (0.15, 0.2, 0.1, 0.2)])[:10].T
    # The rest of the disc, in three rectangles.
    rest = plate.patch_forces([(0.0, 0.15, 0.0, 0.2), (0.15, 0.2, 0.0, 0.1)])[:10].sum(axis=1)
    assert crossing + rest == pytest.approx(whole, abs=1e-9 * np.abs(whole).max())
    assert plate.patch_forces([(0.0, 0.02, 0.0, 0.02)]) == pytest.approx(0, abs=0)  # no chord is inside the disc
    assert plate.at_points([(0.01, 0.01)]) == pytest.approx(0, abs=0)
    assert plate.at_points([]).shape == (plate.frequencies.size, 0)
    assert not plate.shapes(np.array([0.0, 0.1]), np.array([0.0, 0.1]))[:, 0, 0].any()
    mass = plate.kinetic_matrix(Target(disc=(0.18, 0.1, 0.05))) + plate.kinetic_matrix("plate")
    assert (np.linalg.eigvalsh(mass) > 0).all()


def test_localization_factors_with_loads_and_target_across_the_edge():
    """A drive that starts suddenly moves many modes, which take more functions than natural frequencies do."""
    scene = outlined(
        {"ellipse": (0.1, 0.1, 0.1, 0.06, 0.5)},
        "supported",
        actuators=[(0.06, 0.08, 0.02, 0.06), (0.1, 0.12, 0.09, 0.11)],
        target={"disc": (0.17, 0.14, 0.05)},
    )
    factors = []
    for density in (1.0, 1.5):
        energy = ModalSolver(scene.with_tables(grid={"modal_density": density}), "cpu").run([[1.0, 1.0]]).energy[0]
        factors.append(energy[1] / energy[0])
    assert factors[0] == pytest.approx(factors[1], rel=2e-5)


def test_too_narrow_plates_name_the_piece():
    shape, target = {"rectangle": (0.2, 4e-4), "angle": 0.3}, {"disc": (0.1, 0.03, 0.02)}
    scene = outlined(shape, target=target, actuators=[(0.09, 0.11, 0.02, 0.04)])
    message = refused(solve_modes, scene, 0.0, 6)
    assert "the mean width between edges is 0.399 mm; widen it beside the longest piece, outline, side 0" in message


def test_slopes_of_loads_are_differences():
    space = make_space(outlined(DISC, "free"), (12, 12))
    area, step = np.array([[0.13, 0.19, 0.12, 0.17]]), 1e-6
    for axis, slope in enumerate(space.patch_slopes(area)):
        move = np.zeros(4)
        move[2 * axis : 2 * axis + 2] = step
        difference = (space.patch_integrals(area + move) - space.patch_integrals(area - move)) / (2 * step)
        assert slope == pytest.approx(difference, abs=1e-6 * np.abs(difference).max())


def test_loads_off_the_plate_are_none():
    """As small actuators are that a search tries in the corners of the bounding box."""
    scene = outlined(DISC, "clamped", actuators=[(0.1, 0.11, 0.1, 0.11)])
    assert not make_space(scene, (10, 10)).patch_integrals(np.array([[0.0, 0.01, 0.0, 0.01]])).any()
    assert ModalSolver(scene, "cpu").run([[1.0]]).energy[0, 0] > 0


def test_scenes_of_the_same_outline_share_their_functions():
    scene = outlined(DISC, "clamped")
    space = make_space(scene, (10, 10))
    other = space.of_scene(scene.replace("plate.thickness", 6e-4))
    assert other.is_near(space, 0.1)
    assert not space.of_scene(scene.replace("plate.outline.disc", (0.1, 0.1, 0.09))).is_near(space, 0.1)
    ratio = make_galerkin(other.scene, other).bending.trace() / make_galerkin(scene, space).bending.trace()
    assert ratio == pytest.approx(1.2**3, rel=1e-6)


def test_a_line_support_in_the_middle_makes_two_plates_of_one():
    """Odd modes are those of a half with supported edges, even ones those of a half that the line clamps."""
    support = {"line": ((0.1, 0.0), (0.1, 0.2))}
    scene = outlined({"rectangle": (0.2, 0.2)}, "supported", supports=[support])
    halves = [
        scene_of(size=(0.1, 0.2), edges=("supported", "supported", middle, "supported"), modal_density=1.5)
        for middle in ("supported", "clamped")
    ]
    exact = np.sort(np.concatenate([lowest(half, 6) for half in halves]))[:6]
    assert lowest(scene, 6) == pytest.approx(exact, rel=1e-7)


def test_two_line_supports_that_cross_in_a_disc():
    """Diameters at a right angle: each quarter is a sector whose straight edges are supported or clamped."""
    ends = [(0.1 + 0.1 * math.cos(turn), 0.1 + 0.1 * math.sin(turn)) for turn in np.arange(4) * math.pi / 2 + 0.3]
    crossing = [{"line": (ends[index], ends[index + 2])} for index in (0, 1)]
    exact = [84.87423122, 101.54143926, 101.54143926, 118.72103454, 169.53372761, 190.72724173]
    assert lowest(outlined(DISC, "clamped", supports=crossing), 6) == pytest.approx(exact, rel=2e-6)


def test_point_supports():
    """The middle of a clamped disc: the modes with a node there stay, the first is the limit of rings with ever smaller
    holes that hold the displacement alone; corners of a free square, as Leissa's 7.11 and 15.77."""
    middle = outlined(DISC, "clamped", material=HARD, supports=[{"point": (0.1, 0.1)}])
    assert dimensionless(middle, lowest(middle, 6), 0.1)[:3] == pytest.approx(
        [21.2603976946, 21.2603976946, POINT_OF_DISC], rel=1e-5
    )
    corners = [{"point": point} for point in ((0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2))]
    square = outlined({"rectangle": (0.2, 0.2)}, "free", material=HARD, supports=corners)
    assert dimensionless(square, lowest(square, 6), 0.2)[:2] == pytest.approx([7.11088, 15.77024], rel=1e-5)


def test_supports_of_a_plate_given_by_its_size():
    """A square with supported edges: its modes with a node in the middle stay, and its diagonal makes two triangles of
    it, whose modes with four supported corners have ωL²√(ρH/D) = (m² + n²)π² with m ≠ n."""
    exact = math.pi**2 * np.array([5, 10, 13])
    for place in ({"point": (0.1, 0.1)}, {"line": ((0.0, 0.0), (0.2, 0.2))}):
        scene = scene_of(size=(0.2, 0.2), edges=("supported",) * 4, supports=[place], modal_density=1.0)
        values = dimensionless(scene, lowest(scene, 6), 0.2)
        assert np.abs(values[:, None] / exact - 1).min(axis=0) == pytest.approx(0, abs=1e-6)
    elastic = {"translation": 3e3, "rotation": 0.4}
    edges, line = ("free", "clamped", elastic, "supported"), {"line": ((0.0, 0.1), (0.2, 0.1)), "stiffness": 1e4}
    scene = scene_of(size=(0.2, 0.2), edges=edges, supports=[line], modal_density=1.0)
    parts = [((0, 0), (0.2, 0), "clamped"), ((0.2, 0), (0.2, 0.2), elastic), ((0.2, 0.2), (0, 0.2), "supported")]
    parts = [{"from": first, "to": last, "edge": edge} for first, last, edge in parts]
    other = outlined({"rectangle": (0.2, 0.2)}, "free", parts=parts, supports=[line])
    assert lowest(scene, 6) == pytest.approx(lowest(other, 6), rel=1e-6)


def test_dense_knots_at_points_keep_rigid_motions():
    """A free plate on three points; the rank of its functions must not lose the turns about the points."""
    points = [{"point": point} for point in ((0.1, 0.0), (0.0, 0.2), (0.2, 0.2))]
    scene = scene_of(size=(0.2, 0.2), edges=("free",) * 4, supports=points, modal_density=0.85)
    denser = scene.with_tables(grid={"modal_density": 1.2})
    assert lowest(denser, 6) == pytest.approx(lowest(scene, 6), rel=1e-6)


def test_dense_knots_at_the_ends_of_a_clamp_keep_smooth_motions():
    """A free square that part of a side clamps. The second frequency [Hz] lies below those of conforming elements with
    cubic polynomials, of 20, 40 and 80 a side: 4.0554, 4.0158, 3.9956."""
    part = {"edge": "clamped", "from": (0.09, 0.0), "to": (0.17, 0.0)}
    glass = {"thickness": 1e-4, "young_modulus": 7e10, "poisson_ratio": 0.3, "density": 2500.0}
    for density in (1.0, 1.4):
        scene = outlined({"rectangle": (0.2, 0.2)}, "free", parts=[part], material=glass)
        values = lowest(scene.with_tables(grid={"modal_density": density}), 2)
        assert values == pytest.approx([1.803, 3.98], rel=3e-3)


def test_a_ring_in_a_disc():
    """Modes of a supported disc with n nodal diameters and a nodal circle there stay as they are."""
    root = 0.441744286801  # radius of the nodal circle of the second axisymmetric mode over that of the disc
    scene = outlined(DISC, "supported", material=HARD, supports=[{"ring": (0.1, 0.1, 0.1 * root)}])
    values = dimensionless(scene, lowest(scene, 6), 0.1)
    assert np.abs(values / 29.7200047321 - 1).min() < 1e-4


@pytest.mark.parametrize("radius", [0.01, 0.04])
def test_supported_rectangles_with_round_corners(radius):
    """As on the grid, whose errors are those of the sharp rectangle; the slope is not held where the edge bends."""
    shapes = [{"rectangle": (0.2, 0.16), "corner_radius": part} for part in (radius, 0.0)]
    on_grid, sharp = (
        natural_modes(outlined(shape, "supported", grid={"nodes": (81, 65)}), 2).frequencies for shape in shapes
    )
    exact, values = lowest(outlined(shapes[1], "supported"), 2), lowest(outlined(shapes[0], "supported"), 2)
    assert values == pytest.approx(on_grid / sharp * exact, rel=2e-3)


@pytest.mark.slow
def test_supported_polygons_with_round_corners():
    """Of small radius and wide angles: the first frequency was 5 % too high."""
    corners = [(0.17, 0.07), (0.16, 0.19), (0.1, 0.2), (0.0, 0.12), (0.05, 0.04), (0.15, 0.0)]
    scene = outlined({"polygon": corners, "corner_radius": 0.004}, "supported")
    assert lowest(scene, 6) == pytest.approx(lowest(scene.with_tables(grid={"modal_density": 1.3}), 6), rel=2e-3)


def test_errors_of_frequencies_hold_where_they_fall_unevenly():
    """Of a square with round corners the first frequency changes less than the others in the second solution."""
    scene = outlined({"rectangle": (0.2, 0.2), "corner_radius": 0.04}).with_tables(grid={"modal_density": 0.5})
    coarse = solve_modes(scene, 0.0, 6).frequencies[:6]
    exact = lowest(scene.with_tables(grid={"modal_density": 1.6}), 6)
    errors = errors_of_frequencies(scene, coarse)
    assert (np.abs(coarse / exact - 1) < errors).all()
    assert errors.max() < 1e-2


def test_springs_that_are_too_stiff():
    for stiffness in (1e18, 1e30):
        support = {"point": (0.05, 0.1), "stiffness": stiffness}
        scene = outlined({"rectangle": (0.2, 0.2)}, "free", supports=[support])
        for tension in ({}, {"tension": {"x": 50.0}}, {"tension": {"x": -1e-3}}):  # none of which buckles the plate
            stiff = scene.with_tables(effects=tension)
            assert "supports, edges: a spring is too stiff beside the plate" in refused(solve_modes, stiff, 0.0, 6)


def test_soft_supports_are_springs():
    """A spring K at a point adds K u² to the energy, so that a soft one shifts ω² by K φ² of the mode there."""
    stiffness, point = 0.05, (0.07, 0.11)
    plain = solve_modes(outlined(DISC, "clamped"), 0.0, 6)
    sprung = solve_modes(outlined(DISC, "clamped", supports=[{"point": point, "stiffness": stiffness}]), 0.0, 6)
    shift = (sprung.angular_frequencies[0] ** 2 - plain.angular_frequencies[0] ** 2) / stiffness
    assert shift == pytest.approx(plain.at_points([point])[0, 0] ** 2, rel=1e-3)


def test_more_conditions_than_functions_allow_the_same_motions():
    chance = np.random.default_rng(0)
    rows = chance.normal(size=(60, 30)) @ scipy.linalg.orth(chance.normal(size=(40, 30))).T
    some, allowed = null_space(rows, None), null_space(rows[:30], None)
    assert some.shape == (40, 10)
    assert some.T @ some == pytest.approx(np.eye(10), abs=1e-12)
    assert some @ some.T == pytest.approx(allowed @ allowed.T, abs=1e-12)
