"""Positions to designs and scenes and back, the limits of drives, and the tables that are refused."""

import re

import numpy as np
import pytest

from support.scenes import areas_of, refused, scene_of
from warp_plate import Scene, SceneError
from warp_plate.plate.designs import Designs, scene_phasors
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.design_variables import at_highest_frequency, with_common_step
from warp_plate.problem.parametrization import paper_phasors, parametrization_of

ALL = {
    "magnitude": {"range": [0.5, 3.0]},
    "phase": {},
    "frequency": {"range": [200.0, 400.0], "own": True},
    "position": {"area": [0.0, 0.15, 0.02, 0.2]},
    "delay": {"range": [0.0, 0.005], "own": True},
}
BURST = {"frequency": 290.0, "burst": {"start": 0.001, "duration": 0.004}}
CHIRP = {"frequency": 290.0, "chirp": {"end_frequency": 400.0, "duration": 0.01}}
ELECTROSTATIC = {"frequency": 290.0, "electrostatic": {"gain": 1.0}}
SIGNAL = {"frequency": 290.0, "signal": {"file": "a.csv", "rate": 2e4}}
EQUAL = {"limits": {"equal_magnitudes": True}}
STRETCHING, STEADY = {"effects": {"stretching": {}}}, {"effects": {"loss_factor": {"eta": 0.02}}}
NARROW = [(0.05, 0.08, 0.05, 0.08), (0.1, 0.13, 0.1, 0.13)]


def parametrized(search=None, **tables):
    """Return the parametrization of a small scene, with a burst where its delay is searched."""
    search = search or {}
    return parametrization_of(scene_of(search=search, **({"drive": BURST, **tables} if "delay" in search else tables)))


def with_magnitudes(scene, *values):
    pairs = zip(scene.actuators, values, strict=True)
    return scene.with_tables(actuators=[actuator.model_dump() | {"magnitude": value} for actuator, value in pairs])


def positions_in(space, count=5, seed=1):
    return space.from_unit(np.random.default_rng(seed).random((count, space.dimension)))


def test_without_tables_it_is_the_papers_reading():
    """w₂ w₃ φ₂ φ₃ from −2 ... 2 without limits; w₁ = 1, φ₁ = 0, and Z = w exp(−iφ)."""
    parametrization = parametrized()
    space = parametrization.space
    assert space.names == ("magnitude of 1", "magnitude of 2", "phase of 1", "phase of 2")
    assert np.all((space.initial_lower == -2) & (space.initial_upper == 2))
    assert np.all(np.isinf([space.lower, space.upper, space.period]))
    assert parametrization.only_drives
    assert parametrization.quadratic
    position = np.array([[2.0, -3.0, np.pi / 2, 0.4]])
    designs = parametrization.designs(position)
    assert designs.only_drives
    assert np.array_equal(designs.drives, [[1, 2 * np.exp(-1j * np.pi / 2), -3 * np.exp(-0.4j)]])
    assert np.array_equal(paper_phasors(position), designs.drives)
    assert not np.signbit(designs.drives[0, 0].imag)
    assert parametrized(actuators=NARROW[:1]).space.dimension == 0


@pytest.mark.parametrize("tables", [{}, STRETCHING], ids=["linear", "nonlinear"])
def test_magnitudes_are_relative_to_the_scenes_largest(tables):
    parametrization = parametrization_of(with_magnitudes(scene_of(**tables), 0, 10, -20))
    assert parametrization.quadratic == (not tables)
    assert parametrization.designs(np.zeros((1, 4))).drives[0, 0] == 20
    assert parametrization_of(with_magnitudes(scene_of(**tables), 0, 0, 0)).unit == 1
    # A drive found is no stronger than the scene's strongest actuator if only ratios count.
    strong = parametrization.drive(np.array([-3.0, 0.5, 0.0, 0.0]))
    np.testing.assert_allclose(strong, np.array([1, -3, 0.5]) * (20 / 3 if not tables else 20))


