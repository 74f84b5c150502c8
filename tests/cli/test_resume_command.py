"""The command that goes on with a search: what it takes, what it refuses, and searches that were killed."""

import inspect
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_resume import assert_same, stop_after

from warp_plate import Scene, SceneError, load_result, localize, resume
from warp_plate.cli.localize import localize as localize_command
from warp_plate.result.checkpoint import load_newest, previous_path
from warp_plate.scene.dump import dump_scene
from warp_plate.studies.checkpointing import EVERY, CheckpointFile

ROOT = Path(__file__).parents[2]
COMMAND = ["localize", "panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate"]


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
    localize(panel, "panel.toml", "cpu", on_progress=stop_after(5), estimate=False, checkpoints=file)
    return file.path


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
        (["--resume", "."], r"\.: is no file"),
        (["--resume", "result.h5"], "result.h5: not a checkpoint of warp-plate"),
    ],
)
def test_a_scene_or_a_checkpoint_is_needed(options, named, command, panel):
    command("simulate", "panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate", "--out", "result.h5")
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
        files = ["panel-localize.h5", "panel-localize.best.toml"]
        assert answer["files"] == files
        assert sorted(map(str, Path().iterdir())) == sorted([*files, "panel.toml"])
        save = load_result("panel-localize.h5")
        assert_same(replace(save, cases=whole.cases), whole)
        for name, case in whole.cases.items():
            assert save.cases[name].energy == case.energy


def test_a_damaged_checkpoint_gives_way_to_the_one_before(command, panel, left):
    previous = previous_path(left)
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


def test_two_searches_into_one_file(panel, tmp_path):
    """The one whose checkpoint another search has replaced says so once and leaves that one alone, to the end too."""
    told = []
    mine, other = (CheckpointFile(Path("search.checkpoint.h5"), 0.0, warn=told.append) for _ in range(2))
    go = {"told": stop_after(3), "estimate": False}
    localize(panel, "panel.toml", "cpu", checkpoints=mine, **go)
    assert told == []
    assert mine.saved.iterations == 3
    localize(panel, "panel.toml", "cpu", 5, checkpoints=CheckpointFile(mine.path, 0.0, warn=told.append), **go)
    replaced = mine.path.read_bytes()
    for last in (mine, other):
        told.clear()
        for _ in range(2):
            localize(panel, "panel.toml", "cpu", checkpoints=last, **go)
        assert len(told) == 1
        assert "search.checkpoint.h5 is written by another search" in told[0]
        assert last.saved is None
        last.remove()
        assert mine.path.read_bytes() == replaced


def test_a_result_in_the_place_of_its_checkpoint(command, panel, left):
    """Is whole, so the checkpoint before the last one is not what was meant."""
    previous_path(left).write_bytes(left.read_bytes())
    status, _, _ = command(*COMMAND, "--out", "whole.h5")
    Path("whole.h5").replace("panel-localize.h5")
    status, _, err = command("localize", "--resume", "panel-localize.h5", "--no-pictures", "--no-estimate")
    assert (status, len(err.splitlines())) == (2, 1)
    assert "not a checkpoint of warp-plate" in err


def modified(file):
    """When [ns]; 0 where it is not there, as for a moment while the next one takes its place."""
    try:
        return file.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def killed(arguments, moment, random):
    """Start the command and kill it some time after its first checkpoint is there; whether it ended by itself."""
    process = subprocess.Popen(
        [sys.executable, "-m", "warp_plate", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    file = Path("panel-localize.checkpoint.h5")
    before = modified(file)
    while process.poll() is None and modified(file) in (0, before):
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
    file = CheckpointFile(Path("panel-localize.checkpoint.h5"), resumes=True)
    file.remove()
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_twice(panel, random):
    killed_until(2, 0.1, panel, random)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_at_twenty_random_moments(panel, random):
    killed_until(20, 0.05, panel, random)


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


def test_files_that_the_scene_names_must_be_the_same(command, panel):
    """They lie beside the scene where it is given, else beside the checkpoint; another content is refused."""
    Path("scenes").mkdir()
    text = Path("panel.toml").read_text(encoding="utf-8") + '\n[effects.variation]\nthickness = "map.csv"\n'
    Path("scenes/panel.toml").write_text(text, encoding="utf-8")
    Path("scenes/map.csv").write_text("1.0, 1.1\n0.9, 1.0\n", encoding="utf-8")
    made = Scene.load("scenes/panel.toml")
    file = Path("panel-localize.checkpoint.h5")
    checkpoints = CheckpointFile(file, np.inf)
    localize(made, "panel", "cpu", on_progress=stop_after(390), estimate=False, checkpoints=checkpoints)
    kept, going_on = file.read_bytes(), ["localize", "--resume", file, "--no-pictures", "--no-estimate"]
    for others, named in (
        ((), "effects.variation.thickness = 'map.csv': no such file beside the scene file"),
        (("map.csv",), "effects.variation.thickness: the file holds something else than when the search began"),
    ):
        for name in others:
            Path(name).write_text("1.0, 1.2\n0.9, 1.0\n", encoding="utf-8")
        status, _, err = command(*going_on)
        assert (status, len(err.splitlines())) == (2, 1)
        assert named in err
        assert file.read_bytes() == kept
    whole = localize(made, "panel", "cpu", estimate=False)
    assert command(*going_on, "scenes/panel.toml")[0] == 0
    assert load_result("panel-localize.h5").cases["best"].energy == whole.cases["best"].energy
    file.write_bytes(kept)
    Path("map.csv").write_bytes(Path("scenes/map.csv").read_bytes())
    assert command(*going_on)[0] == 0
    np.testing.assert_array_equal(load_result("panel-localize.h5").history["best"], whole.history["best"])
