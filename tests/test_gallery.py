"""Every script of the gallery runs, draws, and stays short."""

import runpy
from pathlib import Path

import pytest

from warp_plate.viz.availability import missing_renderer

GALLERY = Path(__file__).parents[1] / "docs" / "examples" / "gallery"
SCRIPTS = sorted(GALLERY.glob("*/plot_*.py"))
MOST_LINES = 40


@pytest.mark.slow
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_script_draws(path, tmp_path, monkeypatch):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pytest.importorskip("xarray")
    if (problem := missing_renderer()) is not None:
        pytest.skip(problem)
    pyplot.switch_backend("Agg")
    monkeypatch.chdir(tmp_path)
    assert len(path.read_text(encoding="utf-8").splitlines()) < MOST_LINES
    runpy.run_path(str(path))
    assert pyplot.get_fignums() or list(tmp_path.glob("*.png"))
    pyplot.close("all")
