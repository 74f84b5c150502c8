"""Motion and energies of the modal plate under drives that are switched, against closed forms and time steps.

Under a tone that is switched on at t = 0 a mode of the supported plate moves as ``series.damped_motion``. Bursts are
sums of tones that are switched on and off at their corners.
"""

import math

import numpy as np
import pytest

from support import series
from support.scenes import scene_of
from warp_plate import PlateSolver
from warp_plate.modal.energies import ModalEnergies
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.motion import modal_motion, trace
from warp_plate.plate.signals import actuator_delays, actuator_frequencies

SUPPORTED = ("supported",) * 4
BURST = {"start": 0.002, "duration": 0.005, "ramp": 0.0015, "period": 0.006}
MODES = 6


def actuators_of(frequencies=(None,) * 3, delays=(None,) * 3):
    """Return the actuators of ``scene_of`` with frequencies [Hz] and delays [s]."""
    plain = scene_of().actuators
    rows = zip(plain, frequencies, delays, strict=True)
    return [{**actuator.model_dump(), "frequency": tone, "delay": delay} for actuator, tone, delay in rows]


def bursts(edges=SUPPORTED, window=(0.004, 0.012), burst=BURST, delays=(None, 0.0, 0.0031), **tables):
    """Return a scene of three bursts of different frequencies and delays."""
    drive = {"frequency": 290.0, "burst": burst}
    actuators = actuators_of((None, 210.0, 333.0), delays)
    return scene_of(edges=edges, damping=60.0, window=window, **{"drive": drive, **tables}).with_tables(
        actuators=actuators
    )


def unit_motion(plate, times, velocity=False):
    """Return the complex motion (modes, actuators, times) under unit phasors of a plate without a moving load."""
    one = np.eye(len(plate.scene.actuators))
    parts = modal_motion(plate, np.concatenate([one, -1j * one]), times, velocity)
    return parts[:, : len(one)] + 1j * parts[:, len(one) :]


def switched_terms(scene, actuator):
    """Yield (moment [s], frequency [Hz], complex weight) of tones that, switched on together, are its load."""
    burst, start = scene.drive.burst, actuator_delays(scene)[actuator]
    frequency, half = actuator_frequencies(scene)[actuator], 0.5 / burst.ramp if burst.ramp else 0.0
    while start < scene.window.end:
        feet = (start, 1), (start + burst.ramp, -1), (start + burst.duration - burst.ramp, 1)
        for index, (moment, sign) in enumerate((*feet, (start + burst.duration, -1)) if burst.ramp else ()):
            foot = start if index < 2 else start + burst.duration
            for weight, shift in ((0.5, 0.0), (-0.25, half), (-0.25, -half)):
                turn = frequency * moment + shift * (moment - foot)
                yield moment, frequency + shift, sign * weight * np.exp(2j * math.pi * turn)
        for moment, sign in ((start + burst.ramp, 1), (start + burst.duration - burst.ramp, -1)):
            yield moment, frequency, sign * np.exp(2j * math.pi * frequency * moment)
        start += burst.period or math.inf


def amplitudes(plate, actuator, phasor, times, derivative=0):
    """Return (modes, times) amplitudes q or q̇ of all modes as sums of ``damped_motion``."""
    force, rate, total = plate.actuator_forces()[:, [actuator]], np.diag(plate.damping)[0], 0.0
    assert np.allclose(np.diag(plate.damping), rate)  # viscous damping of a uniform plate
    for moment, frequency, weight in switched_terms(plate.scene, actuator):
        since = np.maximum(times - moment, 0)
        motion = series.damped_motion(
            since, plate.angular_frequencies[:, None] ** 2, 1.0, rate, force * phasor * weight, frequency, derivative
        )
        total = total + np.where(times > moment, motion, 0)
    return total


