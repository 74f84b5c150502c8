"""What the explorer draws, as data; its refusals on the command line."""

import math
import sys
import time

import numpy as np
import pytest

from warp_plate import viz
from warp_plate.cli.main import main
from warp_plate.explore.live_model import LiveModel
from warp_plate.result.live import DriveResponse, SteadyMotion, SwarmSnapshot
from warp_plate.scene.dump import dump_scene
from warp_plate.viz import explorer_page, explorer_window
from warp_plate.viz.availability import off_screen
from warp_plate.viz.explorer import CHOICES, LOWEST, Stage, factor_text, share_texts

pyvista = pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")


@pytest.fixture
def drawing():
    """Skips the test where nothing can be drawn off screen."""
    if (problem := viz.missing()) is not None:
        pytest.skip(problem)
    with off_screen():
        yield


@pytest.fixture
def model(scene):
    made = LiveModel(scene(damping=120.0, window=(0.08, 0.1), search={"particles": 6, "iterations": 8}), "cpu")
    yield made
    made.close()


@pytest.fixture
def stage(model, drawing):
    plotter = explorer_page._make_plotter()
    yield Stage(plotter, model, 16)
    plotter.close()


def points(chart_plot):
    """(points, 2) of a plot of a chart."""
    return np.column_stack([np.asarray(chart_plot.x), np.asarray(chart_plot.y)])


# Stage ------------------------------------------------------------------------------------------------------


def test_the_plate_is_the_models(stage, model):
    """Heights are the displacement at the phase shown times the factor, and go on with time."""
    for seconds in (0.0, 0.1, 0.4):
        stage.advance(seconds)
        surface = stage.plate.meshes.surface
        field = model.read().motion.at(stage.turn)
        np.testing.assert_allclose(surface.points[:, 2], stage.plate.scale.factor * field.ravel(), rtol=1e-5, atol=1e-9)
    assert stage.turn == pytest.approx(2 * math.pi * 0.5 / 1.5)
    stage.playing = False
    stage.advance(0.2)
    assert stage.turn == pytest.approx(2 * math.pi * 0.5 / 1.5)


def test_what_stands_still_is_not_drawn_again(model, drawing, monkeypatch):
    """A paused window renders when something changes, and only then."""
    plotter = explorer_window.make_plotter(off_screen=True)
    window = explorer_window.ExplorerWindow(plotter, model)
    plotter.show(auto_close=False, interactive=False)
    drawn = []
    monkeypatch.setattr(type(plotter), "render", lambda self: drawn.append(1))
    assert window.tick()
    window.pause()
    window.tick()
    drawn.clear()
    assert not any(window.tick() for _ in range(3))
    assert not drawn
    for change in (
        lambda: model.set_actuator(1, magnitude=0.5),
        lambda: model.set_frequency(250.0),
        lambda: model.choose("found"),
        lambda: model.set_actuator(1, phase=0.5),
    ):
        change()
        model.wait()
        drawn.clear()
        assert window.tick()
        assert drawn
        assert not window.tick()
    window.pause()
    time.sleep(0.01)
    assert window.tick()
    plotter.close()


def test_a_harder_drive_moves_more_until_the_scale_ends(stage, model):
    """Half the drive is drawn half as high, in the same colours; twice the drive takes another scale."""
    stage.turn = 0.7
    stage.advance(0)
    first, height = stage.plate.scale, np.abs(stage.plate.meshes.surface.points[:, 2]).max()
    for index in range(3):
        model.set_actuator(index, magnitude=0.5)
    stage.advance(0)
    assert stage.plate.scale == first
    assert np.abs(stage.plate.meshes.surface.points[:, 2]).max() == pytest.approx(height / 2, rel=1e-4)
    for index in range(3):
        model.set_actuator(index, magnitude=2.0)
    stage.advance(0)
    assert stage.plate.scale.limit >= model.read().motion.peak() > first.limit
    for index in range(3):
        model.set_actuator(index, magnitude=0.1 * LOWEST)
    stage.advance(0)
    assert LOWEST * stage.plate.scale.limit <= model.read().motion.peak() <= stage.plate.scale.limit


def test_texts_follow(stage, model):
    model.set_frequency(250.0)
    model.choose("exact")
    model.wait()
    assert model.status() == ""
    stage.advance(0)
    shown = stage.plate.heading.GetInput()
    assert "250 Hz" in shown
    bound = f"{100 * model.read().bound:.2f} %"
    assert f"localization factor {bound}, bound {bound}" in shown


