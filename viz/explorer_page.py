"""The explorer as a page for a browser: pictures of the stage drawn here and sent, sliders and buttons there.

Everything that the page loads comes from this server. It listens on one address of this machine and asks for no
password, so leave it at 127.0.0.1 unless all who can reach another address may play. A page of another site that is
open in the same browser cannot: it is not told the secret of this run.
"""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import math
import os
import secrets
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from warp_plate.viz.explorer import CHOICES, ROWS, SEARCH_SECONDS, Live, Stage, share_texts

if TYPE_CHECKING:
    import pyvista

EXTRA = "pip install 'warp-plate[web]'"
TITLE = "warp-plate explore"
# Of the stage before a browser has told its own, in pixels, and the text on it.
SIZE, FONT_SIZE = (900, 800), 16
# A picture is drawn at most so often, and only when the browser has taken the last but one. One that is as before is
# sent every second only, for a browser that has come meanwhile.
FRAMES_A_SECOND = 30.0
AHEAD, AGAIN = 2, 1.0
# Without an answer for so long, nobody is looking, or a message was lost.
PATIENCE = 1.0
# Where the libraries write of a browser that went away while a picture was on its way to it.
LOGGERS = ("asyncio", "aiohttp.server", "wslink.protocol")
LOCAL = ("127.0.0.1", "localhost", "[::1]", "::1")
# Of the pictures, as JPEG.
QUALITY = 85


def missing_page() -> str | None:
    """None where the page can be served; otherwise one sentence that says what to install."""
    for module in ("trame", "trame_vtk", "trame_vuetify"):
        if importlib.util.find_spec(module) is None:
            return f"the page needs trame: {EXTRA}"
    return None


