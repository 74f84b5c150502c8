"""Free and elastic edges, each orthotropic rigidity, and layers, against Lévy's solution and the laminate's formula."""

import math

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg
from test_effects_exact import DENSITY, NODES, ORTHOTROPIC, RATIO, RIGIDITY, SIZE, SUPPORTED, THICKNESS, YOUNG

from warp_plate.plate.bending import make_bending, stiffness_matrix, system

LAYER = {"thickness": 3e-4, "young_modulus": 4e9, "density": 1800.0}
# Springs (translation, rotation) at x = 0 and a of a plate whose other sides are supported, and effects.
LEVY = {
    "free": (0.0, 0.0, {"tension": {"x": 8.0, "y": 5.0}}),
    "rotation alone": (0.0, 0.2, {}),
    "translation alone": (2e4, 0.0, {}),
    "orthotropic on springs": (1e4, 0.1, {"orthotropic": ORTHOTROPIC, "foundation": {"stiffness": 5e4}}),
}


def test_layer_over_the_whole_plate_is_the_laminate(scene):
    """A layer on one face has D = D₁ + D₂ + d²/(1/A₁ + 1/A₂), with the distance d of the middles and the stretching
    stiffnesses A in series. The mass is the sum."""
    plane, thin = 1 - RATIO**2, LAYER["thickness"]
    stretch, stretch_layer = YOUNG * THICKNESS / plane, LAYER["young_modulus"] * thin / plane
    lever = (THICKNESS + thin) ** 2 / 4 / (1 / stretch + 1 / stretch_layer)
    rigidity = RIGIDITY + stretch_layer * thin**2 / 12 + lever
    made = make_bending(scene(NODES, SIZE, effects={"layers": [{"area": (0, SIZE[0], 0, SIZE[1]), **LAYER}]}))
    for values, expected in (
        (made.bend_xx, rigidity), (made.bend_yy, rigidity), (made.bend_xy, RATIO * rigidity),
        (made.mass, DENSITY + LAYER["density"] * thin),
    ):  # fmt: skip
        np.testing.assert_allclose(values[1:-1, 1:-1], expected, rtol=1e-12)


def lowest_frequency(scene):
    """Return the lowest natural frequency ω [rad/s] of the plate on its grid, as the paths step it."""
    stiffness, masses = system(make_bending(scene))
    root = scipy.sparse.diags_array(1 / np.sqrt(masses))
    matrix = root @ stiffness @ root
    value = scipy.sparse.linalg.eigsh(matrix, k=1, sigma=-1.0, which="LM", return_eigenvectors=False)
    return math.sqrt(value[0])


def root_near(determinant, near):
    """Return the root ω of a determinant closest to ``near``, found by its first change of sign."""
    for part in np.linspace(0.0, 0.3, 301):
        low, high = near * (1 - part), near * (1 + part)
        if determinant(low) * determinant(high) < 0:
            return scipy.optimize.brentq(determinant, low, high, xtol=1e-12 * near)
    raise AssertionError("no frequency near the grid's")


@pytest.mark.parametrize("name", LEVY)
def test_edges_on_springs_and_free_ones_by_levys_solution(scene, name):
    """u = X(x) sin(ky), k = π/b: D_x X⁗ − (2(D_1 + 2D_xy)k² + T_x) X″ + (D_y k⁴ + T_y k² + k_f − ρHω²) X = 0, even
    about the middle, and at x = a/2 the moment against the rotation and the shear against the translation:
    D_x X″ − D_1k² X = −r X′, D_x X‴ − ((D_1 + 4D_xy)k² + T_x) X′ = t X. Second order: halving the spacing divides the
    error by about four."""
    translation, rotation, effects = LEVY[name]
    isotropic = {"Dx": RIGIDITY, "Dy": RIGIDITY, "D1": RATIO * RIGIDITY, "Dxy": (1 - RATIO) / 2 * RIGIDITY}
    plate = effects.get("orthotropic", isotropic)
    tension, bed = effects.get("tension", {"x": 0.0, "y": 0.0}), effects.get("foundation", {"stiffness": 0.0})
    k, half = math.pi / SIZE[1], SIZE[0] / 2
    middle = 2 * (plate["D1"] + 2 * plate["Dxy"]) * k**2 + tension["x"]

    def determinant(omega):
        rest = plate["Dy"] * k**4 + tension["y"] * k**2 + bed["stiffness"] - DENSITY * omega**2
        root = np.sqrt(complex(middle**2 - 4 * plate["Dx"] * rest))
        columns = []
        for square in (middle + root, middle - root):
            s = np.sqrt(square / (2 * plate["Dx"]))
            even, odd = np.cosh(s * half), np.sinh(s * half)
            columns.append(
                [
                    (plate["Dx"] * s**2 - plate["D1"] * k**2) * even + rotation * s * odd,
                    (plate["Dx"] * s**3 - ((plate["D1"] + 4 * plate["Dxy"]) * k**2 + tension["x"]) * s) * odd
                    - translation * even,
                ]
            )
        return (np.linalg.det(np.array(columns)) / root).real

    side = {"translation": translation, "rotation": rotation} if translation or rotation else "free"
    edges = (side, "supported", side, "supported")
    # An extra node along x, so that no cell is square.
    errors = []
    for count in (17, 33):
        tables = {"effects": {"foundation": {"stiffness": 0.0}, **effects}}
        found = lowest_frequency(scene((count + 1, count), SIZE, edges, **tables))
        errors.append(found / root_near(determinant, found) - 1)
    assert abs(errors[0]) < 0.01
    assert abs(errors[1]) < max(0.3 * abs(errors[0]), 1e-5)


