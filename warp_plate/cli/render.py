"""``warp-plate view`` and ``render``: plates in motion, in a window or in files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.model import Result
    from warp_plate.result.motion import Motion
    from warp_plate.scene.model import Scene
    from warp_plate.viz.fields import ColourOptions, PictureStyle

# As in viz.pictures, which is imported later.
ENDINGS = (".png", ".svg", ".pdf", ".gif", ".mp4", ".html")
# Limits of the frames a second, and the shortest time in which a period is played [s].
RATES, PERIOD_SECONDS = (1, 120), 1.4
# Options of the arguments that errors name.
FRAME_ARGUMENTS = {name: name for name in ("case", "start", "end", "frames", "time", "device")}


@Parameter(name="*")
@dataclass(frozen=True)
class FrameOptions:
    """Options that select cases of a result and frames.

    Attributes:
        case: A case of the result (equal, single, best, drive, ...); repeat the option for more (default: all).
        start: First time of the frames in seconds. Without --start and --end frames cover the last period of the drive;
            for a drive that does not repeat, the first burst or the scene's window.
        end: Last time of the frames in seconds (default: the end of the run).
        frames: Number of frames, 600 at most (default: 60 a period, or as many as there are time steps).
        device: Device of the run that yields the frames: cpu, cuda, cuda:1, ...; auto (the default) takes a CUDA device
            if there is one.
    """

    case: Annotated[list[str] | None, Parameter(negative="")] = None
    start: float | None = None
    end: float | None = None
    frames: Annotated[options.Integer | None, Parameter(validator=Number(gte=2))] = None
    device: str | None = None


@Parameter(name="*")
@dataclass(frozen=True)
class PlaybackOptions:
    """Options for the content and playback of moving plates.

    Attributes:
        field: Quantity shown in colour (energy: kinetic energy density; level: RMS velocity in dB relative
            to the target's). Heights always show displacements.
        modes: Show this many natural mode shapes, 6 at most, instead of the cases.
        rate: Frames a second (default: 30, or fewer so that a period takes at least 1.4 s).
        heights: Factor by which displacements are exaggerated (default: automatic).
    """

    field: Literal["displacement", "velocity", "energy", "rms-velocity", "level", "phase"] = "displacement"
    modes: Annotated[options.Integer, Parameter(validator=Number(gte=0, lte=6))] = 0
    rate: float | None = None
    heights: float | None = None

    def check(self) -> None:
        """Check ``--rate`` and ``--heights``."""
        if self.rate is not None and not RATES[0] <= self.rate <= RATES[1]:
            raise SceneError(f"--rate {self.rate:g}: must be from {RATES[0]} to {RATES[1]} frames a second")
        if self.heights is not None and not 0 < self.heights < float("inf"):
            raise SceneError(f"--heights {self.heights:g}: must be above 0")

    def style(self, motions: Sequence[Motion], colours: ColourOptions, **options: Any) -> PictureStyle:
        """Return the style of pictures of these motions; by default a period takes at least ``PERIOD_SECONDS``."""
        from warp_plate.viz.fields import PictureStyle

        first = motions[0]
        periods = (first.span[1] - first.span[0]) * first.frequency
        usual = min(30.0, max(RATES[0], len(first.times) / max(periods, 1e-9) / PERIOD_SECONDS))
        rate = usual if self.rate is None else self.rate
        return PictureStyle(self.field, heights=self.heights, colours=colours, rate=rate, **options)


@Parameter(name="*")
@dataclass(frozen=True)
class PictureOptions:
    """Options of pictures.

    Attributes:
        plan: Draw the .png seen from above as well.
        time: Time of a picture in seconds (default: when the quantity in colour is largest).
        width: Width of one plate's picture in pixels.
    """

    plan: options.Switch = False
    time: float | None = None
    width: Annotated[options.Integer, Parameter(validator=Number(gte=120, lte=4000))] = 560


def view(
    result: options.ResultFile,
    /,
    *,
    playback: PlaybackOptions = PlaybackOptions(),
    colours: options.ColourChoice = options.ColourChoice(),
    frames: FrameOptions = FrameOptions(),
) -> None:
    """Show the plates of a result in motion, in a window with a slider and keys.

    A result holds few displacements, so its scene is run again under its drives to make the frames.
    """
    playback.check()
    chosen = colours.chosen()
    from warp_plate.result.model import load_result
    from warp_plate.viz.availability import missing_window

    loaded = load_result(result)
    if (problem := missing_window()) is not None:
        raise SceneError(
            f"no window can be opened: {problem}; write pictures, movies or a page with 'warp-plate render {result}'"
            ", or look in a browser with 'warp-plate explore SCENE'"
        )
    with output.scene_errors(result, **FRAME_ARGUMENTS):
        motions = select_motions(loaded, frames, playback, quiet=False)
    from warp_plate.viz.window import open_window

    open_window(loaded.scene, motions, playback.style(motions, chosen))


def render(
    result: options.ResultFile,
    /,
    *,
    out: Annotated[list[Path] | None, Parameter(negative="")] = None,
    playback: PlaybackOptions = PlaybackOptions(),
    colours: options.ColourChoice = options.ColourChoice(),
    shown: FrameOptions = FrameOptions(),
    picture: PictureOptions = PictureOptions(),
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
    """
    targets = [output.output_file(path, ".png", ENDINGS) for path in out or [Path(f"{result.stem}.png")]]
    playback.check()
    from warp_plate.analysis.motion import frame_at
    from warp_plate.result.hdf5 import describe_file
    from warp_plate.result.model import load_result
    from warp_plate.viz.availability import DrawingUnavailable
    from warp_plate.viz.pictures import draw_motions, largest_frame, missing_library

    for target in targets:  # before anything is simulated
        if (problem := missing_library(target, picture.plan)) is not None:
            raise SceneError(problem)
    time = picture.time
    with output.scene_errors(result, **FRAME_ARGUMENTS):
        if describe_file(result) == "a focus":
            scene, motions = select_focus_motions(result, shown, playback)
        else:
            loaded = load_result(result)
            scene, motions = loaded.scene, select_motions(loaded, frames_around(loaded, time, shown), playback, json)
        frame = largest_frame(motions, playback.field) if time is None else frame_at(motions[0], time)
    style = playback.style(motions, colours.chosen(), width=picture.width, plan=picture.plan)
    files: list[Path] = []
    try:
        for target in targets:
            with output.progress_bar(f"drawing {target.name}", shown=not json) as show:
                draw_motions(scene, motions, target, style, frame, show)
            files.append(target)
    except DrawingUnavailable as problem:
        raise SceneError(str(problem)) from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"; wrote only {', '.join(map(str, files))}" if files else "") from None
    output.report(json, lambda: {"result": result}, lambda _: None, write=lambda: (files, None))


