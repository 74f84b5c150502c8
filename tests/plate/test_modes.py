"""Natural modes and static deflections of the discretized plate: published, without a grid, and of the kernels."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg

from support.grid_modes import natural_modes
from warp_plate import PlateSolver
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.bending import make_bending, mass_matrix, system
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.weights import patches

DATA = Path(__file__).parents[1] / "data"
NAMES = {"C": "clamped", "S": "supported", "F": "free"}
SIDE = 0.2


def springs(translation, rotation):
    """N/m² and N·m/(rad·m)."""
    return {"translation": translation, "rotation": rotation}


# Edges, and Poisson's ratio.
SPRUNG = {
    "unlike": (("free", springs(300.0, 0.0), springs(0.0, 0.1), springs(50.0, 1.0)), 0.45),
    "one rigid motion": ((springs(0.0, 0.3), "supported", "free", "free"), 0.1),
    "free": (("free",) * 4, 0.1),
}


def table_rows(name):
    with open(DATA / name, encoding="utf-8") as lines:
        return list(csv.reader(line for line in lines if not line.startswith("#")))[1:]


def with_ratio(scene, ratio):
    return scene.model_copy(update={"plate": scene.plate.model_copy(update={"poisson_ratio": ratio})})


def order_between(coarse, fine, cells):
    """Return the powers of the spacing with which errors fall between two grids."""
    return np.log(np.asarray(coarse) / fine) / np.log(cells[1] / cells[0])


@pytest.mark.parametrize(("held", "published"), [(row[0], row[1:]) for row in table_rows("modes_square_plate.csv")])
def test_published_frequencies(scene, held, published):
    """Within 0.6 % with 51 × 51 nodes, of second order, rigid motions at 0; of fourth order without free sides.

    The fifth of CCCC, three half-waves between clamped sides, is off by 0.606 % in second order.
    """
    sides, rigid = held[:4], int(held.split("_")[2]) if "_" in held else 0
    published, edges, errors = np.array(published, dtype=float), [NAMES[side] for side in sides], []
    for nodes, order in ((27, 2), (51, 2), *([] if "F" in sides else [(27, 4)])):
        made = with_ratio(scene((nodes, nodes), (SIDE, SIDE), edges, order=order), 0.3)
        found = natural_modes(made, 6 + rigid).frequencies * 2 * math.pi * SIDE**2 / make_scheme(made).kappa
        assert found.size == 6 + rigid
        assert (found[:rigid] == 0).all()
        assert (found[rigid:] > 0).all()
        errors.append(np.abs(found[rigid:] / published - 1))
    assert errors[1].max() < (0.0061 if sides == "CCCC" else 0.006)
    np.testing.assert_allclose(order_between(*errors[:2], (26, 50)), 2, atol=0.06)
    assert all(error.max() < 3.5e-4 for error in errors[2:])


@pytest.mark.parametrize("name", SPRUNG)
def test_frequencies_of_other_plates(scene, name):
    """Oblong cells, other Poisson's ratios, and edges on springs: within 0.7 % and of second order."""
    (edges, ratio), errors = SPRUNG[name], []
    exact = solve_modes(with_ratio(scene((9, 9), (0.26, 0.2), edges), ratio), count=12).frequencies
    rigid = np.count_nonzero(exact == 0)
    for nodes in ((27, 23), (53, 45)):
        found = natural_modes(with_ratio(scene(nodes, (0.26, 0.2), edges), ratio), 6 + rigid).frequencies
        assert (found[:rigid] == 0).all()
        errors.append(np.abs(found[rigid:] / exact[rigid : rigid + 6] - 1))
    assert errors[1].max() < 0.007
    np.testing.assert_allclose(order_between(*errors, (26, 52)), 2, atol=0.12)


