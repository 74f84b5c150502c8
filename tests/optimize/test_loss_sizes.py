"""What a search finds does not depend on the unit or the weight of its objective: tolerances are parts of losses."""

import json
from functools import cache

import numpy as np
import pytest
from conftest import scene_of

from warp_plate.optimize.record import tolerance_scale
from warp_plate.problem.methods import make_optimizer, optimizer_from_state
from warp_plate.problem.objectives import loss_scale
from warp_plate.problem.problem import make_problem
from warp_plate.result.comparison import MethodComparison, Trial
from warp_plate.scene.search import Objective

DISPLACEMENT = {"kind": "displacement"}
LIMITED = {"kind": "displacement", "rest_limit": 2e-8}


@cache
def problem(**objective):
    """A search for displacements of about 5e-8 m, answered by Gram matrices."""
    search = {"magnitude": {"range": [0.0, 0.1]}, "phase": {}, "objectives": [objective]}
    return make_problem(scene_of(nodes=(9, 9), damping=88.5, search=search), "cpu", evaluator="response")


def found(objective, weight, resumed=False, **keys):
    """(all positions asked for, all losses, why it stopped) of a search with that weight."""
    made = problem(**objective, weight=weight)
    search = made.scene.search.model_copy(update={"particles": 8, "iterations": 150, **keys})
    searcher = make_optimizer(search, made.space, 1, made.quadratic)
    asked, losses = [], []
    while not searcher.stop():
        asked.append(np.array(searcher.ask()))
        losses.append(made.losses(asked[-1]))
        losses[-1][0] = np.nan if len(asked) % 5 == 0 else losses[-1][0]
        searcher.tell(asked[-1], losses[-1])
        if resumed and len(asked) in (7, 40):
            state = json.loads(json.dumps(searcher.state()))
            searcher = optimizer_from_state(search, made.space, 1, state, made.quadratic)
    return np.concatenate(asked), np.concatenate(losses), searcher.stop()


@pytest.mark.parametrize(
    ("method", "objective", "keys"),
    [
        ("pso", DISPLACEMENT, {"stall": 5}),
        ("pso", DISPLACEMENT, {"restarts": 2}),
        ("pso", LIMITED, {"stall": 5, "restarts": 2}),
        ("constriction", DISPLACEMENT, {"stall": 5}),
        ("ring", DISPLACEMENT, {"stall": 5}),
        ("cma", DISPLACEMENT, {"iterations": 400}),
        ("cma", LIMITED, {"restarts": 1, "iterations": 300}),
        ("cma", DISPLACEMENT, {"stall": 5}),
        ("gradient", DISPLACEMENT, {"particles": 4, "restarts": 1}),
        ("gradient", DISPLACEMENT, {"stall": 3, "restarts": 2}),
    ],
)
def test_a_weight_changes_no_position(method, objective, keys):
    """A weight that is a power of two leaves every digit of a loss: the same positions, however small losses are."""
    if method == "cma":
        pytest.importorskip("cma", reason="pycma is not installed: pip install 'warp-plate[cma]'")
    positions, losses, reasons = found(objective, 1.0, method=method, **keys)
    assert -1e-6 < np.nanmin(losses) < 0
    assert not {"iterations", "evaluations"} & reasons.keys() or "restarts" in keys  # it rests by itself
    for weight in (2.0**30, 2.0**-60):
        others, weighed, last = found(objective, weight, resumed=weight > 1, method=method, **keys)
        np.testing.assert_array_equal(others, positions)
        within = losses < 0  # beyond a rest_limit losses are parts of that limit, without a weight
        np.testing.assert_array_equal(weighed[within], weight * losses[within])
        assert last.keys() == reasons.keys()


def test_a_decimal_weight_changes_rounding_alone():
    for method in ("pso", "ring"):
        one, other = (found(DISPLACEMENT, weight, method=method, stall=5) for weight in (1.0, 1e9))
        np.testing.assert_allclose(other[0], one[0], rtol=0, atol=1e-9)


def test_sizes_of_losses():
    """1 − LF keeps its 1e-6; numbers of order one have a least size, for sums that pass zero; velocities have none."""
    assert loss_scale([Objective()]) == tolerance_scale(0.3, 1.0) == 1.0
    assert loss_scale([Objective(kind="velocity", weight=1e9), Objective(kind="displacement")]) == 0.0
    assert loss_scale([Objective(kind="contrast", weight=0.5), Objective(kind="uniformity", weight=2.0)]) == 2.5
    assert tolerance_scale(-7e-8, 0.0) == 7e-8
    assert tolerance_scale(-7e-8, 2.5) == 2.5


@pytest.mark.parametrize("weight", [1.0, 1e9])
def test_near_a_bound_is_a_part_of_it(weight, monkeypatch, capsys):
    """And the table shows six digits of the smallest losses, in the narrowest window."""
    from warp_plate.cli.compare import _print, rows
    from warp_plate.cli.output import console

    scene, bound = problem(**DISPLACEMENT, weight=weight).scene, -7.54042e-08 * weight
    losses = [bound * (1 - missing) for missing in (0.0, 9e-7, 2e-6, 0.1)]
    trials = [
        Trial("constriction", seed, np.array([1600]), np.array([12.3456]), np.array([loss]))
        for seed, loss in enumerate(losses)
    ]
    prepared = {"prepare": 0.0}
    result = MethodComparison(
        "s", scene, "cpu", "response", 1600, prepared, False, tuple(trials), bound, "attained", "known"
    )
    assert [(row["at_bound"], row["seeds"]) for row in rows(result)] == [(2, 4)]
    for columns in ("80", "30"):
        monkeypatch.setenv("COLUMNS", columns)
        _print(result, console())
        out = capsys.readouterr().out
        assert "…" not in out
        (line,) = [line for line in out.splitlines() if line.startswith("constriction")]
        assert line.split()[1:4] == [f"{loss:.6g}" for loss in (losses[0], np.median(losses), losses[3])]
        assert columns == "30" or len(line) <= 80
