"""The scheme's numbers: stability in runs, windows, default time steps, weights of loads and regions."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import REGIONS, patches, region_weights

SUPPORTED = ("supported",) * 4


@pytest.mark.parametrize(
    ("damping", "held", "precision"),
    [
        ((None, "centred"), ("clamped",) * 4, "float64"),
        ((20.0, "centred"), SUPPORTED, "float32"),
        ((20.0, "backward"), ("supported", "clamped", "clamped", "supported"), "float64"),
    ],
    ids=["undamped", "centred", "backward"],
)
def test_just_below_the_limit_stays_bounded(device, path, damping, held, precision, scene, phasors):
    """6000 steps at 0.999 of the limit, undamped or nearly so.

    A mode with κ²ΛΔt² = 4 sin²(θ/2) under a force f a step reaches at most f·n/sin θ after n steps; here θ goes from
    0.034 (the lowest mode of a supported plate) to π − 0.089, so n/sin θ ≤ 2e5. A mode that grows would reach
    e^(0.1·n). The force on a mode is at most the load's norm, √(inner nodes) times its largest value.
    """
    step = 0.999 * make_scheme(scene(edges=held, damping=damping[0], scheme=damping[1])).limit
    made = scene(
        (13, 13), (0.2, 0.2), held, *damping, precision, (0.0, 6000 * step), time_step=step, frequency=0.37 / step
    )
    drives, scheme = phasors(2, 3), make_scheme(made)
    run = PlateSolver(made, device, path).run(drives, (3000 * step, 6000 * step))
    assert scheme.steps == 6000
    assert run.finite.all()
    force = scheme.load_scale * math.sqrt(11 * 11) * np.abs(drives).sum(axis=1).max()
    assert np.abs(run.displacement).max() < 2e5 * force


def test_above_the_limit_grows(device, path, scene, phasors):
    """A supported plate at 1.01 of the limit is lost within 2000 steps; its neighbours are not."""
    step = 1.01 * make_scheme(scene((27, 27), edges=SUPPORTED)).limit
    made = scene((27, 27), edges=SUPPORTED, precision="float64", window=(0.0, 2000 * step), time_step=step)
    with pytest.raises(SceneError, match="stability limit"):
        make_scheme(made)
    drives = phasors(3, 3)
    drives[1] = 0
    solver = PlateSolver(made, device, path, allow_unstable=True)
    run = solver.run(drives, (200 * step, 300 * step, 2000 * step))
    # The fastest mode has λ = 4.08, and grows by 2 arcosh(√λ/2) = 0.28 a step or less.
    early, late = np.abs(run.displacement[[0, 2], :2]).max(axis=(2, 3)).T
    assert np.all(late > 1e3 * early)
    assert list(run.status) == ["grew without bound", "ok", "grew without bound"]
    assert max(run.faults[plate][1] for plate in (0, 2)) < 300 * step
    assert run.fault(0).startswith("grew without bound by t = ")
    assert list(run.finite) == [False, True, False]
    assert not run.displacement[1].any()
    # All stop when none is left.
    alone = solver.run(drives[[0, 2]], (2000 * step,))
    assert list(alone.faults.values()) == [run.faults[plate] for plate in (0, 2)]
    assert np.isnan(alone.displacement).all()


def test_unstable_time_step_is_refused_with_the_limit(scene):
    limit = make_scheme(scene()).limit
    assert make_scheme(scene(time_step=limit)).time_step == limit
    with pytest.raises(SceneError, match=r"^grid\.time_step = .*stability limit of") as caught:
        make_scheme(scene(time_step=1.0001 * limit))
    assert f"{limit:.6g}" in str(caught.value)
    assert make_scheme(scene(damping=88.5)).limit == limit
    assert make_scheme(scene(damping=88.5, scheme="backward")).limit < limit


def test_default_time_step(scene):
    """A whole number of steps to the end of the window, as few as 0.9 of the limit and 20 steps a period allow."""
    for nodes in ((13, 13), (17, 9), (27, 27)):
        made = make_scheme(scene(nodes))
        assert made.steps * made.time_step == pytest.approx(0.012, rel=1e-12)
        longest = min(0.9 * made.limit, 2 * np.pi / made.angular_frequency / 20)
        assert made.time_step <= longest * (1 + 1e-12)
        assert 0.012 / (made.steps - 1) > longest


@pytest.mark.parametrize(
    ("start", "end"),
    [("0", "0.1"), ("0.00004", "0.1"), ("0.04996", "0.10004"), ("0.00405", "0.00411"), ("0.1", "0.10013")],
)
def test_window_counts_the_half_steps_inside(start, end, scene):
    """start < (n + ½)Δt < end by exact fractions, Δt = 8e-5 s; a half-step on an end is outside."""
    step = Fraction("8e-5")
    inside = [n for n in range(2000) if Fraction(start) < (n + Fraction(1, 2)) * step < Fraction(end)]
    window = (float(start), float(end))
    if not inside:
        with pytest.raises(SceneError, match=r"^window\.end = .*half-step"):
            make_scheme(scene(time_step=8e-5, window=window))
        return
    made = make_scheme(scene(time_step=8e-5, window=window))
    assert (made.window, made.steps) == ((inside[0], inside[-1] + 1), inside[-1] + 1)


def test_paper_scheme():
    """Equation (6)'s numbers of the source paper: 27 × 27 nodes, Δt = 8e-5 s, window from 0.05 to 0.1 s."""
    made = make_scheme(Scene.load("paper"))
    assert made.rigidity == pytest.approx(1e9 * 5e-4**3 / (12 * (1 - 0.33**2)), rel=1e-14)
    assert made.surface_density == 0.5
    assert made.spacing == pytest.approx((0.2 / 26, 0.2 / 26), rel=1e-14)
    assert (made.steps, made.window) == (1250, (625, 1250))
    assert made.square_cells


