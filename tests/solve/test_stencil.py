"""∇⁴u as the paths compute it, against polynomials and against the NumPy reference.

The operator is measured through ``PlateSolver.run``, see ``apply_biharmonic`` in conftest.py. Tolerance:
u(2Δt) is rounded to ε·max|u| a few times, and dividing by (κΔt/h²)² ≈ 1/18 of the stencil's unit makes some
100 ε·max|u|/h⁴ of that, while ∇⁴u itself is of the size 64 max|u|/h⁴ on a random field.
"""

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.numpy_plate import biharmonic, with_ghosts

PLATES = {"square": ((13, 13), (0.2, 0.2)), "oblong": ((17, 9), (0.2, 0.16))}
REACH = 2


def tolerance(precision, field, spacing):
    return 400 * np.finfo(precision).eps * np.abs(field).max() / min(spacing) ** 4


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("plate", PLATES)
def test_equals_reference_for_all_edges(
    device, path, edges, plate, precision, point_scene, apply_biharmonic, random
):
    """The compact 13 points with ghost nodes, as the reference writes them, on random fields."""
    nodes, size = PLATES[plate]
    solver = PlateSolver(point_scene(nodes, size, edges, precision), device, path)
    fields = np.zeros((3, nodes[1], nodes[0]))
    fields[:, 1:-1, 1:-1] = random.normal(size=(3, nodes[1] - 2, nodes[0] - 2))
    fields, measured = apply_biharmonic(solver, fields)
    spacing = make_scheme(solver.scene).spacing
    expected = biharmonic(with_ghosts(fields, edges), spacing)
    np.testing.assert_allclose(measured, expected, rtol=0, atol=tolerance(precision, fields, spacing))


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("plate", PLATES)
def test_exact_on_polynomials_of_degree_four(
    device, path, plate, precision, point_scene, apply_biharmonic, random
):
    """∇⁴ of Σ a_mn x^m y^n with m + n ≤ 4 is 24 a_40 + 8 a_22 + 24 a_04, at every node away from the
    edges."""
    nodes, size = PLATES[plate]
    solver = PlateSolver(point_scene(nodes, size, precision=precision), device, path)
    spacing = make_scheme(solver.scene).spacing
    y, x = np.meshgrid(np.linspace(-1, 1, nodes[1]), np.linspace(-1, 1, nodes[0]), indexing="ij")
    degrees = [(m, n) for m in range(5) for n in range(5 - m)]
    coefficients = random.normal(size=(4, len(degrees)))
    fields = np.einsum("pd,dyx->pyx", coefficients, np.array([x**m * y**n for m, n in degrees]))
    fields[:, [0, -1]] = 0
    fields[:, :, [0, -1]] = 0
    loaded, measured = apply_biharmonic(solver, fields)
    # What is measured is ∇⁴ of u(Δt), which is the load times a number.
    scale = np.abs(loaded).max() / np.abs(fields).max()
    a40, a22, a04 = (coefficients[:, degrees.index(degree)] for degree in ((4, 0), (2, 2), (0, 4)))
    half = np.array(size) / 2
    exact = scale * (24 * a40 / half[0] ** 4 + 8 * a22 / (half[0] * half[1]) ** 2 + 24 * a04 / half[1] ** 4)
    away = measured[:, REACH:-REACH, REACH:-REACH]
    np.testing.assert_allclose(
        away,
        np.broadcast_to(exact[:, None, None], away.shape),
        rtol=0,
        atol=tolerance(precision, loaded, spacing),
    )
