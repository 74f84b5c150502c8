"""The scheme's numbers: stability limits, windows, time steps left out, weights of loads and regions."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse.linalg

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.stability_limit import time_step_limit
from warp_plate.plate.weights import REGIONS, patches, region_weights
from warp_plate.reference.numpy_plate import biharmonic, with_ghosts

PLATES = {"square": ((13, 13), (0.2, 0.2)), "oblong": ((17, 9), (0.2, 0.16)), "long": ((21, 5), (0.5, 0.02))}


def operator_of_reference(nodes, size, edges):
    """The matrix of ∇⁴ on the inner nodes, by unit vectors through the NumPy reference."""
    columns, rows = nodes[0] - 2, nodes[1] - 2
    fields = np.zeros((columns * rows, nodes[1], nodes[0]))
    fields[:, 1:-1, 1:-1] = np.eye(columns * rows).reshape(-1, rows, columns)
    spacing = tuple(length / (count - 1) for length, count in zip(size, nodes, strict=True))
    return biharmonic(with_ghosts(fields, edges), spacing).reshape(columns * rows, -1).T


@pytest.mark.parametrize("plate", PLATES)
def test_no_eigenvalue_passes_the_limit(edges, plate):
    """κ²λΔt² ≤ 4 for every eigenvalue λ of the discrete ∇⁴, at the limit that the formula gives; and it is
    not lax."""
    nodes, size = PLATES[plate]
    matrix = operator_of_reference(nodes, size, edges)
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-9 * np.abs(matrix).max())
    largest = np.linalg.eigvalsh(matrix)[-1]
    spacing = tuple(length / (count - 1) for length, count in zip(size, nodes, strict=True))
    kappa = 0.153
    reached = kappa**2 * largest * time_step_limit(kappa, spacing) ** 2
    assert reached <= 4 * (1 + 1e-12)
    # A supported side of n nodes reaches cos²(π/2(n − 1)) of the formula's part, a clamped one at least as
    # much.
    ends = [
        math.cos(math.pi / (2 * (count - 1))) ** 2 / step**2
        for count, step in zip(nodes, spacing, strict=True)
    ]
    assert reached >= 4 * (sum(ends) / sum(1 / step**2 for step in spacing)) ** 2 * (1 - 1e-12)


@pytest.mark.parametrize("plate", ["square", "oblong"])
def test_limit_against_power_iteration_on_the_kernel(edges, plate, point_scene, discrete_operator):
    """The same for the operator as the default path computes it."""
    nodes, size = PLATES[plate]
    made = point_scene(nodes, size, edges)
    scheme = make_scheme(made)
    matrix = discrete_operator(made)
    largest = scipy.sparse.linalg.eigsh(matrix, k=1, which="LA", return_eigenvectors=False)[0]
    # The matrix is measured to 1e-11 of its largest entry.
    assert scheme.kappa**2 * largest * scheme.limit**2 <= 4 * (1 + 1e-9)


def test_limit_on_square_cells_is_a_quarter():
    """κΔt/h² ≤ 1/4, DESIGN's rule for square cells."""
    kappa, h = 0.153, 0.2 / 26
    assert kappa * time_step_limit(kappa, (h, h)) / h**2 == pytest.approx(0.25, rel=1e-14)


@pytest.mark.parametrize("loss", [0.0, 1.0, 177.0, 2e4, 1e9])
def test_limit_of_backward_damping(loss):
    """z² − (2 − a − λ)z + 1 − a = 0 for a mode with λ = κ²ΛΔt² and a = cΔt/ρH: no root leaves the unit circle
    up to the limit, one does beyond it."""
    kappa, spacing = 0.153, (0.008, 0.005)
    limit = time_step_limit(kappa, spacing, loss)
    largest = kappa**2 * (4 / spacing[0] ** 2 + 4 / spacing[1] ** 2) ** 2

    def fastest(time_step, eigenvalue):
        a, reach = loss * time_step, eigenvalue * time_step**2
        return np.abs(np.roots([1, -(2 - a - reach), 1 - a])).max()

    # Double roots, as at λ = 0 without damping, are found to √ε.
    assert max(fastest(limit * (1 - 1e-6), largest * share) for share in np.linspace(0, 1, 101)) <= 1 + 1e-7
    assert fastest(limit * 1.001, largest) > 1 + 1e-4


