"""The viewer's window: what its controls do, and the command under an X server with real keys and clicks."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from warp_plate import viz
from warp_plate.analysis.motion import mode_motions, motions
from warp_plate.cli.main import main
from warp_plate.result import save_result
from warp_plate.studies.simulate import simulate
from warp_plate.viz.availability import missing_window, off_screen
from warp_plate.viz.quantity import QUANTITIES
from warp_plate.viz.surface import FIELD
from warp_plate.viz.window import ALL, FASTEST, Window, window_plotter

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

# A window on a busy machine may take its time.
PATIENCE = 90.0


@pytest.fixture
def result(scene):
    made = simulate(scene(damping=200.0), device="cpu", estimate=False)
    case = made.cases["drive"]
    return replace(made, cases={"equal": case, "single": case, "best": replace(case, phasors=2 * case.phasors)})


@pytest.fixture
def window(result, tmp_path):
    """A window off screen, whose time stands still but for ``tick``."""
    if (problem := viz.missing()) is not None:
        pytest.skip(problem)
    shown = motions(result.scene, result.cases, device="cpu")
    with off_screen():
        plotter = window_plotter(len(shown), off_screen=True)
        yield Window(plotter, result.scene, shown, "displacement", tmp_path / "shot", 30.0)
        plotter.close()


def test_time_passes_while_it_plays(window, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    window.tick()
    window.go(0)
    for seconds, frame in ((0.0, 0), (0.11, 3), (0.05, 4), (1.0, 34)):
        clock[0] += seconds
        window.tick()
        assert window.comparison.frame == frame % window.comparison.frames
    window.pause()
    before = window.comparison.frame
    clock[0] += 7.0
    window.tick()
    assert window.comparison.frame == before
    window.pause()
    clock[0] += 1 / 30 + 1e-6
    window.tick()
    assert window.comparison.frame == (before + 1) % window.comparison.frames


def test_steps_go_round_and_stop_it(window):
    window.step(-1)
    last = window.comparison.frames - 1
    assert (window.playing, window.comparison.frame) == (False, last)
    assert window.sliders["time"].value == pytest.approx(window.comparison.motions[0].times[last])
    window.step(1)
    assert window.comparison.frame == 0


def test_heights_and_speed_have_limits(window):
    factor = window.comparison.scale.factor
    window.exaggerate(2 * factor)
    assert window.comparison.scale.factor == pytest.approx(2 * factor, rel=5e-3)
    field = window.comparison.motions[1].displacement[window.comparison.frame]
    heights = window.comparison.plates[1].meshes.surface.points[:, 2]
    np.testing.assert_allclose(heights, window.comparison.scale.factor * field.ravel(), atol=1e-7)
    window.exaggerate(0.0)
    assert window.comparison.scale.factor > 0
    window.set_rate(1000.0)
    assert window.rate == FASTEST
    window.set_rate(0.0)
    assert window.rate == 1.0


def test_a_drive_alone_fills_the_window_and_all_come_back(window):
    renderers = [window.plotter.renderers[index] for index in range(3)]
    places = [renderer.GetViewport() for renderer in renderers]
    window.colour_by("phase")
    window.exaggerate(1000.0)
    window.step(4)
    window.show_only("single")
    assert [motion.name for motion in window.comparison.motions] == ["single"]
    assert [renderer.GetDraw() for renderer in renderers] == [1, 0, 0]
    left, bottom, right, top = renderers[0].GetViewport()
    assert (left, bottom) == pytest.approx(places[0][:2])
    assert (right, top) == pytest.approx(places[2][2:])
    plate, scale = window.comparison.plates[0], window.comparison.scale
    assert (window.comparison.frame, scale.factor, scale.quantity) == (4, 1000.0, QUANTITIES["phase"])
    phase = window.motions["single"].phase * 180 / math.pi
    np.testing.assert_allclose(plate.meshes.surface.point_data[FIELD], phase.ravel())
    window.colour_by("energy")
    limits = window.comparison.scale.limits
    window.show_only(ALL)
    assert window.comparison.scale.limits == limits
    assert [renderer.GetDraw() for renderer in renderers] == [1, 1, 1]
    assert [renderer.GetViewport() for renderer in renderers] == places
    assert len(window.comparison.plates) == 3


def test_views_as_at_first(window):
    camera = window.plotter.renderers[1].camera
    first = camera.position
    camera.azimuth += 40
    camera.zoom(2)
    assert camera.position != pytest.approx(first)
    window.look_again()
    assert window.plotter.renderers[1].camera.position == pytest.approx(first)


def test_screenshots_are_numbered(window, tmp_path):
    assert [window.screenshot().name for _ in range(2)] == ["shot-1.png", "shot-2.png"]
    assert (tmp_path / "shot-2.png").read_bytes().startswith(b"\x89PNG")
    window.stem = tmp_path / "nowhere" / "shot"
    window.screenshot()
    assert "cannot be written" in window.status.GetInput()


def test_natural_shapes_have_neither_fields_nor_drives_to_choose(scene, tmp_path):
    if (problem := viz.missing()) is not None:
        pytest.skip(problem)
    made = scene()
    with off_screen():
        plotter = window_plotter(4, off_screen=True)
        window = Window(plotter, made, mode_motions(made, [1, 2, 3, 4]), "displacement", tmp_path / "x", 30.0)
        assert len(window.comparison.plates) == 4
        for key in ("c", "d"):
            for does in plotter.iren._key_press_event_callbacks[key]:
                does()
        window.go(15)
        assert window.sliders["time"].value == 0.25
        assert (window.quantity, window.shown) == ("displacement", window.comparison.motions[0].name)
        plotter.close()


# The command ------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only on Linux is there a system without displays")
@pytest.mark.parametrize("display", [None, ":987"])
def test_without_a_display_it_says_what_to_do(result, tmp_path, monkeypatch, capsys, display):
    monkeypatch.delenv("DISPLAY", raising=False)
    if display is not None:
        monkeypatch.setenv("DISPLAY", display)
    path = save_result(result, tmp_path / "result.h5")
    with pytest.raises(SystemExit) as left:
        main(["view", str(path)])
    assert left.value.code == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"warp-plate render {path}" in line
    assert "explore SCENE --web" in line


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--rate", "0"], "--rate 0: must be from 1 to 120"),
        (["--heights", "-1"], "--heights -1: must be above 0"),
        (["--field", "stress"], "stress"),
    ],
)
def test_bad_options_are_named(result, tmp_path, capsys, options, complaint):
    with pytest.raises(SystemExit) as left:
        main(["view", str(save_result(result, tmp_path / "result.h5")), *options])
    assert left.value.code == 2
    assert complaint in capsys.readouterr().err


class Desk:
    """A window of ``warp-plate view`` on a display, and the keyboard and mouse before it."""

    def __init__(self, display, folder, result):
        self.folder = folder
        self.environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self.environment.pop("VTK_DEFAULT_OPENGL_WINDOW", None)
        path = save_result(result, folder / "panel.h5")
        command = [sys.executable, "-m", "warp_plate", "view", str(path), "--device", "cpu"]
        self.process = subprocess.Popen(command, cwd=folder, env=self.environment, stderr=subprocess.PIPE, text=True)
        self.shots = 0
        ask = ["search", "--sync", "--onlyvisible", "--name", "warp-plate view"]
        self.id = self.tool(*ask).split()[0]
        # Without a window manager, keys go to the window below the mouse.
        self.tool("mousemove", "--window", self.id, "400", "200")

    def tool(self, *arguments):
        run = subprocess.run(
            ["xdotool", *arguments], env=self.environment, capture_output=True, text=True, timeout=PATIENCE
        )
        assert run.returncode == 0, run.stderr
        return run.stdout

    def press(self, *keys):
        for key in keys:
            self.tool("key", key)

    def picture(self):
        """The window as Shift+S keeps it, once all keys before have done their work."""
        from matplotlib.image import imread

        self.shots += 1
        self.press("S")
        path = self.folder / f"panel-view-{self.shots}.png"
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and self.process.poll() is None:
            if path.exists() and path.stat().st_size:
                time.sleep(0.2)
                return np.round(imread(path)[..., :3] * 255).astype(int)
            time.sleep(0.05)
        pytest.fail(f"no {path.name}; {self.process.poll()}")


@pytest.fixture
def desk(display, result, tmp_path, monkeypatch):
    monkeypatch.setenv("DISPLAY", display)
    if (problem := missing_window()) is not None:
        pytest.skip(problem)
    made = Desk(display, tmp_path, result)
    yield made
    if made.process.poll() is None:
        made.process.kill()
    made.process.communicate()


@pytest.mark.slow
def test_keys_and_clicks_do_what_they_say(desk):
    desk.press("space")
    still = desk.picture()
    height = len(still)
    # All the window but the strip below and the line that names the file.
    plates = np.s_[: height - 160]
    assert ((still[plates].max(axis=-1) - still[plates].min(axis=-1)) > 100).sum() > 2000
    assert (desk.picture()[plates] == still[plates]).all()
    changed = {}
    for key in ("Right", "Up", "c", "d", "h"):
        before = desk.picture()[plates]
        desk.press(key)
        changed[key] = int((desk.picture()[plates] != before).any(axis=-1).sum())
    assert min(changed.values()) > 300, json.dumps(changed)
    # The keys' list is hidden again; then the button "pause" plays, which shows in the plates without any key.
    desk.press("h")
    before = desk.picture()[plates]
    desk.tool("mousemove", "--window", desk.id, "45", str(height - 150 + 75), "click", "1")
    time.sleep(0.5)
    assert (desk.picture()[plates] != before).any()
    desk.press("q")
    assert desk.process.wait(PATIENCE) == 0
    assert desk.process.stderr.read() == ""


@pytest.mark.slow
def test_ctrl_c_closes_the_window(desk):
    desk.picture()
    desk.process.send_signal(signal.SIGINT)
    assert desk.process.wait(PATIENCE) == 0
    assert desk.process.stderr.read() == ""
