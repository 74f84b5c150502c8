"""Gram matrices of the modal plate, against the limits of the source paper's scene and each other."""

import numpy as np
import pytest
from conftest import MATERIAL, scene_of

from warp_plate import Scene
from warp_plate.modal.energy import gram_matrices
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.motion import unit_motion
from warp_plate.solve.response import Response


def matrices(plate, window, **options):
    scene = plate.scene
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    frequency = np.full((1, len(scene.actuators)), scene.drive.frequency)
    return gram_matrices(plate, regions, plate.actuator_forces()[None], frequency, window, **options)[0]


def test_paper_scene_reaches_its_limit():
    """The limits are those of a Ritz method with 40 functions a side."""
    scene = Scene.load("paper")
    response = Response(matrices(solve_modes(scene), scene.window))
    energy = response.energy(np.eye(4))
    assert energy[0, 1] / energy[0, 0] == pytest.approx(0.586298, rel=1e-5)
    assert response.bound() == pytest.approx(0.654001, rel=1e-5)


def test_late_window_is_steady():
    """E ∝ ω² U: steady rates are iω times steady displacements, and free motion has died away."""
    scene = Scene.load("paper")
    plate = solve_modes(scene)
    period = 1 / scene.drive.frequency
    late = scene.window.model_copy(update={"start": 2.0, "end": 2.0 + 20 * period})
    steady = matrices(plate, None)
    assert np.allclose(matrices(plate, late), steady, rtol=1e-7, atol=1e-9 * steady.max())
    omega = 2 * np.pi * scene.drive.frequency
    assert np.allclose(matrices(plate, None, quantity="displacement") * omega**2, steady, rtol=1e-12)


@pytest.mark.parametrize("damping", [0.0, 1.0], ids=["undamped at resonance", "critical"])
def test_energy_where_exponentials_cancel(damping):
    """Means over times of the motion itself, of a plate driven at its first natural frequency."""
    edges = ("supported",) * 4
    first = solve_modes(scene_of(edges=edges), density=0.6)
    viscous = 2 * damping * first.angular_frequencies[0] * MATERIAL["density"] * MATERIAL["thickness"]
    scene = scene_of(edges=edges, damping=viscous, frequency=float(first.frequencies[0]))
    plate = solve_modes(scene, density=0.6)
    window, outputs = plate.scene.window, np.eye(len(plate.frequencies))
    breaks = np.linspace(window.start, window.end, 150)
    points, weights = np.polynomial.legendre.leggauss(5)
    half = np.diff(breaks)[:, None] / 2
    motion = unit_motion(plate, outputs, (breaks[:-1, None] + half * (1 + points)).ravel(), velocity=True)
    mean = (motion[:, 0].real ** 2).sum(axis=0) @ (half * weights).ravel() / (window.end - window.start)
    assert matrices(plate, window)[0, 0, 0] == pytest.approx(mean / 2, rel=2e-5)
