"""Sound without a baffle: added masses of rectangles, the power of a dipole, pressure, reciprocity, refusals."""

import math

import numpy as np
import pytest

from support.scenes import refused, scene_of
from support.scenes_of_outlines import outlined
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Air
from warp_plate.modal.unbaffled import Unbaffled
from warp_plate.studies.sound import sound

AIR = Air()
PLATE = {"thickness": 3e-3, "young_modulus": 7e10, "poisson_ratio": 0.3, "density": 2700.0}


def rigid(size):
    """Return the modes of a free plate, and amplitudes (modes, 1) of the velocity 1 at the frequency 1/2π."""
    plate = solve_modes(scene_of(plate={**PLATE, "size": size}, edges=("free",) * 4, actuators=[(0.05, 0.06) * 2]),
                        highest=0.0, count=3)  # fmt: skip
    modes = np.flatnonzero(plate.frequencies == 0)
    points = np.array([(0.1, 0.2), (0.9, 0.3), (0.5, 0.8), (0.2, 0.6)]) * size
    moved = np.zeros((len(plate.frequencies), 1), dtype=complex)
    moved[modes, 0] = np.linalg.lstsq(plate.at_points(points)[modes].T, np.ones(4), rcond=None)[0]
    return plate, moved


# Coefficients of DNV-RP-C205, appendix D, by the ratio of the sides.
@pytest.mark.parametrize(("ratio", "coefficient"), [(1, 0.579), (2, 0.757), (4, 0.872)])
def test_a_rigid_rectangle_is_a_dipole_with_a_known_mass(ratio, coefficient):
    short, frequency = 0.1, 40.0
    plate, moved = rigid((ratio * short, short))
    radiation, omega = Unbaffled(plate, 400.0), 2 * math.pi * frequency
    amplitudes = moved / (1j * omega)
    force = (radiation.jumps(frequency, amplitudes)[:, :, 0] * (radiation.projection @ moved)[:, :, 0]).sum()
    mass = AIR.density * coefficient * math.pi / 4 * short**2 * ratio * short
    assert force.imag / omega == pytest.approx(mass, rel=1e-2)
    k = AIR.wavenumber(frequency)
    power = radiation.powers(np.array([frequency]), amplitudes[None])[0, 0]
    assert power == pytest.approx(k**2 * abs(force) ** 2 / (24 * math.pi * AIR.density * AIR.sound_speed), rel=5e-3)
    far = np.array([[ratio * short / 2, short / 2, 80.0], [ratio * short / 2 + 80.0, short / 2, 1.0]])
    pressure = radiation.pressures(np.array([frequency]), amplitudes[None], far)[0, :, 0]
    assert abs(pressure[0]) == pytest.approx(k * abs(force) / (4 * math.pi * 80.0), rel=2e-3)
    assert abs(pressure[1]) < 0.02 * abs(pressure[0])


def test_power_is_that_of_the_pressure_far_away(random):
    plate = solve_modes(scene_of(plate={**PLATE, "size": (0.3, 0.2)}, edges=("clamped", "free", "supported", "free")),
                        highest=0.0, count=6)  # fmt: skip
    amplitudes = np.zeros((1, len(plate.frequencies), 1), dtype=complex)
    amplitudes[0, :6, 0] = random.normal(size=6) + 1j * random.normal(size=6)
    frequency, radius = np.array([900.0]), 150.0
    radiation = Unbaffled(plate, 1000.0)
    heights, shares = np.polynomial.legendre.leggauss(14)
    heights, shares = (heights + 1) / 2, shares / 2
    azimuth, sine = 2 * math.pi * np.arange(28) / 28, np.sqrt(1 - heights**2)
    x, y = radius * np.outer(sine, np.cos(azimuth)).ravel(), radius * np.outer(sine, np.sin(azimuth)).ravel()
    points = np.column_stack([x + 0.15, y + 0.1, np.repeat(radius * heights, 28)])
    pressure = radiation.pressures(frequency, amplitudes, points)[0, :, 0]
    intensity = np.abs(pressure) ** 2 / (2 * AIR.density * AIR.sound_speed)
    both_sides = 2 * (intensity.reshape(14, 28).mean(axis=1) @ shares) * 2 * math.pi * radius**2
    assert both_sides == pytest.approx(radiation.powers(frequency, amplitudes)[0, 0], rel=1e-4)
    far = radiation.far_sound(900.0, amplitudes[0, :, 0], np.repeat(sine, 28), np.tile(azimuth, 14))
    ratio = np.abs(pressure) / np.abs(far)
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=5e-3)


@pytest.mark.slow
def test_a_small_panel_is_quieter_without_a_baffle():
    plate = {**PLATE, "size": (0.2, 0.15)}
    made = scene_of(size=(0.2, 0.15), plate=plate, damping=50.0, frequency=300.0, modal_density=0.6)
    without, baffled = (sound(made, [(0.1, 0.07, 1.0)], (250.0, 400.0), baffle=one) for one in (False, True))
    assert not without.baffle
    assert (without.power_level < baffled.power_level - 3).all()
    assert without.directivity[0, [0, -1]] == pytest.approx([-60.0, -60.0])


def test_outlines_are_refused():
    made = outlined({"disc": (0.1, 0.1, 0.1)})
    assert "plate.outline: sound without a baffle is that of rectangles" in refused(sound, made, baffle=False)
