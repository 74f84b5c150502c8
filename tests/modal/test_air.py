"""The load of air: added masses and radiation losses against closed forms, the balance of energy, what is refused."""

import math

import numpy as np
import pytest
import scipy

from support.pistons import rigid_motion
from support.scenes import refused, scene_of
from support.scenes_of_outlines import outlined
from warp_plate import frf
from warp_plate.modal.air import Shapes, Waves
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Air, Radiation, air_of
from warp_plate.problem.methods import resolve_search
from warp_plate.problem.problem import make_problem

AIR = Air()
POINTS = [(0.05, 0.05), (0.15, 0.05), (0.1, 0.09), (0.03, 0.08)]
SUPPORTED = {"edges": ("supported",) * 4, "size": (0.3, 0.2)}


def piston_mass(plate, wavenumber):
    """Return the added mass per density [m³] of the rigid motion u = 1 of a free plate."""
    rigid = np.flatnonzero(plate.frequencies == 0)
    shapes = Shapes(plate.scene, plate.space, plate.frequencies[rigid], plate.vectors[:, rigid])
    moved = rigid_motion(plate, POINTS)[rigid]
    return moved @ Waves(shapes).masses_per_density(wavenumber) @ moved


def test_a_square_piston_has_its_added_mass():
    """∫∫ 1/r over a unit square and itself is (4/3)(1 − √2 + 3 ln(1 + √2))."""
    plate = solve_modes(scene_of(edges=("free",) * 4), highest=0.0, count=3)
    exact = 0.2**3 * (4 / 3) * (1 - math.sqrt(2) + 3 * math.log(1 + math.sqrt(2))) / (2 * math.pi)
    assert piston_mass(plate, 0.0) == pytest.approx(exact, rel=1e-7)


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.2, 0.16), (0.3, 0.1)])
@pytest.mark.parametrize("wavenumber", [0.5, 5.0, 20.0, 50.0])
def test_a_rectangular_piston_has_rayleigh_s_impedance(size, wavenumber):
    """It is ρck/2π ∫∫∫∫ (sin kr + i cos kr)/r, over the distances of all pairs of points."""
    plate = solve_modes(scene_of(edges=("free",) * 4, size=size), highest=0.0, count=3)
    frequency = wavenumber * AIR.sound_speed / (2 * math.pi)
    moved = rigid_motion(plate, POINTS)
    resistance = moved @ Radiation(plate, frequency).resistances(np.array([frequency]))[0] @ moved
    omega = 2 * math.pi * frequency
    found = resistance + 1j * omega * AIR.density * piston_mass(plate, wavenumber)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    nodes, weights = (nodes + 1) / 2, weights / 2
    total = 0.0
    for one, other in (size, size[::-1]):  # polar coordinates on both sides of the diagonal
        angles = math.atan2(other, one) * nodes
        longest = one / np.cos(angles)
        r, by = np.outer(longest, nodes), np.outer(math.atan2(other, one) * weights * longest, weights)
        pairs = (one - r * np.cos(angles)[:, None]) * (other - r * np.sin(angles)[:, None])
        total = total + 4 * (by * pairs * 1j * np.exp(-1j * wavenumber * r)).sum()
    expected = AIR.density * AIR.sound_speed * wavenumber / (2 * math.pi) * total
    assert abs(found / expected - 1) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("wavenumber", [0.5, 20.0, 50.0])
def test_a_disc_has_rayleigh_s_reactance(wavenumber):
    plate = solve_modes(outlined({"disc": (0.1, 0.1, 0.1)}, "free"), highest=0.0, count=3)
    x = 2 * wavenumber * 0.1
    exact = math.pi * 0.01 * scipy.special.struve(1, x) * 2 / (x * wavenumber)
    assert piston_mass(plate, wavenumber) == pytest.approx(exact, rel=2e-4)


def sine_load(numbers, size, k):
    """Return ∫∫ φφ' cos(kr)/r and ∫∫ φφ' sin(kr)/r [m³] of the shape sin(mπx/a) sin(nπy/b), from the correlations of
    sines."""

    def correlation(number, side, shift):
        turn = number * math.pi / side
        return ((side - shift) * math.cos(turn * shift) + math.sin(turn * shift) / turn) / 2

    def part(wave, angle, r):
        x, y = r * math.cos(angle), r * math.sin(angle)
        return correlation(numbers[0], size[0], x) * correlation(numbers[1], size[1], y) * wave(k * r)

    corner = math.atan2(size[1], size[0])
    total = []
    for wave in (math.cos, math.sin):
        values = [
            scipy.integrate.dblquad(lambda r, angle, wave=wave: part(wave, angle, r), low, high, 0, end, epsrel=1e-9)[0]
            for low, high, end in (
                (0, corner, lambda angle: size[0] / math.cos(angle)),
                (corner, math.pi / 2, lambda angle: size[1] / math.sin(angle)),
            )
        ]
        total.append(4 * sum(values))
    return total


def test_resonances_in_air_are_those_of_one_mode():
    """In thin air, whose coupling of modes counts to second order."""
    thin = 0.01
    plate = solve_modes(scene_of(**SUPPORTED, effects={"air": {"density": thin, "sides": "front"}}), highest=60.0)
    panel = plate.scene.plate
    mass = panel.density * panel.thickness * panel.size[0] * panel.size[1] / 4
    frequencies, widths = plate.resonances
    for index, numbers in ((0, (1, 1)), (1, (2, 1)), (3, (3, 1))):
        frequency = frequencies[index]
        real, imaginary = sine_load(numbers, panel.size, AIR.wavenumber(frequency))
        added = thin * real / (2 * math.pi) / mass
        resistance = frequency * thin * imaginary / mass
        assert frequency == pytest.approx(plate.frequencies[index] / math.sqrt(1 + added), rel=1e-6)
        assert 4 * math.pi * widths[index] == pytest.approx(resistance / (1 + added), rel=5e-3)


