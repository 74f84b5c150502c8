"""The swarm beyond the paper's: constriction, a ring of neighbours, numbers that wrap, restarts, blocks of rows."""

import itertools
import os
import signal

import numpy as np
import pytest

from warp_plate.optimize.pso import Swarm, SwarmSettings, optimize
from warp_plate.optimize.space import Space
from warp_plate.plate import row_blocks as blocks
from warp_plate.problem.methods import swarm_settings
from warp_plate.scene.search import Search


def paper_space(dimension):
    """Numbers without limits, first drawn from −2 ... 2."""
    infinite, first = np.full(dimension, np.inf), np.full(dimension, 2.0)
    return Space(("",) * dimension, -infinite, infinite, -first, first, infinite)


def test_the_paper_s_scene_has_the_paper_s_swarm():
    assert swarm_settings(Search(seed=5), paper_space(6), 3) == SwarmSettings(6, seed=3)


def test_constriction_is_clerc_and_kennedy_s():
    found = SwarmSettings.constriction(3)
    assert found.inertia == pytest.approx(0.7298, abs=5e-5)
    assert found.cognitive == found.social == pytest.approx(1.49618, abs=5e-6)
    assert found.decay == 1
    with pytest.raises(ValueError, match=r"^cognitive \+ social = 4.0: must be above 4"):
        SwarmSettings.constriction(3, 2.0, 2.0)
    made = swarm_settings(Search(method="ring", inertia=9.0), paper_space(3), 0)
    assert (made.neighbours, made.inertia) == (1, found.inertia)


@pytest.mark.parametrize("neighbours", [1, 2, 3, 50])
def test_a_ring_is_drawn_to_the_best_of_its_neighbours(neighbours):
    """Without inertia and own best, a particle moves by social · U · (best of its neighbours − X)."""
    swarm = Swarm(
        SwarmSettings(
            2, 7, 5, inertia=0.0, cognitive=0.0, social=1.0, seed=2, neighbours=neighbours, period=[9, np.inf]
        )
    )
    first = np.array(swarm.ask())
    losses = np.array([3.0, 1.0, np.nan, 5.0, 2.0, 7.0, 2.0])
    swarm.tell(first, losses)
    ranks = np.nan_to_num(losses, nan=np.inf)
    best = [
        min((ranks[(i + d) % 7], abs(d), (i + d) % 7) for d in range(-neighbours, neighbours + 1))[0] for i in range(7)
    ]
    moved = swarm.ask() - first
    for particle in range(7):
        ways = [first[other] - first[particle] for other in range(7) if ranks[other] == best[particle]]
        shares = [moved[particle] / np.where(way == 0, np.inf, way) for way in ways]
        assert any(np.all((share >= 0) & (share < 1)) for share in shares)
        assert (moved[particle] == 0).all() == (best[particle] == ranks[particle])


def test_the_shorter_way_round():
    swarm = Swarm(SwarmSettings(1, 2, 9, 0.0, 1.0, 0.0, 1.0, start=[[0.25], [5.75]], period=6, position_range=(0, 6)))
    positions = swarm.ask()
    swarm.tell(positions, [0.0, 1.0])
    after = swarm.ask()
    # Half a unit across the cut, not five and a half back.
    assert after[1, 0] >= 5.75 or after[1, 0] <= 0.25
    assert after[0, 0] == 0.25


def test_a_period_takes_no_bounds():
    with pytest.raises(ValueError, match=r"^period = .*: must be above 0, and infinite for numbers that have bounds"):
        SwarmSettings(2, period=[6, 6], bounds=([0, -np.inf], [1, np.inf]))
    with pytest.raises(ValueError, match=r"^restarts = 2: must be 0 without stall"):
        SwarmSettings(2, restarts=2)


def test_restarts_keep_the_best_and_count():
    """A flat loss stalls at once; the first swarm's one better particle stays the best."""
    swarm = Swarm(SwarmSettings(2, 5, 50, stall=3, restarts=2))
    seen = []

    def flat(positions):
        seen.append(np.array(positions))
        losses = np.ones(5)
        losses[3] -= swarm.iterations == 0
        return losses

    result = optimize(swarm, flat)
    assert swarm.stop() == {"stall": 3}
    assert (result.fbest, result.iterations, result.evaluations) == (0.0, 12, 60)
    np.testing.assert_array_equal(result.xbest, seen[0][3])
    np.testing.assert_array_equal(swarm.history["best"], 0)
    assert not np.isin(seen[4], seen[3]).any()
    assert np.abs(seen[4]).max() <= 2