class ExplorerPage:
    """A live model on a trame server; ``serve`` runs it until it is cancelled."""

    def __init__(self, model: Live, name: str = TITLE) -> None:
        from trame.app import get_server

        self.model = model
        self.server = get_server(name, client_type="vue3")
        self.plotter = _make_plotter()
        self._size: tuple[int, ...] = ()
        self._fit()
        self._sent = self._taken = 0
        self._answered = asyncio.Event()
        self._view: Any = None
        self._build()

    async def serve(self, host: str, port: int, ready: Callable[[str], object]) -> None:
        """Answer browsers; port 0 takes any free one; ``ready`` is called with the page's address."""
        secret = secrets.token_urlsafe()
        self.server.controller.on_server_bind.add(lambda server: _answer_where(server, host, secret))
        with _arguments(f"--authKey={secret}", "--nosignalhandlers"):  # it may begin with a hyphen
            task = self.server.start(
                port=port,
                host=host,
                exec_mode="task",
                timeout=0,
                open_browser=False,
                show_connection_info=False,
                disable_logging=True,
            )
        while not self.server.running:
            if task.done():
                task.result()
            await asyncio.sleep(0.01)
        ready(f"http://{f'[{host}]' if ':' in host else host}:{self.server.port}/")
        try:
            await self._show()
        finally:
            # A browser that is still connected would be waited for.
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self.server.stop(), PATIENCE)

    async def _show(self) -> None:
        """Picture after picture, as fast as the browser takes them."""
        last, drawn = time.perf_counter(), -math.inf
        while True:
            started = time.perf_counter()
            fitted = self._fit()
            changed = self.stage.advance(started - last) or fitted
            last = started
            with self.server.state as state:
                self._tell(state)
                if changed or started - drawn > AGAIN:
                    drawn = started
                    self._view.update()
                    self._sent += 1
                    state.picture = self._sent
            await asyncio.sleep(max(0.001, 1 / FRAMES_A_SECOND - (time.perf_counter() - started)))
            while self._sent - self._taken >= AHEAD:
                self._answered.clear()
                try:
                    await asyncio.wait_for(self._answered.wait(), PATIENCE)
                except asyncio.TimeoutError:
                    self._taken = self._sent

    def _fit(self) -> bool:
        """Lay the stage out for the size that the browser has given it; whether that is another one."""
        size = tuple(self.plotter.render_window.GetSize())
        if size == self._size:
            return False
        self._size = size
        turn, playing = (self.stage.turn, self.stage.playing) if hasattr(self, "stage") else (0.0, True)
        self.plotter.clear()
        font_size = max(9, round(FONT_SIZE * min(size[0] / SIZE[0], size[1] / SIZE[1])))
        self.stage = Stage(self.plotter, self.model, font_size)
        self.stage.turn, self.stage.playing = turn, playing
        self.plotter.disable_anti_aliasing()
        return True

    def _tell(self, state: Any) -> None:
        """Sliders and numbers follow the model; what is as the browser has it already is not sent."""
        wanted, reading = self.model.settings, self.model.read()
        state.frequency, state.damping = wanted.frequency, wanted.damping
        for index, (magnitude, phase) in enumerate(zip(wanted.magnitude, wanted.phase, strict=True)):
            state[f"magnitude_{index}"], state[f"phase_{index}"] = magnitude, phase
        state.factor = _percent(reading.localization_factor)
        state.bound = "none claimed" if reading.bound is None else _percent(reading.bound)
        state.energy = f"{reading.energy['plate']:.3g} J"
        state.shares = {name.replace(" ", "_"): text for name, text in share_texts(reading).items()}
        state.status = self.model.status()
        state.playing = self.stage.playing

    def _build(self) -> None:
        from trame.ui.vuetify3 import VAppLayout
        from trame.widgets import client, html, vtk
        from trame.widgets import vuetify3 as vuetify

        state = self.server.state
        state.trame__title = TITLE
        state.picture = 0
        state.choice = ""
        self._tell(state)
        with VAppLayout(self.server), html.Div(style="display: flex; height: 100vh; overflow: hidden"):
            with html.Div(style="flex: 1 1 0; min-width: 0; height: 100%", id="stage"):
                self._view = vtk.VtkRemoteView(
                    self.plotter.render_window,
                    interactive_ratio=1,
                    still_ratio=1,
                    interactive_quality=QUALITY,
                    still_quality=QUALITY,
                )
            with html.Div(style="flex: 0 0 390px; overflow-y: auto; padding: 14px 22px; font-size: 15px"):
                self._add_numbers(html)
                self._add_buttons(html, vuetify)
                self._add_sliders(html, vuetify)
            client.ClientStateChange(value="picture", change=(self._take, "[picture]"))

    def _add_numbers(self, html: Any) -> None:
        scene = self.model.scene
        self.server.state.title = scene.title or TITLE
        html.Div("{{ title }}", style="font-weight: 600; margin-bottom: 6px")
        with html.Div(style="font-size: 17px"):
            html.Div("Localization factor <b id='factor'>{{ factor }}</b>")
            html.Div("Bound <b id='bound'>{{ bound }}</b>")
        html.Div("Kinetic energy {{ energy }}; by quadrant, as they lie:", id="energy", style="margin-top: 4px")
        with html.Div(style="display: grid; grid-template-columns: 90px 90px; gap: 3px; margin: 4px 0"):
            for name in ("upper left", "upper right", "lower left", "lower right"):
                key = name.replace(" ", "_")
                html.Div(
                    f"{{{{ shares.{key} }}}}",
                    id=key,
                    title=name,
                    style="border: 1px solid #999; padding: 2px 8px; text-align: right",
                )
        html.Div("{{ status }}", id="status", style="min-height: 3em; color: #b2182b; font-size: 13px")

    def _add_buttons(self, html: Any, vuetify: Any) -> None:
        with html.Div(style="display: grid; grid-template-columns: 1fr 1fr 1fr; gap: 6px; margin-bottom: 8px"):
            looks = {"size": "small", "style": "text-transform: none; letter-spacing: 0"}
            for choice, word in CHOICES.items():
                vuetify.VBtn(
                    word,
                    id=f"choose-{choice}",
                    color=(f"choice === '{choice}' ? 'primary' : undefined",),
                    click=(self._choose, f"['{choice}']"),
                    **looks,
                )
            vuetify.VBtn("{{ playing ? 'pause' : 'play' }}", id="pause", click=self._pause, **looks)

    def _add_sliders(self, html: Any, vuetify: Any) -> None:
        ranges = self.model.ranges

        def add(name: str, key: str, ends: tuple[float, float], moved: Callable[[float], object]) -> None:
            with html.Div(id=f"slide-{key}"):
                with html.Div(style="display: flex; justify-content: space-between; margin-top: 2px"):
                    html.Span(name)
                    html.Span(f"{{{{ Number({key}).toPrecision(4) }}}}", id=f"value-{key}")
                vuetify.VSlider(
                    v_model=(key,),
                    min=ends[0],
                    max=ends[1],
                    step=0,
                    hide_details=True,
                    density="compact",
                    color="primary",
                    update_modelValue=(moved, "[$event]"),
                    raw_attrs=[f'aria-label="{name}"'],
                )

        pair = "display: grid; grid-template-columns: 1fr 1fr; column-gap: 18px"
        with html.Div(style=pair):
            add("frequency [Hz]", "frequency", ranges.frequency, self.model.set_frequency)
            add("damping [N·s/m³]", "damping", (0.0, ranges.damping), self.model.set_damping)
        # Names are the user's own texts: from the state, so that nothing in them is read as a part of the page.
        names = [f"{number}  {one.name}" for number, one in enumerate(self.model.scene.actuators, start=1)]
        self.server.state.names = names
        for index in range(len(names)):
            html.Div(f"{{{{ names[{index}] }}}}", style="font-weight: 600; margin-top: 10px; overflow-wrap: anywhere")
            with html.Div(style=pair):
                words = f"w [{self.model.scene.drive_unit}]"
                add(words, f"magnitude_{index}", (0.0, ranges.magnitude), self._magnitude(index))
                add("φ [rad]", f"phase_{index}", (0.0, 2 * math.pi), self._phase(index))

    def _magnitude(self, index: int) -> Callable[[float], None]:
        def moved(value: float) -> None:
            self.server.state.choice = ""
            self.model.set_actuator(index, magnitude=value)

        return moved

    def _phase(self, index: int) -> Callable[[float], None]:
        def moved(value: float) -> None:
            self.server.state.choice = ""
            self.model.set_actuator(index, phase=value)

        return moved

    def _choose(self, choice: str) -> None:
        self.server.state.choice = choice
        self.model.choose(choice, SEARCH_SECONDS)

    def _pause(self) -> None:
        self.stage.playing = not self.stage.playing

    def _take(self, picture: int) -> None:
        self._taken = max(self._taken, int(picture))
        self._answered.set()


