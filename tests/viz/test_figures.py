"""Pictures of whole results, and what is said where nothing can be drawn."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import result_of, start_program

from warp_plate import viz
from warp_plate.result import Case
from warp_plate.scene import Scene
from warp_plate.viz import availability
from warp_plate.viz.plots.search import plot_history

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

TIMES = (0.0464, 0.0696)
SHARES = {"best": 0.6853, "equal": 0.25, "single": 0.6367}


@pytest.fixture
def result():
    """A result like that of ``localize paper``; amplitudes of the cases differ by factors of ten."""
    x, cases = np.linspace(0, np.pi, 27), {}
    for rank, (name, share) in enumerate(SHARES.items()):
        waves = [np.outer(np.sin((3 + step) * x), np.sin((rank + 2) * x)) for step in range(len(TIMES))]
        energy = {"target": share * 1e-9, "plate": 1e-9}
        cases[name] = Case(np.ones(4, complex), energy, 2e-7 * 10.0**-rank * np.stack(waves), np.zeros((0, 3)))
    best = np.maximum.accumulate(0.68 - 0.3 * np.exp(-np.arange(80) / 9) * (1 + np.sin(np.arange(80))) / 2)
    history = {"evaluations": np.arange(20, 1601, 20), "best": best, "mean": best - 0.1}
    held = {"source": "paper", "times": np.array(TIMES), "bound": 0.6867, "history": history}
    return result_of(Scene.load("paper"), cases, **held)


@pytest.fixture
def new_trial():
    """Repeat the trial drawing in this test and in the next."""
    availability.working_window.cache_clear()
    yield
    availability.working_window.cache_clear()


def pixels(path):
    from matplotlib.image import imread

    return np.round(imread(path)[..., :3] * 255).astype(int)


def test_surfaces_show_every_case_and_time(result, drawing, tmp_path):
    viz.draw_surfaces(result, tmp_path / "figure.png")
    picture = pixels(tmp_path / "figure.png")
    assert picture.shape[1] == pytest.approx(1600, abs=50)
    red = picture[..., 0] - picture[..., 2]
    for row in np.split(np.arange(len(picture)), 3):
        for left in (0, 710):
            panel = np.ix_(row, np.arange(left, left + 710))
            # Each row has limits of its own, so that both colours show in spite of amplitudes that differ.
            assert (red[panel] > 100).sum() > 1000
            assert (red[panel] < -100).sum() > 1000
            assert (picture[panel][:70].max(axis=-1) < 100).sum() > 500
            # Nothing is cut off at the sides.
            assert (picture[panel][70:, :5] > 250).all()
    assert (picture[[0, 1, 2, -3, -2, -1]] > 250).all()


def test_history_has_the_bound_and_the_published_loss(result, tmp_path):
    from matplotlib import rc_context

    with rc_context({"svg.fonttype": "none"}):
        viz.draw_history(result, tmp_path / "history.svg")
        viz.draw_history(replace(result, source="panel.toml", bound=None), tmp_path / "other.svg")
    text, without = ((tmp_path / name).read_text(encoding="utf-8") for name in ("history.svg", "other.svg"))
    for label in ("iteration", "best so far", "swarm mean", "bound: 0.3133", "published: 0.28"):
        assert f">{label}<" in text, label
    assert "bound" not in without
    assert "published" not in without
    viz.draw_history(result, tmp_path / "history.png")
    assert pixels(tmp_path / "history.png").shape[1] == 1600


def test_the_best_loss_never_rises_and_infinite_means_are_gaps(result):
    from matplotlib.figure import Figure

    history = {"best": np.array([0.3, 0.5, 0.4]), "mean": np.array([0.1, -np.inf, 0.2])}
    axes = Figure().add_subplot()
    plot_history(axes, replace(result, history=history))
    lines = {line.get_label(): line.get_ydata() for line in axes.get_lines()}
    np.testing.assert_allclose(lines["best so far"], [0.7, 0.5, 0.5])
    np.testing.assert_allclose(lines["swarm mean"], [0.9, np.nan, 0.8])
    assert lines["bound: 0.3133"][0] == pytest.approx(1 - 0.6867)


def test_all_pictures_that_a_result_holds(result, drawing, tmp_path):
    written, problem = viz.draw_all(result, tmp_path / "paper")
    assert problem is None
    assert sorted(written) == sorted(tmp_path.iterdir())
    assert {path.name for path in written} == {"paper-surfaces.png", "paper-history.png"}
    empty = replace(result, history={}, times=np.zeros(0))
    assert viz.draw_all(empty, tmp_path / "empty") == ([], None)
    for draw, match in ((viz.draw_surfaces, "no displacement"), (viz.draw_history, "no history")):
        with pytest.raises(ValueError, match=match):
            draw(empty, tmp_path / "empty.png")
    written, problem = viz.draw_all(result, tmp_path / "no such folder" / "paper")
    assert written == []
    assert problem.count("cannot be written") == 2


# Availability -----------------------------------------------------------------------------------------------


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the packages are named for Linux")
def test_if_vtk_crashes_only_surfaces_are_missing(result, monkeypatch, new_trial, tmp_path):
    monkeypatch.setattr(availability, "TRIAL", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    written, problem = viz.draw_all(result, tmp_path / "paper")
    assert written == [tmp_path / "paper-history.png"]
    assert "apt-get install libegl1 libgl1-mesa-dri" in problem
    assert "\n" not in problem
    with pytest.raises(viz.DrawingUnavailable, match="no EGL or OSMesa driver"):
        viz.draw_surfaces(result, tmp_path / "paper.png")


@pytest.mark.parametrize(
    ("trial", "reason"),
    [("raise ImportError('libX.so.1: cannot open')", "libX.so.1"), ("import time; time.sleep(9)", "cannot be drawn")],
)
def test_failed_trials_are_reported(monkeypatch, new_trial, trial, reason):
    monkeypatch.setattr(availability, "TRIAL", trial)
    monkeypatch.setattr(availability, "TIMEOUT", 1.0)
    assert reason in viz.missing_renderer()


def test_missing_packages_are_named(result, monkeypatch, new_trial, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    written, problem = viz.draw_all(result, tmp_path / "paper")
    assert written == []
    assert all(words in problem for words in ("PyVista", "Matplotlib", "pip install 'warp-plate[viz]'"))


def run_python(code):
    """Return what a program wrote on standard output and error."""
    return tuple(text.strip() for text in start_program("-c", code).communicate())


def test_off_screen_drawing_is_quiet(drawing):
    code = """
from warp_plate.viz.availability import set_up_renderer
set_up_renderer()
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
plotter.add_mesh(pyvista.Sphere())
print(plotter.screenshot(return_img=True).std() > 0)
plotter.close()
"""
    assert run_python(code) == ("True", "")


def test_importing_loads_neither_drawing_libraries_nor_the_solver():
    heavy = {"pyvista", "vtkmodules", "matplotlib", "PIL", "warp", "IPython"}
    code = f"import sys, warp_plate.viz, warp_plate.viz.notebook; print(sorted({heavy!r} & set(sys.modules)))"
    assert run_python(code) == ("[]", "")
