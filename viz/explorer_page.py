"""The explorer as a web page: pictures are drawn here and sent, sliders and buttons run in the browser.

All that the page loads comes from this server; ``explorer_access`` says who may use it.
"""

from __future__ import annotations

import asyncio
import errno
import importlib.util
import logging
import math
import os
import secrets
import socket
import sys
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from warp_plate.interrupts import end_signals
from warp_plate.result.case import amplitudes_as_given
from warp_plate.scene.errors import SceneError
from warp_plate.viz.annotations import in_percent
from warp_plate.viz.explorer_access import guard, is_number, limit_calls
from warp_plate.viz.explorer_view import ROW_WEIGHTS, ExplorerView, level_texts, share_texts
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions
from warp_plate.viz.pictures import make_plotter

if TYPE_CHECKING:
    from warp_plate.explore.live_model import LiveModel

WEB_EXTRA = "pip install 'warp-plate[web]'"
TITLE = "warp-plate explore"
ITERATION_SECONDS = 0.1  # least duration of an iteration of the swarm, so that it can be watched
# Initial size of the picture, and its font size for this size [pixels].
SIZE, FONT_SIZE = (900, 800), 16
# Most pictures a second. The next is drawn once the browser has taken the last but one; unchanged pictures are sent
# only every REPEAT seconds, for browsers that have connected meanwhile.
FRAMES_PER_SECOND, AHEAD, REPEAT = 30.0, 2, 1.0
# Without an answer for this long, nobody is looking or a message was lost [s].
ANSWER_TIMEOUT, JPEG_QUALITY = 1.0, 85
# Loggers that print what browsers send.
SILENT = ("aiohttp.server", "wslink", "trame_server")
AMPLITUDES = {"N": "force", "V": "voltage", "A": "current"}  # names of the magnitudes w by their units
BESIDE = "display: grid; grid-template-columns: 1fr 1fr; column-gap: 18px"
NUMBERS = """
<div style="font-weight: 600; margin-bottom: 6px">{{ title }}</div>
<div style="font-size: 17px">Localization factor <b id="factor">{{ factor }}</b></div>
<div style="font-size: 17px">Bound <b id="bound">{{ bound }}</b></div>
<table id="levels" v-if="levels.length"
  style="width: 100%; table-layout: fixed; margin: 6px 0; font-size: 13px; text-align: right">
  <tr><th v-for="name in ['peaks', 'weakest (g)', '(µm)', 'worst (g)', '(µm)']" style="font-weight: normal">
    {{ name }}</th></tr>
  <tr v-for="row in levels"><td v-for="text in row">{{ text }}</td></tr>
</table>
<div v-if="sound" style="margin: 4px 0">Sound power <b id="sound">{{ sound }}</b>
  <meter id="meter" min="0" max="100" low="40" high="70" optimum="0" :value="sound_level" title="0 to 100 dB(A)"
    style="width: 120px; margin-left: 8px; vertical-align: middle"></meter></div>
<div style="margin-top: 4px">Kinetic energy {{ energy }}; by quadrant:</div>
<div style="display: grid; grid-template-columns: 90px 90px; gap: 3px; margin: 4px 0">
  <div v-for="name in ['upper left', 'upper right', 'lower left', 'lower right']" :id="name.replace(' ', '_')"
    :title="name" style="border: 1px solid #999; padding: 2px 8px; text-align: right">{{ shares[name] }}</div>
</div>
<div style="font-size: 13px">Computed {{ engine }}</div>
<div style="min-height: 3em; color: #b2182b; font-size: 13px">{{ status }}</div>
"""


def missing_page() -> str | None:
    """Return a sentence on what is missing for the page, or None."""
    modules = ("trame", "trame_vtk", "trame_vuetify")
    return None if all(map(importlib.util.find_spec, modules)) else f"the explorer's page needs trame: {WEB_EXTRA}"


def serve_page(
    model: LiveModel, host: str, port: int, on_ready: Callable[[str], object], colours: ColourOptions = DEFAULT_COLOURS
) -> None:
    """Serve a live model until Ctrl-C, at any free port if it is 0; call ``on_ready`` with the address of the page.

    Raises DrawingUnavailable if VTK cannot draw here, OSError if the address is in use or not of this machine, and
    SceneError if the server stops.
    """
    from warp_plate.viz.availability import set_up_renderer

    try:
        host.encode("idna")
    except UnicodeError:
        raise OSError("it is no name of a host") from None
    with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
        pass  # raises here what trame would only log
    set_up_renderer()
    # JPEG cannot be compressed further; trying takes longer than drawing. Read when the server starts.
    os.environ.setdefault("WSLINK_WS_COMPRESS", "0")
    logging.getLogger("asyncio").addFilter(is_no_connection_error)
    for name in SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with suppress(KeyboardInterrupt, asyncio.CancelledError):
        asyncio.run(_until_interrupted(ExplorerPage(model, colours).serve(host, port, on_ready)))


