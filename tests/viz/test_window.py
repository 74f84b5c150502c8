"""The window of ``view``: its controls off screen, and the command on a display with real keys and clicks."""

import math
import signal
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from support.commands import error_of, start_program, until
from support.pictures import pixels
from support.results import motion_of
from warp_plate.analysis.motion import mode_motions
from warp_plate.result.model import save_result
from warp_plate.studies.localize import localize
from warp_plate.viz.availability import missing_window
from warp_plate.viz.scene3d import SCALARS
from warp_plate.viz.window import ALL, FASTEST, ViewerWindow, window_plotter

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

# Longest wait for a window on a busy machine [s].
PATIENCE = 90.0
SEARCH = {"particles": 4, "iterations": 3}


@pytest.fixture
def window(scene, drawing, tmp_path):
    """A window off screen without a timer; the drives have amplitudes of 100 nm and phases of their own."""
    x, y = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, np.pi, 11))
    shape = 1e-7 * np.sin(x) * np.sin(y)
    shown = [motion_of(name, shape, lag, frames=60) for lag, name in enumerate(("equal", "single", "best"))]
    with closing(window_plotter(len(shown), off_screen=True)) as plotter:
        yield ViewerWindow(plotter, scene(), shown, "displacement", tmp_path / "shot", 30.0)


def test_frames_follow_the_clock(window, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    window.tick()
    window.go(0)
    for seconds, frame in ((0.0, 0), (0.11, 3), (0.05, 4), (1.0, 34)):
        clock[0] += seconds
        window.tick()
        assert window.plates.frame == frame
    window.step(-window.plates.frame - 1)
    clock[0] += 7.0
    window.tick()
    assert (window.playing, window.plates.frame) == (False, 59)
    assert window.sliders["time"].GetRepresentation().GetValue() == pytest.approx(59 / 60 / 200)


def test_sliders_are_followed_within_limits(window):
    factor = window.plates.scales[0].warp_factor
    for (name, slider), value in zip(window.sliders.items(), (0.0025, 12, 3), strict=True):
        slider.GetRepresentation().SetValue(value)
        slider.InvokeEvent("InteractionEvent")
        assert slider.GetRepresentation().GetValue() == pytest.approx(value, rel=5e-3), name
    assert (window.playing, window.plates.frame, window.rate) == (False, 30, 12)
    assert window.plates.scales[0].warp_factor == pytest.approx(3 * factor, rel=5e-3)
    window.exaggerate(0.0)
    assert window.plates.scales[0].warp_factor > 0
    for rate, limited in ((1000.0, FASTEST), (0.0, 1.0)):
        window.set_rate(rate)
        assert window.rate == limited


def test_one_drive_fills_the_window_and_all_come_back(window, tmp_path):
    renderers = [window.plotter.renderers[index] for index in range(3)]
    viewports, camera = [renderer.GetViewport() for renderer in renderers], renderers[1].camera
    position, scale = camera.position, camera.parallel_scale
    window.colour_by("phase")
    window.show_only("single")
    assert [renderer.GetDraw() for renderer in renderers] == [0, 1, 0]
    assert renderers[1].GetViewport()[::2] == pytest.approx((viewports[0][0], viewports[2][2]))
    phase = window.plates.motions[1].phase * 180 / math.pi
    np.testing.assert_allclose(window.plates.plates[1].meshes.surface.point_data[SCALARS], phase.ravel())
    camera.azimuth += 40
    window.show_only(ALL)
    assert [renderer.GetDraw() for renderer in renderers] == [1, 1, 1]
    assert [renderer.GetViewport() for renderer in renderers] == viewports
    assert camera.position == pytest.approx(position)
    assert camera.parallel_scale == pytest.approx(scale)
    # Screenshots are numbered.
    assert [window.screenshot().name for _ in range(2)] == ["shot-1.png", "shot-2.png"]
    assert (tmp_path / "shot-2.png").read_bytes().startswith(b"\x89PNG")
    window.stem = tmp_path / "nowhere" / "shot"
    window.screenshot()
    assert "cannot be written" in window.status.GetInput()


def test_modes_have_periods_instead_of_times_and_no_fields(scene, drawing, tmp_path):
    modes = mode_motions(scene(), [1, 2, 3, 4])
    with closing(window_plotter(4, off_screen=True)) as plotter:
        window = ViewerWindow(plotter, scene(), modes, "energy", tmp_path / "x", 30.0)
        window.go(15)
        assert window.sliders["time"].GetRepresentation().GetValue() == 0.25
        assert (len(window.plates.plates), list(window.field_buttons), len(window.case_buttons)) == (4, [], 5)
        assert (window.plates.scales[0].clim, window.plates.scales[0].unit) == ((-1.0, 1.0), "")
        assert window.plates.plates[2].caption.GetInput() == modes[2].name


@pytest.fixture
def saved_result(scene, tmp_path):
    """The path of a result with three cases."""
    made = localize(scene(damping=200.0, search=SEARCH), device="cpu", estimate=False)
    return save_result(made, tmp_path / "panel.h5")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only on Linux is there a system without displays")
@pytest.mark.parametrize("display", [None, ":987"])
def test_without_a_display_other_commands_are_named(saved_result, monkeypatch, command, display):
    monkeypatch.delenv("DISPLAY", raising=False)
    if display is not None:
        monkeypatch.setenv("DISPLAY", display)
    assert f"warp-plate render {saved_result}" in error_of(command("view", saved_result))


@pytest.mark.slow
def test_the_window_opens_plays_and_closes(display, saved_result, tmp_path, monkeypatch):
    """The window responds to real keys and clicks; Ctrl-C closes it too."""
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    if (problem := missing_window()) is not None:
        pytest.skip(problem)

    def xdotool(*words):
        subprocess.run(["xdotool", *map(str, words)], check=True, timeout=PATIENCE)

    def opened():
        process = start_program("-m", "warp_plate", "view", "panel.h5", "--device", "cpu", cwd=tmp_path)
        # Keys go to the window below the mouse.
        at = ("mousemove", "--window", "%1", 400, 200)
        xdotool("search", "--sync", "--onlyvisible", "--name", "warp-plate view", *at)
        return process

    def picture(number):
        xdotool("key", "S")
        path = tmp_path / f"panel-view-{number}.png"
        until(lambda: process.poll() is not None or (path.exists() and path.stat().st_size), PATIENCE)
        time.sleep(0.2)
        return pixels(path)[:-160]  # without the controls

    process = opened()
    xdotool("key", "space")
    still = picture(1)
    assert (np.ptp(still, axis=-1) > 100).sum() > 2000
    assert (picture(2) == still).all()
    for number, key in enumerate(("Right", "Up", "c", "d", "h"), start=3):
        before = still
        xdotool("key", key)
        still = picture(number)
        assert (still != before).any(axis=-1).sum() > 300, key
    # The button "play", at the left of the strip of controls.
    xdotool("search", "--name", "warp-plate view", "mousemove", "--window", "%1", 28, len(still) + 160 - 73, "click", 1)
    time.sleep(0.5)
    assert (picture(8) != still).any()
    xdotool("key", "q")
    assert (process.communicate(timeout=PATIENCE)[1], process.returncode) == ("", 0)
    process = opened()
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    assert (process.communicate(timeout=PATIENCE)[1], process.returncode) == ("", 0)
