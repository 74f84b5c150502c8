"""``warp-plate compare``: equal budgets, the bound, its table, JSON, file and picture, and what Ctrl-C keeps."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from warp_plate import SceneError
from warp_plate.result.comparison import MethodComparison, Trial, load_comparison, save_comparison
from warp_plate.scene.dump import dump_scene
from warp_plate.studies import compare as module
from warp_plate.studies.compare import METHODS, compare
from warp_plate.viz.plots.compare import draw_comparison, loss_statistics

NEEDS_PLOTS = "Matplotlib is not installed: pip install 'warp-plate[viz]'"
BUDGET = 8 * 30


@pytest.fixture
def panel(scene, tmp_path, monkeypatch):
    """A small scene in a file of an empty working folder."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, search={"particles": 8, "iterations": 30, "seed": 5})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


@pytest.fixture
def command(command):
    """Run ``compare``: (status, standard output, standard error)."""

    return partial(command, "compare")


def test_all_methods_share_a_budget_and_none_passes_the_bound(panel):
    pytest.importorskip("cma", reason="pycma is not installed: pip install 'warp-plate[cma]'")
    result = compare(panel, "panel", seeds=3, device="cpu")
    assert result.methods == METHODS
    assert result.evaluator == "response"
    assert result.bound_kind == "attained"
    for trial in result.trials:
        assert 0 < trial.evaluations[-1] <= BUDGET
        assert (np.diff(trial.evaluations) > 0).all()
        assert (np.diff(trial.seconds) > 0).all()
        assert (np.diff(trial.loss) <= 0).all()
        assert trial.best_loss >= result.bound - 1e-12
    assert [len(result.trials_of(method)) for method in METHODS] == [3, 3, 3, 3, 3, 1]
    assert {trial.seed for trial in result.trials_of("pso")} == {5, 6, 7}
    for method in ("gradient", "exact"):
        assert all(trial.best_loss <= result.bound + 1e-6 for trial in result.trials_of(method))


def test_a_trial_is_the_search_that_localize_makes(panel):
    """The same seed and evaluator find the same drive."""
    from warp_plate.studies.localize import localize

    trial = compare(panel, methods=["pso"], seeds=1, device="cpu").trials[0]
    alone = localize(panel, device="cpu", evaluator="response", estimate=False)
    np.testing.assert_allclose(1 - trial.loss, alone.history["best"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(trial.evaluations, alone.history["evaluations"])


def test_plates_instead_of_matrices(panel):
    """--evaluator direct simulates, and finds the same up to rounding; an own budget is kept."""
    direct = compare(panel, methods=["pso"], seeds=1, device="cpu", evaluator="direct", evaluations=80)
    matrices = compare(panel, methods=["pso"], seeds=1, device="cpu", evaluations=80)
    assert (direct.evaluator, direct.budget, direct.trials[0].evaluations[-1]) == ("direct", 80, 80)
    assert direct.trials[0].loss[0] == pytest.approx(matrices.trials[0].loss[0], rel=1e-9)


def test_limits_give_another_bound(panel):
    """Equal magnitudes: the eigen-solution is out of reach, says so, and the bound lies lower."""
    search = {"particles": 8, "iterations": 30, "seed": 5, "limits": {"equal_magnitudes": True}}
    limited = type(panel).model_validate({**panel.model_dump(exclude_unset=True), "search": search})
    free, result = (compare(one, seeds=2, methods=["pso"], device="cpu") for one in (panel, limited))
    assert result.bound > free.bound + 1e-3
    assert all(trial.best_loss >= result.bound - 1e-9 for trial in result.trials)
    found = compare(limited, seeds=1, device="cpu")
    assert "exact" in found.skipped
    assert "exact" not in found.methods
    with pytest.raises(SceneError, match="exact"):
        compare(limited, seeds=1, methods=["exact"], device="cpu")


def test_a_scene_that_is_not_linear_claims_no_bound(panel):
    tables = panel.model_dump(exclude_unset=True)
    tables["effects"] = {**tables["effects"], "stretching": {}}
    bent = type(panel).model_validate(tables)
    result = compare(bent, seeds=1, device="cpu", evaluations=16, methods=["pso"])
    assert (result.bound, result.evaluator) == (None, "direct")
    with pytest.raises(SceneError, match="response"):
        compare(bent, seeds=1, device="cpu", evaluator="response")


def test_one_actuator_leaves_nothing_to_compare(scene):
    with pytest.raises(SceneError, match="nothing to compare"):
        compare(scene(actuators=[(0.05, 0.08, 0.05, 0.08)]), device="cpu")


def test_other_objectives_have_their_own_bound(panel):
    """The largest RMS velocity of the target under so much power is no method's to pass."""
    search = {"particles": 8, "iterations": 30, "objectives": [{"kind": "velocity"}], "limits": {"power": 2.0}}
    made = type(panel).model_validate({**panel.model_dump(exclude_unset=True), "search": search})
    result = compare(made, seeds=2, methods=["pso", "gradient"], device="cpu")
    assert not result.localization
    assert all(result.bound * (1 + 1e-9) <= trial.best_loss < 0 for trial in result.trials)


def test_json_file_and_picture(panel, command):
    pytest.importorskip("matplotlib", reason=NEEDS_PLOTS)
    arguments = ("--methods", "pso,ring,exact", "--seeds", 2, "--device", "cpu")
    status, out, err = command("panel.toml", *arguments, "--json", "--out", "c.h5")
    assert (status, err) == (0, "")
    answer = json.loads(out)
    assert answer["files"] == ["c.h5", "c.png", "c.svg"]
    assert [row["method"] for row in answer["methods"]] == ["pso", "ring", "exact"]
    for row in answer["methods"]:
        assert row["best"] <= row["median"] <= row["worst"]
        assert row["gap"] == pytest.approx(row["median"] - answer["bound"]["loss"])
    assert answer["budget"] == BUDGET
    assert len(answer["trials"]) == 5
    assert "bound: no method can pass" in Path("c.svg").read_text(encoding="utf-8")
    assert Path("c.png").read_bytes().startswith(b"\x89PNG")
    loaded = load_comparison("c.h5")
    assert loaded.bound == answer["bound"]["loss"]
    assert [trial.best_loss for trial in loaded.trials] == [trial["loss"] for trial in answer["trials"]]


def test_table_fits_80_columns(panel, command):
    arguments = ("--methods", "pso,gradient", "--seeds", 2, "--device", "cpu", "--no-pictures")
    status, out, err = command("panel.toml", *arguments)
    assert (status, err) == (0, "")
    for part in ("localization factor", "gradient", "bound (no method can pass)", "wrote panel-compare.h5"):
        assert part in out
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--methods", "annealing"), "annealing"),
        (("--seeds", "0"), "--seeds 0"),
        (("--evaluations", "0"), "--evaluations 0"),
        (("--evaluations", "7"), "give 8 or more"),
        (("--out", "c.json"), ".h5"),
    ],
)
def test_bad_options_get_one_line(panel, command, arguments, word):
    status, out, err = command("panel.toml", "--device", "cpu", *arguments)
    assert (status, out) == (2, "")
    assert word in err
    assert len(err.splitlines()) == 1
    assert not list(Path().glob("*.h5"))


