"""Drives of any shape, kind and size given to ``PlateSolver.run``: right numbers, a faulty plate, or one line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from support.scenes import refused, scene_of
from warp_plate import PlateSolver
from warp_plate.solve.batching import LARGEST_DRIVE, SMALLEST_DRIVE

ACTUATORS = 3
# The sizes that are kept, with room for the rounding of a sum of three.
SIZES = st.floats(10 * SMALLEST_DRIVE, LARGEST_DRIVE / 10)
PARTS = st.just(0.0) | SIZES | SIZES.map(lambda size: -size)


@pytest.fixture(scope="module")
def short_solver():
    return PlateSolver(scene_of(damping=88.5, precision="float32", window=(0.002, 0.006)), "cpu")


def refuse(short_solver, *arguments, **options):
    line = refused(short_solver.run, *arguments, **options)
    assert line.isprintable()
    return line


@settings(max_examples=20)
@given(
    drives=arrays.arrays(
        st.sampled_from([np.float64, np.complex128]), st.tuples(st.integers(0, 6), st.just(ACTUATORS)),
        elements={"allow_nan": True, "allow_infinity": True},
    ),
    good=st.lists(st.tuples(*[PARTS] * ACTUATORS), min_size=1, max_size=4),
)  # fmt: skip
def test_a_bad_drive_harms_no_other(short_solver, drives, good):
    """Good drives give the same bits as alone whatever stands beside them; every bad one is reported."""
    good = np.array(good)
    alone = short_solver.run(good, (0.004,))
    mixed = short_solver.run(np.concatenate([drives, good, drives]), (0.004,))
    middle = slice(len(drives), len(drives) + len(good))
    np.testing.assert_array_equal(mixed.energy[middle], alone.energy)
    np.testing.assert_array_equal(mixed.displacement[middle], alone.displacement)
    assert alone.finite.all()
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.abs(drives).max(axis=1) if len(drives) else np.zeros(0)
    bad = ~(np.isfinite(size) & ((size == 0) | ((size >= SMALLEST_DRIVE) & (size <= LARGEST_DRIVE))))
    # Near the end, the plate's own stiffness may carry a drive beyond it.
    near = (size > LARGEST_DRIVE / 10) & (size < 10 * LARGEST_DRIVE)
    np.testing.assert_array_equal(mixed.finite[: len(drives)][~near], ~bad[~near])
    np.testing.assert_array_equal(mixed.finite[: len(drives)], mixed.finite[middle.stop :])
    faults = mixed.status[: len(drives)]
    assert set(faults[~np.isfinite(drives).all(axis=1)]) <= {"drive is not finite"}
    assert set(faults[~bad & ~near]) <= {"ok"}


def test_values_that_are_no_drives_are_refused(short_solver):
    for shape in ((), (3,), (0, 0), (2, 4), (1, 1, 3), (2, 3, 1, 1)):
        assert "drives: shape" in refuse(short_solver, np.zeros(shape))
    for drives in (
        None, "abc", {1: 2}, [[1, None, 2]], [[1, 2, 3], [1, 2]], [[10**400, 1, 1]], iter([[1, 2, 3]]),
        np.ma.masked_array([[1.0, 2, 3]], mask=[[0, 1, 0]]), ([[1, 2, 3]], [[0, 0]]), ([[1j, 1, 1]], [[0, 0, 0]]),
        ([[1, 2, 3]], [[0, 0, 0]], [[0, 0, 0]]), np.array([["2026-01-01"] * 3], "M8[D]"), np.array([[b"1"] * 3]),
    ):  # fmt: skip
        assert refuse(short_solver, drives).startswith("drives: ")


def test_magnitudes_and_phases(short_solver):
    """Pairs Z = magnitude · exp(−i·phase) of numbers; those that are not finite are reported."""
    magnitude, phase = np.random.default_rng(0).uniform(-2, 2, (2, 4, 3))
    expected = short_solver.run(magnitude * np.exp(-1j * phase)).energy
    np.testing.assert_array_equal(short_solver.run((magnitude, phase)).energy, expected)
    for magnitude, phase in ([[np.inf, 1, 1]], 0.0), ([[1, 1, 1]], np.nan), ([[1, 1, 1]], [[0, np.inf, 0]]):
        assert not short_solver.run((np.array(magnitude), np.array(phase))).finite.any()


def test_numbers_of_every_kind_are_accepted(short_solver):
    expected = short_solver.run([[1.0, 0.0, 1.0]]).energy
    for dtype in ("f2", "f4", "f8", "i1", "u8", "c8", "c16", "?"):
        np.testing.assert_array_equal(short_solver.run(np.array([[1, 0, 1]], dtype=dtype)).energy, expected)


def test_bad_times_and_points_are_refused(short_solver):
    for times in 5, ("a",), ((0.001, 0.002),), (np.inf,), (None,), (0.004, -0.001), (0.007,):
        assert refuse(short_solver, [[1, 1, 1]], times=times).startswith("times")
    for points in (
        (5,), ((0.1,),), ((0.1, 0.1, 0.1),), (("a", "b"),), ((np.nan, 0.1),), ((0.1, 0.1), (0.21, 0.1)), ((0.1, -0.01),)
    ):  # fmt: skip
        assert refuse(short_solver, [[1, 1, 1]], points=points).startswith("points")
