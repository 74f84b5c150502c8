"""Bounds under limits: above every drive that keeps them, tight where the relaxation is; bounds of losses."""

import math

import numpy as np
import pytest
import scipy

from warp_plate.optimize.quadratic import best_position
from warp_plate.plate.designs import Designs
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.allowed_drives import AllowedDrives, allowed_drives
from warp_plate.problem.bounds import EnergyLimits, bound_energy, bound_localization
from warp_plate.problem.problem import make_problem
from warp_plate.problem.semidefinite import least_majorant
from warp_plate.quantities.region_quantities import PLATE, TARGET
from warp_plate.resolve import resolve
from warp_plate.solve.response import Response

INFINITE, SEARCHED = math.inf, math.nan


def gram(random, actuators, rank=None):
    """Return matrices like those of a plate: 0 ⪯ target ⪯ plate."""
    rank = rank or 2 * actuators
    factor = random.normal(size=(2 * actuators, rank))
    orthogonal, _ = np.linalg.qr(random.normal(size=(rank, rank)))
    shares = orthogonal * random.uniform(0, 1, rank) @ orthogonal.T
    parts = {PLATE: np.eye(rank), TARGET: shares}
    return Response(np.array([factor @ parts[region] @ factor.T for region in sorted(parts)]))


def allowed(actuators, lower=-INFINITE, upper=INFINITE, phase=SEARCHED, power=INFINITE, equal=False):
    """Return a set of drives; each limit is a number, or one for each actuator."""
    arrays = (np.broadcast_to(np.asarray(value, float), actuators) for value in (lower, upper, phase))
    return AllowedDrives(*arrays, power, equal)


def drawn(random, limits, count):
    """Return random drives that keep the limits, many of them at a limit."""
    actuators = len(limits.phase)
    top = np.where(np.isfinite(limits.upper), limits.upper, 2.0)
    low = np.where(np.isfinite(limits.lower), limits.lower, -top)
    size = low + (top - low) * np.clip(random.uniform(-0.5, 1.5, (count, actuators)), 0, 1)
    if limits.equal:
        size = np.broadcast_to(size[:, :1], size.shape)
    power = (size**2).sum(axis=1, keepdims=True)
    if (limits.lower > 0).any():
        size = size[power[:, 0] <= limits.power]
    else:
        size = size * np.sqrt(np.minimum(1, limits.power / power))
    phase = random.uniform(0, 2 * np.pi, size.shape)
    return size * np.exp(-1j * np.where(np.isnan(limits.phase), phase, limits.phase))


CASES = {
    "none": {},
    "all phases fixed": {"phase": [0.4, 1.0, 3.0]},
    "fixed, no sign": {"phase": [0.4, 1.0, 3.0], "lower": 0.0},
    "equal": {"equal": True, "lower": 0.0},
    "range": {"lower": 0.5, "upper": 1.0},
    "one magnitude fixed": {"lower": [1.0, 0.2, 0.0], "upper": [1.0, 0.8, 1.0], "phase": [0.0, SEARCHED, SEARCHED]},
    "magnitudes fixed": {"lower": [1.0, 0.5, 0.2], "upper": [1.0, 0.5, 0.2]},
    "one off": {"lower": 0.0, "upper": [1.0, 0.0, 1.0]},
    "one without end": {"lower": [0.0, 0.3, 0.2], "upper": [1.0, 0.4, INFINITE]},
    "power": {"lower": 0.5, "power": 1.2},
    "all": {"lower": 0.2, "upper": 1.0, "power": 1.5, "phase": [0.0, SEARCHED, SEARCHED]},
}