def test_magnitudes_without_a_range_go_up_to_the_scenes_largest():
    """An amplifier's limit is written once, as the force of the actuators, and not again as a pressure."""
    space = parametrization_of(with_magnitudes(scene_of(search={"magnitude": {}, "phase": {}}), 3, 10, -20)).space
    np.testing.assert_array_equal(space.lower[:3], 0)
    np.testing.assert_array_equal(space.upper[:3], 20)


def test_each_table_adds_its_variables():
    """The rest stays as the scene has it; every variable has the limits of its table."""
    space = parametrized(ALL).space
    assert space.names == (
        *(f"{kind} of {index}" for kind in ("magnitude", "phase", "frequency") for index in range(3)),
        *(f"{axis} of {index}" for index in range(3) for axis in "xy"),
        *(f"delay of {index}" for index in range(3)),
    )
    assert np.array_equal(np.isfinite(space.period), [name.startswith("phase") for name in space.names])
    assert np.array_equal(np.isinf(space.lower), np.isfinite(space.period))
    assert np.allclose(space.initial_upper[3:6] - space.initial_lower[3:6], 2 * np.pi)
    assert np.array_equal([space.lower[6], space.upper[6], space.lower[0], space.upper[0]], [200, 400, 0.5, 3])
    some = parametrized({"phase": {"actuators": ["2"]}})
    assert some.space.names == ("phase of 2",)
    assert np.array_equal(np.abs(some.designs(np.array([[1.0]])).drives), [[1, 1, 1]])


def test_a_patch_stays_whole_within_its_area():
    """A side without room is fixed."""
    parametrization = parametrized({"position": {"area": [0.0, 0.15, 0.02, 0.2]}})
    for corner in (parametrization.space.lower, parametrization.space.upper):
        areas = areas_of(parametrization.scene_of(corner))
        assert np.all((areas[..., 0] >= [-1e-15, 0.02 - 1e-15]) & (areas[..., 1] <= [0.15 + 1e-15, 0.2 + 1e-15]))
        assert np.allclose(np.diff(areas), np.diff(areas_of(parametrization.scene)))
    flat = parametrized({"position": {"area": [0.0, 0.2, 0.1, 0.14]}}, actuators=[(0.02, 0.05, 0.1, 0.14)])
    assert flat.space.names == ("x of 0",)


def test_actuators_have_areas_of_their_own():
    """A strip along an edge, for one of them; the others stay in the common area."""
    strip, common = [0.0, 0.2, 0.0, 0.06], [0.0, 0.2, 0.1, 0.2]
    scene = scene_of(search={"position": {"area": common, "areas": {"1": strip}}})
    assert Scene.parse(scene.to_toml(), "panel.toml").search.position == scene.search.position
    parametrization = parametrization_of(scene)
    for corner in (parametrization.space.lower, parametrization.space.upper):
        for index, (x, y) in enumerate(areas_of(parametrization.scene_of(corner))):
            x0, x1, y0, y1 = strip if index == 1 else common
            assert x0 - 1e-15 <= x[0] < x[1] <= x1 + 1e-15
            assert y0 - 1e-15 <= y[0] < y[1] <= y1 + 1e-15


PHASES, DELAY = ("phase of 0", "phase of 1", "phase of 2"), {"delay": {"range": [0, 0.005]}}
MAGNITUDE, VELOCITY = {"magnitude": {"range": [0, 5]}, **EQUAL}, {"objectives": [{"kind": "velocity"}]}
MAGNITUDES, LIMITED = ("magnitude of 1", "magnitude of 2"), {"limits": {"magnitude": 1}}
LEVELS, QUIET = ("magnitude of 0", *MAGNITUDES), {"objectives": [{"kind": "displacement", "rest_limit": 1e-6}]}


