"""Plates with outlines on the grid: frequencies of discs, steps against the NumPy plate, areas, the stability limit."""

import math

import numpy as np
import pytest

from support.grid_modes import natural_modes
from support.oracle import check_run, reference, run_on_a_block
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.outline_grid import outline_grid
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import patches, region_weights

RADIUS = 0.05
# ω r² √(ρH/D) of discs, ν = 0.3, from their characteristic equations by Bessel functions; rigid motions are left out.
DISCS = {
    "clamped": (10.21583, 21.26040, 21.26040, 34.87704, 34.87704, 39.77115, 51.03002, 51.03002, 60.82867),
    "supported": (4.93515, 13.89823, 13.89823, 25.61329, 25.61329, 29.72000, 39.95731, 39.95731, 48.47888),
    "free": (5.35830, 5.35830, 9.00308, 12.43903, 12.43903, 20.47461, 20.47461, 21.83531, 21.83531),
}


MIDDLE = {"name": "middle", "area": (0.04, 0.06, 0.03, 0.07), "magnitude": 10.0}


def disc(edge, nodes=53, **tables):
    """Return a scene of an aluminium disc."""
    plate = {
        "outline": {"disc": (RADIUS, RADIUS, RADIUS)},
        "thickness": 1e-3,
        "young_modulus": 7e10,
        "poisson_ratio": 0.3,
        "density": 2700.0,
    }
    return Scene.from_tables(
        {
            "plate": plate | tables.pop("plate", {}),
            "edges": {"outline": edge},
            "grid": {"nodes": (nodes, nodes), **tables.pop("grid", {})},
            "window": {"start": 0.0005, "end": 0.002},
            "drive": {"frequency": 900.0},
            "target": {"area": (0.0, 0.05, 0.0, 0.1)},
            "actuators": [
                MIDDLE,
                {"name": "beyond the edge", "area": (0.0, 0.04, 0.06, 0.1), "magnitude": 5.0},
            ],
            "effects": {"damping": {"viscous": 50.0}} | tables.pop("effects", {}),
            **tables,
        }
    )


@pytest.mark.parametrize("edge", DISCS)
def test_discs_have_the_frequencies_of_bessel_functions(edge):
    made = disc(edge)
    scale = 2 * math.pi * RADIUS**2 * math.sqrt(2.7 / made.plate.rigidity)
    found = scale * natural_modes(made, 12).frequencies[3 if edge == "free" else 0 :][:9]
    np.testing.assert_allclose(found[0], DISCS[edge][0], rtol=4e-3)
    np.testing.assert_allclose(found, DISCS[edge], rtol=1.2e-2)


def test_errors_fall_as_the_grid_is_refined():
    """Between the first and the second power of the spacing; a staircase of nodes would be 80 % off on any grid."""
    errors = []
    for nodes in (27, 53):
        made = disc("supported", nodes)
        first = natural_modes(made, 1).frequencies[0]
        exact = DISCS["supported"][0] / (2 * math.pi * RADIUS**2 * math.sqrt(2.7 / made.plate.rigidity))
        errors.append(abs(first / exact - 1))
    assert errors[1] < 0.55 * errors[0] < 0.008


PARTS = [
    {"from": (0.1, 0.05), "to": (0.05, 0.1), "edge": "free"},
    {"from": (0.05, 0.1), "to": (0.0, 0.05), "edge": "supported"},
]
HOLE = {"holes": [{"disc": (0.04, 0.035, 0.012)}]}
LAYER = {"area": (0.03, 0.08, 0.03, 0.08), "thickness": 1e-4, "young_modulus": 2e9, "density": 1500.0}
CASES = {
    "clamped": ("clamped", {"effects": {"tension": {"x": 5.0, "y": 2.0}}}),
    "supported": (
        "supported",
        {"effects": {"foundation": {"stiffness": 1e4, "damping": 10.0}, "material_damping": {"time": 1e-6}}},
    ),
    "free": (
        "free",
        {
            "effects": {
                "layers": [LAYER],
                "oscillators": [{"area": (0.02, 0.07, 0.02, 0.1), "mass": 0.003, "stiffness": 300.0, "damping": 0.1}],
                "moving_load": {"force": 0.3, "start": (0.02, 0.05), "velocity": (20.0, 10.0), "size": 0.01},
            }
        },
    ),
    "of three kinds, with a hole": ("clamped", {"plate": HOLE, "parts": PARTS}),
}  # fmt: skip


def made_of(edge, tables, **grid):
    tables = dict(tables)
    parts = tables.pop("parts", ())
    made = disc(edge, 21, grid=grid, **tables)
    return made.with_tables(edges={"outline": edge, "parts": parts}) if parts else made


