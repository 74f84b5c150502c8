"""Warnings about drives in time: steadiness of the motion, and frequencies of a signal's file."""

import math

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.analysis.influence import toggle
from warp_plate.analysis.warnings import find_warnings, slowest_frequency, warning_texts
from warp_plate.scene.dump import dump_scene
from warp_plate.solve.specialize import effect_names

START = 0.004  # start of the window of the tests' scene [s]
TAU = 1e-5  # retardation time [s]


def left(scene):
    return next(number for number in find_warnings(scene, None) if number.name == "start-up motion left")


def decayed(frequency):
    """Return the start-up motion left by material damping alone."""
    return math.exp(-TAU * (2 * math.pi * frequency) ** 2 / 2 * START)


def test_start_up_motion_decays_at_the_lowest_frequency(scene):
    made = scene(effects={"material_damping": {"time": TAU}})
    actuators = [one.model_dump() for one in made.actuators]
    actuators[1]["frequency"], actuators[2]["frequency"] = 150.0, 400.0
    assert left(made).value == pytest.approx(decayed(290.0))
    made = made.with_tables(actuators=actuators)
    assert left(made).value == pytest.approx(decayed(150.0))
    # Transient motion is not judged.
    load = left(made.with_tables(effects={"moving_load": {"force": 1.0, "start": (0.1, 0.1)}}))
    burst = left(made.with_tables(drive={"frequency": 290.0, "burst": {"duration": 0.01}}))
    for found, key in ((load, "effects.moving_load"), (burst, "drive.burst")):
        assert not found.exceeded
        assert math.isnan(found.value)
        assert key in found.sentence


def test_squared_voltages_excite_the_lowest_modes(scene):
    """The lowest frequency of a supported square is π/L² √(D/ρH)."""
    made = scene(
        (41, 41), edges=("supported",) * 4, effects={"material_damping": {"time": TAU}},
        drive={"frequency": 290.0, "electrostatic": {"bias": 10.0, "gain": 1.0}},
    )  # fmt: skip
    plate = made.plate
    stiff = plate.young_modulus * plate.thickness**3 / 12 / (1 - plate.poisson_ratio**2)
    lowest = math.pi / plate.size[0] ** 2 * math.sqrt(stiff / plate.density / plate.thickness)
    assert slowest_frequency(made) == pytest.approx(lowest, rel=1e-6)
    assert left(made).value == pytest.approx(decayed(lowest), rel=1e-6)
    assert left(made).value > left(made.with_tables(drive={"frequency": 290.0})).value


@pytest.mark.parametrize(("frequency", "named"), [(300.0, False), (100.0, True)])
def test_files_with_higher_frequencies_are_reported(tmp_path, scene, frequency, named):
    times = np.arange(2000) / 8000
    np.savetxt(tmp_path / "tone.csv", np.column_stack([times, np.sin(2 * np.pi * 290 * times)]), delimiter=",")
    made = scene(drive={"frequency": frequency, "signal": {"file": "tone.csv"}})
    (tmp_path / "panel.toml").write_text(dump_scene(made), encoding="utf-8")
    loaded = Scene.load(tmp_path / "panel.toml")
    number = find_warnings(loaded, None)[-1]
    assert number.value == pytest.approx(290 / frequency, rel=0.12)
    assert number.exceeded == named
    assert (number.sentence in warning_texts(loaded, 0.0)) == named
    assert "drive.signal" in left(loaded).sentence


def test_effects_are_toggled_and_named_as_in_the_kernel(scene):
    with pytest.raises(SceneError, match="one actuator"):
        toggle(scene(actuators=[(0.05, 0.09, 0.05, 0.09)]), "own_frequencies")
    voltage = scene(drive={"frequency": 290.0, "electrostatic": {"gain": 1.0}})
    loaded = scene(effects={"moving_load": {"force": 1.0, "start": (0.1, 0.1)}})
    for made, waves in ((voltage, True), (loaded, False), (scene(), False)):
        effects = PlateSolver(made, "cpu").specialized.effects
        assert ("several waves" in effect_names(made)) == (effects.terms > 2) == waves
        assert ("bending by moments" in effect_names(made)) == effects.moments == (not effects.plain)
