"""``warp-plate keys``: the keys of scene files."""

from __future__ import annotations

from dataclasses import asdict

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError


def keys(*tables: str, json: options.Json = False) -> None:
    """Show the tables of a scene file, or every key of a table with unit, default, range, example and meaning.

    Parameters
    ----------
    tables
        Tables such as plate, edges, drive.burst or effects.damping; "all" for all of them. Default: their names.
    """
    from rich.console import Console

    from warp_plate.scene.key_reference import table_references

    known = {heading.strip("[]"): each for each in table_references() for heading in each.headings}
    for name in tables:
        if name not in known and name != "all":
            raise SceneError(f"{name}: no such table; there are: {', '.join(list(known)[1:])}")
    chosen = {name: known[name] for name in (known if "all" in tables else tables)}

    def show(console: Console) -> None:
        if not chosen:
            made = output.table("table", "")
            for name, each in known.items():
                made.add_row(name, each.description.split("\n\n")[0].replace("\n", " ").replace("`", ""))
            made.columns[-1].justify = "left"
            return console.print(made)
        for name, each in chosen.items():
            console.print(f"{name}: {each.description.replace('`', '')}\n", highlight=False)
            made = output.table("key", "unit", "default", "range", "example", "meaning")
            for key in each.keys:
                cells = key.unit, key.default, key.range, key.example, f"{key.meaning} ({key.type})"
                made.add_row(key.name, *(cell.replace("`", "") for cell in cells))
            made.columns[-1].justify = "left"
            console.print(made, "")

    record = {name: [asdict(key) for key in each.keys] for name, each in (chosen or known).items()}
    output.report(json, lambda: record, show)
