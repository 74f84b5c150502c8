"""Orders of accuracy: transients of a supported plate and natural frequencies, of second and of fourth order."""

import csv
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg

from warp_plate import PlateSolver
from warp_plate.reference.series import damped_motion, grid_wavenumber_squared, mode_shape, wavenumber_squared

SUPPORTED = ("supported",) * 4
SIZE = (0.2, 0.16)
FREQUENCY, VISCOUS, END = 290.0, 60.0, 0.012
# Several times, for the error at any one of them may happen to be near zero. All counts of steps are multiples of 12.
TIMES = END * np.array([5, 7, 8, 10, 11, 12]) / 12
# Loads that start at their largest and at zero: cos ωt, sin ωt.
DRIVES = np.array([1.0, -1.0j])
MODES = Path(__file__).parents[1] / "data" / "modes_square_plate.csv"


def observed_orders(spacings, errors):
    """The slopes of log error over log spacing from one run to the next; errors: (runs, ...)."""
    return (np.diff(np.log(errors), axis=0).T / np.diff(np.log(spacings))).T


def relative_errors(made, device, path, mode, wavenumber):
    """(drives,) largest errors over the largest displacements of a plate under loads shaped like one sine mode."""
    x, y = (np.linspace(0, length, count) for length, count in zip(SIZE, made.grid.nodes, strict=True))
    shape, solver = mode_shape(mode, SIZE, x, y), PlateSolver(made, device, path)
    run, scheme = solver.run(DRIVES[:, None] * shape[1:-1, 1:-1].reshape(1, -1), TIMES), solver.discretization.scheme
    np.testing.assert_allclose(run.times, TIMES, rtol=1e-12)
    stiffness = scheme.rigidity * wavenumber(scheme) ** 2
    errors = []
    for found, drive in zip(run.displacement, DRIVES, strict=True):
        amplitude = damped_motion(TIMES, stiffness, scheme.surface_density, VISCOUS, drive, FREQUENCY)
        exact = amplitude[:, None, None] * shape
        errors.append(np.abs(found - exact).max() / np.abs(exact).max())
    return errors


@pytest.mark.parametrize("order", [2, 4])
def test_order_in_space(device, path, order, point_scene):
    """The exact transient of one sine mode, on grids with Δt ∝ h², so that the error in time falls as h⁴."""
    cells, mode = (10, 20, 40), (1, 1) if order == 2 else (2, 1)
    errors = [
        relative_errors(
            point_scene(
                (count + 1, count + 1), SIZE, SUPPORTED, order=order, time_step=END / steps, window=(0.0, END),
                frequency=FREQUENCY, damping=VISCOUS,
            ),
            device, path, mode, lambda scheme: wavenumber_squared(mode, SIZE),
        )
        for count, steps in zip(cells, (480, 1920, 7680), strict=True)
    ]  # fmt: skip
    # The next term of the error is h² times smaller, which the coarsest pair still shows.
    assert observed_orders(1 / np.array(cells), errors)[-1] == pytest.approx([order] * 2, abs=0.1)


def test_second_order_in_time(device, path, point_scene):
    """A sine mode is a mode of the grid too, with its own k²: with that, only the time steps are in error."""
    counts, mode = (240, 480, 960), (2, 1)
    errors = [
        relative_errors(
            point_scene(
                (11, 11), SIZE, SUPPORTED, time_step=END / steps, window=(0.0, END), frequency=FREQUENCY,
                damping=VISCOUS,
            ),
            device, path, mode, lambda scheme: grid_wavenumber_squared(mode, SIZE, scheme.spacing),
        )
        for steps in counts
    ]  # fmt: skip
    np.testing.assert_allclose(observed_orders(1 / np.array(counts), errors), 2, atol=0.1)


@pytest.mark.parametrize(("held", "order"), [("CCCC", 2), ("SCSC", 4)])
def test_natural_frequencies(held, order, point_scene, discrete_operator):
    """√ of the eigenvalues of the ∇⁴ that the default path computes, against a Ritz solution.

    Second order with 26 and 51 nodes, within 0.7 % on the finer; fourth with 13 and 26, within 5e-4: a finer grid would
    show the table's last digit. Between coarse grids some of its slopes are still on their way to 4.
    """
    with MODES.open(encoding="utf-8") as file:
        rows = csv.reader(line for line in file if not line.startswith("#"))
        exact = np.array({row[0]: row[1:] for row in rows}[held], dtype=float)
    names = {"S": "supported", "C": "clamped"}
    cells, side, errors = {2: (25, 50), 4: (12, 25)}[order], 0.2, []
    for count in cells:
        edges = [names[edge] for edge in held]
        matrix = discrete_operator(point_scene((count + 1, count + 1), (side, side), edges, order=order))
        values = scipy.sparse.linalg.eigsh(matrix, k=6, sigma=0, which="LM", return_eigenvectors=False)
        errors.append(np.abs(side**2 * np.sqrt(np.sort(values)) - exact) / exact)
    assert np.max(errors[-1]) < {2: 0.007, 4: 5e-4}[order]
    orders = observed_orders(1 / np.array(cells), errors)
    np.testing.assert_allclose(orders[-1], order, atol={2: 0.1, 4: 0.35}[order])
