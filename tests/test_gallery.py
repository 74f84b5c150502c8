"""Every script of the gallery runs, draws, and stays short."""

import runpy
from pathlib import Path

import pytest

from warp_plate.viz.availability import missing_renderer

DOCS = Path(__file__).parents[1] / "docs"
GALLERY = DOCS / "examples" / "gallery"
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


def test_pictures_of_the_docs_are_used_and_can_be_drawn_again():
    program = runpy.run_path(str(DOCS / "pictures.py"))
    drawn = {*program["COMMANDS"], *program["SCRIPTS"], *program["OTHERS"]}
    there = {path.name: path for path in (DOCS / "images").iterdir()}
    assert set(there) == drawn
    pages = "".join(path.read_text(encoding="utf-8") for path in [*DOCS.glob("*.md"), DOCS.parent / "README.md"])
    assert not [name for name in there if f"images/{name}" not in pages]
    assert not [name for name, path in there.items() if name.endswith(".png") and path.stat().st_size > 300_000]
