"""The explorer's window on a display, with real mouse and keys; what it did is told by the process that shows it."""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from warp_plate.scene.dump import dump_scene

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

ROOT = Path(__file__).parents[2]
# Shared machines are slow at times; nothing here waits so long where all is well.
PATIENCE = 60.0
# Opens the window by the command, and tells after each picture where everything stands, where that is new.
DRIVER = """
import json, sys
import warp_plate.viz.explorer_window as module
from warp_plate.cli.main import main

tick, told = module.ExplorerWindow.tick, []

def tell(self):
    tick(self)
    if not told:
        width, height = self.plotter.render_window.GetSize()
        flip = lambda at: (at[0], height - at[1])
        places = {key: flip(self.choices.centre(key)) for key in module.CHOICES}
        places["pause"] = flip(self.pages.centre("pause"))
        for key, slider in self.sliders.items():
            for share in (0.25, 0.75):
                low, high = slider._bar.GetMinimumValue(), slider._bar.GetMaximumValue()
                places[f"{key} {share}"] = flip(slider.place(low + share * (high - low)))
            places[key] = flip(slider.place(slider.value))
        print(json.dumps(places), flush=True)
    reading, wanted, swarm = self.model.read(), self.model.settings, self.model.swarm()
    state = {
        "factor": reading.localization_factor, "bound": reading.bound, "frequency": reading.scene.drive.frequency,
        "magnitude": wanted.magnitude, "phase": wanted.phase, "playing": self.stage.playing,
        "knob": self.sliders["magnitude 1"]._bar.GetValue(), "heading": self.stage.plate.heading.GetInput(),
        "numbers": self.numbers.GetInput(), "particles": None if swarm is None else len(swarm.phasors),
        "camera": list(self.plotter.renderers[0].camera.position),
    }
    line = json.dumps(state)
    if line not in told:
        told[:] = [line]
        print(line, flush=True)

module.ExplorerWindow.tick = tell
main(["explore", "panel.toml", "--device", "cpu"])
"""


class Hand:
    """A window, and xdotool in front of it."""

    def __init__(self, process, display):
        self.process = process
        self.environment = {**os.environ, "DISPLAY": display}
        self.lines = queue.Queue()
        threading.Thread(target=lambda: [self.lines.put(line) for line in process.stdout], daemon=True).start()
        self.places = json.loads(self.lines.get(timeout=PATIENCE))
        self.state = json.loads(self.lines.get(timeout=PATIENCE))
        found = self._do("search", "--sync", "--name", "warp-plate explore")
        self.window = found.split()[0]

    def _do(self, *arguments):
        run = subprocess.run(
            ["xdotool", *map(str, arguments)], env=self.environment, capture_output=True, text=True, timeout=PATIENCE
        )
        return run.stdout

    def move(self, x, y):
        self._do("mousemove", "--window", self.window, x, y)

    def click(self, place):
        self.move(*self.places[place])
        self._do("click", 1)

    def drag(self, key, share):
        """The knob of a slider to this share of its way."""
        self.drag_between(self.places[key], self.places[f"{key} {share}"])

    def drag_between(self, start, end):
        self.move(*start)
        self._do("mousedown", 1)
        for part in (0.3, 0.6, 1.0):
            self.move(*(round(a + part * (b - a)) for a, b in zip(start, end, strict=True)))
            time.sleep(0.1)
        self._do("mouseup", 1)

    def press(self, key):
        self.move(300, 300)
        self._do("key", "--window", self.window, key)

    def wait(self, holds):
        """Until it holds of the state."""
        until = time.monotonic() + PATIENCE
        while not holds(self.state):
            try:
                self.state = json.loads(self.lines.get(timeout=max(0.1, until - time.monotonic())))
            except queue.Empty:
                pytest.fail(f"still {self.state}")
        return self.state


@pytest.fixture
def hand(display, tmp_path, scene):
    made = scene(damping=120.0, window=(0.08, 0.1), search={"particles": 6, "iterations": 12})
    (tmp_path / "panel.toml").write_text(dump_scene(made), encoding="utf-8")
    (tmp_path / "driver.py").write_text(DRIVER, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "driver.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "DISPLAY": display},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield Hand(process, display)
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_mouse_and_keys(hand):
    """Everything of the window once, for opening it takes seconds."""
    start = hand.state
    assert start["magnitude"] == [1, 1, 1]

    # A drive slider: the factor, not the bound; its knob is where the hand left it.
    hand.drag("magnitude 1", 0.25)
    state = hand.wait(lambda now: abs(now["magnitude"][1] - 0.5) < 0.02)
    assert state["factor"] != start["factor"]
    assert state["bound"] == start["bound"]
    assert state["knob"] == state["magnitude"][1]
    hand.drag("phase 2", 0.75)
    hand.wait(lambda now: abs(now["phase"][2] - 4.71) < 0.1)

    # Frequency: the bound too, and the texts.
    hand.drag("frequency", 0.75)
    state = hand.wait(lambda now: abs(now["frequency"] - 449.5) < 6 and now["bound"] != start["bound"])
    state = hand.wait(lambda now: f"{now['frequency']:.4g} Hz" in now["heading"])
    assert f"bound {100 * state['bound']:.2f} %" in state["numbers"]

    # Buttons and keys; sliders follow.
    hand.click("exact")
    hand.wait(lambda now: abs(now["factor"] - now["bound"]) < 1e-9)
    hand.click("equal")
    hand.wait(lambda now: now["magnitude"] == [1, 1, 1] and now["knob"] == 1)
    hand.press("3")
    hand.wait(lambda now: sorted(now["magnitude"]) == [0, 0, 1])
    hand.click("found")
    hand.wait(lambda now: now["particles"] == 6)
    hand.press("space")
    hand.wait(lambda now: not now["playing"])
    hand.click("pause")
    hand.wait(lambda now: now["playing"])

    # Elsewhere the mouse turns the plate.
    hand.drag_between((300, 300), (380, 330))
    hand.wait(lambda now: now["camera"] != start["camera"])

    hand.press("q")
    hand.process.wait(timeout=PATIENCE)
    assert hand.process.returncode == 0
    assert hand.process.stderr.read() == ""
