"""Natural frequencies that were measured, from a CSV file with a column ``frequency``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.scene.errors import SceneError

MOST_BYTES, MOST_MODES = 2**22, 500
# Limits of the columns' numbers, excluded, and how they are written.
LIMITS = {
    "frequency": (0.0, math.inf, "a number above 0 (hertz)"),
    "damping": (0.0, 1.0, "a ratio above 0 and below 1, or empty"),
    "mode": (0.0, MOST_MODES + 1, f"a whole number from 1 to {MOST_MODES}, different in each line"),
}
# Cells of a column with the numbers of their lines.
Cells = list[tuple[int, str]]


@dataclass(frozen=True, eq=False)
class MeasuredModes:
    """Natural frequencies of a panel.

    Attributes:
        source: File that they come from.
        frequencies: (n,) [Hz]; rising, unless there are numbers.
        damping: (n,) damping ratios ζ, NaN where none was measured.
        numbers: (n,) numbers of the modes, from 1 for the lowest that is no rigid motion; None if not known.
    """

    source: str
    frequencies: np.ndarray
    damping: np.ndarray
    numbers: np.ndarray | None = None


def read_modes(path: Path) -> MeasuredModes:
    """Return the modes of a CSV file whose first line names the columns ``frequency``, ``damping`` and ``mode``.

    Columns are separated by commas, semicolons or tabs. Lines that begin with #, other columns, and a unit in brackets
    after a name are skipped.

    Raises:
        SceneError: The file cannot be read, or holds no such table.
    """
    columns = read_columns(path)
    cells = columns.get("frequency", [])
    if not 1 <= len(cells) <= MOST_MODES:
        named = ", ".join(columns)
        raise SceneError(f"{path}: needs 1 to {MOST_MODES} numbers in a column 'frequency'; the columns are: {named}")
    found = {name: _numbers(path, name, columns[name]) for name in LIMITS if name in columns}
    order = np.argsort(found.get("mode", found["frequency"]), kind="stable")
    frequencies, numbers = found["frequency"][order], found.get("mode")
    damping = found.get("damping", np.full(len(cells), math.nan))[order]
    return MeasuredModes(str(path), frequencies, damping, None if numbers is None else numbers[order].astype(int))


def read_columns(path: Path) -> dict[str, Cells]:
    """Return the cells of each column of a CSV file, by the names in its first line without their units."""
    try:
        if not path.is_file():
            raise SceneError(f"{path}: no such file")
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(f"{path}: {path.stat().st_size} bytes; at most {MOST_BYTES} are read")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read as UTF-8 text: {error}") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    if not lines:
        raise SceneError(f"{path}: is empty; its first line names the columns, such as frequency,damping")
    separator = next((mark for mark in ";\t" if mark in lines[0][1]), ",")
    heading, *rows = ([cell.strip() for cell in line.split(separator)] for _, line in lines)
    names = [name.strip('"').partition("[")[0].strip().lower() for name in heading]
    if len(set(names)) < len(names):
        raise SceneError(f"{path}: line {lines[0][0]} names two columns alike: {', '.join(names)}")
    columns: dict[str, Cells] = {name: [] for name in names}
    for (number, _), row in zip(lines[1:], rows, strict=True):
        if len(row) != len(names):
            raise SceneError(f"{path}: line {number} has {len(row)} columns; the first line names {len(names)}")
        for name, cell in zip(names, row, strict=True):
            columns[name].append((number, cell))
    return columns


def _numbers(path: Path, name: str, cells: Cells) -> np.ndarray:
    """Return the numbers of a column, NaN for empty dampings."""
    low, high, rule = LIMITS[name]
    values: list[float] = []
    for line, cell in cells:
        try:
            value = math.nan if name == "damping" and not cell else float(cell)
        except ValueError:
            value = high
        missing = name == "damping" and not cell
        if not (missing or low < value < high) or (name == "mode" and (value % 1 or value in values)):
            raise SceneError(f"{path}: line {line}, {name} = {cell[:40]!r}: must be {rule}")
        values.append(value)
    return np.array(values)
