"""A search that was stopped, by Ctrl-C, by a kill or by a lost device, goes on to the result of one that was not."""

import inspect
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError, load_result, localize, resume
from warp_plate.cli.localize import localize as localize_command
from warp_plate.cli.main import main
from warp_plate.result.checkpoint import load_checkpoint, load_newest, previous_of, save_checkpoint
from warp_plate.scene.load import dump_scene
from warp_plate.search.checkpoints import EVERY, CheckpointFile

ROOT = Path(__file__).parents[1]
SMALL = {"search": {"particles": 8, "iterations": 9, "seed": 3}, "record": {"points": ((0.1, 0.1),)}}
COMMAND = ["localize", "panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate"]
# Of two runs, what the clock decides.
TIMED = {"seconds", "accuracy"}


def assert_same(one, other):
    """All that a search finds, to the last bit."""
    for name in {field.name for field in fields(one)} - TIMED - {"cases", "times", "trace_times", "history"}:
        assert getattr(one, name) == getattr(other, name), name
    np.testing.assert_array_equal(one.times, other.times)
    assert one.history.keys() == other.history.keys()
    for name in one.history:
        np.testing.assert_array_equal(one.history[name], other.history[name])
    assert one.cases.keys() == other.cases.keys()
    for name, case in one.cases.items():
        assert case.energy == other.cases[name].energy
        for part in ("drive", "displacement", "trace"):
            np.testing.assert_array_equal(getattr(case, part), getattr(other.cases[name], part))


@pytest.fixture
def stopped(tmp_path):
    """Search until ``told`` or the solver raises KeyboardInterrupt; the checkpoint that is left."""

    def run(made, *options, told=None):
        file = CheckpointFile(tmp_path / "one.checkpoint.h5", np.inf)
        result = localize(made, "mine", *options, told=told, estimate=False, checkpoints=file)
        assert result.interrupted
        return load_checkpoint(file.path)

    return run


def stop_after(iterations):
    def told(done, total, best):
        if done == iterations:
            raise KeyboardInterrupt

    return told


@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_from_any_iteration_to_the_same_bits(evaluator, device, path, scene, stopped):
    made = scene(damping=88.5, precision="float32", **SMALL)
    options = (device, None, evaluator, path)
    whole = localize(made, "mine", *options, estimate=False)
    for iterations in (1, 4, 8):
        checkpoint = stopped(made, *options, told=stop_after(iterations))
        assert (checkpoint.iterations, checkpoint.progress) == (iterations, f"{iterations} of 9 iterations")
        assert_same(resume(checkpoint, estimate=False), whole)


@pytest.mark.parametrize("call", [3, 5, 10])
def test_ctrl_c_amid_an_iteration(call, scene, stopped, monkeypatch):
    """The swarm has moved, its losses are not known: it goes on from there, and nothing is counted twice."""
    made = scene(damping=88.5, **SMALL)
    whole = localize(made, "mine", "cpu", estimate=False)
    run, calls = PlateSolver.run, []

    def interrupted(self, *arguments, **options):
        answer = run(self, *arguments, **options)
        calls.append(1)
        if len(calls) == call:
            raise KeyboardInterrupt
        return answer

    monkeypatch.setattr(PlateSolver, "run", interrupted)
    checkpoint = stopped(made, "cpu")
    assert checkpoint.iterations == call - 3  # the response and the single actuators come first
    assert_same(resume(checkpoint, estimate=False), whole)


def test_stopped_again_and_again(scene, stopped, tmp_path):
    made = scene(damping=88.5, effects={"stretching": {}}, **SMALL)
    whole = localize(made, "mine", "cpu", estimate=False)
    checkpoint = stopped(made, "cpu", told=stop_after(1))
    for iterations in range(2, 9):
        file = CheckpointFile(tmp_path / "two.checkpoint.h5", np.inf, goes_on=True)
        resume(checkpoint, told=stop_after(iterations), estimate=False, checkpoints=file)
        checkpoint = load_checkpoint(file.path)
        assert checkpoint.iterations == iterations
    found = resume(checkpoint, estimate=False)
    assert found.bound is None
    assert_same(found, whole)


