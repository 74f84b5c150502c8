"""Coils on plates: closed forms alone, on a rigid mass and on a large plate; a dense system; energy balance."""

import math
from functools import partial

import numpy as np
import pytest
from scipy import signal, special

from support.coils import COILS, EXCITER, FREE, SPRUNG, dense_motion, panel
from support.scenes import refused, scene_of
from support.series import patch_pressures, supported_plate
from warp_plate import Scene
from warp_plate.effects.coil import catalogue
from warp_plate.modal.energies import ModalEnergies
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Radiation, air_of
from warp_plate.plate.designs import scene_phasors

# Stiffer than any plate, and so light that it is rigid up to much higher frequencies.
RIGID = {"size": (0.2, 0.2), "thickness": 0.04, "young_modulus": 1e13, "poisson_ratio": 0.3, "density": 1.0}
SOFT = {"suspension_stiffness": 27.0}
FREQUENCIES = np.geomspace(5.0, 60.0, 30)


def on_rigid_plate(edge, **keys):
    """Return a coil in the middle of a plate with four equal edges."""
    coil = {"name": "0", **EXCITER, **SOFT, **keys, "disc": (0.1, 0.1, 0.03)}
    return scene_of(size=(0.2, 0.2), edges=(edge,) * 4, plate=RIGID).with_tables(actuators=[coil])


def blocked(omega, resistance=3.5):
    """Return the impedance [Ω] of the coil of EXCITER at rest."""
    return resistance + 3e-4 * omega**0.82 + 1j * 1.3e-3 * omega**0.74


def test_a_coil_on_a_plate_that_is_held_swings_alone():
    omega = 2 * math.pi * FREQUENCIES
    made = on_rigid_plate("clamped", **FREE)
    impedance, _ = solve_modes(made, 100.0).coils.impedance(omega)
    mobility = 1j * omega / (27.0 + 0.1j * omega - 0.05 * omega**2)
    np.testing.assert_allclose(impedance[:, 0, 0], blocked(omega) + 4.2**2 * mobility, rtol=1e-8)


@pytest.mark.parametrize("magnet", [{}, FREE, SPRUNG])
def test_a_coil_on_a_rigid_mass(magnet):
    """A free plate, the moving mass of the coil and its magnet are masses on springs."""
    omega, mass = 2 * math.pi * FREQUENCIES, 0.04 * 0.2**2 + 1.6e-3
    plate = solve_modes(on_rigid_plate("free", **magnet), 100.0)
    between, of_plate = 27.0 + 0.1j * omega, -(omega**2) * mass
    of_magnet = magnet.get("magnet_stiffness", 0) + 1j * omega * magnet.get("magnet_damping", 0)
    of_magnet = of_magnet - omega**2 * magnet.get("magnet_mass", math.inf)
    # The current pushes both ends of the spring, in series with two masses.
    in_series = 1 / (1 / of_plate + 1 / of_magnet)
    expected = blocked(omega) + 4.2**2 * 1j * omega / (between + in_series)
    np.testing.assert_allclose(plate.coils.impedance(omega)[0][:, 0, 0], expected, rtol=1e-8)


def test_a_coil_on_a_supported_plate_has_the_impedance_of_the_sine_series():
    coil = {"name": "0", **EXCITER, "area": (0.05, 0.09, 0.06, 0.09)}
    made = scene_of(size=(0.2, 0.16), edges=("supported",) * 4, damping=30.0, modal_density=1.0).with_tables(
        actuators=[coil]
    )
    frequency = np.array([30.0, 61.0, 140.0, 333.0])
    omega, series, orders = 2 * math.pi * frequency[:, None, None], supported_plate(made), np.arange(1, 161) * math.pi
    pressed = patch_pressures(made, [1.0], 160)  # 4/ab ∫ sin sin dA over the patch
    squared = (orders / 0.2) ** 2 + (orders[:, None] / 0.16) ** 2
    dynamic = series.rigidity * squared**2 - series.surface_density * omega**2 + 1j * series.viscous * omega
    receptance = (pressed**2 * 0.2 * 0.16 / 4 / dynamic).sum(axis=(1, 2)) / (0.04 * 0.03) ** 2
    omega = omega[:, 0, 0]
    coil = 2703.0 + 0.1j * omega - 1.6e-3 * omega**2
    expected = blocked(omega) + 4.2**2 * 1j * omega / (coil + 1 / receptance)
    impedance = solve_modes(made, 1500.0).coils.impedance(omega)[0][:, 0, 0]
    np.testing.assert_allclose(impedance, expected, rtol=1e-5)


