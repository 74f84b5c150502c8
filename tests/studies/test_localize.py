"""The whole search on small scenes and on the paper's own."""

import numpy as np
import pytest
from inline_pool import InlinePool
from pydantic import ValidationError

from warp_plate import Scene, SceneError, localize
from warp_plate.plate.scheme import make_scheme
from warp_plate.studies.simulate import simulate

SMALL = {"search": {"particles": 8, "iterations": 12, "seed": 3}}


def same(one, other):
    """Equal to the last bit in all that a search finds."""
    return (
        one.bound == other.bound
        and one.evaluations == other.evaluations
        and one.node_steps == other.node_steps
        and all(
            np.array_equal(one.history[name], other.history[name]) for name in ("best", "mean", "evaluations")
        )
        and all(np.array_equal(one.cases[name].phasors, other.cases[name].phasors) for name in one.cases)
        and all(one.cases[name].energy == other.cases[name].energy for name in one.cases)
        and all(
            np.array_equal(one.cases[name].displacement, other.cases[name].displacement) for name in one.cases
        )
    )


@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_what_a_search_leaves(device, path, evaluator, scene):
    made = scene(
        damping=88.5, precision="float32", record={"times": (0.005, 0.012), "points": ((0.1, 0.1),)}, **SMALL
    )
    told = []
    result = localize(made, "mine", device, None, evaluator, path, lambda *news: told.append(news))
    assert (result.command, result.source, result.scene, result.seed) == ("localize", "mine", made, 3)
    assert list(result.cases) == ["equal", "single", "best"]
    factors = {name: case.localization_factor for name, case in result.cases.items()}
    # The swarm found it, or one of the two drives that it is compared with is better still; none passes the
    # bound.
    assert max(factors.values()) <= result.bound + 1e-6
    assert factors["best"] == pytest.approx(result.history["best"][-1], abs=2e-6)
    np.testing.assert_array_equal(result.cases["equal"].phasors, [1, 1, 1])
    assert sorted(np.abs(result.cases["single"].phasors)) == [0, 0, 1]
    assert result.cases["best"].phasors[0] == 1
    assert set(result.history) == {"evaluations", "best", "mean"}
    np.testing.assert_array_equal(result.history["evaluations"], 8 * np.arange(1, 13))
    assert np.all(np.diff(result.history["best"]) >= 0)
    assert np.all(result.history["mean"] <= result.history["best"] + 1e-12)
    assert result.evaluations == 96
    assert [done for done, _, _ in told] == list(range(1, 13))
    assert {whole for _, whole, _ in told} == {12}
    np.testing.assert_array_equal([best for _, _, best in told], result.history["best"])
    assert set(result.seconds) == {"compile", "solve", "estimate"}
    assert result.effects == ("viscous damping (centred)",)
    assert (result.evaluator, result.interrupted) == (evaluator, False)
    for case in result.cases.values():
        assert case.displacement.shape == (2, 13, 13)
        assert case.trace.shape == (1, result.trace_times.size)
        assert np.isfinite(case.displacement).all()
    assert set(result.versions) == {"warp_plate", "warp", "numpy", "python"}


def test_node_steps_are_those_of_all_plates(scene):
    """Nodes that move × steps × plates: 21 for the bound, 3 single ones, the swarm's, 3 for the pictures."""
    made = scene(**SMALL)
    plate = simulate(made, device="cpu").node_steps
    assert plate == 11 * 11 * make_scheme(made).steps
    plates, rest = divmod(localize(made, device="cpu").node_steps, plate)
    assert rest == 0
    assert plates == 21 + 3 + 96 + 3


@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_same_seed_same_bits(device, path, evaluator, scene):
    made = scene(precision="float32", damping=88.5, **SMALL)
    first, again, other = (localize(made, "", device, seed, evaluator, path) for seed in (5, 5, 6))
    assert same(first, again)
    assert not same(first, other)
    assert localize(made, "", device, None, evaluator, path).seed == 3


def test_both_evaluators_walk_the_same_way(scene):
    """Losses that differ in the twelfth digit lead the swarm the same way, to as many digits as its moves
    keep."""
    made = scene(damping=88.5, **SMALL)
    direct, response = (localize(made, device="cpu", evaluator=name) for name in ("direct", "response"))
    np.testing.assert_allclose(direct.history["best"], response.history["best"], rtol=1e-9)
    np.testing.assert_allclose(direct.cases["best"].phasors, response.cases["best"].phasors, rtol=1e-6)


