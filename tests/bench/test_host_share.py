"""The benchmark of the host's share: its parts add up, and it changes no result; no test asserts a speed."""

import host_share

from warp_plate.optimize.optimizer import minimize
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve
from warp_plate.studies.searches import search_optimizer


def test_parts_add_up_and_the_clock_changes_no_bit(scene):
    for row, plates in zip(host_share.measure(scene(nodes=(9, 9)), "cpu", (3, 20), 3), (3, 20), strict=True):
        seconds = row["seconds"]
        assert (row["plates"], set(seconds)) == (plates, {"whole", "device", *host_share.PARTS})
        assert 0 < row["host_share"] < 1
        assert 0 < seconds["device"] < seconds["whole"]
        assert min(seconds.values()) > 0
    plain, timed = (
        make_problem(resolve(scene(nodes=(9, 9), search={"particles": 5, "iterations": 3}), "cpu")) for _ in range(2)
    )
    clock = host_share.DeviceTime(timed)
    best, same = (minimize(search_optimizer(one, 0), one.losses).fbest for one in (plain, timed))
    assert best == same
    assert clock.taken() > 0
