"""Stretching stiffness of plates that are not the same sheet everywhere.

Berger keeps ½∫ C e² dA of the in-plane energy, e = U_x + V_y + ½|∇u|². Among all U and V that vanish at the edges it is
least where C e = N is the same everywhere, and then N ∫ dA/C = ½∫ |∇u|² dA.
"""

import math

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.bending import make_bending
from warp_plate.plate.scheme import make_scheme

NODES, SIZE = (13, 11), (0.2, 0.18)
YOUNG, RATIO, THICKNESS, DENSITY = 1e9, 0.33, 5e-4, 1000.0  # the tests' plate
PLANE = 1 - RATIO**2
LAYER = {"thickness": 3e-4, "young_modulus": 4e9, "density": 1800.0}
SHEET = YOUNG * THICKNESS / PLANE
FACES = 2 * LAYER["young_modulus"] * LAYER["thickness"] / PLANE


@pytest.mark.parametrize("area", [(0.0, 0.1, 0.0, 0.18), (0.031, 0.115, 0.05, 0.13)])
def test_compliance_of_a_patch(scene, area):
    """By area, wherever its edges cut cells."""
    made = make_bending(scene(NODES, SIZE, effects={"layers": [{"area": area, "both": True, **LAYER}]}))
    part = (area[1] - area[0]) * (area[3] - area[2]) / (SIZE[0] * SIZE[1])
    mean = 1 / (part / (SHEET + FACES) + (1 - part) / SHEET)
    np.testing.assert_allclose(made.stretch, mean, rtol=1e-12)
    assert made.stretch_ratio == 1
    assert made.berger == pytest.approx(mean / (2 * SIZE[0] * SIZE[1]), rel=1e-12)


def test_thickness_and_modulus_that_vary(scene):
    """C = C₀ E H: the mean of 1/(1 + x) from 0 to 1 is ln 2, of second order in the spacing."""
    mean_of_ramp = 1 / math.log(2)
    ramps = (({"thickness": [[1.0, 2.0]]}, mean_of_ramp), ({"young_modulus": [[2.0], [4.0]]}, 2 * mean_of_ramp))
    for tables, mean in ramps:
        made = [make_bending(scene((cells + 1, cells + 1), SIZE, effects={"variation": tables})) for cells in (12, 24)]
        errors = [plate.stretch[1] / (SHEET * mean) - 1 for plate in made]
        assert abs(errors[0]) < 1e-3
        assert abs(errors[1]) < 0.26 * abs(errors[0])
    density = make_bending(scene(NODES, SIZE, effects={"variation": {"density": [[0.5, 2.0]]}}))
    np.testing.assert_allclose(density.stretch, SHEET, rtol=1e-12)


def test_an_orthotropic_sheet_with_layers_and_variation(scene):
    """12 D/H² along each axis, with its thickness and modulus, plus the layers."""
    rigidities = {"Dx": 0.02, "Dy": 0.005, "D1": 0.002, "Dxy": 0.004}
    bare = make_bending(scene(NODES, SIZE, effects={"orthotropic": rigidities}))
    np.testing.assert_allclose(bare.stretch, [12 * 0.02 / THICKNESS**2, 12 * 0.005 / THICKNESS**2], rtol=1e-12)
    assert bare.stretch_ratio == pytest.approx(0.5)
    layer = {"area": (0, SIZE[0], 0, SIZE[1]), "both": True, **LAYER}
    variation = {"thickness": [[2.0]], "young_modulus": [[3.0]]}
    tables = {"orthotropic": rigidities, "layers": [layer], "variation": variation}
    whole = make_bending(scene(NODES, SIZE, effects=tables))
    np.testing.assert_allclose(whole.stretch, 6 * np.array(bare.stretch) + FACES, rtol=1e-12)


def test_layers_on_both_faces_move_as_one_sheet(scene, device, path):
    """D and C of a laminate are those of a sheet of H = √(12D/C) and E = C(1 − ν²)/H, in motion of some thicknesses."""
    throw = 2.0
    rigidity = YOUNG * THICKNESS**3 / 12 / PLANE
    middle = (THICKNESS + LAYER["thickness"]) / 2
    rigidity += 2 * LAYER["young_modulus"] / PLANE * (LAYER["thickness"] ** 3 / 12 + LAYER["thickness"] * middle**2)
    height = math.sqrt(12 * rigidity / (SHEET + FACES))
    mass = DENSITY * THICKNESS + 2 * LAYER["density"] * LAYER["thickness"]
    sheet = {
        "size": SIZE, "thickness": height, "young_modulus": (SHEET + FACES) * PLANE / height, "poisson_ratio": RATIO,
        "density": mass / height,
    }  # fmt: skip
    layer = {"area": (0, SIZE[0], 0, SIZE[1]), "both": True, **LAYER}
    edges, stretching = ("clamped", "supported", "clamped", "clamped"), {"stretching": {}}
    tables = {"edges": edges, "effects": {"layers": [layer], **stretching}, "frequency": 90.0}
    step = 0.8 * make_scheme(scene(NODES, SIZE, **tables)).limit
    layered = scene(NODES, SIZE, time_step=step, **tables)
    same = scene(NODES, SIZE, edges, effects=stretching, frequency=90.0, time_step=step, plate=sheet)
    drives = np.array([[1, 0.3j, -0.5]])
    linear = PlateSolver(layered, device, path).run(1e-6 * drives, (0.01,)).displacement
    drives = drives * 1e-6 * throw * height / np.abs(linear).max()
    found, right = (PlateSolver(made, device, path).run(drives, (0.004, 0.01)).displacement for made in (layered, same))
    scale = np.abs(right).max()
    assert 0.3 * height < scale < 0.9 * throw * height
    np.testing.assert_allclose(found, right, atol=1e-9 * scale)