async def _until_interrupted(serving: Coroutine[Any, Any, None]) -> None:
    """Cancel a coroutine on Ctrl-C, SIGTERM or SIGHUP. An exception in a handler would break off the event loop."""
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(serving)
    with end_signals(lambda number, frame: loop.call_soon_threadsafe(task.cancel)):
        await task


class ExplorerPage:
    """A live model on a trame server; :meth:`serve` runs it until it is cancelled."""

    def __init__(self, model: LiveModel, colours: ColourOptions) -> None:
        from trame.app import get_server

        self.colours = colours
        self.model, self.server = model, get_server(TITLE, client_type="vue3")
        self.plotter = make_plotter(SIZE, off_screen=True, shape=(2, 1), row_weights=list(ROW_WEIGHTS))
        self.view: ExplorerView | None = None
        self._size: tuple[int, ...] = ()
        self._fit()
        self._sent = self._taken = 0
        self._answered = asyncio.Event()
        self._build()

    async def serve(self, host: str, port: int, on_ready: Callable[[str], object]) -> None:
        """Answer browsers until the server stops, which is an error; for the arguments see :func:`serve_page`."""
        secret = secrets.token_hex()  # the page sends it in lower case
        self.server.controller.on_server_bind.add(lambda server: guard(server, host, secret))
        self.server.controller.on_server_bind.add(lambda server: limit_calls(server, self._positions()))
        os.environ["TRAME_ARGS"] = ""  # in place of the command line, which is not trame's
        self.server.cli.set_defaults(authKey=secret, nosignalhandlers=True)
        quiet = {"open_browser": False, "show_connection_info": False, "disable_logging": True}
        task = self.server.start(port=port, host=host, exec_mode="task", timeout=0, **quiet)
        while not self.server.running:
            if task.done():
                task.result()
            await asyncio.sleep(0.01)
        on_ready(f"http://{f'[{host}]' if ':' in host else host}:{self.server.port}/?key={secret}")
        try:
            await self._send_pictures(task)
            raise SceneError("the page's server has stopped; start explore again")
        finally:
            # Stopping would wait for browsers that are still connected.
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self.server.stop(), ANSWER_TIMEOUT)

    async def _send_pictures(self, server: asyncio.Task[None]) -> None:
        """Send picture after picture, as fast as the browser takes them, while the server runs."""
        last, sent_at = time.perf_counter(), -math.inf
        while not server.done():
            started = time.perf_counter()
            fitted = self._fit()
            changed = self.view.advance(started - last) or fitted
            last = started
            with self.server.state as state:
                self._update(state)
                if changed or started - sent_at > REPEAT:
                    sent_at = started
                    self._remote.update()
                    self._sent += 1
                    state.picture = self._sent
            await asyncio.sleep(max(0.001, 1 / FRAMES_PER_SECOND - (time.perf_counter() - started)))
            while self._sent - self._taken >= AHEAD:
                self._answered.clear()
                try:
                    await asyncio.wait_for(self._answered.wait(), ANSWER_TIMEOUT)
                except TimeoutError:
                    self._taken = self._sent

    def _fit(self) -> bool:
        """Lay the picture out for the size that the browser asks for; return whether it has changed."""
        size = tuple(self.plotter.render_window.GetSize())
        if size == self._size:
            return False
        self._size, before = size, self.view
        self.plotter.clear()
        font_size = max(9, round(FONT_SIZE * min(size[0] / SIZE[0], size[1] / SIZE[1])))
        self.view = ExplorerView(self.plotter, self.model, font_size, self.colours)
        if before is not None:
            self.view.angle, self.view.playing = before.angle, before.playing
        self.plotter.disable_anti_aliasing()
        return True

    def _update(self, state: Any) -> None:
        """Exchange settings and numbers with the state, of which trame sends what has changed."""
        reading = self.model.read()
        state.update(self._positions())
        state.factor = in_percent(reading.localization_factor)
        state.bound = "none" if reading.bound is None else in_percent(reading.bound)
        state.levels = level_texts(reading)
        level = reading.sound_level
        state.sound = "" if level is None else f"{level:.1f} dB(A)" if math.isfinite(level) else "none"
        state.sound_level = 0 if level is None else max(0.0, level)
        state.energy = f"{reading.energy['plate']:.3g} J"
        state.shares = share_texts(reading)
        state.engine = "by modes, without time steps" if self.model.by_modes else "in time steps"
        state.status = self.model.status()
        self.view.playing = bool(state.playing)

    def _positions(self) -> dict[str, float]:
        """Return the position of every slider by its key in the state; of forces in newtons."""
        settings = self.model.settings
        positions = {"frequency": settings.frequency}
        positions |= {f"number_{index}": value for index, value in enumerate(settings.numbers)}
        amplitudes = amplitudes_as_given(self.model.scene, settings.magnitude)
        positions |= {f"magnitude_{index}": value for index, (_, value, _) in enumerate(amplitudes)}
        return positions | {f"phase_{index}": value for index, value in enumerate(settings.phase)}

    def _build(self) -> None:
        from trame.ui.vuetify3 import VAppLayout
        from trame.widgets import client, html, vtk

        state, actuators = self.server.state, self.model.scene.actuators
        state.trame__title, state.picture, state.choice, state.playing = TITLE, 0, "", True
        # Texts of the user are in the state, so that nothing in them is read as part of the page.
        state.title = self.model.scene.title or TITLE
        state.names = [f"{number}  {actuator.name}" for number, actuator in enumerate(actuators, start=1)]
        self._update(state)
        quality = {"interactive_ratio": 1, "still_ratio": 1}
        quality |= {"interactive_quality": JPEG_QUALITY, "still_quality": JPEG_QUALITY}
        with VAppLayout(self.server), html.Div(style="display: flex; height: 100vh; overflow: hidden"):
            with html.Div(style="flex: 1 1 0; min-width: 0; height: 100%", id="stage"):
                self._remote = vtk.VtkRemoteView(self.plotter.render_window, **quality)
            with html.Div(style="flex: 0 0 390px; overflow-y: auto; padding: 14px 22px; font-size: 15px"):
                html.Div(NUMBERS)
                self._add_controls()
            client.ClientStateChange(value="picture", change=(self._take, "[picture]"))

    def _add_controls(self) -> None:
        from trame.widgets import html, vuetify3

        model, ranges, actuators = self.model, self.model.ranges, self.model.scene.actuators
        largest = amplitudes_as_given(model.scene, [ranges.magnitude] * len(actuators))
        with html.Div(style="display: grid; grid-template-columns: 1fr 1fr 1fr; gap: 6px; margin-bottom: 8px"):
            style = {"size": "small", "style": "text-transform: none; letter-spacing: 0"}
            for choice, label in model.choices.items():
                colour, click = (f"choice === '{choice}' ? 'primary' : undefined",), (self._choose, f"['{choice}']")
                vuetify3.VBtn(label, id=f"choose-{choice}", color=colour, click=click, **style)
            vuetify3.VBtn("{{ playing ? 'pause' : 'play' }}", id="pause", click="playing = !playing", **style)
        with html.Div(style=BESIDE):
            _add_slider("frequency [Hz]", "frequency", ranges.frequency, model.set_frequency)
            for index, (key, ends) in enumerate(ranges.numbers.items()):
                _add_slider(model.number_label(key), f"number_{index}", ends, partial(model.set_number, key))
        for index, (_, end, unit) in enumerate(largest):
            html.Div(f"{{{{ names[{index}] }}}}", style="font-weight: 600; margin-top: 8px; overflow-wrap: anywhere")
            sliders = (
                ("magnitude", f"{AMPLITUDES.get(unit, 'w')} [{unit}]", end),
                ("phase", "φ [rad]", 2 * math.pi),
            )
            with html.Div(style=BESIDE):
                for key, label, end in sliders:
                    _add_slider(label, f"{key}_{index}", (0.0, end), partial(self._set_actuator, index, key))

    def _set_actuator(self, index: int, key: str, value: float) -> None:
        self.server.state.choice = ""
        unit = self.model.scene.actuators[index].amplitude_area if key == "magnitude" else 1.0
        self.model.set_actuator(index, **{key: value / unit})

    def _choose(self, choice: str) -> None:
        if choice in self.model.choices:
            self.server.state.choice = choice
            self.model.choose(choice, ITERATION_SECONDS)

    def _take(self, picture: int) -> None:
        if isinstance(picture, int):
            self._taken = max(self._taken, min(picture, self._sent))
        self._answered.set()


def _add_slider(label: str, key: str, ends: tuple[float, float], on_change: Callable[[float], object]) -> None:
    """Add a slider of the state's ``key``, with its label and value above; it takes numbers only, within its ends."""
    from trame.widgets import html, vuetify3

    def take(value: object) -> None:
        if is_number(value):
            on_change(min(max(float(value), ends[0]), ends[1]))

    with html.Div(id=f"slide-{key}"):
        with html.Div(style="display: flex; justify-content: space-between; margin-top: 2px"):
            html.Span(label)
            html.Span(f"{{{{ Number({key}).toPrecision(4) }}}}", id=f"value-{key}")
        look = {"hide_details": True, "density": "compact", "color": "primary", "raw_attrs": [f'aria-label="{label}"']}
        change = (take, "[$event]")
        vuetify3.VSlider(v_model=(key,), min=ends[0], max=ends[1], step=0, update_modelValue=change, **look)


def is_no_connection_error(record: logging.LogRecord) -> bool:
    """Filter out log records of disconnected browsers and of too many connections."""
    error = record.exc_info[1] if record.exc_info else sys.exc_info()[1]
    too_many = isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE)
    return not (isinstance(error, ConnectionError) or too_many)
