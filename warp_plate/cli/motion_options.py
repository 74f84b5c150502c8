"""Plates in motion as the options of ``view``, ``render`` and ``export`` select them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.model import Case, Result
    from warp_plate.result.motion import Motion
    from warp_plate.scene.model import Scene

# Limits of the frames a second.
RATES = (1, 120)
# Shortest time in which a period is played [s].
PERIOD_SECONDS = 1.4


@Parameter(name="*")
@dataclass(frozen=True)
class FrameOptions:
    """Options that select cases of a result and frames; their help texts are the lines below.

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
    frames: Annotated[int | None, Parameter(validator=Number(gte=2))] = None
    device: str | None = None


@Parameter(name="*")
@dataclass(frozen=True)
class PlaybackOptions:
    """Options for the content and playback of moving plates; their help texts are the lines below.

    Attributes:
        field: Quantity shown in colour (energy: kinetic energy density). Heights always show displacements.
        modes: Show this many natural mode shapes, 6 at most, instead of the cases.
        rate: Frames a second (default: 30, or fewer so that a period takes at least 1.4 s).
        heights: Factor by which displacements are exaggerated (default: automatic).
    """

    field: Literal["displacement", "velocity", "energy", "rms-velocity", "phase"] = "displacement"
    modes: Annotated[int, Parameter(validator=Number(gte=0, lte=6))] = 0
    rate: float | None = None
    heights: float | None = None

    def check(self) -> None:
        """Check ``--rate`` and ``--heights``."""
        if self.rate is not None and not RATES[0] <= self.rate <= RATES[1]:
            raise SceneError(f"--rate {self.rate:g}: must be from {RATES[0]} to {RATES[1]} frames a second")
        if self.heights is not None and not 0 < self.heights < float("inf"):
            raise SceneError(f"--heights {self.heights:g}: must be above 0")

    def frame_rate(self, motions: Sequence[Motion]) -> float:
        """Return the frames a second: ``rate``, or 30 unless a period would be shorter than ``PERIOD_SECONDS``."""
        if self.rate is not None:
            return self.rate
        first = motions[0]
        periods = (first.span[1] - first.span[0]) * first.frequency
        return min(30.0, max(RATES[0], len(first.times) / max(periods, 1e-9) / PERIOD_SECONDS))


DEFAULT_FRAMES, DEFAULT_PLAYBACK = FrameOptions(), PlaybackOptions()


def select_motions(
    result: Result, file: Path, options: FrameOptions, playback: PlaybackOptions, quiet: bool
) -> list[Motion]:
    """Return the motions of a result to show; errors name its file."""
    from warp_plate.analysis.motion import motions

    if playback.modes:
        return _mode_shapes(result, options.frames, playback)
    span = span_of(options, result.scene.window.end)
    cases = select_cases(result, file, options.case)
    with output.progress_bar("simulating", shown=not quiet) as show:
        try:
            return motions(result.scene, cases, span, options.frames, options.device or "auto", show)
        except SceneError as error:
            raise SceneError(f"{file}: {error}") from None


def span_of(options: FrameOptions, end: float) -> tuple[float, float] | None:
    """Return the start and end that the options give, of a run that ends at ``end`` [s]; None if they give neither."""
    if options.start is None and options.end is None:
        return None
    return options.start or 0.0, end if options.end is None else options.end


def select_focus_motions(file: Path, options: FrameOptions, playback: PlaybackOptions) -> tuple[Scene, list[Motion]]:
    """Return the scene and the motions to show of a file of ``focus``."""
    from warp_plate.focusing.motion import FRAMES, focus_motions
    from warp_plate.result.focus import load_focus

    if playback.modes:
        raise SceneError(f"--modes {playback.modes}: {file} holds waveforms; leave it out")
    found = load_focus(file)
    span = span_of(options, float(found.times[-1]))
    try:
        return found.scene, focus_motions(found, options.case or (), span, options.frames or FRAMES)
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None


def _mode_shapes(result: Result, frames: int | None, playback: PlaybackOptions) -> list[Motion]:
    from warp_plate.analysis.motion import mode_motions

    count = playback.modes
    if playback.field != "displacement":
        raise SceneError(f"--field {playback.field}: mode shapes have displacements only; leave out --modes")
    return mode_motions(result.scene, range(1, count + 1), **({} if frames is None else {"frames": frames}))


def select_cases(result: Result, file: Path, names: Sequence[str] | None) -> dict[str, Case]:
    """Return the named cases of a result, or all if no name is given, in the order in which they are shown."""
    from warp_plate.viz.captions import ordered_cases

    known = ordered_cases(result)
    for name in names or ():
        if name not in known:
            raise SceneError(f"--case {name}: {file} holds {', '.join(known)}")
    return {name: known[name] for name in names or known}
