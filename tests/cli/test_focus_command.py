"""``warp-plate focus``: its JSON, table, files and picture, and what it refuses."""

import json
from pathlib import Path

import pytest
from conftest import error_of, output_of

from warp_plate import focus
from warp_plate.result.focus import load_focus

TABLE = {"points": [(0.07, 0.06), (0.13, 0.12)], "highest": 200.0, "time": 0.01, "rate": 4000}


def test_json_and_files(command, write_scene):
    pytest.importorskip("matplotlib")
    scene = write_scene(damping=10.0, focus=TABLE)
    record = json.loads(output_of(command("focus", "panel.toml", "--json")))
    assert record["files"] == ["panel-focus.h5", "panel-focus.png"]
    found, read = focus(scene), load_focus("panel-focus.h5")
    assert record["unit"] == "m"
    assert record["methods"].keys() == found.methods.keys() == read.methods.keys()
    for name, method in record["methods"].items():
        for figure in ("peak", "focus_area", "contrast_db", "energy", "gap"):
            expected = getattr(found.methods[name], figure).tolist()
            assert method[figure] == pytest.approx(expected, rel=1e-6, abs=1e-12)
            assert getattr(read.methods[name], figure).tolist() == method[figure]
    again = output_of(command("focus", "panel.toml", "--set", "focus.energy=0.001", "--no-pictures"))
    for words in ("one bit", "peak (m)", "energy", "crosstalk at most", "wrote panel-focus.h5"):
        assert words in again


def test_what_cannot_be_focused_is_one_line(command, write_scene):
    write_scene()
    assert "panel.toml: focus: there is no such table" in error_of(command("focus", "panel.toml"))
    write_scene(focus=TABLE)
    assert "focus.highest" in error_of(command("focus", "panel.toml", "--set", "focus.highest=-1"))
    Path("panel-focus.h5").write_text("notes", encoding="utf-8")
    assert "--force" in error_of(command("focus", "panel.toml"))
