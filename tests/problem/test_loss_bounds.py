"""Bounds of a search's loss: no position drawn at random has a smaller one, whatever is sought, limited and fixed."""

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.discretization import discretize
from warp_plate.problem import bounds
from warp_plate.problem.bounds import Bound, allowed_drives, bound_loss
from warp_plate.problem.objectives import make_objectives
from warp_plate.problem.parametrization import parametrization_of
from warp_plate.solve.response import measure_response

RANGE = {"magnitude": {"range": (0.5, 2.0)}, "phase": {}}
VELOCITY = {"objectives": [{"kind": "velocity"}]}
SEARCHES = {
    "paper": {},
    "equal": {"limits": {"equal_magnitudes": True}},
    "ranges": RANGE,
    "phases alone": {"phase": {}},
    "magnitudes alone": {"magnitude": {"range": (0.0, 1.0)}},
    "one magnitude": {"magnitude": {"range": (0.2, 1.0), "actuators": ("1",)}},
    "some": {"magnitude": {"range": (0.2, 1.0), "actuators": ("1",)}, "phase": {"actuators": ("0", "2")}},
    "contrast": {"objectives": [{"kind": "contrast"}], **RANGE},
    "velocity": {**VELOCITY, **RANGE},
    "velocity, power": {**VELOCITY, "limits": {"power": 3.0}, **RANGE},
    "velocity, magnitude": {**VELOCITY, "limits": {"magnitude": 1.5}},
    "velocity, rest": {"objectives": [{"kind": "velocity", "rest_limit": 2e-4}], "limits": {"magnitude": 1.0}},
    "velocity, equal": {**VELOCITY, "limits": {"equal_magnitudes": True, "power": 3.0}, **RANGE},
    "several": {
        "objectives": [
            {"kind": "localization", "weight": 2.0}, {"kind": "velocity", "weight": 30.0}, {"kind": "uniformity"},
        ],
        **RANGE,
    },
    "displacement": {"objectives": [{"kind": "displacement"}], **RANGE},
}  # fmt: skip


def pieces(scene):
    """Return the parametrization, the objectives and the Gram matrices of velocities and displacements."""
    grid = discretize(scene)
    objectives = make_objectives(grid)
    quantities = ("velocity", "displacement") if objectives.needs_displacement else ("velocity",)
    solvers = [PlateSolver(grid, "cpu", areas=objectives.regions, quantity=quantity) for quantity in quantities]
    return parametrization_of(scene), objectives, *map(measure_response, solvers)


def draw_phasors(parametrization, random, count):
    space = parametrization.space
    shares = random.random((count, space.dimension))
    return parametrization.designs(space.initial_lower + (space.initial_upper - space.initial_lower) * shares).drives


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_no_position_has_less_loss_and_every_drive_is_allowed(scene, random, search):
    made = scene(damping=130.0, window=(0.01, 0.02), search=search)
    actuators = [actuator.model_dump() for actuator in made.actuators]
    actuators[2]["phase"] = 0.7
    if not search.get("limits", {}).get("equal_magnitudes"):
        actuators[2]["magnitude"] = -0.6
    parametrization, objectives, *responses = pieces(made.with_tables(actuators=actuators))
    bound = bound_loss(parametrization, objectives, *responses)
    phasors = draw_phasors(parametrization, random, 20_000)
    losses = objectives.losses(*(response.energy(phasors) for response in responses))
    assert np.isfinite(bound.value)
    assert np.nanmin(losses) >= bound.value - 1e-9 * abs(bound.value)
    assert bound.kind == "bound only" or len(objectives.terms) == 1
    if search == SEARCHES["displacement"]:
        assert losses.min() <= 0.8 * bound.value
    allowed = allowed_drives(parametrization)
    fixed = ~np.isnan(allowed.phase)
    turned = phasors * np.exp(1j * np.where(fixed, allowed.phase, -np.angle(phasors)))
    assert np.abs(turned.imag).max() < 1e-12
    assert (turned.real >= allowed.lower - 1e-12).all()
    assert (turned.real <= allowed.upper + 1e-12).all()
    assert ((np.abs(phasors) ** 2).sum(axis=1) <= allowed.power * (1 + 1e-12)).all()


def test_a_limit_on_the_rest_alone_gives_the_ratio(scene):
    """So much energy in the rest lets LF / (1 − LF) times as much into the target."""
    wide = {"magnitude": {"range": (0.0, 100.0)}, "phase": {}}
    search = {"objectives": [{"kind": "velocity", "rest_limit": 2e-4}], **wide}
    parametrization, objectives, response = pieces(scene((9, 9), damping=130.0, search=search))
    rest, factor = objectives.masses[1] * 2e-4**2 / 2, response.bound()
    speed = np.sqrt(2 * rest * factor / (1 - factor) / objectives.masses[0])
    assert bound_loss(parametrization, objectives, response).value == pytest.approx(-speed, rel=1e-3)


def test_the_drive_that_reaches_a_bound_may_lie_outside_the_range(scene, monkeypatch):
    """Power scales drives down below their range, so the bound is that of drives that no position has too."""
    monkeypatch.setattr(bounds, "bound_energy", lambda *_: Bound(1e-9, "attained", "which a drive reaches"))
    kinds = []
    for lowest in (0.5, 0.0):
        ends = {"magnitude": {"range": (lowest, 1.0)}, "phase": {}}
        kinds.append(bound_loss(*pieces(scene((9, 9), search={**VELOCITY, "limits": {"power": 1.0}, **ends}))).kind)
    assert kinds == ["bound only", "attained"]


def test_no_bound_is_claimed_where_none_is_proved(scene):
    moved, objectives, response = pieces(scene((9, 9), search={"position": {}}))
    assert bound_loss(moved, objectives, response) is None
    assert bound_loss(parametrization_of(scene((9, 9))), objectives, None) is None
    displacement = pieces(scene((9, 9), search=SEARCHES["displacement"]))
    assert bound_loss(*displacement[:3]) is None
