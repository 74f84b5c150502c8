"""The sine series of supported plates under patches, against its own equation, sampling, and its bounds."""

import math

import numpy as np
import pytest
from numpy.polynomial import legendre

from warp_plate import Scene, SceneError
from warp_plate.reference import series
from warp_plate.scene.effects import Effects

DRIVE = np.array([1, 0.3 - 0.4j, 0, 0.2j])
X, Y = np.linspace(0, 0.2, 8), np.linspace(0, 0.2, 11)


def supported(viscous=112.0, window=(0.05, 0.1), **changes):
    """The paper's supported plate; its first mode is critically damped at 75.45 N·s/m³."""
    scene = Scene.load("paper-supported")
    update = {
        "effects": Effects.model_validate({"damping": {"viscous": viscous}}),
        "window": scene.window.model_copy(update=dict(zip(("start", "end"), window, strict=True))),
    }
    return scene.model_copy(update={**update, **changes})


@pytest.mark.parametrize("viscous", [0.0, 40.0, 2 * math.sqrt(4e5 * 0.5), 2000.0])
def test_motion_solves_its_equation(viscous):
    """ρH q̈ + c q̇ + Dk⁴ q = Re(Z e^{iωt}) by differences of the rate, from rest; weak, critical and strong
    damping."""
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


def test_very_strong_damping_does_not_overflow():
    """A mode that creeps for hours: q̇ = Z/c to a part in a thousand."""
    rate = series.damped_motion(np.array([0.5, 1.0]), 1.0, 1e-3, 1e6, 1.0, 1e-4, derivative=1)
    np.testing.assert_allclose(rate, 1e-6, rtol=1e-3)


def test_pressures_add_up_to_the_patches():
    """Their series is p inside the patches and zero outside; Parseval: ab/4 Σ|Z|² = ∫|p|² dA from below."""
    scene = supported()
    for terms, share in ((50, 0.85), (400, 0.98)):
        pressures = series.patch_pressures(scene, DRIVE, terms)
        power = 0.04 / 4 * np.sum(np.abs(pressures) ** 2)
        exact = 0.012**2 * np.sum(np.abs(DRIVE) ** 2)
        assert share * exact < power < exact
    orders = np.arange(1, 401)
    points = np.array([0.036, 0.1, 0.164])
    sines = np.sin(np.outer(orders * math.pi / 0.2, points))
    field = sines.T @ pressures @ sines
    np.testing.assert_allclose(field[::2, ::2], [[1, 0], [0.3 - 0.4j, 0.2j]], atol=0.15)
    np.testing.assert_allclose(field[1], 0, atol=0.02)


@pytest.mark.parametrize("terms", [16, 48])
def test_truncation_bounds_hold(terms):
    """What 400 terms add stays below the bounds, at early and late times, for weak and strong damping."""
    for viscous in (0.0, 112.0):
        scene = supported(viscous)
        bounds = series.truncation(scene, DRIVE, terms)
        for name, bound in zip(("displacement", "velocity"), bounds, strict=True):
            field = getattr(series, name)
            some, many = (field(scene, DRIVE, [1e-4, 0.003, 0.07], X, Y, count) for count in (terms, 400))
            assert 0 < np.abs(some - many).max() < bound


def test_default_terms_are_exact_enough():
    """100 terms: 300 change the displacement, 1.2e-7 m at most, by less than 1e-5 of it; the bound says 4 %."""
    scene = supported()
    assert series.truncation(scene, DRIVE, 100)[0] < 4.5e-9
    some, many = (series.displacement(scene, DRIVE, [0.003, 0.07], X, Y, count) for count in (100, 300))
    np.testing.assert_allclose(some, many, atol=1e-5 * np.abs(many).max())


def test_mean_square_velocity_by_sampling():
    """Against the mean of 40,000 equally spaced samples (whose own error, by the trapezoidal rule, is some
    1e-7)."""
    scene = supported(window=(0.001, 0.006))
    found = series.mean_square_velocity(scene, DRIVE, X, Y, terms=8)
    edges = np.linspace(0.001, 0.006, 40_001)
    sampled = (series.velocity(scene, DRIVE, (edges[1:] + edges[:-1]) / 2, X, Y, terms=8) ** 2).mean(axis=0)
    np.testing.assert_allclose(found, sampled, atol=1e-6 * sampled.max())


def test_energies_are_integrals_of_the_mean_square():
    """½ρH ∫ v² dA over the plate and over the target, by Gauss's rule on the field."""
    scene = supported(window=(0.002, 0.01))
    energies = series.kinetic_energies(scene, DRIVE, terms=8)
    s, weights = legendre.leggauss(40)
    for half, energy in zip((0.1, 0.05), energies, strict=True):
        points = half + half * s
        mean = series.mean_square_velocity(scene, DRIVE, points, points, terms=8)
        assert energy == pytest.approx(0.25 * half**2 * weights @ mean @ weights, rel=1e-10)


def test_energies_converge_from_below():
    """The plate's energy grows with every term; the last doubling changes the share in the target by 1e-5."""
    scene = supported(window=(0.05, 0.055))
    plate, target = np.array([series.kinetic_energies(scene, DRIVE, terms) for terms in (8, 16, 32)]).T
    assert (np.diff(plate) > 0).all()
    assert abs(np.diff(target / plate)[1]) < 5e-5


def test_pressures_of_a_patch_over_the_whole_plate():
    """Odd modes only, 16p/π²mn each."""
    scene = supported()
    whole = scene.actuators[0].model_copy(update={"area": (0.0, 0.2, 0.0, 0.2)})
    pressures = series.patch_pressures(scene.model_copy(update={"actuators": (whole,)}), np.array([2j]), 6)
    orders = np.arange(1, 7)
    exact = np.where(np.outer(orders % 2, orders % 2), 32j / math.pi**2 / np.outer(orders, orders), 0)
    np.testing.assert_allclose(pressures, exact, atol=1e-13)


def test_what_is_refused():
    """Edges that the sines do not fit, and so few terms that there is no bound."""
    with pytest.raises(SceneError, match="needs all four supported"):
        series.displacement(Scene.load("paper"), DRIVE, [0.01], X, Y)
    with pytest.raises(ValueError, match="terms = 3"):
        series.truncation(supported(), DRIVE, 3)
