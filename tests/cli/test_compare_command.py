"""``warp-plate compare``: equal budgets, the bound, its table, JSON, file and picture, and what Ctrl-C keeps."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import output_of, scene_of

from warp_plate import SceneError
from warp_plate.result.comparison import MethodComparison, Trial, load_comparison, save_comparison
from warp_plate.studies.compare import METHODS, compare
from warp_plate.studies.localize import localize
from warp_plate.viz.plots.compare import loss_statistics

SEARCH = {"particles": 8, "iterations": 30, "seed": 5}


@pytest.fixture
def panel(write_scene):
    """A small scene in a file of an empty working folder."""
    return write_scene(damping=88.5, search=SEARCH)


def test_all_methods_share_a_budget_and_none_exceeds_the_bound(panel):
    pytest.importorskip("cma", reason="pycma is not installed: pip install 'warp-plate[cma]'")
    result = compare(panel, "panel", seeds=3, device="cpu")
    assert result.methods == METHODS
    assert (result.evaluator, result.bound_kind) == ("response", "attained")
    for trial in result.trials:
        assert 0 < trial.evaluations[-1] <= 8 * 30
        assert (np.diff(trial.evaluations) > 0).all()
        assert (np.diff(trial.seconds) > 0).all()
        assert (np.diff(trial.loss) <= 0).all()
        assert trial.best_loss >= result.bound - 1e-12
    assert [len(result.trials_of(method)) for method in METHODS] == [3, 3, 3, 3, 3, 1]
    assert {trial.seed for trial in result.trials_of("pso")} == {5, 6, 7}
    for method in ("gradient", "exact"):
        assert all(trial.best_loss <= result.bound + 1e-6 for trial in result.trials_of(method))


def test_a_trial_is_the_search_of_localize_by_either_evaluator(panel):
    trial = compare(panel, methods=["pso"], seeds=1, device="cpu").trials[0]
    single = localize(panel, device="cpu", evaluator="response", estimate=False)
    np.testing.assert_allclose(1 - trial.loss, single.history["best"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(trial.evaluations, single.history["evaluations"])
    direct = compare(panel, methods=["pso"], seeds=1, device="cpu", evaluator="direct", evaluations=80)
    assert (direct.evaluator, direct.budget, direct.trials[0].evaluations[-1]) == ("direct", 80, 80)
    assert direct.trials[0].loss[0] == pytest.approx(trial.loss[0], rel=1e-9)


def test_limits_raise_the_bound_and_exclude_the_eigenvector(panel):
    limited = panel.with_tables(search={**SEARCH, "limits": {"equal_magnitudes": True}})
    free, result = (compare(scene, seeds=2, methods=["pso"], device="cpu") for scene in (panel, limited))
    assert result.bound > free.bound + 1e-3
    assert all(trial.best_loss >= result.bound - 1e-9 for trial in result.trials)
    found = compare(limited, seeds=1, device="cpu")
    assert "exact" in found.skipped
    assert "exact" not in found.methods
    with pytest.raises(SceneError, match="exact"):
        compare(limited, seeds=1, methods=["exact"], device="cpu")


def test_a_nonlinear_scene_claims_no_bound(panel):
    bent = panel.with_tables(effects={"damping": {"viscous": 88.5}, "stretching": {}})
    result = compare(bent, seeds=1, device="cpu", evaluations=16, methods=["pso"])
    assert (result.bound, result.evaluator) == (None, "direct")
    with pytest.raises(SceneError, match="response"):
        compare(bent, seeds=1, device="cpu", evaluator="response")
    with pytest.raises(SceneError, match="nothing to compare"):
        compare(scene_of(actuators=[(0.05, 0.08, 0.05, 0.08)]), device="cpu")


def test_other_objectives_have_a_bound_of_their_own(panel):
    """The largest RMS velocity of the target within a power limit."""
    scene = panel.with_tables(search={**SEARCH, "objectives": [{"kind": "velocity"}], "limits": {"power": 2.0}})
    result = compare(scene, seeds=2, methods=["pso", "gradient"], device="cpu")
    assert not result.localization
    assert all(result.bound * (1 + 1e-9) <= trial.best_loss < 0 for trial in result.trials)


def test_json_file_and_picture(panel, command):
    pytest.importorskip("matplotlib")
    options = "--methods pso,ring,exact --seeds 2 --device cpu --json --out c.h5"
    record = json.loads(output_of(command("compare", "panel.toml", *options.split())))
    assert record["files"] == ["c.h5", "c.png", "c.svg"]
    assert [row["method"] for row in record["methods"]] == ["pso", "ring", "exact"]
    for row in record["methods"]:
        assert row["best"] <= row["median"] <= row["worst"]
        assert row["gap"] == pytest.approx(row["median"] - record["bound"]["loss"])
    assert record["budget"] == 8 * 30
    assert len(record["trials"]) == 5
    assert Path("c.svg").exists()
    assert Path("c.png").read_bytes().startswith(b"\x89PNG")
    loaded = load_comparison("c.h5")
    assert loaded.bound == record["bound"]["loss"]
    assert [trial.best_loss for trial in loaded.trials] == [trial["loss"] for trial in record["trials"]]


def test_the_table_fits_in_80_columns(panel, command):
    out = output_of(
        command(
            "compare", "panel.toml", *["--methods", "pso,gradient", "--seeds", "2", "--device", "cpu", "--no-pictures"]
        )
    )
    for part in ("localization factor", "gradient", "bound (no method can exceed it)", "wrote panel-compare.h5"):
        assert part in out
    assert max(map(len, out.splitlines())) <= 80


def test_ctrl_c_keeps_the_finished_trials(panel):
    """Three trials are kept if the fourth is interrupted; without any the interrupt is passed on."""

    def stop_in(trial):
        def on_progress(done, total, note):
            if done > 240 * (trial - 1):
                raise KeyboardInterrupt

        return on_progress

    result = compare(panel, methods=["pso", "ring"], seeds=4, device="cpu", on_progress=stop_in(4))
    assert result.interrupted
    assert [(trial.method, trial.seed) for trial in result.trials] == [("pso", 5), ("pso", 6), ("ring", 5)]
    with pytest.raises(KeyboardInterrupt):
        compare(panel, methods=["pso"], seeds=2, device="cpu", on_progress=stop_in(1))


@pytest.fixture
def made(panel):
    """A comparison with trials of different length."""
    first = Trial("pso", 9, np.array([8, 16, 24]), np.array([0.1, 0.2, 0.4]), np.array([0.9, 0.5, 0.4]))
    second = Trial("pso", 10, np.array([8]), np.array([0.3]), np.array([0.7]))
    return MethodComparison("panel", panel, "cpu", "direct", 40, {"prepare": 0.5}, True, (first, second))


def test_statistics_hold_what_finished_trials_found(made):
    clocks, losses = loss_statistics(made.trials, "evaluations", 40)
    np.testing.assert_array_equal(clocks, [8, 12, 16, 40])
    np.testing.assert_allclose(losses, [[0.7, 0.5, 0.4, 0.4], [0.8, 0.6, 0.55, 0.55], [0.9, 0.7, 0.7, 0.7]])
    seconds, _ = loss_statistics(made.trials, "seconds", 40)
    np.testing.assert_allclose(seconds, [0.2, 0.25, 0.35])


def test_a_comparison_in_a_file(made):
    loaded = load_comparison(save_comparison(made, "c.h5"))
    assert replace(loaded, trials=()) == replace(made, trials=())
    np.testing.assert_equal([vars(trial) for trial in loaded.trials], [vars(trial) for trial in made.trials])


@pytest.mark.parametrize("weight", [1.0, 1e9])
def test_near_a_bound_is_relative_to_it(weight, scene):
    """However small a displacement's loss is; a localization factor's is compared with one."""
    from warp_plate.cli.compare import rows

    search = {"magnitude": {"range": [0.0, 0.1]}, "objectives": [{"kind": "displacement", "weight": weight}]}
    bound = -7.5e-8 * weight
    trials = tuple(
        Trial("ring", seed, np.array([9]), np.array([1.0]), np.array([bound * (1 - missing)]))
        for seed, missing in enumerate((0.0, 9e-7, 2e-6, 0.1))
    )
    made = scene(search=search)
    result = MethodComparison("s", made, "cpu", "response", 9, {}, False, trials, bound, "attained", "known")
    assert [(row["at_bound"], row["seeds"]) for row in rows(result)] == [(2, 4)]
