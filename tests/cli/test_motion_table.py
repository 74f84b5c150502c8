"""Motion of the target and the rest under drives: the table of ``localize`` and ``simulate``, and its numbers."""

import json
import math

import pytest

from support.commands import output_of
from warp_plate import Scene, load_result

OPTIONS = ("--device", "cpu", "--no-pictures", "--no-estimate")


@pytest.mark.parametrize("path", ["auto", "modal"])
def test_numbers_follow_from_energies(command, tmp_path, path):
    file = tmp_path / "a.h5"
    words = ("simulate", "paper", "--drive", "single", "--path", path, *OPTIONS, "--out", file)
    found = json.loads(output_of(command(*words, "--json")))
    scene, motion = Scene.load("paper"), found["motion"]
    mass = scene.plate.density * scene.plate.thickness * math.prod(scene.plate.size)
    target, plate = found["energy"]["target"], found["energy"]["plate"]
    for region, energy, share in (("target", target, 1 / 4), ("outside", plate - target, 3 / 4)):
        velocity = motion["velocity_rms"][region]
        assert velocity == pytest.approx(math.sqrt(2 * energy / (share * mass)), rel=1e-6)
        assert motion["acceleration_rms"][region] == pytest.approx(2 * math.pi * 290 * velocity)
    assert motion["contrast_db"] == pytest.approx(10 * math.log10(3 * target / (plate - target)))
    peaks = motion["displacement_peak"]
    assert max(peaks.values()) == load_result(file).peak_displacement
    assert peaks["outside"] < peaks["target"]
    assert "only actuator driven lower left" in " ".join(command(*words)[1].split())
    assert load_result(file).main_case.motion is None


def test_a_plate_that_is_not_linear_has_no_acceleration(command, tmp_path):
    words = ("simulate", "large-amplitude", *OPTIONS, "--out", tmp_path / "a.h5")
    motion = json.loads(output_of(command(*words, "--json")))["motion"]
    assert set(motion) == {"contrast_db", "velocity_rms", "displacement_peak"}
    assert "acceleration" not in command(*words)[1]


def test_cases_of_a_search_are_compared(command, tmp_path):
    words = ("localize", "paper", *OPTIONS, "--baselines", "--set", "search.iterations=3", "--out", tmp_path / "a.h5")
    found = json.loads(output_of(command(*words, "--json")))
    assert set(found["motion"]) == set(found["localization_factor"]) - {"bound"}
    equal, single, best = (found["motion"][name] for name in ("equal", "single", "best"))
    assert equal["contrast_db"] == pytest.approx(0, abs=1e-6)
    assert equal["displacement_peak"]["target"] == pytest.approx(equal["displacement_peak"]["outside"], rel=1e-3)
    assert best["contrast_db"] > 0
    assert single["contrast_db"] == pytest.approx(7.208, abs=0.01)
    assert found["single_actuator"] in {actuator.name for actuator in Scene.load("paper").actuators}
    text = " ".join(command(*words)[1].split())
    assert f"best single actuator, {found['single_actuator']}" in text
    assert "Motion in the target / outside" in text
