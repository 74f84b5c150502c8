"""The shear layer against the exact modes of a supported plate: ρHω² = Dk⁴ + Gk², k² = (mπ/a)² + (nπ/b)²."""

import math

import numpy as np
import pytest

from warp_plate.modal.continuous_modes import continuous_modes
from warp_plate.plate.modes import natural_modes
from warp_plate.reference.numpy_plate import run_moment_form
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver

WIDTH, HEIGHT, STIFFNESS = 0.2, 0.12, 400.0


def panel(**tables):
    return Scene.from_tables({
        "plate": {"size": [WIDTH, HEIGHT], "thickness": 7e-4, "young_modulus": 7e9, "poisson_ratio": 0.3,
                  "density": 1500.0},
        "edges": dict.fromkeys(("left", "right", "bottom", "top"), "supported"),
        "grid": {"nodes": [21, 17]},
        "window": {"start": 2e-3, "end": 4e-3},
        "drive": {"frequency": 300.0},
        "target": {"area": [0.0, 0.1, 0.0, 0.06]},
        "effects": {"shear_layer": {"stiffness": STIFFNESS}},
        "actuators": [{"name": "a", "area": [0.02, 0.05, 0.03, 0.06]}],
        **tables,
    })  # fmt: skip


def exact_frequencies(scene, count):
    squares = np.add.outer((np.arange(1, 9) * math.pi / WIDTH) ** 2, (np.arange(1, 9) * math.pi / HEIGHT) ** 2).ravel()
    plate = scene.plate
    stiffness = plate.rigidity * squares**2 + STIFFNESS * squares
    return np.sort(np.sqrt(stiffness / (plate.density * plate.thickness)) / (2 * math.pi))[:count]


def test_modes_are_exact():
    scene = panel()
    np.testing.assert_allclose(continuous_modes(scene, 8).frequencies, exact_frequencies(scene, 8), rtol=1e-8)
    assert exact_frequencies(scene, 1) > 1.05 * continuous_modes(panel(effects={}), 1).frequencies


def test_modes_of_the_grid_converge_to_second_order():
    scene = panel()
    errors = [
        abs(natural_modes(panel(grid={"nodes": nodes}), 1).frequencies[0] / exact_frequencies(scene, 1)[0] - 1)
        for nodes in ([21, 13], [41, 25])
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_time_steps_are_those_of_the_plain_matrices():
    scene, drives = panel(grid={"nodes": [21, 17], "precision": "float64"}), np.array([[1.0 + 0.5j], [2.0j]])
    np.testing.assert_allclose(
        PlateSolver(scene, "cpu").run(drives).energy, run_moment_form(scene, drives).energy, rtol=1e-10
    )
