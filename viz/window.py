"""The window of ``warp-plate view``: plates in motion, with PyVista's sliders, buttons and keys."""

from __future__ import annotations

import itertools
import signal
import time
from collections import ChainMap
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.interrupts import END_SIGNALS
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import LEGEND_WIDTH, add_text, case_label, free_width, look_at_plate, style_text
from warp_plate.viz.fields import DEFAULT_COLOURS, FIELDS, ColourOptions
from warp_plate.viz.pictures import make_plotter
from warp_plate.viz.scene3d import SideBySide, plate_subplots, rows_and_columns
from warp_plate.viz.styles import INK

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkInteractionWidgets import vtkButtonWidget

# In pixels: largest window, width of a plate, least height of a single row, strip of controls, button and its column.
MOST_WIDE, MOST_HIGH, PLATE, LEAST_HIGH, STRIP, BUTTON, COLUMN = 1500, 900, 620, 560, 150, 18, 172
FONT_SIZE = 15
# Height of a plate's subplot over its width; interval of the timer [ms]; most frames a second.
ASPECT, TIMER, FASTEST = 0.8, 10, 60.0
# Factor of a key press for rate and heights.
STEP = 1.25
ALL = "all"


class ViewerWindow:
    """Motions in a plotter of :func:`window_plotter`; :meth:`tick` shows the next frame.

    Args:
        quantity: field in colour, a key of FIELDS.
        stem: path of screenshots without number and ending.
        rate: frames a second.
        colours: colour map and limits.

    Attributes:
        playing: True while frames follow the clock.
        shown: name of the motion that is shown alone, or ALL.
        ratio: factor of heights over the first factor.
    """

    def __init__(
        self, plotter: pyvista.Plotter, scene: Scene, motions: Sequence[Motion], quantity: str, stem: Path, rate: float,
        colours: ColourOptions = DEFAULT_COLOURS,
    ) -> None:  # fmt: skip
        self.plotter, self.scene, self.stem, self.rate, self.quantity = plotter, scene, stem, rate, quantity
        self.plates = SideBySide(plotter, scene, motions, quantity, FONT_SIZE, colours)
        self.names, self.shown, self.playing = [motion.name for motion in motions], ALL, False
        self._warp_factor, self.ratio = self.plates.scales[0].warp_factor, 1.0
        self._modes = motions[0].localization_factor is None
        self._moments = np.linspace(0, 1, self.plates.frames, endpoint=False) if self._modes else motions[0].times
        self._position, self._clock = 0.0, time.perf_counter()
        rows, self._columns = rows_and_columns(len(motions))
        places = [divmod(place, self._columns) for place in range(rows * self._columns)]
        self._renderers = [plotter.renderers[int(plotter.renderers.loc_to_index(place))] for place in places]
        self._viewports = [renderer.GetViewport() for renderer in self._renderers]
        self._add_controls(rows)
        plotter.subplot(0, 0)
        keys = self._keys()
        self.keys = add_text(plotter, "\n".join(f"{name:<15}{use}" for name, use, _ in keys), (0.03, 0.8), FONT_SIZE)
        style_text(style := self.keys.GetTextProperty(), FONT_SIZE - 2, font="DejaVuSansMono")
        style.SetBackgroundColor(1, 1, 1)
        style.SetBackgroundOpacity(0.9)
        self.keys.VisibilityOff()
        for name, callback in ChainMap(*(callbacks for *_, callbacks in keys)).items():
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
        self._update("time", self._moments[self.plates.frame])

    def go_to(self, moment: float) -> None:
        """Stop at the frame nearest to a time [s], or to a part of the period of modes."""
        self.step(int(np.abs(self._moments - moment).argmin()) - self.plates.frame)

    def play(self, playing: bool) -> None:
        """Start or stop."""
        self.playing = playing
        self.play_button.GetRepresentation().SetState(playing)
        self.plotter.render()

    def step(self, frames: int) -> None:
        """Stop, and move by a number of frames."""
        self.play(False)
        self.go(self.plates.frame + frames)

    def set_rate(self, rate: float) -> None:
        """Set the frames a second."""
        self.rate = min(max(rate, 1.0), FASTEST)
        self._update("rate", self.rate)

    def exaggerate(self, ratio: float) -> None:
        """Exaggerate heights by this multiple of their first factor."""
        self.plates.exaggerate(self._warp_factor * max(ratio, 1e-3))
        self.ratio = self.plates.scales[0].warp_factor / self._warp_factor
        self._update("heights", self.ratio)

    def colour_by(self, quantity: str) -> None:
        """Show another field in colour."""
        self.quantity = quantity
        self.plates.colour_by(quantity)
        _check(self.field_buttons, quantity)
        self.plotter.render()

    def show_only(self, name: str) -> None:
        """Enlarge one motion to the whole window, or show ALL side by side; colours stay the same."""
        self.shown = name
        left, bottom, right, top = np.transpose(self._viewports)
        window = (left.min(), bottom.min(), right.max(), top.max())
        for index, (renderer, viewport) in enumerate(zip(self._renderers, self._viewports, strict=True)):
            alone = self.names[index : index + 1] == [name]
            renderer.SetViewport(*(window if alone else viewport))
            renderer.SetDraw(alone or name == ALL)
            renderer.SetInteractive(alone or name == ALL)
            renderer.RemoveViewProp(self.keys)
        self._renderers[self.names.index(name) if name != ALL else 0].AddViewProp(self.keys)
        _check(self.case_buttons, name)
        self.reset_view()

    def reset_view(self) -> None:
        """Point all cameras as at first."""
        for index in range(len(self.names)):
            self.plotter.subplot(*divmod(index, self._columns))
            share = free_width(self.plotter, FONT_SIZE) if self.plates.colours.separate else 1.0
            look_at_plate(self.plotter, self.scene.plate.size, FONT_SIZE, share)
        self.plotter.render()

    def screenshot(self) -> Path:
        """Write the window to the next free file name."""
        paths = (Path(f"{self.stem}-{number}.png") for number in itertools.count(1))
        path = next(path for path in paths if not path.exists())
        try:
            self.plotter.screenshot(path)
            self.status.SetInput(f"wrote {path}")
        except OSError as error:
            self.status.SetInput(f"{path}: cannot be written: {error.strerror}")
        self.plotter.render()
        return path

    def _update(self, slider: str, value: float) -> None:
        self.sliders[slider].GetRepresentation().SetValue(value)
        self.plotter.render()

    def _add_controls(self, row: int) -> None:
        """Fill the strip below the plates."""
        plotter, moments = self.plotter, self._moments
        plotter.subplot(row, 0)
        plotter.renderer.InteractiveOff()
        self.status = add_text(plotter, "h: list of keys", (0.013, 0.14), FONT_SIZE, "#08519c")
        self.play_button = self._add_button("play", 20, 64, plotter.add_checkbox_button_widget, self.play, True)
        fields = {} if self._modes else {name: name.replace("-", " ") for name in FIELDS}
        self.field_buttons = self._add_buttons(fields, 64, COLUMN, self.colour_by, self.quantity)
        cases = {name: case_label(name, self.scene) for name in self.names} | {ALL: "side by side"}
        self.case_buttons = self._add_buttons(cases if len(self.names) > 1 else {}, 34, 0, self.show_only, ALL)
        self.sliders: dict[str, Any] = {}
        for key, title, ends, value, left, right, callback in (
            ("time", f"time [{'periods' if self._modes else 's'}]", moments[[0, -1]], 0.0, 0.02, 0.42, self.go_to),
            ("rate", "frames per second", (1.0, FASTEST), self.rate, 0.48, 0.70, self.set_rate),
            ("heights", "heights, 1 at first", (0.0, 4.0), 1.0, 0.76, 0.98, self.exaggerate),
        ):
            look = {"style": "modern", "fmt": "%.4g", "slider_width": 0.12, "tube_width": 0.03, "color": INK}
            place = {"pointa": (left, 0.65), "pointb": (right, 0.65)}
            slider = plotter.add_slider_widget(lambda _: None, ends, value=max(value, ends[0]), **place, **look)
            self.sliders[key], bar = slider, slider.GetRepresentation()
            slider.AddObserver("InteractionEvent", lambda *_, bar=bar, call=callback: call(bar.GetValue()))
            bar.SetLabelHeight(0.11)
            bar.SetSliderLength(0.006)
            bar.SetEndCapLength(0.0)
            style_text(bar.GetLabelProperty(), FONT_SIZE)
            add_text(plotter, title, (left, 0.97), FONT_SIZE)

    def _add_buttons(
        self, labels: dict[str, str], y: int, left: int, callback: Callable[[str], None], chosen: str
    ) -> dict[str, vtkButtonWidget]:
        """Add a row of radio buttons."""
        column = min(COLUMN, (self.plotter.window_size[0] - left) // max(1, len(labels)))
        add = partial(self.plotter.add_radio_button_widget, radio_button_group=f"row {y}")
        return {
            name: self._add_button(label, left + index * column + 20, y, add, partial(callback, name), name == chosen)
            for index, (name, label) in enumerate(labels.items())
        }

    def _add_button(
        self, label: str, x: int, y: int, add: Callable[..., Any], callback: Callable[..., None], value: bool
    ) -> vtkButtonWidget:
        style_text(self.plotter.add_text(label, position=(x + 1.5 * BUTTON, y)).prop, FONT_SIZE)
        look = {"size": BUTTON, "border_size": 4, "color_on": "#08519c", "color_off": "#c4c4c4"}
        return add(callback=callback, value=value, position=(x, y), **look)

    def _keys(self) -> list[tuple[str, str, dict[str, Callable[[], object]]]]:
        """Return keys as in their list, their use, and callbacks by VTK's names of the keys."""

        def next_of(buttons: dict[str, Any], name: str, callback: Callable[[str], None]) -> None:
            if names := [*buttons, *buttons]:
                callback(names[names.index(name) + 1])

        def show_keys() -> None:
            self.keys.SetVisibility(not self.keys.GetVisibility())
            self.plotter.render()

        rates, heights = (("comma", 1 / STEP), ("period", STEP)), (("Up", STEP), ("Down", 1 / STEP))
        return [
            ("space", "play, pause", {"space": lambda: self.play(not self.playing)}),
            ("left, right", "previous, next frame", {"Left": partial(self.step, -1), "Right": partial(self.step, 1)}),
            (", and .", "slower, faster", {key: lambda by=by: self.set_rate(self.rate * by) for key, by in rates}),
            ("up, down", "heights", {key: lambda by=by: self.exaggerate(self.ratio * by) for key, by in heights}),
            ("c", "next field in colour", {"c": lambda: next_of(self.field_buttons, self.quantity, self.colour_by)}),
            ("d", "next drive, or all", {"d": lambda: next_of(self.case_buttons, self.shown, self.show_only)}),
            ("Shift+S", "screenshot", {"S": self.screenshot}),
            ("Home", "initial view", {"Home": self.reset_view}),
            ("h", "these keys", {"h": show_keys}),
            ("q", "close", {}),
            ("drag, wheel", "turn, zoom", {}),
            ("r, w, s", "fit, wireframe, surface", {}),
        ]


def window_plotter(plates: int, separate: bool = False, **options: object) -> pyvista.Plotter:
    """Return a plotter with subplots for the plates, their legend or ``separate`` ones, and the strip of controls below
    them."""
    rows, columns = rows_and_columns(plates)
    most_wide = (MOST_WIDE - LEGEND_WIDTH * FONT_SIZE * (columns if separate else 1)) / columns
    width = round(min(PLATE * (1.6 if plates == 1 else 1), most_wide, (MOST_HIGH - STRIP) / rows / ASPECT))
    # A drive shown alone takes the whole row.
    height = max(round(width * ASPECT), LEAST_HIGH if rows == 1 else 0)
    subplots = plate_subplots(plates, width, FONT_SIZE, separate)
    subplots |= {"shape": (rows + 1, subplots["shape"][1]), "row_weights": [height] * rows + [STRIP]}
    subplots["groups"] = [(rows, np.s_[:])]
    size = (sum(subplots["col_weights"]), rows * height + STRIP)
    return make_plotter(size, title="warp-plate view", **subplots, **options)


def open_window(
    scene: Scene, motions: Sequence[Motion], quantity: str, stem: Path, rate: float, heights: float | None,
    colours: ColourOptions = DEFAULT_COLOURS,
) -> None:  # fmt: skip
    """Show motions until the window is closed."""
    plotter = window_plotter(len(motions), colours.separate)
    window = ViewerWindow(plotter, scene, motions, quantity, stem, rate, colours)
    if heights is not None:
        window.exaggerate(heights / window.plates.scales[0].warp_factor)
    plotter.add_timer_event(max_steps=2**31 - 1, duration=TIMER, callback=lambda _: window.tick())
    # Ctrl-C closes the window as q does; VTK would end the process.
    before = {number: signal.signal(number, lambda *_: plotter.iren.terminate_app()) for number in END_SIGNALS}
    try:
        plotter.show()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _check(buttons: dict[str, vtkButtonWidget], chosen: str) -> None:
    for name, button in buttons.items():
        button.GetRepresentation().SetState(name == chosen)
