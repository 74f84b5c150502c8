"""The particle swarm against equations (7) and (8) and known minima."""

import math

import numpy as np
import pytest

from warp_plate.optimize.optimizer import SearchSpace, minimize
from warp_plate.optimize.pso import Swarm, SwarmSettings


def space_of(dimension, lower=-math.inf, upper=math.inf, initial=(-2, 2), period=math.inf):
    """Numbers without limits, first drawn from −2 ... 2, as in the source paper."""
    arrays = [np.broadcast_to(np.array(value, float), dimension) for value in (lower, upper, *initial, period)]
    return SearchSpace(("",) * dimension, *arrays)


def swarm_of(dimension, space=None, **settings):
    return Swarm(space or space_of(dimension), SwarmSettings(**settings))


def sphere(positions):
    return np.sum((positions - 0.5) ** 2, axis=1)


def rosenbrock(positions):
    first, second = positions[:, :-1], positions[:, 1:]
    return np.sum(100 * (second - first**2) ** 2 + (1 - first) ** 2, axis=1)


def step(swarm, objective):
    positions = swarm.ask()
    swarm.tell(positions, objective(positions))
    return positions


def test_the_papers_counts_and_a_callback():
    """A callback that returns true ends the loop; another call goes on."""
    evaluated, swarm, other = [], swarm_of(6), swarm_of(6)
    with pytest.raises(ValueError, match="read-only"):
        swarm.ask()[:] = 0
    result = minimize(swarm, lambda positions: evaluated.append(len(positions)) or sphere(positions))
    assert evaluated == [20] * 80
    assert (result.evaluations, result.iterations, swarm.stop()) == (1600, 80, {"iterations": 80})
    assert minimize(other, sphere, lambda optimizer: optimizer.iterations == 7).iterations == 7
    assert other.stop() == {}
    minimize(other, sphere, lambda optimizer: None)
    np.testing.assert_equal(swarm.state(), other.state())


def test_first_swarm_fills_its_ranges():
    """Positions fill the part of their range that is within the limits; velocities go half-way across the range."""
    swarm = swarm_of(2, space_of(2, 0, [1, 3], initial=([-2, 0], [2, 6])), particles=2000)
    for drawn, ends in ((swarm.ask(), ([0, 0], [1, 3])), (swarm.velocities, ([-2, -3], [2, 3]))):
        # The extremes of 2000 uniform draws lie within 1 % of the ends (missed once in 1e8).
        np.testing.assert_allclose([drawn.min(axis=0), drawn.max(axis=0)], ends, atol=0.06)
        assert np.all((drawn > ends[0]) & (drawn < ends[1]))


@pytest.mark.parametrize("ring", [False, True])
def test_moves_are_equations_7_and_8(ring):
    """G of a ring is the best of the particle and its neighbours, and the particle's own if they are equal."""
    particles, dimension, inertia, decay, cognitive, social = 5, 3, 0.7, 0.9, 1.5, 2.5
    weights = {"inertia": inertia, "decay": decay, "cognitive": cognitive, "social": social}
    swarm = swarm_of(dimension, particles=particles, iterations=6, seed=9, ring=ring, **weights)
    random = np.random.default_rng(9)
    x = -2 + 4 * random.random((particles, dimension))
    v = -2 + 4 * random.random((particles, dimension))
    best = [(math.inf, None)] * particles
    for moves in range(1, 6):
        np.testing.assert_allclose(step(swarm, rosenbrock), x, rtol=1e-12)
        losses = rosenbrock(x)
        best = [min(best[i], (losses[i], tuple(x[i])), key=lambda pair: pair[0]) for i in range(particles)]
        u = random.random((2, particles, dimension))
        for i in range(particles):
            group = [best[i], best[i - 1], best[(i + 1) % particles]] if ring else best
            leader = min(group, key=lambda pair: pair[0])[1]
            to_best, to_leader = (np.array(place) - x[i] for place in (best[i][1], leader))
            v[i] = inertia * decay**moves * v[i] + cognitive * u[0, i] * to_best + social * u[1, i] * to_leader
        x = x + v
    np.testing.assert_allclose(swarm.ask(), x, rtol=1e-12)
    np.testing.assert_allclose(swarm.velocities, v, rtol=1e-12)