@pytest.mark.parametrize("damping", ["undamped", "centred", "backward"])
@pytest.mark.parametrize("precision", [pytest.param("float32", marks=pytest.mark.slow), "float64"])
def test_just_below_the_limit_stays_bounded(device, path, damping, precision, scene, phasors):
    """20000 steps at 0.999 of the limit, undamped or nearly so.

    A mode with κ²ΛΔt² = 4 sin²(θ/2) under a force f a step reaches at most f·n/sin θ after n steps; here θ
    goes from 0.034 (the lowest mode of a supported plate) to π − 0.089, so n/sin θ ≤ 6e5. A mode that grows
    would reach e^(0.1·n). The force on a mode is at most the load's norm, √(inner nodes) times its largest
    value.
    """
    kinds = {"undamped": (None, "centred"), "centred": (20.0, "centred"), "backward": (20.0, "backward")}
    for edges in (("clamped",) * 4, ("supported",) * 4, ("supported", "clamped", "clamped", "supported")):
        limit = make_scheme(scene(edges=edges, damping=kinds[damping][0], scheme=kinds[damping][1])).limit
        step = 0.999 * limit
        made = scene(
            (13, 13), (0.2, 0.2), edges, *kinds[damping], precision, (0.0, 20000 * step), time_step=step,
            frequency=0.37 / step,
        )  # fmt: skip
        drives = phasors(2, 3)
        run = PlateSolver(made, device, path).run(drives, (10000 * step, 20000 * step))
        scheme = make_scheme(made)
        assert scheme.steps == 20000
        assert run.finite.all()
        force = scheme.load_scale * math.sqrt(11 * 11) * np.abs(drives).sum(axis=1).max()
        assert np.abs(run.displacement).max() < 6e5 * force


def test_above_the_limit_grows(device, path, scene, phasors):
    """The limit is no more careful than it must be: a supported plate at 1.01 of it is lost within 2000
    steps."""
    edges = ("supported",) * 4
    step = 1.01 * make_scheme(scene((27, 27), edges=edges)).limit
    wanted = {"edges": edges, "precision": "float64", "window": (0.0, 2000 * step), "time_step": step}
    with pytest.raises(SceneError, match="stability limit"):
        make_scheme(scene((27, 27), **wanted))
    drives = phasors(3, 3)
    drives[1] = 0
    solver = PlateSolver(scene((27, 27), **wanted), device, path, allow_unstable=True)
    run = solver.run(drives, (200 * step, 300 * step, 2000 * step))
    # The fastest mode has λ = 4.08, and grows by 2 arcosh(√λ/2) = 0.28 a step or less.
    early, late = np.abs(run.displacement[[0, 2], :2]).max(axis=(2, 3)).T
    assert np.all(late > 1e3 * early)
    assert list(run.status) == ["grew without bound", "ok", "grew without bound"]
    assert np.all(run.growth_time[[0, 2]] < 300 * step)
    assert list(run.finite) == [False, True, False]
    # A plate that grows does not touch its neighbours, and all stop when none is left.
    assert not run.displacement[1].any()
    alone = solver.run(drives[[0, 2]], (2000 * step,))
    np.testing.assert_array_equal(alone.growth_time, run.growth_time[[0, 2]])
    assert np.isnan(alone.displacement).all()


def test_unstable_time_step_is_refused_with_the_limit(scene):
    limit = make_scheme(scene()).limit
    assert make_scheme(scene(time_step=limit)).time_step == limit
    with pytest.raises(SceneError, match=r"^grid\.time_step = .*stability limit of") as caught:
        make_scheme(scene(time_step=1.0001 * limit))
    assert "\n" not in str(caught.value)
    assert f"{limit:.6g}" in str(caught.value)


@pytest.mark.parametrize("scheme", ["centred", "backward"])
def test_damping_and_the_limit(scene, scheme):
    """Centred damping leaves the limit alone, backward damping lowers it."""
    free = make_scheme(scene()).limit
    damped = make_scheme(scene(damping=88.5, scheme=scheme)).limit
    assert damped == free if scheme == "centred" else damped < free


def test_time_step_left_out(scene):
    """A whole number of steps to the end of the window, as few as 0.9 of the limit and 20 steps a period allow."""
    for nodes in ((13, 13), (17, 9), (27, 27)):
        made = make_scheme(scene(nodes))
        count = 0.012 / made.time_step
        assert count == pytest.approx(round(count), rel=1e-12)
        assert made.steps == round(count)
        longest = min(0.9 * made.limit, 2 * np.pi / made.angular_frequency / 20)
        assert made.time_step <= longest * (1 + 1e-12)
        assert 0.012 / (round(count) - 1) > longest


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ("0.05", "0.1"),
        ("0", "0.1"),
        ("0.00004", "0.1"),
        ("0.04996", "0.10004"),
        ("0.05001", "0.0501"),
        ("0.1", "0.10013"),
    ],
)
def test_window_counts_the_half_steps_inside(start, end, scene):
    """start < (n + ½)Δt < end by exact fractions, Δt = 8e-5 s; a half-step on an end is outside."""
    step = Fraction("8e-5")
    inside = [n for n in range(2000) if Fraction(start) < (n + Fraction(1, 2)) * step < Fraction(end)]
    made = make_scheme(scene(time_step=8e-5, window=(float(start), float(end))))
    assert made.window == (inside[0], inside[-1] + 1)
    assert made.steps == inside[-1] + 1


def test_window_without_a_half_step_is_refused(scene):
    with pytest.raises(SceneError, match=r"^window\.end = .*half-step"):
        make_scheme(scene(time_step=8e-5, window=(0.00405, 0.00411)))


