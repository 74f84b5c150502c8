"""Actuators, oscillators, layers and targets of any shape: integrals over them, by modes and on the grid."""

import math

import numpy as np
import pytest
import scipy

from support.scenes import scene_of
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.analysis.warnings import warning_texts
from warp_plate.modal.assemble import load_integrals, load_slopes
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.solver import ModalSolver
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.plate.designs import per_plate_of
from warp_plate.plate.section import make_section
from warp_plate.plate.weights import patches

SUPPORTED = dict.fromkeys(("left", "right", "bottom", "top"), "supported")
RECTANGLE = {"area": (0.03, 0.07, 0.05, 0.11)}
# The same rectangle in other words.
SAME = [
    {"rectangle": (0.06, 0.04), "angle": math.pi / 2, "centre": (0.05, 0.08)},
    {"polygon": ((0.03, 0.05), (0.07, 0.05), (0.07, 0.11), (0.03, 0.11))},
]
DISC = {"disc": (0.07, 0.11, 0.03)}
WATCH = """
plate.thickness = 1e-3
plate.young_modulus = 7e10
plate.poisson_ratio = 0.22
plate.density = 2500.0
plate.outline.disc = [0.02, 0.02, 0.02]
edges.outline = "free"
drive.frequency = 6000.0
window = { start = 0.0, end = 0.004 }
effects.damping.viscous = 500.0
target.disc = [0.012, 0.03, 0.012]
actuators = [
    { name = "rim", disc = [0.038, 0.02, 0.005] },
    { name = "turned", rectangle = [0.008, 0.004], angle = 0.5, centre = [0.01, 0.01] },
    { name = "polygon", polygon = [[0.01, 0.02], [0.02, 0.021], [0.012, 0.028]] },
]
"""


def scene_with(*shapes, **tables):
    """Return a scene of the paper's plate, supported, with actuators of these shapes."""
    scene = Scene.load("paper", ["grid.load=overlap"])
    actuators = [{"name": str(index), **shape} for index, shape in enumerate(shapes)]
    return scene.with_tables(edges=SUPPORTED, actuators=actuators, **tables)


def space_of(scene):
    return TensorSplines(scene, (16, 16))


def test_disc_has_its_closed_form_on_the_modes_of_a_supported_plate():
    plate = solve_modes(scene_with(DISC), count=4, density=2.0)
    (x, y, radius), side = DISC["disc"], 0.2
    mass = plate.scene.plate.density * plate.scene.plate.thickness
    forces = plate.actuator_forces()[:, 0]
    for mode, (m, n) in ((0, (1, 1)), (3, (2, 2))):
        size = 2 / side / math.sqrt(mass)
        wave = math.pi / side * math.hypot(m, n)
        middle = size * math.sin(m * math.pi * x / side) * math.sin(n * math.pi * y / side)
        exact = middle * 2 * math.pi * radius * scipy.special.j1(wave * radius) / wave
        assert abs(forces[mode]) == pytest.approx(abs(exact), abs=1e-9 * size * math.pi * radius**2)


@pytest.mark.parametrize("shape", SAME, ids=lambda shape: next(iter(shape)))
@pytest.mark.parametrize("load", ["overlap", "moments", "nodes"])
def test_a_rectangle_in_other_words_is_the_same(shape, load):
    one, other = (scene_with(words).replace("grid.load", load) for words in (RECTANGLE, shape))
    np.testing.assert_allclose(patches(other), patches(one), atol=1e-12)
    attached = {"mass": 1e-3, "stiffness": 500.0}
    section = {"thickness": 2e-4, "young_modulus": 2e9, "density": 1500.0}
    integrals, masses = [], []
    for words, scene in ((RECTANGLE, one), (shape, other)):
        space = space_of(one)
        region = scene.actuators[0]
        integrals.append(space.region_integrals([region])[0])
        full = scene.with_tables(effects={"layers": [words | section], "oscillators": [words | attached]})
        masses.append((space_of(full).plate_mass, make_section(full).mass))
    np.testing.assert_allclose(integrals[1], integrals[0], rtol=0, atol=1e-12 * np.abs(integrals[0]).max())
    assert masses[1][0] == pytest.approx(masses[0][0], rel=1e-12)
    np.testing.assert_allclose(masses[1][1], masses[0][1], rtol=1e-12)


def test_shaped_patches_move_like_rectangles():
    """Loads and their slopes at other places, with a rectangle as a polygon beside a rectangle."""
    one, other = (scene_with(words) for words in (RECTANGLE, SAME[1]))
    areas = np.array([[[0.1, 0.14, 0.02, 0.08]]])
    for function in (load_integrals, load_slopes):
        values = [np.array(function(solve_modes(s, count=1).galerkin, areas)) for s in (one, other)]
        np.testing.assert_allclose(values[1], values[0], rtol=0, atol=1e-7 * np.abs(values[0]).max())


