"""``warp-plate init`` and ``keys``: scene files to begin with, and what may be in them."""

from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError, printable

# Commands that read a table of their own, and the line of a preset that opens it.
COMMANDS = {"specify": "\n[specification]", "focus": "\n[focus"}


def init(name: str, /, *, out: Path | None = None) -> None:
    """Write a preset as a TOML file to edit.

    Parameters
    ----------
    name
        The preset: paper, paper-supported, touch-panel, cantilever-display, composite-panel, large-amplitude,
        focusing-glass, four-fingers, console, watch or trackpad.
    out
        The file to write (default: NAME.toml in this folder). An existing file is never overwritten.
    """
    from warp_plate.scene.load import preset_text

    text = preset_text(name)
    path = out or Path(f"{name}.toml")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise SceneError(f"{path}: exists already; choose another name with --out") from None
    except (OSError, ValueError) as error:
        with suppress(OSError, ValueError):
            path.unlink()  # what a full disk took of it
        raise SceneError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    command = next((command for command, table in COMMANDS.items() if table in text), "localize")
    print(printable(f"wrote {path}; run it with: warp-plate {command} {path}"))


def keys(*tables: str, json: options.Json = False) -> None:
    """Show the tables of a scene file, or every key of a table with unit, default, range, example and meaning.

    Parameters
    ----------
    tables
        Tables such as plate, edges, drive.burst or effects.damping; "all" for all of them. Default: their names.
    """
    from warp_plate.scene.key_reference import table_references

    references = {heading.strip("[]"): table for table in table_references() for heading in table.headings}
    for name in tables:
        if name.rpartition(".")[0] in references and name not in references:
            table = name.rpartition(".")[0]
            raise SceneError(f"{name}: no such table; the keys of {table} are shown by: warp-plate keys {table}")
        if name not in references and name != "all":
            raise SceneError(f"{name}: no such table; there are: {', '.join(list(references)[1:])}")
    selected = {name: references[name] for name in (references if "all" in tables else tables)}

    def show(console: Console) -> None:
        if not selected:
            tables = {name: table.description.split("\n\n")[0].replace("\n", " ") for name, table in references.items()}
            output.print_lines(console, ((name, text.replace("`", "")) for name, text in tables.items()))
        for name, table in selected.items():
            console.print(f"{name}: {table.description.replace('`', '')}\n", highlight=False)
            rows = [("key", "unit", "default", "range", "example", "meaning")]
            for key in table.keys:
                rows.append((key.name, key.unit, key.default, key.range, key.example, f"{key.meaning} ({key.type})"))
            output.print_lines(console, ([cell.replace("`", "") for cell in row] for row in rows), "")

    record = {name: [asdict(key) for key in table.keys] for name, table in (selected or references).items()}
    output.report(json, lambda: record, show)