@pytest.mark.parametrize(("held", "load", "coefficient"), table_rows("static_plate.csv"))
def test_static_deflection(scene, held, load, coefficient):
    """Ku = f meets the table; the deflection under a point load, that of one node, converges as h² log h."""
    errors, uniform = [], load == "uniform"
    for nodes in (27, 51):
        half = SIDE / (nodes - 1) / 2
        area = (0.0, SIDE, 0.0, SIDE) if uniform else (SIDE / 2 - half, SIDE / 2 + half) * 2
        edges = [NAMES[side] for side in held]
        made = with_ratio(scene((nodes, nodes), (SIDE, SIDE), edges, actuators=[area]), 0.3)
        moves, solved = make_bending(made).moves, np.zeros((nodes, nodes))
        pressed = patches(made)[0][moves] * (2 * half) ** 2
        solved[moves] = scipy.sparse.linalg.spsolve(system(make_bending(made))[0].tocsc(), pressed)
        unit = (SIDE**4 if uniform else (2 * half * SIDE) ** 2) / make_scheme(made).rigidity
        errors.append(abs(solved[nodes // 2, nodes // 2] / unit / float(coefficient) - 1))
    assert errors[1] < (0.004 if uniform else 0.007)
    assert order_between(*errors, (26, 50)) == pytest.approx(2 if uniform else 1.75, abs=0.1)


MIXES = {
    "plain": {"edges": ("clamped", "supported", "clamped", "clamped")},
    "fourth order": {"edges": ("clamped", "supported", "supported", "clamped"), "order": 4, "load": "moments"},
    "effects": {
        "edges": ("free", "supported", springs(0.0, 0.2), springs(50.0, 0.0)),
        "effects": {
            "tension": {"x": 12.0, "y": -0.2},
            "foundation": {"stiffness": 2e4},
            "orthotropic": {"Dx": 0.02, "Dy": 0.008, "D1": 0.003, "Dxy": 0.004},
            "layers": [{"area": (0.05, 0.12, 0.05, 0.12), "thickness": 4e-4, "young_modulus": 3e9, "density": 2e3}],
            "oscillators": [{"area": (0.1, 0.13, 0.12, 0.15), "stiffness": 200.0}],
        },
    },
}


@pytest.mark.parametrize("name", MIXES)
def test_the_kernels_move_in_these_modes(scene, device, path, random, name):
    """In a run, the share q = φᵀMu of each mode is an oscillator of its frequency, whatever the others do:
    q⁺ − 2q + q⁻ + (ωΔt)² q = Δt² φᵀf to rounding; and that rings at the stepped frequency."""
    made = scene((17, 15), (0.2, 0.18), window=(0.0, 0.012), **MIXES[name])
    scheme, found = make_scheme(made), natural_modes(made, 8)
    step, (hx, hy) = scheme.time_step, scheme.spacing
    turn = 2 * math.pi * found.frequencies * step
    np.testing.assert_allclose(2 * np.sin(math.pi * found.stepped * step), turn, rtol=1e-12)
    drive = random.normal(size=3) + 1j * random.normal(size=3)
    times = step * np.arange(scheme.steps + 1)
    moved = PlateSolver(made, device, path).run(drive[None], times).displacement[0].reshape(len(times), -1)
    shapes = found.shapes.reshape(8, -1)
    q = moved @ (mass_matrix(make_bending(made)) * shapes).T
    pressed = shapes @ patches(made).reshape(3, -1).T * hx * hy
    signals = make_signals(made, step, scheme.steps)
    wave = signals.wave @ signals.coefficients(drive[None])[0]
    before = np.concatenate([0 * q[:1], q[:-2]])
    rest = q[1:] - 2 * q[:-1] + before + turn**2 * q[:-1] - step**2 * wave @ pressed.T
    assert len(q) > 50
    assert (np.abs(rest).max(axis=0) < 1e-7 * np.abs(turn**2 * q[:-1]).max(axis=0)).all()


def test_modes_with_attached_masses(scene):
    """A mass m on a spring k adds to the bare plate's modes those of 1 = G(ω) kmω²/(k − mω²), G = Σ (φᵀs)²/(ω_i² − ω²)
    over all of them, s the patch and φᵀMφ = 1; it moves k/(k − mω²) times as far as its patch."""
    mass, stiffness = 0.004, 60.0
    attached = {"area": (0.05, 0.08, 0.04, 0.07), "mass": mass, "stiffness": stiffness, "damping": 0.1}
    only_damped = {"area": (0.1, 0.13, 0.1, 0.13), "mass": 0.01, "damping": 0.1}
    bare = scene((11, 9), (0.2, 0.18))
    made = scene((11, 9), (0.2, 0.18), effects={"oscillators": [only_damped, attached]})
    found, whole = natural_modes(made, 6), natural_modes(bare, 200)
    assert whole.frequencies.size == 9 * 7
    share = make_bending(made).shares[1]
    squares = (2 * math.pi * whole.frequencies) ** 2
    modal_mass = (whole.shapes**2).reshape(len(squares), -1) @ mass_matrix(make_bending(bare))
    coupled = (whole.shapes * share).sum(axis=(1, 2)) ** 2 / modal_mass
    for frequency, shape, motion in zip(found.frequencies, found.shapes, found.oscillators, strict=True):
        square = (2 * math.pi * frequency) ** 2
        ratio = stiffness / (stiffness - mass * square)
        assert (coupled / (squares - square)).sum() * mass * square * ratio == pytest.approx(1, rel=1e-6)
        assert motion[1] == pytest.approx(ratio * (shape * share).sum(), rel=1e-6)
        assert motion[0] == 0
        assert np.abs(shape).max() == shape.max() == 1


def test_a_mass_on_a_patch_at_rest_swings_alone(scene):
    attached = {"area": (0.0, 0.001, 0.05, 0.1), "mass": 1e-3, "stiffness": 2.0}
    found = natural_modes(scene((9, 9), effects={"oscillators": [attached]}), 1)
    assert found.frequencies[0] == pytest.approx(math.sqrt(2000.0) / (2 * math.pi), rel=1e-9)
    assert found.oscillators[0, 0] == pytest.approx(1)
    assert np.abs(found.shapes).max() < 1e-9


def test_shapes_of_one_frequency_are_kept_apart(scene):
    """Square plates have pairs of modes; they come out along the sides."""
    found = natural_modes(scene((21, 21)), 8)
    assert found.half_waves() == [(1, 1), (1, 2), (2, 1), (2, 2), None, None, (2, 3), (3, 2)]
    assert found.frequencies[1] == pytest.approx(found.frequencies[2], rel=1e-9)
    np.testing.assert_allclose(np.abs(found.shapes).max(axis=(1, 2)), 1)
    # Many modes are computed in another way than a few.
    dense = natural_modes(scene((21, 21)), 200)
    np.testing.assert_allclose(dense.frequencies[:8], found.frequencies, rtol=1e-9)
    np.testing.assert_allclose(np.abs(dense.shapes[:8]), np.abs(found.shapes), atol=1e-5)


def test_losses_and_stretching_are_left_out(scene):
    lossy = {"damping": {"viscous": 50.0}, "material_damping": {"time": 1e-6}, "stretching": {}}
    bare, made = scene((13, 11), (0.2, 0.18)), scene((13, 11), (0.2, 0.18), effects=lossy)
    np.testing.assert_allclose(natural_modes(made, 5).frequencies, natural_modes(bare, 5).frequencies, rtol=1e-10)
