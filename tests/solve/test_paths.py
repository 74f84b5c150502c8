"""Every path of plain plates against the NumPy float64 reference: energies, displacements and traces.

Tolerances are relative to the largest number of the run. float64: both sides round a few times 1e-16 a step, which a
thousand steps of sums in another order make 1e-11 at most. float32: ε = 6e-8 per rounding, and a run of n steps near
the stability limit gathers √n to n of them in the fastest modes; 1e-4 holds for a few hundred steps.
"""

import itertools

import numpy as np
import pytest
from conftest import EDGE_MIXES, edges_id

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import patches, region_weights
from warp_plate.reference.numpy_plate import run_plate

TOLERANCE = {"float32": 1e-4, "float64": 1e-11}
DAMPING = ((None, "centred"), (88.5, "centred"), (88.5, "backward"))
MIXED = ("supported", "clamped", "clamped", "supported")
TIMES = (0.0, 0.004, 0.0071, 0.012)
# Order, nodes and sides [m] of small plates, each run with every mix of edges.
SMALL = {
    "square": (2, (13, 13), (0.2, 0.2)),
    "oblong": (2, (17, 9), (0.2, 0.16)),
    "fourth order": (4, (16, 11), (0.2, 0.16)),
}
# Each mix of edges with every damping, each plate with every mix of edges, in one precision: SIZES has the other.
CASES = [
    pytest.param(*plate, edges, *DAMPING[(mix + index) % 3], list(TOLERANCE)[index % 2], id=f"{name}-{edges_id(edges)}")
    for mix, edges in enumerate(EDGE_MIXES)
    for index, (name, plate) in enumerate(SMALL.items())
]
# The smallest plates of either order, no padding, a warp's full width, one column more, higher than a warp, walked row
# by row, and shared by a team of CPU threads.
SIZES = {
    "smallest": (2, (5, 5), (0.2, 0.2)),
    "smallest of fourth order": (4, (9, 9), (0.2, 0.2)),
    "no padding": (2, (16, 9), (0.2, 0.2)),
    "full warp": (4, (32, 11), (0.2, 0.0645161290322581)),
    "a column over": (2, (33, 6), (0.2, 0.1)),
    "high": (2, (7, 43), (0.05, 0.35)),
    "high of fourth order": (4, (9, 43), (0.05, 0.35)),
    "row by row": (2, (71, 63), (0.07, 0.062)),
    "row by row of fourth order": (4, (71, 63), (0.07, 0.062)),
    "team": (2, (97, 89), (0.096, 0.088)),
    "team of fourth order": (4, (97, 89), (0.096, 0.088)),
}


def reference(scene, drives):
    """Return energy and displacement history (plates, steps + 1, ny, nx) by :func:`run_plate`."""
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


def check_equal(run, scene, exact, points=()):
    """Compare all that a run returns with the reference."""
    scheme, tolerance = make_scheme(scene), TOLERANCE[scene.grid.precision]
    energy, history = exact
    np.testing.assert_allclose(run.energy, energy, rtol=tolerance)
    largest = np.abs(history).max()
    steps = np.rint(run.times / scheme.time_step).astype(int)
    np.testing.assert_allclose(run.displacement, history[:, steps], rtol=0, atol=tolerance * largest)
    for trace, (x, y) in zip(run.trace.swapaxes(0, 1), points, strict=True):
        expected = bilinear(history[:, 1:], x / scheme.spacing[0], y / scheme.spacing[1])
        np.testing.assert_allclose(trace, expected, rtol=0, atol=tolerance * largest)


def bilinear(history, i, j):
    """Interpolate the displacement at i nodes from the left and j from below."""
    column, row = (min(int(at), count - 2) for at, count in zip((i, j), history.shape[:1:-1], strict=True))
    i, j = i - column, j - row
    corner = history[..., row : row + 2, column : column + 2]
    return np.einsum("...yx,y,x->...", corner, [1 - j, j], [1 - i, i])


