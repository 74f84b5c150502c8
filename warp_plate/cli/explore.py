"""``warp-plate explore``: a page of sliders in the browser."""

import os
import sys
import threading
import webbrowser
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError


@Parameter(name="*")
@dataclass(frozen=True)
class PageOptions:
    """Options of the page.

    Attributes:
        web: Serve the page without opening a browser, for example on a remote machine.
        host: Address of the page; 127.0.0.1 can be reached from this machine only.
        port: Port of the page; 0 takes any free one.
    """

    web: options.Switch = False
    host: str = "127.0.0.1"
    port: Annotated[options.Integer, Parameter(validator=Number(gte=0, lte=65535))] = 8080


def explore(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneOptions = options.SceneOptions(),
    page: PageOptions = PageOptions(),
    device: options.Device = "auto",
    path: options.SteppingOrModes = "auto",
    colormap: options.Colormap = None,
) -> None:
    """Explore a scene in the browser: sliders for every actuator, frequency, damping and links (needs the extra web).

    The moving plate, its peaks in g and µm, its localization factor, the bound and the energy shares of the quadrants
    are updated at once. Buttons select the scene's drive, equal drives, the best single actuator, the best of the
    swarm (shown as it searches), the exact optimum, or a random drive. The swarm optimizes all magnitudes and phases
    for the localization factor and ignores the scene's [search]. The scene must be linear in the drives; --path auto
    uses its modes.
    """
    host, port = page.host, page.port
    if not host.strip():
        raise SceneError("--host '': must be an address of this machine, such as 127.0.0.1, or 0.0.0.0 for all")
    loaded, scene = changes.load(scene)
    from warp_plate.explore.live_model import LiveModel
    from warp_plate.resolve import resolve
    from warp_plate.viz.availability import missing_renderer
    from warp_plate.viz.explorer_page import missing_page, serve_page

    colours = options.ColourChoice(colormap).chosen()

    if (problem := missing_page() or missing_renderer()) is not None:
        raise SceneError(problem)

    def on_ready(address: str) -> None:
        print(f"open {address} in a browser; Ctrl-C ends it", flush=True)
        if not page.web and has_desktop():
            # In a thread, as some browsers return only when they are closed.
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    with output.scene_errors(scene):
        chosen = resolve(loaded, device, purpose="survey", path=path).scene
        with output.progress_bar("simulating the unit responses", shown=True) as show:
            note = "{:.2g} node-steps".format
            model = LiveModel(chosen, device, path, lambda done, total: show(done, total, note(done)))
    try:
        serve_page(model, host, port, on_ready, colours)
    except OSError as error:
        raise SceneError(f"--host {host} --port {port}: cannot be listened on: {error.strerror or error}") from None
    finally:
        model.close()
    print("ended", file=sys.stderr)


def has_desktop() -> bool:
    """Return whether a browser would open a window rather than take over this terminal."""
    return not sys.platform.startswith("linux") or bool({"DISPLAY", "WAYLAND_DISPLAY", "BROWSER"} & os.environ.keys())
