"""``warp-plate render RESULT``: pictures, movies and pages of a result."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.moving import Choice, Field, check_looks, chosen_motions, playing_rate
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.model import Result
    from warp_plate.result.motion import Motion
    from warp_plate.viz.pictures import PictureStyle

PLOTS, MOVIES = (".svg", ".pdf"), (".gif", ".mp4")
ENDINGS = (".png", *PLOTS, *MOVIES, ".html")
WIDTHS = (120, 4000)


def render(
    result: Path,
    /,
    *,
    out: Annotated[list[Path] | None, cyclopts.Parameter(negative="")] = None,
    figures: Literal["paper"] | None = None,
    field: Field = "displacement",
    case: Annotated[list[str] | None, cyclopts.Parameter(negative="")] = None,
    modes: int = 0,
    plan: Annotated[bool, cyclopts.Parameter(negative="")] = False,
    time: float | None = None,
    start: float | None = None,
    end: float | None = None,
    frames: int | None = None,
    rate: float | None = None,
    width: int = 560,
    heights: float | None = None,
    device: str = "auto",
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Draw pictures, movies and pages of a result; needs no display.

    A result keeps few displacements, so its scene is run once more under its drives for the frames.

    Parameters
    ----------
    result
        An .h5 file that localize or simulate wrote.
    out
        File to write; give it again for more: .png (a picture), .gif, .mp4 (movies), .html (a page that plays and
        turns the plates, offline), .svg, .pdf (seen from above). RESULT.png in this folder when left out.
    figures
        paper: figures 2 and 3 of the source paper, as RESULT-figure-2.png (the recorded times) and
        RESULT-figure-3.png, .svg and .pdf (the search).
    field
        In colour: displacement, velocity, energy (kinetic energy density), rms-velocity or phase; heights are
        displacements always.
    case
        equal, single, best, drive or another of the result's; give it again for more. All, side by side, when left out.
    modes
        Draw the first so many natural shapes instead, 6 at most.
    plan
        Draw the .png seen from above as well.
    time
        Of a picture, in seconds; the moment when what is in colour is largest, when left out.
    start
        Of the frames, in seconds; when both this and --end are left out, the last period of the drive, or of a drive
        that does not repeat the first burst, else the scene's window.
    end
        Of the frames, in seconds; the end of the run when only --start is there.
    frames
        How many; 60 a period, or as many as there are steps, and 600 at most, when left out.
    rate
        Frames a second in movies and pages; 30, or what plays a period in 1.4 s, when left out.
    width
        Of one plate's picture, in pixels.
    heights
        How many times displacements are exaggerated.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    json
        Print one JSON object instead of lines.
    """
    targets = _targets(out, result, figures)
    if not WIDTHS[0] <= width <= WIDTHS[1]:
        raise SceneError(f"--width {width}: must be from {WIDTHS[0]} to {WIDTHS[1]} pixels")
    check_looks(rate, heights)
    from warp_plate.result import load_result
    from warp_plate.viz.availability import DrawingUnavailable
    from warp_plate.viz.pictures import PictureStyle

    loaded = load_result(result)
    files: list[Path] = []
    try:
        if figures == "paper":
            files += _paper_figures(loaded, result)
        if targets:
            _refuse_undrawable(targets, plan)
            start, end = _around(loaded, time, start, end)
            choice = Choice(case or [], modes, start, end, frames, device)
            motions = chosen_motions(loaded, result, choice, field, json)
            shown = _frame(motions, time, field)
            style = PictureStyle(field, width, heights)
            for target in targets:
                _draw(loaded, motions, target, style, shown, plan, playing_rate(rate, motions), json)
                files.append(target)
    except DrawingUnavailable as problem:
        raise SceneError(str(problem)) from None
    except KeyboardInterrupt:
        if not files:
            raise
        print(f"warp-plate: interrupted; wrote only {', '.join(map(str, files))}", file=sys.stderr)
        sys.exit(130)
    if json:
        output.print_json({"result": str(result), "files": [str(file) for file in files]})
        return
    for file in files:
        print(f"wrote {file}")


