"""Radiated sound: pistons and supported plates against closed forms, interpolation, power far away, reciprocity."""

import math

import numpy as np
import pytest
import scipy

from support.pistons import rigid_motion
from support.scenes import refused, scene_of
from support.scenes_of_outlines import outlined
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Air, FarField, Radiation, pressures

AIR = Air()
POINTS = np.array([(0.3, -0.1, 0.8), (0.1, 0.12, 0.05)])


@pytest.fixture(scope="module")
def disc():
    """The modes of a free disc."""
    return solve_modes(outlined({"disc": (0.1, 0.1, 0.1)}, "free"), highest=0.0, count=3)


@pytest.mark.parametrize("frequency", [20.0, 900.0, 4000.0])
def test_a_disc_has_rayleigh_s_resistance(disc, frequency):
    moved = rigid_motion(disc, [(0.1, 0.1), (0.15, 0.1), (0.1, 0.17), (0.03, 0.08)])
    argument = 2 * AIR.wavenumber(frequency) * 0.1
    expected = AIR.density * AIR.sound_speed * math.pi * 0.01 * (1 - 2 * scipy.special.j1(argument) / argument)
    resistance = moved @ Radiation(disc, frequency).resistances(np.array([frequency]))[0] @ moved
    assert resistance == pytest.approx(expected, rel=1e-6)


