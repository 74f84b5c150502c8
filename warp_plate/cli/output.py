"""Input and output of commands: scenes, output files, text, tables, JSON, and progress on standard error."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import stat
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from warp_plate.scene.errors import SceneError, printable

# The longest ending of the files that are written beside a result.
LONGEST_ENDING = ".checkpoint.h5.12345678.part.h5"

if TYPE_CHECKING:
    from warp_plate.result.model import Result
    from warp_plate.scene.model import Scene
    from warp_plate.studies.checkpointing import StudyFile

# Draws pictures beside a file; returns their paths and, if some are missing, the reason.
Drawn = tuple[list[Path], str | None]


class _PlainConsole(Console):
    """A console that prints text verbatim: scene titles and names are neither markup nor terminal commands."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)


def console() -> Console:
    """Return a console on standard output, wrapped to the terminal's width and without colours in a file."""
    return _PlainConsole(highlight=False, markup=False, emoji=False)


def how_to_resume(file: StudyFile[Any], command: str) -> str:
    """Return how far an unfinished study is, and the command that resumes it; "" if nothing was saved."""
    if file.saved is None:
        return ""
    return f" after {file.saved.progress}; resume with: warp-plate {command} --resume {shlex.quote(str(file.path))}"


def log(line: str) -> None:
    """Print one line on standard error."""
    print(f"warp-plate: {printable(' '.join(line.split()))}", file=sys.stderr)


def print_json(data: Mapping[str, object]) -> None:
    """Print one JSON object. Numbers that are not finite become null, since JSON has no others."""
    print(json.dumps(_finite(data), indent=2))


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value


def table(*headings: str, title: str | None = None) -> Table:
    """Return an empty table whose first column is text and whose other columns are numbers."""
    made = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for index, heading in enumerate(headings):
        made.add_column(heading, justify="left" if index == 0 else "right")
    return made


def print_uncropped(console: Console, made: Table) -> None:
    """Print a table whatever the width of the terminal: a number without its last digits is another number. Only
    headings and the first column may wrap."""
    for index, column in enumerate(made.columns):
        cells = [str(cell) for cell in column.cells]
        wrapped, fixed = ([column.header, *cells], []) if index == 0 else ([column.header], cells)
        words = [word for text in wrapped for word in str(text).split()]
        column.min_width = max(map(len, [*words, *fixed]), default=0)
    console.print(made, crop=False)


def number_text(value: float | None, digits: str, unit: str = "") -> str:
    """Format a number; "none" if it is missing or not finite."""
    return "none" if value is None or not math.isfinite(value) else f"{value:{digits}}{unit}"


def print_files(files: Sequence[Path], missing: str | None) -> None:
    """Print a line for each file written, and why others are missing."""
    for file in files:
        print(printable(f"wrote {file}"))
    if missing:
        print(printable(missing))


@contextmanager
def progress_bar(label: str, shown: bool) -> Iterator[Callable[[int, int, str], None]]:
    """Show a progress bar if standard error is a terminal; yield a function of (done, total, note) that updates it."""
    if not shown or not sys.stderr.isatty():
        yield lambda done, total, note: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(label), BarColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(label, total=None, note="")
        yield lambda done, total, note: progress.update(task, completed=done, total=total, note=note)


def load_scene(source: str, accuracy: str | None = None) -> Scene:
    """Load a scene, with ``--accuracy`` in place of its grid if that is given."""
    from warp_plate.scene import Scene

    scene = Scene.load(source)
    return scene if accuracy is None else with_accuracy_option(scene, accuracy)


def with_accuracy_option(scene: Scene, accuracy: str) -> Scene:
    """Return the scene with ``--accuracy``, such as 1% or 0.01, in place of its grid."""
    text = accuracy.strip()
    try:
        return scene.with_accuracy(float(text.removesuffix("%")) / (100 if text.endswith("%") else 1))
    except (ValueError, SceneError):
        raise SceneError(f"--accuracy {accuracy}: must be from 0.01% to 50%, such as 1% or 0.01") from None


@contextmanager
def scene_errors(source: str | None) -> Iterator[None]:
    """Prefix errors that begin with a key of the scene with the scene's file."""
    from warp_plate.scene import Scene

    try:
        yield
    except SceneError as error:
        key = re.match(r"\w*", str(error))
        if source is None or key is None or key[0] not in Scene.model_fields:
            raise
        raise SceneError(f"{source}: {error}") from None


def output_file(out: Path | None, source: str, command: str, endings: Sequence[str] = (".h5",)) -> Path:
    """Return the path of a command's file: ``out``, or SCENE-COMMAND with the first of the endings, in this folder.

    Args:
        source: the scene's name; empty for commands without a scene.
    """
    path = out or Path(f"{Path(source).stem}-{command}{endings[0]}" if source else f"{command}{endings[0]}")
    if path.suffix not in endings:
        raise SceneError(f"--out {path}: must end in {' or '.join(', '.join(endings).rsplit(', ', 1))}")
    check_writable(path)
    return path


