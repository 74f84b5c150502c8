"""From positions to designs and scenes and back, the limits of drives, and what the tables may not ask for."""

import re

import numpy as np
import pytest
from conftest import scene_of
from hypothesis import given
from hypothesis import strategies as st

from warp_plate import SceneError
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.design_variables import at_highest_frequency, with_common_step
from warp_plate.problem.parametrization import parametrization_of
from warp_plate.problem.problem import make_problem

ALL = {
    "magnitude": {"range": [0.5, 3.0]},
    "phase": {},
    "frequency": {"range": [200.0, 400.0], "own": True},
    "position": {"area": [0.0, 0.15, 0.02, 0.2]},
    "delay": {"range": [0.0, 0.005], "own": True},
}
BURST = {"frequency": 290.0, "burst": {"start": 0.001, "duration": 0.004}}
CHIRP = {"frequency": 290.0, "chirp": {"end_frequency": 400.0, "duration": 0.01}}
EQUAL = {"limits": {"equal_magnitudes": True}}
STRETCHING = {"effects": {"stretching": {}}}


def with_search(search, **tables):
    tables = {"drive": BURST, **tables} if "delay" in search else tables
    return scene_of(search=search, **tables)


def positions_in(space, count=5, seed=1):
    low, high = np.maximum(space.lower, space.initial_lower), np.minimum(space.upper, space.initial_upper)
    return low + (high - low) * np.random.default_rng(seed).random((count, space.dimension))


NARROW = [(0.05, 0.08, 0.05, 0.08), (0.1, 0.13, 0.1, 0.13)]


def test_without_tables_it_is_the_papers_reading():
    """w₂ w₃ φ₂ φ₃ from −2 ... 2 without limits; w₁ = 1, φ₁ = 0, and Z = w exp(−iφ)."""
    variables = parametrization_of(scene_of())
    space = variables.space
    assert space.names == ("magnitude of 1", "magnitude of 2", "phase of 1", "phase of 2")
    assert np.all(space.initial_lower == -2)
    assert np.all(space.initial_upper == 2)
    assert np.all(np.isinf([space.lower, space.upper, space.period]))
    assert variables.only_drives
    assert variables.quadratic
    designs = variables.designs(np.array([[2.0, -3.0, np.pi / 2, 0.4]]))
    assert designs.only_drives
    assert np.array_equal(designs.drives, [[1, 2 * np.exp(-1j * np.pi / 2), -3 * np.exp(-0.4j)]])
    assert not np.signbit(designs.drives[0, 0].imag)


def test_magnitudes_of_a_scene_that_is_not_linear_are_parts_of_its_largest():
    actuators = [
        {"name": str(one), "area": [0.03 + 0.05 * one, 0.06 + 0.05 * one, 0.03, 0.06], "magnitude": 10.0 * one}
        for one in range(3)
    ]
    scene = scene_of(**STRETCHING).with_tables(actuators=actuators)
    assert not parametrization_of(scene).quadratic
    assert parametrization_of(scene).designs(np.zeros((1, 4))).drives[0, 0] == 20


def test_one_actuator_leaves_the_papers_reading_no_choice():
    assert parametrization_of(scene_of(actuators=[(0.05, 0.08, 0.05, 0.08)])).space.dimension == 0


def test_each_table_frees_what_it_says():
    """The rest stays as the scene has it; every number has the limits that its table gives."""
    variables = parametrization_of(with_search(ALL))
    space = variables.space
    assert space.names[:4] == ("magnitude of 0", "magnitude of 1", "magnitude of 2", "phase of 0")
    assert space.names[6:] == (
        *(f"frequency of {one}" for one in range(3)),
        *(f"{axis} of {one}" for one in range(3) for axis in "xy"),
        *(f"delay of {one}" for one in range(3)),
    )
    assert np.array_equal(np.isfinite(space.period), [name.startswith("phase") for name in space.names])
    assert np.array_equal(np.isinf(space.lower), np.isfinite(space.period))
    assert np.allclose(space.initial_upper[3:6] - space.initial_lower[3:6], 2 * np.pi)
    frees_phase = parametrization_of(scene_of(search={"phase": {"actuators": ["2"]}}))
    assert frees_phase.space.names == ("phase of 2",)
    assert np.array_equal(np.abs(frees_phase.designs(np.array([[1.0]])).drives), [[1, 1, 1]])