def _targets(out: list[Path] | None, result: Path, figures: str | None) -> list[Path]:
    targets = out or ([] if figures else [Path(f"{result.stem}.png")])
    for target in targets:
        if target.suffix.lower() not in ENDINGS:
            raise SceneError(f"--out {target}: must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
        output.refuse_place(target)
    return targets


def _refuse_undrawable(targets: list[Path], plan: bool) -> None:
    """Say what is missing before anything is simulated.

    Raises:
        SceneError: a library that one of the files needs.
    """
    from warp_plate.viz.availability import missing_meshes, missing_plots, missing_renderer
    from warp_plate.viz.pictures import missing_movies

    needed: list[Callable[[], str | None]] = []
    for target in targets:
        ending = target.suffix.lower()
        if ending in PLOTS or (ending == ".png" and plan):
            needed.append(missing_plots)
        elif ending == ".html":
            needed.append(missing_meshes)
        else:
            needed += [missing_renderer, missing_movies] if ending == ".mp4" else [missing_renderer]
    for lacking in needed:
        if (problem := lacking()) is not None:
            raise SceneError(problem)


def _around(
    result: Result, time: float | None, start: float | None, end: float | None
) -> tuple[float | None, float | None]:
    """The span of the frames: a moment that is named must be in it, and colours hold for a period around it."""
    if time is None or start is not None or end is not None:
        return start, end
    last = result.scene.window.end
    if not 0 <= time <= last:
        raise SceneError(f"--time {time:g}: must be from 0 to {last:g} s")
    lowest = min(result.case_scene(case).drive.frequency for case in result.cases.values())
    period = min(1 / lowest, last)
    first = min(time, last - period)
    return first, first + period


def _frame(motions: list[Motion], time: float | None, field: Field) -> int:
    """The frame of pictures."""
    from warp_plate.viz.pictures import largest_frame

    if time is None:
        return largest_frame(motions, field)
    first, last = motions[0].span
    if not first <= time <= last * (1 + 1e-9):
        raise SceneError(f"--time {time:g}: must lie between --start and --end, {first:g} and {last:g} s")
    return int(abs(motions[0].times - time).argmin())


def _draw(
    result: Result,
    motions: list[Motion],
    target: Path,
    style: PictureStyle,
    shown: int,
    plan: bool,
    rate: float,
    quiet: bool,
) -> None:
    from warp_plate.result.atomic_io import atomic_paths
    from warp_plate.viz.page import write_page
    from warp_plate.viz.pictures import draw_gif, draw_mp4, draw_picture
    from warp_plate.viz.plots.plan import draw_plan

    ending = target.suffix.lower()
    with (
        atomic_paths(target) as (path,),
        output.progress_bar(f"drawing {target.name}", shown=not quiet) as show,
    ):

        def told(done: int, total: int) -> None:
            show(done, total, "")

        if ending in PLOTS or (plan and ending == ".png"):
            draw_plan(result.scene, motions, path, style.quantity, shown)
        elif ending == ".png":
            draw_picture(result.scene, motions, path, style, shown)
        elif ending == ".html":
            write_page(result.scene, motions, path, style.quantity, rate, style.heights)
        elif ending == ".gif":
            draw_gif(result.scene, motions, path, style, rate, told)
        else:
            draw_mp4(result.scene, motions, path, style, rate, told)


def _paper_figures(result: Result, name: Path) -> list[Path]:
    """Figures 2 and 3.

    Raises:
        SceneError: the result is no search's or keeps no displacement, or a library is missing.
    """
    from warp_plate.result.atomic_io import atomic_paths
    from warp_plate.viz.availability import missing_plots, missing_renderer
    from warp_plate.viz.figures import draw_history, draw_surfaces

    if not result.history or not result.times.size:
        raise SceneError(f"--figures paper: {name} holds no search; make it with localize")
    for lacking in (missing_plots, missing_renderer):
        if (problem := lacking()) is not None:
            raise SceneError(problem)
    drawn = [Path(f"{name.stem}-figure-2.png"), *(Path(f"{name.stem}-figure-3{form}") for form in (".png", *PLOTS))]
    with atomic_paths(*drawn) as (surfaces, *histories):
        draw_surfaces(result, surfaces)
        for path in histories:
            draw_history(result, path)
    return drawn