def test_paper_scheme():
    """Equation (6)'s numbers of the source paper: 27 × 27 nodes, Δt = 8e-5 s, window from 0.05 to 0.1 s."""
    made = make_scheme(Scene.load("paper"))
    assert made.rigidity == pytest.approx(1e9 * 5e-4**3 / (12 * (1 - 0.33**2)), rel=1e-14)
    assert made.surface_density == 0.5
    assert made.spacing == pytest.approx((0.2 / 26, 0.2 / 26), rel=1e-14)
    assert (made.steps, made.window) == (1250, (625, 1250))
    assert made.square_cells


@pytest.mark.parametrize("nodes", [(13, 13), (17, 9), (8, 31)])
def test_overlap_weights_sum_to_the_area(nodes, scene, random):
    """Σ weights · hx·hy is the area of a region, and of a patch that no held node has a part of."""
    size = (0.2, 0.16)
    cell = size[0] * size[1] / ((nodes[0] - 1) * (nodes[1] - 1))
    for _ in range(20):
        x0, y0 = random.uniform(0.15, 0.5, 2) * size
        x1, y1 = (x0, y0) + random.uniform(0.01, 0.3, 2) * size
        made = scene(nodes, size, actuators=[(x0, x1, y0, y1)], target={"area": (x0, x1, y0, y1)})
        area = (x1 - x0) * (y1 - y0)
        weights = region_weights(made)
        assert weights[REGIONS.index("target")].sum() * cell == pytest.approx(area, rel=1e-12)
        assert weights[REGIONS.index("plate")].sum() * cell == pytest.approx(size[0] * size[1], rel=1e-12)
        assert patches(made)[0].sum() * cell == pytest.approx(area, rel=1e-12)


def test_overlap_is_the_covered_part_of_each_cell(scene):
    """By hand: from 2.25 to 4.75 spacings a patch covers ¼ of the cells of nodes 2 and 5 and all of 3's and
    4's; from 5 to 6 it covers half of the cells of nodes 5 and 6."""
    h = 0.2 / 12
    made = scene(actuators=[(2.25 * h, 4.75 * h, 5 * h, 6 * h)])
    field = patches(made)[0]
    np.testing.assert_allclose(field[5, 1:7], [0, 0.125, 0.5, 0.5, 0.125, 0], atol=1e-12)
    np.testing.assert_allclose(field[6], field[5], atol=1e-12)
    assert np.count_nonzero(field > 1e-9) == 8


def test_a_quadrant_takes_half_of_the_mid_line():
    weights = region_weights(Scene.load("paper"))[REGIONS.index("target")]
    assert weights[13, 13] == pytest.approx(0.25, rel=1e-12)
    assert weights[5, 13] == weights[13, 5] == pytest.approx(0.5, rel=1e-12)
    assert (weights[5, 5], weights[0, 5], weights[0, 0], weights[5, 14]) == pytest.approx(
        (1, 0.5, 0.25, 0), rel=1e-12
    )


def test_node_masks_of_the_paper():
    """The four actuators of the paper press on 2 × 2 nodes each: 4, 5 and 21, 22 from the edges' own node
    0."""
    fields = patches(Scene.load("paper"))
    low, high = [4, 5], [21, 22]
    for field, rows, columns in zip(fields, (low, high, low, high), (low, low, high, high), strict=True):
        expected = np.zeros((27, 27))
        expected[np.ix_(rows, columns)] = 1
        np.testing.assert_array_equal(field, expected)


def test_nodes_on_a_patch_s_rim_belong_to_it(scene):
    """Rounding does not decide: sides written as decimals lie on the nodes that they name."""
    for cells in (10, 16, 20, 25, 40, 50):
        for low, high in ((1, 3), (3, 6), (3, 7), (6, 9)):
            x0, x1 = (round(index * 0.3 / cells, 10) for index in (low, high))
            made = scene((cells + 1, cells + 1), (0.3, 0.3), load="nodes", actuators=[(x0, x1, x0, x1)])
            expected = np.zeros((cells + 1, cells + 1))
            expected[low : high + 1, low : high + 1] = 1
            np.testing.assert_array_equal(patches(made)[0], expected)


@pytest.mark.parametrize("load", ["nodes", "overlap"])
def test_held_nodes_take_no_load(load, scene):
    field = patches(scene(load=load, actuators=[(0.0, 0.2, 0.0, 0.2)]))[0]
    expected = np.zeros((13, 13))
    expected[1:-1, 1:-1] = 1
    np.testing.assert_allclose(field, expected, atol=1e-12)


def test_actuator_that_covers_no_node_is_refused(scene):
    """Between two nodes with node masks; within half a spacing of a held edge with overlap."""
    for load, area in (("nodes", (0.05, 0.06, 0.051, 0.06)), ("overlap", (0.0, 0.008, 0.0, 0.2))):
        made = scene(load=load, actuators=[(0.1, 0.15, 0.1, 0.15), area])
        with pytest.raises(SceneError, match=r"^actuators\[1\]\.area = .*covers no node") as caught:
            PlateSolver(made, "cpu")
        assert "\n" not in str(caught.value)
