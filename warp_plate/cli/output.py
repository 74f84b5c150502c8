"""Input and output of commands: scenes, output files, text, tables, JSON, and progress on standard error."""

from __future__ import annotations

import io
import math
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console
from rich.table import Table
from rich.text import Text

from warp_plate.cli import collect_garbage, postpone_garbage
from warp_plate.cli import log as log
from warp_plate.interrupts import deferred_interrupts, ignore_interrupts
from warp_plate.scene.errors import SceneError, printable
from warp_plate.scene.errors import number_text as number_text

# The longest ending of the files that are written beside a result.
LONGEST_ENDING = "-inverse_filter-64.wav.123456789abc.part.wav"
# Why pictures are missing after Ctrl-C.
INTERRUPTED = "no pictures: interrupted by Ctrl-C"
if TYPE_CHECKING:
    from warp_plate.result.model import Result
    from warp_plate.scene.model import Scene
    from warp_plate.studies.unfinished import CheckpointFile
    from warp_plate.viz.fields import ColourOptions

# Draws pictures beside a file; returns their paths and, if some are missing, the reason.
Drawn = tuple[list[Path], str | None]


class _PlainConsole(Console):
    """A console that prints text verbatim: scene titles and names are neither markup nor terminal commands."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)

    def on_broken_pipe(self) -> None:
        raise  # the BrokenPipeError that main expects


class _ProgressStream(io.StringIO):
    """Standard error without the errors of a terminal that was closed."""

    def __init__(self) -> None:
        super().__init__()
        self._terminal = sys.stderr  # rich replaces it while a bar is shown

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._terminal.write(text)
            self._terminal.flush()
        return len(text)


def console(**options: Any) -> Console:
    """Return a console on standard output, wrapped to the terminal's width and without colours in a file."""
    return _PlainConsole(highlight=False, markup=False, emoji=False, **options)