@pytest.mark.slow
def test_a_round_coil_on_a_large_damped_plate_is_near_that_of_an_infinite_one():
    """The mean receptance of a disc of radius a is 1/2πD ∫ (2 J₁(ka)/ka)² k/(k⁴ − q⁴) dk, a sum of Bessel functions;
    for a small disc that of a point, whose mobility is 1/8√(DρH) (Cremer and Heckl)."""
    tables = {"thickness": 2e-3, "young_modulus": 4e9, "poisson_ratio": 0.3, "density": 1200.0, "size": (1.5, 1.3)}
    made = scene_of(plate=tables, edges=("supported",) * 4, effects={"loss_factor": {"eta": 0.9}}, modal_density=1.0)
    made = made.with_tables(actuators=[{"name": "0", **EXCITER, "disc": (0.76, 0.66, 0.04)}])
    omega = 2 * math.pi * np.array([300.0, 400.0, 500.0])
    rigidity = made.plate.rigidity * (1 + 0.9j)

    def receptance(radius):
        q = (2.4 * omega**2 / rigidity) ** 0.25
        x = q * radius
        waves = -1j * math.pi / 4 * special.jv(1, x) * special.hankel2(1, x)
        return 2 / (math.pi * rigidity * radius**2) / q**4 * (special.iv(1, x) * special.kv(1, x) / 2 + waves - 0.5)

    np.testing.assert_allclose(1j * omega * receptance(1e-4), 1 / (8 * np.sqrt(rigidity * 2.4)), rtol=1e-4)
    expected = blocked(omega) + 4.2**2 * 1j * omega / (2703.0 + 0.1j * omega - 1.6e-3 * omega**2 + 1 / receptance(0.04))
    impedance = solve_modes(made, 500.0).coils.impedance(omega)[0][:, 0, 0]
    np.testing.assert_allclose(impedance, expected, rtol=5e-5)


@pytest.mark.slow
def test_a_square_coil_on_a_large_damped_plate_meets_that_of_an_infinite_one():
    """The receptance of a square is the mean of Green's function over the distances of its points, and its own at one
    point has the mobility 1/8√(DρH) (Cremer and Heckl)."""
    side, square = 0.8, (0.3, 0.5, 0.3, 0.5)
    tables = {"thickness": 2e-3, "young_modulus": 4e9, "poisson_ratio": 0.3, "density": 1200.0, "size": (side, side)}
    # A layer without weight: its edges are lines of the functions, which can then follow the edges of the patch.
    layer = {"area": square, "thickness": 1e-9, "young_modulus": 1.0, "density": 1e-3}
    effects = {"loss_factor": {"eta": 0.9}, "damping": {"viscous": 2e4}, "layers": [layer]}
    made = scene_of(plate=tables, edges=("supported",) * 4, effects=effects, modal_density=1.0)
    made = made.with_tables(actuators=[{"name": "0", **EXCITER, "area": square}])
    omega = 2 * math.pi * np.array([300.0, 400.0, 500.0])
    rigidity = made.plate.rigidity * (1 + 0.9j)
    waves = ((2.4 * omega**2 - 2e4j * omega) / rigidity) ** 0.25
    assert np.exp(waves.imag * (side - 0.2)).max() < 1e-7  # what comes back from the edges

    def green(q, r):
        return -1j / (8 * q**2) * (special.hankel2(0, q * r) - 2j / math.pi * special.kv(0, q * r)) / rigidity

    point = 1 / (8 * rigidity * waves[0] ** 2)
    assert abs(1j * green(waves[0], 1e-7) / point - 1) < 1e-6
    receptance = np.array([square_mean(partial(green, q), 0.2) for q in waves])
    expected = blocked(omega) + 4.2**2 * 1j * omega / (2703.0 + 0.1j * omega - 1.6e-3 * omega**2 + 1 / receptance)
    impedance = solve_modes(made, 500.0).coils.impedance(omega)[0][:, 0, 0]
    np.testing.assert_allclose(impedance, expected, rtol=1e-8)


