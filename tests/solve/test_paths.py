"""Every path of plain plates against the NumPy float64 reference: energies, displacements and traces."""

import numpy as np
import pytest

from support.oracle import TOLERANCE, check_run, random_area, reference
from support.scenes import EDGE_MIXES, edges_id
from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme

DAMPING = ((None, "centred"), (88.5, "centred"), (88.5, "backward"))
LOAD = {2: "overlap", 4: "moments"}
# Order, nodes and precision of small plates, of which two are run with every mix of edges; SIZES has the other
# precisions.
SMALL = {
    "square": (2, (13, 13), "float64"),
    "fourth order": (4, (16, 13), "float64"),
    "oblong": (2, (16, 13), "float32"),
}
CASES = [
    pytest.param(*plate, edges, *DAMPING[(mix + index) % 3], id=f"{name}-{edges_id(edges)}")
    for mix, edges in enumerate(EDGE_MIXES)
    for index, (name, plate) in enumerate(SMALL.items())
    if (mix + 2 * index) % 3 != 2
]
# The smallest plates of either order, a warp's full width, one column more, higher than a warp, and walked row by row,
# by a team of CPU threads or by one.
SIZES = {
    "smallest": (2, (5, 5), (0.2, 0.2)),
    "smallest of fourth order": (4, (9, 9), (0.2, 0.2)),
    "full warp": (4, (32, 11), (0.2, 0.0645161290322581)),
    "a column over": (2, (33, 9), (0.2, 0.1)),
    "high": (2, (7, 43), (0.05, 0.35)),
    "large of fourth order": (4, (97, 89), (0.096, 0.088)),
    "large": (2, (97, 89), (0.096, 0.088)),
    "rates off the registers": (2, (105, 97), (0.104, 0.096)),
}


@pytest.mark.parametrize(("order", "nodes", "precision", "sides", "viscous", "scheme"), CASES)
def test_edges_and_dampings(device, path, order, nodes, precision, sides, viscous, scheme, scene, random, phasors):
    """35 plates: on CPU some run in groups and some singly."""
    areas = [random_area(random, np.array([0.2, 0.2]), 0.3) for _ in range(3)]
    made = scene(nodes, (0.2, 0.2), sides, viscous, scheme, precision, actuators=areas, order=order, load=LOAD[order])
    drives = phasors(35, 3)
    run = PlateSolver(made, device, path).run(drives, (0.0, 0.004, 0.0071, 0.012))
    check_run(run, made, reference(made, drives))


@pytest.mark.parametrize("name", SIZES)
def test_sizes(device, path, name, scene, fitting_solver, random, phasors):
    """Paths run with traces and without; some leave traces to another path."""
    order, nodes, size = SIZES[name]
    count = 150 if max(nodes) < 50 else 50  # steps; on every grid as long as its stability limit allows
    precision = tuple(TOLERANCE)[list(SIZES).index(name) % 2]
    areas = [random_area(random, np.array(size), 0.35) for _ in range(3)]
    step = 0.8 * make_scheme(scene(nodes, size, order=order)).limit
    times, points = (0.0, 30 * step, 0.8 * count * step), (random.uniform(0, 1, (3, 2)) * size).tolist()
    made = scene(
        nodes, size, EDGE_MIXES[1], 88.5, "centred", precision, (count / 3 * step, count * step),
        areas, LOAD[order], step, 0.03 / step, order,
    )  # fmt: skip
    drives = phasors(3, 3)
    exact = reference(made, drives)
    check_run(fitting_solver(made, device, path, threads=4).run(drives, times), made, exact)
    check_run(fitting_solver(made, device, path, threads=1).run(drives, times, points), made, exact, points)


@pytest.mark.parametrize(("nodes", "order"), [((13, 13), 2), ((513, 513), 2), ((161, 161), 4)])
def test_streaming_says_why(pairs, scene, nodes, order):
    """Plates stream on CUDA if they do not fit on the chip or are traced; on CPU all run resident."""
    assert {("cpu", "resident"), ("cpu", "streaming")} <= set(pairs)
    for device in {device for device, _ in pairs}:
        solver = PlateSolver(scene(nodes, order=order, window=(0.0, 1 / 290)), device)
        large = device.startswith("cuda") and max(nodes) > 13
        assert solver.path == ("streaming" if large else "resident")
        assert ("do not fit on one multiprocessor" in solver.describe_path()) == large
        assert ("streaming (" in solver.describe_path(traced=True)) == device.startswith("cuda")
