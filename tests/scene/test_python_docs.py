"""The pages on Python and the example script run as written."""

import doctest
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import warp_plate
from warp_plate import Scene, frf, load_result, plot, simulate
from warp_plate.viz.availability import missing_renderer

PICTURES = ("surfaces", "sweep")
DOCS = Path(__file__).parents[2] / "docs"


def test_examples_of_the_page_hold():
    pytest.importorskip("xarray")
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
    pytest.importorskip("xarray")
    if (problem := missing_renderer()) is not None:
        pytest.skip(problem)
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(DOCS / "examples" / "glass_panel.py"))
    best = names["result"].cases["best"].localization_factor
    assert load_result("glass-panel.h5").cases["best"].localization_factor == best
    assert {file.stem for file in tmp_path.glob("*.png")} == {f"glass-panel-{of}" for of in PICTURES}
    swept = names["found"].to_xarray()["best"]
    assert swept.sel({"drive.frequency": 300}).item() == pytest.approx(best, rel=0.02)


def test_plots_are_those_of_the_commands(tmp_path):
    pytest.importorskip("matplotlib")
    responses = frf("paper", frequency_range=(200, 300))
    assert plot(responses, tmp_path / "drawn.1") == [tmp_path / "drawn.1.png"]
    assert (tmp_path / "drawn.1.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(TypeError, match="Scene: there are pictures of Result, Sweep"):
        plot(Scene.load("paper"), tmp_path / "drawn")


def test_results_are_by_case():
    pytest.importorskip("xarray")
    scene = Scene.load("paper").with_tables(record={"times": [0.0464, 0.05], "points": [[0.05, 0.06]]})
    result = simulate(scene, device="cpu", estimate=False)
    data, case = result.to_xarray(), result.main_case
    chosen = data.isel(case=0)
    assert dict(data["displacement"].sizes) == {"case": 1, "time": 2, "y": 27, "x": 27}
    assert (chosen["displacement"].values == case.displacement).all()
    assert np.abs(case.displacement).max() > 0
    assert (chosen["trace"].values == case.trace).all()
    assert len(data["trace_time"]) == case.trace.shape[1]
    target, plate = (chosen["energy"].sel(region=name).item() for name in ("target", "plate"))
    assert target / plate == case.localization_factor == chosen["localization_factor"].item()
    assert (chosen["magnitude"].values == case.magnitude).all()
    assert data["x"].values[-1] == scene.plate.size[0]
    bare = simulate("paper", device="cpu", estimate=False)
    assert bare.to_xarray().sizes["trace_time"] == 0
    assert (bare.to_xarray()["phase"].sel(case="drive").values == bare.main_case.phase).all()


def test_frequency_responses_are_by_input_and_point():
    pytest.importorskip("xarray")
    response = frf("paper", points=[(0.05, 0.05), (0.12, 0.08), (0.1, 0.1)])
    data = response.to_xarray()
    assert dict(data.sizes) == {"input": 4, "point": 3, "frequency": len(response.frequencies)}
    for row, (name, (x, _)) in zip(response.responses, response.pairs, strict=True):
        place = data["x"].values.tolist().index(x)
        assert (data["response"].sel(input=name).isel(point=place).values == row).all()