@pytest.mark.parametrize(
    ("search", "tables", "names"),
    [
        ({"frequency": {"range": [200, 400]}}, {}, ("frequency",)),
        ({"frequency": {"range": [200, 400], "actuators": ["2", "1"]}}, {}, ("frequency of 1, 2",)),
        ({"phase": {}}, {}, PHASES),
        ({"phase": {}}, STEADY, PHASES[1:]),
        ({"phase": {}, **DELAY}, {}, (*PHASES, "delay")),
        ({"phase": {}, **MAGNITUDE}, {}, PHASES),
        (EQUAL, {}, PHASES),
        (EQUAL, STEADY, PHASES[1:]),
        (MAGNITUDE, STRETCHING, ("magnitude",)),
        ({**MAGNITUDE, **VELOCITY}, {}, ("magnitude",)),
        ({"objectives": [{"kind": "contrast"}]}, {}, (*MAGNITUDES, *PHASES[1:])),
        ({**VELOCITY, "limits": {"power": 1}}, {}, (*LEVELS, *PHASES)),
        ({**VELOCITY, "limits": {"power": 1}}, STEADY, (*LEVELS, *PHASES[1:])),
        (QUIET, STEADY, (*LEVELS, *PHASES[1:])),
        ({**QUIET, **EQUAL}, STEADY, ("magnitude", *PHASES[1:])),
        (LIMITED, {}, (*MAGNITUDES, *PHASES)),
        (LIMITED, STRETCHING, (*LEVELS, *PHASES)),
    ],
)
def test_shared_variables_and_those_that_change_nothing(search, tables, names):
    """A common phase of steady motion, or of the paper's ratio, and a common linear magnitude are fixed; but where the
    level of the drive counts, the magnitude of the first actuator is searched as well."""
    parametrization = parametrized(search, **tables)
    assert parametrization.space.names == names
    if names == ("magnitude",):
        assert np.array_equal(parametrization.designs(np.array([[3.0]])).drives, [[3, 3, 3]])


@pytest.mark.parametrize("limits", [{"magnitude": 0.5}, {"power": 0.02}, {"magnitude": 3.0, "power": 20.0}])
@pytest.mark.parametrize("tables", [{}, STRETCHING])
@pytest.mark.parametrize("search", [{}, {"magnitude": {"range": [0.0, 10.0]}, "phase": {}}, {"phase": {}}])
def test_no_drive_exceeds_the_limits(random, limits, tables, search):
    """|Z| of each actuator and Σ|Z|² stay below the amplifier's limits, also in the scene of the position."""
    parametrization = parametrized({**search, "limits": limits}, **tables)
    position = random.normal(0, 10, parametrization.space.dimension)
    phasors = parametrization.designs(position[None]).drives[0]
    assert np.allclose(scene_phasors(parametrization.scene_of(position)), phasors, rtol=1e-15, atol=1e-29)
    assert np.abs(phasors).max() <= limits.get("magnitude", np.inf) * (1 + 1e-12)
    assert (np.abs(phasors) ** 2).sum() <= limits.get("power", np.inf) * (1 + 1e-12)


def test_designs_do_not_depend_on_how_a_batch_is_cut():
    """Twelve squares, which NumPy would add in another order for one plate alone; and more plates than a block."""
    areas = [(0.01 + 0.015 * index, 0.02 + 0.015 * index, 0.05, 0.1) for index in range(12)]
    search = {"magnitude": {"range": [0.0, 1.0]}, "phase": {}, "limits": {"power": 0.5}}
    parametrization = parametrized(search, actuators=areas)
    positions = positions_in(parametrization.space, 20_000)
    phasors = parametrization.designs(positions).drives
    for row in (0, 7, 8447, 8448, 19_999):
        assert parametrization.designs(positions[[row]]).drives.tobytes() == phasors[row].tobytes()


TO_400, TO_6000 = ({"frequency": {"range": [200.0, end]}} for end in (400.0, 6000.0))
COARSE = {"nodes": (9, 9), "time_step": 1e-4}


