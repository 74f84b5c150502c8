"""The explorer's picture as data, and refusals of the command."""

import math

import numpy as np
import pytest
from conftest import error_of

from warp_plate.explore import live_model
from warp_plate.explore.live_model import LiveModel
from warp_plate.result.motion import QUADRANTS, DriveResponse, SteadyMotion, SwarmSnapshot
from warp_plate.viz import explorer_page
from warp_plate.viz.explorer_view import LEAST_SHARE, PERIOD, ExplorerView, share_texts
from warp_plate.viz.pictures import make_plotter

pyvista = pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")


@pytest.fixture
def model(scene):
    made = LiveModel(scene(damping=120.0, window=(0.08, 0.1), search={"particles": 6, "iterations": 8}), "cpu")
    yield made
    made.close()


@pytest.fixture
def view(model, drawing):
    plotter = make_plotter((900, 800), off_screen=True, shape=(2, 1))
    made = ExplorerView(plotter, model, 16)
    made.plotter = plotter
    yield made
    plotter.close()


def points(chart_plot):
    """(points, 2) of a plot of a chart."""
    return np.column_stack([chart_plot.x, chart_plot.y])


def test_the_plate_follows_the_model(view, model):
    pictures = []
    for seconds in (0.0, 0.1, 0.4):
        assert view.advance(seconds)
        surface = view.plate.meshes.surface
        heights = view.plate.scale.warp_factor * model.read().motion.at(view.angle).ravel()
        np.testing.assert_allclose(surface.points[:, 2], heights, rtol=1e-5, atol=1e-9)
        view.plotter.render_window.Render()
        pictures.append(np.asarray(view.plotter.screenshot(return_img=True)).astype(int))
    assert view.angle == pytest.approx(2 * math.pi * 0.5 / PERIOD)
    assert (pictures[0] != pictures[2]).any()
    assert (np.ptp(pictures[0], axis=2) > 60).mean() > 0.01


def test_a_paused_plate_changes_only_with_the_model(view, model):
    view.playing = False
    view.advance(0.2)
    assert view.angle == 0
    assert not view.advance(0.2)
    for change in (
        lambda: model.set_actuator(1, magnitude=0.5),
        lambda: model.set_frequency(250.0),
        lambda: model.choose("found"),
        lambda: model.set_actuator(1, phase=0.5),
    ):
        change()
        model.wait()
        assert view.advance(0.2)
        assert not view.advance(0.2)


def test_caption_and_scale_follow(view, model):
    """Half the drive is drawn half as high in the same scale; twice the drive needs another one."""
    view.angle = 0.7
    view.advance(0)
    first, height = view.plate.scale, np.abs(view.plate.meshes.surface.points[:, 2]).max()

    def drive(magnitude):
        for index in range(3):
            model.set_actuator(index, magnitude=magnitude)
        view.advance(0)
        return view.plate.scale.limit, model.read().motion.peak()

    drive(0.5)
    assert view.plate.scale == first
    assert np.abs(view.plate.meshes.surface.points[:, 2]).max() == pytest.approx(height / 2, rel=1e-4)
    limit, peak = drive(2.0)
    assert limit >= peak > first.limit
    limit, peak = drive(0.1 * LEAST_SHARE)
    assert LEAST_SHARE * limit <= peak <= limit
    model.set_frequency(250.0)
    model.choose("exact")
    model.wait()
    view.advance(0)
    text, bound = view.plate.caption.GetInput(), f"{100 * model.read().bound:.2f} %"
    assert text.startswith("250 Hz")
    assert f"localization factor {bound}, bound {bound}" in text


def test_the_swarm_is_drawn(view, model):
    charts = view.search
    assert not charts.history.visible
    assert charts.hint.GetVisibility()
    model.choose("found", seconds=0.01)
    model.wait()
    view.advance(0)
    swarm = model.swarm()
    assert charts.history.visible
    assert not charts.hint.GetVisibility()
    bound, best, factors = [points(plot) for plot in (*charts.history.plots("line"), *charts.history.plots("scatter"))]
    np.testing.assert_allclose(best, np.column_stack([np.arange(1, 9), swarm.best]))
    np.testing.assert_allclose(factors, np.column_stack([np.full(6, 8), swarm.factors]))
    np.testing.assert_allclose(bound[:, 1], model.read().bound)
    *particles, first_mark, second_mark = (points(plot) for plot in charts.plane.plots("scatter"))
    for index, (drawn, mark) in enumerate(zip(particles, (first_mark, second_mark), strict=True), start=1):
        phasors, found = swarm.phasors[:, index], swarm.best_phasors[index]
        np.testing.assert_allclose(drawn, np.column_stack([phasors.real, phasors.imag]))
        np.testing.assert_allclose(mark, [[found.real, found.imag]])
    model.set_actuator(0, magnitude=0.5)
    view.advance(0)
    assert not charts.history.visible


def test_a_swarm_without_a_finite_loss_and_without_a_bound(view):
    swarm = SwarmSnapshot(
        np.ones((4, 3), complex), np.full(4, np.nan), np.array([np.nan]), best_phasors=None, iterations=5, running=True
    )
    view.search.show(swarm, None)
    assert [plot.visible for plot in view.search.plane.plots("scatter")] == [True, True, False, False]
    assert not next(iter(view.search.history.plots("line"))).visible


def test_texts_of_a_plate_at_rest(scene):
    motion = SteadyMotion(np.array([1]), np.zeros((1, 13, 13), complex))
    reading = DriveResponse(scene(), np.zeros(3, complex), motion, dict.fromkeys(("plate", *QUADRANTS), 0.0), None)
    assert set(share_texts(reading).values()) == {"—"}


def test_the_buttons_are_the_choices_of_the_model():
    assert tuple(explorer_page.CHOICES) == live_model.CHOICES


def test_refusals_name_the_library_the_port_or_the_device(write_scene, monkeypatch, command, drawing):
    write_scene(damping=120.0)
    if explorer_page.missing_page():
        pytest.skip("the page cannot be served here")
    for words, *options in (
        ("cuda:99", "--device", "cuda:99"),
        ("--port -1", "--port", -1),
        ("70000", "--port", 70000),
    ):
        assert words in error_of(command("explore", "panel.toml", "--web", *options))
    monkeypatch.setattr(explorer_page.importlib.util, "find_spec", lambda name: None)
    assert "pip install 'warp-plate[web]'" in error_of(command("explore", "panel.toml"))