def check_writable(path: Path) -> None:
    """Check that a file and those beside it (checkpoints, pictures, temporary files) can be written."""
    problem: str | bool
    try:
        problem = "is a folder" if stat.S_ISDIR(path.stat().st_mode) else ""
    except (FileNotFoundError, NotADirectoryError):
        problem = "" if path.parent.is_dir() else f"no such folder: {path.parent}"
    except (OSError, ValueError) as error:  # a name that is too long or contains forbidden characters
        problem = f"not a valid file name: {getattr(error, 'strerror', None) or error}"
    problem = problem or _name_too_long(path)
    if problem or not os.access(path.parent, os.W_OK):
        raise SceneError(f"--out {path}: {problem or f'no permission to write to the folder {path.parent}'}")


def _name_too_long(path: Path) -> str:
    """Return why the longest name beside a file is too long, or "". Only the system knows the limit."""
    added = len(LONGEST_ENDING) + 1 - len(path.suffix)
    try:
        path.with_name(f".{path.stem}{LONGEST_ENDING}").stat()
    except FileNotFoundError:
        pass
    except OSError as error:
        return f"{error.strerror}: the names of the files beside it are {added} bytes longer"
    return ""


def print_cost(result: Result, console: Console, start: str = "") -> None:
    """Print where a result was computed, its cost and accuracy, the effects in the compiled kernels, and warnings."""
    console.print(
        f"{start}{result.node_steps:.3g} node-steps on {result.device}, {result.path}: {result.seconds['solve']:.2f} s "
        f"solving after {result.seconds['compile']:.2f} s compiling or loading kernels. Effects compiled in: "
        f"{', '.join(result.effects) or 'none'}."
    )
    if "reason" in result.accuracy:
        console.print(f"grid chosen for {result.accuracy['reason']}")
    if "estimate" in result.accuracy:
        console.print(result.accuracy["estimate"]["line"])
    for sentence in warnings_of(result):
        console.print(f"! {sentence}")


def warnings_of(result: Result) -> list[str]:
    """Return warnings about effects that the result calls for but its scene lacks, and about search settings that have
    no effect."""
    from warp_plate.analysis.warnings import explain_missing_energies, search_warnings, warning_texts
    from warp_plate.problem.methods import unread_keys

    failed = next((case.status for case in result.cases.values() if case.status != "ok"), None)
    if failed is not None:
        return [explain_missing_energies(result.scene, failed)]
    best = result.history.get("best")
    if best is not None and len(best) and not math.isfinite(best[-1]):
        return ["No plate that the search tried has energies; the best single actuator is shown in place of a result."]
    found = [*search_warnings(result.scene), *unread_keys(result.scene.search)] if result.command == "localize" else []
    return found + warning_texts(result.case_scene(result.main_case), result.peak_displacement)


def prepare_pictures(pictures: bool) -> None:
    """Start loading what drawing needs while the command runs."""
    if pictures:
        from warp_plate.viz import prepare

        prepare()


def write_plotted(
    path: Path, save: Callable[[Path], object], draw: Callable[..., Path], data: Any, pictures: bool
) -> Drawn:
    """Save a file and, if there shall be pictures, draw its data by a plot function; see :func:`write_files`."""
    from warp_plate.viz.plots.frame import save_plots

    return write_files(path, save, (lambda path: save_plots(draw, data, path)) if pictures else None)


def write_measurements(path: Path, record: Mapping[str, object], draw: Callable[..., Path], pictures: bool) -> Drawn:
    """Save measurements as a JSON file with their plots."""
    from warp_plate.result.atomic_io import write_atomically

    text = f"{json.dumps(record, indent=1)}\n"
    return write_plotted(path, lambda path: write_atomically(text.encode(), path), draw, record, pictures)


def write_files(path: Path, save: Callable[[Path], object], draw: Callable[[Path], Drawn] | None) -> Drawn:
    """Save a file whole even if Ctrl-C comes, and draw its pictures beside it unless ``draw`` is None.

    Returns:
        The files written, and why pictures are missing, if they are.
    """
    from warp_plate.interrupts import deferred_interrupts

    files: list[Path] = []
    try:
        with deferred_interrupts():
            save(path)
            files.append(path)
        if draw is None:
            return files, None
        drawn, missing = draw(path)
    except KeyboardInterrupt:
        if not files:
            raise
        return files, "no pictures: interrupted by Ctrl-C"
    return files + drawn, missing


def write_result(result: Result, path: Path, pictures: bool) -> Drawn:
    """Save a result and draw its pictures; see :func:`write_files`."""
    from warp_plate.result import save_result
    from warp_plate.viz import draw_all

    draw = (lambda path: draw_all(result, path.with_suffix(""))) if pictures else None
    return write_files(path, lambda path: save_result(result, path), draw)