@pytest.mark.parametrize("case", [*CASES.values(), {"power": 3.0}], ids=[*CASES, "power alone"])
def test_no_allowed_drive_exceeds_the_bounds_of_ratio_and_energy(random, case):
    limits = allowed(3, **case)
    for rank in (None, 2):
        response = gram(random, 3, rank)
        bound = bound_localization(response, limits)
        energy = response.energy(drawn(random, limits, 5000))
        moved = energy[:, PLATE] > 1e-9 * energy.max()
        assert localization_factor(energy[moved]).max() <= bound.value + 1e-8, rank
        assert bound.value <= response.bound() * (1 + 1e-9)
    response = gram(random, 3)
    target, plate = response.matrices[[TARGET, PLATE]]
    energies = response.energy(drawn(random, limits, 5000))
    inside, rest = energies[:, TARGET], energies[:, PLATE] - energies[:, TARGET]
    bound = bound_energy(target, limits)
    if np.isinf(limits.upper).any() and math.isinf(limits.power):
        assert bound is None  # nothing limits it
    else:
        assert inside.max() <= bound.value * (1 + 1e-9)
    if case == {"power": 3.0}:
        assert (bound.value, bound.kind) == (pytest.approx(3 * np.linalg.eigvalsh(target)[-1], rel=1e-8), "attained")
    most = float(np.median(rest))
    with_rest = bound_energy(target, limits, EnergyLimits([(plate - target, most)]))
    assert inside[rest <= most].max() <= with_rest.value * (1 + 1e-9)
    assert bound is None or with_rest.value <= bound.value * (1 + 1e-6)
    if not case:  # so much energy in the rest lets LF / (1 − LF) times as much into the target
        assert with_rest.value == pytest.approx(most / (1 / response.bound() - 1), rel=1e-5)


def test_equal_magnitudes_of_two_are_bounded_by_the_best_on_a_grid(random):
    """The relaxation for two actuators with one fixed phase is exact: the bound is the best of all phases."""
    for _ in range(5):
        response = gram(random, 2)
        bound = bound_localization(response, allowed(2, lower=0.0, phase=[0.0, SEARCHED], equal=True))
        turn = np.exp(-1j * np.linspace(0, 2 * np.pi, 20_001))
        best = localization_factor(response.energy(np.stack([np.ones_like(turn), turn], axis=1))).max()
        assert bound.value == pytest.approx(best, abs=1e-6)
        assert bound.kind == "attained"


def test_magnitudes_that_are_fixed_and_equal_do_not_stop_the_search(random):
    for _ in range(2):
        factor = random.normal(size=(10, 10)) * np.tile(np.geomspace(1, 1e-2, 5), 2)
        response, limits = Response(factor @ gram(random, 5).matrices @ factor.T), allowed(5, 1.0, 1.0, equal=True)
        found = response.localization_factors(bound_localization(response, limits).drive[None])
        assert found[0] >= response.localization_factors(drawn(random, limits, 5000)).max()


def test_units_do_not_matter(random):
    """Actuators of very different strength, and energies in tiny units."""
    response, size = gram(random, 3), np.array([1e-6, 1.0, 1e5])
    other = Response(1e-20 * response.matrices / np.outer(np.tile(size, 2), np.tile(size, 2)))
    lower, upper = np.array([0.5, 0.2, 0.3]), np.array([1.0, 1.0, 2.0])
    limits, scaled = allowed(3, lower, upper), allowed(3, lower * size, upper * size)
    ratios = bound_localization(response, limits).value, bound_localization(other, scaled).value
    energies = bound_energy(response.matrices[TARGET], limits).value, bound_energy(other.matrices[TARGET], scaled).value
    assert ratios[1] == pytest.approx(ratios[0], rel=1e-6)
    assert 1e20 * energies[1] == pytest.approx(energies[0], rel=1e-6)


@pytest.mark.parametrize("lower", [0.0, 0.4])
def test_bounds_of_tiny_energies_are_as_tight(random, lower):
    """½ ∫ ρH u² dA of a gram that moves by picometres is 1e-27 J."""
    for actuators in (2, 2, 3, 3):
        matrix, limits = gram(random, actuators).matrices[TARGET], allowed(actuators, lower, 1.2)
        assert 1e27 * bound_energy(1e-27 * matrix, limits).value == pytest.approx(bound_energy(matrix, limits).value)


