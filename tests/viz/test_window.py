"""The window of ``view``: its controls off screen, and the command on a display with real keys."""

import math
import signal
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from support.commands import error_of, start_program
from support.results import motion_of
from warp_plate.viz.availability import missing_window
from warp_plate.viz.fields import PictureStyle
from warp_plate.viz.scene3d import SCALARS
from warp_plate.viz.window import RATES, ViewerWindow, window_plotter

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

# Longest wait for a window on a busy machine [s].
PATIENCE = 90.0


@pytest.fixture
def window(scene, drawing):
    """A window off screen without a timer; the drives have amplitudes of 100 nm and phases of their own."""
    x, y = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, np.pi, 11))
    shape = 1e-7 * np.sin(x) * np.sin(y)
    shown = [motion_of(name, shape, lag, frames=60) for lag, name in enumerate(("equal", "single", "best"))]
    with closing(window_plotter(len(shown), off_screen=True)) as plotter:
        yield ViewerWindow(plotter, scene(), shown, PictureStyle())


def test_frames_follow_the_clock_and_the_slider(window, monkeypatch):
    clock, bar = [100.0], window.slider.GetRepresentation()
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
    assert bar.GetValue() == pytest.approx(59 / 60 / 200)
    window.play()
    bar.SetValue(0.0025)
    window.slider.InvokeEvent("InteractionEvent")
    assert (window.playing, window.plates.frame) == (False, 30)


def test_keys_change_speed_heights_and_fields(window):
    factor = window.plates.scales[0].height_factor
    window.exaggerate(3.0)
    assert window.plates.scales[0].height_factor == pytest.approx(3 * factor, rel=5e-3)
    for ratio, limited in ((1000.0, RATES[1]), (1e-9, RATES[0])):
        window.speed_up(ratio)
        assert window.rate == limited
    for _ in range(4):
        window.next_field()
    phase = window.plates.motions[1].phase * 180 / math.pi
    np.testing.assert_allclose(window.plates.plates[1].meshes.surface.point_data[SCALARS], phase.ravel())
    window.next_field()
    assert window.quantity == "displacement"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only on Linux is there a system without displays")
@pytest.mark.parametrize("display", [None, ":987"])
def test_without_a_display_other_commands_are_named(result_file, monkeypatch, command, display):
    monkeypatch.delenv("DISPLAY", raising=False)
    if display is not None:
        monkeypatch.setenv("DISPLAY", display)
    assert f"warp-plate render {result_file}" in error_of(command("view", result_file))


@pytest.mark.slow
def test_the_window_opens_plays_and_closes(display, result_file, tmp_path, monkeypatch):
    from PIL import ImageGrab

    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    if (problem := missing_window()) is not None:
        pytest.skip(problem)

    def xdotool(*words):
        subprocess.run(["xdotool", *map(str, words)], check=True, timeout=PATIENCE)

    def opened():
        process = start_program("-m", "warp_plate", "view", result_file, "--device", "cpu", cwd=tmp_path)
        # Keys go to the window below the mouse.
        at = ("mousemove", "--window", "%1", 400, 200)
        xdotool("search", "--sync", "--onlyvisible", "--name", "warp-plate view", *at)
        return process

    def picture():
        time.sleep(0.5)
        return np.asarray(ImageGrab.grab(xdisplay=display), dtype=int)

    process = opened()
    time.sleep(2.0)
    xdotool("key", "space")
    still = picture()
    assert (np.ptp(still, axis=-1) > 100).sum() > 2000
    for key in ("Right", "Up", "c"):
        before = still
        xdotool("key", key)
        still = picture()
        assert (still != before).any(axis=-1).sum() > 300, key
    xdotool("key", "q")
    assert (process.communicate(timeout=PATIENCE)[1], process.returncode) == ("", 0)
    process = opened()
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    assert (process.communicate(timeout=PATIENCE)[1], process.returncode) == ("", 0)
