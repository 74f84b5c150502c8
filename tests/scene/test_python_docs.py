"""The pages on Python and the example script run as written."""

import doctest
import re
import runpy
from pathlib import Path

import pytest

import warp_plate
from warp_plate import Scene, frf, load_result, plot
from warp_plate.viz.availability import missing_renderer

PICTURES = ("surfaces", "sweep")
DOCS = Path(__file__).parents[2] / "docs"


def test_examples_of_the_page_hold():
    failed, tried = doctest.testfile(str(DOCS / "python.md"), module_relative=False, encoding="utf-8")
    assert tried
    assert not failed


def test_every_name_has_an_example():
    text = (DOCS / "python-names.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\bwpl\.(\w+)", text)) == set(warp_plate.__all__)


@pytest.mark.slow
def test_examples_of_names_hold(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    pytest.importorskip("pyvista")
    page = DOCS / "python-names.md"
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testfile(str(page), module_relative=False, encoding="utf-8")
    assert tried
    assert not failed


@pytest.mark.slow
def test_script_finds_and_saves_a_drive(tmp_path, monkeypatch):
    if (problem := missing_renderer()) is not None:
        pytest.skip(problem)
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(DOCS / "examples" / "glass_panel.py"))
    best = names["result"].cases["best"].localization_factor
    assert load_result("glass-panel.h5").cases["best"].localization_factor == best
    assert {file.stem for file in tmp_path.glob("*.png")} == {f"glass-panel-{of}" for of in PICTURES}
    swept = names["found"].shaped("best")
    assert swept[2] == pytest.approx(best, rel=0.02)


def test_plots_are_those_of_the_commands(tmp_path):
    pytest.importorskip("matplotlib")
    responses = frf("paper", frequency_range=(200, 300))
    assert plot(responses, tmp_path / "drawn.1") == [tmp_path / "drawn.1.png"]
    assert (tmp_path / "drawn.1.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(TypeError, match="Scene: there are pictures of Result, Sweep"):
        plot(Scene.load("paper"), tmp_path / "drawn")
