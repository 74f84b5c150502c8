"""Sweeps: keys and ranges, points, figures as the commands give them, refused points, and going on after a stop."""

import itertools
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from warp_plate import Scene, SceneError, load_sweep, sweep
from warp_plate.plate.modes import natural_modes
from warp_plate.result.sweep import NOT_RUN, REFUSED, RUN, save_sweep
from warp_plate.scene.keys import NAMED, UNITS, numeric_keys, resolved_key, unit_of, with_numbers, words_of
from warp_plate.scene.load import dump_scene, preset_names
from warp_plate.scene.vary import MOST_POINTS, make_plan, parse_vary
from warp_plate.search.figures import FIGURES
from warp_plate.search.localize import localize
from warp_plate.search.simulate import simulate
from warp_plate.search.sweep import begin_sweep, run_sweep
from warp_plate.search.sweep_file import SweepFile, continued, unfinished_sweep

PAPER = Scene.load("paper")
ROOT = Path(__file__).parents[1]
# Keys without a unit: counts, ratios, tolerances, and what follows the unit of something else.
PLAIN = {
    *("poisson_ratio", "nodes", "order", "accuracy", "gain", "weight", "quantile", "without_oscillators"),
    *("particles", "iterations", "restarts", "inertia", "decay", "cognitive", "social", "velocity_limit", "stall"),
    *("seed", "scenarios", "fresh"),
}


def number_fields(model, at=""):
    """Dotted names, without indices, of all keys of a model's tables that hold numbers."""
    pending = [(f"{at}{key}", field.annotation) for key, field in model.model_fields.items()]
    while pending:
        name, kind = pending.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from number_fields(kind, f"{name}.")
        elif kind in (int, float):
            yield name
        pending += [(name, part) for part in getattr(kind, "__args__", ())]


@pytest.fixture
def plate(scene):
    """A small scene with one key that may be refused: thicker than the time step allows."""
    return scene(damping=88.5, time_step=2e-4, search={"particles": 8, "iterations": 10})


def test_every_number_of_a_scene_has_a_unit_or_none():
    for name in set(number_fields(Scene)):
        parts = name.split(".")
        known = any(".".join(parts[index:]) in UNITS for index in range(len(parts)))
        assert known or parts[-1] in PLAIN, name


@pytest.mark.parametrize("name", preset_names())
def test_every_key_of_a_preset_can_be_found_and_changed(name):
    scene = Scene.load(name)
    assert with_numbers(scene, {}) == scene
    for key in numeric_keys(scene):
        assert resolved_key(scene, key) == key
        assert words_of(scene, key)
        assert unit_of(scene, key)


def test_numbers_are_put_where_they_belong():
    made = with_numbers(PAPER, {"target.area[1]": 0.05, "actuators[2].phase": 1.5, "search.velocity_limit": 3})
    assert made.target.area == (0.0, 0.05, 0.0, 0.1)
    assert [one.phase for one in made.actuators] == [0.0, 0.0, 1.5, 0.0]
    assert made.search.velocity_limit == 3.0
    assert made.plate == PAPER.plate
    # Left out in the file, and an accuracy in the place of a whole table.
    bare = Scene.model_validate({**PAPER.model_dump(exclude={"grid"})})
    assert with_numbers(bare, {"grid.nodes[1]": 31.0}).grid.nodes == (27, 31)
    assert with_numbers(PAPER, {"grid.accuracy": 0.01}).grid.accuracy == 0.01
    with pytest.raises(SceneError, match="not thin"):
        with_numbers(PAPER, {"plate.thickness": 0.1})