@pytest.mark.parametrize("largest", [1e2, 1e3, 1e5, 1e9])
def test_wide_ranges_leave_bounds_under_limits_of_energies_tight(random, largest):
    """With two limits of forms that do not depend on a common phase, the relaxation is exact."""
    for _ in range(3):
        factors = random.normal(size=(3, 8, 4)) + 1j * random.normal(size=(3, 8, 4))
        target, rest, sound = (np.block([[a.real, a.imag], [-a.imag, a.real]]) for a in factors.conj().mT @ factors)
        response = Response(np.array([form for _, form in sorted([(PLATE, target + rest), (TARGET, target)])]))
        some = scipy.linalg.eigh(sound, target)[1][:, 0]  # the quietest drive
        others = EnergyLimits([(sound, 1.1 * some @ sound @ some)], [(target, some @ target @ some)])
        phase = [0.0, SEARCHED, SEARCHED, SEARCHED]
        bound = bound_localization(response, allowed(4, 0.0, largest, phase), others=others)
        reached = localization_factor(response.energy(bound.drive[None]))[0]
        assert bound.value * (1 - 5e-6) <= reached <= bound.value


@pytest.mark.parametrize("ends", [(0.0, 1e3), (1e-4, 1e3), (1e-2, 1e5)])
def test_wide_ranges_leave_bounds_above_a_least_energy_tight(random, ends):
    """Equal magnitudes within them reach the least energy, so that neither limits the ratio."""
    response, phase = gram(random, 3), [0.0, SEARCHED, SEARCHED]
    target = response.matrices[TARGET]
    others = EnergyLimits([], [(target, 1e-6 * np.linalg.eigvalsh(target)[-1])])
    limited = bound_localization(response, allowed(3, *ends, phase, equal=True), others=others)
    free = bound_localization(response, allowed(3, 0.0, phase=phase, equal=True))
    assert limited.value == pytest.approx(free.value, rel=1e-6)


def test_where_no_bound_is_proved_none_is_claimed(random):
    """Without motion or a limit: −z² ≤ 1 does not limit z². Many actuators keep the eigenvalue."""
    still = Response(np.zeros((2, 4, 4)))
    assert bound_localization(still, allowed(2)) is None
    assert bound_localization(still, allowed(2, lower=0.0, upper=0.0)) is None
    assert bound_energy(np.eye(4), allowed(2)) is None
    value, slack = least_majorant(np.eye(1), -np.ones((1, 1, 1)), np.ones(1), np.zeros(1, bool))
    assert (value, slack.size) == (math.inf, 0)
    response = gram(random, 50)
    bound = bound_localization(response, allowed(50, lower=0.0, equal=True))
    assert (bound.value, bound.kind) == (pytest.approx(response.bound()), "bound only")


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_limits_that_say_the_same_bound_alike(random, count):
    """So many of them that the first multipliers keep the slack positive."""
    matrix = random.normal(size=(4, 4))
    matrix = matrix @ matrix.T
    value, _ = least_majorant(matrix, np.tile(np.eye(4), (count, 1, 1)), 2.0 + np.arange(count), np.zeros(count, bool))
    assert value == pytest.approx(2 * np.linalg.eigvalsh(matrix)[-1], rel=1e-8)


RANGE = {"magnitude": {"range": (0.5, 2.0)}, "phase": {}}
VELOCITY = {"objectives": [{"kind": "velocity"}]}
SEARCHES = {
    "paper": {},
    "equal": {"limits": {"equal_magnitudes": True}},
    "phases alone": {"phase": {}},
    "magnitudes alone": {"magnitude": {"range": (0.0, 1.0)}},
    "some": {"magnitude": {"range": (0.2, 1.0), "actuators": ("1",)}, "phase": {"actuators": ("0", "2")}},
    "contrast": {"objectives": [{"kind": "contrast"}], **RANGE},
    "velocity, power": {**VELOCITY, "limits": {"power": 3.0}, **RANGE},
    "velocity, magnitude": {**VELOCITY, "limits": {"magnitude": 1.5}},
    "velocity, rest": {
        "objectives": [{"kind": "velocity", "rest_limit": 2e-4}], "magnitude": {"range": (0.0, 100.0)}, "phase": {},
    },
    "velocity, equal": {**VELOCITY, "limits": {"equal_magnitudes": True, "power": 3.0}, **RANGE},
    "several": {"objectives": [{"weight": 2}, {"kind": "velocity", "weight": 30}, {"kind": "uniformity"}], **RANGE},
    "displacement": {"objectives": [{"kind": "displacement"}], **RANGE},
    "equal of a range": {"limits": {"equal_magnitudes": True}, **RANGE},
    "several, scaled to a power": {
        "objectives": [{}, {"kind": "velocity", "weight": 30}], "phase": {}, "limits": {"power": 0.5},
    },
}  # fmt: skip


