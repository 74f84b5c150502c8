"""The largest stable time step against eigenvalues of the whole step, worked out densely, over many scenes.

The step's matrix takes (u, v, masses' places, their rates) from one time level to the next. It is built from the
equations alone here, K and C by the scene's springs, dampers and moments; tests/solve/test_hard_cases.py shows on every
path that the kernels hold to the same limit.
"""

import math

import numpy as np
import pytest
import scipy.optimize

from warp_plate.plate.bending import make_bending, oscillator_shares, stiffness_matrix, system
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.operator import biharmonic
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.stability_limit import FORMULA_NODES, find_limit

SIZES = {
    "smallest": ((5, 5), (0.2, 0.2)),
    "square": ((13, 13), (0.2, 0.2)),
    "oblong": ((17, 9), (0.2, 0.16)),
    "long": ((21, 5), (0.5, 0.02)),
    "beam": ((9, 21), (0.008, 0.4)),
    "cells 1 : 10": ((9, 15), (0.2, 0.035)),
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
    "tension": {"tension": {"x": 500.0, "y": 20.0}},
    "material damping": {"material_damping": {"time": 1e-5}},
    "material damping of a slack plate": {"material_damping": {"time": 1e-4}, "tension": {"x": 1e5, "y": 1e5}},
    "orthotropic": {"orthotropic": {"Dx": 0.05, "Dy": 0.004, "D1": 0.003, "Dxy": 0.002}},
    "negative D1": {"orthotropic": {"Dx": 0.02, "Dy": 0.018, "D1": -0.017, "Dxy": 0.002}},
    "layer in the middle": {"layers": [{"area": (0.25, 0.75, 0.25, 0.75), **LAYER}]},
    "layer on one half": {"layers": [{"area": (0.0, 0.5, 0.0, 1.0), **LAYER}]},
    "layer everywhere": {"layers": [{"area": (0.0, 1.0, 0.0, 1.0), **LAYER}]},
    "thickness 1 : 3": {"variation": {"thickness": [[1.0, 3.0, 1.0], [1.0, 1.0, 2.0]]}},
    "heavy corner": {"layers": [{"area": (0.0, 0.3, 0.0, 0.3), **LAYER, "density": 1e5}]},
    "spring": {"oscillators": [{"area": (0.4, 0.6, 0.4, 0.6), "stiffness": 1e6}]},
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


def on(size, effects):
    """Effects whose areas, above in shares of the sides, are of this plate."""
    scaled = {}
    for name, table in effects.items():
        if isinstance(table, list):
            scale = (size[0], size[0], size[1], size[1])
            table = [{**one, "area": tuple(np.multiply(one["area"], scale))} for one in table]
        scaled[name] = table
    return scaled


def matrices(made):
    """Dense K, C, c per mass, in coordinates √mass·u: damping C at the last half-step, c centred in time."""
    scheme = make_scheme(made)
    if made.grid.order == 4:
        bilaplacian = biharmonic(scheme.taps_x, scheme.taps_y, scheme.spacing, scheme.order)
        stiffness = scheme.kappa**2 * bilaplacian.toarray()
        return stiffness, scheme.viscous / scheme.surface_density * scheme.backward * np.eye(len(stiffness))
    bending, effects = make_bending(made), made.effects
    stiffness, masses = system(made, bending)
    root = np.sqrt(masses)
    moves, hung = bending.moves.ravel(), [one for one in effects.oscillators if one.mass > 0]
    nodes = int(moves.sum())
    late = np.zeros((len(masses), len(masses)))
    if scheme.backward:
        cell = bending.spacing[0] * bending.spacing[1] * bending.weight
        late[:nodes, :nodes] += np.diag((scheme.viscous * cell).ravel()[moves])
    if effects.material_damping:
        bare = type(bending)(**{**vars(bending), "spring": 0 * bending.spring, "tension": (0.0, 0.0)})
        late[:nodes, :nodes] += effects.material_damping.time * stiffness_matrix(bare).toarray()[np.ix_(moves, moves)]
    for one, share in zip(effects.oscillators, oscillator_shares(made), strict=True):
        reach = np.concatenate([share.ravel()[moves], [-1.0 * (other is one) for other in hung]])
        late += one.damping * np.outer(reach, reach)
    return stiffness.toarray() / root / root[:, None], late / root / root[:, None]


def true_limit(made):
    """Δt [s] at which the largest eigenvalue of Δt²K + 2Δt C is 4, by bisection on dense eigenvalues."""
    stiffness, late = matrices(made)

    def above(logarithm):
        step = math.exp(logarithm)
        return np.linalg.eigvalsh(step**2 * stiffness + 2 * step * late)[-1] - 4

    largest = np.linalg.eigvalsh(stiffness)[-1]
    if not late.any():
        return 2 / math.sqrt(largest)
    high = math.log(2 / math.sqrt(largest)) + 1e-6
    low = math.log(4 / (4 * np.linalg.eigvalsh(late)[-1] + 4 * math.sqrt(largest)))
    return math.exp(scipy.optimize.brentq(above, low, high, xtol=1e-10, rtol=1e-14))


def check(made):
    found, exact = find_limit(made)[0], true_limit(made)
    assert 0.99 < found.time_step / exact < 1 + 1e-9, found
    assert sum(found.shares.values()) == pytest.approx(1, abs=1e-5)
    return found


QUICK = ("smallest", "long")


@pytest.mark.parametrize(
    "size", [size if size in QUICK else pytest.param(size, marks=pytest.mark.slow) for size in SIZES]
)
@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("name", EFFECTS)
def test_within_one_percent_and_never_above(name, edge, size, scene):
    """Over small grids, where the end of a periodic plate's spectrum is far off."""
    nodes, sides = SIZES[size]
    check(scene(nodes, sides, EDGES[edge], effects=on(sides, EFFECTS[name])))


@pytest.mark.parametrize("nodes", [(9, 9), (13, 13), (17, 9)])
@pytest.mark.parametrize("loss", [None, 400.0])
def test_fourth_order(nodes, loss, edges, scene):
    check(scene(nodes, (0.2, 0.16), edges, damping=loss, scheme="backward", order=4))


# Of grids that are fine enough for a formula: what has one.
FORMULAS = ("nothing", "backward damping", "stiff bed", "tension", "material damping", "orthotropic", "negative D1")


@pytest.mark.parametrize("nodes", [(FORMULA_NODES, FORMULA_NODES), (24, 29)])
@pytest.mark.parametrize("edge", ["clamped", "supported", "free"])
@pytest.mark.parametrize("name", FORMULAS)
def test_formulas(name, edge, nodes, scene):
    """The coarsest grids that a formula serves, where it is furthest off."""
    assert check(scene(nodes, (0.2, 0.16), EDGES[edge], effects=EFFECTS[name])).formula


@pytest.mark.parametrize("edge", ["clamped", "supported"])
def test_formula_of_fourth_order(edge, scene):
    assert check(scene((FORMULA_NODES, FORMULA_NODES), (0.2, 0.16), EDGES[edge], order=4)).formula


def test_shares_say_what_sets_it(scene):
    """A stiff spring on a patch: the fastest motion is its own, and there; a bare plate: bending."""
    spring = {"oscillators": [{"area": (0.14, 0.16, 0.04, 0.06), "stiffness": 1e8}]}
    found = check(scene(effects=spring))
    assert found.shares["oscillators"] > 0.98
    assert found.place == pytest.approx((0.15, 0.05), abs=0.02)
    assert check(scene()).shares == pytest.approx({"bending": 1})
    half = check(scene(effects={"material_damping": {"time": 1e-3}}))
    assert half.shares["material damping"] > 0.9


@pytest.mark.parametrize("pull", [(-0.5, -0.5), (-0.5, 2.0)])
@pytest.mark.parametrize("edge", ["clamped", "springy", "rigid springs"])
def test_buckling_load_against_the_lowest_frequency(edge, pull, scene):
    """At 0.999 of the load that is refused first the lowest frequency is next to zero, at 0.5 of it is not."""
    from warp_plate.plate.bending import buckling_factor

    for nodes in ((9, 9), (27, 25)):
        trial = scene(nodes, edges=EDGES[edge], effects={"tension": {"x": pull[0], "y": pull[1]}})
        factor = buckling_factor(trial, make_bending(trial))
        lowest = []
        for part in (0.5, 0.999):
            tension = {"x": part * factor * pull[0], "y": part * factor * pull[1]}
            made = scene(nodes, edges=EDGES[edge], effects={"tension": tension})
            lowest.append(natural_modes(made, 1).frequencies[0])
        assert 0 < lowest[1] < 0.1 * lowest[0]
