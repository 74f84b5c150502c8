"""The tables of outlines and holes: read, written, and what is refused."""

import math

import numpy as np
import pytest

from support.scenes import refused
from support.scenes_of_outlines import outlined
from warp_plate import Scene, check, modes
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.resolve import resolve
from warp_plate.scene.grid import Grid

DISC = {"disc": (0.1, 0.1, 0.1)}
HOLE = {"disc": (0.1, 0.15, 0.02), "edge": {"translation": 1e3}}
PART = {"edge": "free", "from": (0.2, 0.1), "to": (0.1, 0.2)}


def test_the_size_is_that_of_the_outline_and_not_written():
    scene = outlined(DISC, "supported", [HOLE], [PART])
    assert scene.plate.size == pytest.approx((0.2, 0.2))
    assert scene.plate.area == pytest.approx(math.pi * (0.01 - 0.0004))
    assert dict(scene.edge_conditions) == {
        "outline": "supported",
        "parts[0]": "free",
        "holes[0]": scene.plate.holes[0].edge,
    }
    assert "size" not in scene.to_toml()
    assert Scene.parse(scene.to_toml(), "again") == scene
    assert outlined(DISC).replace("plate.outline.disc", (0.11, 0.11, 0.1)).plate.size == pytest.approx((0.21, 0.21))


def test_a_turned_rectangle_touches_the_axes():
    scene = outlined({"rectangle": (0.2, 0.1), "angle": 0.5, "corner_radius": 0.02})
    assert scene.outline.bounds[::2] == pytest.approx((0, 0), abs=1e-15)
    assert scene.plate.area == pytest.approx(0.02 - (4 - math.pi) * 0.0004)


def test_an_edge_is_clamped_unless_it_is_written():
    scene = outlined(DISC)
    tables = scene.model_dump()
    del tables["edges"], tables["grid"]
    assert Scene.from_tables(tables).edges.outline == "clamped"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"plate.outline": {"disc": (0.1, 0.1, 0.1), "polygon": [(0, 0), (1, 0), (0, 1)]}},
            "polygon: disc is given too",
        ),
        ({"plate.outline": {}}, "no shape is given; write one of disc, ellipse, rectangle, polygon, path"),
        ({"plate.outline": {"disc": (0.1, 0.1, 0.1), "corner_radius": 0.01}}, "corner_radius: not for disc"),
        ({"plate.outline": {"rectangle": (0.2, 0.1), "corner_radius": 0.06}}, "corner_radius: 0.06 m does not fit"),
        ({"plate.outline": {"disc": (0.0, 0.1, 0.1)}}, "plate.outline: reaches to x = -0.1, y = 0 m; move it"),
        ({"plate.outline": {"polygon": [(0, 0), (0.2, 0.2), (0.2, 0), (0, 0.2)]}}, "side 0 crosses or touches side 2"),
        ({"plate.size": (0.2, 0.2)}, "plate.size: outline is given too"),
        ({"plate.holes": [{"disc": (0.1, 0.4, 0.01)}]}, "plate.holes[0]: is off the plate"),
        ({"plate.holes": [{"rectangle": (0.1, 0.04)}]}, "plate.holes[0].centre: is missing"),
        ({"supports": [{"point": (0.01, 0.01)}]}, "supports[0].point: [0.01, 0.01] is off the plate"),
        (
            {"supports": [{"line": ((0.05, 0.1), (0.05, 0.1))}]},
            "supports[0].line: [[0.05, 0.1], [0.05, 0.1]] has no length",
        ),
        ({"supports": [{"ring": (0.1, 0.1, 0.12)}]}, "supports[0].ring: leaves the plate; keep all of it inside"),
        ({"supports": [{}]}, "supports[0].point: write one of point, line and ring"),
        ({"actuators[0].area": (0.0, 0.01, 0.0, 0.01)}, "actuators[0].area: [0.0, 0.01, 0.0, 0.01] is off the plate"),
        ({"edges.left": "free"}, "edges.left: the plate has an outline; write edges.outline"),
        ({"edges.parts": [{**PART, "to": (0.1, 0.1)}]}, "edges.parts[0].to_point: [0.1, 0.1] is 0.1 m off the outline"),
        (
            {"plate.outline": {"polygon": [(0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0.1, 0.2), (0, 0.2)]}},
            "edges.outline: supported at the re-entrant corner of side 2 and side 3 near (0.1, 0.1) m",
        ),
        ({"record.points": [(0.01, 0.01)]}, "record.points[0]: [0.01, 0.01] is off the plate; move it inside"),
        ({"effects.stretching": {}}, "effects.stretching: not with plate.outline"),
    ],
)
def test_wrong_tables_are_refused_in_one_line(changes, message):
    ((key, value),) = changes.items()
    edge = "supported" if "supported" in message else "clamped"
    assert message in refused(outlined(DISC, edge).replace, key, value)