def frames_around(result: Result, time: float | None, shown: FrameOptions) -> FrameOptions:
    """Return the options with the period around a time that is given without ``--start`` and ``--end``."""
    if time is None or shown.start is not None or shown.end is not None:
        return shown
    from warp_plate.analysis.motion import period_around

    start, end = period_around(result, time)
    return replace(shown, start=start, end=end)


def select_motions(result: Result, shown: FrameOptions, playback: PlaybackOptions, quiet: bool) -> list[Motion]:
    """Return the motions of a result to show."""
    from warp_plate.analysis.motion import FRAMES_A_PERIOD, mode_motions, motions
    from warp_plate.viz.annotations import ordered_cases

    if playback.modes:
        if playback.field != "displacement":
            raise SceneError(f"--field {playback.field}: mode shapes have displacements only; leave out --modes")
        return mode_motions(result.scene, range(1, playback.modes + 1), shown.frames or FRAMES_A_PERIOD)
    span = span_of(shown, result.scene.window.end)
    cases = result.select_cases(shown.case or list(ordered_cases(result)))
    with output.progress_bar("simulating", shown=not quiet) as show:
        return motions(result.scene, cases, span, shown.frames, shown.device or "auto", show)


def span_of(shown: FrameOptions, end: float) -> tuple[float, float] | None:
    """Return the start and end that the options give, of a run that ends at ``end`` [s]; None if they give neither."""
    if shown.start is None and shown.end is None:
        return None
    return shown.start or 0.0, end if shown.end is None else shown.end


def select_focus_motions(file: Path, shown: FrameOptions, playback: PlaybackOptions) -> tuple[Scene, list[Motion]]:
    """Return the scene and the motions to show of a file of ``focus``."""
    from warp_plate.focusing.figures import FRAMES, focus_motions
    from warp_plate.result.focus import load_focus

    if playback.modes:
        raise SceneError(f"--modes {playback.modes}: {file} holds waveforms; leave it out")
    result = load_focus(file)
    span = span_of(shown, float(result.times[-1]))
    return result.scene, focus_motions(result, shown.case or (), span, shown.frames or FRAMES)
