"""Energies where exponentials nearly cancel, decay fast or have died away, against means of the motion over time."""

import numpy as np
import pytest

from support.scenes import MATERIAL, scene_of
from warp_plate.modal.energies import ModalEnergies
from warp_plate.modal.gram import Means, gram_matrices
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.motion import modal_motion
from warp_plate.modal.slopes import energy_slopes
from warp_plate.optimize.quadratic import quadratic_forms

FREE, SUPPORTED = {"edges": ("free",) * 4}, {"edges": ("supported",) * 4}
ABRUPT, EARLY = {"start": 0.0, "duration": 0.004}, {"start": 0.0, "ramp": 0.001, "duration": 0.004}
PHASORS, DENSITY = np.array([[1.0, 0.5j, -0.3]]), 0.5
CASES = {
    "undamped, free": {**FREE, "window": (0.02, 0.04)},
    "lightly damped, free": {**FREE, "damping": 1.0},
    "at resonance": {**SUPPORTED, "frequency": "first"},
    "critically damped": {**SUPPORTED, "damping": "critical"},
    "overdamped": {"damping": 1e5},
    "burst, overdamped": {"damping": 1e5, "burst": ABRUPT, "window": (0.002, 0.012)},
    "burst at resonance": {**SUPPORTED, "frequency": "first", "burst": EARLY},
    "long after a burst": {"damping": 88.3, "burst": EARLY, "window": (0.1, 0.12)},
    "displacements between corners": {"damping": 88.3, "burst": EARLY, "window": (0.001, 0.004)},
}


def plate_of(frequency=290.0, damping=None, burst=None, **tables):
    """Return the modes of a scene; its frequency or damping may be that of the first mode."""
    if "first" in (frequency, damping) or damping == "critical":
        first = solve_modes(scene_of(edges=tables["edges"]), density=DENSITY)
        frequency = float(first.frequencies[0]) if frequency == "first" else frequency
        if damping == "critical":
            damping = 2 * first.angular_frequencies[0] * MATERIAL["density"] * MATERIAL["thickness"]
    drive = {"drive": {"frequency": frequency, "burst": burst}} if burst else {}
    return solve_modes(scene_of(frequency=frequency, damping=damping, **drive, **tables), density=DENSITY)


def mean_over_time(plate, regions, corners=(), velocity=True):
    """Return the mean energies (regions,) of the motion, by Gauss's rule on panels that narrow towards corners [s]."""
    window, points = plate.scene.window, np.polynomial.legendre.leggauss(8)
    narrow = [corner + np.geomspace(1e-7, 1e-4, 20) for corner in (0.0, *corners)]
    breaks = np.concatenate([np.linspace(window.start, window.end, 300), *narrow, corners])
    breaks = np.unique(breaks[(breaks >= window.start) & (breaks <= window.end)])
    half = np.diff(breaks)[:, None] / 2
    times = (breaks[:-1, None] + half * (1 + points[0])).ravel()
    rates = modal_motion(plate, PHASORS, times, velocity)[:, 0]
    weights = (half * points[1]).ravel() / (window.end - window.start) / 2
    return np.array([((rates * (region @ rates)).sum(axis=0) * weights).sum() for region in regions])


@pytest.mark.parametrize("name", CASES)
def test_energies_are_means_over_time(name):
    plate = plate_of(**CASES[name])
    scene, regions = plate.scene, [plate.kinetic_matrix(), plate.kinetic_matrix(plate.scene.target)]
    frequency, forces = np.full((1, 3), scene.drive.frequency), plate.actuator_forces()[None]
    settings = frequency, np.array([[actuator.area for actuator in scene.actuators]]), np.zeros((1, 3))
    quantity = "displacement" if "displacements" in name else "velocity"
    energies = ModalEnergies(plate, regions, quantity)
    means = Means(plate, regions, scene.window, quantity == "velocity")
    found = [
        quadratic_forms(gram_matrices(means, forces, frequency)[0], PHASORS)[0],
        energies.slopes(PHASORS, *settings).energy[0],
        energies.values(PHASORS, *settings)[0],
    ]
    corners = () if scene.drive.burst is None else (0.001, 0.003, 0.004)
    exact = mean_over_time(plate, regions, corners, quantity == "velocity")
    assert np.allclose(found, exact, rtol=5e-5, atol=0)


def test_slopes_where_a_mode_is_not_excited():
    """An actuator in the middle excites no mode that is odd there, but one beside it does."""
    plate = solve_modes(scene_of(damping=20.0, actuators=[(0.09, 0.11, 0.04, 0.06)]), density=DENSITY)
    means = Means(plate, [plate.kinetic_matrix(plate.scene.target)], plate.scene.window)
    area, step = np.array(plate.scene.actuators[0].area), 1e-5

    def slopes_at(shift):
        return energy_slopes(means, np.ones((1, 1)), np.full((1, 1), 290.0), (area + shift)[None, None])

    sideways = np.array([1.0, 1.0, 0.0, 0.0])
    difference = (slopes_at(step * sideways).energy - slopes_at(-step * sideways).energy) / (2 * step)
    assert slopes_at(0 * sideways).centre[0, 0, 0, 0] == pytest.approx(difference[0, 0], rel=1e-4)
