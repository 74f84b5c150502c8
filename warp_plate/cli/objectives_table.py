"""What ``localize`` prints of objectives other than the localization factor alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warp_plate.cli import output

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.model import Result

HEADINGS = {
    "equal": "equal",
    "single": "single",
    "time_reversal": "time\nreversal",
    "inverse_filter": "inverse\nfilter",
}


def print_objectives(result: Result, console: Console) -> None:
    """A row for each objective, a column for each target's drive, or for what was found and the drives beside it;
    nothing where only localization is sought."""
    from warp_plate.problem.objectives import keeps_limit
    from warp_plate.scene.search import OBJECTIVE_UNITS

    if result.only_localization or not result.objective_values:
        return
    values = [one.objective_values for one in result.target_searches] or [result.objective_values]
    columns = [target.name for target in result.scene.targets][: len(values)] or ["found"]
    by_case = result.objective_values_by_case
    beside = {heading: by_case[name] for name, heading in HEADINGS.items() if name in by_case}
    made = output.table("objective", "weight", "limit", *columns, *beside)
    beyond = []

    def add(name: str, words: str, weight: str = "", limit: float | None = None) -> None:
        shown = [output.known(one.get(name), ".4g") for one in values]
        shown += [output.known(one[name], ".4g") if name in one else "" for one in beside.values()]
        made.add_row(words, weight, "" if limit is None else f"{limit:g}", *shown)
        if limit is not None and not all(keeps_limit(one.get(name, 0.0), limit) for one in values):
            beyond.append(words)

    for one in result.scene.search.objectives:
        unit = OBJECTIVE_UNITS[one.kind].removeprefix("1")
        add(one.kind, f"{one.kind} ({unit})" if unit else one.kind, f"{one.weight:g}")
        if one.rest_limit is not None:
            add(f"{one.kind} of the rest", f"{one.kind} of the rest ({unit})", limit=one.rest_limit)
    add("sum", "weighted sum")
    if any("bound" in one for one in values):
        kinds = [one.bound_kind for one in result.target_searches] or [result.bound_kind]
        add("bound", f"{'bound only' if 'bound only' in kinds else 'bound'} of the sum")
    output.print_whole(console, made)
    if beside and not beyond:
        console.print("Found: of the drives that may be chosen, which those beside it need not be.", style="dim")
    for words in beyond:
        console.print(f"! {words}: no drive was found that keeps the limit; the one nearest to it is shown")
    console.print()