def square_mean(of_distance, side):
    """Return the mean over all pairs of points of a square, in polar coordinates of their distances."""
    (s, ds), (t, dt) = (np.polynomial.legendre.leggauss(count) for count in (80, 40))
    root, angle = (s + 1) / 2, (t[:, None] + 1) * math.pi / 8  # the root, for the logarithm at 0
    longest = side / np.cos(angle)
    r, dr = longest * root**2, longest * root * ds
    pairs = (side - r * np.cos(angle)) * (side - r * np.sin(angle)) * r
    return 8 / side**4 * (pairs * of_distance(r) * dr * dt[:, None] * math.pi / 8).sum()


def test_the_motion_is_that_of_one_system_of_all_unknowns():
    made = panel(coupled=True)
    plate, frequencies = solve_modes(made, 400.0), np.array([47.0, 120.0, 290.0])
    amplitudes = plate.respond_to_drive(frequencies, scene_phasors(made))
    motion = plate.coils.motion(2 * math.pi * frequencies, amplitudes, scene_phasors(made)[:, None])
    for index, frequency in enumerate(frequencies):
        modes, magnets, currents = dense_motion(plate, 2 * math.pi * frequency)
        np.testing.assert_allclose(amplitudes[index, :, 0], modes, atol=1e-9 * np.abs(modes).max())
        np.testing.assert_allclose(motion.magnet[index, :, 0], magnets, atol=1e-8 * np.abs(magnets).max())
        np.testing.assert_allclose(motion.current[index, :, 0], currents, rtol=1e-8)


@pytest.mark.parametrize("air", [None, {"density": 12.0}], ids=["in vacuo", "in air"])
def test_what_goes_in_is_lost_or_radiated(air):
    """Electrical power, and that of the force beside the coils, is the heat of coils, springs, dampers and plate, and
    the sound of both sides."""
    made = panel(coupled=True)
    made = made if air is None else made.replace("effects.air", air)
    plate, frequencies, phasors = solve_modes(made, 400.0), np.array([47.0, 120.0, 290.0]), scene_phasors(made)
    omega = 2 * math.pi * frequencies
    amplitudes = plate.respond_to_drive(frequencies, phasors)
    motion = plate.coils.motion(omega, amplitudes, phasors[:, None])
    q = amplitudes[:, :, 0]
    lost = np.einsum("fm,mn,fn->f", q.conj(), plate.damping, q).real * omega**2 / 2
    lost += np.einsum("fm,mn,fn->f", q.conj(), plate.hysteretic, q).real * omega / 2
    if air is not None:
        radiated = 2 * Radiation(plate, 400.0, air_of(made)).powers(frequencies, amplitudes)[:, 0]
        assert (radiated > 1e-4 * lost).all()
        lost += radiated
    heat = np.zeros(3)
    for index in range(3):
        coil = made.actuators[index].coil
        resistance = coil.blocked_impedance(omega).real
        heat += resistance * np.abs(motion.current[:, index, 0]) ** 2 / 2
        lost += coil.suspension_damping * np.abs(omega * motion.stroke[:, index, 0]) ** 2 / 2
        lost += coil.magnet_damping * np.abs(omega * motion.magnet[:, index, 0]) ** 2 / 2
    force = plate.actuator_forces()[:, 3] * phasors[3]
    pressed = (force.conj() * (1j * omega[:, None] * q)).sum(axis=1).real / 2
    np.testing.assert_allclose(motion.electrical_power.sum(axis=(1, 2)) + pressed, heat + lost, rtol=1e-8)
    np.testing.assert_allclose(motion.mechanical_power.sum(axis=(1, 2)) + pressed, lost, rtol=1e-8)


