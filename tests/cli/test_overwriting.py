"""Files of other commands and programs are replaced only by ``--force``, and named where they are read."""

import json
import os
import shutil
import stat
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from support.commands import error_of, output_of
from warp_plate import SceneError, load_result, save_result, simulate
from warp_plate.cli import output

FAST = ("--device", "cpu", "--no-pictures")


@pytest.fixture(scope="module")
def result_of_simulate(tmp_path_factory):
    return save_result(simulate("paper", device="cpu", estimate=False), tmp_path_factory.mktemp("simulate") / "a.h5")


@pytest.fixture
def simulated(result_of_simulate, tmp_path):
    return Path(shutil.copy(result_of_simulate, tmp_path))


@pytest.mark.parametrize("words", [("localize",), ("sweep", "--what", "check", "--vary", "drive.frequency=290,300")])
def test_results_of_other_commands_stay_without_force(command, simulated, words):
    before = simulated.read_bytes()
    name, *others = words
    line = (name, "paper", *others, *FAST, "--out", simulated)
    assert "--force" in error_of(command(*line))
    assert simulated.read_bytes() == before
    if name == "sweep":
        output_of(command(*line, "--force"))
        assert "this is a sweep (format" in error_of(command("view", simulated))


def test_the_same_command_replaces_its_result(command, simulated):
    output_of(command("simulate", "paper", *FAST, "--no-estimate", "--out", simulated))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has only read-only and other files")
def test_a_file_that_is_written_again_stays_private_or_read_only(command, simulated):
    line = ("simulate", "paper", *FAST, "--no-estimate", "--out", simulated)
    simulated.chmod(0o600)
    output_of(command(*line))
    assert stat.S_IMODE(simulated.stat().st_mode) == 0o600
    simulated.chmod(0o444)
    before = simulated.read_bytes()
    for force in ((), ("--force",)):
        assert f"{simulated}: is read-only" in error_of(command(*line, *force))
    best, other = simulated.with_name("b.best.toml"), simulated.with_name("b.h5")
    best.touch(0o444)
    assert f"{best}: is read-only" in error_of(command("localize", "paper", *FAST, "--out", other))
    with pytest.raises(SceneError, match="is read-only"):
        save_result(load_result(simulated), simulated)
    assert simulated.read_bytes() == before


def test_files_of_other_programs_stay(command, tmp_path):
    ours, notes = tmp_path / "a.h5", tmp_path / "a.best.toml"
    ours.write_bytes(b"my data")
    for name in ("simulate", "localize"):
        assert "another command or program" in error_of(command(name, "paper", *FAST, "--out", ours))
        assert ours.read_bytes() == b"my data"
    ours.unlink()
    notes.write_text("title = 'mine'")
    assert f"{notes}: was written by another" in error_of(command("localize", "paper", *FAST, "--out", ours))
    for name, ending in (("frf", ".csv"), ("frf", ".CSV"), ("sound", ".csv")):
        (numbers := tmp_path / f"a{ending}").write_text("frequency [Hz],mine\n")
        assert f"{numbers}: was written by another" in error_of(command(name, "paper", "--out", numbers))
    free = "--set=design.thickness={range=[3e-4,7e-4],length_scale=0.1}"
    for ending in (".thickness.csv", ".stl", ".3mf"):
        (drawn := tmp_path / f"a{ending}").write_text("mine")
        line = ("design", "paper", free, "--solid", "--out", tmp_path / "a.toml")
        assert f"{drawn}: was written by another" in error_of(command(*line))
        drawn.unlink()
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"limits": 1}, indent=1))
    assert "--force" in error_of(command("accuracy", "paper", "--out", file))


@pytest.mark.parametrize(
    "line",
    [
        "localize panel.toml --no-estimate",
        pytest.param("simulate panel.toml --no-estimate", marks=pytest.mark.slow),
        pytest.param("sweep panel.toml --what check --vary drive.frequency=290,300", marks=pytest.mark.slow),
        pytest.param("modes panel.toml --out a.svg", marks=pytest.mark.slow),
        pytest.param("frf panel.toml --out a.csv", marks=pytest.mark.slow),
        pytest.param("sound panel.toml --out a.csv", marks=pytest.mark.slow),
        pytest.param("focus panel.toml", marks=pytest.mark.slow),
        pytest.param("fit panel.toml --data modes.csv", marks=pytest.mark.slow),
    ],
)
def test_answers_that_no_disk_has_room_for_are_printed(line, command, write_scene, monkeypatch):
    free = {"fit": {"free": {"plate.young_modulus": (9e8, 1.1e9)}, "starts": 1}}
    pulse = {"points": [(0.06, 0.05)], "highest": 200.0, "time": 0.01, "rate": 2000}
    write_scene(nodes=(9, 9), damping=88.5, search={"particles": 3, "iterations": 2}, focus=pulse, **free)
    Path("modes.csv").write_text("frequency\n38\n77\n78\n115\n", encoding="utf-8")
    words = (*line.split(), "--json", *(() if "--out" in line else ("--no-pictures",)))
    with monkeypatch.context() as full:
        full.setattr(os, "replace", Mock(side_effect=OSError(28, "No space left on device")))
        status, out, error = command(*words)
    assert status == 2
    assert "cannot be written: No space left on device" in error.splitlines()[-1]
    expected = json.loads(output_of(command(*words)))
    assert expected.pop("files")
    assert {**json.loads(out), "seconds": None} == {**expected, "seconds": None}


def test_files_written_before_one_that_cannot_be_are_named():
    full = Mock(side_effect=SceneError("b: cannot be written"))
    with pytest.raises(SceneError, match=r"^b: cannot be written; wrote a$"):
        output.write_files({Path("a"): str, Path("b"): full}, None)
    with pytest.raises(SceneError, match=r"^b: cannot be written$"):
        output.write_files({Path("b"): full}, None)
