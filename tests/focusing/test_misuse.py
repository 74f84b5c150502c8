"""Waveforms are not played or written as what they are not."""

import pytest

from support.scenes import scene_of
from warp_plate import SceneError, export, focus
from warp_plate.result.focus import load_focus, save_focus

FOCUS = {"points": [(0.05, 0.04)], "highest": 300.0, "rate": 2000, "time": 0.02}
PIEZO = [
    {"name": name, "area": area, "kind": "piezo", "d31": -1.8e-10, "young_modulus": 6e10, "thickness": 2e-4}
    for name, area in (("a", (0.02, 0.05, 0.02, 0.05)), ("b", (0.12, 0.15, 0.1, 0.13)))
]


@pytest.fixture(scope="module")
def piezo_focus():
    return focus(scene_of(damping=88.5, focus=FOCUS).with_tables(actuators=PIEZO))


def test_volts_are_written_as_volts(piezo_focus, tmp_path):
    written = export(piezo_focus, tmp_path / "a.csv", to="drive-csv")
    assert written.contents["unit"] == "V"
    assert " V]" in (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[0]


def test_volts_are_not_played_as_pressures(piezo_focus, tmp_path):
    file = save_focus(piezo_focus, tmp_path / "volts.h5")
    pressures = [{"name": each["name"], "area": each["area"]} for each in PIEZO]
    with pytest.raises(SceneError, match="made for actuators driven by V, not N/m²"):
        focus(piezo_focus.scene.with_tables(actuators=pressures), load_focus(file))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"to": "wav"}, "to = 'wav': must be one of pvd"),
        ({"encoding": "pcm8"}, "encoding = 'pcm8': must be one of float32"),
        ({"rate": 96000}, "rate = 96000: waveforms of focus have a rate"),
    ],
)
def test_exports_refuse_what_they_cannot_do(piezo_focus, tmp_path, arguments, message):
    with pytest.raises(SceneError, match=message):
        export(piezo_focus, tmp_path / "a.wav", **{"to": "drive-wav", **arguments})
    assert not list(tmp_path.iterdir())
