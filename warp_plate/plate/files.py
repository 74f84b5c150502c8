"""Files that a scene names: read from the scene's folder, up to a limit of size, as bytes or as tables of numbers."""

from __future__ import annotations

import hashlib
import io
from functools import lru_cache
from pathlib import Path

import numpy as np

from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

MOST_BYTES = 2**27
# Rows of a table, each of which takes some 150 bytes while it is read.
MOST_ROWS = 2**22
# Tables cached after they are read.
MOST_TABLES = 4


def read_beside(key: str, name: str, folder: Path | None) -> bytes:
    """Return the content of a file in the scene's folder.

    Args:
        key: Key of the scene that names the file.
        folder: The scene's folder; None if it was not read from a file.

    Raises:
        SceneError: There is no folder, the file is not in it, or it is too large.
    """
    head = f"{key} = {name!r}"
    if folder is None:
        raise SceneError(f"{head}: this scene was not read from a file, so its folder is unknown; give one")
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
    """Return the names of the files that a scene refers to, by key."""
    signals = {"drive.signal": scene.drive.signal, "focus.wish": scene.focus and scene.focus.wish}
    files = {f"{key}.file": signal.file for key, signal in signals.items() if signal}
    files |= scene.effects.map_files
    masks = {f"{key}.mask": target.mask for key, target in scene.targets_by_key.items()}
    return files | {key: name for key, name in masks.items() if name is not None}


def digests(scene: Scene) -> dict[str, str]:
    """Return the SHA-256 of each file that a scene names, by key."""
    files = named_files(scene)
    return {key: hashlib.sha256(read_beside(key, name, scene.folder)).hexdigest() for key, name in files.items()}


def read_table(key: str, name: str, folder: Path | None, low: float, high: float) -> np.ndarray:
    """Return (rows, columns) numbers from ``low`` to ``high`` of a text table beside the scene, see ``number_rows``.

    Raises:
        SceneError: The file cannot be read or holds no such table.
    """
    data = read_beside(key, name, folder)
    try:
        table, lines = _table(data)
        for row, column in np.argwhere(~((low <= table) & (table <= high)))[:1].tolist():
            where, value = f"line {lines[row]}, column {column + 1}", table[row, column]
            raise ValueError(f"{where}: {value:g} is no number from {low:g} to {high:g}")
    except ValueError as error:
        raise SceneError(f"{key} = {name!r}: {error}") from None
    return table


@lru_cache(MOST_TABLES)
def _table(data: bytes) -> tuple[np.ndarray, list[int]]:
    """Return the numbers of a text table, read only, and the line of each row; a plate is asked for its maps often."""
    rows = number_rows(data)
    if not rows:
        raise ValueError("holds no numbers")
    table = np.array([row for _, row in rows])
    table.flags.writeable = False
    return table, [number for number, _ in rows]


def number_rows(data: bytes) -> list[tuple[int, list[float]]]:
    """Return the rows of a text table with their line numbers, counted from 1.

    Columns are separated by semicolons or tabs if the first line of numbers has one, else by commas. A first line
    without numbers, empty lines and lines that begin with # are skipped.

    Raises:
        ValueError: The text is not UTF-8, a cell is no number or has a decimal comma, lines differ in length, or there
            are more than MOST_ROWS.
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
        heading, first = first and not row, False
        if heading:
            separator = ""
            continue
        if len(row) < len(cells):
            raise ValueError(f"line {number} is not made of numbers")
        if rows and len(row) != len(rows[0][1]):
            raise ValueError(f"line {number} has {len(row)} columns instead of {len(rows[0][1])} as above it")
        rows.append((number, row))
    return rows


def _number(cell: str) -> float | None:
    """Return the number in a cell, or None; Python's 1_000 is none."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