def test_impedances_and_responses_are_reciprocal():
    plate, omega = solve_modes(panel(), 400.0), 2 * math.pi * FREQUENCIES[FREQUENCIES < 400]
    impedance, amplitudes = plate.coils.impedance(omega)
    np.testing.assert_allclose(impedance, impedance.mT, rtol=1e-8)
    # 1 N at a point induces the voltage that is the velocity there under 1 A: with the opposite sign, e = Bl v.
    point = plate.at_points([(0.03, 0.1)])
    pushed = plate.coils.respond(omega, np.broadcast_to(point, (len(omega), *point.shape)), opened=True)
    drives = np.zeros((4, 1))
    opened = panel([{**row, "voltage": None, "current": 1.0} if "kind" in row else row for row in COILS])
    motion = solve_modes(opened, 400.0).coils.motion(omega, pushed, drives)
    by_current = 1j * omega[:, None] * (point.T @ amplitudes)[:, 0]
    np.testing.assert_allclose(motion.voltage[:, :, 0], by_current, rtol=1e-6)


def test_gram_matrices_motion_and_slopes_are_those_of_the_steady_response():
    made = panel()
    plate, phasors = solve_modes(made, 330.0), scene_phasors(made)
    energies = ModalEnergies(plate, [plate.kinetic_matrix("plate"), plate.kinetic_matrix(made.target)])
    frequency, areas, delay = np.full((1, 4), 290.0), np.array([[row.box for row in made.actuators]]), np.zeros((1, 4))
    q = plate.respond_to_drive(np.array([290.0]), phasors)[0, :, 0] * 2j * math.pi * 290.0
    expected = [(q.conj() @ region @ q).real / 4 for region in (energies.regions[0], energies.regions[1])]
    np.testing.assert_allclose(energies.values(phasors[None], frequency, areas, delay)[0], expected, rtol=1e-9)
    slopes = energies.slopes(phasors[None], frequency, areas, delay)
    np.testing.assert_allclose(slopes.energy[0], expected, rtol=1e-9)
    step = 1e-3
    ends = [energies.values(phasors[None], frequency + side * step, areas, delay)[0] for side in (1, -1)]
    by_frequency = slopes.frequency[0].sum(axis=1)
    np.testing.assert_allclose(by_frequency, (ends[0] - ends[1]) / (2 * step), rtol=1e-4)


def test_every_peak_of_the_impedance_is_a_resonance():
    made = scene_of(size=(0.2, 0.16), damping=3.0).with_tables(actuators=COILS[:1])
    plate = solve_modes(made, 200.0)
    frequency = np.linspace(10, 200, 3801)
    impedance = plate.coils.impedance(2 * math.pi * frequency)[0][:, 0, 0]
    peaks, _ = signal.find_peaks(np.abs(impedance - blocked(2 * math.pi * frequency)), prominence=0.1)
    centres, widths = plate.coils.resonances(opened=True)
    distance = np.abs(frequency[peaks][:, None] - centres) / widths
    assert len(peaks) > 4
    assert (distance.min(axis=1) < 1).all()


def test_an_undamped_plate_is_damped_by_its_coil():
    """At a natural frequency of the plate alone, the response is that between its neighbours."""
    made = scene_of(size=(0.2, 0.16)).with_tables(actuators=COILS[:1])
    plate = solve_modes(made, 200.0)
    frequencies = plate.frequencies[0] * np.array([1 - 1e-5, 1, 1 + 1e-5])
    low, middle, high = plate.respond(frequencies, plate.actuator_forces())
    np.testing.assert_allclose(middle, (low + high) / 2, atol=1e-5 * np.abs(middle).max())