def test_masses_of_modes_are_those_of_sines():
    plate = solve_modes(scene_of(**SUPPORTED), highest=0.0, count=5)
    shapes = Shapes(plate.scene, plate.space, plate.frequencies[:4], plate.vectors[:, :4])
    panel = plate.scene.plate
    mass = panel.density * panel.thickness * panel.size[0] * panel.size[1] / 4
    for k in (0.0, 15.0):
        masses = np.diag(Waves(shapes).masses_per_density(k))
        for index, numbers in ((0, (1, 1)), (1, (2, 1)), (3, (3, 1))):
            expected = sine_load(numbers, panel.size, k)[0] / (2 * math.pi) / mass
            assert masses[index] == pytest.approx(expected, rel=5e-5)


@pytest.mark.parametrize(("density", "damping"), [(1.204, 0.5), (30.0, 0.5), (30.0, 300.0)])
def test_what_goes_in_is_lost_or_radiated(density, damping):
    """A strong damper couples more modes than refinement follows."""
    oscillator = {"area": (0.1, 0.12, 0.1, 0.12), "mass": 0.005, "stiffness": 2e3, "damping": damping}
    effects = {"air": {"density": density}, "damping": {"viscous": 3.0}, "oscillators": [oscillator]}
    scene = scene_of(size=(0.3, 0.2), edges=("clamped", "supported", "free", "clamped"), modal_density=0.6,
                     effects=effects)  # fmt: skip
    plate, frequencies = solve_modes(scene), np.array([12.0, 33.0, 150.0, 170.0, 280.0])
    forces = plate.actuator_forces() @ np.array([[1.0], [0.5j], [2.0]])
    amplitudes = plate.respond(frequencies, forces)
    rates = 2j * math.pi * frequencies[:, None, None] * amplitudes
    given = (forces.conj() * rates).sum(axis=(1, 2)).real / 2
    lost = np.einsum("nal,ab,nbl->n", rates.conj(), plate.damping, rates).real / 2
    radiated = 2 * Radiation(plate, 290.0, air_of(scene)).powers(frequencies, amplitudes)[:, 0]
    assert (radiated > 1e-4 * given).all()
    np.testing.assert_allclose(lost + radiated, given, rtol=1e-8)


def test_all_modes_feel_the_masses():
    """The equation of motion holds with the masses at the frequency itself, without interpolation or modes in air."""
    effects = {"air": {"density": 12.0}, "damping": {"viscous": 5.0}}
    plate = solve_modes(scene_of(**SUPPORTED, modal_density=0.6, effects=effects))
    frequency = np.array([130.0])
    forces, omega = plate.actuator_forces(), 2 * math.pi * 130.0
    amplitudes = plate.respond(frequency, forces)[0]
    count = int((plate.frequencies <= 2 * 290.0).sum())  # modes up to twice the drive's frequency have a mass of air
    shapes = Shapes(plate.scene, plate.space, plate.frequencies[:count], plate.vectors[:, :count])
    air = air_of(plate.scene)
    masses = 2 * air.density * Waves(shapes).masses_per_density(float(air.wavenumber(130.0)))
    resistances = 2 * Radiation(plate, plate.highest, air).resistances(frequency)[0]
    balanced = (plate.angular_frequencies[:, None] ** 2 - omega**2) * amplitudes
    balanced = balanced + 1j * omega * ((plate.damping + resistances) @ amplitudes)
    balanced[:count] -= omega**2 * masses @ amplitudes[:count]
    np.testing.assert_allclose(balanced[:40], forces[:40], atol=2e-4 * np.abs(forces).max())


def test_a_search_in_air_has_another_bound():
    scene = scene_of((9, 9), modal_density=0.4, effects={"air": {"density": 10.0}, "damping": {"viscous": 5.0}})
    dry = scene.with_tables(effects={"damping": {"viscous": 5.0}}, search={"limits": {"sound": 100.0}})
    bounds = [make_problem(resolve_search(one, "cpu", evaluator="modal")).bound for one in (scene, dry)]
    assert abs(bounds[0] - bounds[1]) > 1e-3


@pytest.mark.slow
def test_curves_in_air_list_resonances_in_air():
    scene = scene_of((9, 9), modal_density=0.4, frequency=100.0, effects={"air": {"density": 5.0}})
    response = frf(scene, frequency_range=(10.0, 110.0))
    plate = solve_modes(scene, 110.0)
    frequencies = plate.resonances[0]
    shown = frequencies[(frequencies >= 10) & (frequencies <= 110)]
    np.testing.assert_allclose(response.natural_frequencies, shown, rtol=1e-9)
    assert (response.loss_factors > 0).all()
    assert shown[0] < 0.8 * plate.frequencies[0]
    near = np.abs(response.frequencies - shown[0]).argmin()
    velocity = response.mean_square_velocity[0]
    assert velocity[near] >= 0.98 * velocity[max(near - 40, 0) : near + 40].max()


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"drive": {"frequency": 260.0, "ramp": 0.01}}, "effects.air: the load of air is that of steady tones"),
        ({"effects": {"air": {}, "stretching": {}}}, "or delete effects.stretching"),
        ({"effects": {"air": {"density": -1.0}}}, "effects.air.density = -1.0: must be greater than 0"),
    ],
)
def test_what_is_refused(tables, message):
    assert message in refused(scene_of(effects={"air": {}}).with_tables, **tables)
