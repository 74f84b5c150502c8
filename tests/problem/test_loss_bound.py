"""The bound of a search's loss: of positions drawn at random, none has less, whatever is sought and held."""

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.problem import loss_bounds as loss_bound
from warp_plate.problem.bounds import Bound
from warp_plate.problem.loss_bounds import allowed_drives, bound_loss
from warp_plate.problem.objectives import make_objectives
from warp_plate.problem.parametrization import parametrization_of
from warp_plate.solve.response import measure_response

RANGE = {"magnitude": {"range": (0.5, 2.0)}, "phase": {}}
SEARCHES = {
    "paper": {},
    "equal": {"limits": {"equal_magnitudes": True}},
    "ranges": RANGE,
    "phases alone": {"phase": {}},
    "magnitudes alone": {"magnitude": {"range": (0.0, 1.0)}},
    "some": {"magnitude": {"range": (0.2, 1.0), "actuators": ("1",)}, "phase": {"actuators": ("0", "2")}},
    "contrast": {"objectives": [{"kind": "contrast"}], **RANGE},
    "velocity": {"objectives": [{"kind": "velocity"}], **RANGE},
    "velocity, power": {"objectives": [{"kind": "velocity"}], "limits": {"power": 3.0}, **RANGE},
    "velocity, magnitude": {"objectives": [{"kind": "velocity"}], "limits": {"magnitude": 1.5}},
    "velocity, rest": {"objectives": [{"kind": "velocity", "rest_limit": 2e-4}], "limits": {"magnitude": 1.0}},
    "velocity, equal": {
        "objectives": [{"kind": "velocity"}], "limits": {"equal_magnitudes": True, "power": 3.0}, **RANGE,
    },
    "several": {
        "objectives": [
            {"kind": "localization", "weight": 2.0}, {"kind": "velocity", "weight": 30.0}, {"kind": "uniformity"},
        ],
        **RANGE,
    },
}  # fmt: skip


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_no_position_has_less_loss(scene, random, search):
    made = scene(damping=130.0, window=(0.01, 0.02), search=search)
    tables = made.model_dump(exclude_unset=True)
    tables["actuators"][2]["phase"] = 0.7
    if not search.get("limits", {}).get("equal_magnitudes"):
        tables["actuators"][2]["magnitude"] = -0.6
    made = type(made).model_validate(tables)
    variables, judge = parametrization_of(made), make_objectives(made)
    response = measure_response(PlateSolver(made, "cpu", areas=judge.regions))
    bound = bound_loss(variables, judge, response)
    space = variables.space
    positions = space.initial_lower + (space.initial_upper - space.initial_lower) * random.random(
        (20_000, space.dimension)
    )
    losses = judge.losses(response.energy(variables.designs(positions).drives))
    assert np.isfinite(bound.value)
    assert np.nanmin(losses) >= bound.value - 1e-9 * abs(bound.value)
    assert bound.kind == "bound only" or len(judge.terms) == 1


def test_what_a_drive_outside_the_range_reaches_is_a_bound_only(scene, monkeypatch):
    """Power brings drives below their range, so the bound is that of drives that no position has too."""
    monkeypatch.setattr(loss_bound, "bound_energy", lambda *_: Bound(1e-9, "attained", "which a drive reaches"))
    kinds = []
    for lowest in (0.5, 0.0):
        ends = {"magnitude": {"range": (lowest, 1.0)}, "phase": {}}
        made = scene(search={"objectives": [{"kind": "velocity"}], "limits": {"power": 1.0}, **ends})
        response = measure_response(PlateSolver(made, "cpu"))
        kinds.append(bound_loss(parametrization_of(made), make_objectives(made), response).kind)
    assert kinds == ["bound only", "attained"]


def test_drives_of_positions_are_allowed(scene, random):
    """Magnitudes and phases of what positions give lie within what the bound takes as allowed."""
    for name in ("ranges", "some", "velocity, power", "velocity, magnitude", "magnitudes alone"):
        made = scene(search=SEARCHES[name])
        variables = parametrization_of(made)
        allowed, space = allowed_drives(variables), variables.space
        positions = space.initial_lower + (space.initial_upper - space.initial_lower) * random.random(
            (500, space.dimension)
        )
        drives = variables.designs(positions).drives
        held = ~np.isnan(allowed.phase)
        turned = drives * np.exp(1j * np.where(held, allowed.phase, -np.angle(drives)))
        assert np.abs(turned.imag).max() < 1e-12, name
        assert (turned.real >= allowed.lower - 1e-12).all(), name
        assert (turned.real <= allowed.upper + 1e-12).all(), name
        assert ((np.abs(drives) ** 2).sum(axis=1) <= allowed.power * (1 + 1e-12)).all(), name


def test_other_searches_claim_nothing(scene):
    moved = scene(search={"position": {}})
    variables, judge = parametrization_of(moved), make_objectives(moved)
    response = measure_response(PlateSolver(moved, "cpu"))
    assert bound_loss(variables, judge, response) is None
    assert bound_loss(parametrization_of(scene()), judge, None) is None
    displaced = scene(search={"objectives": [{"kind": "displacement"}], **RANGE})
    assert bound_loss(parametrization_of(displaced), make_objectives(displaced), response) is None


def test_displacements_are_bounded_by_their_own_matrices(scene, random):
    made = scene(damping=130.0, search={"objectives": [{"kind": "displacement"}], **RANGE})
    variables, judge = parametrization_of(made), make_objectives(made)
    moved = measure_response(PlateSolver(made, "cpu", quantity="displacement"))
    response = measure_response(PlateSolver(made, "cpu"))
    bound = bound_loss(variables, judge, response, moved)
    space = variables.space
    drives = variables.designs(
        space.initial_lower + (space.initial_upper - space.initial_lower) * random.random((20_000, space.dimension))
    ).drives
    losses = judge.losses(response.energy(drives), moved.energy(drives))
    assert bound.value <= losses.min() <= 0.8 * bound.value
