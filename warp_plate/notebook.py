"""Pictures of results, and scenes, results and moving plates in IPython and Jupyter notebooks.

``import warp_plate`` in a running notebook (or ``%load_ext warp_plate``) shows every :class:`Scene` and :class:`Result`
as text with a picture, and :func:`view` plays a result:

    >>> from warp_plate import load_result, view
    >>> view(load_result("paper-localize.h5"))

The player holds its whole page, so it needs neither a server nor a network, and also works in a saved notebook.
"""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, tostring

if TYPE_CHECKING:
    from warp_plate.result.focus import FocusResult
    from warp_plate.result.frequency_response import FrequencyResponse
    from warp_plate.result.model import Result
    from warp_plate.result.sound import Sound
    from warp_plate.result.specified import SpecifiedDrive
    from warp_plate.result.sweep import Sweep
    from warp_plate.scene.model import Scene


def register(shell: Any) -> None:
    """Register the HTML formatters of scenes and results with an IPython shell."""
    formatter = shell.display_formatter.formatters["text/html"]
    formatter.for_type_by_name("warp_plate.scene.model", "Scene", scene_html)
    formatter.for_type_by_name("warp_plate.result.model", "Result", result_html)


def scene_html(scene: Scene) -> str:
    """Return the scene as TOML, and a picture of its layout."""
    from warp_plate.viz.availability import missing_plots
    from warp_plate.viz.plots.plan import draw_layout

    return _card(scene.title or "Scene", scene.to_toml(), partial(draw_layout, scene), missing_plots())


def result_html(result: Result) -> str:
    """Return localization factors, motion, drive and cost as the commands print them, and a picture of the plate."""
    from warp_plate.cli import output, tables
    from warp_plate.viz.annotations import case_label, in_percent, ordered_cases
    from warp_plate.viz.availability import missing_plots, missing_renderer
    from warp_plate.viz.pictures import draw_history, draw_surfaces

    scene, cases, main = result.scene, ordered_cases(result), result.main_case
    text = io.StringIO()
    # Kernels set FORCE_COLOR, whose escape sequences HTML shows as letters.
    console = output.console(file=text, width=160, force_jupyter=False, force_terminal=False)
    if result.interrupted:
        console.print("Interrupted by Ctrl-C: the best so far is shown.")
    factors = [(case_label(name, scene), in_percent(case.localization_factor)) for name, case in cases.items()]
    if result.bound is not None:
        factors.append((result.bound_description, in_percent(result.bound)))
    output.print_rows(console, ("drive", "localization factor"), factors, "")
    tables.print_motion(cases, scene, console)
    if result.command == "localize":
        tables.print_drive(main, scene, console)
    tables.print_cost(result, console)
    single = replace(result, cases={result.main_name: main})
    draw, problem = draw_surfaces, missing_renderer() if result.times.size else "The result holds nothing to draw."
    if problem is not None and result.history:
        draw, problem = draw_history, missing_plots()
    return _card(scene.title or result.source or "Result", text.getvalue(), partial(draw, single), problem)


def _card(title: str, text: str, draw: Callable[[Path], object], problem: str | None) -> str:
    """Return a title, a text with its line breaks, and a picture, or the problem that prevents it."""
    card = Element("div")
    SubElement(card, "strong").text = title
    SubElement(card, "pre").text = text
    if problem is not None:
        SubElement(card, "p").text = problem
        return tostring(card, encoding="unicode")
    with tempfile.TemporaryDirectory() as folder:
        draw(path := Path(folder, "picture.png"))
        source = f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
    SubElement(card, "img", {"src": source, "alt": f"Picture of {title}", "style": "max-width: 100%"})
    return tostring(card, encoding="unicode")


@dataclass(frozen=True)
class NotebookPlayer:
    """A page shown in a frame of a notebook.

    Attributes:
        html: the complete page.
        height: height of the frame [pixels].
    """

    html: str
    height: int

    def _repr_html_(self) -> str:
        # The sandbox keeps the scripts of the page away from the notebook.
        style = {"sandbox": "allow-scripts", "width": "100%", "height": str(self.height), "style": "border: none"}
        frame = Element("iframe", {"srcdoc": self.html, **style})
        return tostring(frame, encoding="unicode", short_empty_elements=False)


