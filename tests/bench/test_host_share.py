"""The benchmark of the host's share: its parts add up, and it changes no result; no test asserts a speed."""

import host_share

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
