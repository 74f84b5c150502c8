"""What an estimate must not claim: answers that nothing resolves, drives that nobody tried, windows without a step."""

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.accuracy import reference_solution as truth
from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.estimate import estimate
from warp_plate.plate.weights import localization_factor
from warp_plate.reference.forced import localization_factors
from warp_plate.scene.model import Grid, Window


def test_what_is_not_resolved_is_not_known(panel):
    """At a frequency whose waves the functions cannot follow, the answer stands still at a wrong value."""
    fast = panel.model_copy(update={"drive": panel.drive.model_copy(update={"frequency": 3e4})})
    fast = fast.model_copy(update={"window": Window(start=20 / 3e4, end=40 / 3e4)})
    assert truth.grow(fast, "ritz", "cpu", 0.02, 0.05).uncertainty >= 1


def test_functions_follow_the_sides():
    """As many in all, in proportion to the sides, within what rounding allows."""
    assert truth._functions((0.2, 0.2), 20) == (20, 20)
    wide, high = truth._functions((0.4, 0.1), 20), truth._functions((0.1, 0.4), 20)
    assert wide == high[::-1] == (40, 10)
    assert max(truth._functions((2.0, 0.1), 40)) == 60
    assert min(truth._functions((2.0, 0.1), 12)) == 8


@pytest.mark.slow
def test_a_drive_asked_for_keeps_the_accuracy(panel):
    """Not only the best drives: one that avoids the target, too."""
    drive = np.array([[0.2, 1.0, -0.7j]])[:, : len(panel.actuators)]
    choice = choose(panel, 0.02, "cpu", drive)
    found = localization_factor(PlateSolver(choice.scene, "cpu").run(drive).energy)
    known = truth.find_reference_solution(panel, "auto", "cpu", 1e-4, 20.0, drive)
    right = localization_factors(known.matrices, drive)
    assert np.abs(found / right - 1).max() <= 0.02


def test_a_short_window_is_no_reason_to_fail(panel):
    """The plates that price fourth order have longer steps than the run's, and none may fall into its window."""
    short = panel.model_copy(update={"window": Window(start=panel.window.end - 6e-5, end=panel.window.end)})
    short = short.model_copy(update={"grid": Grid(nodes=(75, 75), load="overlap")})
    drive = np.eye(len(panel.actuators), dtype=complex)[:1]
    factor = localization_factor(PlateSolver(short, "cpu").run(drive).energy)
    assert np.isfinite(estimate(short, drive, factor, 0.1, "cpu").error)
