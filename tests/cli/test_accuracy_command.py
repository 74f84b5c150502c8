"""``warp-plate accuracy``: its table, JSON, files and picture, and Ctrl-C."""

import json
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pytest

from support.commands import output_of
from warp_plate.accuracy import report
from warp_plate.cli.accuracy import error_text

ROW_KEYS = {
    "order", "load", "nodes", "time_step", "precision", "localization_factor", "bound", "error", "seconds_per_plate",
    "status",
}  # fmt: skip


@pytest.fixture
def accuracy(command, write_scene, panel):
    """Run ``accuracy`` on the first grids of the panel, in an empty folder."""
    write_scene(panel)
    return partial(command, "accuracy", "panel.toml", "--device", "cpu", "--budget", "0.3")


def test_table_file_and_picture(accuracy):
    pytest.importorskip("matplotlib")
    out = output_of(accuracy("--out", "a.json"))
    written = "as written: order 2, overlap, centred damping"
    for part in ("modes, without a grid", written, "order 4, moments", "measured laws", "refused"):
        assert part in out
    assert out.splitlines()[-3:] == ["wrote a.json", "wrote a.png", "wrote a.svg"]
    assert max(map(len, out.splitlines())) <= 80
    record = json.loads(Path("a.json").read_text(encoding="utf-8"))
    assert set(record["reference"]) >= {"kind", "localization_factor", "bound", "uncertainty"}
    rows = record["rows"]
    assert all(set(row) >= ROW_KEYS for row in rows)
    assert [row["as_written"] for row in rows].count(True) == 1
    modal = [row for row in rows if row["load"] == "modal"]
    assert modal[-1]["error"] < 0.01
    assert modal[-1]["time_step"] is None
    assert all(row["seconds_once"] > 0 for row in modal)
    assert {row["status"].partition(":")[0] for row in rows} == {"ok", "refused", "skipped"}
    measured = [row for row in rows if row["status"] == "ok"]
    assert all(0 < row["error"] < 10 and row["seconds_per_plate"] > 0 for row in measured)
    assert [entry["tolerance"] for entry in record["recommended"]] == [0.1, 0.03, 0.01, 0.003, 0.001]
    for entry in record["recommended"]:
        assert entry["row"] is None or rows[entry["row"]]["error"] <= entry["tolerance"]
    assert {"system", "devices"} <= set(record["machine"])
    assert "warp-lang" in record["versions"]
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert "order 4, moments" in Path("a.svg").read_text(encoding="utf-8")


def test_errors_within_that_of_the_reference_are_bounds():
    found = [error_text(error, 0.01) for error in (None, 0.02, 0.01, 0.004)]
    assert found == ["~", "2", "≤2", "≤1.4"]


def test_ctrl_c_keeps_the_measurements(panel):
    def stop(done, total, name):
        if done == 3:
            raise KeyboardInterrupt

    found = report.measure_accuracy(panel, device="cpu", budget=4, on_progress=stop)
    with pytest.raises(KeyboardInterrupt):  # before the first
        report.measure_accuracy(panel, device="cpu", budget=4, on_progress=Mock(side_effect=KeyboardInterrupt))
    assert (found.interrupted, len(found.rows)) == (True, 3)
    assert found.as_json()["interrupted"]