@pytest.mark.parametrize("random_numbers", ["component", "particle"])
def test_blocks_of_rows_change_no_bit(random_numbers, monkeypatch):
    """However the rows are cut, each particle gets the numbers that one call for the whole swarm gives it."""
    found = []
    for rows in (1000, 7, 64):
        monkeypatch.setattr(blocks, "ROWS", rows)
        swarm = Swarm(SwarmSettings(3, 150, 6, bounds=(-1, 2), random_numbers=random_numbers, neighbours=2))
        optimize(swarm, lambda positions: np.sum(positions**2, axis=1))
        found.append(swarm.state())
    assert found[0] == found[1] == found[2]


def losses_in_parts(positions, reach=150):
    """Of so many particles' positions, looked at from the first to the last; the others are not looked at."""
    losses = np.full(150, 0.5)
    for first in range(0, reach, 23):
        some = slice(first, min(first + 23, reach))
        losses[some] = np.sin(3 * positions[some]).sum(axis=1)
    losses[40:43] = np.nan
    return losses


@pytest.mark.parametrize(
    "options", [{}, {"neighbours": 2}, {"stall": 2, "restarts": 1, "stall_tolerance": 9.0}], ids=["", "ring", "restart"]
)
def test_a_large_swarm_that_moves_as_it_is_looked_at_is_the_same(options, monkeypatch):
    """Looked at in parts, not to the end, or not at all; kept and read back in the middle; of a loss that ties."""
    settings = SwarmSettings(3, 150, 9, period=[np.inf, 5, np.inf], **options)
    plain, made = Swarm(settings), []
    for generation in range(9):
        positions = plain.ask()
        assert isinstance(positions, np.ndarray)
        plain.tell(positions, losses_in_parts(positions, 150 if generation % 3 else 60))
        made.append(plain.result)
    monkeypatch.setattr(blocks, "ROWS", 16)
    large = Swarm(settings)
    for generation in range(9):
        positions = large.ask()
        assert large.ask() is positions
        losses = losses_in_parts(positions, 150 if generation % 3 else 60)
        if generation % 2:
            large = Swarm.from_state(large.state())
            positions = large.ask()
        large.tell(positions, losses)
        assert large.result.fbest == made[generation].fbest
        np.testing.assert_array_equal(large.result.xbest, made[generation].xbest)
        if generation == 4:
            large = Swarm.from_state(large.state(False))
    assert large.state() == plain.state()
    np.testing.assert_array_equal(large.velocities, plain.velocities)


@pytest.mark.parametrize("looked_at", [9, 100], ids=["one block", "several"])
def test_ctrl_c_in_the_middle_of_a_move_changes_no_bit(looked_at, monkeypatch):
    """It is heard when the rows that were asked for have moved, and no thread goes on behind."""
    settings, found = SwarmSettings(3, 150, 9, bounds=(-1, 2)), []
    monkeypatch.setattr(blocks, "ROWS", 16)
    for interrupted in (False, True):
        swarm = Swarm(settings)
        swarm.tell(swarm.ask(), losses_in_parts(swarm.positions))
        positions = swarm.ask()
        if interrupted:
            confine, asked = swarm._confine, itertools.count()

            def ctrl_c(*args, confine=confine, asked=asked):
                if next(asked) == 0:
                    os.kill(os.getpid(), signal.SIGINT)
                confine(*args)

            monkeypatch.setattr(swarm, "_confine", ctrl_c)
            with pytest.raises(KeyboardInterrupt):
                positions[:looked_at]
            assert next(asked) == -(-looked_at // 16)
        found.append(swarm.state())
        swarm.tell(positions, losses_in_parts(positions))
        found.append(swarm.state())
    assert found[:2] == found[2:]


def test_a_large_swarm_of_no_finite_loss_is_drawn_again(monkeypatch):
    monkeypatch.setattr(blocks, "ROWS", 16)
    swarm = Swarm(SwarmSettings(3, 150, 9))
    first = np.array(swarm.ask())
    swarm.tell(first, np.full(150, np.nan))
    assert swarm.result.xbest is None
    assert not np.isin(np.asarray(swarm.ask()), first).any()


def test_a_fault_in_a_block_is_told():
    def task(rows):
        if rows.start:
            raise ValueError("in the second block")

    with pytest.raises(ValueError, match="second block"):
        blocks.over_blocks(task, blocks.ROWS + 1)
