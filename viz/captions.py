"""Names of cases and captions of plates."""

from __future__ import annotations

import math

from warp_plate.result.model import Case, Result
from warp_plate.result.motion import Motion
from warp_plate.result.targets import target_cases
from warp_plate.scene.errors import printable
from warp_plate.scene.model import Scene

LONGEST_NAME = 22  # characters of a name in a caption or legend
CASE_LABELS = {
    "equal": "equal drive",
    "single": "single actuator",
    "time_reversal": "time reversal",
    "inverse_filter": "inverse filter",
    "nominal": "optimised without scatter",
    "best": "best drive found",
    "drive": "given drive",
}


def case_label(name: str, scene: Scene, actuator: str = "") -> str:
    """Return the label of a case of a result of this scene; of a single actuator with its name, if it is given."""
    targets = {case: target for target, case in target_cases(scene).items()}
    label = f"best drive for {targets[name]}" if name in targets else CASE_LABELS.get(name, name)
    return f"{label}, {shortened(actuator)}" if name == "single" and actuator else label


def shortened(name: str) -> str:
    """Return a name cut after LONGEST_NAME characters, with control characters escaped."""
    name = printable(name)
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def ordered_cases(result: Result) -> dict[str, Case]:
    """Return the cases in the order of the source paper, then those of further targets, then any others."""
    names = dict.fromkeys([*CASE_LABELS, *target_cases(result.scene).values(), *result.cases])
    return {name: result.cases[name] for name in names if name in result.cases}


def caption(label: str, time: float, localization_factor: float, decimals: int | None = None, tone: str = "") -> str:
    """Return two lines: the drive and the time [s], with so many decimals or four digits; the localization factor and
    the text of :func:`at_frequency`."""
    moment = f"{time:.4g}" if decimals is None else f"{time:.{decimals}f}"
    return f"{label}, t = {moment} s\nlocalization factor {percent(localization_factor)}{tone}"


def at_frequency(scene: Scene, frequency: float) -> str:
    """Return " at ... Hz" if a common frequency was searched, so that the cases of a result may differ in it."""
    searched = scene.search.frequency
    common = searched is not None and searched.actuators is None and not searched.own
    return f" at {frequency:.4g} Hz" if common else ""


def frame_caption(motion: Motion, frame: int, scene: Scene) -> str:
    """Return the caption of a plate at a frame: drive, time and localization factor, or the mode."""
    if motion.localization_factor is None:
        return motion.name
    # Enough decimals to tell one frame from the next.
    decimals = max(0, math.ceil(-math.log10((motion.span[1] - motion.span[0]) / len(motion.times))))
    label = case_label(motion.name, scene, motion.only_actuator)
    tone = at_frequency(scene, motion.frequency)
    return caption(label, float(motion.times[frame]), motion.localization_factor, decimals, tone)


def percent(share: float, decimals: int = 2) -> str:
    """Return a share in percent, or "not defined" for a plate at rest."""
    return f"{100 * share:.{decimals}f} %" if math.isfinite(share) else "not defined"