def test_disc_layer_by_modes_and_on_the_grid():
    """A layer on a whole disc of a plate: its mass is exact, and both engines agree on the first frequency."""
    layer = {"disc": (0.1, 0.1, 0.05), "thickness": 2e-4, "young_modulus": 2e9, "density": 1500.0}
    scene = scene_with(DISC, effects={"layers": [layer]})
    bare = 0.04 * scene.plate.density * scene.plate.thickness
    assert space_of(scene).plate_mass - bare == pytest.approx(math.pi * 0.05**2 * 0.3, rel=1e-9)
    section = make_section(scene)
    spacing, weight = 0.2 / 26, np.ones(27)
    weight[[0, -1]] = 0.5
    mass = spacing**2 * weight @ section.mass @ weight
    assert mass - bare == pytest.approx(math.pi * 0.05**2 * 0.3, rel=1e-6)
    with pytest.raises(SceneError, match=r"effects.layers\[1\].disc = .*: overlaps effects.layers\[0\]"):
        scene_with(DISC, effects={"layers": [layer, layer | {"disc": (0.15, 0.1, 0.02)}]})


def test_factor_of_shapes_over_the_outline():
    """The localization factor to 1e-5 between numbers of functions, time steps within their error, and a warning."""
    scene = Scene.parse(WATCH, "watch")
    drives, factors = np.ones((1, 3), complex), []
    for density in (0.7, 1.0):
        energy = ModalSolver(scene.replace("grid.modal_density", density)).run(drives).energy[0]
        factors.append(energy[1] / energy[0])
    assert factors[1] == pytest.approx(factors[0], abs=1e-5)
    energy = PlateSolver(scene.replace("grid.nodes", (53, 53)), "cpu").run(drives).energy[0]
    assert energy[1] / energy[0] == pytest.approx(factors[0], rel=0.03)
    x, radius, plate = 0.018, 0.005, 0.02  # the lens that two discs share
    one = radius**2 * math.acos((x**2 + radius**2 - plate**2) / (2 * x * radius))
    two = plate**2 * math.acos((x**2 + plate**2 - radius**2) / (2 * x * plate))
    kite = math.sqrt((-x + radius + plate) * (x + radius - plate) * (x - radius + plate) * (x + radius + plate)) / 2
    outside = 1 - (one + two - kite) / (math.pi * radius**2)
    space = solve_modes(scene, count=1).space
    assert 1 - space.region_areas(scene.actuators)[0] / (math.pi * radius**2) == pytest.approx(outside, rel=1e-6)
    lines = [line for line in warning_texts(scene, None) if "reach over the outline" in line]
    assert lines
    assert f'"rim" {100 * outside:.0f} %' in lines[0]


@pytest.mark.parametrize(
    ("shape", "right"),
    [
        ({"disc": (0.19, 0.1, 0.03)}, "actuators[0].disc ('0'): [0.19, 0.1, 0.03] is off the plate"),
        ({"disc": (0.1, 0.1, 0.03), "area": (0, 0.1, 0, 0.1)}, "disc: area is given too; write one of them"),
        ({"rectangle": (0.1, 0.1)}, "centre: is missing"),
        ({"disc": (0.1, 0.1, 0.03), "angle": 1.0}, "angle: not for disc"),
        (
            {"disc": (0.1, 0.1, 0.03), "kind": "piezo", "d31": -2e-10, "thickness": 1e-4, "young_modulus": 6e10},
            "disc: piezo patches are rectangles",
        ),
    ],
)
def test_bad_shapes_are_refused(shape, right):
    with pytest.raises(SceneError) as error:
        scene_with(shape)
    assert right in str(error.value)


def test_places_of_shapes_are_not_searched_in_time_steps():
    scene = scene_with(DISC, search={"position": {}})
    with pytest.raises(SceneError, match=r"search.position: in time steps only actuators with area move"):
        PlateSolver(scene, "cpu", per_plate=per_plate_of(scene))


def test_force_of_a_disc_is_that_of_its_area():
    scene = scene_with(DISC | {"force": 2.0})
    assert scene.actuators[0].magnitude == pytest.approx(2 / (math.pi * 0.03**2))
    assert Scene.parse(scene.to_toml(), "again") == scene


def test_a_lattice_is_its_oscillators_one_by_one():
    one = {"disc": (0.03, 0.02, 0.004), "mass": 1e-3, "stiffness": 2e3, "damping": 0.3}
    pitch = (0.04, 0.05)
    middles = [(0.03 + column * pitch[0], 0.02 + row * pitch[1]) for row in range(2) for column in range(3)]
    apart = [{**one, "disc": (*middle, 0.004)} for middle in middles]
    lattice = scene_of(effects={"oscillators": [{**one, "lattice": (3, 2), "pitch": pitch}]}, modal_density=0.5)
    written = scene_of(effects={"oscillators": apart}, modal_density=0.5)
    first, second = (ModalSolver(scene, "cpu").response.matrices for scene in (lattice, written))
    assert (first == second).all()
    assert lattice.effects.attachment_keys(lattice.plate) == ["effects.oscillators[0]"] * 6


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"lattice": (3, 2)}, r"lattice: write lattice = \[columns, rows\] with pitch"),
        ({"lattice": (3, 2), "pitch": (0.09, 0.05)}, r"last of lattice = \[3, 2\].*off the plate"),
        ({"lattice": (200, 51), "pitch": (1e-4, 1e-4)}, "10200 oscillators; at most 10000 are possible"),
    ],
)
def test_lattices_that_do_not_fit_are_refused(keys, message):
    one = {"disc": (0.03, 0.02, 0.004), "mass": 1e-3, "stiffness": 2e3, **keys}
    with pytest.raises((SceneError, ValueError), match=message):
        scene_of(effects={"oscillators": [one]})