def test_the_shorter_way_round():
    """Numbers that wrap are drawn across the cut of the period, and stay in one period from the range's lower end."""
    swarm = swarm_of(2, space_of(2, initial=([1, -2], [7, 2]), period=[6, math.inf]), particles=40, inertia=0.0)
    first = step(swarm, sphere)
    random = np.random.default_rng(0)
    random.random((2, 40, 2))  # positions and velocities
    way = first[np.argmin(sphere(first))] - first
    way[:, 0] -= 6 * np.round(way[:, 0] / 6)
    moved = first + 2 * random.random((2, 40, 2))[1] * way
    wrapped = np.where([True, False], 1 + (moved - 1) % 6, moved)
    np.testing.assert_allclose(swarm.ask(), wrapped, atol=1e-12)
    assert np.any(wrapped != moved)


def test_limits_and_velocity_limit_hold():
    lower, upper, walls = np.array([-1.0, 0.0]), np.array([0.25, np.inf]), 0
    swarm = swarm_of(2, space_of(2, lower, upper), inertia=4, velocity_limit=0.125, iterations=30)
    while not swarm.stop():
        positions = step(swarm, sphere)
        assert np.all((positions >= lower) & (positions <= upper) & (np.abs(swarm.velocities) <= 0.125))
        at_wall = (positions == lower) | (positions == upper)
        assert np.all(swarm.velocities[at_wall] == 0)
        walls += np.count_nonzero(at_wall)
    assert walls > 0
    # The minimum, (0.5, 0.5), is outside: the best is on the wall next to it.
    np.testing.assert_allclose(swarm.result.xbest, [0.25, 0.5], atol=2e-3)


def test_restarts_keep_the_best_and_count():
    """A flat loss stalls at once; the first swarm's one better particle stays the best. The inertia begins again: a new
    swarm's leader is at its own best, so that it moves by its inertia alone."""
    swarm = swarm_of(2, particles=5, iterations=50, stall=3, restarts=2)
    seen, velocities = [], []

    def flat(positions):
        seen.append(positions)
        velocities.append(swarm.velocities.copy())
        losses = np.ones(5)
        losses[3] -= swarm.iterations == 0
        return losses

    result = minimize(swarm, flat)
    assert swarm.stop() == {"stall": 3}
    assert (result.fbest, result.iterations, result.evaluations) == (0.0, 12, 60)
    np.testing.assert_array_equal(result.xbest, seen[0][3])
    np.testing.assert_array_equal(swarm.history["best"], 0)
    assert not np.isin(seen[4], seen[3]).any()
    assert np.abs(seen[4]).max() <= 2
    np.testing.assert_allclose((seen[5] - seen[4])[0], 0.4 * 0.99 * velocities[4][0], rtol=1e-12)


@pytest.mark.parametrize(("fall", "iterations"), [(0.4e-6, 50), (0.3e-6, 4)])
def test_stall_counts_small_steps_together(fall, iterations):
    """A loss of 1 that falls by this part an iteration: in three steps by more than 1e-6 of it, or by less."""
    swarm = swarm_of(2, iterations=50, stall=3)
    minimize(swarm, lambda positions: np.full(len(positions), 1 - fall * swarm.iterations))
    assert swarm.iterations == iterations


def test_nonfinite_losses_are_worst():
    swarm = swarm_of(2, particles=5, iterations=3)
    first = swarm.ask()
    swarm.tell(first, [np.nan, 3.0, -np.inf, 2.0, np.inf])
    assert swarm.result.fbest == 2.0
    np.testing.assert_array_equal(swarm.result.xbest, first[3])
    np.testing.assert_array_equal(swarm.personal_losses, [np.inf, 3, np.inf, 2, np.inf])
    second = step(swarm, lambda positions: np.full(5, np.nan))
    # Those that have had no finite loss are not held to the place where they began.
    np.testing.assert_array_equal(swarm.personal_positions, np.where([[1], [0], [1], [0], [1]], second, first))
    step(swarm, lambda positions: np.arange(1.0, 6.0))
    expected = {"evaluations": [5, 10, 15], "best": [2, 2, 1], "mean": [2.5, np.nan, 3]}
    np.testing.assert_equal(swarm.history, {name: np.array(values) for name, values in expected.items()})


def test_without_a_finite_loss_the_swarm_is_drawn_again():
    swarm = swarm_of(2, particles=5, iterations=30)
    seen = [step(swarm, lambda positions: np.full(5, np.nan)) for _ in range(10)]
    assert (swarm.result.xbest, swarm.result.fbest) == (None, math.inf)
    assert len(np.unique(np.concatenate(seen), axis=0)) == 50
    assert np.all(np.abs(seen) <= 2)
    assert minimize(swarm, sphere).fbest < 0.01