def test_a_disc_s_pressure_on_its_axis(disc):
    moved = rigid_motion(disc, [(0.1, 0.1), (0.15, 0.1), (0.1, 0.17), (0.03, 0.08)])
    heights, frequency = np.array([0.1, 0.7]), 3000.0
    points = np.column_stack([np.full((2, 2), 0.1), heights])
    k, omega = AIR.wavenumber(frequency), 2 * math.pi * frequency
    expected = (
        AIR.density
        * AIR.sound_speed
        * 1j
        * omega
        * (np.exp(-1j * k * heights) - np.exp(-1j * k * np.hypot(heights, 0.1)))
    )
    found = pressures(disc, np.array([frequency]), moved[None, :, None], points)[0, :, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def wallace(numbers, size, k):
    """Return the radiation efficiency of a mode of a supported plate by the integral of C. E. Wallace (J. Acoust. Soc.
    Am. 51, 1972, p. 946)."""
    (m, n), (a, b) = numbers, size

    def density(theta, phi):
        alpha, beta = k * a * math.sin(theta) * math.cos(phi), k * b * math.sin(theta) * math.sin(phi)
        one = (math.cos if m % 2 else math.sin)(alpha / 2) * (math.cos if n % 2 else math.sin)(beta / 2)
        other = ((alpha / (m * math.pi)) ** 2 - 1) * ((beta / (n * math.pi)) ** 2 - 1)
        return (one / other) ** 2 * math.sin(theta)

    total, _ = scipy.integrate.dblquad(density, 0, math.pi / 2, 0, math.pi / 2, epsabs=0, epsrel=1e-9)
    return 64 * k**2 * a * b / (math.pi**6 * m**2 * n**2) * total


@pytest.mark.parametrize("frequency", [150.0, 3000.0])
def test_supported_plates_have_wallace_s_efficiencies(frequency):
    made = scene_of(size=(0.3, 0.2), edges=("supported",) * 4)
    plate = solve_modes(made, highest=0.0, count=6)
    numbers = [(1, 1), (2, 1), (1, 2), (3, 1), (2, 2), (3, 2)]  # by rising frequency
    resistances = np.diag(Radiation(plate, frequency).resistances(np.array([frequency]))[0])[:6]
    mass = made.plate.density * made.plate.thickness
    expected = [wallace(pair, (0.3, 0.2), AIR.wavenumber(frequency)) for pair in numbers]
    np.testing.assert_allclose(resistances * mass / (AIR.density * AIR.sound_speed), expected, rtol=1e-6)


def test_many_frequencies_are_interpolated(random):
    plate = solve_modes(scene_of(edges=("free", "clamped", "supported", "free")), highest=0.0, count=12)
    frequencies = np.sort(random.uniform(10, 6000, 60))
    radiation, shape = Radiation(plate, 6000.0), (60, len(plate.frequencies), 2)
    resistances, moved = radiation.resistances(frequencies), random.normal(size=shape) + 1j * random.normal(size=shape)
    heard, powers = radiation.pressures(frequencies, moved, POINTS), radiation.powers(frequencies, moved)
    for index in (0, 20, 59):
        alone = Radiation(plate, frequencies[index]).resistances(frequencies[[index]])[0]
        np.testing.assert_allclose(resistances[index], alone, rtol=0, atol=1e-9 * np.abs(alone).max())
        rate = 2j * math.pi * frequencies[index] * moved[index]
        np.testing.assert_allclose(powers[index], (rate.conj() * (alone @ rate)).real.sum(axis=0) / 2, rtol=1e-9)
        exact = pressures(plate, frequencies[[index]], moved[[index]], POINTS)[0]
        np.testing.assert_allclose(heard[index], exact, rtol=0, atol=1e-12 * np.abs(exact).max())


def test_power_is_that_of_the_pressure_far_away(random):
    """On a hemisphere of 200 m radius."""
    plate = solve_modes(scene_of(edges=("clamped", "free", "supported", "clamped")), highest=0.0, count=8)
    rate = np.zeros(len(plate.frequencies), dtype=complex)
    rate[:8] = random.normal(size=8) + 1j * random.normal(size=8)
    frequency, radius = np.array([1500.0]), 200.0
    power = 0.5 * (rate.conj() @ Radiation(plate, 1500.0).resistances(frequency)[0] @ rate).real
    heights, shares = np.polynomial.legendre.leggauss(16)
    heights, shares = (heights + 1) / 2, shares / 2
    azimuth = 2 * math.pi * np.arange(32) / 32
    sine = np.sqrt(1 - heights**2)
    x, y = radius * np.outer(sine, np.cos(azimuth)).ravel(), radius * np.outer(sine, np.sin(azimuth)).ravel()
    width, height = plate.scene.plate.size
    points = np.column_stack([x + width / 2, y + height / 2, np.repeat(radius * heights, 32)])
    amplitudes = rate / (2j * math.pi * frequency)
    pressure = pressures(plate, frequency, amplitudes[None, :, None], points)[0, :, 0]
    intensity = np.abs(pressure) ** 2 / (2 * AIR.density * AIR.sound_speed)
    assert intensity.reshape(16, 32).mean(axis=1) @ shares * 2 * math.pi * radius**2 == pytest.approx(power, rel=1e-4)
    field = FarField(plate, 60.0).at(AIR.wavenumber(frequency)[0], np.repeat(sine, 32), np.tile(azimuth, 16)) @ rate
    expected = frequency[0] * AIR.density * np.abs(field) / radius
    np.testing.assert_allclose(np.abs(pressure), expected, rtol=2e-3, atol=2e-3 * expected.max())


def test_pressure_by_a_force_is_the_velocity_by_a_source():
    """The pressure at a point by a force on the plate is the velocity there by a volume velocity at the point.

    The source presses on the baffled plate with twice its free pressure, integrated here by Gauss's rule.
    """
    plate = solve_modes(scene_of(edges=("clamped", "free", "supported", "clamped")), highest=0.0, count=12)
    frequency, pushed, heard = 700.0, (0.07, 0.11), np.array([0.15, 0.02, 0.4])
    omega = 2 * math.pi * frequency
    compliance = 1 / ((2 * math.pi * plate.frequencies) ** 2 * (1 + 0.05j) - omega**2)
    moved = plate.at_points([pushed])[:, 0] * compliance
    pressure = pressures(plate, np.array([frequency]), moved[None, :, None], heard[None])[0, 0, 0]
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x, y = ((nodes + 1) / 2 * side for side in plate.scene.plate.size)
    places = np.column_stack([part.ravel() for part in np.meshgrid(x, y, indexing="ij")])
    areas = np.outer(weights, weights).ravel() / 4 * math.prod(plate.scene.plate.size)
    distances = np.linalg.norm(np.column_stack([places, np.zeros(len(places))]) - heard, axis=1)
    source = 1j * omega * AIR.density * np.exp(-1j * AIR.wavenumber(frequency) * distances) / (2 * math.pi * distances)
    velocity = 1j * omega * (moved @ (plate.at_points(places) @ (-areas * source)))
    assert abs(pressure) > 0
    np.testing.assert_allclose(velocity, -pressure, rtol=1e-6)


def test_points_beside_or_too_near_the_plate_are_refused():
    plate = solve_modes(scene_of(), highest=0.0, count=3)
    still = np.zeros((1, len(plate.frequencies), 1))
    message = refused(pressures, plate, np.array([100.0]), still, np.array([[0.1, 0.1, 0.5], [0.1, 0.1, 1e-4]]))
    assert "points[1] = 0.1,0.1,0.0001: must lie in front of the plate" in message
