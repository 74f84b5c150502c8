"""The sine series of supported plates under patches, against its equation, quadrature, and its bounds."""

import math

import numpy as np
import pytest
from numpy.polynomial import legendre

from support import series
from warp_plate import Scene, SceneError
from warp_plate.effects.table import Effects

DRIVE = np.array([1, 0.3 - 0.4j, 0, 0.2j])
X, Y = np.linspace(0, 0.2, 8), np.linspace(0, 0.2, 11)


def paper_plate(viscous=112.0, window=(0.05, 0.1), **changes):
    """The paper's supported plate; its first mode is critically damped at 75.45 N·s/m³."""
    scene = Scene.load("paper-supported")
    update = {
        "effects": Effects.model_validate({"damping": {"viscous": viscous}}),
        "window": scene.window.model_copy(update=dict(zip(("start", "end"), window, strict=True))),
    }
    return scene.model_copy(update={**update, **changes})


@pytest.mark.parametrize("viscous", [0.0, 40.0, 2 * math.sqrt(4e5 * 0.5), 2000.0])
def test_motion_solves_its_equation(viscous):
    """ρH q̈ + c q̇ + Dk⁴ q = Re(Z e^{iωt}), from rest, for weak, critical and strong damping."""
    stiffness, density, pressure, frequency = 4e5, 0.5, 0.3 - 1.1j, 130.0
    h, t = 1e-6, np.linspace(0.0, 0.02, 50)

    def motion(time, derivative=0):
        return series.damped_motion(time, stiffness, density, viscous, pressure, frequency, derivative)

    change = (motion(t + h, 1) - motion(t - h, 1)) / (2 * h)
    left = density * change + viscous * motion(t, 1) + stiffness * motion(t)
    load = (pressure * np.exp(2j * math.pi * frequency * t)).real
    np.testing.assert_allclose(left, load, atol=1e-5)
    np.testing.assert_allclose(motion(t, 1), (motion(t + h) - motion(t - h)) / (2 * h), atol=1e-8)
    assert motion(0.0) == pytest.approx(0, abs=1e-18)
    assert motion(0.0, 1) == pytest.approx(0, abs=1e-15)


def test_pressures_add_up_to_the_patches():
    """Their series is p inside the patches and zero outside; Parseval: ab/4 Σ|Z|² = ∫|p|² dA from below."""
    scene = paper_plate()
    for terms, share in ((50, 0.85), (400, 0.98)):
        pressures = series.patch_pressures(scene, DRIVE, terms)
        power = 0.04 / 4 * np.sum(np.abs(pressures) ** 2)
        exact = 0.012**2 * np.sum(np.abs(DRIVE) ** 2)
        assert share * exact < power < exact
    sines = np.sin(np.outer(np.arange(1, 401) * math.pi / 0.2, np.array([0.036, 0.1, 0.164])))
    field = sines.T @ pressures @ sines
    np.testing.assert_allclose(field[::2, ::2], [[1, 0], [0.3 - 0.4j, 0.2j]], atol=0.15)
    np.testing.assert_allclose(field[1], 0, atol=0.02)


def test_energies_are_integrals_of_the_mean_square_velocity():
    """½ρH ∫ v² dA over the plate and over the target, by Gauss's rule in space and in time; the plate's from below."""
    scene = paper_plate(window=(0.002, 0.006))
    energies = series.kinetic_energies(scene, DRIVE, terms=8)
    times = np.linspace(0.002, 0.006, 8001)
    s, weights = legendre.leggauss(24)
    for half, energy in zip((0.1, 0.05), energies, strict=True):
        points = half + half * s
        squares = series.displacement(scene, DRIVE, (times[1:] + times[:-1]) / 2, points, points, 8, 1) ** 2
        assert energy == pytest.approx(0.25 * half**2 * weights @ squares.mean(axis=0) @ weights, rel=1e-5)
    assert energies[0] < series.kinetic_energies(scene, DRIVE, terms=16)[0]


def test_refusals():
    with pytest.raises(SceneError, match="needs all four supported"):
        series.displacement(Scene.load("paper"), DRIVE, [0.01], X, Y)
