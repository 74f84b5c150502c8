"""``warp-plate render RESULT``: pictures, movies and pages of a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warp_plate.cli import motion_options, options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.model import Result

# As in viz.render, which is imported later.
PLOTS = (".svg", ".pdf")
ENDINGS = (".png", *PLOTS, ".gif", ".mp4", ".html")
# Size [bytes] from which a GIF is remarked on: many mail servers and web pages take no more.
LARGE_GIF = 10_000_000


def render(
    result: options.ResultFile,
    /,
    *,
    out: Annotated[list[Path] | None, Parameter(negative="")] = None,
    figures: Literal["paper"] | None = None,
    playback: motion_options.PlaybackOptions = motion_options.DEFAULT_PLAYBACK,
    colours: options.ColourChoice = options.DEFAULT_COLOURS,
    shown: motion_options.FrameOptions = motion_options.DEFAULT_FRAMES,
    plan: options.Flag = False,
    time: float | None = None,
    width: Annotated[int, Parameter(validator=Number(gte=120, lte=4000))] = 560,
    json: options.Json = False,
) -> None:
    """Draw pictures, movies and pages of a result; needs no display.

    A result holds few displacements, so its scene is run again under its drives to make the frames. For a file written
    by focus, the plate is shown around the moment of the focus at its first point, with methods as cases.

    Parameters
    ----------
    out
        File to write; repeat the option for more: .png (a picture), .gif, .mp4 (movies), .html (a page that plays and
        turns the plates, offline), .svg, .pdf (seen from above). Default: RESULT.png in this folder.
    figures
        paper: figures 2 and 3 of the source paper, as RESULT-figure-2.png (the recorded times) and
        RESULT-figure-3.png, .svg and .pdf (the search).
    plan
        Draw the .png seen from above as well.
    time
        Time of a picture in seconds (default: when the quantity in colour is largest).
    width
        Width of one plate's picture in pixels.
    """
    given = out or ([] if figures else [Path(f"{result.stem}.png")])
    targets = [output.output_file(path, ".png", ENDINGS) for path in given]
    playback.check()
    from warp_plate.analysis.motion import frame_at
    from warp_plate.result.hdf5 import describe_file
    from warp_plate.result.model import load_result
    from warp_plate.viz.availability import DrawingUnavailable
    from warp_plate.viz.pictures import PictureStyle, largest_frame
    from warp_plate.viz.render import draw_motions

    files: list[Path] = []
    try:
        if describe_file(result) == "a focus" and figures is None:
            _check_drawable(targets, plan)
            scene, motions = motion_options.select_focus_motions(result, shown, playback)
        else:
            loaded = load_result(result)
            scene = loaded.scene
            if figures == "paper":
                files += _paper_figures(loaded, result)
            if targets:
                _check_drawable(targets, plan)
                around = frames_around(loaded, time, shown)
                motions = motion_options.select_motions(loaded, result, around, playback, json)
        if targets:
            frame = largest_frame(motions, playback.field) if time is None else frame_at(motions[0], time)
            rate = playback.frame_rate(motions)
            style = PictureStyle(playback.field, width, playback.heights, colours.chosen())
            for target in targets:
                with output.progress_bar(f"drawing {target.name}", shown=not json) as show:
                    draw_motions(scene, motions, target, style, frame, rate, plan, show)
                files.append(target)
    except DrawingUnavailable as problem:
        raise SceneError(str(problem)) from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"; wrote only {', '.join(map(str, files))}" if files else "") from None
    for file in files:
        size = file.stat().st_size
        if file.suffix.lower() == ".gif" and size > LARGE_GIF:
            output.log(f"{file} has {size / 1e6:.0f} MB: fewer --frames, a smaller --width or an .mp4 are smaller")
    output.report(json, lambda: {"result": result}, lambda _: None, (files, None))


def _check_drawable(targets: list[Path], plan: bool) -> None:
    """Check that the libraries for all files are there, before anything is simulated."""
    from warp_plate.viz.render import missing_library

    for target in targets:
        if (problem := missing_library(target, plan)) is not None:
            raise SceneError(problem)


def frames_around(
    result: Result, time: float | None, shown: motion_options.FrameOptions
) -> motion_options.FrameOptions:
    """Return the options with the period around a time that is given without ``--start`` and ``--end``."""
    if time is None or shown.start is not None or shown.end is not None:
        return shown
    from warp_plate.analysis.motion import period_around

    start, end = period_around(result, time)
    return replace(shown, start=start, end=end)


def _paper_figures(result: Result, name: Path) -> list[Path]:
    """Draw figures 2 and 3 of the source paper."""
    from warp_plate.result.atomic_io import atomic_paths
    from warp_plate.viz.availability import missing_plots, missing_renderer
    from warp_plate.viz.figures import draw_history, draw_surfaces

    if not result.history or not result.times.size:
        raise SceneError(f"--figures paper: {name} holds no search; make it with localize")
    if (problem := missing_plots() or missing_renderer()) is not None:
        raise SceneError(problem)
    drawn = [Path(f"{name.stem}-figure-2.png"), *(Path(f"{name.stem}-figure-3{form}") for form in (".png", *PLOTS))]
    with atomic_paths(*drawn) as (surfaces, *histories):
        draw_surfaces(result, surfaces)
        for path in histories:
            draw_history(result, path, loss=True)
    return drawn