def serve_page(model: Live, host: str, port: int, ready: Callable[[str], object]) -> None:
    """Serve a live model until Ctrl-C; ``missing_page`` says whether it can be.

    Raises:
        DrawingUnavailable: VTK cannot draw here; says what to install.
        OSError: the address cannot be listened on.
    """
    from warp_plate.viz.availability import off_screen

    with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
        pass  # else trame would tell of an address in use by a page of its own
    # JPEG does not get smaller; trying takes longer than drawing. Read when the server starts.
    os.environ.setdefault("WSLINK_WS_COMPRESS", "0")
    for name in LOGGERS:
        logging.getLogger(name).addFilter(_is_news)

    async def run() -> None:
        # Not everywhere; elsewhere asyncio itself raises KeyboardInterrupt.
        with suppress(NotImplementedError):
            me = asyncio.current_task()
            asyncio.get_running_loop().add_signal_handler(signal.SIGINT, lambda: me.cancel() if me else None)
        await ExplorerPage(model).serve(host, port, ready)

    with off_screen(), suppress(asyncio.CancelledError, KeyboardInterrupt):
        asyncio.run(run())


def _make_plotter() -> pyvista.Plotter:
    import pyvista

    return pyvista.Plotter(
        off_screen=True,
        shape=(2, 1),
        row_weights=list(ROWS),
        border=False,
        window_size=list(SIZE),
        theme=pyvista.themes.DocumentTheme(),
        lighting="none",
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %" if math.isfinite(share) else "not defined"


def _answer_where(server: Any, host: str, secret: str) -> None:
    """Answer the page's first question: where its connection is, and the secret of this run."""
    from aiohttp import web

    async def answer(request: web.Request) -> web.Response:
        name = request.host.rsplit(":", 1)[0]
        if host in LOCAL and name not in LOCAL:  # another site's name that was made to lead here
            raise web.HTTPForbidden
        return web.json_response({"sessionURL": f"ws://{request.host}/ws", "secret": secret})

    server.app.router.add_post("/paraview/", answer)


def _is_news(record: logging.LogRecord) -> bool:
    """Whether a message of the server tells of more than a browser that went away."""
    told = record.exc_info[1] if record.exc_info else None
    return not isinstance(told or sys.exc_info()[1], ConnectionError)


@contextmanager
def _arguments(*arguments: str) -> Iterator[None]:
    """Trame reads the command line by itself, and would take what is meant for us."""
    before = sys.argv
    sys.argv = [before[0], *arguments]
    try:
        yield
    finally:
        sys.argv = before
