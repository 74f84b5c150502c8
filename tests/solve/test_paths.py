"""Every path against the plain NumPy float64 reference: energies, displacements and traces.

Tolerances are relative to the largest number of the run. float64: both sides round a few times 1e-16 a step,
which a thousand steps of sums in another order make 1e-11 at most. float32: ε = 6e-8 a rounding, and a run of
n steps near the stability limit gathers some √n to n of them in the fastest modes; 1e-4 is kept for a few
hundred steps.
"""

import dataclasses
import itertools

import numpy as np
import pytest
import warp as wp

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import patches, region_weights
from warp_plate.reference.numpy_plate import run_plate

TOLERANCE = {"float32": 1e-4, "float64": 1e-11}
DAMPING = {"undamped": (None, "centred"), "centred": (88.5, "centred"), "backward": (88.5, "backward")}
MIXED = ("supported", "clamped", "clamped", "supported")
# (nodes, sides): odd, even, the smallest, more columns than a warp has lanes, rows without padding, long and
# high.
GRIDS = {
    "smallest": ((5, 5), (0.2, 0.2)),
    "even": ((12, 12), (0.2, 0.2)),
    "no padding, oblong cells": ((16, 9), (0.2, 0.2)),
    "two whole lines": ((32, 7), (0.2, 0.0387096774193548)),
    "a column over": ((33, 6), (0.2, 0.1)),
    "wide": ((41, 8), (0.2, 0.05)),
    "high": ((7, 43), (0.05, 0.35)),
    "row by row": ((71, 63), (0.07, 0.062)),
    "threads share a plate": ((97, 89), (0.096, 0.088)),
}
# Those that fourth order can take, and in place of the others the like with nine rows or columns.
GRIDS_OF_FOURTH_ORDER = {
    **{name: grid for name, grid in GRIDS.items() if min(grid[0]) >= 9},
    "smallest": ((9, 9), (0.2, 0.2)),
    "two whole lines": ((32, 11), (0.2, 0.0645161290322581)),
    "a column over": ((33, 10), (0.2, 0.1)),
    "wide": ((41, 9), (0.2, 0.05)),
    "high": ((9, 43), (0.05, 0.35)),
}
SIZES = [(2, *grid) for grid in GRIDS.items()] + [(4, *grid) for grid in GRIDS_OF_FOURTH_ORDER.items()]
LARGE = dict.fromkeys(("row by row", "threads share a plate"), pytest.mark.slow)
TIMES = (0.0, 0.004, 0.0071, 0.012)
# What stays from run to run.
NOT_WRITTEN = ("loads", "in_phase", "quadrature", "wave", "shared_wave")


def reference(scene, drives):
    """(energy, displacement history (plates, steps + 1, ny, nx)) by :func:`run_plate`."""
    scheme, edges, damping = make_scheme(scene), scene.edges, scene.effects.damping
    history, squared_velocity = run_plate(
        scheme,
        (edges.left, edges.bottom, edges.right, edges.top),
        damping.viscous if damping else 0.0,
        damping is not None and damping.scheme == "backward",
        patches(scene),
        drives,
    )
    cells = scheme.spacing[0] * scheme.spacing[1] * region_weights(scene)
    energy = 0.5 * scheme.surface_density * np.einsum("ryx,pyx->pr", cells, squared_velocity)
    return energy, history


def check_equal(run, scene, drives, points=()):
    """All that a run returns, against the reference."""
    scheme, tolerance = make_scheme(scene), TOLERANCE[scene.grid.precision]
    energy, history = reference(scene, drives)
    np.testing.assert_allclose(run.energy, energy, rtol=tolerance)
    largest = np.abs(history).max()
    steps = np.rint(run.times / scheme.time_step).astype(int)
    np.testing.assert_allclose(run.displacement, history[:, steps], rtol=0, atol=tolerance * largest)
    for trace, (x, y) in zip(run.trace.swapaxes(0, 1), points, strict=True):
        expected = bilinear(history[:, 1:], x / scheme.spacing[0], y / scheme.spacing[1])
        np.testing.assert_allclose(trace, expected, rtol=0, atol=tolerance * largest)


def bilinear(history, i, j):
    """The displacement at i nodes from the left and j from below."""
    column, row = (min(int(at), count - 2) for at, count in zip((i, j), history.shape[:1:-1], strict=True))
    i, j = i - column, j - row
    corner = history[..., row : row + 2, column : column + 2]
    return np.einsum("...yx,y,x->...", corner, [1 - j, j], [1 - i, i])


def random_areas(random, size, count=3):
    """Rectangles inside the plate; each is wide enough to cover a node that can move, on any grid here."""
    low = random.uniform(0.05, 0.5, (count, 2)) * size
    high = low + random.uniform(0.3, 0.45, (count, 2)) * size
    return [(x0, x1, y0, y1) for (x0, y0), (x1, y1) in zip(low.tolist(), high.tolist(), strict=True)]


