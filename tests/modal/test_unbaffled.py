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


def open_scene(density, **tables):
    effects = {"air": {"density": density, "baffle": False}, "damping": {"viscous": 3.0}, **tables}
    return scene_of(size=(0.3, 0.2), plate={**PLATE, "size": (0.3, 0.2), "thickness": 5e-4}, frequency=250.0,
                    edges=("free", "free", "supported", "free"), modal_density=0.4, effects=effects)  # fmt: skip


@pytest.mark.parametrize("density", [1.204, 20.0])
def test_what_goes_in_is_lost_or_radiated_to_both_sides(density):
    oscillator = {"area": (0.1, 0.12, 0.1, 0.12), "mass": 0.005, "stiffness": 2e3, "damping": 0.5}
    plate = solve_modes(open_scene(density, oscillators=[oscillator]))
    assert not plate.proportional
    frequencies = np.array([12.0, 33.0, 88.0, 100.0, 240.0])
    forces = plate.actuator_forces() @ np.array([[1.0], [0.5j], [2.0]])
    amplitudes = plate.respond(frequencies, forces)
    rates = 2j * math.pi * frequencies[:, None, None] * amplitudes
    given = (forces.conj() * rates).sum(axis=(1, 2)).real / 2
    lost = np.einsum("nal,ab,nbl->n", rates.conj(), plate.damping, rates).real / 2
    radiated = Unbaffled(plate, 250.0, Air(density)).powers(frequencies, amplitudes)[:, 0]
    np.testing.assert_allclose(lost + radiated, given, rtol=1e-8)


def test_modes_feel_the_jump_of_pressure():
    """The equation of motion holds with the jump that the found motion makes."""
    plate = solve_modes(open_scene(5.0))
    frequency, forces = 70.0, plate.actuator_forces()
    amplitudes, omega = plate.respond(np.array([frequency]), forces)[0], 2 * math.pi * frequency
    radiation = Unbaffled(plate, 250.0, Air(5.0))
    pressed = np.tensordot(radiation.projection, radiation.jumps(frequency, amplitudes), ((0, 1), (0, 1)))
    balanced = (plate.angular_frequencies[:, None] ** 2 - omega**2) * amplitudes
    balanced = balanced + 1j * omega * plate.damping @ amplitudes + pressed
    np.testing.assert_allclose(balanced, forces, atol=1e-8 * np.abs(forces).max())


def test_a_rigid_strip_swings_with_its_added_mass():
    """A free plate far below its resonances is a mass, that of the air of DNV-RP-C205 beside its own."""
    made = scene_of(plate={**PLATE, "size": (0.2, 0.1)}, size=(0.2, 0.1), edges=("free",) * 4, frequency=20.0,
                    effects={"air": {"density": 30.0, "baffle": False}})  # fmt: skip
    plate = solve_modes(made, 20.0)
    own, added = 2700.0 * 3e-3 * 0.02, 30.0 * 0.757 * math.pi / 4 * 0.1**2 * 0.2
    force = plate.at_points([(0.1, 0.05)])
    moved = (force.T @ plate.respond(np.array([2.0]), force)[0])[0, 0]
    assert -1 / (moved.real * (4 * math.pi) ** 2) == pytest.approx(own + added, rel=2e-3)


def test_resonances_without_a_baffle_are_peaks():
    plate = solve_modes(open_scene(5.0))
    frequencies, widths = plate.resonances
    shown = np.flatnonzero((frequencies > 5) & (frequencies < 100))
    assert (frequencies[shown] < plate.frequencies[shown]).all()
    force = plate.at_points([(0.21, 0.17)])
    for index in shown[:4]:
        near = frequencies[index] + widths[index] * np.linspace(-3, 3, 61)
        moved = np.abs(force.T @ plate.respond(near, force))[:, 0, 0]
        assert 10 < moved.argmax() < 50


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"effects": {"air": {"baffle": False, "sides": "front"}}}, 'effects.air.sides: "front", but without a baffle'),
        ({"search": {"limits": {"sound": 30.0}}}, "search.limits.sound: is the sound of a plate in a baffle"),
        (
            {
                "specification": {
                    "level": {"velocity": 1e-3},
                    "limits": {"pressures": [{"point": (0, 0, 1), "level": 9}]},
                }
            },
            "specification.limits.pressures: is the sound of a plate in a baffle",
        ),
    ],
)
def test_what_is_refused_without_a_baffle(tables, message):
    assert message in refused(scene_of(effects={"air": {"baffle": False}}).with_tables, **tables)


def test_the_sound_in_open_air_is_that_without_a_baffle():
    made = open_scene(1.204)
    found, named = (sound(made, [(0.1, 0.1, 1.0)], (248.0, 252.0), baffle=one) for one in (True, False))
    assert not found.baffle
    np.testing.assert_array_equal(found.power, named.power)