def test_resonances_of_many_modes(monkeypatch):
    """Beyond the modes that are solved for with the coils, they are those of the plate."""
    plate = solve_modes(panel(), 200.0)
    monkeypatch.setattr("warp_plate.modal.coils.MOST_MODES", 20)
    centres, widths = plate.coils.resonances(opened=True)
    np.testing.assert_allclose(centres[-100:], plate.frequencies[-100:])
    np.testing.assert_allclose(widths[-100:], (plate.damping_ratios * plate.frequencies)[-100:])


def test_keys_override_the_model():
    made = panel([{**COILS[0], "resistance": 4.98}])
    coil = made.actuators[0].coil
    assert (coil.resistance, coil.force_factor, coil.magnet_mass) == (4.98, 4.2, 0.05)
    assert Scene.parse(made.to_toml(), "x") == made
    assert made.drive_unit == "V"
    assert panel().drive_unit == "V or A or N/m²"
    for model in catalogue():
        assert panel([{**COILS[0], "model": model}]).actuators[0].coil.moving_mass > 0


BAD = [
    ({"model": "DAEX1"}, "model: 'DAEX1' is not in the catalogue; it has DAEX25FHE-4, DAEX25VT-4, XT25-4, XT32-4"),
    ({"model": None}, "force_factor: is missing; a coil takes force_factor, or a model of the catalogue"),
    ({"voltage": None}, "voltage: is missing; a coil takes a voltage, or a current"),
    ({"current": 0.1}, "current: 0.1 A, beside voltage = 2 V; delete one of them"),
    ({"magnitude": 1.0}, "magnitude: 1, but a coil takes voltage or current; write one of them"),
    ({"force": 1.0}, "force: 1 N, but a coil takes volts or amperes; write voltage or current"),
    ({"magnet_mass": 0.1}, 'magnet_mass: 0.1, but magnet = "fixed"; write magnet = "free" or magnet = "sprung"'),
    ({"magnet": "free"}, 'magnet_mass: is missing; magnet = "free" needs it'),
    ({**SPRUNG, "magnet": "free"}, 'magnet_stiffness: 800, but magnet = "free"; write magnet = "sprung", or delete it'),
    ({"kind": "pressure", "voltage": None}, 'model: DAEX25VT-4, but the actuator is no coil; write kind = "coil"'),
    ({"thickness": 1e-3}, 'thickness: 0.001, but the patch holds a coil; write kind = "piezo", or delete the key'),
]


@pytest.mark.parametrize(("keys", "message"), BAD)
def test_wrong_keys_of_a_coil_are_named(keys, message):
    row = {"name": "0", **EXCITER, "disc": (0.1, 0.08, 0.01), **keys}
    assert refused(Scene.from_tables, {**panel().model_dump(), "actuators": [row]}).startswith(
        f"actuators[0].{message}"
    )


@pytest.mark.parametrize(
    ("tables", "key"),
    [
        ({"effects": {"stretching": {}}}, "effects.stretching"),
        ({"search": {"position": {}}}, "search.position"),
    ],
)
def test_what_a_coil_excludes_is_named(tables, key):
    line = refused(Scene.from_tables, {**panel().model_dump(), **tables})
    assert line.startswith('actuators[0].kind: "coil" ')
    assert line.endswith(f"delete {key}")


@pytest.mark.parametrize(
    ("tables", "key"),
    [
        ({"drive": {"frequency": 290.0, "ramp": 0.01}}, "drive.ramp"),
        ({"drive": {"frequency": 290.0, "burst": {"duration": 0.01}}}, "drive.burst"),
    ],
)
def test_a_lossy_inductance_has_no_motion_in_time(tables, key):
    line = refused(Scene.from_tables, {**panel().model_dump(), **tables})
    assert line == (
        "actuators[0].eddy_resistance: is defined for steady tones alone; write eddy_branches in place of "
        f"eddy_resistance and eddy_reactance, or delete {key}"
    )
    assert panel().steady_key == "actuators[0].eddy_resistance"
