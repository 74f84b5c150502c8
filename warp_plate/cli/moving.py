"""What ``view`` and ``render`` share: the plates of a result in motion, from what the options choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.model import Case, Result
    from warp_plate.result.motion import Motion

Field = Literal["displacement", "velocity", "energy", "rms-velocity", "phase"]
# Of natural shapes side by side; frames a second.
MOST_MODES, RATES = 6, (1, 120)
# A period is played in this time at least.
PERIOD_SECONDS = 1.4


@dataclass(frozen=True)
class Choice:
    """What the options of both commands choose; see ``render``."""

    cases: Sequence[str]
    modes: int
    start: float | None
    end: float | None
    frames: int | None
    device: str


def chosen_motions(result: Result, name: Path, choice: Choice, field: Field, quiet: bool) -> list[Motion]:
    """The plates to show; ``name`` of the result's file, for errors.

    Raises:
        SceneError: options that do not go together, and see ``motions`` and ``mode_motions``.
    """
    from warp_plate.analysis.motion import mode_motions, motions
    from warp_plate.plate.modes import refuse_many_nodes

    if choice.frames is not None and choice.frames < 2:
        raise SceneError(f"--frames {choice.frames}: must be at least 2")
    if choice.modes:
        if not 0 < choice.modes <= MOST_MODES:
            raise SceneError(f"--modes {choice.modes}: must be from 1 to {MOST_MODES}")
        if field != "displacement":
            raise SceneError(f"--field {field}: natural shapes have their displacement only; leave out --modes")
        try:
            refuse_many_nodes(result.scene)
        except SceneError as error:
            raise SceneError(f"--modes {choice.modes}: {error}") from None
        return mode_motions(result.scene, range(1, choice.modes + 1), **_given(frames=choice.frames))
    span = None
    if choice.start is not None or choice.end is not None:
        span = (choice.start or 0.0, result.scene.window.end if choice.end is None else choice.end)
    cases = chosen_cases(result, name, choice.cases)
    with output.progress_bar("simulating", shown=not quiet) as show:
        try:
            return motions(
                result.scene,
                cases,
                span,
                choice.frames,
                choice.device,
                lambda done, total: show(done, total, ""),
            )
        except SceneError as error:
            raise SceneError(f"{name}: {error}") from None


def check_looks(rate: float | None, heights: float | None) -> None:
    """Raise SceneError for options that no picture could have."""
    if rate is not None and not RATES[0] <= rate <= RATES[1]:
        raise SceneError(f"--rate {rate:g}: must be from {RATES[0]} to {RATES[1]} frames a second")
    if heights is not None and not 0 < heights < float("inf"):
        raise SceneError(f"--heights {heights:g}: must be above 0")


def playing_rate(rate: float | None, motions: Sequence[Motion]) -> float:
    """Frames a second: what was asked for, or 30 unless a period would be over too soon to be seen."""
    if rate is not None:
        return rate
    first = motions[0]
    periods = (first.span[1] - first.span[0]) * first.frequency
    frames_a_period = len(first.times) / max(periods, 1e-9)
    return min(30.0, max(RATES[0], frames_a_period / PERIOD_SECONDS))


def chosen_cases(result: Result, name: Path, cases: Sequence[str]) -> dict[str, Case]:
    """The result's cases with these names, in their order; all where none is named.

    Raises:
        SceneError: the result has no such case.
    """
    from warp_plate.viz.captions import ordered_cases

    known = ordered_cases(result)
    for case in cases:
        if case not in known:
            raise SceneError(f"--case {case}: {name} holds {', '.join(known)}")
    return {case: known[case] for case in cases} or known


def _given(**options: int | None) -> dict[str, int]:
    """Those that are not left out."""
    return {name: value for name, value in options.items() if value is not None}
