"""``warp-plate frf``: its JSON, table, files and picture, and what it refuses."""

import json
from pathlib import Path

import pytest

from support.commands import error_of, output_of
from warp_plate.studies.frequency_response import frf


@pytest.fixture
def damped(write_scene):
    """The file panel.toml of a small damped plate."""
    return write_scene(damping=10.0)


def test_json_table_and_files(command, damped):
    pytest.importorskip("matplotlib")
    asked = ("--from", "1", "--from", "0.1,0.05", "--at", "0.05,0.07", "--range", "20:120", "--quantity", "receptance")
    expected = frf(damped, ["1", (0.1, 0.05)], [(0.05, 0.07)], (20, 120), "receptance")
    answer = command("frf", "panel.toml", *asked, "--json", "--to", "csv", "--to", "hdf5", "--out", "found.svg")
    record = json.loads(output_of(answer))
    assert record["pairs"] == [{"from": "1", "at": [0.05, 0.07]}, {"from": "0.1,0.05", "at": [0.05, 0.07]}]
    assert (record["quantity"], record["unit"]) == ("receptance", "m/N")
    assert record["frequencies"] == pytest.approx(expected.frequencies.tolist())
    for index in (0, 1):
        size = abs(expected.responses[index]).max()
        assert record["real"][index] == pytest.approx(expected.responses[index].real.tolist(), abs=1e-6 * size)
        assert record["imaginary"][index] == pytest.approx(expected.responses[index].imag.tolist(), abs=1e-6 * size)
    for name in ("localization_factor", "bound", "natural_frequencies", "loss_factors"):
        assert record[name] == pytest.approx(getattr(expected, name).tolist(), rel=1e-6)
    assert record["mean_square_velocity"][1] == pytest.approx(expected.mean_square_velocity[1].tolist(), rel=1e-6)
    assert record["errors"]["bound"] == pytest.approx(expected.errors.bound.tolist(), rel=1e-6)
    assert [len(row) for row in record["errors"]["responses"]] == [len(expected.frequencies)] * 2
    assert record["files"] == ["found.csv", "found.h5", "found.svg"]
    assert sorted(path.name for path in Path().iterdir()) == ["found.csv", "found.h5", "found.svg", "panel.toml"]
    drawn = Path("found.svg").read_text(encoding="utf-8")
    labels = ("1 → (50, 70) mm", "(100, 50) mm → (50, 70) mm")
    for words in (*labels, "bound", "natural frequency", "receptance [m/N]", "frequency [Hz]"):
        assert f"<!-- {words} -->" in drawn


def test_text_names_responses_and_undamped_plates(command, write_scene):
    write_scene(damping=10.0)
    out = output_of(command("frf", "panel.toml", "--no-pictures", "--range", "20:60", "--out", "found.csv"))
    for part in ("0 → 0.05,0.05", "(m/s)/N", "± (%)", "20 to 60 Hz", "wrote found.csv"):
        assert part in out
    assert "undamped" not in out
    write_scene()
    assert "undamped" in output_of(command("frf", "panel.toml", "--no-pictures", "--range", "20:60"))
    assert sorted(path.name for path in Path().iterdir()) == ["found.csv", "panel.toml"]


WRONG = {
    "--from": "9 0.1,0.3 0.1;0.3",
    "--at": "0.1 nan,0.1 0.1,-0.1 -0.1,0.1",
    "--range": "100 100:50 0:50 50:1e99 50:900000 ٣:50",
    "--quantity": "speed",
    "--to": "xls",
    "--out": "a.txt none/a.png",
}


@pytest.mark.parametrize("option", WRONG)
def test_wrong_options_are_refused_in_one_line(option, command, damped):
    for value in WRONG[option].split():
        line = error_of(command("frf", "panel.toml", "--no-pictures", option, value))
        assert value.strip("٣") in line
        assert option == "--out" or option in line
        assert [path.name for path in Path().iterdir()] == ["panel.toml"]


def test_scenes_that_are_not_linear_are_refused(command, write_scene):
    write_scene(effects={"stretching": {}})
    assert "effects.stretching" in error_of(command("frf", "panel.toml"))
