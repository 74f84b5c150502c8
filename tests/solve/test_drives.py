"""Plates under drives beyond one tone: bursts, sweeps, files, several frequencies and squares, on every path."""

import numpy as np
import pytest
from oracle import check_run, reference

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.dump import dump_scene
from warp_plate.studies.localize import localize

WINDOW = (0.004, 0.012)
TIMES = (0.003, 0.0075, 0.012)
CARRIERS = {
    "burst": {"burst": {"start": 0.001, "duration": 0.008, "ramp": 0.002}},
    "bursts that jump": {"burst": {"duration": 0.001, "period": 0.003}},
    "chirp": {"chirp": {"end_frequency": 500.0, "duration": 0.01, "law": "logarithmic"}},
}


@pytest.fixture
def driven(scene):
    """The factory of small scenes under a drive; ``own``: the actuators' frequencies."""

    def make(own=(None,) * 3, frequency=290.0, **drive):
        kept = {name: drive.pop(name) for name in ("order", "damping", "time_step") if name in drive}
        made = scene(window=WINDOW, frequency=frequency, **kept)
        pairs = zip(made.model_dump()["actuators"], own, strict=True)
        actuators = [{**table, "frequency": one} for table, one in pairs]
        return made.with_tables(drive={"frequency": frequency, **drive}, actuators=actuators)

    return make


def displacement(scene, drives, device, path):
    return PlateSolver(scene, device, path).run(np.atleast_2d(drives), TIMES).displacement


@pytest.mark.parametrize(("name", "order"), [*((name, 2) for name in CARRIERS), ("file", 4)])
def test_one_carrier_takes_the_paths_of_a_tone(device, path, name, order, driven, phasors, tmp_path):
    """Against plain NumPy under the same carrier; the kernels are those of a tone."""
    if name == "file":
        times = np.arange(0, 0.015, 1 / 8000)
        tap = np.stack([times, np.exp(-400 * times) * np.sin(3000 * times)], axis=1)
        np.savetxt(tmp_path / "tap.csv", tap, delimiter=",")
        made = driven(order=order, damping=60.0, signal={"file": "tap.csv"})
        with pytest.raises(SceneError, match=r"^drive\.signal\.file = 'tap\.csv': this scene was not read from a file"):
            PlateSolver(made, "cpu")
        (tmp_path / "scene.toml").write_text(dump_scene(made), encoding="utf-8")
        made = Scene.load(tmp_path / "scene.toml")  # finds the signal beside it
    else:
        made = driven(order=order, damping=60.0, **CARRIERS[name])
    solver, drives = PlateSolver(made, device, path), phasors(3, 3)
    tone = PlateSolver(driven(order=order, damping=60.0), device, path)
    assert solver.specialized.effects == tone.specialized.effects
    check_run(solver.run(drives, TIMES), made, reference(made, drives))


def test_own_frequencies_superpose(device, path, driven, phasors):
    """Each actuator's motion is the one that it makes alone, under a drive of its own frequency."""
    own, drive = (170.0, None, 410.0), phasors(1, 3)
    together = driven(own)
    step = make_scheme(together).time_step
    alone = [
        displacement(driven(frequency=frequency, time_step=step), drive * np.eye(3)[actuator], device, path)
        for actuator, frequency in enumerate((170.0, 290.0, 410.0))
    ]
    found = displacement(together, drive, device, path)
    np.testing.assert_allclose(found, sum(alone), rtol=0, atol=1e-10 * np.abs(found).max())


def test_square_of_the_voltage(device, path, driven, phasors):
    """gain·(bias + V)² moves the plate as a constant, a tone and a tone of twice the frequency do, each in a linear
    scene; without a voltage the bias still does."""
    bias, gain, drives = 3.0, 0.7, np.concatenate([phasors(1, 3), np.zeros((1, 3))])
    squared = driven(electrostatic={"bias": bias, "gain": gain})
    step = make_scheme(squared).time_step

    def linear(frequency, drive):
        return displacement(driven(frequency=frequency, time_step=step), drive, device, path)

    constant = gain * (bias**2 + np.abs(drives) ** 2 / 2)
    expected = linear(1e-6, constant) + linear(290.0, 2 * gain * bias * drives)
    expected += linear(580.0, gain / 2 * drives**2)
    found = displacement(squared, drives, device, path)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(found).max())
    assert found[1].any()


def test_fourth_order_knows_one_frequency(driven):
    for changes in ({"own": (170.0, None, None)}, {"electrostatic": {"gain": 1.0}}):
        with pytest.raises(SceneError, match=r"^grid\.order = 4: .* actuators of one frequency; write 2"):
            make_scheme(driven(order=4, **changes))


def test_search_under_squares_keeps_to_the_volts_of_the_scene(driven):
    """No bound is claimed, and a magnitude of one stands for the largest of the scene's."""
    made = driven(electrostatic={"bias": 50.0, "gain": 1e-3})
    pairs = zip(made.model_dump()["actuators"], (20.0, 120.0, 80.0), strict=True)
    volts = [{**table, "magnitude": volt} for table, volt in pairs]
    made = made.with_tables(actuators=volts, search={"particles": 4, "iterations": 2})
    found = localize(made, device="cpu", estimate=True)
    assert found.bound is None
    np.testing.assert_array_equal(found.cases["equal"].phasors, np.full(3, 120.0))
    assert found.cases["best"].magnitude[0] == pytest.approx(120.0)
    assert "no error estimate" in found.accuracy["estimate"]["line"]
    with pytest.raises(SceneError, match=r"^evaluator = 'response': drive\.electrostatic is not linear"):
        localize(made, device="cpu", evaluator="response")