@pytest.mark.parametrize("precision", TOLERANCE)
@pytest.mark.parametrize("damping", DAMPING)
@pytest.mark.parametrize("nodes", [(13, 13), (17, 9)], ids=["square", "oblong"])
def test_all_edges_and_dampings(device, path, edges, damping, nodes, precision, scene, random, phasors):
    viscous, scheme = DAMPING[damping]
    size = (0.2, 0.2) if nodes == (13, 13) else (0.2, 0.16)
    areas = random_areas(random, size)
    made = scene(nodes, size, edges, viscous, scheme, precision, actuators=areas)
    drives = phasors(2, len(areas))
    check_equal(PlateSolver(made, device, path).run(drives, TIMES), made, drives)


@pytest.mark.parametrize("precision", TOLERANCE)
@pytest.mark.parametrize("damping", DAMPING)
def test_all_edges_and_dampings_of_fourth_order(
    device, path, edges, damping, precision, scene, random, phasors
):
    """Oblong cells, loads by moments, and enough plates for every way to run many at once."""
    size = (0.2, 0.16)
    areas = random_areas(random, size)
    made = scene((16, 11), size, edges, *DAMPING[damping], precision, actuators=areas, order=4, load="moments")
    drives = phasors(35, len(areas))
    check_equal(PlateSolver(made, device, path).run(drives, TIMES), made, drives)


@pytest.mark.parametrize("precision", TOLERANCE)
@pytest.mark.parametrize(
    ("order", "nodes", "size"),
    [pytest.param(order, *grid, id=f"{order}-{name}", marks=LARGE.get(name, ())) for order, name, grid in SIZES],
)
def test_all_sizes(device, path, order, nodes, size, precision, scene, fitting_solver, random, phasors):
    areas = random_areas(random, size)
    # As many steps on every grid, for the stability limit is far shorter on the fine ones.
    load = {2: "overlap", 4: "moments"}[order]
    step = 0.8 * make_scheme(scene(nodes, size, order=order)).limit
    times, points = (0.0, 40 * step, 120 * step), (random.uniform(0, 1, (3, 2)) * size).tolist()
    made = scene(
        nodes, size, MIXED, 88.5, "centred", precision, (50 * step, 200 * step), areas, load, step,
        frequency=0.03 / step, order=order,
    )  # fmt: skip
    drives = phasors(3, len(areas))
    solver = fitting_solver(made, device, path)
    # Without and with traces, which some paths leave to another one.
    check_equal(solver.run(drives, times), made, drives)
    check_equal(solver.run(drives, times, points), made, drives, points)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("nodes", [(13, 13), (71, 63)], ids=["small", "row by row"])
def test_numbers_left_in_memory_do_not_matter(device, path, nodes, order, scene, fitting_solver, phasors):
    """A run is the same, bit for bit, after all that it should write anew was filled with NaN."""
    size = (0.2, 0.2) if nodes == (13, 13) else (0.07, 0.062)
    step = 0.9 * make_scheme(scene(nodes, size, order=order)).limit
    made = scene(nodes, size, MIXED, 88.5, window=(20 * step, 90 * step), time_step=step, order=order)
    solver = fitting_solver(made, device, path)
    drives = phasors(4, len(made.actuators))
    first = solver.run(drives, (60 * step,))
    poisoned = poison(solver.states[0])
    assert {"u", "rate", "squares"} <= poisoned
    second = solver.run(drives, (60 * step,))
    np.testing.assert_array_equal(second.energy, first.energy)
    np.testing.assert_array_equal(second.displacement, first.displacement)


def poison(state):
    """Fill with NaN every array of numbers but the load fields, which hold zero where no actuator is, and the wave that
    all plates share."""
    poisoned = set()
    for field in dataclasses.fields(state):
        values = getattr(state, field.name)
        numbers = isinstance(values, wp.array) and values.dtype in (wp.float32, wp.float64)
        if numbers and field.name not in NOT_WRITTEN:
            values.fill_(float("nan"))
            poisoned.add(field.name)
    return poisoned


def test_every_path_is_tested(pairs):
    """The pairs of this machine hold at least both CPU paths, so that no refusal hides one."""
    assert {("cpu", "resident"), ("cpu", "streaming")} <= set(pairs)


@pytest.mark.parametrize("order", [2, 4])
def test_recording_on_the_same_solver(device, path, order, scene, phasors):
    """With and without traces by turns, with other points and numbers of plates: no run sees another's
    memory."""
    made = scene(damping=88.5, order=order)
    solver = PlateSolver(made, device, path)
    asked = itertools.product((5, 2), ((), ((0.11, 0.07),), ((0.03, 0.17), (0.15, 0.02))), ((), (0.007,)))
    for plates, points, times in asked:
        drives = phasors(plates, len(made.actuators))
        check_equal(solver.run(drives, times, points), made, drives, points)


@pytest.mark.parametrize(("nodes", "order"), [((27, 27), 2), ((513, 513), 2), ((105, 105), 4)])
def test_streaming_says_why(pairs, scene, nodes, order):
    """On CUDA what does not fit on the chip, and traces; on CPU all run resident."""
    for device in {device for device, _ in pairs}:
        step = 1 / 290
        solver = PlateSolver(scene(nodes, order=order, window=(0.0, step), precision="float32"), device)
        large = device.startswith("cuda") and max(nodes) > 27
        assert solver.path == ("streaming" if large else "resident")
        assert ("do not fit on one multiprocessor" in solver.describe_path()) == large
        assert ("streaming (" in solver.describe_path(traced=True)) == device.startswith("cuda")