def test_names_stand_for_indices(scene):
    assert resolved_key(PAPER, "actuators.lower right.phase") == "actuators[2].phase"
    assert words_of(PAPER, "actuators[2].area[3]") == "actuator lower right area y1"
    several = scene(
        target={"area": (0.0, 0.1, 0.0, 0.1)},
        targets=[{"name": "a.b", "area": (0.0, 0.1, 0.0, 0.1)}, {"name": "a", "disc": (0.1, 0.1, 0.02)}],
    )
    assert resolved_key(several, "targets.a.b.area[0]") == "targets[0].area[0]"
    assert not any(key.startswith("target.") for key in numeric_keys(several))
    assert with_numbers(several, {"targets[0].area[0]": 0.02}).target.area[0] == 0.02
    assert set(NAMED) == {"actuators", "targets"}


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("drive.freqency", "near it: drive.frequency"),
        ("viscous", "near it: effects.damping.viscous"),
        ("plate.size", "is no single number; write plate.size[0], plate.size[1]"),
        ("actuators.nobody.phase", "near it: actuators[0].phase"),
        ("actuators[7].phase", "near it: actuators[0].phase"),
        ("effects.foundation.stiffness", "the scene has no [effects.foundation]"),
        ("edges.left", "is no key of this scene that holds a number"),
        ("title", "is no key of this scene that holds a number"),
        ("", "is no key of this scene that holds a number"),
    ],
)
def test_a_wrong_key_names_those_near_it(key, near):
    with pytest.raises(SceneError) as caught:
        resolved_key(PAPER, key)
    assert near in str(caught.value)
    assert "\n" not in str(caught.value)


def judged(scene, text):
    """What a text varies, or the line that refuses it."""
    try:
        return parse_vary(scene, text), ""
    except SceneError as error:
        return None, str(error)


@given(st.text(max_size=40), st.text(max_size=60))
def test_any_text_is_a_range_or_one_line(key, text):
    """Also of a right key; and what is accepted makes numbers."""
    for said in (f"{key}={text}", f"drive.frequency={text}", f"search.particles={text}", text):
        varied, line = judged(PAPER, said)
        assert "\n" not in line
        assert line.startswith("--vary") == (varied is None)
        assert varied is None or np.isfinite([varied.start, varied.stop]).all()


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6).filter(bool), st.integers(2, 50), st.sampled_from(["", "log:"]))
def test_ranges_end_where_they_are_said_to(start, stop, count, kind):
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
        ("drive.frequency=", "'' is no number"),
        ("drive.frequency=1:2:0", "COUNT = '0': must be a whole number"),
        ("drive.frequency=1:2:3:4", "write START:STOP:COUNT"),
        ("drive.frequency=1:1:4", "the range has no inside"),
        ("drive.frequency=log:0:1:4", "has both ends above 0"),
        ("drive.frequency=1,2,1", "a value is there twice"),
        ("drive.frequency=1,nan", "'nan' is no number"),
        ("search.particles=2:9.5:3", "search.particles holds whole numbers"),
        (f"drive.frequency=1:2:{MOST_POINTS + 1}", "must be a whole number from 1 to"),
    ],
)
def test_wrong_ranges(text, message):
    with pytest.raises(SceneError, match=message):
        parse_vary(PAPER, text)


def test_whole_numbers_stay_whole():
    with pytest.raises(SceneError, match="is no whole number"):
        make_plan([parse_vary(PAPER, "search.particles=2:9:4")])
    drawn = make_plan([parse_vary(PAPER, "search.particles=2:5")], samples=200).coordinates[0]
    assert set(drawn) == {2, 3, 4, 5}


def test_the_grid_is_full_and_the_last_key_is_the_fastest():
    plan = make_plan([parse_vary(PAPER, "drive.frequency=1,2,3"), parse_vary(PAPER, "plate.thickness=4e-4:5e-4:2")])
    assert (len(plan), plan.shape) == (6, (3, 2))
    assert plan.points.tolist() == [list(pair) for pair in itertools.product([1.0, 2.0, 3.0], [4e-4, 5e-4])]
    assert plan.numbers(3) == {"drive.frequency": 2.0, "plate.thickness": 5e-4}


@given(st.integers(1, 40), st.integers(0, 2**32))
def test_samples_are_a_latin_hypercube(samples, seed):
    """Each of as many equal parts of every range holds one sample, logarithmic or not; a seed repeats them."""
    varied = [parse_vary(PAPER, "drive.frequency=400:200"), parse_vary(PAPER, "effects.damping.viscous=log:1:100")]
    plan = make_plan(varied, samples, seed)
    assert plan.shape == (samples,)
    frequency, damping = plan.coordinates
    for share in ((frequency - 200) / 200, np.log(damping) / np.log(100)):
        assert sorted(np.floor(share * samples * (1 - 1e-12))) == list(range(samples))
    assert plan.same(make_plan(varied, samples, seed))


