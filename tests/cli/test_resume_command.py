"""``warp-plate localize --resume``: what it accepts and refuses, and searches that were killed."""

import json
import re
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.commands import error_of, output_of, start_program
from support.searches import assert_same_results, stop_after
from warp_plate import Scene, SceneError, load_result, localize, resume
from warp_plate.result.checkpoint import load_checkpoint
from warp_plate.studies.unfinished import CheckpointFile

QUICK = ("--no-pictures", "--no-estimate")
COMMAND = ("localize", "panel.toml", "--device", "cpu", *QUICK)
FILE = Path("panel-localize.checkpoint.h5")


@pytest.fixture
def resumable(write_scene):
    """A small scene with a search, in a file of the working folder."""
    return write_scene(damping=88.5, precision="float32", search={"particles": 6, "iterations": 60})


@pytest.fixture
def left(resumable):
    """The checkpoint of a search of the panel that Ctrl-C ended."""
    file = CheckpointFile(FILE, np.inf)
    localize(resumable, source="panel.toml", device="cpu", on_progress=stop_after(5), estimate=False, checkpoints=file)
    return file.path


def test_what_would_change_the_result_is_refused_by_name(command, resumable, left, write_scene):
    write_scene(resumable.with_tables(plate={**resumable.plate.model_dump(), "thickness": 1e-3}), "thicker")
    before = left.read_bytes()
    for options, named in (
        ("--seed 3", "--seed 3: the search in panel-localize.checkpoint.h5 began with 0"),
        ("--evaluator response", "--evaluator response: the search in .* began with direct"),
        ("--path streaming", "--path streaming: the search in .* began with auto"),
        ("--set drive.frequency=300", "an unfinished search has its own"),
        ("--accuracy 1%", "the scene is not that of the search in"),
        ("thicker.toml", "the scene is not that of the search in"),
    ):
        assert re.search(named, error_of(command("localize", "--resume", left, *options.split(), "--no-pictures")))
        assert left.read_bytes() == before
    assert not Path("panel-localize.h5").exists()


def test_the_command_resumes(command, resumable, left):
    """The same scene may be given or not; the result is beside the checkpoint, which is deleted."""
    kept = left.read_bytes()
    full = localize(resumable, source="panel.toml", device="cpu", estimate=False)
    for more in ([], ["panel.toml", "--seed", "0", "--path", "auto", "--device", "cpu"]):
        left.write_bytes(kept)
        record = json.loads(output_of(command("localize", "--resume", left, *more, *QUICK, "--json")))
        assert (record["interrupted"], record["checkpoint"]) == (False, None)
        files = ["panel-localize.h5", "panel-localize.best.toml"]
        assert record["files"] == files
        assert sorted(map(str, Path().iterdir())) == sorted([*files, "panel.toml"])
        result = load_result("panel-localize.h5")
        assert_same_results(replace(result, cases=full.cases), full)
        for name, case in full.cases.items():
            assert result.cases[name].energy == case.energy
    Path("other.h5").write_bytes(kept)  # a checkpoint by another name is not overwritten
    record = json.loads(output_of(command("localize", "--resume", "other.h5", *QUICK, "--json")))
    assert record["files"] == ["other-localize.h5", "other-localize.best.toml"]


def test_a_damaged_checkpoint_is_refused(command, left):
    left.write_bytes(b"x")
    assert "panel-localize.checkpoint.h5: damaged: " in error_of(command("localize", "--resume", left, *QUICK))


def killed(arguments, seconds):
    """Start the command and kill it some time after it has written a checkpoint; return whether it ended before."""

    def modified():
        return FILE.stat().st_mtime_ns if FILE.exists() else None

    before, process = modified(), start_program("-m", "warp_plate", *arguments)
    with suppress(FileNotFoundError):  # while it is being replaced
        while process.poll() is None and modified() in (None, before):
            time.sleep(0.002)
    time.sleep(seconds)
    process.kill()
    _, err = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), err
    return process.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("kills", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_killed_at_random_moments(kills, resumable, random, write_scene):
    """A search killed and resumed several times gives the result of one that was left alone."""
    resumable = write_scene(resumable.with_tables(search={"particles": 6, "iterations": 200}))
    arguments, reached = [*COMMAND, "--checkpoint-every", "0"], [0]
    for _ in range(kills):
        assert not killed(arguments, random.uniform(0, 0.3 / kills))
        checkpoint = load_checkpoint(FILE)
        reached.append(checkpoint.iterations)
        arguments = ["localize", "--resume", str(FILE), *QUICK, "--checkpoint-every", "0"]
    assert reached == sorted(reached)
    found = resume(checkpoint, estimate=False)
    assert_same_results(
        replace(found, source="panel.toml"), localize(resumable, source="panel.toml", device="cpu", estimate=False)
    )
    CheckpointFile(FILE).remove()
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


def test_a_result_that_cannot_be_written_leaves_the_checkpoint(command, resumable, monkeypatch, write_scene):
    def full_disk(result, path):
        raise SceneError(f"{path}: cannot be written: No space left on device")

    write_scene(resumable.with_tables(search={"particles": 6, "iterations": 3}))
    with monkeypatch.context() as patch:
        patch.setattr("warp_plate.result.model.save_result", full_disk)
        status, answer, err = command(*COMMAND, "--checkpoint-every", "0")
    assert status == 2
    assert answer
    assert "there is a checkpoint after 3 of 3 iterations" in err
    assert err.endswith(f"warp-plate localize --resume {FILE}\n")
    assert command("localize", "--resume", FILE, *QUICK)[0] == 0
    assert load_result("panel-localize.h5").evaluations == 18


def test_files_that_the_scene_names_must_be_the_same(command, resumable):
    """They are beside the scene if that is given, else beside the checkpoint."""
    Path("scenes").mkdir()
    text = Path("panel.toml").read_text(encoding="utf-8") + '\n[effects.variation]\nthickness = "map.csv"\n'
    Path("scenes/panel.toml").write_text(text, encoding="utf-8")
    Path("scenes/map.csv").write_text("1.0, 1.1\n0.9, 1.0\n", encoding="utf-8")
    scene = Scene.load("scenes/panel.toml")
    checkpoints = CheckpointFile(FILE, np.inf)
    localize(scene, source="panel", device="cpu", on_progress=stop_after(55), estimate=False, checkpoints=checkpoints)
    kept, resuming = FILE.read_bytes(), ["localize", "--resume", FILE, *QUICK]
    assert "effects.variation.thickness = 'map.csv': no such file beside the" in error_of(command(*resuming))
    Path("map.csv").write_text("1.0, 1.2\n0.9, 1.0\n", encoding="utf-8")
    assert "effects.variation.thickness: the file has changed since the search" in error_of(command(*resuming))
    assert FILE.read_bytes() == kept
    full = localize(scene, source="panel", device="cpu", estimate=False)
    assert command(*resuming, "scenes/panel.toml")[0] == 0
    assert load_result("panel-localize.h5").cases["best"].energy == full.cases["best"].energy
    FILE.write_bytes(kept)
    Path("map.csv").write_bytes(Path("scenes/map.csv").read_bytes())
    assert command(*resuming)[0] == 0
