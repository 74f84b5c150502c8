"""What commands print: a table for people, one JSON object for programs, progress on standard error."""

from __future__ import annotations

import json
import math
import os
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from warp_plate.scene.errors import SceneError, printable

# Of the files beside a result, while they are written.
LONGEST_ENDING = ".checkpoint.h5.12345678.part.h5"

if TYPE_CHECKING:
    from collections.abc import Callable

    from warp_plate.result.model import Case, Result
    from warp_plate.scene.model import Scene


def print_json(data: Mapping[str, object]) -> None:
    """One JSON object and nothing else; numbers that are not finite become null, which JSON has."""
    print(json.dumps(_finite(data), indent=2))


class _PlainConsole(Console):
    """Prints text as it stands: what a scene calls itself is neither markup nor a command to the terminal."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)


def console() -> Console:
    """Standard output, wrapped to the terminal's width and plain when it is a file."""
    return _PlainConsole(highlight=False, markup=False, emoji=False)


def tell(line: str) -> None:
    """One line for people on standard error."""
    print(f"warp-plate: {printable(' '.join(line.split()))}", file=sys.stderr)


def table(*headings: str, title: str | None = None) -> Table:
    """An empty table whose first column is text and whose other columns are numbers."""
    made = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for index, heading in enumerate(headings):
        made.add_column(heading, justify="left" if index == 0 else "right")
    return made


def known(value: float | None, digits: str, unit: str = "") -> str:
    """A number for people; none where there is no such number."""
    return "none" if value is None or not math.isfinite(value) else f"{value:{digits}}{unit}"


@contextmanager
def progress_bar(label: str, shown: bool) -> Iterator[Callable[[int, int, str], None]]:
    """A bar with time left where standard error is a terminal; the yielded function takes (done, total, note)."""
    if not shown or not sys.stderr.isatty():
        yield lambda done, total, note: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(label), BarColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(label, total=None, note="")
        yield lambda done, total, note: progress.update(task, completed=done, total=total, note=note)


def print_whole(console: Console, made: Table) -> None:
    """Print a table of which nothing is cut, whatever the window's width: a number without its end is another number.
    Headings and the first column, which is text, may take several lines."""
    for index, column in enumerate(made.columns):
        cells = [str(cell) for cell in column.cells]
        texts, whole = ([column.header, *cells], []) if index == 0 else ([column.header], cells)
        words = [word for text in texts for word in str(text).split()]
        column.min_width = max(map(len, [*words, *whole]), default=0)
    console.print(made, crop=False)


def drive_table(case: Case, scene: Scene, target: str = "") -> Table:
    """A drive as the source paper's Table 1 gives it, and after it what else was found; target: of several."""
    headings = ("actuator", f"magnitude ({scene.drive_unit})", "phase (rad)", "phase / π", *case.per_actuator)
    made = table(*headings, title=f"Drive found{f' for {printable(target)}' if target else ''}")
    for index, actuator in enumerate(scene.actuators):
        magnitude, phase = case.magnitude[index], case.phase[index]
        own = (f"{values[index]:.5g}" for values in case.per_actuator.values())
        made.add_row(actuator.name, f"{magnitude:.4f}", f"{phase:.4f}", f"{phase / math.pi:.4f}", *own)
    return made


def drive_json(case: Case, scene: Scene) -> list[dict[str, object]]:
    """A drive for ``--json``, an object for each actuator; with what the search gave it of its own."""
    own = {"frequency": case.frequency, "centre": case.centre, "delay": case.delay}
    return [
        {
            "actuator": actuator.name,
            "magnitude": float(case.magnitude[index]),
            "phase": float(case.phase[index]),
            **{name: values[index].tolist() for name, values in own.items() if values is not None},
        }
        for index, actuator in enumerate(scene.actuators)
    ]


def output_file(out: Path | None, source: str, command: str, endings: Sequence[str] = (".h5",)) -> Path:
    """Where a command's file goes: ``out``, or SCENE-COMMAND with the first of the endings, in this folder.

    source: the name given as SCENE, empty where a command takes none.

    Raises:
        SceneError: another ending, or see :func:`refuse_place`; said before any work is done.
    """
    path = out or Path(f"{Path(source).stem}-{command}{endings[0]}" if source else f"{command}{endings[0]}")
    if path.suffix not in endings:
        raise SceneError(f"--out {path}: must end in {' or '.join(', '.join(endings).rsplit(', ', 1))}")
    refuse_place(path)
    return path


def refuse_place(path: Path) -> None:
    """Nothing, where a file of that name and those beside it (checkpoints, pictures, unfinished ones) can be made.

    Raises:
        SceneError: no file can be made there, its name leaves those no room, or its folder is missing.
    """
    there: str | bool
    try:
        there = "is a folder" if stat.S_ISDIR(path.stat().st_mode) else ""
    except (FileNotFoundError, NotADirectoryError):
        there = "" if path.parent.is_dir() else f"no such folder: {path.parent}"
    except (OSError, ValueError) as error:  # a name too long, or with characters that no name may have
        there = f"no name for a file: {getattr(error, 'strerror', None) or error}"
    there = there or _no_room_beside(path)
    if there or not os.access(path.parent, os.W_OK):
        raise SceneError(f"--out {path}: {there or f'no permission to write to the folder {path.parent}'}")