@pytest.mark.parametrize(
    ("search", "tables", "words"),
    [
        ({"phase": {"actuators": ["7"]}}, {}, ["search.phase.actuators[0] = '7'", "0, 1, 2"]),
        ({"phase": {"actuators": ["1", "1"]}}, {}, ["search.phase.actuators[1] = '1'", "twice"]),
        ({"delay": {"range": [0, 0.001]}}, {}, ["search.delay", "[drive.burst]"]),
        ({"delay": {"range": [0, 0.5]}}, {"drive": BURST}, ["search.delay.range = [0.0, 0.5]", "window.end = 0.012"]),
        ({"position": {}}, {"load": "nodes"}, ["search.position", '"overlap"', '"moments"']),
        ({"position": {"area": [0, 0.02, 0, 0.2]}}, {}, ["search.position.area", "0.02 m long along x", "0.03 m"]),
        ({"position": {"area": [0, 0.03, 0, 0.2], "actuators": ["1"]}}, {"actuators": NARROW}, ["move it there"]),
        ({"position": {"areas": {"7": [0, 0.1, 0, 0.1]}}}, {}, ["search.position.areas.7", "0, 1, 2"]),
        ({"position": {"areas": {"1": [0, 0.02, 0, 0.2]}}}, {}, ["search.position.areas.1 = [0.0, 0.02", "0.05 m"]),
        (TO_400, {"drive": CHIRP}, ["search.frequency", "drive.chirp"]),
        (TO_400, {"drive": SIGNAL}, ["search.frequency", "drive.signal"]),
        ({"phase": {}}, {"actuators": NARROW[:1], **STEADY}, ["search: ", "[search.frequency]"]),
        ({**EQUAL, "magnitude": {"range": [0, 1], "actuators": ["1"]}}, {}, ["search.magnitude.actuators", "equal_"]),
        ({**EQUAL, "phase": {}}, {"magnitudes": (1, 2, 3)}, ["equal_magnitudes", "from 1 to 3"]),
        ({"phase": {}}, {"magnitudes": (0, 0, 0)}, ["all 0", "[search.magnitude]"]),
        ({"objectives": [{"kind": "velocity"}]}, {}, ["search.objectives[0].kind = 'velocity'", "[search.magnitude]"]),
        (TO_6000, COARSE, ["search.frequency.range = ", "0.0001 s carries less than 5000 Hz"]),
        # The force has twice the voltage's frequency.
        (TO_6000, {**COARSE, "drive": ELECTROSTATIC}, ["0.0001 s carries less than 2500 Hz"]),
    ],
)
def test_tables_that_do_not_fit_are_refused_in_one_line(search, tables, words):
    made = scene_of(search=search, **{key: value for key, value in tables.items() if key != "magnitudes"})
    if "magnitudes" in tables:
        made = with_magnitudes(made, *tables["magnitudes"])
    line = refused(lambda: parametrization_of(with_common_step(made)))
    assert all(word in line for word in words)


def test_the_time_step_fits_the_upper_end_of_the_range():
    """A step that the scene leaves out is chosen for 20 steps a period there; too many are refused with the highest
    frequency that is possible."""

    def searching_up_to(end):
        return scene_of(nodes=(9, 9), search={"frequency": {"range": [200.0, end]}})

    plain, stepped = scene_of(nodes=(9, 9)), with_common_step(searching_up_to(3000.0))
    assert stepped.grid.time_step <= 1 / (20 * 3000)
    assert make_scheme(plain).time_step > stepped.grid.time_step
    assert parametrization_of(stepped).scene_of(np.array([3000.0])).grid.time_step == stepped.grid.time_step
    assert with_common_step(plain) == plain
    for grid in ({"nodes": (9, 9)}, {"accuracy": 0.1}):
        with pytest.raises(SceneError, match=r"^search\.frequency\.range = \[200.0, 1000000000.0\]") as refusal:
            at_highest_frequency(searching_up_to(1e9).with_tables(grid=grid))
        most = float(re.search(r"([\d.e+]+) Hz or lower", str(refusal.value))[1])
        kept = searching_up_to(most * 0.999)
        assert 0.9e8 < kept.window.end / with_common_step(kept).grid.time_step <= 1e8