@pytest.mark.parametrize(
    "burst",
    [BURST, {**BURST, "period": None, "ramp": 0.0}, {**BURST, "duration": 0.003}, {**BURST, "period": 0.005}],
    ids=["ramps", "switched", "no plateau", "without pause"],
)
def test_bursts_move_modes_as_tones_that_are_switched(burst):
    """Times include the corners of bursts and the ends of the run, in no order."""
    plate = solve_modes(bursts(burst=burst))
    times = np.concatenate([np.linspace(0, 0.012, 40), [0.002, 0.0035, 0.0055, 0.007, 0.0031]])
    times = np.random.default_rng(1).permutation(times)
    motion = unit_motion(plate, times)[:MODES]
    for actuator, phasor in enumerate((1.0, -1j, 0.4 + 0.3j)):
        exact = amplitudes(plate, actuator, phasor, times)[:MODES]
        moved = (phasor * motion[:, actuator]).real
        assert np.allclose(moved, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_undamped_mode_at_resonance_grows():
    """Switched on at its natural frequency ω, q = f t sin(ωt) / 2ω, beside terms that stay as they are."""
    scene = scene_of(edges=SUPPORTED, damping=None)
    plate = solve_modes(scene)
    scene = scene.with_tables(drive={"frequency": float(plate.frequencies[0])})
    plate = solve_modes(scene)
    times = np.linspace(0, 0.5, 7)
    omega = plate.angular_frequencies[0]
    exact = plate.actuator_forces()[0, 1] * times * np.sin(omega * times) / (2 * omega)
    motion = unit_motion(plate, times)[0, 1].real
    assert np.allclose(motion, exact, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_steady_motion_has_the_amplitude_of_late_motion():
    """A loss factor η of all modes at resonance is viscous damping of ratio η/2."""
    scene = scene_of(edges=SUPPORTED)
    frequency = float(solve_modes(scene).frequencies[0])
    one = {"drive": {"frequency": frequency}, "actuators": actuators_of()[:1]}
    steady = solve_modes(scene.with_tables(effects={"loss_factor": {"eta": 0.1}}, **one))
    late = solve_modes(scene.with_tables(effects={"modal_damping": {"ratio": 0.05}}, **one))
    times = 12.0 + np.linspace(0, 1 / frequency, 5)
    assert np.allclose(unit_motion(steady, times)[0], unit_motion(late, times)[0], rtol=1e-7, atol=0)


def test_polynomials_hold_what_exponentials_hold():
    """A sweep that ends at the frequency at which it began is a tone, and so are its bursts, motion and energies."""
    chirp = {"end_frequency": 290.0, "duration": 0.005}
    drive = {"frequency": 290.0, "burst": {**BURST, "ramp": 0.001}}
    exact, sampled = (
        solve_modes(scene_of(edges=SUPPORTED, damping=60.0, drive=tables), highest=100.0, density=0.5)
        for tables in (drive, {**drive, "chirp": chirp})
    )
    times = np.linspace(0, 0.012, 50)
    for velocity in (False, True):
        motion = unit_motion(exact, times, velocity)
        assert np.allclose(unit_motion(sampled, times, velocity), motion, rtol=0, atol=1e-7 * abs(motion).max())
    region, phasors = exact.kinetic_matrix(exact.scene.target), np.array([[1, 1j, 0.5]])
    for quantity in ("velocity", "displacement"):
        energy, other = (ModalEnergies(plate, [region], quantity).scene_values(phasors) for plate in (exact, sampled))
        assert np.allclose(energy, other, rtol=1e-5, atol=0)


def test_resting_load_on_a_point_is_static_in_the_end():
    """A constant force F at a point gives ω² q = F φ after the motion has decayed; half of it if the patch is half on
    the plate."""
    moving = {"force": 0.2, "start": (0.07, 0.05), "from_time": 0.5}
    scene = scene_of(edges=SUPPORTED, window=(0.1, 0.5), effects={"damping": {"viscous": 60.0}, "moving_load": moving})
    plate = solve_modes(scene)
    static = 0.2 * plate.at_points([(0.07, 0.05)])[:, 0] / plate.angular_frequencies**2
    motion = modal_motion(plate, np.zeros((1, 3)), np.array([0.4, 1.4]))[:, 0]
    assert np.allclose(motion[:, 0], 0)
    assert np.allclose(motion[:, 1], static, rtol=0, atol=1e-9 * abs(static).max())
    load = {**moving, "start": (0.2, 0.05), "size": 0.02}
    edge = solve_modes(scene.with_tables(effects={"damping": {"viscous": 60.0}, "moving_load": load}))
    motion = modal_motion(edge, np.zeros((1, 3)), np.array([1.4]))[:, 0, 0]
    forces = edge.patch_forces([(0.19, 0.2, 0.04, 0.06)])[:, 0] * 0.2 / 0.02**2
    assert np.allclose(motion, forces / edge.angular_frequencies**2, rtol=0, atol=1e-9 * abs(motion).max())


def with_file(scene, folder, channels=False):
    """Return the scene with a signal of 220 and 350 Hz under a window, or one of a tone for each actuator, at 4 kHz."""
    times, window = np.arange(48) / 4000, np.hanning(48)
    values = window * (np.sin(440 * math.pi * times) - 0.5 * np.cos(700 * math.pi * times))
    if channels:
        values = window[:, None] * np.sin(2 * math.pi * times[:, None] * [150.0, 220.0, 350.0])
    np.savetxt(folder / "signal.csv", values, delimiter=",")
    signal = {"file": "signal.csv", "rate": 4000.0, "per_actuator": channels}
    return scene.with_tables(drive={"frequency": 400.0, "signal": signal}).in_folder(folder)


def with_channels(scene, folder):
    return with_file(scene, folder, channels=True)


TONE = {"drive": {"frequency": 290.0}}
SMOOTH = {"drive": {"frequency": 290.0, "burst": {"start": 0.001, "duration": 0.008, "ramp": 0.002}}}
CHIRP = {"drive": {"frequency": 150.0, "chirp": {"end_frequency": 400.0, "duration": 0.01, "law": "logarithmic"}}}
LOAD = {"force": 0.3, "start": (-0.02, 0.05), "velocity": (25.0, 2.0), "size": 0.03, "frequency": 80.0}
MOVING = {"drive": {"frequency": 290.0}, "effects": {"damping": {"viscous": 88.0}, "moving_load": LOAD}}
# Tables of the drive, order of the grid, and largest errors of traces and energies on the second grid.
STEPPED = {
    "tone": (TONE, 4, 0.02),
    "burst": (SMOOTH, 4, 0.005),
    "sweep": (CHIRP, 4, 0.01),
    "file": (with_file, 4, 0.005),
    "file, a channel each": (with_channels, 2, 0.06),
    "moving load": (MOVING, 2, 0.06),
}
FAST = ("burst", "sweep", "moving load")


def test_each_actuator_has_a_channel(tmp_path):
    """Energies of a search are those of the motion, and actuators move the plate as one-channel files would."""
    scene = with_channels(scene_of(damping=88.0, window=(0.004, 0.014)), tmp_path)
    plate, phasors, times = (
        solve_modes(scene, density=0.4),
        np.array([[1, 0.5 - 0.5j, -0.8j]]),
        np.array([0.006, 0.012]),
    )
    energies = ModalEnergies(plate, [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)])
    areas = np.array([[actuator.area for actuator in scene.actuators]])
    found = energies.values(phasors, np.full((1, 3), 400.0), areas, np.zeros((1, 3)))
    assert np.allclose(found, energies.scene_values(phasors), rtol=1e-5)
    motion = trace(plate, phasors, [(0.05, 0.1)], times)
    for actuator, wave in enumerate(np.loadtxt(tmp_path / "signal.csv", delimiter=",").T):
        np.savetxt(tmp_path / f"{actuator}.csv", wave)
        drive = {"frequency": 400.0, "signal": {"file": f"{actuator}.csv", "rate": 4000.0}}
        alone = solve_modes(scene.with_tables(drive=drive), density=0.4)
        motion -= trace(alone, phasors * np.eye(3)[actuator], [(0.05, 0.1)], times)
    assert np.abs(motion).max() < 1e-9 * np.abs(trace(plate, phasors, [(0.05, 0.1)], times)).max()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in STEPPED]
)
@pytest.mark.parametrize("nodes", [(21, 41), pytest.param((41, 81), marks=pytest.mark.slow)])
def test_stepping_converges_to_the_motion(name, nodes, tmp_path):
    """Twice the nodes leave a sixteenth of the error of fourth order, a quarter of that of second; three times as much
    is allowed."""
    tables, order, bound = STEPPED[name]
    phasors, points = np.array([[1, 0.5 - 0.5j, -0.8j]]), [(0.05, 0.1), (0.15, 0.06)]
    scene = scene_of(damping=88.0, window=(0.004, 0.014), modal_density=1.0)
    scene = tables(scene, tmp_path) if callable(tables) else scene.with_tables(**tables)
    plate, errors = solve_modes(scene, density=0.7 if nodes[0] == 21 else 1.4), []
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    energy = ModalEnergies(plate, regions).scene_values(phasors)[0]
    for count in nodes:
        grid = {"nodes": (count, count), "order": order, "load": "moments", "precision": "float64"}
        run = PlateSolver(scene.with_tables(grid=grid), "cpu").run(phasors, points=points)
        moved = trace(plate, phasors, points, run.trace_times)
        of_trace = np.abs(moved - run.trace).max() / np.abs(moved).max()
        errors.append((of_trace, np.abs(run.energy[0] / energy - 1).max()))
    assert max(errors[1]) < (bound if nodes[0] == 21 else bound / order)
    assert errors[1][0] < 3 * errors[0][0] / 2**order
    assert errors[1][1] < 3 * errors[0][1] / 2**order