@pytest.mark.parametrize(
    ("outline", "start"),
    [
        ({"polygon": [(0, 0), (0.2, 0.2), (0.2, 0), (0, 0.2)]}, "plate.outline: side 0 crosses or touches side 2"),
        (
            {"rectangle": (0.2, 0.1), "corner_radius": 1e-30},
            "plate.outline: the arc at corner 0 has no length; write no point twice and no arc of less than 2e-10 m",
        ),
        ({"path": [(0, 0), (0.1,)]}, "plate.outline.path[1]: 1 numbers; write 2 (straight), 5 (arc) or 7"),
    ],
)
def test_what_is_wrong_with_an_outline_is_named_by_its_key(outline, start):
    assert refused(outlined(DISC).replace, "plate.outline", outline).startswith(start)


def test_a_rectangle_by_its_size_takes_no_keys_of_outlines():
    scene = Scene.load("paper")
    assert "edges.outline: the plate has no outline" in refused(scene.replace, "edges.outline", "free")
    assert "plate.holes: need an outline" in refused(scene.replace, "plate.holes", [{"disc": (0.1, 0.1, 0.01)}])


def test_plates_with_outlines_are_solved_by_modes_unless_a_grid_is_written():
    scene = outlined(DISC)
    assert resolve(scene, "cpu").engine == "steps"
    tables = scene.model_dump()
    del tables["grid"]
    grids = {}, {"grid": {"modal_density": 0.6}}, {"grid": {"accuracy": 0.2}}
    for grid, purpose in zip(grids, ("search", "simulate", "search"), strict=True):
        assert resolve(Scene.from_tables(tables | grid), "cpu", purpose=purpose).engine == "modes"


def test_supports_are_stepped_where_a_grid_is_written():
    scene = outlined(DISC, supports=[{"point": (0.1, 0.1)}])
    assert resolve(scene, "cpu", purpose="simulate").engine == "steps"
    unwritten = scene.model_copy(update={"grid": Grid()})
    assert resolve(unwritten, "cpu", purpose="simulate").engine == "modes"


def test_plates_that_are_not_stepped_are_checked():
    scene = outlined(DISC, {"translation": 1e3, "rotation": 1.0})
    checked = check(scene, "cpu")
    assert checked.path == "modal"
    assert not checked.numerics
    assert checked.slowest_frequency == pytest.approx(modes(scene).frequencies[0])


@pytest.mark.parametrize(
    ("edge", "holes", "effects", "key"),
    [
        ({"translation": 1e5}, [], {}, "edges.outline"),
        ("clamped", [{"disc": (0.1, 0.15, 0.02), "edge": {"rotation": 5.0}}], {}, "plate.holes[0].edge"),
        ("free", [], {"tension": {"x": 10.0, "y": 10.0}}, "plate.outline"),
        ("clamped", [], {"material_damping": {"time": 1e-6}}, "plate.outline"),
    ],
)
def test_what_has_no_time_steps_on_an_outline_is_taken_by_modes(edge, holes, effects, key):
    scene = outlined(DISC, edge, holes, effects=effects, modal_density=0.5)
    assert resolve(scene, "cpu").engine == "modes"
    assert (message := refused(scene.check_stepped)).startswith(f"{key}: ")
    assert message == refused(make_scheme, scene)
    run = ModalSolver(scene, "cpu").run([[1.0]], points=[(0.1, 0.12)])
    assert run.energy[0, 1] > 0
    assert np.abs(run.trace).max() > 0
