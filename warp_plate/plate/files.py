"""Files that a scene names: found beside the scene file, bounded, and read as bytes or as a table of numbers."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

MOST_BYTES = 2**27
# Of a table, each of which takes some 150 bytes on the way.
MOST_ROWS = 2**22


def read_beside(key: str, name: str, folder: Path | None) -> bytes:
    """The content of the file ``name`` in the scene's folder, which ``key`` of the scene names.

    Raises:
        SceneError: no folder, no such file in it, or a large one; one line with key and file.
    """
    head = f"{key} = {name!r}"
    if folder is None:
        raise SceneError(f"{head}: this scene was not read from a file, so no folder is known; say which")
    try:
        path = (folder / name).resolve()
        if path.parent != folder.resolve():
            raise SceneError(f"{head}: leads out of the scene's folder; put a copy of the file there")
        if not path.is_file():
            raise SceneError(f"{head}: no such file beside the scene file")
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(f"{head}: {path.stat().st_size} bytes; at most {MOST_BYTES} are read")
        return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise SceneError(f"{head}: cannot be read: {type(error).__name__}") from None


def named_files(scene: Scene) -> dict[str, str]:
    """The files that a scene names, by the keys that name them."""
    named = {} if scene.drive.signal is None else {"drive.signal.file": scene.drive.signal.file}
    named |= {
        f"effects.variation.{key}": value for key, value in scene.effects.variation or () if isinstance(value, str)
    }
    return named | {
        f"{key}.mask": target.mask for key, target in scene.targets_by_key.items() if target.mask is not None
    }


def digests(scene: Scene) -> dict[str, str]:
    """SHA-256 of each file that a scene names, by the key that names it.

    Raises:
        SceneError: see :func:`read_beside`.
    """
    return {
        key: hashlib.sha256(read_beside(key, name, scene.folder)).hexdigest()
        for key, name in named_files(scene).items()
    }


def number_rows(data: bytes) -> list[tuple[int, list[float]]]:
    """The lines of a text table with their numbers in the file, counted from 1.

    Columns are parted by semicolons or tabs where the first line of numbers has one, else by commas; a first line
    without a number in it, empty lines and # lines are passed over.

    Raises:
        ValueError: not UTF-8, a cell is no number or has a decimal comma, lines differ in length, or there are more
            than MOST_ROWS.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("not UTF-8 text") from None
    rows: list[tuple[int, list[float]]] = []
    first, separator = True, ""
    for number, line in enumerate(io.StringIO(text), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if len(rows) == MOST_ROWS:
            raise ValueError(f"more than {MOST_ROWS} lines")
        separator = separator or next((mark for mark in ";\t" if mark in line), ",")
        cells = line.split(separator)
        if separator != "," and any("," in cell and _number(cell.replace(",", ".")) is not None for cell in cells):
            raise ValueError(f"line {number} has a comma in a number; write a decimal point, such as 1.05")
        row = [value for cell in cells if (value := _number(cell)) is not None]
        names, first = first and not row, False
        if names:
            separator = ""
            continue
        if len(row) < len(cells):
            raise ValueError(f"line {number} is not made of numbers")
        if rows and len(row) != len(rows[0][1]):
            raise ValueError(f"line {number} has {len(row)} columns instead of {len(rows[0][1])} as above it")
        rows.append((number, row))
    return rows


def _number(cell: str) -> float | None:
    """What a cell says, or None where it is no number; Python's 1_000 is none."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
