"""Objectives of the drive found and of others: in results, their files, checkpoints, tables and JSON."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from warp_plate import load_result, localize
from warp_plate.problem.objectives import keeps_limit
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve
from warp_plate.result.case import motion_table

OBJECTIVES = [
    {"kind": "velocity", "weight": 1e4, "rest_limit": 1.0},
    {"kind": "displacement", "weight": 1e6},
    {"kind": "contrast", "weight": 0.1},
    {"kind": "uniformity"},
]
SEARCH = {
    "particles": 8, "iterations": 6, "objectives": OBJECTIVES, "magnitude": {"range": (0.0, 2.0)}, "phase": {},
}  # fmt: skip
CASES = ("equal", "single", "time_reversal", "inverse_filter")


@pytest.fixture
def localize_command(command, write_scene, monkeypatch):
    """Run ``localize`` on a scene in an empty working folder, and return what it writes."""
    monkeypatch.setenv("COLUMNS", "60")  # where no number is cut all the same

    def run(scene, *words):
        write_scene(scene)
        return command("localize", "panel.toml", "--device", "cpu", "--no-estimate", "--no-pictures", *words)[1]

    return run


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
    total = sum(term.get("weight", 1.0) * values[term["kind"]] for term in OBJECTIVES)
    assert values["sum"] == pytest.approx(total, rel=1e-12)
    assert values["sum"] == pytest.approx(result.history["best"][-1], rel=1e-9)
    assert values["sum"] <= values["bound"]


def test_the_command_shows_those_of_all_cases(scene, localize_command):
    panel = scene(damping=88.5, search=SEARCH)
    out = localize_command(panel, "--baselines")
    result = load_result("panel-localize.h5")
    columns = [result.objective_values, *(result.objective_values_by_case[name] for name in CASES)]
    number = re.compile(r"-?\d+\.\d+(e[+-]\d+)?")
    rows = [[float(word) for word in line.split() if number.fullmatch(word)] for line in out.splitlines()]
    for name in ("velocity", "velocity of the rest", "contrast", "sum", "bound"):
        known = [column[name] for column in columns if name in column]
        assert any(row[-len(known) :] == pytest.approx(known, rel=1e-3) for row in rows if len(row) >= len(known))
    problem = make_problem(resolve(panel, "cpu"))
    phasors = np.array([result.cases[name].phasors for name in CASES])
    evaluators = (problem.plates.drives, problem.plates.displacements)
    values = problem.objectives.values(*(evaluator.run(phasors).energy for evaluator in evaluators))
    for kind, value in values.items():
        assert [result.objective_values_by_case[name][kind] for name in CASES] == pytest.approx(value.tolist())
    record = json.loads(localize_command(panel, "--json"))
    assert record["objectives"] == pytest.approx(result.objective_values)
    assert record["bound_kind"] == "bound only"


def test_a_limit_that_no_drive_keeps_leaves_no_bound(scene, localize_command):
    search = {**SEARCH, "magnitude": {"range": (1.0, 2.0)}, "objectives": [{"kind": "velocity", "rest_limit": 1e-7}]}
    out = localize_command(scene((9, 9), damping=88.5, search=search))
    assert "! velocity of the rest: no drive within" in " ".join(out.split())
    values = load_result("panel-localize.h5").objective_values
    assert values["velocity of the rest"] > 1e-7
    assert "bound" not in values
    assert [keeps_limit(1 + beyond, 1.0) for beyond in (1e-6, 1e-4)] == [True, False]


@pytest.mark.parametrize("limits", [{}, {"magnitude": 1.0}, {"equal_magnitudes": True}])
def test_a_limit_that_weak_drives_keep_is_kept(scene, limits):
    """Without tables too, all magnitudes can be as small as a limit of the rest demands, the first one included."""
    search = {"objectives": [{"kind": "velocity", "rest_limit": 1e-7}], "limits": limits}
    result = localize(
        scene((9, 9), damping=88.5, search={**search, "method": "pso", "particles": 4, "iterations": 3}),
        device="cpu",
        estimate=False,
    )
    values = result.objective_values
    assert 0 < values["velocity of the rest"] <= 1e-7
    if not limits.get("equal_magnitudes"):
        assert values["velocity"] == pytest.approx(values["bound"], rel=1e-5)


def test_a_robust_search_has_those_of_the_nominal_plate(scene):
    search = {**SEARCH, "robust": {"young_modulus": 0.1, "scenarios": 4, "fresh": 2}}
    result = localize(scene((9, 9), damping=88.5, search=search), device="cpu", estimate=False)
    assert result.objective_values["sum"] == pytest.approx(result.robust.nominal_plate[0], rel=1e-9)
    nominal = make_problem(resolve(scene((9, 9), damping=88.5, search=SEARCH), "cpu"))
    assert result.objective_values["bound"] == pytest.approx(-nominal.loss_bound.value, rel=1e-9)


def test_equal_cases_are_one_row_of_the_table_of_motion(scene):
    made = scene(actuators=[(0.03, 0.06, 0.04, 0.07)], damping=120.0)
    cases = localize(made, device="cpu", estimate=False).cases
    headings, rows = motion_table(cases, made)
    assert [row[0] for row in rows] == ["all"]
    assert len(rows[0]) == len(headings)
    case = cases["equal"]
    other = replace(case, phasors=2 * case.phasors)
    assert [row[0] for row in motion_table({"equal": case, "other": other}, made)[1]] == ["equal", "other"]