def test_plans_that_cannot_be():
    one = parse_vary(PAPER, "drive.frequency=1:2:2")
    with pytest.raises(SceneError, match="varied twice"):
        make_plan([one, one])
    with pytest.raises(SceneError, match="nothing is varied"):
        make_plan([])
    with pytest.raises(SceneError, match="COUNT is missing"):
        make_plan([parse_vary(PAPER, "drive.frequency=1:2")])
    with pytest.raises(SceneError, match="at most 1000000"):
        make_plan([parse_vary(PAPER, f"{key}=1:2:1001") for key in ("drive.frequency", "window.end")])
    with pytest.raises(SceneError, match="--samples 0"):
        make_plan([one], samples=0)


def test_figures_are_those_of_the_commands(plate):
    """Each point alone, by the command itself, gives the same."""
    plan = make_plan([parse_vary(plate, "drive.frequency=250,290"), parse_vary(plate, "actuators[1].phase=0,1.5")])
    found = {what: sweep(plate, plan, what, device="cpu", count=3) for what in FIGURES}
    for point in range(len(plan)):
        scene = plan.scene(plate, point)
        alone = simulate(scene, device="cpu", estimate=False)
        values = {name: one[point] for name, one in found["simulate"].values.items()}
        assert values["localization_factor"] == alone.cases["drive"].localization_factor
        assert values["energy_plate"] == alone.cases["drive"].energy["plate"]
        assert values["peak_displacement"] == alone.peak
        searched = localize(scene, device="cpu", evaluator="response", estimate=False)
        values = {name: one[point] for name, one in found["localize"].values.items()}
        assert values["bound"] == pytest.approx(searched.bound, rel=1e-9)
        for name in ("equal", "single"):
            assert values[name] == pytest.approx(searched.cases[name].localization_factor, rel=1e-9)
        assert searched.cases["best"].localization_factor <= values["best"] * (1 + 1e-9)
        assert values["best"] <= values["bound"] * (1 + 1e-9)
        np.testing.assert_array_equal(found["modes"].values["frequency"][point], natural_modes(scene, 3).frequencies)
        assert found["check"].values["time_step"][point] == 2e-4
        assert found["check"].values["steps_a_period"][point] == pytest.approx(1 / (scene.drive.frequency * 2e-4))


def test_where_no_eigenvector_is_the_answer_the_scene_is_searched(scene):
    """A limit on magnitudes, a plate that is not linear, one actuator, and one that is searched over panels: what
    ``localize`` finds."""
    search = {"particles": 6, "iterations": 8}
    limited = scene(damping=88.5, search={**search, "limits": {"equal_magnitudes": True}})
    stretched = scene((9, 9), effects={"stretching": {}}, search=search)
    alone = scene(damping=88.5, actuators=[(0.03, 0.06, 0.03, 0.06)])
    robust = scene((9, 9), damping=88.5, search={**search, "robust": {"thickness": 0.05, "scenarios": 2, "fresh": 1}})
    for one, evaluator in ((limited, "response"), (stretched, "direct"), (alone, "response"), (robust, "response")):
        found = sweep(one, ["drive.frequency=290"], device="cpu").values
        searched = localize(one, device="cpu", evaluator=evaluator, estimate=False)
        assert found["best"][0] == pytest.approx(searched.cases["best"].localization_factor, rel=1e-6)
        assert np.isnan(found["bound"][0]) == (searched.bound is None)
        if searched.bound is not None:
            assert found["bound"][0] == pytest.approx(searched.bound, rel=1e-9)


def test_refused_points_have_a_reason_and_others_run(plate):
    found = sweep(plate, ["plate.thickness=5e-4,2e-3,0.1", "drive.frequency=250,290"], "check", device="cpu")
    assert found.status.tolist() == [RUN, RUN, REFUSED, REFUSED, REFUSED, REFUSED]
    assert np.isfinite(found.shaped("limit")[0]).all()
    assert np.isnan(found.shaped("limit")[1:]).all()
    assert "grid.time_step = 0.0002: above the stability limit" in found.reasons[2]
    assert "not thin" in found.reasons[4]
    with pytest.raises(SceneError, match=r"all points are refused; at plate\.thickness = 0\.1: plate\.thickness"):
        sweep(plate, ["plate.thickness=0.1,0.2"], "check", device="cpu")


def test_what_is_no_sweep(plate):
    with pytest.raises(SceneError, match="--what colours: must be one of localize"):
        sweep(plate, ["drive.frequency=1,2"], "colours")
    with pytest.raises(SceneError, match="--count 0"):
        sweep(plate, ["drive.frequency=1,2"], "modes", count=0)


