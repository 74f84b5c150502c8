"""The explorer's window: the stage at its left, sliders, buttons and numbers at its right."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from warp_plate.result.live import QUADRANTS, DriveResponse
from warp_plate.viz.controls import QUIET, Buttons, Slider
from warp_plate.viz.explorer import CHOICES, ROWS, SEARCH_SECONDS, Live, Stage, factor_text, share_texts
from warp_plate.viz.lettering import add_text

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkTextActor

Pair = tuple[float, float]
SIZE = (1360, 860)
FONT_SIZE = 15
STAGE, PANEL = 0.68, 0.32
# Actuators whose sliders fit into the panel.
ACTUATORS = 5
# As wide as a digit.
FIGURE_SPACE = "\u2007"
# Of the timer that asks for the next picture.
MILLISECONDS = 10


class ExplorerWindow:
    """A live model in a PyVista plotter of ``make_plotter``; ``tick`` shows the next picture."""

    def __init__(self, plotter: pyvista.Plotter, model: Live) -> None:
        self.plotter = plotter
        self.model = model
        self.stage = Stage(plotter, model, FONT_SIZE)
        self.first = 0  # of the actuators whose sliders are shown
        self._shown: DriveResponse | None = None
        self._last = time.perf_counter()
        plotter.subplot(0, 1)
        plotter.renderer.InteractiveOff()
        self._line = FONT_SIZE / plotter.renderer.GetSize()[1]
        self._build()
        plotter.disable_anti_aliasing()
        plotter.add_key_event("space", self.pause)
        for number, choice in enumerate(CHOICES, start=1):
            plotter.add_key_event(str(number), partial(self.choose, choice))

    def choose(self, choice: str) -> None:
        """As the button does."""
        self.model.choose(choice, SEARCH_SECONDS)
        self.choices.mark(choice)
        self.plotter.render()

    def pause(self) -> None:
        """Stop the motion, or let it go on."""
        self.stage.playing = not self.stage.playing
        self.pages.say("pause", "pause" if self.stage.playing else "play")
        self.plotter.render()

    def tick(self) -> bool:
        """Show the model as it is now, and tell whether that took another picture."""
        now = time.perf_counter()
        moved = self.stage.advance(now - self._last)
        self._last = now
        changed = self._read() or moved
        if changed:
            self.plotter.render()
        return changed

    def _build(self) -> None:
        plotter, model, ranges = self.plotter, self.model, self.model.ranges
        names = [actuator.name for actuator in model.scene.actuators]
        top = 1 - 1.5 * self._line
        self.sliders: dict[str, Slider] = {}

        def add(key: str, name: str, ends: Pair, where: Pair, changed: Callable[[float], object]) -> None:
            self.sliders[key] = Slider(plotter, name, ends, ends[0], (*where, top), FONT_SIZE, changed)

        left, right = (0.04, 0.46), (0.52, 0.94)
        add("frequency", "frequency [Hz]", ranges.frequency, left, model.set_frequency)
        add("damping", "damping [N·s/m³]", (0.0, ranges.damping), right, model.set_damping)
        self._names = []
        for slot in range(min(len(names), ACTUATORS)):
            top -= 4.0 * self._line
            self._names.append(add_text(plotter, "", (0.04, top), FONT_SIZE, QUIET))
            top -= 1.6 * self._line
            magnitude, phase = partial(self._set_magnitude, slot), partial(self._set_phase, slot)
            add(f"magnitude {slot}", f"w [{model.scene.drive_unit}]", (0.0, ranges.magnitude), left, magnitude)
            add(f"phase {slot}", "φ [rad]", (0.0, 2 * math.pi), right, phase)
        top -= 4.4 * self._line
        words = {key: f"{number} {word}" for number, (key, word) in enumerate(CHOICES.items(), start=1)}
        self.choices = Buttons(plotter, words, (0.04, top), 3, FONT_SIZE, self.choose)
        top -= 4.6 * self._line
        more = {"before": "◀ actuators", "after": "actuators ▶"} if len(names) > ACTUATORS else {}
        self.pages = Buttons(plotter, {"pause": "pause", **more}, (0.04, top), 3, FONT_SIZE, self._page)
        top -= 3.0 * self._line
        self.numbers = add_text(plotter, "", (0.04, top), FONT_SIZE)
        top -= 6.4 * self._line
        self.quadrants = {}
        for index, name in enumerate(QUADRANTS):
            where = (0.04 + 0.2 * (index % 2), top + 2.0 * self._line * (index // 2))
            self.quadrants[name] = _cell(add_text(plotter, "", where, FONT_SIZE))
        self.status = add_text(plotter, "", (0.04, 4.6 * self._line), FONT_SIZE, "#b2182b")
        self._read()

    def _set_magnitude(self, slot: int, value: float) -> None:
        self.choices.mark(None)
        self.model.set_actuator(self.first + slot, magnitude=value)

    def _set_phase(self, slot: int, value: float) -> None:
        self.choices.mark(None)
        self.model.set_actuator(self.first + slot, phase=value)

    def _page(self, key: str) -> None:
        if key == "pause":
            self.pause()
            return
        last = len(self.model.scene.actuators) - ACTUATORS
        step = ACTUATORS if key == "after" else -ACTUATORS
        self.first = min(max(self.first + step, 0), last)

    def _read(self) -> bool:
        """Sliders and numbers follow the model; whether any of them changed."""
        wanted, actuators = self.model.settings, self.model.scene.actuators
        shown = [
            self.sliders["frequency"].show(wanted.frequency),
            self.sliders["damping"].show(wanted.damping),
            _say(self.status, _folded(self.model.status(), 48)),
        ]
        for slot, name in enumerate(self._names):
            index = self.first + slot
            shown.append(_say(name, f"{index + 1}  {actuators[index].name}"))
            shown.append(self.sliders[f"magnitude {slot}"].show(wanted.magnitude[index]))
            shown.append(self.sliders[f"phase {slot}"].show(wanted.phase[index]))
        reading = self.model.read()
        if reading is not self._shown:
            self._shown = reading
            shown.append(_say(self.numbers, _numbers(reading)))
            for name, share in share_texts(reading).items():
                shown.append(_say(self.quadrants[name], f" {share:{FIGURE_SPACE}>7} "))
        return any(shown)


def make_plotter(off_screen: bool = False) -> pyvista.Plotter:
    """With the subplots that the window fills."""
    import pyvista

    return pyvista.Plotter(
        shape=(2, 2),
        groups=[([0, 1], 1)],
        row_weights=list(ROWS),
        col_weights=[STAGE, PANEL],
        border=False,
        window_size=list(SIZE),
        theme=pyvista.themes.DocumentTheme(),
        lighting="none",
        off_screen=off_screen,
        title="warp-plate explore",
    )


def open_window(model: Live) -> None:
    """Show a live model until its window is closed; ``viz.availability.missing_window`` says whether it can be."""
    plotter = make_plotter()
    window = ExplorerWindow(plotter, model)
    plotter.add_timer_event(max_steps=2**31 - 1, duration=MILLISECONDS, callback=lambda _: window.tick())
    plotter.show()


def _numbers(reading: DriveResponse) -> str:
    """Localization factor, bound and energy, a line each; the quadrants' shares stand below."""
    factor = factor_text(reading).replace(", ", "\n")
    return f"{factor}\nkinetic energy {reading.energy['plate']:.3g} J; by quadrant, as they lie:"


def _cell(text: vtkTextActor) -> vtkTextActor:
    look = text.GetTextProperty()
    look.FrameOn()
    look.SetFrameColor(0.6, 0.6, 0.6)
    return text


def _say(text: vtkTextActor, words: str) -> bool:
    """Show these words; whether they are others than before."""
    if text.GetInput() == words:
        return False
    text.SetInput(words)
    return True


def _folded(line: str, width: int) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(line, width)[:3])
