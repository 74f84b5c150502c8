"""Plates under drives beyond one tone: bursts, sweeps, files, several frequencies and squares, on every path."""

import numpy as np
import pytest

from support.oracle import check_run, reference
from support.scenes import scene_of
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import make_signals

WINDOW = (0.004, 0.012)
TIMES = (0.003, 0.0075, 0.012)
CARRIERS = {
    "burst": {"burst": {"start": 0.001, "duration": 0.008, "ramp": 0.002}},
    "bursts that jump": {"burst": {"duration": 0.001, "period": 0.003}},
    "chirp": {"chirp": {"end_frequency": 500.0, "duration": 0.01, "law": "logarithmic"}},
}


def driven(frequency=290.0, order=2, damping=None, time_step=None, **drive):
    """Return a small scene under a drive."""
    drive = {"frequency": frequency, **drive}
    return scene_of(window=WINDOW, order=order, damping=damping, time_step=time_step, drive=drive)


@pytest.mark.parametrize(("name", "order"), [*((name, 2) for name in CARRIERS), ("file", 4)])
def test_one_carrier_takes_the_paths_of_a_tone(device, path, name, order, phasors, tmp_path):
    """Against plain NumPy under the same carrier; the kernels are those of a tone."""
    if name == "file":
        times = np.arange(0, 0.015, 1 / 8000)
        tap = np.stack([times, np.exp(-400 * times) * np.sin(3000 * times)], axis=1)
        np.savetxt(tmp_path / "tap.csv", tap, delimiter=",")
        made = driven(order=order, damping=60.0, signal={"file": "tap.csv"})
        with pytest.raises(SceneError, match=r"^drive\.signal\.file = 'tap\.csv': this scene was not read from a file"):
            PlateSolver(made, "cpu")
        (tmp_path / "scene.toml").write_text(made.to_toml(), encoding="utf-8")
        made = Scene.load(tmp_path / "scene.toml")  # finds the signal beside it
    else:
        made = driven(order=order, damping=60.0, **CARRIERS[name])
    solver, drives = PlateSolver(made, device, path), phasors(3, 3)
    tone = PlateSolver(driven(order=order, damping=60.0), device, path)
    assert solver.specialized.effects == tone.specialized.effects
    check_run(solver.run(drives, TIMES), made, reference(made, drives))


@pytest.mark.parametrize("square", [{}, {"electrostatic": {"bias": 2.0, "gain": 0.5}}])
def test_a_waveform_for_each_actuator(phasors, tmp_path, square):
    """The pressures that the plates in float64 take are those of one-channel files, each at its actuator."""
    times, drives = np.arange(0, 0.012, 1 / 8000), phasors(2, 3)
    waves = np.exp(-300 * times) * np.sin(np.outer([1500.0, 2600.0, 3300.0], times))
    np.savetxt(tmp_path / "all.csv", waves.T, delimiter=",")
    signal = {"file": "all.csv", "per_actuator": True, "rate": 8000.0, "start": 0.001}
    made = driven(signal=signal, **square).in_folder(tmp_path)
    step = make_scheme(made).time_step
    expected = []
    for actuator, wave in enumerate(waves):
        np.savetxt(tmp_path / f"{actuator}.csv", wave)
        alone = driven(signal={"file": f"{actuator}.csv", "rate": 8000.0, "start": 0.001}, **square)
        signals = make_signals(alone, step, 80, tmp_path)
        expected.append(np.einsum("nt,pt->pn", signals.wave, signals.coefficients(drives)[:, :, actuator]))
    signals = make_signals(made, step, 80, tmp_path)
    found = np.einsum("nt,ptk->kpn", signals.wave, signals.coefficients(drives))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(found).max())
    check_run(PlateSolver(made, "cpu").run(drives, TIMES), made, reference(made, drives))


def test_square_of_the_voltage(device, path, phasors):
    """gain·(bias + V)² moves the plate as a constant, a tone and a tone of twice the frequency do, each in a linear
    scene; without a voltage the bias still does."""
    bias, gain, drives = 3.0, 0.7, np.concatenate([phasors(1, 3), np.zeros((1, 3))])
    squared = driven(electrostatic={"bias": bias, "gain": gain})
    step = make_scheme(squared).time_step

    def displacement(made, drives):
        return PlateSolver(made, device, path).run(drives, TIMES).displacement

    def linear(frequency, drives):
        return displacement(driven(frequency=frequency, time_step=step), drives)

    constant = gain * (bias**2 + np.abs(drives) ** 2 / 2)
    expected = linear(1e-6, constant) + linear(290.0, 2 * gain * bias * drives)
    expected += linear(580.0, gain / 2 * drives**2)
    found = displacement(squared, drives)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(found).max())
    assert found[1].any()


def test_fourth_order_knows_one_frequency():
    first, *others = driven().model_dump()["actuators"]
    apart = driven(order=4).with_tables(actuators=[{**first, "frequency": 170.0}, *others])
    for made in apart, driven(order=4, electrostatic={"gain": 1.0}):
        with pytest.raises(SceneError, match=r"^grid\.order = 4: .* actuators of one frequency; write 2"):
            make_scheme(made)
