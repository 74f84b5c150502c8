"""The largest stable time step against eigenvalues of the whole step, computed densely, over many scenes.

K and C are built from the equations, by the scene's springs, dampers and moments; tests/solve/test_hard_cases.py shows
that the kernels hold to the same limit.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from support.grid_modes import natural_modes
from warp_plate import SceneError
from warp_plate.plate.bending import buckling_factor, make_bending, stiffness_matrix, system
from warp_plate.plate.operator import biharmonic
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.stability_limit import FORMULA_NODES, find_limit

SIZES = {
    "smallest": ((5, 5), (0.2, 0.2)),
    "square": ((13, 13), (0.2, 0.2)),
    "oblong": ((17, 9), (0.2, 0.16)),
    "long": ((21, 5), (0.5, 0.02)),
    "beam": ((7, 17), (0.008, 0.4)),
    "cells 1 : 10": ((9, 13), (0.2, 0.035)),
}
LAYER = {"thickness": 3e-4, "young_modulus": 3e9, "density": 1000.0}
SPRINGY = {"translation": 1e5, "rotation": 0.3}
RIGID = {"translation": 1e9, "rotation": 1e4}
EFFECTS = {
    "nothing": {},
    "backward damping": {"damping": {"viscous": 400.0, "scheme": "backward"}},
    "backward damping, huge": {"damping": {"viscous": 1e8, "scheme": "backward"}},
    "bed": {"foundation": {"stiffness": 1e6}},
    "stiff bed": {"foundation": {"stiffness": 1e12, "damping": 30.0}},
    "tension": {"tension": {"x": 500.0, "y": 20.0}, "damping": {"viscous": 4e3, "scheme": "backward"}},
    "material damping": {"material_damping": {"time": 1e-5}},
    "material damping under tension": {"material_damping": {"time": 1e-4}, "tension": {"x": 1e5, "y": 1e5}},
    "orthotropic": {"orthotropic": {"Dx": 0.05, "Dy": 0.004, "D1": 0.003, "Dxy": 0.002}},
    "negative D1": {"orthotropic": {"Dx": 0.02, "Dy": 0.018, "D1": -0.017, "Dxy": 0.002}},
    "light place": {"damping": {"viscous": 3e4, "scheme": "backward"}, "variation": {"density": [[0.1, 1.0]]}},
    "thickness 1 : 3": {"variation": {"thickness": [[1.0, 3.0, 1.0], [1.0, 1.0, 2.0]]}},
    "heavy corner": {"layers": [{"area": (0.0, 0.3, 0.0, 0.3), **LAYER, "density": 1e5}]},
    "heavy mass": {"oscillators": [{"area": (0.45, 0.7, 0.3, 0.6), "mass": 50.0, "stiffness": 1e5, "damping": 3.0}]},
    "light mass": {"oscillators": [{"area": (0.45, 0.7, 0.3, 0.6), "mass": 1e-6, "stiffness": 1e3}]},
    "dashpot": {"oscillators": [{"area": (0.1, 0.4, 0.3, 0.9), "damping": 20.0}]},
    "much": {
        "damping": {"viscous": 60.0, "scheme": "backward"},
        "material_damping": {"time": 3e-6},
        "tension": {"x": 2.0, "y": 30.0},
        "foundation": {"stiffness": 3e5, "damping": 20.0},
        "layers": [{"area": (0.1, 0.4, 0.2, 0.9), **LAYER}],
        "oscillators": [
            {"area": (0.5, 0.8, 0.1, 0.6), "mass": 1e-3, "stiffness": 2e3, "damping": 0.4},
            {"area": (0.1, 0.3, 0.1, 0.4), "stiffness": 500.0, "damping": 0.1},
        ],
    },
}  # fmt: skip
EDGES = {
    "clamped": ("clamped",) * 4,
    "supported": ("supported",) * 4,
    "free": ("free",) * 4,
    "springy": (SPRINGY,) * 4,
    "rigid springs": (RIGID,) * 4,
    "all kinds": ("clamped", "free", SPRINGY, "supported"),
}
# Each effect on three kinds of edges and three sizes, and every kind of edge on every size.
COVERING = [
    (name, list(EDGES)[turn % 6], list(SIZES)[(turn // 6 + turn) % 6])
    for index, name in enumerate(EFFECTS)
    for turn in range(3 * index, 3 * index + 3)
]


def on_plate(size, effects):
    """Return effects whose areas, given in shares of the sides, are in m."""
    return {
        name: [{**item, "area": tuple(np.multiply(item["area"], np.repeat(size, 2)))} for item in table]
        if isinstance(table, list)
        else table
        for name, table in effects.items()
    }


def dense_matrices(made):
    """Return dense K and C (the losses at the last half-step) per mass, in coordinates √mass·u."""
    scheme = make_scheme(made)
    if made.grid.order == 4:
        stiffness = scheme.kappa**2 * biharmonic(scheme.taps_x, scheme.taps_y, scheme.spacing, 4).toarray()
        return stiffness, scheme.viscous / scheme.surface_density * scheme.backward * np.eye(len(stiffness))
    bending, oscillators = make_bending(made), made.effects.oscillators
    stiffness, masses = system(bending)
    root, moves = np.sqrt(masses), bending.moves.ravel()
    attached, nodes = [item for item in oscillators if item.mass > 0], int(moves.sum())
    loss = np.zeros((len(masses), len(masses)))
    if scheme.backward:
        cell = bending.spacing[0] * bending.spacing[1] * bending.weight
        loss[:nodes, :nodes] += np.diag((scheme.viscous * cell).ravel()[moves])
    if made.effects.material_damping:
        bare = stiffness_matrix(replace(bending, springs={}, membrane=(0.0, 0.0))).toarray()
        loss[:nodes, :nodes] += made.effects.material_damping.time * bare[np.ix_(moves, moves)]
    for oscillator, share in zip(oscillators, make_bending(made).shares, strict=True):
        reach = np.concatenate([share.ravel()[moves], [-1.0 * (other is oscillator) for other in attached]])
        loss += oscillator.damping * np.outer(reach, reach)
    return stiffness.toarray() / root / root[:, None], loss / root / root[:, None]


def check_limit(made):
    """Compare with Δt [s] at which the largest eigenvalue of Δt²K + 2Δt C is 4: it grows with Δt, so that it must be
    below 4 at the limit, and above 4 at 1.01 times the limit."""
    (stiffness, loss), limit = dense_matrices(made), find_limit(made)[0]

    def fastest(step):
        last = [len(stiffness) - 1] * 2
        matrix = step**2 * stiffness + 2 * step * loss
        return scipy.linalg.eigh(matrix, eigvals_only=True, subset_by_index=last)[0]

    assert fastest(limit.time_step * (1 - 1e-9)) < 4 < fastest(limit.time_step / 0.99), limit
    assert sum(limit.shares.values()) == pytest.approx(1, abs=1e-5)
    return limit


@pytest.mark.parametrize(("name", "edge", "size"), COVERING)
def test_within_one_percent_and_never_above(name, edge, size, scene):
    nodes, sides = SIZES[size]
    check_limit(scene(nodes, sides, EDGES[edge], effects=on_plate(sides, EFFECTS[name])))


@pytest.mark.parametrize(("nodes", "loss"), [((9, 9), None), ((17, 9), 400.0)])
def test_fourth_order(nodes, loss, edges, scene):
    check_limit(scene(nodes, (0.2, 0.16), edges, damping=loss, scheme="backward", order=4))


@pytest.mark.parametrize(
    ("name", "edge", "order"),
    [("nothing", "free", 2), ("nothing", "clamped", 4), ("nothing", "supported", 4), ("negative D1", "free", 2),
     ("backward damping", "supported", 2), ("stiff bed", "free", 2), ("tension", "clamped", 2),
     ("material damping", "supported", 2), ("orthotropic", "clamped", 2)],
)  # fmt: skip
def test_formulas(name, edge, order, scene):
    """The coarsest grids that a formula serves, where it is furthest off."""
    nodes = (FORMULA_NODES, FORMULA_NODES + 1)
    assert check_limit(scene(nodes, (0.2, 0.16), EDGES[edge], effects=EFFECTS[name], order=order)).formula


def test_shares_and_place_of_the_fastest_motion(scene):
    """A stiff spring on a patch moves fastest itself; a bare plate by bending."""
    spring = {"oscillators": [{"area": (0.14, 0.16, 0.04, 0.06), "stiffness": 1e8}]}
    found = check_limit(scene(effects=spring))
    assert found.shares["oscillators"] > 0.98
    assert found.place == pytest.approx((0.15, 0.05), abs=0.02)
    bare = check_limit(scene())
    assert bare.shares == pytest.approx({"bending": 1})
    assert bare.frequency * math.pi * bare.time_step == pytest.approx(1, abs=0.005)
    assert check_limit(scene(effects={"material_damping": {"time": 1e-3}})).shares["material damping"] > 0.9


@pytest.mark.parametrize(("edge", "nodes"), [("clamped", (9, 9)), ("springy", (27, 25)), ("rigid springs", (9, 9))])
def test_buckling_load_against_the_lowest_frequency(edge, nodes, scene):
    """The lowest frequency is nearly zero at 0.999 of the first load that is refused, and not at 0.5 of it."""
    for x, y in ((-0.5, -0.5), (-0.5, 2.0)):

        def pulled(factor, x=x, y=y):
            return scene(nodes, edges=EDGES[edge], effects={"tension": {"x": factor * x, "y": factor * y}})

        factor = buckling_factor(make_bending(pulled(1)))
        low, high = (natural_modes(pulled(part * factor), 1).frequencies[0] for part in (0.999, 0.5))
        assert 0 < low < 0.1 * high
        with pytest.raises(SceneError, match="the plate buckles"):
            make_scheme(pulled(1.001 * factor))