@pytest.mark.parametrize("search", [{}, ALL, {"phase": {}}, {"frequency": {"range": [200, 400]}}])
def test_designs_scenes_and_positions_agree(search):
    """The scene of a position has its drive to the last bit, its frequencies, places and bursts."""
    parametrization = parametrized(search)
    positions = positions_in(parametrization.space)
    designs = parametrization.designs(positions)
    for index, position in enumerate(positions[:2]):
        scene = parametrization.scene_of(position)
        assert np.array_equal(scene_phasors(scene), designs.drives[index])
        assert scene.grid == parametrization.scene.grid
        if designs.frequency is not None:
            found = [actuator.frequency or scene.drive.frequency for actuator in scene.actuators]
            assert np.array_equal(found, designs.frequency[index])
        if designs.centre is not None:
            assert np.allclose(designs.centre[index], areas_of(scene).mean(axis=2), rtol=1e-14)
        if designs.delay is not None:
            assert np.array_equal([actuator.delay for actuator in scene.actuators], designs.delay[index])
    again = parametrization.positions_of(designs)
    assert np.allclose(parametrization.designs(again).drives, designs.drives, rtol=1e-13)
    if search:  # a magnitude below zero is one above with another phase
        assert np.allclose(again, positions, rtol=1e-12)
        periods = np.where(np.isfinite(parametrization.space.period), parametrization.space.period, 0)
        turned = parametrization.designs(positions - 3 * periods)
        assert np.allclose(turned.drives, designs.drives, rtol=0, atol=1e-13)
    else:  # the whole drive is turned and scaled until its first actuator fits
        turned = parametrization.positions_of(Designs(designs.drives * 3 * np.exp(1j)))
        assert np.allclose(parametrization.designs(turned).drives, designs.drives, rtol=1e-13)


@pytest.mark.parametrize("search", [{"phase": {}}, {"magnitude": {"range": [0.5, 3.0]}, "phase": {}}])
@pytest.mark.parametrize("power", [1.0, 100.0])
def test_drives_have_positions_beside_fixed_signs_and_under_a_power(search, power):
    """A drive that was scaled down below its range has one too."""
    limited = {**search, "objectives": [{"kind": "velocity"}], "limits": {"power": power}}
    parametrization = parametrization_of(with_magnitudes(scene_of(search=limited), 1.0, -0.5, 2.0))
    drives = parametrization.designs(positions_in(parametrization.space)).drives
    again = parametrization.designs(parametrization.positions_of(Designs(drives))).drives
    assert np.allclose(again, drives, rtol=1e-12)


def test_a_drive_without_the_first_actuator_is_not_turned():
    """Its phase is fixed, and says nothing where the magnitude is 0; others count from rest."""
    scene = with_magnitudes(scene_of(search={"phase": {"actuators": ["2"]}}), 0.0, 1.0, 1.0)
    parametrization = parametrization_of(scene.replace("actuators[0].phase", 1.0))
    positions = positions_in(parametrization.space)
    assert np.allclose(parametrization.positions_of(parametrization.designs(positions)), positions, rtol=1e-12)


def test_drives_are_scaled_where_only_ratios_matter_and_clipped_elsewhere():
    position = np.array([[4.0, -0.9, 0.0, 0.0, 0.0]])
    small = parametrized({"limits": {"magnitude": 0.5}}).designs(position).drives
    assert np.allclose(small, [[0.125, 0.5, -0.1125]], rtol=1e-14)
    powered = parametrized({"limits": {"power": 4.0}}).designs(position).drives
    assert np.allclose(powered, np.array([[1, 4, -0.9]]) * 2 / np.sqrt(17.81), rtol=1e-14)
    leveled = np.insert(position, 0, 0.5, axis=1)
    clipped = parametrized({"limits": {"magnitude": 0.75}}, **STRETCHING)
    assert np.allclose(clipped.designs(leveled).drives, [[0.5, 0.75, -0.75]])
    again = clipped.positions_of(clipped.designs(leveled))
    assert np.allclose(clipped.designs(again).drives, [[0.5, 0.75, -0.75]])