def test_overlap_is_the_covered_part_of_each_cell(scene):
    """From 2.25 to 4.75 spacings a patch covers ¼ of the cells of nodes 2 and 5 and all of 3's and 4's; from 5 to 6
    half of the cells of nodes 5 and 6. A quadrant covers half of the mid-line's cells."""
    h = 0.2 / 12
    field = patches(scene(actuators=[(2.25 * h, 4.75 * h, 5 * h, 6 * h)]))[0]
    np.testing.assert_allclose(field[5, 1:7], [0, 0.125, 0.5, 0.5, 0.125, 0], atol=1e-12)
    np.testing.assert_allclose(field[6], field[5], atol=1e-12)
    assert np.count_nonzero(field > 1e-9) == 8
    weights = region_weights(Scene.load("paper"))[REGIONS.index("target")]
    found = weights[[13, 5, 13, 5, 0, 0, 5], [13, 13, 5, 5, 5, 0, 14]]
    np.testing.assert_allclose(found, [0.25, 0.5, 0.5, 1, 0.5, 0.25, 0], atol=1e-12)


def test_node_masks(scene):
    """The paper's actuators load 2 × 2 nodes each; nodes on a patch's rim belong to it, whatever the rounding."""
    for field, (row, column) in zip(patches(Scene.load("paper")), ((4, 4), (21, 4), (4, 21), (21, 21)), strict=True):
        expected = np.zeros((27, 27))
        expected[row : row + 2, column : column + 2] = 1
        np.testing.assert_array_equal(field, expected)
    for cells, (first, last) in itertools.product((10, 16, 25, 50), ((1, 3), (3, 7), (6, 9))):
        x0, x1 = (round(index * 0.3 / cells, 10) for index in (first, last))
        made = scene((cells + 1, cells + 1), (0.3, 0.3), load="nodes", actuators=[(x0, x1, x0, x1)])
        expected = np.zeros((cells + 1, cells + 1))
        expected[first : last + 1, first : last + 1] = 1
        np.testing.assert_array_equal(patches(made)[0], expected)


@pytest.mark.parametrize("load", ["nodes", "overlap"])
def test_held_nodes_take_no_load(load, scene):
    field = patches(scene(load=load, actuators=[(0.0, 0.2, 0.0, 0.2)]))[0]
    np.testing.assert_allclose(field, np.pad(np.ones((11, 11)), 1), atol=1e-12)


def test_actuator_that_covers_no_node_is_refused(scene):
    """Between two nodes with node masks; within half a spacing of a held edge with overlap."""
    for load, area in (("nodes", (0.05, 0.06, 0.051, 0.06)), ("overlap", (0.0, 0.008, 0.0, 0.2))):
        with pytest.raises(SceneError, match=r"^actuators\[1\]\.area = .*covers no node"):
            PlateSolver(scene(load=load, actuators=[(0.1, 0.15, 0.1, 0.15), area]), "cpu")