def test_a_grid_that_was_chosen_is_not_chosen_again(scene, stopped, monkeypatch):
    """Timing takes part in the choice: it is kept with the search, and so is what was asked for."""
    asked = scene(damping=88.5, **SMALL).model_copy(update={"grid": type(scene().grid)(accuracy=0.3)})
    whole = None

    def keep(done, total, best):
        if done == 2:
            raise KeyboardInterrupt

    checkpoint = stopped(asked, "cpu", told=keep)
    assert checkpoint.asked == asked
    monkeypatch.setattr("warp_plate.search.localize.choose", None)
    found = resume(checkpoint, estimate=False)
    whole = localize(checkpoint.scene, "mine", "cpu", estimate=False)
    assert_same(found, whole)
    assert found.accuracy == checkpoint.accuracy
    assert found.accuracy["asked"] == 0.3


def test_another_device_only_by_name(scene, stopped):
    checkpoint = stopped(scene(**SMALL), "cpu", told=stop_after(2))
    elsewhere = replace(checkpoint, device="cuda:7", processor="another one")
    with pytest.raises(SceneError, match=r"began on cuda:7 \(another one\).*--device") as refused:
        resume(elsewhere)
    assert "\n" not in str(refused.value)
    found = resume(elsewhere, "cpu", estimate=False)
    assert found.device.startswith("cuda:7 (another one), then cpu")
    older = resume(replace(checkpoint, versions={**checkpoint.versions, "warp": "0.1"}), estimate=False)
    assert older.versions["warp"] == f"0.1, then {checkpoint.versions['warp']}"


def test_a_search_that_moved_goes_on_where_it_is(scene, stopped, tmp_path):
    checkpoint = stopped(scene(**SMALL), "cpu", told=stop_after(2))
    elsewhere = replace(checkpoint, device="cuda:7", processor="another one")
    file = CheckpointFile(tmp_path / "two.checkpoint.h5", np.inf, goes_on=True)
    resume(elsewhere, "cpu", told=stop_after(4), estimate=False, checkpoints=file)
    moved = load_checkpoint(file.path)
    assert (moved.device, moved.processor) == (checkpoint.device, checkpoint.processor)
    found = resume(moved, estimate=False)
    assert found.device.startswith("cuda:7 (another one), then cpu")
    assert found.versions == checkpoint.versions


