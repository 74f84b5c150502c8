"""Result files that someone has changed and sealed again: commands use them, or refuse them in one line."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.attacks import examples
from support.commands import error_of
from support.forged import ARRAYS, VALUES, forge, forge_place, set_dataset

LINES = {
    "run.h5": [
        "export run.h5 --to traces-csv",
        "export run.h5 --to drive-wav --duration 0.1",
        "export run.h5 --to drive-csv --case equal --json",
        "verify run.h5 --data velocities.csv --json",
    ],
    "focus.h5": [
        "focus focus.toml --waveforms focus.h5 --no-pictures --json --force",
        "export focus.h5 --to drive-wav --case optimum",
        "export focus.h5 --to drive-csv --case one_bit --json",
    ],
    "sweep.h5": ["sweep panel.toml --vary drive.frequency=280,290 --what simulate --out sweep.h5 --no-pictures --json"],
}


@pytest.fixture
def forged_folder(filled, tmp_path, monkeypatch):
    """A working folder with a result of each kind, and its content beside it."""
    shutil.copytree(filled, tmp_path / "at")
    monkeypatch.chdir(tmp_path / "at")
    for name in LINES:
        shutil.copy(name, Path(name).with_suffix(".right"))


@pytest.mark.slow
@pytest.mark.hour
@examples(40)
@given(
    line=st.sampled_from([(name, line) for name, lines in LINES.items() for line in lines]),
    place=st.integers(0, 10**6),
    value=st.sampled_from(VALUES),
    way=st.sampled_from(list(ARRAYS)),
)
def test_any_value_in_any_place(line, place, value, way, forged_folder, command):
    path, words = Path(line[0]), line[1].split()
    forge_place(path, place, value, way)
    status, _, err = command(*words)
    assert status in (0, 2)
    assert "Traceback" not in err
    if status:
        assert all(line.startswith("warp-plate: ") for line in err.splitlines())
        assert err.strip().replace("\n", "").isprintable()


@pytest.mark.slow
@pytest.mark.parametrize("way", ["one nan", "inf", "huge"])
@pytest.mark.parametrize(("path", "name"), [("focus.h5", "methods/optimum/waveforms"), ("run.h5", "cases/best/real")])
def test_drives_that_no_amplifier_plays(path, name, way, forged_folder, command):
    forge(Path(path), lambda file: set_dataset(file, name, ARRAYS[way](file[name][()])))
    for line in LINES[path]:
        assert f"{path}: damaged: {name} must hold numbers from" in error_of(command(*line.split()))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["nan", "huge", "negative"])
def test_points_of_a_sweep_of_no_known_status(way, forged_folder, command):
    forge(Path("sweep.h5"), lambda file: set_dataset(file, "status", ARRAYS[way](file["status"][()])))
    answer = command(*LINES["sweep.h5"][0].split())
    assert "sweep.h5: damaged: status must hold 0, 1 or 2 for each point" in error_of(answer)


@pytest.mark.slow
def test_other_points_of_a_sweep_that_are_whole_numbers(forged_folder, command):
    forge(Path("sweep.h5"), lambda file: set_dataset(file, "drive.frequency", np.array([100, 200])))
    answer = command(*LINES["sweep.h5"][0].split())
    assert "other points (2 points, drive.frequency from 100 to 200)" in error_of(answer)
