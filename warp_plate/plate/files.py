"""Files that a scene names: read from the scene's folder, up to a limit of size, as bytes or as tables of numbers."""

import hashlib
import io
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from warp_plate.row_blocks import read_only
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import read_beside

MOST_ROWS, MOST_COLUMNS = 2**22, 2**16
MOST_NUMBERS = 2**22  # of a mask or map, whose integrals need some 200 bytes for each
# Tables cached after they are read.
MOST_TABLES = 4


def digests(files: Mapping[str, str], folder: Path | None) -> dict[str, str]:
    """Return the SHA-256 of each of a scene's ``named_files``, by key."""
    return {key: hashlib.sha256(read_beside(key, name, folder)).hexdigest() for key, name in files.items()}


def read_table(key: str, name: str, folder: Path | None, low: float, high: float) -> np.ndarray:
    """Return (rows, columns) numbers from ``low`` to ``high`` of a table beside the scene, or raise a SceneError."""
    data = read_beside(key, name, folder)
    try:
        table, numbers = _table(data)
        if not table.size:
            raise ValueError("holds no numbers")
        if table.size > MOST_NUMBERS:
            raise ValueError(f"holds {table.size} numbers; at most {MOST_NUMBERS} are possible")
        for row, column in np.argwhere(~((low <= table) & (table <= high)))[:1].tolist():
            where = f"row {numbers[row]}, column {column + 1}"
            raise ValueError(f"{where}: {table[row, column]:g} is no number from {low:g} to {high:g}")
    except ValueError as error:
        raise SceneError(f"{key} = {name!r}: {error}") from None
    return table


def read_numbers(data: bytes) -> np.ndarray:
    """Return (rows, columns) numbers of a text table; (0, 0) if it has none.

    Columns are separated by semicolons or tabs if the first line of numbers has one, else by commas. A first line
    without numbers, empty lines and lines that begin with # are skipped.

    Raises:
        ValueError: The text is not UTF-8, a cell is no number, rows differ in length, or there are too many.
    """
    return _read_rows(data)[0]


def _read_rows(data: bytes) -> tuple[np.ndarray, list[int]]:
    """Return the numbers of a text table, and the line of each row in the file, from 1."""
    if (rows := max(data.count(b"\n"), data.count(b"\r"))) > MOST_ROWS:
        raise ValueError(f"{rows} rows; at most {MOST_ROWS} are read")
    try:
        text = io.StringIO(data.decode("utf-8-sig"), newline=None)
    except UnicodeDecodeError:
        raise ValueError("not UTF-8 text") from None
    lines = [(at, line) for at, line in enumerate(text, 1) if line.strip() and not line.lstrip().startswith("#")]
    if lines and (columns := 1 + max(map(lines[0][1].count, ",;\t"))) > MOST_COLUMNS:
        raise ValueError(f"{columns} columns; at most {MOST_COLUMNS} are read")
    if lines and not any(map(is_number, re.split("[,;\t]", lines[0][1]))):
        del lines[0]
    if not lines:
        return np.empty((0, 0)), []
    separator = next((mark for mark in ";\t" if mark in lines[0][1]), ",")
    number = 0

    def one_by_one() -> Iterator[str]:
        nonlocal number
        for at, line in lines:
            number = at
            yield line

    try:
        table = np.loadtxt(one_by_one(), delimiter=separator, ndmin=2, comments=None)
    except ValueError as error:  # at the line that was taken last
        reason = re.sub(r"at row \d+", f"at row {number}", str(error).partition(";")[0])
        raise ValueError(f"not a table of numbers with decimal points: {reason}") from None
    return table, [at for at, _ in lines]


@lru_cache(MOST_TABLES)
def _table(data: bytes) -> tuple[np.ndarray, list[int]]:
    """Return what :func:`_read_rows` does, read only; a plate is asked for its maps often."""
    table, numbers = _read_rows(data)
    return read_only(table)[0], numbers


def is_number(cell: str) -> bool:
    """Return whether a cell of a table is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
