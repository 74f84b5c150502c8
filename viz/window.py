"""The viewer's window: plates in motion, with sliders, buttons and keys."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.camera import look_at_plate
from warp_plate.viz.comparison import Comparison, drive_words, layout, rows_and_columns
from warp_plate.viz.controls import Buttons, Slider
from warp_plate.viz.lettering import LEGEND_WIDTH, add_text, style_text
from warp_plate.viz.pictures import make_plotter
from warp_plate.viz.quantity import QUANTITIES

if TYPE_CHECKING:
    import pyvista

FONT_SIZE = 15
# In pixels: of a window at most, of one plate, and of the strip with sliders and buttons.
WIDEST, HIGHEST, PLATE, STRIP = 1500, 900, 620, 150
# Height of a plate's subplot over its width; the least height of a single row.
SHAPE, LOWEST = 0.8, 560
# Of the timer that asks for the next frame; frames a second at most.
MILLISECONDS, FASTEST = 10, 60.0
HIGHER = 1.25
ALL = "all"
KEYS = """space          play, pause
left, right    a frame back, on
, and .        slower, faster
up, down       heights
c              next field in colour
d              next drive, or all
Shift+S        screenshot
Home           view as at first
h              these keys
q              close
drag, wheel    turn, zoom
r, w, s        fit, wireframe, surface"""


class Window:
    """Motions in a plotter of :func:`window_plotter`; :meth:`tick` shows the next frame.

    comparison: what is shown; playing; rate: frames a second.
    """

    def __init__(
        self, plotter: pyvista.Plotter, scene: Scene, motions: Sequence[Motion], quantity: str, stem: Path, rate: float
    ) -> None:
        """stem: of the files of screenshots, without a number and ending."""
        self.plotter = plotter
        self.scene = scene
        self.motions = {motion.name: motion for motion in motions}
        self.quantity = quantity
        self.stem = stem
        self.rate = rate
        self.playing = True
        self.shown = ALL
        rows, columns = rows_and_columns(len(self.motions))
        self._columns = columns
        at = plotter.renderers.loc_to_index
        self._plates = [int(at((row, column))) for row in range(rows) for column in range(columns)]
        self._legend = int(at((0, columns)))
        self._viewports = [plotter.renderers[index].GetViewport() for index in self._plates]
        self.comparison = Comparison(plotter, scene, motions, quantity, FONT_SIZE)
        self._factor = self.comparison.scale.factor
        # Natural shapes have a period each.
        self._natural = motions[0].localization_factor is None
        count = self.comparison.frames
        self._moments = np.arange(count) / count if self._natural else motions[0].times
        self._position, self._last = 0.0, time.perf_counter()
        self._build_strip(rows)
        self._bind_keys()

    def tick(self) -> None:
        """Show the frame of this moment, if it is another."""
        now = time.perf_counter()
        if self.playing:
            self._position += self.rate * (now - self._last)
            if int(self._position) % self.comparison.frames != self.comparison.frame:
                self.go(self._position)
        self._last = now

    def go(self, frame: float) -> None:
        """Show a frame; after the last come the first ones again."""
        self._position = frame % self.comparison.frames
        self.comparison.show(int(self._position))
        self.sliders["time"].show(float(self._moments[self.comparison.frame]))
        self.plotter.render()

    def pause(self) -> None:
        """Stop, or go on."""
        self.playing = not self.playing
        self.actions.say("pause", "pause" if self.playing else "play")
        self.plotter.render()

    def step(self, frames: int) -> None:
        """Stop, so many frames on."""
        if self.playing:
            self.pause()
        self.go(self.comparison.frame + frames)

    def set_rate(self, rate: float) -> None:
        """Frames a second."""
        self.rate = min(max(rate, 1.0), FASTEST)
        self.sliders["rate"].show(self.rate)
        self.plotter.render()

    def exaggerate(self, factor: float) -> None:
        """Heights, times their true size."""
        self.comparison.exaggerate(max(factor, 1e-3 * self._factor))
        self.sliders["heights"].show(self.comparison.scale.factor / self._factor)
        self.plotter.render()

    def colour_by(self, quantity: str) -> None:
        """Another quantity in colour."""
        self.quantity = quantity
        self.comparison.colour_by(quantity)
        self.fields.mark(quantity)
        self.plotter.render()

    def show_only(self, name: str) -> None:
        """One drive alone, as large as the window and with the same colours; or ALL, side by side."""
        self.shown = name
        motions = list(self.motions.values()) if name == ALL else [self.motions[name]]
        factor, frame = self.comparison.scale.factor, self.comparison.frame
        for index in (*self._plates, self._legend):
            self.plotter.renderers[index].clear()
        whole = np.array(self._viewports)
        alone = (whole[:, 0].min(), whole[:, 1].min(), whole[:, 2].max(), whole[:, 3].max())
        for place, index in enumerate(self._plates):
            renderer = self.plotter.renderers[index]
            used = place < len(motions)
            renderer.SetViewport(*(alone if name != ALL and used else self._viewports[place]))
            renderer.SetDraw(used)
            renderer.SetInteractive(used)
        legend, alike = (0, self._columns), list(self.motions.values())
        self.comparison = Comparison(self.plotter, self.scene, motions, self.quantity, FONT_SIZE, legend, alike)
        self.plotter.renderers[self._plates[0]].AddViewProp(self.keys)
        self.comparison.exaggerate(factor)
        self.comparison.show(frame)
        self.drives.mark(name)
        self.plotter.render()

    def look_again(self) -> None:
        """The view as at first."""
        for place in range(len(self.comparison.plates)):
            self.plotter.subplot(*divmod(place, self._columns))
            look_at_plate(self.plotter, self.scene.plate.size, FONT_SIZE)
        self.plotter.render()

    def screenshot(self) -> Path:
        """Write the window to the next free file."""
        number = 1
        while (path := Path(f"{self.stem}-{number}.png")).exists():
            number += 1
        try:
            self.plotter.screenshot(path)
            self._say(f"wrote {path}")
        except OSError as error:
            self._say(f"{path}: cannot be written: {error.strerror}")
        return path

    def toggle_keys(self) -> None:
        """Show or hide what the keys do."""
        self.keys.SetVisibility(not self.keys.GetVisibility())
        self.plotter.render()

    def _say(self, words: str) -> None:
        self.status.SetInput(words)
        self.plotter.render()

    def _build_strip(self, row: int) -> None:
        plotter = self.plotter
        plotter.subplot(row, 0)
        plotter.renderer.InteractiveOff()
        line = FONT_SIZE / plotter.renderer.GetSize()[1]
        moments, name = self._moments, "time, in periods" if self._natural else "time [s]"
        self.sliders = {
            key: Slider(plotter, name, ends, value, (left, right, 1 - 0.5 * line), FONT_SIZE, changed)
            for key, name, ends, value, (left, right), changed in (
                ("time", name, (moments[0], moments[-1]), moments[0], (0.02, 0.42), self._to_time),
                ("rate", "frames a second", (1.0, FASTEST), self.rate, (0.48, 0.70), self.set_rate),
                ("heights", "heights, 1 as at first", (0.0, 4.0), 1.0, (0.76, 0.98), self._to_heights),
            )
        }

        def buttons(words: dict[str, str], row: int, pressed: Callable[[str], object], columns: int = 6) -> Buttons:
            top = 1 - (4.0 + 2.2 * row) * line
            return Buttons(plotter, words, (0.02, top), columns, FONT_SIZE, pressed)

        actions = {"pause": "pause", "screenshot": "screenshot", "keys": "keys (h)"}
        does = {"pause": self.pause, "screenshot": self.screenshot, "keys": self.toggle_keys}
        self.actions = buttons(actions, 0, lambda key: does[key]())
        self._field_names = [] if self._natural else list(QUANTITIES)
        fields = {name: name.replace("-", " ") for name in self._field_names}
        self.fields = buttons(fields, 1, self.colour_by)
        self._drive_names = [*self.motions, ALL] if len(self.motions) > 1 else []
        words = {name: drive_words(name, self.comparison.scene) for name in self.motions} | {ALL: "side by side"}
        row, columns = (1, 7) if self._natural else (2, 6)
        self.drives = buttons({name: words[name] for name in self._drive_names}, row, self.show_only, columns)
        self.fields.mark(self.quantity)
        self.drives.mark(ALL)
        self.status = add_text(plotter, "", (0.53, 1 - 4.0 * line), FONT_SIZE, "#08519c")
        plotter.subplot(0, 0)
        self.keys = add_text(plotter, KEYS, (0.03, 0.8), FONT_SIZE)
        style_text(self.keys.GetTextProperty(), FONT_SIZE - 2, font="DejaVuSansMono")
        self.keys.GetTextProperty().SetBackgroundColor(1, 1, 1)
        self.keys.GetTextProperty().SetBackgroundOpacity(0.9)
        self.keys.VisibilityOff()

    def _to_heights(self, times: float) -> None:
        self.exaggerate(times * self._factor)

    def _to_time(self, moment: float) -> None:
        if self.playing:
            self.pause()
        self.go(int(np.abs(self._moments - moment).argmin()))

    def _bind_keys(self) -> None:
        def colour_on() -> None:
            if self._field_names:
                self.colour_by(_after(self._field_names, self.quantity))

        def drive_on() -> None:
            if self._drive_names:
                self.show_only(_after(self._drive_names, self.shown))

        keys: dict[str, Callable[[], object]] = {
            "space": self.pause,
            "Left": lambda: self.step(-1),
            "Right": lambda: self.step(1),
            "comma": lambda: self.set_rate(self.rate / HIGHER),
            "period": lambda: self.set_rate(self.rate * HIGHER),
            "Up": lambda: self.exaggerate(self.comparison.scale.factor * HIGHER),
            "Down": lambda: self.exaggerate(self.comparison.scale.factor / HIGHER),
            "c": colour_on,
            "d": drive_on,
            "S": self.screenshot,
            "Home": self.look_again,
            "h": self.toggle_keys,
        }
        for key, does in keys.items():
            self.plotter.add_key_event(key, does)


def window_plotter(plates: int, **options: object) -> pyvista.Plotter:
    """With the subplots of so many plates, their legend and the strip below them."""
    rows, columns = rows_and_columns(plates)
    room = (WIDEST - LEGEND_WIDTH * FONT_SIZE) / columns, (HIGHEST - STRIP) / rows / SHAPE
    each = round(min(PLATE * (1.6 if plates == 1 else 1), *room))
    subplots = layout(plates, each, FONT_SIZE)
    # A drive alone takes the whole row.
    high = max(round(each * SHAPE), LOWEST if rows == 1 else 0)
    subplots |= {
        "shape": (rows + 1, columns + 1),
        "row_weights": [high] * rows + [STRIP],
        "groups": [(rows, np.s_[:])],
    }
    size = (sum(subplots["col_weights"]), rows * high + STRIP)
    return make_plotter(size, title="warp-plate view", **subplots, **options)


def open_window(
    scene: Scene, motions: Sequence[Motion], quantity: str, stem: Path, rate: float, heights: float | None
) -> None:
    """Show motions until the window is closed; ``viz.availability.missing_window`` says whether it can be."""
    plotter = window_plotter(len(motions))
    window = Window(plotter, scene, motions, quantity, stem, rate)
    if heights is not None:
        window.exaggerate(heights)
    plotter.add_timer_event(max_steps=2**31 - 1, duration=MILLISECONDS, callback=lambda _: window.tick())
    # Ctrl-C closes the window as q does; VTK would end the process in its own way.
    before = signal.signal(signal.SIGINT, lambda *_: plotter.iren.terminate_app())
    try:
        plotter.show()
    finally:
        signal.signal(signal.SIGINT, before)


def _after(names: Sequence[str], name: str) -> str:
    """The next of them; the first after the last."""
    return names[(names.index(name) + 1) % len(names)]