def plot(
    shown: Result | Sweep | FrequencyResponse | Sound | FocusResult | SpecifiedDrive,
    stem: str | Path,
    *,
    colormap: str | None = None,
    limits: str | float | None = None,
) -> list[Path]:
    """Draw a result as its command does, and return the files.

    Args:
        shown: result of ``localize`` or ``simulate``, of ``sweep``, of ``frf``, ``sound``, ``focus`` or ``specify``.
        stem: path of the pictures without an ending: a result makes STEM-history.png, STEM-surfaces.png and so on, all
            others STEM.png.
        colormap: colour map of Matplotlib for fields over the plate and maps (default: depends on the field).
        limits: ends of their colours: "common" for all plates, "each" for separate ones, or the largest value shown in
            the field's SI unit (default: "each").

    Raises:
        SceneError, DrawingUnavailable, TypeError: no such colour map or limits, a library is not installed, or there
            are no pictures of such an object.
    """
    from warp_plate.result.focus import FocusResult
    from warp_plate.result.frequency_response import FrequencyResponse
    from warp_plate.result.model import Result
    from warp_plate.result.sound import Sound
    from warp_plate.result.specified import SpecifiedDrive
    from warp_plate.result.sweep import Sweep
    from warp_plate.scene.errors import check_type
    from warp_plate.viz.availability import DrawingUnavailable, missing_plots
    from warp_plate.viz.fields import colour_options
    from warp_plate.viz.pictures import draw_all
    from warp_plate.viz.plots.responses import draw_focus, draw_frequency_response
    from warp_plate.viz.plots.sound import draw_sound
    from warp_plate.viz.plots.specified import draw_specified
    from warp_plate.viz.plots.sweep import draw_sweep

    check_type("stem", stem, str, Path)
    colours = colour_options(colormap, limits)
    if isinstance(shown, Result):
        files, problem = draw_all(shown, stem, colours)
        if problem is not None:
            raise DrawingUnavailable(problem)
        return files
    drawings: dict[type, Callable[[Any, Path], None]] = {
        Sweep: partial(draw_sweep, colormap=colormap),
        FrequencyResponse: draw_frequency_response,
        Sound: draw_sound,
        FocusResult: partial(draw_focus, colours=colours),
        SpecifiedDrive: draw_specified,
    }
    if type(shown) not in drawings:
        names = ", ".join(kind.__name__ for kind in (Result, *drawings))
        raise TypeError(f"{type(shown).__name__}: there are pictures of {names}")
    if (problem := missing_plots()) is not None:
        raise DrawingUnavailable(problem)
    file = Path(f"{stem}.png")
    drawings[type(shown)](shown, file)
    return [file]


def view(result: Result, *cases: str, height: int = 680, **options: Any) -> NotebookPlayer:
    """Run cases of a result again and return a player of their plates, side by side.

    Args:
        cases: names of cases of the result (default: the best drive, or the only case).
        height: height of the frame in the notebook [pixels].
        options: ``quantity``, ``span``, ``frames``, ``rate``, ``heights``, ``device``, ``colormap`` and ``limits`` of
            :func:`render`.

    Raises:
        SceneError, DrawingUnavailable: see :func:`render`.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = render(result, Path(folder, "page.html"), *cases, **options)
        return NotebookPlayer(path.read_text(encoding="utf-8"), height)


def render(
    result: Result,
    path: str | Path,
    *cases: str,
    quantity: str = "displacement",
    span: tuple[float, float] | None = None,
    frames: int | None = None,
    time: float | None = None,
    rate: float = 30.0,
    width: int = 560,
    heights: float | None = None,
    plan: bool = False,
    device: str = "auto",
    colormap: str | None = None,
    limits: str | float | None = None,
) -> Path:
    """Run cases of a result again, draw their plates side by side, and return the path.

    Args:
        path: file to write: .png (a picture), .gif, .mp4 (movies), .html (a page that plays and turns the plates), .svg
            or .pdf (seen from above).
        cases: names of cases of the result (default: the best drive, or the only case).
        quantity: field shown in colour: displacement, velocity, energy, rms-velocity, level or phase.
        span: beginning and end of the frames [s] (default: the last period of the drive, or the first burst or the
            window if the drive does not repeat).
        frames: number of frames (default: 60 a period).
        time: time of a picture [s] (default: when the quantity in colour is largest).
        rate: frames per second of a movie or page.
        width: width of one plate's picture [pixels].
        heights: factor by which displacements are exaggerated (default: one that suits the picture).
        plan: draw a .png seen from above too.
        device: cpu, cuda, cuda:1, …; auto takes a CUDA device if there is one.
        colormap: colour map of Matplotlib (default: depends on the field).
        limits: ends of the colours, see :func:`plot` (default: "common").

    Raises:
        SceneError: an unknown case, quantity, colour map, limits or ending, or a span or time outside the run.
        DrawingUnavailable: a library that the file needs is not installed.
    """
    from warp_plate.analysis.motion import frame_at, motions, period_around
    from warp_plate.result.model import Result
    from warp_plate.scene.errors import SceneError, check_type
    from warp_plate.viz.availability import DrawingUnavailable
    from warp_plate.viz.fields import FIELDS, PictureStyle, colour_options
    from warp_plate.viz.pictures import ENDINGS, draw_motions, largest_frame, missing_library

    check_type("result", result, Result)
    check_type("path", path, str, Path)
    path, colours = Path(path), colour_options(colormap, limits)
    style = PictureStyle(quantity, width, heights, colours, plan, rate)
    if path.suffix.lower() not in ENDINGS:
        raise SceneError(f"path = {str(path)!r}: must end in {', '.join(ENDINGS)}")
    if quantity not in FIELDS:
        raise SceneError(f"quantity = {quantity!r}: must be one of {', '.join(FIELDS)}")
    if (problem := missing_library(path, plan)) is not None:
        raise DrawingUnavailable(problem)
    if time is not None and span is None:
        span = period_around(result, time)
    moving = motions(result.scene, result.select_cases(cases or (result.main_name,)), span, frames, device)
    frame = largest_frame(moving, quantity) if time is None else frame_at(moving[0], time)
    draw_motions(result.scene, moving, path, style, frame)
    return path