def _no_room_beside(path: Path) -> str:
    """Why the longest name of those beside a file is none, if so: the system alone knows how long one may be."""
    try:
        path.with_name(f".{path.stem}{LONGEST_ENDING}").stat()
    except FileNotFoundError:
        return ""
    except OSError as error:
        added = len(LONGEST_ENDING) + 1 - len(path.suffix)
        return f"{error.strerror}: those of the files beside it take {added} bytes more"
    return ""


def load_scene(
    source: str, accuracy: str | None = None, allow_unstable: bool = False, searched: bool = False
) -> Scene:
    """The scene, with the checks that need its grid already made, so that their errors name the file as well.

    accuracy: what ``--accuracy`` says; it takes the place of the scene's grid. allow_unstable: whether its time step
    may be above the limit. searched: whether what its search frees must fit too.

    Raises:
        SceneError: see ``Scene.load``, ``make_scheme``, ``patches`` and ``parametrization_of``; or no accuracy.
    """
    from warp_plate.plate.scheme import make_scheme
    from warp_plate.plate.weights import patches, region_weights
    from warp_plate.result.crosstalk import target_regions
    from warp_plate.scene import Scene

    scene = Scene.load(source)
    if accuracy is not None:
        scene = with_asked_accuracy(scene, accuracy)
    if scene.grid.accuracy is not None:
        return scene
    try:
        make_scheme(scene, allow_unstable)
        patches(scene)
        region_weights(scene, target_regions(scene))
        if searched:
            from warp_plate.problem.design_variables import with_common_step
            from warp_plate.problem.parametrization import parametrization_of

            parametrization_of(with_common_step(scene))
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from None
    return scene


def with_asked_accuracy(scene: Scene, accuracy: str) -> Scene:
    """The scene with what ``--accuracy`` says in the place of its grid.

    Raises:
        SceneError: no accuracy.
    """

    try:
        return scene.with_accuracy(_accuracy_of(accuracy))
    except SceneError:
        raise SceneError(f"--accuracy {accuracy}: must be from 0.01% to 50%, such as 1% or 0.01") from None


def _accuracy_of(text: str) -> float:
    """What ``--accuracy`` asks for, 1% or 0.01.

    Raises:
        SceneError: neither a number nor a percentage.
    """
    number = text.strip().removesuffix("%")
    try:
        return float(number) / (100 if text.strip().endswith("%") else 1)
    except ValueError:
        raise SceneError("not a number") from None


def print_accuracy(result: Result, console: Console) -> None:
    """Why the grid was chosen, if it was, and the estimate of the result's error."""
    known = result.accuracy
    if "reason" in known:
        console.print(f"grid chosen for {known['reason']}")
    if "estimate" in known:
        console.print(known["estimate"]["line"])


def warnings_of(result: Result) -> list[str]:
    """What the result's scene calls for but does not name, going by the drive that was asked for or found; and what its
    search says in vain."""
    from warp_plate.analysis.warnings import explain_missing_energies, search_warnings, warning_texts
    from warp_plate.problem.methods import unread_keys

    lost = next((one.status for one in result.cases.values() if one.status != "ok"), None)
    if lost is not None:
        return [explain_missing_energies(result.scene, lost)]
    best = result.history.get("best")
    if best is not None and len(best) and not math.isfinite(best[-1]):
        return ["No plate that the search tried has energies: the best single actuator stands for what it should find."]
    found = [*search_warnings(result.scene), *unread_keys(result.scene.search)] if result.command == "localize" else []
    return found + warning_texts(result.case_scene(result.main_case), result.peak_displacement)


def print_warnings(result: Result, console: Console) -> None:
    """One line for each of ``warnings_of``."""
    for sentence in warnings_of(result):
        console.print(f"! {sentence}")


def prepare_pictures(pictures: bool) -> None:
    """Let what drawing needs get ready beside the run."""
    if pictures:
        from warp_plate.viz import prepare

        prepare()


def write_files(result: Result, path: Path, pictures: bool) -> tuple[list[Path], str | None]:
    """Save the result and draw its pictures beside it; returns the files, and why a picture is missing."""
    from warp_plate.interrupts import deferred_interrupts
    from warp_plate.result import save_result

    files = []
    try:
        with deferred_interrupts():
            files.append(save_result(result, path))
        if not pictures:
            return files, None
        from warp_plate.viz import draw_all

        drawn, missing = draw_all(result, path.with_suffix(""))
    except KeyboardInterrupt:
        if not files:
            raise
        return files, "no pictures: interrupted by Ctrl-C"
    return files + drawn, missing


def print_files(files: Sequence[Path], missing: str | None) -> None:
    """A line for each file written, and why others are missing."""
    for file in files:
        print(printable(f"wrote {file}"))
    if missing:
        print(printable(missing))


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value
