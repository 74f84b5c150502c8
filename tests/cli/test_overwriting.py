"""Files of other commands and programs are replaced only by ``--force``, and named where they are read."""

import json

import pytest

from support.commands import output_of

FAST = ("--device", "cpu", "--no-pictures")


@pytest.fixture
def simulated(command, tmp_path):
    """A result of simulate."""
    file = tmp_path / "a.h5"
    output_of(command("simulate", "paper", *FAST, "--no-estimate", "--out", file))
    return file


@pytest.mark.parametrize(
    "words", [("localize",), ("compare",), ("sweep", "--what", "check", "--vary", "drive.frequency=290,300")]
)
def test_results_of_other_commands_stay(command, simulated, words):
    before = simulated.read_bytes()
    name, *others = words
    status, _, error = command(name, "paper", *others, *FAST, "--out", simulated)
    assert status == 2
    assert "--force" in error
    assert simulated.read_bytes() == before


def test_the_same_command_and_force_replace(command, simulated):
    again = ("paper", *FAST, "--no-estimate", "--out", simulated)
    output_of(command("simulate", *again))
    assert "is a result of simulate and would be overwritten" in command("localize", *again)[2]
    sweep = ("sweep", "paper", "--what", "check", "--vary", "drive.frequency=290,300", *FAST, "--out", simulated)
    output_of(command(*sweep, "--force"))
    status, _, error = command("view", simulated)
    assert status == 2
    assert "this is a sweep (format" in error


def test_files_of_other_programs_stay(command, tmp_path):
    ours, notes = tmp_path / "a.h5", tmp_path / "a.best.toml"
    ours.write_bytes(b"my data")
    for words in (("simulate", "paper"), ("localize", "paper")):
        status, _, error = command(*words, *FAST, "--out", ours)
        assert (status, ours.read_bytes()) == (2, b"my data")
        assert "another command or program" in error
    ours.unlink()
    notes.write_text("title = 'mine'")
    status, _, error = command("localize", "paper", *FAST, "--out", ours)
    assert status == 2
    assert f"{notes}: was written by another" in error


def test_measurements_stay(command, tmp_path):
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"limits": 1}, indent=1))
    status, _, error = command("accuracy", "paper", "--out", file)
    assert status == 2
    assert "--force" in error
