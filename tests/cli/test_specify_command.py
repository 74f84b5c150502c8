"""``warp-plate specify``: its table, JSON, picture and scene, and what it refuses."""

import io
import json
import math
import re
from types import SimpleNamespace

import pytest
from rich.console import Console

from support.commands import error_of, output_of
from warp_plate import Scene
from warp_plate.cli.specify import MOST_CASES, _print_tolerances
from warp_plate.result.specified import Scatter


def test_the_answer_is_printed_drawn_and_written(command, tmp_path):
    out = tmp_path / "button.json"
    changes = ("--set=specification.frequency=250.0", "--set=title=two\nlines = 2", "--set=grid.modal_density=0.6")
    printed = output_of(command("specify", "console", *changes, "--out", str(out)))
    assert "at 250 Hz a drive meets the specification" in printed
    assert "elsewhere, worst point" in printed
    assert re.search(r"target +rms +0\.7071 ", printed)
    assert "least limits as specified (%)" in printed
    assert out.with_suffix(".png").stat().st_size > 50_000
    record = json.loads(out.read_text())
    assert record["feasible"] is True
    level = record["levels"]["target"]
    assert level["weakest"] == pytest.approx(9.80665, rel=1e-4)
    assert level["weakest_rms"] == pytest.approx(level["weakest"] / math.sqrt(2))
    assert 0 <= level["weakest_db"] < 1e-3
    assert level["worst_db"] == pytest.approx(20 * math.log10(level["worst"] / 9.80665))
    assert record["pareto"]["efforts"][6] == pytest.approx(record["effort"])
    assert list(record["forces"]) == ["A1", "A2", "A3", "A4", "A5", "A6"]
    best = Scene.load(out.with_suffix(".best.toml"))
    assert best.drive.frequency == 250
    assert best.actuators[1].force == pytest.approx(record["forces"]["A2"])


def test_drives_of_several_units_have_their_own(command, tmp_path):
    scene = Scene.load("console", ["specification.frequency=250.0", "grid.modal_density=0.6"])
    coil = {"name": "coil", "kind": "coil", "model": "DAEX25FHE-4", "disc": (0.05, 0.03, 0.0125), "voltage": 2.0}
    path = tmp_path / "mixed.toml"
    path.write_text(scene.with_tables(actuators=[*scene.model_dump()["actuators"][1:], coil]).to_toml())
    printed = output_of(command("specify", str(path), "--no-pictures", "--out", str(tmp_path / "mixed.json")))
    assert re.search(r"coil +2 V +0?\.?[0-9e.-]+ V ", printed)
    assert re.search(r"A2 +0\.5 N +0\.[0-9]+ N ", printed)
    assert re.search(r"target, weakest point +1 +1(\.0+)? +g peak", printed)


def test_what_would_do_is_that_of_the_best_frequency(command, tmp_path):
    """Resonance alone reaches the level with 0.05 N, but takes more for the contrast than 250 Hz does."""
    changes = ("--set=specification.limits.force=0.05", "--set=grid.modal_density=0.6")
    printed = output_of(command("specify", "console", *changes, "--no-pictures", "--out", str(tmp_path / "low.json")))
    assert "1.46 times the limits would do at 250 Hz, 0.0732 N" in " ".join(printed.split())


def test_the_worth_of_larger_limits_is_printed(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    changes = ["specification.frequency=250.0", "specification.limits.force=0.09", "grid.modal_density=0.6"]
    changes = [f"--set={change}" for change in changes]
    printed = " ".join(output_of(command("specify", "console", *changes, "--no-pictures")).split())
    (worth,) = re.findall(r"Larger limits lower the contrast, at first by ([^;]*?)\. ", printed)
    gains = re.findall(r"([0-9.]+) dB/N at (A\d)", worth)
    assert [name for _, name in gains] == ["A2", "A5"]
    assert float(gains[0][0]) == pytest.approx(float(gains[1][0]), rel=0.02)


def test_json_has_what_is_in_the_way(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    changes = ["--set", "specification.frequency=250.0", "--set", "specification.guard=0.0"]
    record = json.loads(output_of(command("specify", "console", *changes, "--no-pictures", "--json")))
    assert record["feasible"] is False
    assert record["proved"] is True
    assert record["effort"] is None
    assert record["bound_db"] <= record["contrast_db"]
    assert "exclude each other" in record["obstacles"][0]
    assert {"requirement", "wanted", "reached", "unit", "margin_db"} == set(record["margins"][0])


def test_scenes_without_a_specification_and_files_of_others_are_refused(command, tmp_path):
    assert "specification: is missing" in error_of(command("specify", "paper"))
    other = tmp_path / "paper-specify.json"
    other.write_text("{}")
    assert "would be overwritten" in error_of(command("specify", "console", "--out", str(other)))


def test_a_level_that_takes_drives_beyond_all_numbers_is_named(command, tmp_path):
    line = ("specify", "touch-panel", "--set", "specification={level={displacement=1e30}}", "--no-pictures")
    error = error_of(command(*line, "--out", tmp_path / "a.json"))
    assert "specification.level: actuators[0].magnitude = " in error


def test_the_worst_of_many_cases_are_printed():
    level = {"nominal_level": 1.0, "nominal_db": -9.0, "robust_level": 1.0, "best_db": -50.0, "met": True}
    many = [Scatter(changes={"gasket": 1.1}, robust_db=-float(number), **level) for number in range(40)]
    text = io.StringIO()
    _print_tolerances(SimpleNamespace(scatter=many, robust_frequency=215.0), Console(file=text, width=160))
    assert [f"-{number}.00" in text.getvalue() for number in (0, MOST_CASES - 1, MOST_CASES)] == [True, True, False]
    assert "28 better cases are left out" in text.getvalue()
