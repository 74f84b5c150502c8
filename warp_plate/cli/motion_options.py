"""Plates in motion as the options of ``view``, ``render`` and ``export`` select them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.model import Case, Result
    from warp_plate.result.motion import Motion

MOST_SHAPES = 6
# Limits of the frames a second.
RATES = (1, 120)
# Shortest time in which a period is played [s].
PERIOD_SECONDS = 1.4


@dataclass(frozen=True)
class MotionOptions:
    """Options that select the plates and frames to show.

    Attributes:
        cases: names of cases; empty for all.
        modes: number of mode shapes shown instead of cases; 0 for none.
        start, end: first and last time [s], or None.
        frames: number of frames, or None.
        device: device that runs the scene again.
    """

    cases: Sequence[str]
    modes: int
    start: float | None
    end: float | None
    frames: int | None
    device: str


def select_motions(result: Result, file: Path, options: MotionOptions, field: str, quiet: bool) -> list[Motion]:
    """Return the motions to show of a result, whose file is named in errors."""
    from warp_plate.analysis.motion import motions

    if options.frames is not None and options.frames < 2:
        raise SceneError(f"--frames {options.frames}: must be at least 2")
    if options.modes:
        return _mode_shapes(result, options, field)
    span = None
    if options.start is not None or options.end is not None:
        span = (options.start or 0.0, result.scene.window.end if options.end is None else options.end)
    cases = select_cases(result, file, options.cases)
    with output.progress_bar("simulating", shown=not quiet) as show:
        try:
            return motions(
                result.scene, cases, span, options.frames, options.device, lambda done, total: show(done, total, "")
            )
        except SceneError as error:
            raise SceneError(f"{file}: {error}") from None


def _mode_shapes(result: Result, options: MotionOptions, field: str) -> list[Motion]:
    from warp_plate.analysis.motion import mode_motions
    from warp_plate.plate.modes import refuse_many_nodes

    count = options.modes
    if not 0 < count <= MOST_SHAPES:
        raise SceneError(f"--modes {count}: must be from 1 to {MOST_SHAPES}")
    if field != "displacement":
        raise SceneError(f"--field {field}: mode shapes have displacements only; leave out --modes")
    try:
        refuse_many_nodes(result.scene)
    except SceneError as error:
        raise SceneError(f"--modes {count}: {error}") from None
    frames = {} if options.frames is None else {"frames": options.frames}
    return mode_motions(result.scene, range(1, count + 1), **frames)


def select_cases(result: Result, file: Path, names: Sequence[str]) -> dict[str, Case]:
    """Return the named cases of a result, or all if no name is given, in the order in which they are shown."""
    from warp_plate.viz.captions import ordered_cases

    known = ordered_cases(result)
    for name in names:
        if name not in known:
            raise SceneError(f"--case {name}: {file} holds {', '.join(known)}")
    return {name: known[name] for name in names} or known


def check_playback(rate: float | None, heights: float | None) -> None:
    """Check ``--rate`` and ``--heights``."""
    if rate is not None and not RATES[0] <= rate <= RATES[1]:
        raise SceneError(f"--rate {rate:g}: must be from {RATES[0]} to {RATES[1]} frames a second")
    if heights is not None and not 0 < heights < float("inf"):
        raise SceneError(f"--heights {heights:g}: must be above 0")


def playback_rate(rate: float | None, motions: Sequence[Motion]) -> float:
    """Return the frames a second: ``rate``, or 30 unless a period would be shorter than ``PERIOD_SECONDS``."""
    if rate is not None:
        return rate
    first = motions[0]
    periods = (first.span[1] - first.span[0]) * first.frequency
    frames_a_period = len(first.times) / max(periods, 1e-9)
    return min(30.0, max(RATES[0], frames_a_period / PERIOD_SECONDS))
