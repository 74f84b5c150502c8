"""Orders of accuracy: transients of a supported plate and natural frequencies, of second and of fourth order.

On the streaming path, whose kernels serve grids of any size; ``test_paths`` compares the others.
"""

import numpy as np
import pytest

from support.scenes import point_scene
from support.series import damped_motion, grid_wavenumber_squared, mode_shape, wavenumber_squared
from warp_plate import PlateSolver

SUPPORTED = ("supported",) * 4
SIZE = (0.2, 0.16)
FREQUENCY, VISCOUS, END = 290.0, 60.0, 0.012
# Several times, for the error at any one of them may happen to be near zero. All counts of steps are multiples of 12.
TIMES = END * np.array([5, 7, 8, 10, 11, 12]) / 12
# Loads that start at their largest and at zero: cos ωt, sin ωt.
DRIVES = np.array([1.0, -1.0j])


def observed_orders(spacings, errors):
    """The slopes of log error over log spacing from one run to the next; errors: (runs, ...)."""
    return (np.diff(np.log(errors), axis=0).T / np.diff(np.log(spacings))).T


def errors(nodes, steps, mode, wavenumber, order=2):
    """Return (drives,) largest errors over the largest displacements, under loads shaped like a mode.

    Args: nodes along each axis, steps, the mode, its k² as a function of the scheme, and the order.
    """
    made = point_scene(
        (nodes, nodes), SIZE, SUPPORTED, order=order, time_step=END / steps, window=(0.0, END),
        frequency=FREQUENCY, damping=VISCOUS,
    )  # fmt: skip
    shape = mode_shape(mode, SIZE, *(np.linspace(0, length, nodes) for length in SIZE))
    solver = PlateSolver(made, "cpu", "streaming")
    scheme, loads = solver.discretization.scheme, DRIVES[:, None] * shape[1:-1, 1:-1].reshape(1, -1)
    found = solver.run(loads, TIMES)
    np.testing.assert_allclose(found.times, TIMES, rtol=1e-12)
    stiffness = scheme.rigidity * wavenumber(scheme) ** 2
    amplitudes = [damped_motion(TIMES, stiffness, scheme.surface_density, VISCOUS, Z, FREQUENCY) for Z in DRIVES]
    exact = np.array(amplitudes)[..., None, None] * shape
    return np.abs(found.displacement - exact).max(axis=(1, 2, 3)) / np.abs(exact).max(axis=(1, 2, 3))


@pytest.mark.parametrize("order", [2, 4])
def test_order_in_space(order):
    """The exact transient of one sine mode, on grids with Δt ∝ h², so that the error in time falls as h⁴."""
    cells, mode = np.array([12, 24]), (1, 1) if order == 2 else (2, 1)
    found = [errors(n + 1, 240 * n**2 // 36, mode, lambda _: wavenumber_squared(mode, SIZE), order) for n in cells]
    # The next term of the error is h² times smaller, which still shows.
    assert observed_orders(1 / cells, found)[-1] == pytest.approx([order] * 2, abs=0.1)


def test_second_order_in_time():
    """A sine mode is a mode of the grid too, with its own k²: with that, only the time steps are in error."""
    counts, mode = np.array([240, 480, 960]), (2, 1)
    found = [
        errors(13, steps, mode, lambda scheme: grid_wavenumber_squared(mode, SIZE, scheme.spacing)) for steps in counts
    ]
    np.testing.assert_allclose(observed_orders(1 / counts, found), 2, atol=0.1)
