"""Printed error bars hold the truth by finite elements, on random scenes; ``benchmarks/error_bars`` has many more."""

import math

import numpy as np
import pytest
from error_bars.campaign import measured, measured_nonlinear, missed
from error_bars.judge import true_factors

from support import series
from warp_plate import Scene
from warp_plate.accuracy.richardson import coprime_grids, weights_of_grids
from warp_plate.plate.weights import localization_factor
from warp_plate.studies.simulate import simulate

# Random scenes by number, and the factor of the quick one.
QUICK, SLOW, TRUTH = 6, (1, 4, 6, 7, 13, 25), 0.2965810757
# Stretching, electrostatic force, a moving load.
NONLINEAR = (9, 7, 2)


@pytest.mark.slow
def test_the_judge_is_the_exact_series():
    scene, drive = Scene.load("paper-supported"), np.array([1, 0.3 - 0.4j, 0, 0.2j])
    exact = localization_factor(series.kinetic_energies(scene, drive, terms=40)[None])[0]
    assert true_factors(scene, drive[None], degree=9)[0] == pytest.approx(exact, rel=1e-4)


def test_the_truth_lies_within_bar_and_interval():
    """Uses stored results of the judge, which take most of the time."""
    check_bars(QUICK, lambda *_: np.array([TRUTH]))


@pytest.mark.slow
@pytest.mark.parametrize("number", SLOW)
def test_the_judged_truth_lies_within_bar_and_interval(number):
    rows = check_bars(number)
    if number == QUICK:
        assert rows[0]["truth"] == pytest.approx(TRUTH, rel=1e-6)


def check_bars(number, judge=true_factors):
    """Return the rows of a scene, the truth of which must lie within their bars."""
    rows = measured(number, judge_by=judge)
    assert {row["engine"] for row in rows} == {"steps", "modes"}
    assert all(row["bar"] > 0 and not missed(row) for row in rows)
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("number", NONLINEAR)
def test_the_truth_lies_within_the_bar_of_a_scene_that_is_not_linear(number):
    (row,) = measured_nonlinear(number)
    assert row["bar"] > 0
    assert not missed(row)


def test_stretched_plates_have_a_bar_that_holds_finer_grids():
    """The run is repeated with half the spacing; its own error is a quarter."""
    scene = Scene.load("large-amplitude").with_tables(grid={"nodes": (15, 15)}, window={"start": 0.0, "end": 0.02})
    coarse, fine = (
        simulate(scene.with_tables(grid={"nodes": (n, n), "load": "moments"}), device="cpu", estimate=n == 15)
        for n in (15, 29)
    )
    estimated, found = coarse.accuracy["estimate"], fine.cases["drive"].localization_factor
    low, high = estimated["interval"][0]
    error = abs(found / coarse.cases["drive"].localization_factor - 1)
    assert 0 < estimated["error"] < 2 * error
    assert low - error / 2 * found < found < high + error / 2 * found


@pytest.mark.slow
def test_modes_under_a_moving_load_have_a_bar_by_grids():
    load = {"force": 0.01, "start": (0.0, 0.05), "velocity": (12.0, 3.0), "size": 0.02}
    scene = Scene.load("paper").with_tables(effects={"damping": {"viscous": 88.0}, "moving_load": load})
    result = simulate(scene, device="cpu", path="modal")
    (low, high), found = result.accuracy["estimate"]["interval"][0], result.cases["drive"].localization_factor
    assert low < found < high < low * 1.05


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.3, 0.2), (0.05, 0.6)])
def test_grids_share_no_line_of_nodes(size):
    cells = np.array(coprime_grids(size, 2)) - 1
    assert all(np.gcd(coarse, fine).max() == 1 for k in (1, 2) for coarse, fine in zip(cells, cells[k:], strict=False))
    assert {True, False} == set((cells % 2 == 0).ravel().tolist())
    spacings = np.array(size) / cells
    assert np.allclose(spacings[2:, 0] / spacings[2:, 1], 1, atol=0.07)


@pytest.mark.parametrize("order", [2, 4])
def test_powers_of_the_spacing_are_extrapolated(order):
    """v + a h^p + b h^(p + 2) has the limit v."""
    scenes = [Scene.load("paper").with_tables(grid={"nodes": (n, n), "order": order}) for n in (14, 19, 28)]
    values = [0.3 - 2 * h**order + 5 * h ** (order + 2) for h in (0.2 / 13, 0.2 / 18, 0.2 / 27)]
    assert math.isclose(weights_of_grids(scenes) @ values, 0.3, rel_tol=1e-9)
