"""∇⁴u as the second-order paths compute it, against polynomials and the NumPy reference.

The operator is measured through ``PlateSolver.run``, see ``apply_biharmonic`` in conftest.py. Tolerance: u(2Δt) is
rounded to ε·max|u| a few times, and dividing by (κΔt/h²)² ≈ 1/18 of the stencil's unit makes some 100 ε·max|u|/h⁴ of
that, while ∇⁴u itself is of the size 64 max|u|/h⁴ on a random field.
"""

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.numpy_plate import biharmonic, with_ghosts

PLATES = {
    "float32-square": ("float32", (13, 13), (0.2, 0.2)),
    "float64-square": ("float64", (13, 13), (0.2, 0.2)),
    "float32-oblong": ("float32", (17, 9), (0.2, 0.16)),
    "float64-oblong": ("float64", (17, 9), (0.2, 0.16)),
}


def check_close(measured, expected, scene, field):
    size = np.finfo(scene.grid.precision).eps * np.abs(field).max() / min(make_scheme(scene).spacing) ** 4
    np.testing.assert_allclose(measured, expected, rtol=0, atol=400 * size)


def test_equals_the_reference(device, path, edges, point_scene, apply_biharmonic, random):
    """The 13-point stencil with ghost nodes of the reference, on random fields."""
    precision, nodes, size = PLATES["float64-oblong"]
    solver = PlateSolver(point_scene(nodes, size, edges, precision), device, path)
    fields = np.zeros((3, nodes[1], nodes[0]))
    fields[:, 1:-1, 1:-1] = random.normal(size=(3, nodes[1] - 2, nodes[0] - 2))
    fields, measured = apply_biharmonic(solver, fields)
    expected = biharmonic(with_ghosts(fields, edges), make_scheme(solver.scene).spacing)
    check_close(measured, expected, solver.scene, fields)


@pytest.mark.parametrize("plate", PLATES)
def test_exact_on_polynomials_of_degree_four(device, path, plate, point_scene, apply_biharmonic, random):
    """∇⁴ of Σ a_mn x^m y^n with m + n ≤ 4 is 24 a_40 + 8 a_22 + 24 a_04, at every node away from the edges."""
    precision, nodes, size = PLATES[plate]
    solver = PlateSolver(point_scene(nodes, size, precision=precision), device, path)
    y, x = np.meshgrid(np.linspace(-1, 1, nodes[1]), np.linspace(-1, 1, nodes[0]), indexing="ij")
    degrees = [(m, n) for m in range(5) for n in range(5 - m)]
    coefficients = random.normal(size=(4, len(degrees)))
    fields = np.einsum("pd,dyx->pyx", coefficients, np.array([x**m * y**n for m, n in degrees]))
    fields[:, [0, -1]] = 0
    fields[:, :, [0, -1]] = 0
    loaded, measured = apply_biharmonic(solver, fields)
    # Measured is ∇⁴ of u(Δt), which is the load times a number.
    scale = np.abs(loaded).max() / np.abs(fields).max()
    a40, a22, a04 = (coefficients[:, degrees.index(degree)] for degree in ((4, 0), (2, 2), (0, 4)))
    half_x, half_y = np.array(size) / 2
    exact = scale * (24 * a40 / half_x**4 + 8 * a22 / (half_x * half_y) ** 2 + 24 * a04 / half_y**4)
    away = measured[:, 2:-2, 2:-2]
    check_close(away, np.broadcast_to(exact[:, None, None], away.shape), solver.scene, loaded)
