"""A report of a command as one HTML page, with its pictures inside, to hand to others."""

from __future__ import annotations

import base64
import html
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError, printable

Report = Annotated[
    Path | None,
    Parameter(help="HTML page to write, with all tables and pictures inside, to hand to others."),
]
# First line of pages, by which those of this program are known.
HEAD = "<!doctype html><!-- report of warp-plate -->"
TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.4rem } table { border-collapse: collapse; margin: 1rem 0 } caption { text-align: left }
th, td { padding: .2rem .8rem .2rem 0; border-bottom: 1px solid #ddd; text-align: right }
th:first-child, td:first-child { text-align: left } img { max-width: 100% } .warning { color: #b2182b }
pre { background: #f6f6f6; padding: .6rem; overflow: auto } footer { color: #777; margin-top: 2rem; font-size: .85rem }
"""


class _HtmlConsole(Console):
    """A console that collects what is printed as HTML."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[str] = []

    def print(self, *objects: Any, **options: Any) -> None:
        for item in objects:
            if isinstance(item, Table):
                self.parts.append("".join(_table(item)))
            elif text := str(item).strip():
                kind = ' class="warning"' if text.startswith("! ") else ""
                self.parts.append(f"<p{kind}>{_escaped(text.removeprefix('! '))}</p>")


def _escaped(text: str) -> str:
    return html.escape(printable(text))


def _table(table: Table) -> Iterator[str]:
    """Yield the parts of a table."""
    yield "<table>"
    if table.title:
        yield f"<caption>{_escaped(str(table.title))}</caption>"
    if table.show_header:
        yield f"<tr>{''.join(f'<th>{_escaped(str(column.header))}</th>' for column in table.columns)}</tr>"
    for row in zip(*(column.cells for column in table.columns), strict=True):
        yield f"<tr>{''.join(f'<td>{_escaped(str(cell))}</td>' for cell in row)}</tr>"
    yield "</table>"


def check_report(path: Path | None, force: bool) -> None:
    """Raise a SceneError if a report cannot be written there."""
    if path is None:
        return
    try:
        output.output_file(path, "report.html", (".html", ".htm"))
        output.check_overwriting(path, HEAD, force)
    except SceneError as error:
        raise SceneError(str(error).replace("--out", "--report")) from None


def write_report(
    path: Path, title: str, show: Callable[[Console], object], draw: Callable[[Path], output.Drawn], appendix: str = ""
) -> Path:
    """Write a report, and return its path.

    Args:
        path: File to write.
        title: Title of the page.
        show: Function that prints text and tables on a console.
        draw: Function that draws pictures beside a path, and returns their files and why some are missing.
        appendix: Text that readers may unfold, such as a scene file.
    """
    from warp_plate._version import __version__
    from warp_plate.result.atomic_io import write_atomically

    console = _HtmlConsole()
    show(console)
    with tempfile.TemporaryDirectory() as folder:
        files, missing = draw(Path(folder) / "picture.png")
        pictures = [_picture(file, title) for file in files if file.suffix == ".png"]
    parts = [f"<h1>{_escaped(title)}</h1>", *console.parts, *pictures]
    parts += [f"<p>{_escaped(missing)}</p>"] if missing else []
    parts += [f"<details><summary>Scene</summary><pre>{_escaped(appendix)}</pre></details>"] if appendix else []
    words = f"warp-plate {shlex.join(sys.argv[1:])}" if Path(sys.argv[0]).stem == "warp-plate" else "warp-plate"
    parts.append(f"<footer>{_escaped(f'{words} (version {__version__})')}</footer>")
    head = f'<html lang="en"><head><meta charset="utf-8"><title>{_escaped(title)}</title><style>{STYLE}</style></head>'
    write_atomically("\n".join([HEAD, head, "<body>", *parts, "</body></html>", ""]).encode(), path)
    return path


def _picture(file: Path, title: str) -> str:
    """Return a picture that holds its file."""
    data = base64.b64encode(file.read_bytes()).decode()
    return f'<img alt="{_escaped(title)}" src="data:{TYPES[file.suffix]};base64,{data}">'
