"""Bounds under limits: above every drive that keeps them, tight where the relaxation is."""

import math

import numpy as np
import pytest

from warp_plate.plate.weights import REGIONS, localization_factor
from warp_plate.problem.bounds import MOST_ACTUATORS, AllowedDrives, bound_energy, bound_localization
from warp_plate.problem.semidefinite import least_majorant
from warp_plate.solve.response import Response

INFINITE, SEARCHED = math.inf, math.nan
PLATE, TARGET = REGIONS.index("plate"), REGIONS.index("target")


def gram(random, actuators, rank=None):
    """Return matrices like those of a plate: 0 ⪯ target ⪯ plate."""
    count = 2 * actuators
    factor = random.normal(size=(count, rank or count))
    orthogonal, _ = np.linalg.qr(random.normal(size=(rank or count, rank or count)))
    shares = orthogonal * random.uniform(0, 1, rank or count) @ orthogonal.T
    matrices = {"plate": factor @ factor.T, "target": factor @ shares @ factor.T}
    return Response(np.array([matrices[name] for name in REGIONS]))


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
    power = (size**2).sum(axis=1)
    if math.isfinite(limits.power):
        if (limits.lower > 0).any():
            size = size[power <= limits.power]
        else:
            size = size * np.sqrt(np.minimum(1, limits.power / power))[:, None]
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
    "one off": {"lower": 0.0, "upper": [1.0, 0.0, 1.0], "equal": False},
    "one without end": {"lower": [0.0, 0.3, 0.2], "upper": [1.0, 0.4, INFINITE]},
    "power": {"lower": 0.5, "power": 1.2},
    "all": {"lower": 0.2, "upper": 1.0, "power": 1.5, "phase": [0.0, SEARCHED, SEARCHED]},
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_no_allowed_drive_exceeds_the_bound_of_the_ratio(random, case):
    limits = allowed(3, **case)
    for rank in (None, 2):
        response = gram(random, 3, rank)
        bound = bound_localization(response, limits)
        energy = response.energy(drawn(random, limits, 5000))
        moved = energy[:, PLATE] > 1e-9 * energy.max()
        assert localization_factor(energy[moved]).max() <= bound.value + 1e-8, rank
        assert bound.value <= response.bound() * (1 + 1e-9)


@pytest.mark.parametrize("case", [*list(CASES.values())[4:], {"power": 3.0}], ids=str)
def test_no_allowed_drive_exceeds_the_bound_of_the_energy(random, case):
    limits, response = allowed(3, **case), gram(random, 3)
    target, plate = response.matrices[[TARGET, PLATE]]
    energies = response.energy(drawn(random, limits, 5000))
    inside = energies[:, TARGET]
    rest = energies[:, PLATE] - inside
    bound = bound_energy(target, limits)
    if (np.isinf(limits.upper)).any() and math.isinf(limits.power):
        assert bound is None  # nothing limits it
    else:
        assert inside.max() <= bound.value * (1 + 1e-9)
    if case == {"power": 3.0}:
        assert (bound.value, bound.kind) == (pytest.approx(3 * np.linalg.eigvalsh(target)[-1], rel=1e-8), "attained")
    most = float(np.median(rest))
    with_rest = bound_energy(target, limits, [(plate - target, most)])
    assert inside[rest <= most].max() <= with_rest.value * (1 + 1e-9)
    assert bound is None or with_rest.value <= bound.value * (1 + 1e-6)


def test_equal_magnitudes_of_two_are_bounded_by_the_best_on_a_grid(random):
    """The relaxation for two actuators with one fixed phase is exact: the bound is the best of all phases."""
    for _ in range(5):
        response = gram(random, 2)
        bound = bound_localization(response, allowed(2, lower=0.0, phase=[0.0, SEARCHED], equal=True))
        turn = np.exp(-1j * np.linspace(0, 2 * np.pi, 20_001))
        best = localization_factor(response.energy(np.stack([np.ones_like(turn), turn], axis=1))).max()
        assert bound.value == pytest.approx(best, abs=1e-6)
        assert bound.kind == "attained"


def test_a_limit_on_the_rest_gives_the_ratio(random):
    """The most energy in the target for so much in the rest is that times LF / (1 − LF), up to the rounding of a rest
    that nearly vanishes."""
    for draws in (random, *map(np.random.default_rng, (239, 364, 453))):
        response = gram(draws, 3)
        target, plate = response.matrices[[TARGET, PLATE]]
        factor = response.bound()
        bound = bound_energy(target, allowed(3), [(plate - target, 0.7)])
        rounding = 1e-6 * max(1, 0.01 / (1 - factor))
        assert 0 <= bound.value * (1 - factor) / (0.7 * factor) - 1 < rounding
        assert bound.kind == "attained" or rounding > 1e-6


def test_units_do_not_matter(random):
    """Actuators of very different strength, and energies in tiny units."""
    response = gram(random, 3)
    size = np.array([1e-6, 1.0, 1e5])
    both = np.tile(size, 2)
    other = Response(1e-20 * response.matrices / np.outer(both, both))
    lower, upper = np.array([0.5, 0.2, 0.3]), np.array([1.0, 1.0, 2.0])
    bound = bound_localization(response, allowed(3, lower=lower, upper=upper))
    scaled = bound_localization(other, allowed(3, lower=lower * size, upper=upper * size))
    assert scaled.value == pytest.approx(bound.value, rel=1e-6)
    energy = bound_energy(response.matrices[1], allowed(3, lower=lower, upper=upper))
    tiny = bound_energy(other.matrices[1], allowed(3, lower=lower * size, upper=upper * size))
    assert tiny.value == pytest.approx(1e-20 * energy.value, rel=1e-6)


def test_without_motion_or_limit_no_bound_is_claimed():
    still = Response(np.zeros((2, 4, 4)))
    assert bound_localization(still, allowed(2)) is None
    assert bound_localization(still, allowed(2, lower=0.0, upper=0.0)) is None
    assert bound_energy(np.eye(4), allowed(2)) is None


def test_many_actuators_keep_the_eigenvalue(random):
    response = gram(random, MOST_ACTUATORS + 1)
    bound = bound_localization(response, allowed(MOST_ACTUATORS + 1, lower=0.0, equal=True))
    assert (bound.value, bound.kind) == (pytest.approx(response.bound()), "bound only")


def test_without_multipliers_there_is_no_bound():
    """−z² ≤ 1 does not limit z²."""
    value, slack = least_majorant(np.eye(1), -np.ones((1, 1, 1)), np.ones(1), np.zeros(1, bool))
    assert value == math.inf
    assert slack.size == 0
