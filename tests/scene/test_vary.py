"""Points of sweeps: numbers of a scene by key, ranges, grids and Latin hypercubes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.scenes import refused
from warp_plate import Scene, SceneError
from warp_plate.scene.keys import label_of, resolved_key, scalar_keys, unit_of
from warp_plate.scene.load import preset_names
from warp_plate.scene.vary import MOST_POINTS, make_plan, parse_vary

PAPER = Scene.load("paper")


@pytest.mark.parametrize("name", preset_names())
def test_every_key_of_a_preset_is_found(name):
    scene = Scene.load(name)
    assert scene.with_values({}) == scene
    for key in (kinds := scalar_keys(scene)):
        assert resolved_key(scene, key, kinds) == key
        assert label_of(scene, key)
    assert unit_of(scene, "actuators[0].magnitude") == ("V" if name == "focusing-glass" else "N/m²")
    assert unit_of(scene, "plate.thickness") == "m"


def test_numbers_are_replaced():
    made = PAPER.with_values({"target.area[1]": 0.05, "actuators[2].phase": 1.5, "search.velocity_limit": 3})
    assert made.target.area == (0.0, 0.05, 0.0, 0.1)
    assert [one.phase for one in made.actuators] == [0.0, 0.0, 1.5, 0.0]
    assert made.search.velocity_limit == 3.0
    assert made.plate == PAPER.plate
    assert PAPER.with_values({"grid.nodes[1]": 31.0}).grid.nodes == (27, 31)
    assert PAPER.with_values({"grid.accuracy": 0.01}).grid.accuracy == 0.01
    with pytest.raises(SceneError, match="not thin"):
        PAPER.with_values({"plate.thickness": 0.1})


def test_names_stand_for_indices(scene):
    assert resolved_key(PAPER, "actuators.lower right.phase") == "actuators[2].phase"
    assert label_of(PAPER, "actuators[2].area[3]") == "actuator lower right area y1"
    several = scene(
        target={"area": (0.0, 0.1, 0.0, 0.1)},
        targets=[{"name": "a.b", "area": (0.0, 0.1, 0.0, 0.1)}, {"name": "a", "disc": (0.1, 0.1, 0.02)}],
    )
    assert resolved_key(several, "targets.a.b.area[0]") == "targets[0].area[0]"
    assert not any(key.startswith("target.") for key in scalar_keys(several))
    assert several.with_values({"targets[0].area[0]": 0.02}).target.area[0] == 0.02


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("drive.freqency", "similar keys: drive.frequency"),
        ("plate.size", "is not a single value; write plate.size[0], plate.size[1]"),
        ("actuators.nobody.phase", "similar keys: actuators[0].phase"),
        ("actuators[7].phase", "similar keys: actuators[0].phase"),
        ("targets[0].area[1]", "similar keys: target.area[0], target.area[1]"),
        ("", "is not a key of this scene that holds a number"),
    ],
)
def test_unknown_keys_suggest_similar_ones(key, near):
    assert near in refused(resolved_key, PAPER, key)


def outcome(option):
    try:
        return parse_vary(PAPER, option)
    except SceneError as error:
        return str(error)


@given(st.text(max_size=40), st.text(max_size=60))
def test_any_text_is_a_range_or_refused_in_one_line(key, text):
    for option in (f"{key}={text}", f"drive.frequency={text}", f"search.particles={text}", text):
        found = outcome(option)
        if isinstance(found, str):
            assert found.startswith("--vary")
            assert "\n" not in found
        else:
            assert np.isfinite([found.start, found.stop]).all()


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6).filter(bool), st.integers(2, 50), st.sampled_from(["", "log:"]))
def test_ranges_have_their_ends_and_even_steps(start, stop, count, kind):
    if start == stop:
        stop = 2 * start
    values = parse_vary(PAPER, f"drive.frequency={kind}{start!r}:{stop!r}:{count}").values()
    assert len(values) == count
    assert (values[0], values[-1]) == (start, stop)
    steps = np.diff(np.log(values) if kind else values)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6, atol=1e-9 * max(start, stop))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("drive.frequency", "must be KEY=RANGE"),
        ("drive.frequency=", "'' is not a number"),
        ("drive.frequency=٣,4", "'٣' is not a number"),
        ("drive.frequency=1:2:0", "COUNT = '0': must be a whole number"),
        ("drive.frequency=1:1:4", "START and STOP must differ"),
        ("drive.frequency=log:0:1:4", "both ends of a logarithmic range must be"),
        ("drive.frequency=1,2,1", "a value is listed twice"),
        ("search.particles=2:9.5:3", "search.particles holds whole numbers"),
        ("search.particles=40,40.00000000000001", "a value is listed twice"),
        ("search.seed=9007199254740993,1", r"9007199254740993 is beyond ±9007199254740991 \(2\^53 - 1\).*float64"),
        (f"drive.frequency=1:2:{MOST_POINTS + 1}", "must be a whole number from 1 to"),
    ],
)
def test_invalid_ranges_are_refused(text, message):
    with pytest.raises(SceneError, match=message):
        parse_vary(PAPER, text)


def test_integers_stay_integers():
    for text, whole in (
        ("search.particles=log:20:80:3", [20, 40, 80]),
        ("search.particles=log:7:343:3", [7, 49, 343]),
        ("search.particles=log:10:1000000000000:12", [10**power for power in range(1, 13)]),
        ("search.particles=40.00000000000001,79.99999999999999", [40, 80]),
        ("search.particles=20:80.00000000000001:3", [20, 50, 80]),
        ("search.seed=9007199254740991,1", [2**53 - 1, 1]),
    ):
        assert make_plan([parse_vary(PAPER, text)]).coordinates[0].tolist() == whole
    drawn = make_plan([parse_vary(PAPER, "search.particles=2:5")], samples=200).coordinates[0]
    assert set(drawn) == {2, 3, 4, 5}


def test_last_key_of_a_grid_changes_fastest():
    plan = make_plan([parse_vary(PAPER, "drive.frequency=1,2,3"), parse_vary(PAPER, "plate.thickness=4e-4:5e-4:2")])
    assert plan.shape == (3, 2)
    assert plan.points.tolist() == [[f, h] for f in (1.0, 2.0, 3.0) for h in (4e-4, 5e-4)]
    assert plan.values(3) == {"drive.frequency": 2.0, "plate.thickness": 5e-4}


@given(st.integers(1, 40), st.integers(0, 2**32))
def test_samples_are_a_latin_hypercube(samples, seed):
    """Each of n equal parts of every range holds one of n samples; the same seed repeats them."""
    varied = [parse_vary(PAPER, "drive.frequency=400:200"), parse_vary(PAPER, "effects.damping.viscous=log:1:100")]
    plan = make_plan(varied, samples, seed)
    assert plan.shape == (samples,)
    frequency, damping = plan.coordinates
    for share in ((frequency - 200) / 200, np.log(damping) / np.log(100)):
        assert sorted(np.floor(share * samples * (1 - 1e-12))) == list(range(samples))
    assert plan.same(make_plan(varied, samples, seed))


@pytest.mark.parametrize(
    ("texts", "samples", "message"),
    [
        (["drive.frequency=1:2:2"] * 2, None, "varied twice"),
        ([], None, "nothing is varied"),
        (["drive.frequency=1:2"], None, "COUNT is missing"),
        (["drive.frequency=1:2:1001", "window.end=1:2:1001"], None, "at most 1000000"),
        (["drive.frequency=1:2:2"], 0, "--samples 0"),
        (["search.particles=2:9:4"], None, "is not a whole number"),
        # A third, however small a part of the number.
        (["search.seed=0:10000000000:4"], None, "is not a whole number"),
    ],
)
def test_invalid_plans_are_refused(texts, samples, message):
    with pytest.raises(SceneError, match=message):
        make_plan([parse_vary(PAPER, text) for text in texts], samples)