@pytest.mark.parametrize("preset", ["paper", pytest.param("paper-supported", marks=pytest.mark.slow)])
def test_the_paper_s_search_comes_near_the_bound(preset):
    """The best drive lies within 0.002 of the bound for at least 9 of 10 seeds, with the preset's own
    settings."""
    scene = Scene.load(preset)
    results = [localize(scene, preset, "cpu", seed, "response") for seed in range(10)]
    gaps = np.array([result.bound - result.cases["best"].localization_factor for result in results])
    assert np.all(gaps > -1e-5)
    assert np.count_nonzero(gaps < 0.002) >= 9
    assert {result.evaluations for result in results} == {1600}
    shares = {name: results[0].cases[name].localization_factor for name in ("equal", "single")}
    assert shares["equal"] == pytest.approx(0.25, abs=1e-5)
    assert shares["single"] == pytest.approx(0.6367, abs=0.0005)


def test_the_paper_s_search_by_plates():
    """The same with a plate for each particle, which is what the command does: one seed here."""
    result = localize(Scene.load("paper"), "paper", "cpu")
    assert result.bound - result.cases["best"].localization_factor < 0.002
    assert result.evaluator == "direct"
    steps, moving = 1250, 25 * 25
    assert result.node_steps >= 1600 * steps * moving


@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_workers_that_have_nothing_to_do_are_named_so(evaluator, scene):
    made = scene(nodes=(9, 9), window=(0.002, 0.004), search={"particles": 3, "iterations": 2})
    result = localize(made, device="cpu", evaluator=evaluator, estimate=False, pool=InlinePool())
    assert ("plates of the search on this process" in result.device) == (evaluator == "direct")
    assert ("unused" in result.device) == (evaluator == "response")


def test_ctrl_c_keeps_the_best_so_far(device, path, scene):
    made = scene(precision="float32", damping=88.5, **SMALL)

    def stop(done, total, best):
        if done == 5:
            raise KeyboardInterrupt

    result = localize(made, "", device, on_progress=stop, path=path)
    whole = localize(made, "", device, path=path)
    assert result.interrupted
    assert result.evaluations == 40
    np.testing.assert_array_equal(result.history["best"], whole.history["best"][:5])
    assert result.cases["best"].localization_factor == pytest.approx(result.history["best"][-1], abs=2e-6)
    assert result.bound == whole.bound


def test_one_actuator_leaves_nothing_to_search(scene):
    made = scene(actuators=[(0.03, 0.06, 0.04, 0.07)], damping=88.5, **SMALL)
    result = localize(made, device="cpu")
    assert result.evaluations == 0
    assert len({case.localization_factor for case in result.cases.values()}) == 1
    assert result.cases["best"].localization_factor <= result.bound + 1e-12


@pytest.mark.parametrize("changes", [{"seed": -1}, {"seed": 2**70}])
def test_seeds_that_cannot_be_kept_are_refused(changes, scene):
    with pytest.raises(SceneError, match="seed"):
        localize(scene(**SMALL), device="cpu", **changes)


@pytest.mark.parametrize("search", [{"inertia": 1e9}, {"velocity_limit": 1e200}, {"social": 1e300}])
def test_settings_that_the_swarm_refuses_are_scene_errors(search, scene):
    """The scene's limits are the swarm's: refused on reading, or by the search as a fault of the scene."""
    with pytest.raises((SceneError, ValidationError), match=next(iter(search))):
        localize(scene(search=search), device="cpu")


def test_simulate_drives(scene):
    """The word "scene" takes the file's magnitudes and phases; equal and single are the search's reference
    drives."""
    made = scene(damping=88.5, precision="float32", **SMALL)
    found = localize(made, device="cpu")
    for drive in ("equal", "single"):
        run = simulate(made, "mine", drive, "cpu")
        assert run.cases["drive"].energy == found.cases[drive].energy
    actuators = tuple(
        actuator.model_copy(update={"magnitude": magnitude, "phase": phase})
        for actuator, magnitude, phase in zip(made.actuators, (1.0, -0.5, 2.0), (0.0, 1.0, -2.0), strict=True)
    )
    written = simulate(made.model_copy(update={"actuators": actuators}), "mine", device="cpu")
    np.testing.assert_allclose(
        written.cases["drive"].phasors, [1, -0.5 * np.exp(-1j), 2 * np.exp(2j)], rtol=1e-14
    )
    assert written.bound is None
    assert not written.history
