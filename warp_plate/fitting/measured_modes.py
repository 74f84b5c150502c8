"""Natural frequencies and shapes that were measured, from CSV files and universal files (dataset 55)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.fitting.universal import UNIVERSAL, universal_modes
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST

MOST_BYTES, MOST_MODES = 2**22, 200
# Limits of the columns' numbers, excluded, and how they are written.
LIMITS = {
    "frequency": (SMALLEST, LARGEST, f"a number above {SMALLEST:g} and below {LARGEST:g} (hertz)"),
    "damping": (SMALLEST, 1.0, f"a ratio above {SMALLEST:g} and below 1, or empty"),
    "mode": (0.0, MOST_MODES + 1, f"a whole number from 1 to {MOST_MODES}, different in each line"),
}
# First word of columns with shapes, and the rule for their numbers.
SHAPE, NUMBER = "shape", (-LARGEST, LARGEST, f"a number of at most {LARGEST:g}")
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
        shapes: (n, points) displacements normal to the panel, of any size and phase; None if not known.
        points: (points, 2) x, y of the points of the shapes [m]; None if not known.
    """

    source: str
    frequencies: np.ndarray
    damping: np.ndarray
    numbers: np.ndarray | None = None
    shapes: np.ndarray | None = None
    points: np.ndarray | None = None


def read_modes(path: Path) -> MeasuredModes:
    """Read modes from a CSV file with a header that names the columns ``frequency``, ``damping`` and ``mode``.

    A column ``shape X Y`` holds the displacements of a point x, y [m] in each mode. Columns are separated by commas,
    semicolons or tabs. Lines that begin with #, other columns, and a unit in brackets after a name are skipped. A
    universal file (.uff, .unv) has a dataset 55 for each mode, and the places of its nodes in a dataset 15.

    Raises:
        SceneError: The file cannot be read, or holds no such table.
    """
    if path.suffix.lower() in UNIVERSAL:
        return _universal(path)
    columns = read_columns(path)
    cells = columns.get("frequency", [])
    if not 1 <= len(cells) <= MOST_MODES:
        named = ", ".join(columns)
        raise SceneError(f"{path}: needs 1 to {MOST_MODES} numbers in a column 'frequency'; the columns are: {named}")
    found = {name: _numbers(path, name, columns[name]) for name in LIMITS if name in columns}
    order = np.argsort(found.get("mode", found["frequency"]), kind="stable")
    frequencies, numbers = found["frequency"][order], found.get("mode")
    damping = found.get("damping", np.full(len(cells), math.nan))[order]
    numbers = None if numbers is None else numbers[order].astype(int)
    points = [name for name in columns if name.split()[0:1] == [SHAPE]]
    if not points:
        return MeasuredModes(str(path), frequencies, damping, numbers)
    shapes = np.stack([_numbers(path, name, columns[name]) for name in points], axis=1)[order]
    return MeasuredModes(str(path), frequencies, damping, numbers, shapes, np.array([_point(path, p) for p in points]))


def _point(path: Path, name: str) -> tuple[float, float]:
    """Return x, y [m] of a column ``shape X Y``."""
    try:
        x, y = (float(text) for text in name.split()[1:])
    except ValueError:
        raise SceneError(f"{path}: column {name[:60]!r}: write 'shape X Y' with the point in metres") from None
    return x, y


def _universal(path: Path) -> MeasuredModes:
    """Return the modes of a universal file, those that bend the panel, by rising frequency."""
    _check_file(path)
    try:
        frequencies, damping, shapes, points = universal_modes(path)
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from None
    order = np.argsort(frequencies, kind="stable")
    order = order[frequencies[order] > 0]
    if not 1 <= len(order) <= MOST_MODES or not np.all(
        (frequencies[order] > SMALLEST) & (frequencies[order] < LARGEST)
    ):
        rule = LIMITS["frequency"][2]
        raise SceneError(f"{path}: needs 1 to {MOST_MODES} modes (dataset 55); a frequency must be {rule}")
    for value in damping[order][np.isfinite(damping[order])]:
        if not SMALLEST < value < 1:
            raise SceneError(f"{path}: a damping ratio is {value:g}; must be above {SMALLEST:g} and below 1")
    if shapes is not None and not np.all(np.abs(shapes) < LARGEST):
        raise SceneError(f"{path}: a shape is not made of numbers below {LARGEST:g}")
    return MeasuredModes(
        str(path), frequencies[order], damping[order], None, None if shapes is None else shapes[order], points
    )


def _check_file(path: Path) -> None:
    """Raise a SceneError unless a file is there that is small enough."""
    if not path.is_file():
        raise SceneError(f"{path}: no such file")
    if path.stat().st_size > MOST_BYTES:
        raise SceneError(f"{path}: {path.stat().st_size} bytes; at most {MOST_BYTES} are read")


def read_columns(path: Path) -> dict[str, Cells]:
    """Return the cells of each column of a CSV file, by the names in its first line without their units."""
    try:
        _check_file(path)
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
    low, high, rule = LIMITS.get(name, NUMBER)
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
