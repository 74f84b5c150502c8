"""Robust searches whole: what they win over the nominal drive, their bound, checkpoints, files, table and picture."""

import json

import numpy as np
import pytest

from warp_plate.cli.main import main
from warp_plate.problem.robust import RobustProblem, apply_measure, make_problem
from warp_plate.result.checkpoint import load_checkpoint
from warp_plate.result.store import load_result, save_result
from warp_plate.scene.dump import dump_scene
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.studies.compare import compare
from warp_plate.studies.localize import localize, resume
from warp_plate.viz.plots.robust import draw_robust

TOLERANCES = {"young_modulus": 0.15, "gain": 0.1, "place": 0.004, "scenarios": 16, "fresh": 60}


@pytest.fixture
def robust(scene):
    """A small lightly damped panel with tolerances."""

    def make(effects=None, seed=0, precision="float64", search=None, **keys):
        return scene(
            (9, 9), effects=effects or {"damping": {"viscous": 20.0}}, precision=precision,
            search={"particles": 8, "iterations": 12, "seed": seed, **(search or {}),
                    "robust": {**TOLERANCES, "seed": seed, **keys}},
        )  # fmt: skip

    return make


@pytest.mark.parametrize("seed", range(4))
def test_the_robust_drive_beats_the_nominal_one_in_the_worst_twentieth(robust, seed):
    """Over fresh scenarios. The nominal drive stays the better one on the panel that it was made for."""
    made = robust(seed=seed, search={"method": "gradient", "iterations": 60}, measure="quantile", scenarios=32)
    compared = localize(made, device="cpu", estimate=False).robust
    rows = compared.rows()
    assert rows["worst_5_percent"][0] > rows["worst_5_percent"][1]
    assert rows["searched"][0] > rows["searched"][1]
    assert rows["nominal_plate"][0] < rows["nominal_plate"][1]
    assert compared.bound >= rows["searched"][0] - 1e-9  # attained where one scenario alone decides
    assert compared.failed.tolist() == [0, 0]


@pytest.mark.parametrize("measure", ["mean", "worst", "quantile"])
def test_losses_are_the_measure_over_scenarios_and_no_drive_passes_the_bound(robust, measure, random):
    problem = make_problem(robust(measure=measure, scenarios=5), "cpu")
    assert isinstance(problem, RobustProblem)
    assert problem.evaluator_name == "response"
    positions = random.normal(size=(40, problem.space.dimension))
    designs = problem.parametrization.designs(positions)
    losses = problem.losses(positions)
    np.testing.assert_array_equal(losses, apply_measure(problem.scenario_losses.losses(designs), problem.robust))
    np.testing.assert_allclose(problem.quadratic.losses(positions), losses, rtol=1e-12)
    assert np.all(losses > problem.loss_bound.value)
    np.testing.assert_array_equal(
        problem.nominal.losses(positions), problem.objectives.losses(problem.response.energy(designs.drives))
    )
    direct = make_problem(robust(measure=measure, scenarios=5), "cpu", evaluator="direct")
    assert direct.quadratic is None
    assert direct.loss_bound is None
    np.testing.assert_allclose(direct.losses(positions), losses, rtol=1e-9)


def test_what_is_not_quadratic_is_simulated(robust):
    """Places, and scenes that are not linear in their drives."""
    places = make_problem(robust(search={"position": {}, "phase": {}}, scenarios=3), "cpu")
    stretching = make_problem(robust({"damping": {"viscous": 20.0}, "stretching": {}}, scenarios=3), "cpu")
    for problem in (places, stretching):
        assert problem.evaluator_name == "direct"
        start = np.random.default_rng(0).uniform(
            problem.space.initial_lower, problem.space.initial_upper, (4, problem.space.dimension)
        )
        losses = problem.losses(start)
        assert np.isfinite(losses).all()
        scattered = problem.scenario_losses.losses(problem.parametrization.designs(start))
        assert scattered.shape == (4, 3)
        np.testing.assert_array_equal(losses, scattered.mean(axis=1))


def test_a_search_that_goes_on_ends_bit_for_bit_the_same(robust, tmp_path):
    made, file = robust(precision="float32", fresh=4, scenarios=3), tmp_path / "search.checkpoint.h5"
    whole = localize(made, device="cpu", estimate=False)

    def stop(done, total, best):
        if done == 5:
            raise KeyboardInterrupt

    cut = localize(made, device="cpu", estimate=False, on_progress=stop, checkpoints=CheckpointFile(file, 0))
    assert cut.interrupted
    assert cut.robust is None
    again = resume(load_checkpoint(file), estimate=False)
    assert again.evaluator == whole.evaluator == "response"
    np.testing.assert_array_equal(again.history["best"], whole.history["best"])
    for name in ("validation", "searched", "nominal_plate"):
        np.testing.assert_array_equal(getattr(again.robust, name), getattr(whole.robust, name))
    for name in ("best", "nominal"):
        np.testing.assert_array_equal(again.cases[name].phasors, whole.cases[name].phasors)


def test_results_keep_the_comparison_and_draw_it(robust, tmp_path):
    result = localize(robust(fresh=5, scenarios=2), device="cpu", estimate=False)
    read = load_result(save_result(result, tmp_path / "result.h5")).robust
    for name in ("measure", "scenarios", "localization", "bound"):
        assert getattr(read, name) == getattr(result.robust, name)
    for name in ("validation", "searched", "nominal_plate"):
        np.testing.assert_array_equal(getattr(read, name), getattr(result.robust, name))
    drawn = draw_robust(result, tmp_path / "robust.svg").read_text(encoding="utf-8")
    assert drawn.startswith("<?xml")
    plain = localize(robust(fresh=5, scenarios=2).with_tables(search={"iterations": 2}), device="cpu", estimate=False)
    assert plain.robust is None
    with pytest.raises(ValueError, match="compares no robust drive"):
        draw_robust(plain, tmp_path / "none.svg")


def test_the_command_shows_both_drives(robust, tmp_path, capsys):
    path = tmp_path / "panel.toml"
    path.write_text(dump_scene(robust(fresh=6, scenarios=2)), encoding="utf-8")
    out = ["--out", str(tmp_path / "found.h5"), "--no-pictures", "--no-estimate", "--device", "cpu"]
    main(["localize", str(path), *out, "--json"])
    found = json.loads(capsys.readouterr().out)
    rows = found["robust"]
    assert {"mean", "worst_5_percent", "worst", "nominal_plate", "searched", "bound", "measure"} <= set(rows)
    assert rows["nominal_plate"]["nominal"] == pytest.approx(found["localization_factor"]["nominal"])
    assert rows["worst"]["robust"] == min(rows["fresh"]["robust"])
    assert len(rows["fresh"]["nominal"]) == 6
    main(["localize", str(path), *out])
    text = capsys.readouterr().out
    assert "Over 6 fresh scenarios" in text
    assert "mean of the worst 5 %" in text
    assert "found without scatter" in text


def test_methods_are_compared_by_robust_losses(robust):
    """Each trial ends at a measure over the scenarios, above its bound."""
    made = robust(scenarios=3)
    found = compare(made, methods=("gradient", "ring"), seeds=1, device="cpu", evaluations=64)
    problem = make_problem(made, "cpu")
    assert found.evaluator == "response"
    assert found.bound == pytest.approx(problem.loss_bound.value)
    assert all(trial.loss[-1] > found.bound for trial in found.trials)
    assert found.bound > problem.nominal.loss_bound.value - 0.2
