"""How ``localize`` shows a robust drive beside the nominal one: a table, and its part of the JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from warp_plate.cli import output

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.model import Result
    from warp_plate.result.robust import RobustComparison

MEANING = {
    "mean": "mean",
    "worst_5_percent": "mean of the worst 5 %",
    "worst": "worst",
    "nominal_plate": "the plate without scatter",
    "searched": "the search's own scenarios",
}


def robust_json(compared: RobustComparison | None) -> dict[str, object] | None:
    """The object under "robust" that ``--json`` prints; a value that is none, of plates that failed, is null."""
    if compared is None:
        return None
    names = ("robust", "nominal")
    rows = {
        key: {name: _finite(value) for name, value in zip(names, values.tolist(), strict=True)}
        for key, values in compared.rows().items()
    }
    return {
        "measure": compared.measure,
        "scenarios": compared.scenarios,
        "value": "localization factor" if compared.localization else "weighted sum of objectives",
        "bound": compared.bound,
        **rows,
        "failed": dict(zip(names, compared.failed.tolist(), strict=True)),
        "fresh": {
            name: [_finite(value) for value in values]
            for name, values in zip(names, compared.validation.tolist(), strict=True)
        },
    }


def print_robust(result: Result, console: Console) -> None:
    """The table; nothing where the search was not robust."""
    robust, compared = result.scene.search.robust, result.robust
    if robust is None:
        return
    if compared is None:
        why = "none was found, Ctrl-C came first, or a fresh scenario is no plate"
        console.print(f"Not compared with a nominal drive: {why}.\n")
        return
    what = "localization factor" if compared.localization else "weighted sum of objectives"
    made = output.table(what, "robust drive", "nominal drive")
    for key, values in compared.rows().items():
        within = f" ({compared.measure} of {compared.scenarios})" if key == "searched" else ""
        made.add_row(MEANING[key] + within, *(f"{value:.4f}" for value in values))
    if compared.bound is not None:
        made.add_row("bound of the search's own", f"{compared.bound:.4f}", "")
    if compared.failed.any():
        made.add_row("plates that failed", *map(str, compared.failed.tolist()))
    console.print(f"Over {compared.validation.shape[1]} fresh scenarios, which neither drive was searched with:")
    console.print(made)
    console.print()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
