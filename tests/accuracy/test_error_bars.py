"""Printed error bars hold the truth by finite elements, on random scenes; ``benchmarks/error_bars`` has many more."""

import numpy as np
import pytest
from error_bars.__main__ import measured, missed
from error_bars.judge import true_factors

from warp_plate import Scene
from warp_plate.plate.weights import localization_factor
from warp_plate.reference import series

QUICK, SLOW = (11,), (4, 12, 25, 26, 36)


def test_the_judge_is_the_exact_series():
    scene, drive = Scene.load("paper-supported"), np.array([1, 0.3 - 0.4j, 0, 0.2j])
    exact = localization_factor(series.kinetic_energies(scene, drive, terms=40)[None])[0]
    assert true_factors(scene, drive[None], degree=9)[0] == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("number", [*QUICK, *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW)])
def test_the_truth_lies_within_bar_and_interval(number):
    rows = measured(number, promise=False)
    assert {row["engine"] for row in rows} == {"steps", "modes"}
    assert all(row["bar"] > 0 and not missed(row) for row in rows)
