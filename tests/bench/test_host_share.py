"""The benchmark of the host's share: its parts add up, and it changes no result; no test asserts a speed."""

import json
import sys

import host_share
import pytest

from warp_plate.optimize.optimizer import minimize
from warp_plate.problem.problem import make_problem
from warp_plate.studies.driver import search_optimizer


def test_parts_add_up_to_the_whole(scene):
    rows = host_share.measure(scene(nodes=(9, 9)), "cpu", (3, 20), 3)
    assert [row["plates"] for row in rows] == [3, 20]
    for row in rows:
        seconds = row["seconds"]
        assert 0 < row["host_share"] < 1
        assert 0 < seconds["steps"] == seconds["device"] < seconds["whole"]
        assert set(seconds) == {"whole", "device", "steps", *host_share.PARTS}
        assert all(seconds[name] > 0 for name in seconds)


def test_the_clock_changes_no_bit(scene):
    found = []
    for timed in (False, True):
        problem = make_problem(scene(nodes=(9, 9), search={"particles": 5, "iterations": 3}), "cpu")
        clock = host_share.DeviceTime(problem) if timed else None
        found.append(minimize(search_optimizer(problem, 0), problem.losses).fbest)
        assert clock is None or clock.taken()[1] > 0
    assert found[0] == found[1]


def test_the_table_and_the_file(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(
        host_share,
        "measure",
        lambda *_: [
            {
                "plates": 20,
                "host_share": 0.25,
                "seconds": {"whole": 4e-3, "device": 3e-3, "steps": 2e-3} | dict.fromkeys(host_share.PARTS, 25e-5),
            }
        ],
    )
    monkeypatch.setattr(sys, "argv", ["host_share.py", "--device", "cpu", "--out", str(tmp_path / "a.json")])
    host_share.main()
    assert "4.00 ms    3.00 ms    2.00 ms  25.0 %" in capsys.readouterr().out
    record = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert set(record) == {"machine", "versions", "rows"}
    monkeypatch.setattr(sys, "argv", ["host_share.py", "--device", "abacus"])
    with pytest.raises(SystemExit):
        host_share.main()