def test_a_patch_stays_whole_within_its_area():
    variables = parametrization_of(with_search({"position": {"area": [0.0, 0.15, 0.02, 0.2]}}))
    space, scene = variables.space, variables.scene
    for corner in (space.lower, space.upper):
        for before, after in zip(scene.actuators, variables.scene_of(corner).actuators, strict=True):
            x0, x1, y0, y1 = after.area
            assert x0 >= -1e-15
            assert x1 <= 0.15 + 1e-15
            assert y0 >= 0.02 - 1e-15
            assert y1 <= 0.2 + 1e-15
            assert x1 - x0 == pytest.approx(before.area[1] - before.area[0])
            assert y1 - y0 == pytest.approx(before.area[3] - before.area[2])


def test_a_side_without_room_is_held():
    """An area as high as the patch leaves it only its x."""
    scene = scene_of(actuators=[(0.02, 0.05, 0.1, 0.14)], search={"position": {"area": [0.0, 0.2, 0.1, 0.14]}})
    assert parametrization_of(scene).space.names == ("x of 0",)


@pytest.mark.parametrize(
    ("search", "names"),
    [
        ({"frequency": {"range": [200, 400]}}, ("frequency",)),
        ({"frequency": {"range": [200, 400], "actuators": ["2", "1"]}}, ("frequency of 1, 2",)),
        ({"delay": {"range": [0, 0.005]}}, ("delay",)),
        ({"phase": {}}, ("phase of 1", "phase of 2")),
        ({"phase": {}, "delay": {"range": [0, 0.005]}}, ("phase of 0", "phase of 1", "phase of 2", "delay")),
        ({"magnitude": {"range": [0, 1]}, "phase": {}, **EQUAL}, ("phase of 1", "phase of 2")),
        (EQUAL, ("phase of 1", "phase of 2")),
    ],
)  # fmt: skip
def test_what_is_shared_and_what_changes_nothing(search, names):
    """A common phase of a steady motion and a common magnitude of a linear one are held."""
    assert parametrization_of(with_search(search)).space.names == names


def test_equal_magnitudes_are_one_number_where_size_matters():
    search = {"magnitude": {"range": [0, 5]}, "limits": {"equal_magnitudes": True}}
    variables = parametrization_of(scene_of(search=search, **STRETCHING))
    assert variables.space.names == ("magnitude",)
    assert np.array_equal(variables.designs(np.array([[3.0]])).drives, [[3, 3, 3]])
    louder = {**search, "objectives": [{"kind": "velocity"}]}
    assert parametrization_of(scene_of(search=louder)).space.names == ("magnitude",)


def test_phases_wrap():
    variables = parametrization_of(scene_of(search={"phase": {}}))
    positions = positions_in(variables.space)
    for turns in (-3, 1, 40):
        shifted = variables.designs(positions + turns * variables.space.period)
        assert np.allclose(shifted.drives, variables.designs(positions).drives, rtol=0, atol=1e-13)


@pytest.mark.parametrize("search", [{}, ALL, {"frequency": {"range": [200, 400]}}])
def test_designs_and_scenes_agree(search):
    """The scene of a position has its drive to the last bit, its frequencies, places and bursts."""
    variables = parametrization_of(with_search(search))
    for position in positions_in(variables.space):
        designs, scene = variables.designs(position[None]), variables.scene_of(position)
        assert np.array_equal(scene_phasors(scene), designs.drives[0])
        for index, actuator in enumerate(scene.actuators):
            if designs.frequency is not None:
                assert (actuator.frequency or scene.drive.frequency) == designs.frequency[0, index]
            if designs.centre is not None:
                x0, x1, y0, y1 = actuator.area
                assert np.allclose(designs.centre[0, index], [(x0 + x1) / 2, (y0 + y1) / 2], rtol=1e-14)
            if designs.delay is not None:
                assert actuator.delay == designs.delay[0, index]
        assert scene.grid == variables.scene.grid


@pytest.mark.parametrize("search", [{}, ALL, {"phase": {}}, {"delay": {"range": [0, 0.005]}}])
def test_positions_of_designs_are_the_positions_they_came_from(search):
    variables = parametrization_of(with_search(search))
    positions = positions_in(variables.space)
    designs = variables.designs(positions)
    assert np.allclose(variables.designs(variables.positions_of(designs)).drives, designs.drives, rtol=1e-13)
    if search:  # a magnitude below zero is one above with another phase
        assert np.allclose(variables.positions_of(designs), positions, rtol=1e-12)


