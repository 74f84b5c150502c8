"""Gram matrices of the modal plate, against the limits of the source paper's scene and each other."""

import numpy as np
import pytest

from warp_plate import Scene
from warp_plate.modal.gram import Means, gram_matrices, mean_exponential, mean_exponential_with_time
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.grid import Window
from warp_plate.solve.response import Response


def matrices(plate, window, velocity=True):
    scene = plate.scene
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    frequency = np.full((1, len(scene.actuators)), scene.drive.frequency)
    return gram_matrices(Means(plate, regions, window, velocity), plate.actuator_forces()[None], frequency)[0]


@pytest.fixture(scope="module")
def paper_plate():
    return solve_modes(Scene.load("paper"))


def test_paper_scene_reaches_its_limit(paper_plate):
    """The limits are those of a Ritz method with 40 functions a side."""
    response = Response(matrices(paper_plate, paper_plate.scene.window))
    energy = response.energy(np.eye(4))
    assert energy[0, 1] / energy[0, 0] == pytest.approx(0.586298, rel=1e-5)
    assert response.bound() == pytest.approx(0.654001, rel=1e-5)


def test_late_window_is_steady(paper_plate):
    """E ∝ ω² U: steady rates are iω times steady displacements, and free motion has died away."""
    plate, scene = paper_plate, paper_plate.scene
    period = 1 / scene.drive.frequency
    late = scene.window.model_copy(update={"start": 2.0, "end": 2.0 + 20 * period})
    steady = matrices(plate, None)
    assert np.allclose(matrices(plate, late), steady, rtol=1e-7, atol=1e-9 * steady.max())
    omega = 2 * np.pi * scene.drive.frequency
    assert np.allclose(matrices(plate, None, velocity=False) * omega**2, steady, rtol=1e-12)


def test_means_of_exponentials():
    """Gauss's rule, from exponents that meet, over those where the formulas' differences cancel, to fast ones."""
    window = Window(start=0.3, end=0.8)
    sizes = np.concatenate([[0], np.geomspace(1e-8, 30, 60)])
    first, second = sizes[:, None] * np.exp(1j * np.linspace(0, 2 * np.pi, 7)) + 5j, np.array([-5j])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    times = (window.start + window.end + (window.end - window.start) * nodes) / 2
    exponentials = np.exp((first + second)[..., None] * times) * weights / 2
    mean, with_time = mean_exponential_with_time(first, second, window)
    assert np.array_equal(mean, mean_exponential(first, second, window))
    assert np.allclose(mean, exponentials.sum(axis=-1), rtol=1e-11, atol=0)
    assert np.allclose(with_time, (exponentials * times).sum(axis=-1), rtol=1e-11, atol=0)