@pytest.mark.parametrize(
    ("case", "block"),
    [*((case, False) for case in CASES), ("clamped", True), pytest.param("free", True, marks=pytest.mark.slow)],
)
def test_steps_are_those_of_the_numpy_plate(case, block, monkeypatch):
    """On a CPU, and by the kernel of CUDA with a block of one thread."""
    made = made_of(*CASES[case], precision="float64")
    if block:
        run_on_a_block(monkeypatch)
    drives = np.array([[1, 0.3j], [0, 1]])
    run = PlateSolver(made, "cpu").run(drives, (0.001,))
    check_run(run, made, reference(made, drives))
    off_plate = ~outline_grid(made.outline, made.plate.size, made.grid.nodes).moves
    assert off_plate.any()
    assert not run.displacement[:, :, off_plate].any()


@pytest.mark.parametrize("case", CASES)
def test_the_outline_does_not_shorten_the_time_step(case):
    """Undamped, after a short burst, 5000 steps at the limit stay bounded but for the drift of a free plate."""
    edge, tables = CASES[case]
    made = made_of(edge, {name: table for name, table in tables.items() if name != "effects"}, precision="float64")
    limit = make_scheme(made.with_tables(effects={})).limit
    assert limit > 0.9 * 0.005**2 / (4 * make_scheme(made).kappa)
    rung = made.with_tables(
        effects={},
        grid={"nodes": (21, 21), "precision": "float64", "time_step": 0.999 * limit},
        drive={"frequency": 900.0, "burst": {"duration": 50 * limit, "ramp": 10 * limit}},
        window={"start": 100 * limit, "end": 5000 * limit},
    )
    run = PlateSolver(rung, "cpu").run(np.ones((1, 2)), (200 * limit, 4900 * limit))
    early, late = np.abs(run.displacement[0]).max(axis=(1, 2))
    assert 0 < late < 100 * early


def test_areas_add_up():
    """Each part of the plate counts once: its area, that of a target, and of an actuator that reaches beyond it."""
    made = disc("free", plate=HOLE)
    cell = (2 * RADIUS / 52) ** 2
    whole, target = region_weights(made).sum(axis=(1, 2)) * cell
    np.testing.assert_allclose(whole, math.pi * (RADIUS**2 - 0.012**2), rtol=2e-3)
    x = np.linspace(-RADIUS, 0, 20001)
    half = np.trapezoid(2 * np.sqrt(RADIUS**2 - x**2), x)
    cut = 0.012**2 * (math.pi / 2 + 1 / 1.2 * math.sqrt(1 - 1 / 1.2**2) + math.asin(1 / 1.2))
    np.testing.assert_allclose(target, half - cut, rtol=4e-3)
    loads = patches(made).sum(axis=(1, 2)) * cell
    assert loads[1] < 0.04 * 0.04
    outside = 0.04**2 - loads[1]
    points = np.stack(np.meshgrid(np.linspace(0, 0.04, 400), np.linspace(0.06, 0.1, 400)), axis=-1)
    np.testing.assert_allclose(outside, 0.04**2 * (1 - made.outline.contains(points).mean()), rtol=0.05)


# A square with a strip of 3 mm up one side, on a grid of 5 mm.
WITH_A_SPIKE = ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.097, 0.1), (0.097, 0.05), (0.0, 0.05))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"edges": {"outline": {"translation": 1e6}}}, "edges.outline: springs along an outline cannot be stepped"),
        ({"edges": {"outline": "free"}, "effects": {"tension": {"x": 1.0}}}, "in-plane forces next to a free edge"),
        ({"effects": {"material_damping": {"time": 1e-6}}}, "losses of the material next to a clamped edge"),
        (
            {"plate": {"outline": {"polygon": WITH_A_SPIKE}}, "edges": {"outline": "free"}, "actuators": [MIDDLE]},
            "grid.nodes: the plate is too narrow at x = 0.09",
        ),
        *[
            (
                {
                    "plate": {"outline": {"ellipse": (0.1, 0.1, 0.1, 0.001, 0.78)}, "thickness": 1e-4},
                    "edges": {"outline": edge},
                    "actuators": [{"name": "whole", "disc": (0.1, 0.1, 0.01), "force": 1.0}],
                },
                "grid.nodes = .*21, 21.: the plate is too narrow for these; use more",
            )
            for edge in ("clamped", "supported", "free")
        ],
    ],
)
def test_what_time_steps_do_not_know_is_refused_by_name(change, words):
    made = disc("clamped", 21)
    plate = made.plate.model_dump(exclude_none=True) | change.get("plate", {})
    made = made.with_tables(**change | {"plate": plate})
    with pytest.raises(SceneError, match=words):
        make_scheme(made)