def test_layer_on_a_strip_of_the_plate_by_levys_solution(scene):
    """The strip 0 … 0.615 a of a supported plate is thickened on both faces: X has other exponents on either side of
    the step, where X, X′, moment and shear are continuous. Second order, for a step within a cell."""
    plane, thin = 1 - RATIO**2, LAYER["thickness"]
    lever = (THICKNESS + thin) / 2
    thick = RIGIDITY + 2 * LAYER["young_modulus"] / plane * (thin**3 / 12 + thin * lever**2)
    cut, k = 0.615 * SIZE[0], math.pi / SIZE[1]
    sides = ((thick, DENSITY + 2 * LAYER["density"] * thin, cut), (RIGIDITY, DENSITY, SIZE[0] - cut))

    def determinant(omega):
        """Rows X, X′, M, V at the step; columns sinh and sin from each supported side."""
        columns = []
        for sign, (rigidity, mass, wide) in zip((1, -1), sides, strict=True):
            turn = math.sqrt(mass / rigidity) * omega
            for square in (k**2 + turn, k**2 - turn):
                s = np.sqrt(complex(square))
                odd, even = np.sinh(s * wide) / s, np.cosh(s * wide)
                columns.append(
                    [
                        sign * odd,
                        even,
                        sign * rigidity * (square - RATIO * k**2) * odd,
                        rigidity * (square - (2 - RATIO) * k**2) * even,
                    ]
                )
        scaled = np.array(columns).T
        return np.linalg.det(scaled / np.abs(scaled).max(axis=1, keepdims=True)).real

    errors = []
    for nodes in ((65, 57), (129, 113)):
        layer = {"area": (0.0, cut, 0.0, SIZE[1]), "both": True, **LAYER}
        found = lowest_frequency(scene(nodes, SIZE, SUPPORTED, effects={"layers": [layer]}))
        errors.append(found / root_near(determinant, found) - 1)
    assert abs(errors[0]) < 0.01
    assert abs(errors[1]) < 0.3 * abs(errors[0])


def test_rigid_motions_of_a_free_plate_bend_nothing(scene):
    """Motions 1, x and y, with a layer and orthotropic rigidities."""
    x, y = np.meshgrid(np.linspace(0, SIZE[0], NODES[0]), np.linspace(0, SIZE[1], NODES[1]))
    layer = {"area": (0.03, 0.09, 0.05, 0.18), **LAYER}
    effects = {"orthotropic": ORTHOTROPIC, "layers": [layer]}
    bending = make_bending(scene(NODES, SIZE, ("free",) * 4, effects=effects))
    matrix = stiffness_matrix(bending)
    for motion in (np.ones_like(x), x, y):
        assert np.abs(matrix @ motion.ravel()).max() < 1e-12 * abs(matrix).max() * np.abs(motion).max()
    twisted = (x * y).ravel()
    # xy has no curvature but a twist of one: ½ · 4D_xy times the area, with the layer's share (1 − ν)/2 of D.
    energy = 0.5 * twisted @ (matrix @ twisted)
    assert energy == pytest.approx(0.5 * bending.twist.sum() * np.prod(bending.spacing), rel=1e-9)