@pytest.mark.parametrize("samples", [None, 7])
def test_a_file_gives_back_what_was_saved(plate, tmp_path, samples):
    vary = ["plate.thickness=4e-4,5e-4,2e-3", "drive.frequency=log:200:300:2"]
    found = sweep(plate, vary, "modes", samples=samples, device="cpu", count=2)
    read = load_sweep(save_sweep(found, tmp_path / "a.h5"))
    assert read.plan.same(found.plan)
    assert read.plan.logarithmic == (False, True)
    assert (read.scene, read.what, read.count, read.reasons) == (plate, "modes", 2, found.reasons)
    assert read.outputs == found.outputs
    np.testing.assert_array_equal(read.values["frequency"], found.values["frequency"])
    np.testing.assert_array_equal(read.status, found.status)


class Stop(KeyboardInterrupt):
    """Ctrl-C at a point of our choice."""


def test_a_sweep_that_is_stopped_anywhere_goes_on_to_the_same(plate, tmp_path, random):
    plan = make_plan([parse_vary(plate, "plate.thickness=4e-4:2e-3:5"), parse_vary(plate, "drive.frequency=200,300")])
    whole, file = sweep(plate, plan, "simulate", device="cpu"), tmp_path / "a.h5"
    ran = []

    def told(done, total, note):
        ran.append(note)
        if random.random() < 0.4:
            raise Stop

    begun = begin_sweep(plate, plan, "simulate", "cpu")
    for _ in range(200):
        try:
            found = run_sweep(begun, told, SweepFile(file, math.inf))
            break
        except Stop:
            begun = continued(unfinished_sweep(file) or load_sweep(file))
    assert found.finished
    for name, values in whole.values.items():
        np.testing.assert_array_equal(found.values[name], values)
    np.testing.assert_array_equal(found.status, whole.status)
    assert found.reasons == whole.reasons
    assert len(ran) == len(set(ran)) == len(plan)  # none twice


def test_points_in_any_order_give_the_same(plate, random):
    from warp_plate.search.sweep import run_here

    plan = make_plan([parse_vary(plate, "drive.frequency=200:300:6")])
    whole = sweep(plate, plan, "localize", device="cpu")
    shuffled = run_sweep(
        begin_sweep(plate, plan, "localize", "cpu"),
        runner=lambda begun, points: run_here(begun, random.permutation(points).tolist()),
    )
    for name, values in whole.values.items():
        np.testing.assert_array_equal(shuffled.values[name], values)


def test_a_process_that_is_killed_leaves_a_file_that_goes_on(plate, tmp_path, random):
    """By the system, without a word, at any moment of its work."""
    (tmp_path / "panel.toml").write_text(dump_scene(plate), encoding="utf-8")
    command = [sys.executable, "-m", "warp_plate", "sweep", "panel.toml", "--vary", "plate.thickness=4e-4:9e-4:40"]
    options = ["--what", "modes", "--checkpoint-every", "0", "--no-pictures", "--device", "cpu"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([*command, *options], cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    file = tmp_path / "panel-sweep.h5"
    while not file.exists() and process.poll() is None:
        time.sleep(0.005)
    time.sleep(0.2 * random.random())
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = load_sweep(file)
    found = run_sweep(continued(left))
    whole = sweep(plate, ["plate.thickness=4e-4:9e-4:40"], "modes", device="cpu")
    np.testing.assert_array_equal(found.values["frequency"], whole.values["frequency"])
    np.testing.assert_array_equal(
        left.values["frequency"][left.status == RUN], whole.values["frequency"][left.status == RUN]
    )
    assert np.isnan(left.values["frequency"][left.status == NOT_RUN]).all()


def test_a_file_that_the_scene_names_must_be_the_same(scene, tmp_path):
    (tmp_path / "thick.csv").write_text("1.0,1.1\n", encoding="utf-8")
    varied = scene(effects={"variation": {"thickness": "thick.csv"}}).in_folder(tmp_path)
    begun = begin_sweep(varied, make_plan([parse_vary(varied, "drive.frequency=200,300")]), "check", "cpu")
    found = run_sweep(begun)
    assert (found.status == RUN).all()
    (tmp_path / "thick.csv").write_text("1.0,1.2\n", encoding="utf-8")
    with pytest.raises(SceneError, match="holds something else than when the sweep began"):
        continued(begun)
