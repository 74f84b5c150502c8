"""Orders of accuracy: transients of a supported plate and natural frequencies, of second and of fourth order."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.series import (
    grid_wavenumber_squared,
    mode_amplitude,
    mode_shape,
    wavenumber_squared,
)

SUPPORTED = ("supported",) * 4
SIZE = (0.2, 0.16)
FREQUENCY, VISCOUS, END = 290.0, 60.0, 0.012
# Compared at several times, for the error at any one of them may happen to be near zero. All counts of steps
# are multiples of 12.
TIMES = END * np.array([5, 7, 8, 10, 11, 12]) / 12
# Loads that start at their largest and at zero: cos ωt, sin ωt.
PHASES = {"cosine": 1.0, "sine": -1.0j}
MODES = Path(__file__).parents[1] / "data" / "modes_square_plate.csv"


def observed_orders(spacings, errors):
    """The slopes of log error over log spacing from one run to the next; errors: (runs, ...)."""
    return (np.diff(np.log(errors), axis=0).T / np.diff(np.log(spacings))).T


def modal_run(point_scene, device, path, nodes, mode, drive, steps, order=2):
    """Scheme, mode (ny, nx), displacements (times, ny, nx) of a supported plate under a load shaped like the
    mode."""
    made = point_scene(
        nodes, SIZE, SUPPORTED, order=order, time_step=END / steps, window=(0.0, END), frequency=FREQUENCY,
        damping=VISCOUS,
    )  # fmt: skip
    x, y = (np.linspace(0, length, count) for length, count in zip(SIZE, nodes, strict=True))
    shape = mode_shape(mode, SIZE, x, y)
    solver = PlateSolver(made, device, path)
    run = solver.run(drive * shape[1:-1, 1:-1].reshape(1, -1), TIMES)
    np.testing.assert_allclose(run.times, TIMES, rtol=1e-12)
    return make_scheme(made), shape, run.displacement[0]


def relative_error(scheme, shape, found, drive, squared_wavenumber):
    """Largest error at any node and time, over the largest displacement."""
    stiffness = scheme.rigidity * squared_wavenumber**2
    amplitudes = mode_amplitude(TIMES, stiffness, scheme.surface_density, VISCOUS, drive, FREQUENCY)
    exact = amplitudes[:, None, None] * shape
    return np.abs(found - exact).max() / np.abs(exact).max()


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("mode", [(1, 1), pytest.param((2, 1), marks=pytest.mark.slow)])
def test_order_in_space(device, path, mode, phase, order, point_scene):
    """The exact transient of one sine mode, on grids with Δt ∝ h², so that the error in time falls as h⁴."""
    cells, drive, errors = (10, 20, 40), PHASES[phase], []
    for count, steps in zip(cells, (480, 1920, 7680), strict=True):
        scheme, shape, found = modal_run(
            point_scene, device, path, (count + 1, count + 1), mode, drive, steps, order
        )
        errors.append(relative_error(scheme, shape, found, drive, wavenumber_squared(mode, SIZE)))
    # The next term of the error is h² times smaller, which the coarsest pair still shows.
    assert observed_orders(1 / np.array(cells), errors)[-1] == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("mode", [(1, 1), (2, 1)])
def test_second_order_in_time(device, path, mode, phase, point_scene):
    """A sine mode is a mode of the grid too, with its own k²: with that the error is of the steps in time
    alone."""
    counts, drive, errors = (240, 480, 960), PHASES[phase], []
    for steps in counts:
        scheme, shape, found = modal_run(point_scene, device, path, (11, 11), mode, drive, steps)
        of_grid = grid_wavenumber_squared(mode, SIZE, scheme.spacing)
        errors.append(relative_error(scheme, shape, found, drive, of_grid))
    assert observed_orders(1 / np.array(counts), errors) == pytest.approx([2, 2], abs=0.1)


def published_eigenvalues(edges):
    """λ = ωa²√(ρH/D) of the first six modes; edges x = 0, y = 0, x = a, y = a."""
    with MODES.open(encoding="utf-8") as file:
        rows = csv.reader(line for line in file if not line.startswith("#"))
        return np.array({row[0]: row[1:] for row in rows}[edges], dtype=float)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize(
    "held", ["CCCC", *(pytest.param(held, marks=pytest.mark.slow) for held in ("SSSS", "SCSC"))]
)
def test_natural_frequencies(held, order, point_scene, discrete_operator):
    """√ of the eigenvalues of the ∇⁴ that the default path computes, against a Ritz solution.

    Second order with 26 and 51 nodes, within 0.7 % on the finer (the fifth of CCCC, with three half-waves on a side,
    is off by 0.61 %). Fourth with 13 and 26, within 5e-4; a finer grid would show the table's last digit, 1e-6 to 3e-6.
    Between coarse grids some of its slopes are still on their way to 4, see test_operator.py.
    """
    exact = published_eigenvalues(held)
    names = {"S": "supported", "C": "clamped"}
    cells, errors = {2: (25, 50), 4: (12, 25)}[order], []
    for count in cells:
        side = 0.2
        matrix = discrete_operator(
            point_scene((count + 1, count + 1), (side, side), [names[edge] for edge in held], order=order)
        )
        values = scipy.sparse.linalg.eigsh(matrix, k=6, sigma=0, which="LM", return_eigenvectors=False)
        errors.append(np.abs(side**2 * np.sqrt(np.sort(values)) - exact) / exact)
    assert np.max(errors[-1]) < {2: 0.007, 4: 5e-4}[order]
    orders = observed_orders(1 / np.array(cells), errors)
    np.testing.assert_allclose(orders[-1], order, atol={2: 0.1, 4: 0.35}[order])


def test_exact_transient_solves_its_equation():
    """The series itself: ρH q̈ + c q̇ + Dk⁴ q = Re(Z e^{iωt}) by central differences of h = 1e-6 s, and rest
    at t = 0."""
    stiffness, density, viscous, pressure, frequency = 4e5, 0.5, 40.0, 0.3 - 1.1j, 130.0
    h, t = 1e-6, np.linspace(0.001, 0.02, 50)

    def q(time):
        return mode_amplitude(np.asarray(time), stiffness, density, viscous, pressure, frequency)

    left = (
        density * (q(t + h) - 2 * q(t) + q(t - h)) / h**2
        + viscous * (q(t + h) - q(t - h)) / (2 * h)
        + stiffness * q(t)
    )
    load = (pressure * np.exp(2j * math.pi * frequency * t)).real
    # Differences of order h² (1e-7 relative) and rounding of 1e-16·q/h² (1e-4·q, q some 1e-6).
    np.testing.assert_allclose(left, load, atol=1e-3)
    assert q(0.0) == pytest.approx(0, abs=1e-18)
    assert (q(h) - q(-h)) / (2 * h) == pytest.approx(0, abs=1e-9)


def test_too_strong_damping_is_refused():
    with pytest.raises(ValueError, match="viscous = 5000"):
        mode_amplitude(np.array(0.1), 4e5, 0.5, 5000.0, 1.0, 130.0)
