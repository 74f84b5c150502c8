"""``warp-plate accuracy``: its table, JSON and picture, Ctrl-C, and invalid options."""

import json
from functools import partial
from pathlib import Path

import pytest
from conftest import output_of

from warp_plate.accuracy import configurations as family
from warp_plate.accuracy import report

ROW_KEYS = {
    "order", "load", "nodes", "time_step", "precision", "localization_factor", "bound", "error", "seconds_per_plate",
    "status",
}  # fmt: skip


@pytest.fixture
def command(command, tmp_path, monkeypatch):
    """Run ``accuracy`` on small grids in an empty folder: (status, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(family, "SIDES", (9, 13, 417))
    monkeypatch.setattr(family, "BASE_SIDE", 9)
    monkeypatch.setattr(report, "REFERENCE_ERROR", 2e-3)
    return partial(command, "accuracy")


def test_json_and_picture(command):
    pytest.importorskip("matplotlib")
    answer = command("paper-supported", "--device", "cpu", "--budget", "60", "--json", "--out", "a.json")
    record = json.loads(output_of(answer))
    assert set(record["reference"]) >= {"kind", "localization_factor", "bound", "uncertainty"}
    assert record["reference"]["localization_factor"] == pytest.approx(0.6223, abs=1e-3)
    rows = record["rows"]
    assert all(set(row) >= ROW_KEYS for row in rows)
    assert [row["as_written"] for row in rows].count(True) == 1
    kinds = {row["status"].partition(":")[0] for row in rows}
    assert kinds == {"ok", "refused", "skipped"}
    measured = [row for row in rows if row["status"] == "ok"]
    assert all(0 < row["error"] < 10 and row["seconds_per_plate"] > 0 for row in measured)
    assert [entry["tolerance"] for entry in record["recommended"]] == [0.1, 0.03, 0.01, 0.003, 0.001]
    for entry in record["recommended"]:
        if entry["row"] is not None:
            assert rows[entry["row"]]["error"] <= entry["tolerance"]
    assert {"system", "devices"} <= set(record["machine"])
    assert "warp-lang" in record["versions"]
    files = record.pop("files")
    assert files == ["a.json", "a.png", "a.svg"]
    assert json.loads(Path("a.json").read_text(encoding="utf-8")) == record
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert "order 4, moments" in Path("a.svg").read_text(encoding="utf-8")


def test_table(command):
    out = output_of(command("paper", "--device", "cpu", "--budget", "40", "--no-pictures"))
    for part in ("as written: order 2, nodes, backward damping", "order 4, moments", "measured laws", "refused"):
        assert part in out
    assert out.splitlines()[-1] == "wrote paper-accuracy.json"
    assert max(map(len, out.splitlines())) <= 80


def test_ctrl_c_keeps_the_measurements(command, monkeypatch):
    plain = report.measure
    calls = []

    def stopped(*arguments):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return plain(*arguments)

    monkeypatch.setattr(report, "measure", stopped)
    record = json.loads(output_of(command("paper", "--device", "cpu", "--json", "--no-pictures")))
    assert record["interrupted"]
    assert len(record["rows"]) == 2
