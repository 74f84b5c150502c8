"""What ``localize`` prints of objectives other than the localization factor alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warp_plate.cli import output

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.model import Result


def print_objectives(result: Result, console: Console) -> None:
    """A row for each objective, a column for each target's drive; nothing where only localization is sought."""
    from warp_plate.scene.search import OBJECTIVE_UNITS

    if result.only_localization or not result.values:
        return
    values = [one.values for one in result.several] or [result.values]
    columns = [target.name for target in result.scene.targets][: len(values)] or ["found"]
    made = output.table("objective", "weight", "limit", *columns)

    def add(name: str, words: str, weight: str = "", limit: str = "") -> None:
        made.add_row(words, weight, limit, *(output.known(one.get(name), ".5g") for one in values))

    for one in result.scene.search.objectives:
        unit = OBJECTIVE_UNITS[one.kind].removeprefix("1")
        add(one.kind, f"{one.kind} ({unit})" if unit else one.kind, f"{one.weight:g}")
        if one.rest_limit is not None:
            add(f"{one.kind} of the rest", f"{one.kind} of the rest ({unit})", limit=f"{one.rest_limit:g}")
    add("sum", "weighted sum")
    if any("bound" in one for one in values):
        add("bound", "bound of the sum")
    console.print(made)
    console.print()
