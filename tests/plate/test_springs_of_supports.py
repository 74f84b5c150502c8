"""Supports on the grid: frequencies against modes, steps against the NumPy plate, the stability limit."""

import numpy as np
import pytest

from support.grid_modes import natural_modes
from support.oracle import FOUR_EDGES, check_run, reference, run_on_a_block
from support.scenes import scene_of
from support.scenes_of_outlines import outlined
from warp_plate import PlateSolver
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.scheme import make_scheme

DISC = {"disc": (0.1, 0.1, 0.1)}
FREE = ("free",) * 4
POINTS = [{"point": point} for point in ((0.0, 0.0), (0.17, 0.04), (0.0, 0.13), (0.144, 0.17))]
SLANTED = {"line": ((0.03, 0.0), (0.151, 0.2))}


def plate(nodes=53, edges=FREE, **tables):
    return scene_of(nodes=(nodes, nodes), edges=edges, **tables)


def disc(nodes=53, edge="free", **tables):
    return outlined(DISC, edge, nodes=(nodes, nodes), **tables)


# Scenes on a grid of so many nodes a side, and the largest errors in % of the first frequency and of the first nine.
CASES = {
    "points": (lambda nodes: plate(nodes, supports=POINTS), 0.3, 0.5),
    "a line": (lambda nodes: plate(nodes, ("supported",) * 4, supports=[SLANTED]), 0.2, 0.6),
    "a line that ends on the plate": (
        lambda nodes: plate(nodes, ("clamped",) * 4, supports=[{"line": ((0.03, 0.05), (0.151, 0.12))}]),
        0.5,
        1.2,
    ),
    "springs": (
        lambda nodes: plate(nodes, supports=[SLANTED | {"stiffness": 2e3}, {"point": (0.04, 0.15), "stiffness": 200}]),
        0.1,
        0.4,
    ),
    "points at the rim of a disc": (
        lambda nodes: disc(nodes, supports=[{"point": (0.197, 0.12)}, {"point": (0.05, 0.185)}, POINTS[1]]),
        0.4,
        0.8,
    ),
    "a ring in a disc": (lambda nodes: disc(nodes, "clamped", supports=[{"ring": (0.1, 0.1, 0.05)}]), 0.5, 1.8),
    "an elastic ring in a disc": (
        lambda nodes: disc(nodes, "supported", supports=[{"ring": (0.1, 0.1, 0.05), "stiffness": 500}]),
        0.3,
        0.6,
    ),
}


def errors_of(case, nodes):
    """Return the errors of the first nine frequencies [%], rigid motions left out."""
    scene = CASES[case][0](nodes)
    found = natural_modes(scene, 12).frequencies
    exact = solve_modes(scene.with_tables(grid={}), 0.0, 12).frequencies[:12]
    moves = exact > 1e-3 * exact[-1]
    return 100 * (found[-np.count_nonzero(moves) :][:9] / exact[moves][:9] - 1)


@pytest.mark.parametrize("case", [case for case in CASES if case not in ("points", "a line", "a ring in a disc")])
def test_frequencies_are_those_of_modes(case):
    errors = np.abs(errors_of(case, 53))
    assert errors[0] < CASES[case][1]
    assert errors.max() < CASES[case][2]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_errors_on_105_nodes(case):
    errors = np.abs(errors_of(case, 105))
    assert errors[0] < 0.2
    assert errors.max() < 0.5


EFFECTS = {
    "damping": {"viscous": 60.0},
    "tension": {"x": 5.0, "y": 2.0},
    "oscillators": [{"area": (0.0, 0.07, 0.0, 0.16), "mass": 0.003, "stiffness": 300.0, "damping": 0.1}],
}
SUPPORTS = [POINTS[1], {"line": ((0.03, 0.07), (0.12, 0.12))}, {"ring": (0.12, 0.1, 0.05), "stiffness": 1e4}]
STEPPED = {
    "a rectangle": lambda: plate(13, FOUR_EDGES, supports=SUPPORTS, effects=EFFECTS),
    "a rectangle that stretches": lambda: plate(13, supports=SUPPORTS, effects={"stretching": {}}),
    "a disc": lambda: disc(13, supports=[*SUPPORTS, {"point": (0.195, 0.1)}], effects={"damping": EFFECTS["damping"]}),
}


@pytest.mark.parametrize(
    ("case", "block"),
    [
        *((case, False) for case in STEPPED),
        ("a disc", True),
        pytest.param("a rectangle that stretches", True, marks=pytest.mark.slow),
    ],
)
def test_steps_are_those_of_the_numpy_plate(case, block, monkeypatch):
    """On a CPU, and by the kernel of CUDA with a block of one thread."""
    scene = STEPPED[case]()
    if block:
        run_on_a_block(monkeypatch)
    drives = np.array([[1, 0.3j, 0], [0.5j, 1, 2]])[:, : len(scene.actuators)]
    run = PlateSolver(scene, "cpu").run(drives, (0.001,))
    check_run(run, scene, reference(scene, drives))


@pytest.mark.parametrize(("make", "edge"), [(plate, ("supported",) * 4), (disc, "free")])
@pytest.mark.parametrize("stiffness", [{}, {"stiffness": 1e9}])
def test_supports_do_not_shorten_the_time_step(make, edge, stiffness):
    """Undamped, after a short burst, 5000 steps at the limit stay bounded."""
    supports = [support | stiffness for support in (*SUPPORTS[:2], {"ring": (0.12, 0.1, 0.05)})]
    plain, scene = make(21, edge), make(21, edge, supports=supports)
    limit = make_scheme(scene).limit
    assert limit > 0.98 * make_scheme(plain).limit
    rung = scene.with_tables(
        grid={"nodes": (21, 21), "precision": "float64", "time_step": 0.999 * limit},
        drive={"frequency": 900.0, "burst": {"duration": 50 * limit, "ramp": 10 * limit}},
        window={"start": 100 * limit, "end": 5000 * limit},
    )
    run = PlateSolver(rung, "cpu").run(np.ones((1, len(rung.actuators))), (200 * limit, 4900 * limit))
    early, late = np.abs(run.displacement[0]).max(axis=(1, 2))
    assert 0 < late < 10 * early