def test_the_swarm_is_drawn(stage, model):
    """History, bound, particles of this iteration and their drives, each as the search has them."""
    charts = stage.search
    assert not charts.history.visible
    assert charts.hint.GetVisibility()
    model.choose("found", seconds=0.01)
    model.wait()
    stage.advance(0)
    swarm = model.swarm()
    assert charts.history.visible
    assert not charts.hint.GetVisibility()
    np.testing.assert_allclose(points(charts._best), np.column_stack([np.arange(1, 9), swarm.best]))
    np.testing.assert_allclose(points(charts._factors), np.column_stack([np.full(6, 8), swarm.factors]))
    np.testing.assert_allclose(points(charts._bound)[:, 1], model.read().bound)
    for index, (particles, mark) in enumerate(zip(charts._particles, charts._marks, strict=True), start=1):
        drives = swarm.drives[:, index]
        np.testing.assert_allclose(points(particles), np.column_stack([drives.real, drives.imag]))
        np.testing.assert_allclose(points(mark), [[swarm.best_phasors[index].real, swarm.best_phasors[index].imag]])
    model.set_actuator(0, magnitude=0.5)
    stage.advance(0)
    assert not charts.history.visible


def test_a_swarm_without_a_finite_loss_and_without_a_bound(stage):
    """Nothing is marked as best."""
    nothing = SwarmSnapshot(
        np.ones((4, 3), complex), np.full(4, np.nan), np.array([np.nan]), best_phasors=None, iterations=5, running=True
    )
    stage.search.show(nothing, None)
    assert not any(mark.visible for mark in stage.search._marks)
    assert not stage.search._bound.visible


def test_texts_of_a_plate_at_rest(scene):
    """Not defined, rather than a number."""
    energy = dict.fromkeys(("plate", "target", "lower left", "lower right", "upper left", "upper right"), 0.0)
    motion = SteadyMotion(np.array([1]), np.zeros((1, 13, 13), complex))
    reading = DriveResponse(scene(), np.zeros(3, complex), motion, energy, None)
    assert factor_text(reading) == "localization factor not defined"
    assert set(share_texts(reading).values()) == {"—"}


def test_pictures_are_drawn(stage):
    """Two phases are two pictures, both in colours."""
    pictures = []
    for seconds in (0.0, 0.5):
        stage.advance(seconds)
        stage.plotter.render_window.Render()
        pictures.append(np.asarray(stage.plotter.screenshot(return_img=True)).astype(int))
    assert np.any(pictures[0] != pictures[1])
    for picture in pictures:
        assert (picture.max(axis=2) - picture.min(axis=2) > 60).mean() > 0.01


def test_the_window_pages_through_many_actuators(scene, drawing):
    """Five fit; the sliders are those of the actuators that their names say, and move these."""
    areas = [(0.02 + 0.02 * index, 0.03 + 0.02 * index, 0.05, 0.1) for index in range(7)]
    model = LiveModel(scene(nodes=(21, 21), damping=120.0, actuators=areas), "cpu")
    plotter = explorer_window.make_plotter(off_screen=True)
    try:
        window = explorer_window.ExplorerWindow(plotter, model)
        plotter.show(auto_close=False, interactive=False)
        for presses, first in (("after", 2), ("after", 2), ("before", 0), ("before", 0), ("after", 2)):
            window.pages._pressed(presses)
            window.tick()
            assert [name.GetInput().split()[0] for name in window._names] == [str(first + k + 1) for k in range(5)]
        window.sliders["magnitude 4"]._changed(0.25)
        window.sliders["phase 4"]._changed(1.5)
        assert model.settings.magnitude == (1, 1, 1, 1, 1, 1, 0.25)
        assert model.settings.phase[6] == 1.5
    finally:
        plotter.close()
        model.close()


def test_choices_are_the_models():
    from warp_plate.explore.live_model import CHOICES as known

    assert tuple(CHOICES) == known


# Command ----------------------------------------------------------------------------------------------------


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys, scene):
    """The line with which a command on a small scene is refused."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "panel.toml").write_text(dump_scene(scene(damping=120.0)), encoding="utf-8")

    def run(*arguments):
        with pytest.raises(SystemExit) as left:
            main(["explore", "panel.toml", *arguments])
        captured = capsys.readouterr()
        assert (left.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
        return captured.err

    return run


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only on Linux is there a system without displays")
def test_without_a_display_it_says_what_to_do(refused, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    assert "no window can be opened: there is no display" in refused()
    assert "'warp-plate explore panel.toml --web' shows the same in a browser" in refused()


def test_without_trame_it_says_what_to_install(refused, monkeypatch):
    monkeypatch.setattr(explorer_page.importlib.util, "find_spec", lambda name: None)
    assert "the page needs trame: pip install 'warp-plate[web]'" in refused("--web")


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none(refused, port):
    assert f"--port {port}: must be from 1 to 65535, or 0" in refused("--web", "--port", str(port))


def test_a_device_that_is_not_there(refused):
    if explorer_page.missing_page() or viz.missing():
        pytest.skip("the page cannot be served here")
    assert "device = 'cuda:99': not on this machine" in refused("--web", "--device", "cuda:99")
