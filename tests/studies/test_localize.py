"""The whole search on small scenes and on the paper's scene."""

import numpy as np
import pytest

from support.inline_pool import InlinePool
from support.scenes import scene_of
from support.searches import assert_same_results
from warp_plate import Scene, localize
from warp_plate.plate.scheme import make_scheme
from warp_plate.studies.simulate import simulate

SEARCH = {"method": "pso", "particles": 8, "iterations": 12, "seed": 3}
PANEL = scene_of(damping=88.5, precision="float32", search=SEARCH)


@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_contents_of_a_result(device, path, evaluator):
    scene = PANEL.with_tables(record={"times": (0.005, 0.012), "points": ((0.1, 0.1),)})
    progress, estimate = [], evaluator == "direct"
    result = localize(
        scene,
        source="mine",
        device=device,
        evaluator=evaluator,
        path=path,
        on_progress=lambda *news: progress.append(news),
        estimate=estimate,
    )
    assert (result.command, result.source, result.scene, result.seed) == ("localize", "mine", scene, 3)
    assert list(result.cases) == ["equal", "single", "best"]
    factors = {name: case.localization_factor for name, case in result.cases.items()}
    assert max(factors.values()) <= result.bound + 1e-6
    assert factors["best"] == pytest.approx(result.history["best"][-1], abs=2e-6)
    np.testing.assert_array_equal(result.cases["equal"].phasors, [1, 1, 1])
    assert sorted(np.abs(result.cases["single"].phasors)) == [0, 0, 1]
    assert result.cases["best"].phasors[0] == 1
    np.testing.assert_array_equal(result.history["evaluations"], 8 * np.arange(1, 13))
    assert np.all(np.diff(result.history["best"]) >= 0)
    assert np.all(result.history["mean"] <= result.history["best"] + 1e-12)
    assert result.evaluations == 96
    assert progress == [(done, 12, result.history["best"][done - 1]) for done in range(1, 13)]
    assert set(result.seconds) == {"compile", "solve", *(["estimate"] if estimate else [])}
    assert ("estimate" in result.accuracy) == estimate
    assert result.effects == ("viscous damping (centred)",)
    assert (result.evaluator, result.interrupted) == (evaluator, False)
    for case in result.cases.values():
        assert case.displacement.shape == (2, 13, 13)
        assert case.trace.shape == (1, result.trace_times.size)
        assert np.isfinite(case.displacement).all()
    assert set(result.versions) == {"warp_plate", "warp", "numpy", "python"}
    # Moving nodes × steps × plates: 21 for the matrices, 3 cases; single actuators and the swarm if simulated.
    plates = 21 + 3 + (3 + 96 if evaluator == "direct" else 0)
    assert result.node_steps == 11 * 11 * make_scheme(scene).steps * plates


@pytest.mark.parametrize("search", [{}, {"phase": {}, "limits": {"equal_magnitudes": True}}])
def test_the_bound_has_the_error_bar_of_its_drives(search):
    """That of the plate lies within the bar; without one, the bound is called one of this grid."""
    scene = scene_of(damping=88.5, search={"method": "exact", **search})
    result = localize(scene, device="cpu")
    expected = localize(scene, device="cpu", evaluator="modal", estimate=False)
    estimated = result.accuracy["estimate"]["bound"]
    low, high = estimated["interval"]
    assert low <= expected.bound <= high
    assert 0.01 < abs(result.bound / expected.bound - 1) <= estimated["error"] < 0.5
    assert f"bound {result.bound:.2f}" in estimated["line"]
    assert result.bound_description.endswith(("from these places", "permitted drives"))
    assert expected.bound_description.endswith(", by these modes")


def test_the_seed_determines_every_bit(device, path):
    first, again, other = (localize(PANEL, device=device, seed=seed, path=path, estimate=False) for seed in (5, 5, 6))
    assert_same_results(first, again)
    assert not np.array_equal(first.history["best"], other.history["best"])


@pytest.mark.parametrize("preset", ["paper", pytest.param("paper-supported", marks=pytest.mark.slow)])
def test_the_paper_s_search_comes_close_to_the_bound(preset):
    """Within 0.002 of the bound for at least 9 of 10 seeds."""
    scene = Scene.load(preset)
    results = [
        localize(scene, source=preset, device="cpu", seed=seed, evaluator="response", estimate=False)
        for seed in range(10)
    ]
    gaps = np.array([result.bound - result.cases["best"].localization_factor for result in results])
    assert np.all(gaps > -1e-5)
    assert np.count_nonzero(gaps < 0.002) >= 9
    assert {result.evaluations for result in results} == {1600}
    assert results[0].cases["equal"].localization_factor == pytest.approx(0.25, abs=1e-5)
    assert results[0].cases["single"].localization_factor == pytest.approx(0.6367, abs=0.0005)


def test_workers_without_plates_are_said_to_be_unused():
    assert "unused" in localize(PANEL, device="cpu", evaluator="response", estimate=False, pool=InlinePool()).device


def test_one_actuator_leaves_nothing_to_search():
    scene = scene_of(actuators=[(0.03, 0.06, 0.04, 0.07)], damping=88.5, search=SEARCH)
    result = localize(scene, device="cpu", estimate=False)
    assert result.evaluations == 0
    assert len({case.localization_factor for case in result.cases.values()}) == 1
    assert result.cases["best"].localization_factor <= result.bound + 1e-12


def test_drives_of_simulate():
    """ "scene" takes the file's magnitudes and phases; "equal" and "single" are the references of a search."""
    found = localize(PANEL, device="cpu", estimate=False)
    for drive in ("equal", "single"):
        run = simulate(PANEL, source="mine", drive=drive, device="cpu", estimate=False)
        assert run.cases["drive"].energy == found.cases[drive].energy
    changes = ({"magnitude": 1.0, "phase": 0.0}, {"magnitude": -0.5, "phase": 1.0}, {"magnitude": 2.0, "phase": -2.0})
    actuators = tuple(one.model_copy(update=new) for one, new in zip(PANEL.actuators, changes, strict=True))
    written = simulate(PANEL.model_copy(update={"actuators": actuators}), source="mine", device="cpu", estimate=False)
    expected = [1, -0.5 * np.exp(-1j), 2 * np.exp(2j)]
    np.testing.assert_allclose(written.cases["drive"].phasors, expected, rtol=1e-14)
    assert written.bound is None
    assert not written.history
