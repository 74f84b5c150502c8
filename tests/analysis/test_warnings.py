"""Warnings about drives in time: steadiness of the motion, and frequencies of a signal's file."""

import math

import numpy as np
import pytest

from support.scenes_of_outlines import outlined
from warp_plate import Scene, SceneError
from warp_plate.analysis.warnings import (
    accuracy_warnings,
    find_warnings,
    search_warnings,
    slowest_frequency,
    target_warnings,
    warning_texts,
)

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
    (tmp_path / "panel.toml").write_text(made.to_toml(), encoding="utf-8")
    loaded = Scene.load(tmp_path / "panel.toml")
    number = find_warnings(loaded, None)[-1]
    assert number.value == pytest.approx(290 / frequency, rel=0.12)
    assert number.exceeded == named
    assert (number.sentence in warning_texts(loaded, 0.0)) == named
    assert "drive.signal" in left(loaded).sentence


def scaled(scene, lengths, thickness):
    """Return a scene whose lengths in the plane, and its thickness, are multiplied."""
    made = scene.model_dump(mode="json", exclude={"targets"})
    made["plate"]["size"] = [lengths * side for side in made["plate"]["size"]]
    made["plate"]["thickness"] *= thickness
    for row in (*made["actuators"], made["target"]):
        row["area"] = [lengths * side for side in row["area"]]
    return Scene.from_tables(made)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("plate.density", 2.5, ["below 1", "is plate.density = 2.5 kg/m³ meant?"]),
        ("drive.frequency", 0.3, ["below 1"]),
        ("actuators[2].phase", 90, ["actuators[2].phase = 90 rad is 14.3 turns", "1.571 rad"]),
        ("actuators[1].area[2]", 0.035, ['Actuators "lower left" and "upper left" overlap by 58 %']),
    ],
)
def test_values_in_other_units_are_named(key, value, named):
    paper = Scene.load("paper")
    first = f"first natural frequency {slowest_frequency(paper.replace(key, value)):.4g} Hz"
    texts = " ".join(warning_texts(paper.replace(key, value), 0.0))
    for part in named:
        part = part.replace("below 1", first).replace("phase = 90 rad is", "phase = 90 rad, is")
        assert part in texts
        assert part not in " ".join(warning_texts(paper, 0.0))


def test_millimetres_written_as_metres_are_asked_about():
    paper = Scene.load("paper")
    with pytest.raises(SceneError, match=r"^plate\.size: \[200\.0, 200\.0\] is above 50 m; are lengths in metres\?$"):
        scaled(paper, 1000, 1000)
    with pytest.raises(SceneError, match=r"^plate\.thickness: 0\.7 m is not thin .*lengths are in metres\)$"):
        scaled(paper, 1, 1400)
    texts = " ".join(warning_texts(scaled(paper, 200, 200), 0.0))
    assert "fewer than 2 points" in texts
    assert "in metres" in texts
    assert "both in metres?" in " ".join(warning_texts(scaled(paper, 100, 1), 0.0))
    assert "in metres" not in " ".join(warning_texts(paper, 0.0))


def test_the_first_natural_frequency_of_a_stiffened_plate_is_found(scene):
    """A bed of stiffness k raises all frequencies: ω² = ω₀² + k/ρH."""
    made = scene(effects={"foundation": {"stiffness": 1e7}})
    plate = made.plate
    bed = math.sqrt(1e7 / (plate.density * plate.thickness)) / (2 * math.pi)
    number = next(one for one in find_warnings(made, None) if "first natural" in one.name)
    bare = slowest_frequency(made.with_tables(effects={}))
    assert number.value == pytest.approx(made.drive.frequency / math.hypot(bare, bed), rel=1e-6)
    assert number.exceeded
    damped = scene(effects={"foundation": {"stiffness": 1.0, "damping": 100.0}})
    assert left(damped).value == pytest.approx(math.exp(-100 * START))


@pytest.mark.parametrize("effects", [None, {"modal_damping": {"ratio": 0.002}}])
def test_the_window_that_is_named_is_late_enough(effects):
    """Where it opens later than it ended, it ends later too."""
    made = Scene.load("paper") if effects is None else Scene.load("paper").with_tables(effects=effects)
    found = left(made)
    start, *ends = (float(part.split()[0].rstrip(".")) for part in found.sentence.split(" = ")[1:])
    end = ends[0] if ends else made.window.end
    assert found.exceeded
    assert end > start
    assert bool(ends) == (effects is not None)
    assert not left(made.with_tables(window={"start": start, "end": end})).exceeded
    if effects is None:
        assert left(made.with_tables(window={"start": start - 0.0002, "end": end})).exceeded


def test_targets_without_energy_are_reported():
    paper = Scene.load("paper")
    assert target_warnings(paper, 0.25) == []
    assert "next to no energy in the target" in target_warnings(paper, 0.0024)[0]
    assert "Nothing moves" in target_warnings(paper, math.nan)[0]


def test_a_search_that_leaves_the_drive_alone_says_so(scene):
    """The best frequency under an equal drive was taken for the best frequency."""
    frequency = {"frequency": {"range": (200.0, 300.0)}}
    assert "only [search.frequency] is written" in search_warnings(scene(search=frequency))[0]
    for search in ({}, {**frequency, "phase": {}}):
        assert search_warnings(scene(search=search)) == []


def test_an_error_above_the_accuracy_is_said_with_what_makes_it_smaller(scene):
    made = scene(damping=88.0)
    accuracy = {"asked": 0.01, "expected": 0.005, "estimate": {"error": 0.2}}
    (warning,) = accuracy_warnings(made.with_tables(window={"start": 0.0, "end": 0.1}), accuracy, "--path modal")
    for part in ("20 %, not 1 %", "grid.modal_density = 2 with --path modal", "window.start", "drive.ramp = 0.03 s"):
        assert part in warning
    assert accuracy_warnings(made, accuracy | {"estimate": {"error": 0.009}}, "--path modal") == []
    assert accuracy_warnings(made, accuracy | {"estimate": {"error": math.nan}}, "--path modal") == []
    assert accuracy_warnings(made, {"estimate": {"error": 0.2}}, "--path modal") == []
    assert accuracy_warnings(made, accuracy | {"estimate": {}, "expected": None}, "") == []


def test_actuators_that_reach_over_an_outline():
    areas = [(0.15, 0.2, 0.0, 0.1), (0.09, 0.11, 0.09, 0.11)]
    made = outlined({"disc": (0.1, 0.1, 0.1)}, actuators=areas)
    (number,) = [number for number in find_warnings(made, None) if number.name == "actuator off the plate"]
    # The part of the rectangle beyond the circle: from 0.15 on, y below 0.1 − √(0.1² − (x − 0.1)²).
    x = np.linspace(0.05, 0.1, 200001)
    covered = np.trapezoid(np.sqrt(np.maximum(0.01 - x**2, 0)), x) / 0.005
    assert number.value == pytest.approx(1 - covered, rel=1e-3)
    assert 'Of actuator "0"' in number.sentence
    assert "what lies outside does not press" in number.sentence
    inside = outlined({"disc": (0.1, 0.1, 0.1)}, actuators=areas[1:])
    assert not [number for number in find_warnings(inside, None) if number.name.endswith("plate") and number.exceeded]