@pytest.fixture
def panel(tmp_path, monkeypatch, scene):
    """A small scene with a long search, in a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, precision="float32", search={"particles": 6, "iterations": 400})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


@pytest.fixture
def left(panel):
    """A search of the panel that Ctrl-C ended: its checkpoint, and its Scene."""
    file = CheckpointFile(Path("panel-localize.checkpoint.h5"), np.inf)
    localize(panel, "panel.toml", "cpu", told=stop_after(5), estimate=False, checkpoints=file)
    return file.path


@pytest.fixture
def command(capsys):
    """Run a command in this process: (status, standard output, standard error)."""

    def run(*arguments):
        try:
            main([str(argument) for argument in arguments])
            status = 0
        except SystemExit as gone:
            status = gone.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--seed", "3"], "--seed 3: the search in panel-localize.checkpoint.h5 began with 0"),
        (["--evaluator", "response"], "--evaluator response: the search in .* began with direct"),
        (["--path", "streaming"], "--path streaming: the search in .* began with auto"),
        (["--accuracy", "1%"], "--accuracy: grid.accuracy = 0.01: the search in .* began with None"),
        (["panel.toml", "--accuracy", "1%"], "panel.toml: grid.accuracy = 0.01"),
        (["thicker.toml"], "thicker.toml: plate.thickness = 0.001: the search in .* began with 0.0005"),
        (["moved.toml"], r"moved.toml: actuators\[1\].area = "),
        (["--checkpoint-every", "-1"], "checkpoint-every = -1: must be a number of seconds"),
        (["--checkpoint-every", "nan"], "checkpoint-every = nan: must be"),
        (["--device", "cuda:9"], "device = 'cuda:9': not on this machine"),
    ],
)
def test_what_would_change_the_result_is_refused_by_name(options, named, command, panel, left):
    thicker = panel.model_copy(update={"plate": panel.plate.model_copy(update={"thickness": 1e-3})})
    Path("thicker.toml").write_text(dump_scene(thicker), encoding="utf-8")
    one, two, *rest = panel.actuators
    moved = panel.model_copy(update={"actuators": (one, two.model_copy(update={"area": one.area}), *rest)})
    Path("moved.toml").write_text(dump_scene(moved), encoding="utf-8")
    before = left.read_bytes()
    status, out, err = command("localize", "--resume", left, *options, "--no-pictures")
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert re.search(named, err), err
    assert left.read_bytes() == before
    assert not Path("panel-localize.h5").exists()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ([], "needs a SCENE .* or --resume FILE"),
        (["--resume", "none.checkpoint.h5"], "none.checkpoint.h5: no such file"),
        (["--resume", "panel.toml"], "panel.toml: damaged: no checksum at its end"),
        (["--resume", "."], "damaged or not an HDF5 file"),
        (["--resume", "result.h5"], "result.h5: not a checkpoint of warp-plate"),
    ],
)
def test_a_scene_or_a_checkpoint_is_needed(options, named, command, panel):
    command("simulate", "panel.toml", "--device", "cpu", "--no-pictures", "--out", "result.h5")
    status, out, err = command("localize", "--no-pictures", *options)
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert re.search(named, err), err


def test_the_command_goes_on(command, panel, left):
    """With the same scene given once more or left out; the result lies beside the checkpoint, which goes."""
    kept = left.read_bytes()
    whole = localize(panel, "panel.toml", "cpu", estimate=False)
    for more in ([], ["panel.toml", "--seed", "0", "--path", "auto", "--device", "cpu"]):
        left.write_bytes(kept)
        status, out, err = command("localize", "--resume", left, *more, "--no-pictures", "--no-estimate", "--json")
        assert (status, err) == (0, "")
        answer = json.loads(out)
        assert (answer["interrupted"], answer["checkpoint"]) == (False, None)
        assert answer["files"] == ["panel-localize.h5"]
        assert sorted(map(str, Path().iterdir())) == ["panel-localize.h5", "panel.toml"]
        save = load_result("panel-localize.h5")
        assert_same(replace(save, cases=whole.cases), whole)
        for name, case in whole.cases.items():
            assert save.cases[name].energy == case.energy


def test_a_damaged_checkpoint_gives_way_to_the_one_before(command, panel, left):
    previous = previous_of(left)
    assert previous == Path("panel-localize.checkpoint.previous.h5")
    previous.write_bytes(left.read_bytes())
    left.write_bytes(b"x" + left.read_bytes()[1:])
    status, _, err = command("localize", "--resume", left, "--no-pictures", "--no-estimate")
    assert status == 0
    assert len(err.splitlines()) == 1
    assert "going on from panel-localize.checkpoint.previous.h5, 5 of 400 iterations" in err
    left.write_bytes(b"x")
    previous.write_bytes(b"y")
    status, _, err = command("localize", "--resume", left, "--no-pictures", "--no-estimate")
    assert (status, len(err.splitlines())) == (2, 1)
    assert err.startswith("warp-plate: panel-localize.checkpoint.h5: damaged: ")


def test_an_unfinished_search_is_named_before_it_is_replaced(command, panel, left):
    short = panel.model_copy(update={"search": panel.search.model_copy(update={"iterations": 2})})
    Path("panel.toml").write_text(dump_scene(short), encoding="utf-8")
    status, _, err = command(*COMMAND)
    assert (status, len(err.splitlines())) == (0, 1)
    assert "panel-localize.checkpoint.h5 is of a search that did not end" in err


def killed(arguments, moment, random):
    """Start the command and kill it some time after its first checkpoint is there; whether it ended by itself."""
    process = subprocess.Popen(
        [sys.executable, "-m", "warp_plate", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    file = Path("panel-localize.checkpoint.h5")
    before = file.stat().st_mtime_ns if file.exists() else 0
    while process.poll() is None and not (file.exists() and file.stat().st_mtime_ns != before):
        time.sleep(0.002)
    time.sleep(moment)
    process.kill()
    _, err = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), err.decode()
    return process.returncode == 0


def killed_until(times, longest, panel, random):
    """Kill and resume so many times, then let it end; the reference is a search that nobody stopped."""
    whole = localize(panel, "panel.toml", "cpu", estimate=False)
    arguments, kills = [*COMMAND, "--checkpoint-every", "0"], 0
    going_on = ["localize", "--resume", "panel-localize.checkpoint.h5", "--no-pictures", "--no-estimate"]
    going_on += ["--checkpoint-every", "0"]
    reached = [0]
    for _ in range(times):
        if killed(arguments, random.uniform(0, longest), random):
            break
        kills += 1
        checkpoint, _ = load_newest(Path("panel-localize.checkpoint.h5"))
        reached.append(checkpoint.iterations)
        arguments = going_on
    assert kills == times, reached
    assert reached == sorted(reached)
    # To the end in this process, from what the last one left.
    found = resume(checkpoint, estimate=False)
    assert_same(replace(found, source="panel.toml"), whole)
    file = CheckpointFile(Path("panel-localize.checkpoint.h5"), goes_on=True)
    file.remove()
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_twice(panel, random):
    killed_until(2, 0.1, panel, random)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_at_twenty_random_moments(panel, random):
    killed_until(20, 0.05, panel, random)


def test_checkpoints_come_by_the_clock(scene, tmp_path, monkeypatch):
    """None before its time, one an iteration with 0, and the one before is kept."""
    made, now = scene(**SMALL), [0.0]
    monkeypatch.setattr("warp_plate.search.checkpoints.time.monotonic", lambda: now[0])
    written = []

    def told(done, total, best):
        now[0] += 1.0
        path = tmp_path / "a.checkpoint.h5"
        if path.exists() and (not written or load_checkpoint(path).iterations != written[-1]):
            written.append(load_checkpoint(path).iterations)

    for every, expected in ((4.0, [5, 9]), (0.0, [*range(1, 10)]), (100.0, [])):
        file = CheckpointFile(tmp_path / "a.checkpoint.h5", every)
        localize(made, "", "cpu", told=told, estimate=False, checkpoints=file)
        assert written == expected
        if len(expected) > 1:
            assert load_checkpoint(previous_of(file.path)).iterations == expected[-2]
        file.remove()
        assert not list(tmp_path.iterdir())
        written.clear()


def test_the_one_before_is_never_that_of_another_search(scene, tmp_path, stopped):
    checkpoint = stopped(scene(**SMALL), "cpu", told=stop_after(2))
    path = tmp_path / "a.checkpoint.h5"
    other = replace(checkpoint, seed=99)
    save_checkpoint(other, path)
    save_checkpoint(other, previous_of(path))
    file = CheckpointFile(path)
    file.save(checkpoint)
    assert not previous_of(path).exists()
    file.save(checkpoint)
    assert load_checkpoint(previous_of(path)).seed == checkpoint.seed


def test_a_result_that_cannot_be_written_leaves_the_checkpoint(command, panel, monkeypatch):
    def full(result, path):
        raise SceneError(f"{path}: cannot be written: No space left on device")

    short = panel.model_copy(update={"search": panel.search.model_copy(update={"iterations": 3})})
    Path("panel.toml").write_text(dump_scene(short), encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr("warp_plate.result.save_result", full)
        status, out, err = command(*COMMAND, "--checkpoint-every", "0")
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert err.endswith(
        "there is a checkpoint after 3 of 3 iterations; go on with: warp-plate localize --resume "
        "panel-localize.checkpoint.h5\n"
    )
    assert command("localize", "--resume", "panel-localize.checkpoint.h5", "--no-pictures", "--no-estimate")[0] == 0
    assert load_result("panel-localize.h5").evaluations == 18


def test_the_command_s_default_is_the_library_s():
    assert inspect.signature(localize_command).parameters["checkpoint_every"].default == EVERY
