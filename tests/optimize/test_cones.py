"""Second-order cone programs of drives: drives keep what is asked, bounds are proved, and both meet where convex."""

import numpy as np
import pytest

from warp_plate.optimize.cones import Block, least_scale, least_scale_of_squares

RNG = np.random.default_rng(5)


def random_rows(*shape):
    return RNG.normal(size=shape) + 1j * RNG.normal(size=shape)


def excess(drive, wanted, blocks, scale, actuators=1.0):
    """Return by how much a drive violates a program with a scale."""
    over = [np.linalg.norm(block.rows @ drive, axis=1) - (scale if block.scaled else 1.0) for block in blocks]
    return max((1 - (wanted @ drive).real).max(), (np.abs(drive) - actuators).max(), *(part.max() for part in over))


@pytest.mark.parametrize("rows", [1, 3])
def test_the_drive_attains_the_bound_of_a_convex_program(rows):
    for _ in range(10):
        wanted = 3 * random_rows(2, 4)
        blocks = [Block(random_rows(5, rows, 4), True), Block(0.1 * random_rows(1, 4, 4))]
        result = least_scale(wanted, blocks)
        assert excess(result.drive, wanted, blocks, result.scale) < 1e-7
        assert result.bound == pytest.approx(result.scale, rel=1e-6)
        assert result.bound <= result.scale * (1 + 1e-9)


def test_no_drive_passes_the_bound():
    wanted, blocks = 3 * random_rows(1, 3), [Block(random_rows(4, 2, 3), True)]
    bound = least_scale(wanted, blocks).bound
    drives = random_rows(20000, 3)
    drives /= np.abs(drives).max(axis=1, keepdims=True)
    drives *= np.exp(-1j * np.angle(drives @ wanted[0]))[:, None]
    reached = (drives @ wanted[0]).real
    scales = np.linalg.norm(np.einsum("bri,di->dbr", blocks[0].rows, drives), axis=2).max(axis=1)
    assert ((scales / reached)[reached >= 1] >= bound * (1 - 1e-9)).all()


def test_actuators_may_be_scaled_instead():
    """One row and no other limit: the drives of equal size in phase with it are the least ones."""
    row = random_rows(1, 5)
    result = least_scale(row, [], actuators_scaled=True)
    assert result.scale == pytest.approx(1 / np.abs(row).sum(), rel=1e-8)


def test_levels_beyond_the_limits_are_proved_to_be_so():
    result = least_scale(np.full((1, 3), 0.1 + 0j), [Block(random_rows(2, 1, 3), True)])
    assert result.scale == np.inf
    assert result.bound > 1e3


@pytest.mark.parametrize("squares", [0, 2])
@pytest.mark.parametrize("level", [1e-12, 1e-9, 1e-3, 1e3])
def test_levels_of_any_size_have_the_same_scale(level, squares):
    """Limits do not matter to levels far below them."""
    rows, rest = (10 * max(1, level) * random_rows(*shape) for shape in ((2, 4), (6, 1, 4)))
    wanted, factors = rows[squares:], list(rows[:squares, None])
    usual = least_scale_of_squares(wanted, factors, [Block(rest, True)])
    result = least_scale_of_squares(wanted / level, [row / level for row in factors], [Block(rest / level, True)])
    assert result.scale == pytest.approx(usual.scale, rel=1e-7 if squares else 1e-9)
    assert result.scale * (1 - (0.3 if squares else 0.02)) < result.bound <= result.scale
    reached = rows @ result.drive / level
    assert (np.abs(reached) if squares else reached.real).min() == pytest.approx(1, rel=1e-7)


def test_the_least_scale_of_mean_squares_is_an_eigenvalue():
    target, rest = random_rows(3, 3), random_rows(4, 3)
    result = least_scale_of_squares(np.empty((0, 3)), [1e3 * target], [Block(1e3 * rest[None], True)])
    ratios = np.linalg.eigvals(np.linalg.solve(target.conj().T @ target, rest.conj().T @ rest)).real
    assert result.scale == pytest.approx(np.sqrt(ratios.min()), rel=1e-6)
    assert result.bound == pytest.approx(result.scale, rel=1e-5)


def test_bounds_of_points_with_free_phases_hold():
    points, rest = [3 * random_rows(1, 3) for _ in range(3)], Block(random_rows(4, 1, 3), True)
    result = least_scale_of_squares(np.empty((0, 3)), points, [rest])
    assert min(np.abs(row @ result.drive)[0] for row in points) > 1 - 1e-7
    assert np.abs(rest.rows[:, 0] @ result.drive).max() < result.scale * (1 + 1e-7)
    drives = random_rows(100000, 3)
    drives /= np.abs(drives).max(axis=1, keepdims=True)
    weakest = np.min([np.abs(drives @ row[0]) for row in points], axis=0)
    scales = np.abs(drives @ rest.rows[:, 0].T).max(axis=1) / weakest
    assert result.bound <= scales[weakest >= 1].min()
    assert result.bound > 0.7 * result.scale


@pytest.mark.parametrize("near", [1e8, 1e10])
def test_what_the_solver_gives_up_is_no_scale(near):
    """Levels 26 and more powers of ten below what is wanted at the same points."""
    for _ in range(6):
        rows = random_rows(20, 3)
        blocks = [Block(1e-8 * rows[4:, None]), Block(near * rows[:3, None])]
        result = least_scale_of_squares(np.empty((0, 3)), [1e-18 * rows[:4]], blocks, True)
        assert (result.scale, result.bound) == (np.inf, 0.0)
        assert np.isnan(result.drive).all()


def test_a_start_without_a_drive_at_its_phases_is_given_up():
    """Its amplitudes were returned, which sixty rounds of added points did not change."""
    start, rest = np.ones(1, dtype=complex), [Block(np.ones((1, 1, 1), dtype=complex), True)]
    for size, reached in ((0.5, False), (2.0, True)):
        result = least_scale_of_squares(np.empty((0, 1)), [np.array([[size + 0j]])], rest, start=start)
        assert (result.start is not None) == np.isfinite(result.scale) == reached
