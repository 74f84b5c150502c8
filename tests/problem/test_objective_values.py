"""What a drive is worth by each objective: in results, their files, checkpoints, tables and JSON."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from warp_plate import Scene, load_result, localize
from warp_plate.cli.main import main
from warp_plate.problem.objectives import keeps_limit
from warp_plate.problem.problem import make_problem
from warp_plate.result.checkpoint import load_checkpoint
from warp_plate.result.store import save_result
from warp_plate.scene.dump import dump_scene
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.studies.localize import resume

OBJECTIVES = [
    {"kind": "velocity", "weight": 1e4, "rest_limit": 1.0},
    {"kind": "displacement", "weight": 1e6},
    {"kind": "contrast", "weight": 0.1},
    {"kind": "uniformity"},
]
SEARCH = {
    "particles": 8,
    "iterations": 6,
    "objectives": OBJECTIVES,
    "magnitude": {"range": (0.0, 2.0)},
    "phase": {},
}


@pytest.fixture
def panel(scene):
    return scene(damping=88.5, search=SEARCH)


def test_values_follow_from_the_energies_of_the_drive_found(scene):
    panel = scene(damping=130.0, window=(0.06, 0.1), search=SEARCH)
    result = localize(panel, device="cpu", estimate=False)
    case, values = result.cases["best"], result.objective_values
    plate, target = case.energy["plate"], case.energy["target"]
    mass = panel.plate.density * panel.plate.thickness * math.prod(panel.plate.size)
    assert values["velocity"] == pytest.approx(math.sqrt(2 * target / (mass / 4)), rel=1e-9)
    assert values["velocity of the rest"] == pytest.approx(math.sqrt(2 * (plate - target) / (0.75 * mass)), rel=1e-9)
    assert values["contrast"] == pytest.approx(10 * math.log10(3 * target / (plate - target)), abs=1e-9)
    # The start is over: what is left moves at one frequency.
    assert values["displacement"] == pytest.approx(values["velocity"] / (2 * math.pi * 290.0), rel=0.02)
    total = sum(one["weight"] * values[one["kind"]] for one in OBJECTIVES if "weight" in one) + values["uniformity"]
    assert values["sum"] == pytest.approx(total, rel=1e-12)
    assert values["sum"] == pytest.approx(result.history["best"][-1], rel=1e-9)
    assert values["sum"] <= values["bound"]


def test_localization_alone_has_none(scene):
    assert localize(scene(damping=88.5), device="cpu", estimate=False).objective_values == {}


def test_files_and_checkpoints_keep_them(panel, tmp_path):
    targets = [{"name": "a", "disc": (0.06, 0.06, 0.04)}, {"name": "b", "area": (0.1, 0.2, 0.0, 0.2)}]
    made = Scene.model_validate({**panel.model_dump(), "targets": targets, "target": {"disc": (0.06, 0.06, 0.04)}})
    kept = CheckpointFile(tmp_path / "a.checkpoint.h5", 0.0, False, lambda line: None)
    result = localize(made, device="cpu", estimate=False, checkpoints=kept)
    first, second = (one.objective_values for one in result.target_searches)
    assert result.objective_values == first
    assert first["sum"] != second["sum"]
    again = load_result(save_result(result, tmp_path / "a.h5"))
    assert again.objective_values == first
    assert [one.objective_values for one in again.target_searches] == [first, second]
    # The last checkpoint is of the search for the second target.
    checkpoint = load_checkpoint(tmp_path / "a.checkpoint.h5")
    assert checkpoint.finished_searches[0].objective_values == first
    assert [one.objective_values for one in resume(checkpoint, estimate=False).target_searches] == [first, second]


def test_of_a_robust_search_they_are_those_of_the_plate_without_scatter(scene):
    search = {**SEARCH, "robust": {"young_modulus": 0.1, "scenarios": 4, "fresh": 2}}
    result = localize(scene((9, 9), damping=88.5, search=search), device="cpu", estimate=False)
    assert result.robust is not None
    assert result.objective_values["sum"] == pytest.approx(result.robust.nominal_plate[0], rel=1e-9)
    plain = make_problem(scene((9, 9), damping=88.5, search=SEARCH), "cpu")
    assert result.objective_values["bound"] == pytest.approx(-plain.loss_bound.value, rel=1e-9)


CASES = ("equal", "single", "time_reversal", "inverse_filter")
ONLY = ["localize", "panel.toml", "--device", "cpu", "--no-estimate", "--no-pictures"]


def test_the_command_shows_them_beside_those_of_other_drives(panel, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "60")  # where no number is cut all the same
    Path("panel.toml").write_text(dump_scene(panel), encoding="utf-8")
    main([*ONLY, "--baselines"])
    out = capsys.readouterr().out
    result = load_result("panel-localize.h5")
    columns = [result.objective_values, *(result.objective_values_by_case[name] for name in CASES)]
    table = out[out.index("objective") : out.index("Found: ")]
    rows = [[float(word) for word in line.split() if "." in word] for line in table.splitlines()]
    for name in ("velocity", "velocity of the rest", "contrast", "sum", "bound"):
        known = [column[name] for column in columns if name in column]
        assert any(row[-len(known) :] == pytest.approx(known, rel=1e-3) for row in rows if len(row) >= len(known))
    assert "…" not in out
    problem = make_problem(panel, "cpu")
    for name in CASES:
        drive = result.cases[name].phasors[None]
        worth = problem.objectives.values(
            problem.drive_evaluator.run(drive).energy, problem.displacement_evaluator.run(drive).energy
        )
        expected = {kind: float(value[0]) for kind, value in worth.items()}
        assert result.objective_values_by_case[name] == pytest.approx(expected)
    main([*ONLY, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["objectives"] == pytest.approx(result.objective_values)
    assert found["objectives_of"] == {name: pytest.approx(result.objective_values_by_case[name]) for name in CASES[:2]}
    assert found["bound_kind"] == "bound only"


def test_a_limit_that_no_drive_keeps_is_told(scene, tmp_path, monkeypatch, capsys):
    """And no bound is claimed of drives that there are not."""
    monkeypatch.chdir(tmp_path)
    search = {**SEARCH, "magnitude": {"range": (1.0, 2.0)}, "objectives": [{"kind": "velocity", "rest_limit": 1e-7}]}
    Path("panel.toml").write_text(dump_scene(scene((9, 9), damping=88.5, search=search)), encoding="utf-8")
    main(ONLY)
    assert "! velocity of the rest (m/s): no drive was found" in " ".join(capsys.readouterr().out.split())
    values = load_result("panel-localize.h5").objective_values
    assert values["velocity of the rest"] > 1e-7
    assert "bound" not in values
    assert keeps_limit(1 + 1e-6, 1.0)
    assert not keeps_limit(1 + 1e-4, 1.0)


def test_ctrl_c_while_other_drives_are_judged_leaves_the_result(panel, monkeypatch):
    def interrupt(scene):
        raise KeyboardInterrupt

    monkeypatch.setattr("warp_plate.problem.evaluate_cases.make_objectives", interrupt)
    result = localize(panel, device="cpu", estimate=False)
    assert result.objective_values
    assert result.objective_values_by_case == {}


@pytest.mark.parametrize(
    ("tables", "kind", "words"),
    [
        ({}, "attained", "bound: no drive passes it"),
        ({"limits": {"equal_magnitudes": True}, "phase": {}}, "attained within limits", "bound of the drives that may"),
        ({"frequency": {"range": (200.0, 400.0)}}, "", "none claimed"),
    ],
)
def test_the_command_says_what_its_bound_is(tables, kind, words, scene, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    made = scene((9, 9), damping=88.5, search={"particles": 4, "iterations": 2, **tables})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    main([*ONLY, "--no-spectrum"])
    assert words in capsys.readouterr().out
    assert load_result("panel-localize.h5").bound_kind == kind


def test_the_picture_of_the_search_has_the_bound(panel):
    figure = pytest.importorskip("matplotlib.figure")
    from warp_plate.viz.plots.history import plot_history

    result = localize(panel, device="cpu", estimate=False)
    axes = figure.Figure().add_subplot()
    plot_history(axes, result)
    (line,) = [line for line in axes.lines if line.get_label().startswith("bound")]
    np.testing.assert_allclose(line.get_ydata(), -result.objective_values["bound"])