def test_ctrl_c_keeps_what_is_done(panel, monkeypatch):
    """After the third trial the fourth is cut short, and three are kept; before any there is nothing to keep."""
    trial, calls = module._trial, []

    def stopped(*arguments):
        calls.append(arguments)
        if len(calls) == stop_at:
            raise KeyboardInterrupt
        return trial(*arguments)

    monkeypatch.setattr(module, "_trial", stopped)
    stop_at = 4
    result = compare(panel, methods=["pso", "ring"], seeds=4, device="cpu")
    assert result.interrupted
    assert [(one.method, one.seed) for one in result.trials] == [("pso", 5), ("pso", 6), ("ring", 5)]
    stop_at = len(calls) + 1
    with pytest.raises(KeyboardInterrupt):
        compare(panel, methods=["pso"], seeds=2, device="cpu")


@pytest.fixture
def made(panel):
    """A comparison with trials of different length."""
    first = Trial("pso", 5, np.array([8, 16, 24]), np.array([0.1, 0.2, 0.4]), np.array([0.9, 0.5, 0.4]))
    second = Trial("pso", 6, np.array([8]), np.array([0.3]), np.array([0.7]))
    return MethodComparison("panel", panel, "cpu", "direct", 40, {"prepare": 0.5}, True, (first, second))


def test_spread_holds_what_ended_trials_found(made):
    clocks, losses = loss_statistics(made.trials, "evaluations", 40)
    np.testing.assert_array_equal(clocks, [8, 12, 16, 40])
    np.testing.assert_allclose(losses[0], [0.7, 0.5, 0.4, 0.4])
    np.testing.assert_allclose(losses[1], [0.8, 0.6, 0.55, 0.55])
    np.testing.assert_allclose(losses[2], [0.9, 0.7, 0.7, 0.7])
    seconds, _ = loss_statistics(made.trials, "seconds", 40)
    np.testing.assert_allclose(seconds, [0.2, 0.25, 0.35])


def test_picture_without_a_bound(made):
    pytest.importorskip("matplotlib", reason=NEEDS_PLOTS)
    drawn = draw_comparison(made, "without.svg").read_text(encoding="utf-8")
    assert "bound" not in drawn
    with_bound = replace(made, bound=0.3, bound_kind="bound only")
    assert "bound only: may not be reached" in draw_comparison(with_bound, "with.svg").read_text(encoding="utf-8")


def test_files_are_read_without_trust(made):
    path = save_comparison(made, "c.h5")
    loaded = load_comparison(path)
    assert loaded.scene == made.scene
    assert loaded.seconds["prepare"] == 0.5
    np.testing.assert_array_equal(loaded.trials[0].loss, made.trials[0].loss)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(SceneError, match="damaged"):
        load_comparison(path)
