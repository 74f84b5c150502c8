"""``warp-plate verify RESULT --data FILE``: a drive measured on the panel against its result."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.cli import options, output

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.studies.verify import Verification


def verify(
    result: options.ResultFile,
    /,
    *,
    data: Path,
    case: str | None = None,
    json: options.Json = False,
) -> None:
    """Compare velocities measured under a drive with those that its result predicts.

    The measured localization factor comes with its uncertainty. One part is the noise; the other is the small number of
    points, estimated from the predicted field.

    Parameters
    ----------
    data
        CSV file whose first line names its columns: x and y (metres), velocity (root mean square, in any unit) and
        optionally uncertainty (standard deviation, in the same unit). Without that column, the spread of repeated
        readings at a point is the uncertainty.
    case
        Name of the drive in the result (default: best, or the one that was simulated).
    """
    from warp_plate.result.model import load_result
    from warp_plate.studies.verify import verify

    found = verify(load_result(result), data, case)
    output.report(json, partial(_as_json, found), partial(_print, found))


def _as_json(found: Verification) -> dict[str, object]:
    names = ("case", "promised_factor", "localization_factor", "deviation", "sampling", "interval", "kept", "scale")
    return {
        **output.attributes(found, *names, "correlation"),
        "points": found.measured.points,
        "measured": found.measured.velocity,
        "promised": found.promised,
    }


def _print(found: Verification, console: Console) -> None:
    low, high = found.interval
    made = output.table("localization factor", "")
    made.add_row("promised", f"{100 * found.promised_factor:.2f} %")
    made.add_row("measured", f"{100 * found.localization_factor:.2f} %")
    made.add_row("standard deviation by noise", output.number_text(100 * found.deviation, ".2g", " %"))
    made.add_row("error of sampling", f"{100 * found.sampling:.2g} %")
    made.add_row("measured, from", f"{100 * low:.2f} %")
    made.add_row("to", f"{100 * high:.2f} %")
    output.print_uncropped(console, made)
    console.print(
        f"\n{len(found.promised)} points: measured velocities are {found.scale:.4g} times the promised ones, and their "
        f"cosine is {found.correlation:.4f}."
    )
    if not found.kept:
        console.print("! The drive does not keep its promise: fit the scene to a measurement, and search again.")
    if np.isnan(found.deviation):
        console.print("! The noise is not known: add a column uncertainty, or measure each point twice.")