@pytest.mark.parametrize("search", SEARCHES.values(), ids=SEARCHES)
def test_no_position_has_less_loss_and_every_drive_is_allowed(scene, random, search):
    made = scene((9, 9), damping=130.0, window=(0.01, 0.02), search=search)
    actuators = [actuator.model_dump() for actuator in made.actuators]
    actuators[2]["phase"] = 0.7
    equal = search.get("limits", {}).get("equal_magnitudes", False)
    if "magnitude" in search or not equal:
        actuators[2]["magnitude"] = -0.6
    problem = make_problem(resolve(made.with_tables(actuators=actuators), "cpu", evaluator="response"))
    bound, objectives = problem.loss_bound, problem.objectives
    positions = problem.space.from_unit(random.random((20_000, problem.space.dimension)))
    losses, phasors = problem.losses(positions), problem.parametrization.designs(positions).drives
    assert np.isfinite(bound.value)
    assert np.nanmin(losses) >= bound.value - 1e-9 * abs(bound.value)
    if search not in (SEARCHES["some"], SEARCHES["magnitudes alone"]):  # so early, a common phase counts
        shifted = phasors * np.exp(1j * random.uniform(0, 2 * np.pi, (len(phasors), 1)))
        assert np.nanmin(problem.design_losses(Designs(shifted))) >= bound.value - 1e-9 * abs(bound.value)
    assert bound.kind == "bound only" or len(objectives.terms) == 1
    if search == SEARCHES["displacement"]:
        assert losses.min() <= 0.8 * bound.value
    if search == SEARCHES["velocity, rest"]:  # so much energy there lets LF / (1 − LF) times as much into the target
        rest, factor = objectives.sizes.masses[1] * 2e-4**2 / 2, problem.response.bound()
        speed = math.sqrt(2 * rest * factor / (1 - factor) / objectives.sizes.masses[0])
        assert bound.value == pytest.approx(-speed, rel=1e-3)
    limits = allowed_drives(problem.parametrization)
    turned = phasors * np.exp(1j * np.where(np.isnan(limits.phase), -np.angle(phasors), limits.phase))
    assert np.abs(turned.imag).max() < 1e-12
    scaled = limits.scaled & ((np.abs(phasors) ** 2).sum(axis=1, keepdims=True) > limits.power * (1 - 1e-9))
    assert ((turned.real >= limits.lower - 1e-12) | scaled).all()
    assert (turned.real <= limits.upper + 1e-12).all()
    assert ((np.abs(phasors) ** 2).sum(axis=1) <= limits.power * (1 + 1e-12)).all()
    if equal:
        assert np.ptp(np.abs(phasors), axis=1).max() <= 1e-12 * np.abs(phasors).max()


def test_power_scales_ranges_too(scene):
    """A drive of too much power is scaled down below its range; its bound lies below that of drives without one."""
    bounds = []
    for lowest in (50.0, 0.0):
        search = {**SEARCHES["displacement"], "magnitude": {"range": (lowest, 200.0)}, "limits": {"power": 1e4}}
        problem = make_problem(resolve(scene((9, 9), search=search), "cpu"))
        bounds.append(problem.loss_bound)
        position = best_position(problem.space, problem.quadratic)
        assert problem.quadratic.losses(position[None])[0] == pytest.approx(bounds[-1].value, rel=1e-6)
    assert [bound.kind for bound in bounds] == ["attained", "attained"]
    assert bounds[0].value > bounds[1].value


def test_no_loss_is_bounded_without_gram_matrices(scene):
    for tables in ({"search": {"position": {}}}, {"effects": {"stretching": {}}}):
        assert make_problem(resolve(scene((9, 9), **tables), "cpu")).loss_bound is None
