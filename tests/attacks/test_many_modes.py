"""Requests for more modes than anyone has use for are refused in one line, before memory or time is spent.

What is not refused takes minutes or gigabytes, which the time limit of all tests ends.
"""

from pathlib import Path

import numpy as np
import pytest

from support.commands import error_of
from support.scenes import scene_of
from warp_plate import SceneError, modes
from warp_plate.modal.modes import MOST_MODES
from warp_plate.studies.spectrum import resonances

FREE = {"fit": {"free": {"plate.young_modulus": (6e8, 2e9)}}}
SENSOR = {"measurement": [{"actuator": "0", "point": (0.05, 0.04)}]}
WAVEFORMS = {"points": [(0.05, 0.04)], "rate": 500_000, "highest": 1e5}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("frf panel.toml --range 100:1e5", "about 6.54e+03 modes are needed; at most 1000"),
        ("modes panel.toml --count 501", "count = 501: must be from 1 to 500 modes"),
        ("sweep panel.toml --vary plate.density=1:2:2 --what modes --count 501", "--count 501: must be from 1 to 500"),
        ("fit panel.toml --data high.csv", "fit.range can lower: about 6.54e+03 modes are needed; at most 200 are"),
        ("fit modes.toml --data many.csv", "many.csv: line 3, mode = '500': must be a whole number from 1 to 200"),
        ("focus focus.toml", "focus.highest 100000: about 6.54e+03 modes are needed; at most"),
    ],
)
def test_commands(line, message, write_scene, command):
    write_scene(damping=88.5, **FREE, **SENSOR)
    write_scene(damping=88.5, name="modes", **FREE)
    write_scene(damping=88.5, name="focus", focus=WAVEFORMS)
    Path("high.csv").write_text("50,1,1\n80,2,1\n100,1,2\n1e5,2,2\n", encoding="utf-8")
    Path("many.csv").write_text("frequency,mode\n40,1\n80,500\n", encoding="utf-8")
    assert message in error_of(command(*line.split()))


def test_functions():
    scene = scene_of(damping=88.5)
    with pytest.raises(SceneError, match=r"^drive.frequency: about .* at most 1000"):
        modes(scene, highest=1e6)
    with pytest.raises(SceneError, match=r"^count: about 1e\+03 modes are needed; at most 1000"):
        modes(scene, MOST_MODES + 1)


@pytest.mark.parametrize("highest", [float("nan"), float("inf"), 0, -1])
def test_highest_frequencies_that_are_none(highest):
    with pytest.raises(SceneError, match=r"^highest = .*: must be a frequency above 0"):
        modes(scene_of(damping=88.5), highest=highest)


def test_a_search_keeps_its_result_where_resonances_are_too_many_to_mark():
    assert np.array_equal(resonances(scene_of(damping=88.5), 100, 1e6), [])


@pytest.mark.parametrize("line", ["check", "simulate", "localize", "accuracy"])
def test_waves_too_short_for_any_reference(line, write_scene, command):
    """Grids that do not resolve the waves are not run, which took minutes before the same answer."""
    write_scene(scene_of(damping=88.5, frequency=1e5, window=(0.05, 0.1), grid={"accuracy": 0.01}))
    error = error_of(command(line, "panel.toml", "--device", "cpu"))
    assert "drive.frequency: bending waves of 0.0031 m on a plate of [0.2, 0.2] m until 0.1 s" in error
    assert "write a [grid]" in error