@contextmanager
def resumable(file: CheckpointFile, command: str = "") -> Iterator[None]:
    """Add how to resume the study that the file holds to errors and Ctrl-C; see :func:`how_to_resume`."""
    try:
        yield
    except SceneError as error:
        saved = "" if file.saved is None else "; there is a checkpoint"
        raise SceneError(f"{error}{saved}{how_to_resume(file, command)}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(how_to_resume(file, command)) from None


def how_to_resume(file: CheckpointFile, command: str) -> str:
    """Return how far an unfinished study is, and what resumes it; "" if nothing was saved.

    Args:
        command: Command whose ``--resume`` continues; "" if the same command line does.
    """
    resume = f"resume with: warp-plate {command} --resume {shlex.quote(str(file.path))}"
    resume = resume if command else "the same command continues"
    return "" if file.saved is None else f" after {file.saved.progress}; {resume}"


def report(
    json: bool,
    as_json: Callable[..., Mapping[str, object]],
    show: Callable[..., object],
    *results: Any,
    write: Callable[[], Drawn] | None = None,
) -> None:
    """Write the files of a command, and print its answer as one JSON object, or as text and tables.

    Files are written first, so that Ctrl-C no longer ends the command. If they cannot be, the answer is printed
    nonetheless, lest it be lost.

    Args:
        as_json: Function of the results that returns the JSON object, to which "files" are added. Numbers that are not
            finite become null.
        show: Function of the results and a console that prints text and tables.
        write: Function that writes the files; it returns them, and why pictures are missing.

    Raises:
        SceneError: Files cannot be written.
    """
    try:
        files, missing = ([], None) if write is None else write()
    except SceneError:
        report(json, as_json, show, *results)
        raise
    if files:
        ignore_interrupts()
    if json:
        print(dumps(json_value({**as_json(*results), **({} if write is None else {"files": files})}), indent=2))
    else:
        show(*results, console())
        for line in (*(f"wrote {file}" for file in files), *([missing] if missing else [])):
            print(printable(line))
    sys.stdout.flush()


def json_value(value: Any) -> Any:
    """Return a value as JSON has it: arrays as lists, paths as texts, null for numbers that are not finite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return json_value(value.tolist()) if hasattr(value, "tolist") else value  # arrays and numbers of NumPy


def attributes(data: object, *names: str) -> dict[str, Any]:
    """Return some attributes of an object by their names."""
    return {name: getattr(data, name) for name in names}


def print_rows(
    console: Console,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *after: str,
    title: str | None = None,
    texts: int = 1,
) -> None:
    """Print a table without cropping numbers, however narrow the terminal; lines may follow.

    The first columns, ``texts`` of them, wrap like the headings; the others are numbers.
    """
    table = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for index, heading in enumerate(headings):
        cells = [row[index] for row in rows]
        unbroken = heading.split() + (" ".join(cells).split() if index < texts else cells)
        justify: Literal["left", "right"] = "left" if index < texts else "right"
        table.add_column(heading, justify=justify, min_width=max(map(len, unbroken), default=0))
    for row in rows:
        table.add_row(*row)
    console.print(table, *after, crop=False)


def print_lines(console: Console, rows: Iterable[Iterable[str]], *after: str) -> None:
    """Print a table of texts without headings; lines may follow."""
    table = Table.grid(padding=(0, 2, 0, 0))
    for row in rows:
        table.add_row(*row)
    console.print(table, *after)


def print_warnings(console: Console, warnings: Iterable[str]) -> None:
    """Print warnings of a result or scene."""
    for line in warnings:
        console.print(f"! {line}")


@contextmanager
def progress_bar(label: str, shown: bool, scene: Scene | None = None, last: str = "") -> Iterator[Callable[..., None]]:
    """Show a progress bar if standard error is a terminal; yield a function of (done, total, note) that updates it.

    Before the first update it says that kernels are compiled, or that a grid is chosen if the scene asks for an
    accuracy; when all is done, ``last`` (default: ``label``).
    """
    collect_garbage()
    if not shown or not sys.stderr.isatty():
        yield lambda done, total, note="": None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=_ProgressStream()), transient=True) as progress:
        first = label if scene is None else "compiling or loading kernels"
        if scene is not None and scene.grid.accuracy is not None:
            first = "choosing a grid"
        task = progress.add_task(first, total=None, note="")

        def show(done: int, total: int, note: str = "") -> None:
            stage = last or label if done == total else label
            progress.update(task, description=stage, completed=done, total=total, note=note)

        yield show


@contextmanager
def scene_errors(source: object, **options: str) -> Iterator[None]:
    """Prefix errors that begin with a key of the scene with its file, ``source``; in errors that begin with an argument
    of a function, ``NAME = value``, or an item of it, write the option that ``options`` name for it, ``--OPTION
    value``."""
    from warp_plate.scene.model import Scene

    try:
        yield
    except SceneError as error:
        message = str(error)
        key = re.split(r"\W", message, maxsplit=1)[0]
        if key in options and re.match(rf"{key}(\[\d+\])? = ", message):
            arguments = rf"(?<![\w.])({'|'.join(options)})(?:\[\d+\])? = "
            raise SceneError(re.sub(arguments, lambda name: f"--{options[name[1]]} ", message)) from None
        if source is None or key not in Scene.model_fields or message.startswith(f"{source}:"):
            raise
        raise SceneError(f"{source}: {error}") from None


def output_file(out: Path | None, default: str, endings: Sequence[str] = ()) -> Path:
    """Return the path to write to, ``--out`` or ``default``, whose ending is allowed unless ``endings`` has others.

    Raises:
        SceneError: it cannot be written.
    """
    path = Path(default) if out is None else out
    endings = endings or (Path(default).suffix,)
    problem = writing_problem(path)
    if path.suffix.lower() not in endings:
        problem = f"must end in {' or '.join(', '.join(endings).rsplit(', ', 1))}"
    if problem:
        raise SceneError(f"--out {path}: {problem}")
    return path


def check_overwriting(path: Path, holds: str, force: bool) -> None:
    """Raise a SceneError if a file cannot be written, or unless ``--force`` one of another command or program is there.

    Args:
        holds: what may be replaced: of HDF5 files their kind, such as "a sweep"; of JSON files "measurements with KEY",
            KEY being one that they have; of others a part of their first line.
    """
    if problem := writing_problem(path, beside=False):
        raise SceneError(f"{path}: {problem}; name another file by --out")
    if force or not path.exists():
        return
    if path.suffix.lower() == ".h5":
        from warp_plate.result.hdf5 import describe_file

        content = describe_file(path)
    else:
        text = path.read_text(encoding="utf-8", errors="replace")
        key = holds.removeprefix("measurements with ")
        content = holds if (f'\n "{key}":' in text if key != holds else holds in text.partition("\n")[0]) else ""
    if content != holds:
        what = f"is {content}" if content else "was written by another command or program"
        raise SceneError(f"{path}: {what} and would be overwritten; name another file by --out, or give --force")


def writing_problem(path: Path, beside: bool = True) -> str:
    """Return why a file or those ``beside`` it (checkpoints, pictures, temporary files) cannot be written, or ""."""
    from warp_plate.result.atomic_io import is_read_only

    if is_read_only(path):
        return "is read-only"
    if os.path.isdir(path):
        return "is a folder"
    if os.path.exists(path) and not os.path.isfile(path):
        return "is a pipe or a device; --json prints results"
    path = Path(os.path.realpath(path)) if os.path.islink(path) else path
    if os.path.islink(path):
        return "is a link that leads to itself"
    if not os.path.isdir(path.parent):
        return f"no such folder: {path.parent}"
    if not os.access(path.parent, os.W_OK):
        return f"no permission to write to the folder {path.parent}"
    added = len(LONGEST_ENDING) + 1 - len(path.suffix)
    try:
        os.stat(path.parent / (f".{path.stem}{LONGEST_ENDING}" if beside else path.name))
    except FileNotFoundError:
        return ""
    except (OSError, ValueError) as error:  # too long, or with forbidden characters
        return f"{getattr(error, 'strerror', error)}: the names of the files beside it are {added} bytes longer"
    return ""


def write_files(saves: Mapping[Path, Callable[[Path], object]], draw: Callable[[], Drawn] | None) -> Drawn:
    """Save files, completely even on Ctrl-C, draw pictures, and return the files written.

    Ctrl-C after the files are saved leaves out pictures.

    Args:
        saves: Functions that save a file, by its path.
        draw: Function that draws the pictures (default: none).
    """
    files: list[Path] = []
    try:
        with deferred_interrupts():
            for path, save in saves.items():
                save(path)
                files.append(path)
        postpone_garbage()
        drawn, missing = ([], None) if draw is None else draw()
    except KeyboardInterrupt:
        if not files or len(files) < len(saves):
            raise
        drawn, missing = [], INTERRUPTED
    except SceneError as error:
        raise SceneError("; wrote ".join(map(str, [error, *files]))) from None
    return files + drawn, missing


def write_measurements(
    path: Path,
    record: Mapping[str, object],
    draw: Callable[..., object],
    pictures: bool,
    others: Mapping[Path, Callable[[Path], object]] | None = None,
) -> Drawn:
    """Save measurements as a JSON file with their plots, and others by their functions; see :func:`write_files`."""
    from warp_plate.result.atomic_io import write_atomically
    from warp_plate.viz.plots.frame import save_plots

    save = partial(write_atomically, f"{dumps(record, indent=1)}\n".encode())
    plots = partial(save_plots, partial(draw, record), path) if pictures else None
    return write_files({path: save, **(others or {})}, plots)


def write_result(result: Result, path: Path, pictures: bool, colours: ColourOptions) -> Drawn:
    """Save a result and draw its pictures."""
    from warp_plate.result.model import save_result
    from warp_plate.viz import draw_all

    draw = partial(draw_all, result, path.with_suffix(""), colours)
    return write_files({path: partial(save_result, result)}, draw if pictures else None)
