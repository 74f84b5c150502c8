"""The window of ``warp-plate view``: plates in motion, with a slider for the time, and keys."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.interrupts import END_SIGNALS
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import INK, LEGEND_WIDTH, add_text
from warp_plate.viz.fields import FIELDS, PictureStyle
from warp_plate.viz.pictures import make_plotter
from warp_plate.viz.scene3d import SideBySide, plate_subplots, rows_and_columns

if TYPE_CHECKING:
    import pyvista

# In pixels: largest window, width of a plate, strip with the slider and the keys.
MOST_WIDE, MOST_HIGH, PLATE, STRIP = 1500, 900, 620, 110
FONT_SIZE = 15
# Height of a plate's subplot over its width; interval of the timer [ms]; least and most frames a second.
ASPECT, TIMER, RATES = 0.8, 10, (1.0, 60.0)
# Factor of a key press for rate and heights.
STEP = 1.25
KEYS = "space: play, pause    ← →: single frames    , .: slower, faster    ↑ ↓: heights    c: next field    q: close"


class ViewerWindow:
    """Motions in a plotter of :func:`window_plotter`; :meth:`tick` shows the next frame.

    Attributes:
        playing: True while frames follow the clock.
        quantity: field in colour, a key of FIELDS.
        rate: frames a second.
    """

    def __init__(self, plotter: pyvista.Plotter, scene: Scene, motions: Sequence[Motion], style: PictureStyle) -> None:
        self.plotter, self.quantity, self.rate = plotter, style.quantity, style.rate
        self.plates = SideBySide(plotter, scene, motions, style.quantity, FONT_SIZE, style.colours)
        if style.heights is not None:
            self.plates.exaggerate(style.heights)
        modes = motions[0].localization_factor is None
        aimed = all(motion.target is not None for motion in motions)
        self._fields = [style.quantity] if modes else [name for name in FIELDS if aimed or name != "level"]
        self._moments = np.linspace(0, 1, self.plates.frames, endpoint=False) if modes else motions[0].times
        self._position, self._clock = 0.0, time.perf_counter()
        plotter.subplot(rows_and_columns(len(motions))[0], 0)
        plotter.renderer.InteractiveOff()
        add_text(plotter, f"time [{'periods' if modes else 's'}]", (0.02, 0.9), FONT_SIZE)
        add_text(plotter, KEYS, (0.02, 0.3), FONT_SIZE)
        look = {"style": "modern", "color": INK, "slider_width": 0.2, "tube_width": 0.04, "interaction_event": "always"}
        place = {"pointa": (0.01, 0.5), "pointb": (0.99, 0.5), "value": self._moments[0]}
        self.slider = plotter.add_slider_widget(self.go_to, self._moments[[0, -1]], **place, **look)
        bar = self.slider.GetRepresentation()
        bar.ShowSliderLabelOff()  # captions hold the time
        bar.SetSliderLength(0.006)
        bar.SetEndCapLength(0.0)
        keys = {
            "space": self.play,
            "Left": partial(self.step, -1),
            "Right": partial(self.step, 1),
            "comma": partial(self.speed_up, 1 / STEP),
            "period": partial(self.speed_up, STEP),
            "Up": partial(self.exaggerate, STEP),
            "Down": partial(self.exaggerate, 1 / STEP),
            "c": self.next_field,
        }
        for name, callback in keys.items():
            plotter.add_key_event(name, callback)
        self.playing = True

    def tick(self) -> None:
        """Show the frame of this moment."""
        now = time.perf_counter()
        if self.playing:
            self._position += self.rate * (now - self._clock)
            if int(self._position) % self.plates.frames != self.plates.frame:
                self.go(self._position)
        self._clock = now

    def go(self, frame: float) -> None:
        """Show a frame, counted modulo the number of frames."""
        self._position = frame % self.plates.frames
        self.plates.show(int(self._position))
        self.slider.GetRepresentation().SetValue(self._moments[self.plates.frame])
        self.plotter.render()

    def go_to(self, moment: float) -> None:
        """Stop at the frame nearest to a time [s], or to a part of the period of modes."""
        self.playing, self._position = False, int(np.abs(self._moments - moment).argmin())
        self.plates.show(self._position)
        self.plotter.render()

    def step(self, frames: int) -> None:
        """Stop, and move by a number of frames."""
        self.playing = False
        self.go(self.plates.frame + frames)

    def speed_up(self, ratio: float) -> None:
        """Multiply the frames a second."""
        self.rate = min(max(ratio * self.rate, RATES[0]), RATES[1])

    def exaggerate(self, ratio: float) -> None:
        """Multiply the heights."""
        self.plates.exaggerate(ratio * self.plates.scales[0].height_factor)
        self.plotter.render()

    def next_field(self) -> None:
        """Show the next field in colour."""
        self.quantity = self._fields[(self._fields.index(self.quantity) + 1) % len(self._fields)]
        self.plates.colour_by(self.quantity)
        self.plotter.render()

    def play(self) -> None:
        """Start or stop."""
        self.playing = not self.playing


def window_plotter(plates: int, separate: bool = False, **options: object) -> pyvista.Plotter:
    """Return a plotter with subplots for the plates, their legend or ``separate`` ones, and a strip for the slider."""
    rows, columns = rows_and_columns(plates)
    most_wide = (MOST_WIDE - LEGEND_WIDTH * FONT_SIZE * (columns if separate else 1)) / columns
    width = round(min(PLATE * (1.6 if plates == 1 else 1), most_wide, (MOST_HIGH - STRIP) / rows / ASPECT))
    height = round(width * ASPECT)
    subplots = plate_subplots(plates, width, FONT_SIZE, separate)
    subplots |= {"shape": (rows + 1, subplots["shape"][1]), "row_weights": [height] * rows + [STRIP]}
    subplots["groups"] = [(rows, np.s_[:])]
    size = (sum(subplots["col_weights"]), rows * height + STRIP)
    return make_plotter(size, title="warp-plate view", **subplots, **options)


def open_window(scene: Scene, motions: Sequence[Motion], style: PictureStyle) -> None:
    """Show motions until the window is closed."""
    plotter = window_plotter(len(motions), style.colours.separate)
    window = ViewerWindow(plotter, scene, motions, style)
    plotter.add_timer_event(max_steps=2**31 - 1, duration=TIMER, callback=lambda _: window.tick())
    # Ctrl-C closes the window as q does; VTK would end the process.
    before = {number: signal.signal(number, lambda *_: plotter.iren.terminate_app()) for number in END_SIGNALS}
    try:
        plotter.show()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
