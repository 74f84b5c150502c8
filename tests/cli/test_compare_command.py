"""``warp-plate compare``: equal budgets, the bound, its table, JSON, file and picture, and what Ctrl-C keeps."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.commands import output_of
from support.scenes import scene_of
from warp_plate import SceneError
from warp_plate.cli.compare import rows
from warp_plate.result.comparison import MethodComparison, Trial, load_comparison, save_comparison
from warp_plate.studies.compare import METHODS, compare
from warp_plate.studies.localize import localize
from warp_plate.viz.plots.search import loss_statistics

SEARCH = {"particles": 8, "iterations": 30, "seed": 5}


@pytest.fixture
def compared(write_scene):
    """A small scene in a file of an empty working folder."""
    return write_scene(damping=88.5, search=SEARCH)


def test_all_methods_share_a_budget_and_none_exceeds_the_bound(compared, command):
    """Also in the JSON, the file and its picture."""
    pytest.importorskip("cma", reason="pycma is not installed: pip install 'warp-plate[cma]'")
    pytest.importorskip("matplotlib")
    words = ("compare", "panel.toml", "--seeds", 2, "--device", "cpu", "--json", "--out", "c.h5")
    record, result = json.loads(output_of(command(*words))), load_comparison("c.h5")
    assert result.methods == METHODS
    assert (result.evaluator, result.bound_kind, record["budget"]) == ("response", "attained", 8 * 30)
    for trial in result.trials:
        assert 0 < trial.evaluations[-1] <= 8 * 30
        assert (np.diff(trial.evaluations) > 0).all()
        assert (np.diff(trial.seconds) > 0).all()
        assert (np.diff(trial.loss) <= 0).all()
        assert trial.best_loss >= result.bound - 1e-12
    assert [len(result.trials_of(method)) for method in METHODS] == [2, 2, 2, 2, 2, 1]
    assert {trial.seed for trial in result.trials_of("pso")} == {5, 6}
    for method in ("gradient", "exact"):
        assert all(trial.best_loss <= result.bound + 1e-6 for trial in result.trials_of(method))
    assert [row["method"] for row in record["methods"]] == list(METHODS)
    for row in record["methods"]:
        assert row["best"] <= row["median"] <= row["worst"]
        assert row["gap"] == pytest.approx(row["median"] - record["bound"]["loss"])
    assert [trial["loss"] for trial in record["trials"]] == [trial.best_loss for trial in result.trials]
    assert record["bound"]["loss"] == result.bound
    assert record["files"] == ["c.h5", "c.png", "c.svg"]
    assert Path("c.svg").exists()
    assert Path("c.png").read_bytes().startswith(b"\x89PNG")
    out = output_of(command(*words[:6], "--methods", "pso,gradient", "--no-pictures"))
    for part in (
        "localization factor",
        "gradient",
        "bound of these searches: ",
        "wrote panel-compare.h5",
    ):
        assert part in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_trial_is_the_search_of_localize_by_either_evaluator(compared):
    trial = compare(compared, methods=["pso"], seeds=1, device="cpu").trials[0]
    single = localize(compared, device="cpu", evaluator="response", estimate=False)
    np.testing.assert_allclose(1 - trial.loss, single.history["best"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(trial.evaluations, single.history["evaluations"])
    direct = compare(compared, methods=["pso"], seeds=1, device="cpu", evaluator="direct", evaluations=80)
    assert (direct.evaluator, direct.budget, direct.trials[0].evaluations[-1]) == ("direct", 80, 80)
    assert direct.trials[0].loss[0] == pytest.approx(trial.loss[0], rel=1e-9)


def test_bounds_of_other_problems(compared):
    """Limits raise the bound and exclude the eigenvector; other objectives have a bound of their own; what is
    nonlinear has none."""
    limited = compared.with_tables(search={**SEARCH, "limits": {"equal_magnitudes": True}})
    free, result = (compare(scene, seeds=2, methods=["pso"], device="cpu") for scene in (compared, limited))
    assert result.bound > free.bound + 1e-3
    assert all(trial.best_loss >= result.bound - 1e-9 for trial in result.trials)
    found = compare(limited, seeds=1, device="cpu")
    assert ("exact" in found.skipped, "exact" in found.methods) == (True, False)
    scene = compared.with_tables(search={**SEARCH, "objectives": [{"kind": "velocity"}], "limits": {"power": 2.0}})
    result = compare(scene, seeds=2, methods=["pso", "gradient"], device="cpu")
    assert not result.localization
    assert all(result.bound * (1 + 1e-9) <= trial.best_loss < 0 for trial in result.trials)
    bent = compared.with_tables(effects={"damping": {"viscous": 88.5}, "stretching": {}})
    result = compare(bent, seeds=1, device="cpu", evaluations=16, methods=["pso"])
    assert (result.bound, result.evaluator) == (None, "direct")
    single = scene_of(actuators=[(0.05, 0.08, 0.05, 0.08)])
    for refused, options, words in (
        (limited, {"methods": ["exact"]}, "exact"),
        (bent, {"evaluator": "response"}, "response"),
        (single, {}, "nothing to compare"),
    ):
        with pytest.raises(SceneError, match=words):
            compare(refused, seeds=1, device="cpu", **options)


def test_ctrl_c_keeps_the_finished_trials(compared):
    """Three trials are kept if the fourth is interrupted; without any the interrupt is passed on."""

    def stop_in(trial):
        def on_progress(done, total, note):
            if done > 240 * (trial - 1):
                raise KeyboardInterrupt

        return on_progress

    result = compare(compared, methods=["pso", "ring"], seeds=4, device="cpu", on_progress=stop_in(4))
    assert result.interrupted
    assert [(trial.method, trial.seed) for trial in result.trials] == [("pso", 5), ("pso", 6), ("ring", 5)]
    with pytest.raises(KeyboardInterrupt):
        compare(compared, methods=["pso"], seeds=2, device="cpu", on_progress=stop_in(1))


def test_statistics_and_files_of_trials_of_different_length(compared):
    first = Trial("pso", 9, np.array([8, 16, 24]), np.array([0.1, 0.2, 0.4]), np.array([0.9, 0.5, 0.4]))
    second = Trial("pso", 10, np.array([8]), np.array([0.3]), np.array([0.7]))
    made = MethodComparison("panel", compared, "cpu", "direct", 40, {"prepare": 0.5}, True, (first, second))
    clocks, losses = loss_statistics(made.trials, "evaluations", 40)
    np.testing.assert_array_equal(clocks, [8, 12, 16, 40])
    np.testing.assert_allclose(losses, [[0.7, 0.5, 0.4, 0.4], [0.8, 0.6, 0.55, 0.55], [0.9, 0.7, 0.7, 0.7]])
    np.testing.assert_allclose(loss_statistics(made.trials, "seconds", 40)[0], [0.2, 0.25, 0.35])
    loaded = load_comparison(save_comparison(made, "c.h5"))
    assert replace(loaded, trials=()) == replace(made, trials=())
    np.testing.assert_equal([vars(trial) for trial in loaded.trials], [vars(trial) for trial in made.trials])


@pytest.mark.parametrize("weight", [1.0, 1e9])
def test_near_a_bound_is_relative_to_it(weight, scene):
    """However small a displacement's loss is; a localization factor's is compared with one."""
    search = {"magnitude": {"range": [0.0, 0.1]}, "objectives": [{"kind": "displacement", "weight": weight}]}
    bound = -7.5e-8 * weight
    trials = tuple(
        Trial("ring", seed, np.array([9]), np.array([1.0]), np.array([bound * (1 - missing)]))
        for seed, missing in enumerate((0.0, 9e-7, 2e-6, 0.1))
    )
    made = scene(search=search)
    result = MethodComparison("s", made, "cpu", "response", 9, {}, False, trials, bound, "attained", "known")
    assert [(row["at_bound"], row["seeds"]) for row in rows(result)] == [(2, 4)]