def test_a_drive_is_turned_and_scaled_until_its_first_actuator_fits():
    variables = parametrization_of(scene_of())
    designs = variables.designs(positions_in(variables.space))
    other = type(designs)(designs.drives * 3 * np.exp(1j))
    again = variables.designs(variables.positions_of(other)).drives
    assert np.allclose(again, designs.drives, rtol=1e-13)


LIMITS = {"magnitude": st.none() | st.floats(1e-3, 1e3), "power": st.none() | st.floats(1e-3, 1e3)}


@given(
    limits=st.fixed_dictionaries(LIMITS),
    values=st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6),
    tables=st.sampled_from([{}, STRETCHING]),
    search=st.sampled_from([{}, {"magnitude": {"range": [0.0, 10.0]}, "phase": {}}, {"phase": {}}]),
)
def test_no_drive_breaks_the_limits(limits, values, tables, search):
    """|Z| of each actuator and Σ|Z|² stay below what the amplifier can do, whatever a method asks for; and so they do
    in the scene that is found."""
    variables = parametrization_of(scene_of(search={**search, "limits": limits}, **tables))
    position = np.array(values[: variables.space.dimension])
    drives = variables.designs(position[None]).drives[0]
    assert np.allclose(scene_phasors(variables.scene_of(position)), drives, rtol=1e-15, atol=1e-29)
    if limits["magnitude"] is not None:
        assert np.abs(drives).max() <= limits["magnitude"] * (1 + 1e-12)
    if limits["power"] is not None:
        assert (np.abs(drives) ** 2).sum() <= limits["power"] * (1 + 1e-12)
    assert np.isfinite(drives).all()


def test_where_only_ratios_matter_the_whole_drive_is_scaled_down():
    """So that a small amplifier costs no localization; a drive whose size matters is cut off actuator by actuator."""
    position = np.array([[4.0, 0.5, 0.0, 0.0]])
    free, small = (
        parametrization_of(scene_of(search={"limits": limits})).designs(position).drives
        for limits in ({}, {"magnitude": 0.5})
    )
    assert np.allclose(small / small[0, 0], free / free[0, 0], rtol=1e-14)
    assert np.abs(small).max() == pytest.approx(0.5)
    cut = parametrization_of(scene_of(search={"limits": {"magnitude": 0.75}}, **STRETCHING)).designs(position).drives
    assert np.allclose(np.abs(cut), [[0.75, 0.75, 0.5]])


def test_the_time_step_fits_the_upper_end_of_the_range():
    """What the scene leaves out is chosen for 20 steps a period there."""
    scene = scene_of(nodes=(9, 9), search={"frequency": {"range": [200.0, 3000.0]}})
    free = with_common_step(scene)
    assert free.grid.time_step <= 1 / (20 * 3000)
    assert make_scheme(scene_of(nodes=(9, 9))).time_step > free.grid.time_step
    assert parametrization_of(free).scene_of(np.array([3000.0])).grid.time_step == free.grid.time_step
    assert with_common_step(scene_of()) == scene_of()


