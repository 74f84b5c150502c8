"""What ``localize`` prints of several targets: how much each drive moves at each target."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.table import Table

from warp_plate.cli import output

if TYPE_CHECKING:
    from warp_plate.result.model import Result


def crosstalk_json(result: Result) -> dict[str, object] | None:
    """Shares of the plate's kinetic energy, and decibels against each drive's own target; None for one target."""
    from warp_plate.result.crosstalk import crosstalk, decibels, target_cases

    cases = target_cases(result.scene)
    if not cases:
        return None
    shares = crosstalk(result)
    found = {name: result.cases[name] for name in cases.values() if name in result.cases}
    return {
        "targets": list(cases),
        "cases": list(cases.values()),
        "share": shares.tolist(),
        "decibels": decibels(shares).tolist(),
        "bound": [one.bound for one in result.target_searches],
        "bound_kind": [one.bound_kind for one in result.target_searches],
        "objectives": [dict(one.objective_values) or None for one in result.target_searches],
        "evaluations": [one.evaluations for one in result.target_searches],
        "drives": {name: output.drive_json(case, result.scene) for name, case in found.items()},
    }


def crosstalk_table(result: Result) -> Table:
    """A row for each drive, a column for each target."""
    from warp_plate.result.crosstalk import crosstalk, decibels, target_cases

    names = list(target_cases(result.scene))
    shares = crosstalk(result)
    against = decibels(shares)
    made = output.table("drive for", *names, "bound", title="Crosstalk: share of the plate's kinetic energy in")
    for row, name in enumerate(names):
        cells = [
            "not searched"
            if math.isnan(share)
            else f"{share:.4f}" + (f" ({against[row, column]:+.1f} dB)" if row != column else "")
            for column, share in enumerate(shares[row].tolist())
        ]
        bound = result.target_searches[row].bound if row < len(result.target_searches) else None
        made.add_row(name, *cells, "none claimed" if bound is None else f"{bound:.4f}")
    return made
