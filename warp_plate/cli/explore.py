"""``warp-plate explore SCENE``: the plate as it moves, live, in a window or in the browser."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable

    from warp_plate.explore.live_model import LiveModel
    from warp_plate.scene.model import Scene


def explore(
    scene: str,
    /,
    *,
    web: Annotated[bool, cyclopts.Parameter(negative="")] = False,
    host: str = "127.0.0.1",
    port: int = 8080,
    device: str = "auto",
    path: Literal["auto", "resident", "streaming"] = "auto",
    accuracy: str | None = None,
) -> None:
    """Play with a scene: sliders for every actuator, frequency and damping; the plate moves as it would.

    Localization factor, bound and the quadrants' shares of the energy follow at once. Buttons take the scene's own
    drive, the equal one, the best single actuator, the best that the swarm finds (watched as it searches), the exact
    best, or a random one. The swarm searches all magnitudes and phases here, for the localization factor, whatever the
    scene's [search] frees or seeks.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file.
    web
        In the browser instead of a window (needs the extra web); also the way on a machine without a display.
    host
        Address that the page is served at; only this machine reaches 127.0.0.1.
    port
        Of the page; 0 takes any free one.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch).
    accuracy
        Such as 1% or 0.01: the relative error that localization factors may have, instead of the scene's grid.
    """
    if not 0 <= port <= 65535:
        raise SceneError(f"--port {port}: must be from 1 to 65535, or 0 for any free one")
    loaded = output.load_scene(scene, accuracy)
    show = _page(host, port) if web else _window(scene)
    model = _model(loaded, device, path)
    try:
        show(model)
    finally:
        model.close()


def _model(scene: Scene, device: str, path: str) -> LiveModel:
    """The scene with a grid, its unit responses simulated."""
    from warp_plate.explore.live_model import LiveModel
    from warp_plate.studies.localize import resolve

    if scene.grid.accuracy is not None:
        scene = resolve(scene, device)[0]
    with output.progress_bar("simulating the unit responses", shown=True) as bar:
        return LiveModel(scene, device, path, lambda done, total: bar(done, total, f"{done:.2g} node-steps"))


def _window(scene: str) -> Callable[[LiveModel], None]:
    """Shows a model in a window.

    Raises:
        SceneError: no window can be opened here; says what to do instead.
    """
    from warp_plate.viz.availability import missing_window

    problem = missing_window()
    if problem is not None:
        instead = f"'warp-plate explore {scene} --web' shows the same in a browser"
        raise SceneError(f"no window can be opened: {problem}; {instead}")
    from warp_plate.viz.explorer_window import open_window

    return open_window


def _page(host: str, port: int) -> Callable[[LiveModel], None]:
    """Serves a model to browsers until Ctrl-C.

    Raises:
        SceneError: a library is missing; says what to install.
    """
    from warp_plate.viz.availability import missing
    from warp_plate.viz.explorer_page import missing_page, serve_page

    problem = missing_page() or missing()
    if problem is not None:
        raise SceneError(problem)

    def ready(address: str) -> None:
        print(f"open {address} in a browser; Ctrl-C ends it", flush=True)

    def show(model: LiveModel) -> None:
        try:
            serve_page(model, host, port, ready)
        except OSError as error:
            raise SceneError(f"--host {host} --port {port}: cannot be listened on: {error.strerror or error}") from None
        print("ended", file=sys.stderr)

    return show
