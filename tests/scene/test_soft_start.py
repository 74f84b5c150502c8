"""A drive that rises softly, and the damping that bursts and soft starts take in place of a loss factor."""

import pytest

import warp_plate
from warp_plate import Scene, SceneError

FINE = "grid={nodes=[45,45],order=4,load='moments',precision='float64'}"


def test_a_soft_start_is_a_burst_without_an_end():
    ramp, burst = (
        warp_plate.simulate(Scene.load("paper", [drive]), path="modal", estimate=False).cases["drive"].energy["plate"]
        for drive in ("drive.ramp=0.02", "drive.burst={duration=1.0,ramp=0.02}")
    )
    assert ramp == pytest.approx(burst, rel=1e-12)


def test_a_rise_beyond_the_run_begins_with_the_square_of_time():
    slow, slower = (
        warp_plate.simulate(Scene.load("paper", [f"drive.ramp={ramp}"]), path="modal", estimate=False)
        .cases["drive"]
        .energy["plate"]
        for ramp in (1.0, 10.0)
    )
    assert slower == pytest.approx(1e-4 * slow, rel=0.02)


def test_both_engines_start_softly():
    scene = Scene.load("paper", ["drive.ramp=0.02", FINE])
    steps, modes = (warp_plate.simulate(scene, path=path, estimate=False) for path in ("auto", "modal"))
    for region in ("plate", "target"):
        assert steps.cases["drive"].energy[region] == pytest.approx(modes.cases["drive"].energy[region], rel=0.02)
    hard = warp_plate.simulate(Scene.load("paper", [FINE]), path="modal", estimate=False)
    assert modes.peak_displacement < 0.95 * hard.peak_displacement


def test_designs_of_a_search_start_softly():
    scene = Scene.load("paper", ["drive.ramp=0.02", "search.particles=2", "search.iterations=1"])
    result = warp_plate.localize(scene, estimate=False, spectrum=False)
    assert result.driven_scene(result.cases["best"]).drive.ramp == 0.02


def test_a_ramp_is_written_without_the_burst_that_follows_from_it():
    scene = Scene.load("paper", ["drive.ramp=0.02"])
    assert "burst" not in scene.to_toml()
    assert Scene.parse(scene.to_toml(), "ramp") == scene
    assert scene.replace("drive.ramp", 0.01).drive.burst.ramp == 0.01


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (["drive.ramp=0.02", "drive.burst={duration=0.1}"], "drive.ramp: 0.02 s, but drive.burst has a ramp"),
        (["drive.ramp=0.02", "effects={loss_factor={eta=0.02}}"], "[effects.modal_damping] ratio = 0.01 instead"),
        (["drive.burst={duration=0.02}", "effects={loss_factor={eta=0.04}}"], "ratio = 0.02 instead"),
        (["drive.ramp=-1"], "drive.ramp = -1: must be 0 or more"),
    ],
)
def test_what_excludes_a_ramp_is_said(keys, words):
    with pytest.raises(SceneError) as refused:
        Scene.load("paper", keys)
    assert words in str(refused.value)


def test_a_ramp_beyond_all_runs_is_refused():
    with pytest.raises(SceneError, match=r"drive.ramp = 1e\+30: must be 5e\+29 or less"):
        Scene.load("paper", ["drive.ramp=1e30"])