@pytest.mark.parametrize(
    ("search", "tables", "words"),
    [
        ({"phase": {"actuators": ["7"]}}, {}, ["search.phase.actuators[0] = '7'", "there are: 0, 1, 2"]),
        ({"phase": {"actuators": ["1", "1"]}}, {}, ["search.phase.actuators[1] = '1'", "twice"]),
        ({"magnitude": {"range": [0, 1], "actuators": []}}, {}, ["search.magnitude.actuators = []", "at least 1 text"]),
        ({"delay": {"range": [0, 0.001]}}, {"drive": {"frequency": 290.0}}, ["search.delay", "[drive.burst]"]),
        ({"delay": {"range": [0, 0.5]}}, {}, ["search.delay.range = [0.0, 0.5]", "window.end = 0.012"]),
        ({"position": {}}, {"load": "nodes"}, ["search.position", '"overlap"', '"moments"']),
        ({"position": {"area": [0, 0.02, 0, 0.2]}}, {}, ["search.position.area", "0.02 m long along x", "0.03 m"]),
        ({"position": {"area": [0, 0.03, 0, 0.2], "actuators": ["1"]}}, {"actuators": NARROW}, ["no longer along x"]),
        ({"position": {"area": [0, 0.3, 0, 0.2]}}, {}, ["search.position.area", "reaches off the plate"]),
        ({"frequency": {"range": [200, 400]}}, {"drive": CHIRP}, ["search.frequency", "drive.chirp"]),
        ({"phase": {}}, {"actuators": [(0.05, 0.08, 0.05, 0.08)]}, ["nothing is free", "[search.frequency]"]),
        ({**EQUAL, "magnitude": {"range": [0, 1], "actuators": ["1"]}}, {}, ["search.magnitude.actuators", "equal_"]),
        ({"objectives": [{"kind": "velocity"}]}, {}, ["search.objectives[0].kind = 'velocity'", "[search.magnitude]"]),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_told_in_one_line(search, tables, words):
    whole = {"drive": BURST, **tables} if "delay" in search else tables
    base = {key: whole[key] for key in whole if key in ("load", "actuators")}
    other = {key: whole[key] for key in whole if key not in base}
    with pytest.raises(SceneError) as told:
        parametrization_of(scene_of(**base).with_tables(search=search, **other))
    for word in words:
        assert word in str(told.value)
    assert "\n" not in str(told.value)


def test_a_file_has_its_own_frequencies():
    drive = {"frequency": 290.0, "signal": {"file": "a.csv", "rate": 2e4}}
    made = scene_of(drive=drive, search={"frequency": {"range": [100.0, 400.0]}})
    with pytest.raises(SceneError, match=r"search\.frequency: drive\.signal says which frequencies there are"):
        parametrization_of(with_common_step(made))


def test_magnitudes_of_zero_that_are_held_move_nothing():
    made = scene_of()
    actuators = [{**one.model_dump(), "magnitude": 0.0} for one in made.actuators]
    with pytest.raises(SceneError, match=r"all 0 and held.*search\.magnitude"):
        parametrization_of(made.with_tables(actuators=actuators, search={"phase": {}}))
    assert parametrization_of(made.with_tables(actuators=actuators, search={"magnitude": {"range": [0, 1]}})).numbers
    assert parametrization_of(
        made.with_tables(actuators=actuators)
    ).numbers  # the paper's reading has magnitudes of its own


def test_a_time_step_that_carries_too_little_is_told_with_its_numbers():
    scene = scene_of(nodes=(9, 9), time_step=1e-4, search={"frequency": {"range": [200.0, 6000.0]}})
    with pytest.raises(SceneError, match=r"search.frequency.range = .*0.0001 s carries less than 5000 Hz"):
        make_problem(scene, "cpu")


@pytest.mark.parametrize("grid", [{"nodes": (9, 9)}, {"accuracy": 0.1}])
def test_a_range_that_takes_too_many_steps_is_told_with_its_numbers(grid):
    made = scene_of().with_tables(grid=grid, search={"frequency": {"range": [200.0, 1e9]}})
    line = r"^search\.frequency\.range = \[200.0, 1000000000.0\].*end the range at"
    with pytest.raises(SceneError, match=line) as told:
        at_highest_frequency(made)
    most = float(re.search(r"at ([\d.e+]+) Hz or lower", str(told.value))[1])
    kept = scene_of(nodes=(9, 9), search={"frequency": {"range": [200.0, most * 0.999]}})
    assert 0.9e8 < kept.window.end / with_common_step(kept).grid.time_step <= 1e8


def test_magnitudes_that_differ_and_are_held_cannot_be_equal():
    scene = scene_of()
    actuators = [one.model_dump() | {"magnitude": 1.0 + index} for index, one in enumerate(scene.actuators)]
    search = {"phase": {}, "limits": {"equal_magnitudes": True}}
    with pytest.raises(SceneError, match=r"search.limits.equal_magnitudes.*from 1 to 3"):
        parametrization_of(scene.with_tables(actuators=actuators, search=search))


def test_limits_of_power_do_not_see_how_a_batch_is_cut():
    """Of many actuators, whose squares NumPy would add up in another order for one plate alone."""
    areas = [(0.01 + 0.015 * index, 0.02 + 0.015 * index, 0.05, 0.1) for index in range(12)]
    search = {"magnitude": {"range": [0.0, 1.0]}, "limits": {"power": 0.5}}
    variables = parametrization_of(scene_of(actuators=areas, search=search))
    positions = np.random.default_rng(3).uniform(0, 1, (65, variables.space.dimension))
    alone = np.concatenate([variables.designs(positions[[row]]).drives for row in range(65)])
    assert alone.tobytes() == np.ascontiguousarray(variables.designs(positions).drives).tobytes()
