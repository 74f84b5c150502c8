"""Loads and regions by moments: the moments that the weights keep, and the order of a plate that uses them."""

import math

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.accuracy.reference_solution import solve_response
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import moments, overlap
from warp_plate.solve.response import measure_response

LENGTH = 0.3
POWERS = np.arange(4)


def exact_moments(low, high):
    """Return (4,) integrals of (x/length)^k from low to high [m]."""
    return LENGTH * ((high / LENGTH) ** (POWERS + 1) - (low / LENGTH) ** (POWERS + 1)) / (POWERS + 1)


@pytest.mark.parametrize("nodes", [5, 12, 27, 201])
def test_moments_up_to_the_third_are_kept(nodes, random):
    """Anywhere, at both edges, within a cell, from node to node, and over the whole side; nothing beyond the plate."""
    positions = np.linspace(0, LENGTH, nodes)
    spacing = positions[1]
    low = random.uniform(0, LENGTH - spacing / 5, (20, 1))
    sides = np.vstack(
        [
            np.sort(random.uniform(0, LENGTH, (50, 2))),
            np.hstack([low, low + random.uniform(0, spacing / 5, (20, 1))]),
            [(0, LENGTH), (0, 0.41 * LENGTH), (0.37 * LENGTH, LENGTH), (0.1 * spacing, 0.3 * spacing)],
            [(LENGTH - 0.6 * spacing, LENGTH - 0.2 * spacing), (positions[1], positions[3])],
        ]
    )
    kept = [spacing * (positions / LENGTH) ** POWERS[:, None] @ moments(positions, *side) for side in sides]
    np.testing.assert_allclose(kept, [exact_moments(*side) for side in sides], rtol=0, atol=1e-14 * LENGTH)
    for weigh in (moments, overlap):
        np.testing.assert_array_equal(weigh(positions, -0.1, 0.07), weigh(positions, 0.0, 0.07))
        np.testing.assert_array_equal(weigh(positions, 0.11, 0.5), weigh(positions, 0.11, LENGTH))
        assert not weigh(positions, 0.12, 0.12).any()


def test_energies_are_of_fourth_order(scene):
    """The energies of plate and target under all drives, transient included, against the modal solution.

    The window ends at whole steps; Δt ∝ h², so that the error of the steps falls as h⁴ too. Actuators end between
    nodes, where the constant of h⁴ changes with the grid: over four pairs of grids the slopes wandered from 2.8 to 4.5.
    """
    areas, counts = [(0.043, 0.062, 0.037, 0.081), (0.121, 0.157, 0.103, 0.144)], (24, 48)
    start, end = 0.005, 0.01
    held = "supported", "clamped", "clamped", "supported"
    wanted = {"edges": held, "damping": 88.5, "order": 4, "load": "moments", "actuators": areas, "window": (start, end)}
    plate = scene(modal_density=1.0, **wanted)
    exact = solve_response(plate, 1.3)[1].matrices
    errors = []
    for cells in counts:
        nodes = (cells + 1, cells + 1)
        steps = math.ceil(start / (0.9 * make_scheme(scene(nodes, **wanted)).limit))
        solver = PlateSolver(scene(nodes, time_step=start / steps, **wanted), "cpu")
        errors.append(np.linalg.norm(measure_response(solver).matrices - exact, axis=(1, 2)))
    slopes = np.log(errors[0] / errors[1]) / math.log(counts[1] / counts[0])
    assert slopes.min() > 3.2
    assert slopes.max() < 5.2
    assert (errors[1] < 2e-3 * np.linalg.norm(exact, axis=(1, 2))).all()