def random_areas(random, size, count=3):
    """Draw rectangles inside the plate, each large enough to cover an inner node of any grid here."""
    low = random.uniform(0.05, 0.5, (count, 2)) * size
    high = low + random.uniform(0.3, 0.45, (count, 2)) * size
    return [(x0, x1, y0, y1) for (x0, y0), (x1, y1) in zip(low.tolist(), high.tolist(), strict=True)]


@pytest.mark.parametrize(("order", "nodes", "size", "sides", "viscous", "scheme", "precision"), CASES)
def test_edges_and_dampings(
    device, path, order, nodes, size, sides, viscous, scheme, precision, scene, random, phasors
):
    """35 plates: on CPU some run in groups and some singly."""
    areas, load = random_areas(random, size), {2: "overlap", 4: "moments"}[order]
    made = scene(nodes, size, sides, viscous, scheme, precision, actuators=areas, order=order, load=load)
    drives = phasors(35, len(areas))
    check_equal(PlateSolver(made, device, path).run(drives, TIMES), made, reference(made, drives))


@pytest.mark.parametrize("name", SIZES)
def test_sizes(device, path, name, scene, fitting_solver, random, phasors):
    """With traces and without, which some paths leave to another one."""
    order, nodes, size = SIZES[name]
    count = 150 if max(nodes) < 50 else 50  # steps; on every grid as long as its stability limit allows
    index, load = list(SIZES).index(name), {2: "overlap", 4: "moments"}[order]
    areas, step = random_areas(random, size), 0.8 * make_scheme(scene(nodes, size, order=order)).limit
    times, points = (0.0, 30 * step, 0.8 * count * step), (random.uniform(0, 1, (3, 2)) * size).tolist()
    made = scene(
        nodes, size, MIXED, 88.5, "centred", list(TOLERANCE)[index % 2], (count / 3 * step, count * step),
        areas, load, step, 0.03 / step, order,
    )  # fmt: skip
    drives = phasors(3, len(areas))
    exact = reference(made, drives)
    solver = fitting_solver(made, device, path, threads=4 if "team" in name else None)
    check_equal(solver.run(drives, times), made, exact)
    check_equal(solver.run(drives, times, points), made, exact, points)


@pytest.mark.parametrize("order", [2, 4])
def test_runs_do_not_depend_on_earlier_runs(device, path, order, scene, phasors):
    """Bit for bit, after a run that left NaN in all that it wrote; with other plates, points and times in turn."""
    made = scene(damping=88.5, order=order)
    solver = PlateSolver(made, device, path)
    drives = phasors(35, len(made.actuators))
    first = solver.run(drives, (0.007,))
    spoiled = solver.run(np.full_like(drives, np.nan), (0.007,), ((0.11, 0.07),))
    assert np.isnan(spoiled.displacement).any(axis=(1, 2, 3)).all()
    second = solver.run(drives, (0.007,))
    np.testing.assert_array_equal(second.energy, first.energy)
    np.testing.assert_array_equal(second.displacement, first.displacement)
    exact = reference(made, drives)
    for plates, points in itertools.product((5, 2), ((), ((0.11, 0.07),), ((0.03, 0.17), (0.15, 0.02)))):
        run = solver.run(drives[:plates], (0.007,) if points else (), points)
        check_equal(run, made, [values[:plates] for values in exact], points)


@pytest.mark.parametrize(("nodes", "order"), [((27, 27), 2), ((513, 513), 2), ((105, 105), 4)])
def test_streaming_says_why(pairs, scene, nodes, order):
    """Plates stream on CUDA if they do not fit on the chip or are traced; on CPU all run resident."""
    assert {("cpu", "resident"), ("cpu", "streaming")} <= set(pairs)
    for device in {device for device, _ in pairs}:
        solver = PlateSolver(scene(nodes, order=order, window=(0.0, 1 / 290), precision="float32"), device)
        large = device.startswith("cuda") and max(nodes) > 27
        assert solver.path == ("streaming" if large else "resident")
        assert ("do not fit on one multiprocessor" in solver.describe_path()) == large
        assert ("streaming (" in solver.describe_path(traced=True)) == device.startswith("cuda")
