"""``warp-plate focus``: its JSON, table, files and picture, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from support.commands import error_of, output_of
from warp_plate import focus, load_focus, plot
from warp_plate.plate.waveforms import read_samples
from warp_plate.scene.drive import SampledSignal

TABLE = {"points": [(0.07, 0.06), (0.13, 0.12)], "highest": 200.0, "time": 0.01, "rate": 4000}


def test_json_and_files(command, write_scene):
    pytest.importorskip("matplotlib")
    scene = write_scene(damping=10.0, focus=TABLE)
    record = json.loads(output_of(command("focus", "panel.toml", "--json")))
    assert record["files"] == ["panel-focus.h5", "panel-focus.png"]
    found, read = focus(scene), load_focus("panel-focus.h5")
    assert record["unit"] == "m"
    assert record["warnings"] == list(found.warnings)
    assert set(read.warnings) == set(found.warnings)
    assert [line.partition(":")[0] for line in found.warnings] == [name.replace("_", " ") for name in found.methods]
    assert record["methods"].keys() == found.methods.keys() == read.methods.keys()
    for name, method in record["methods"].items():
        for figure in ("peak", "focus_area", "contrast_db", "energy", "gap"):
            expected = getattr(found.methods[name], figure).tolist()
            assert method[figure] == pytest.approx(expected, rel=1e-6, abs=1e-12)
            assert getattr(read.methods[name], figure).tolist() == method[figure]
    assert plot(read, "again") == [Path("again.png")]
    again = output_of(command("focus", "panel.toml", "--set", "focus.energy=0.001", "--no-pictures"))
    for words in ("one bit", "peak (m)", "energy", "crosstalk at most", "wrote panel-focus.h5"):
        assert words in again
    for line in load_focus("panel-focus.h5").warnings:
        assert line in again


def test_waveforms_are_exported_and_played_on_another_panel(command, write_scene):
    """Export writes a file for each point, which [drive.signal] reads back as pressures."""
    write_scene(damping=10.0, focus=TABLE)
    output_of(command("focus", "panel.toml", "--no-pictures"))
    out = output_of(command("export", "panel-focus.h5", "--to", "drive-wav", "--case", "time_reversal"))
    assert out.splitlines()[-2:] == ["wrote panel-focus-drive-1.wav", "wrote panel-focus-drive-2.wav"]
    rate, stored = wavfile.read("panel-focus-drive-2.wav")
    waveforms = load_focus("panel-focus.h5").methods["time_reversal"].waveforms
    assert rate == TABLE["rate"]
    np.testing.assert_allclose(stored.T, waveforms[1] / abs(waveforms).max(), atol=1e-7)
    read = read_samples(SampledSignal(file="panel-focus-drive-1.wav", per_actuator=True), Path(), 3)
    np.testing.assert_allclose(read.values * abs(waveforms).max(), waveforms[0], atol=1e-6)
    played = ("focus", "panel.toml", "--set", "effects.damping.viscous=30", "--no-pictures", "--out", "other.h5")
    output_of(command(*played, "--waveforms", "panel-focus.h5"))
    np.testing.assert_array_equal(load_focus("other.h5").methods["time_reversal"].waveforms, waveforms)
    assert "none.h5: no such file" in error_of(command(*played, "--waveforms", "none.h5"))
    csv = json.loads(output_of(command("export", "panel-focus.h5", "--to", "drive-csv", "--full-scale", "2", "--json")))
    assert (csv["case"], csv["full_scale"]) == ("optimum", 2.0)
    for words in (
        ("--to", "drive-wav", "--case", "best"),
        ("--to", "drive-wav", "--rate", "8000"),
        ("--to", "drive-wav", "--full-scale", "0.5"),
        ("--to", "vtkhdf"),
    ):
        assert words[-1] in error_of(command("export", "panel-focus.h5", *words))


def test_focus_is_rendered(command, write_scene):
    pytest.importorskip("matplotlib")
    write_scene(damping=10.0, focus=TABLE)
    output_of(command("focus", "panel.toml", "--no-pictures"))
    shown = ("--case", "optimum", "--case", "one_bit", "--out", "plan.svg")
    assert output_of(command("render", "panel-focus.h5", *shown)).strip() == "wrote plan.svg"
    drawn = Path("plan.svg").read_text(encoding="utf-8")
    assert "optimum" in drawn
    assert "one bit" in drawn
    for words in (("--case", "best"), ("--modes", "2"), ("--start", "0.5")):
        assert words[-1] in error_of(command("render", "panel-focus.h5", *shown, *words))


def test_what_cannot_be_focused_is_one_line(command, write_scene):
    write_scene()
    assert "panel.toml: focus: there is no such table" in error_of(command("focus", "panel.toml"))
    write_scene(focus=TABLE)
    assert "focus.highest" in error_of(command("focus", "panel.toml", "--set", "focus.highest=-1"))
    Path("panel-focus.h5").write_text("notes", encoding="utf-8")
    assert "--force" in error_of(command("focus", "panel.toml"))
