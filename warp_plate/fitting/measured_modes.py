"""Natural frequencies and shapes that were measured, from text tables and universal files."""

from __future__ import annotations

import math
import os
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.fitting.measured_tables import FREQUENCY_UNITS, LENGTHS, RATIO_UNITS, Column, read_columns
from warp_plate.fitting.measured_universal import UNIVERSAL, read_universal, universal_modes
from warp_plate.scene.errors import SceneError, plain_number
from warp_plate.scene.fields import LARGEST, SMALLEST
from warp_plate.scene.fit import Fit

TABLE_BYTES, MOST_MODES = 2**22, 200
MODE_COLUMNS = "frequency", "damping", "loss factor", "mode"
DAMPING, OPTIONAL, HALF = ("damping", "loss factor"), ("damping", "loss factor", "velocity", "uncertainty"), 0.5
UNITS = {
    "frequency": FREQUENCY_UNITS,
    **dict.fromkeys(DAMPING, RATIO_UNITS),
    **dict.fromkeys(("x", "y"), LENGTHS),
}
# Part of the lowest frequency by which those of rigid motions may be below 0.
STILL = 0.1
# Limits of the columns' numbers, excluded, and how they are written.
LIMITS = {
    "frequency": (SMALLEST, LARGEST, f"a number above {SMALLEST:g} and below {LARGEST:g} (hertz)"),
    **dict.fromkeys(DAMPING, (SMALLEST, 1.0, f"a ratio above {SMALLEST:g} and below 1, or empty")),
    "mode": (0.0, MOST_MODES + 1, f"a whole number from 1 to {MOST_MODES}, different in each line"),
    **dict.fromkeys(
        ("x", "y", "velocity", "uncertainty"), (-SMALLEST, LARGEST, f"a number, 0 or more and below {LARGEST:g}")
    ),
}
# First word of columns with shapes, and the rule for their numbers.
SHAPE, NUMBER = "shape", (-LARGEST, LARGEST, f"a number of at most {LARGEST:g}")


@dataclass(frozen=True, eq=False)
class MeasuredModes:
    """Natural frequencies of a panel."""

    source: str  # file that they come from
    frequencies: np.ndarray  # (n,) [Hz]; rising, unless there are numbers
    damping: np.ndarray  # (n,) damping ratios ζ, NaN where none was measured
    # (n,) numbers of the modes, from 1 for the lowest that is no rigid motion; None if not known
    numbers: np.ndarray | None = None
    # (n, points) displacements normal to the panel, of any size and phase; None if not known
    shapes: np.ndarray | None = None
    points: np.ndarray | None = None  # (points, 2) x, y of the points of the shapes [m]; None if not known
    remarks: tuple[str, ...] = ()  # what was left out
    damping_bars: np.ndarray | None = None  # (n,) errors that damping ratios hardly exceed; None if not known


@np.errstate(all="ignore")  # of numbers that are refused in the end
def read_modes(path: Path, fit: Fit | None = None) -> MeasuredModes:
    """Read modes from a CSV file with a header that names the columns ``frequency``, ``damping`` and ``mode``.

    A column ``shape X Y`` holds the displacements of a point x, y in each mode. Columns are separated by commas,
    semicolons or tabs. Frequencies are in hertz and damping in ratios unless the header names other units; a damping
    of 0 is none. Lines above the header or that begin with #, and other columns, are skipped. A universal file (.uff,
    .unv, .ufb) has a dataset 55 or 2414 for each mode, and the places of its nodes in datasets 15 or 2411. Modes at 0
    or slightly below are rigid motions, which are skipped. ``fit`` has the origin and the unit of coordinates.

    Raises:
        SceneError: The file cannot be read, or holds no such table.
    """
    if path.suffix.lower() in UNIVERSAL:
        return _universal(path, fit)
    columns = read_table_columns(path, "frequency")
    cells = columns["frequency"].cells if "frequency" in columns else []
    if not 1 <= len(cells) <= MOST_MODES:
        named = textwrap.shorten(", ".join(columns), 200)
        raise SceneError(f"{path}: needs 1 to {MOST_MODES} numbers in a column 'frequency'; the columns are: {named}")
    table = {name: column_numbers(path, name, columns[name]) for name in MODE_COLUMNS if name in columns}
    frequencies, numbers = table["frequency"], table.get("mode")
    damping = table.get("damping", table.get("loss factor", np.full(len(cells), math.nan)))
    order = np.argsort(frequencies if numbers is None else numbers, kind="stable")
    order = order[_moving(path, columns["frequency"], frequencies)[order]]
    numbers = None if numbers is None else numbers[order].astype(int)
    shaped = [name for name in columns if name.split()[0:1] == [SHAPE]]
    shapes = points = None
    if shaped:
        shapes = np.stack([column_numbers(path, name, columns[name]) for name in shaped], axis=1)[order]
        points = np.array([_point(path, name) for name in shaped])
        points = points * (LENGTHS[fit.unit] if fit and fit.unit else 1.0) + (fit.origin if fit and fit.origin else 0.0)
    return MeasuredModes(str(path), frequencies[order], damping[order], numbers, shapes, points)


def _moving(path: Path, column: Column, frequencies: np.ndarray) -> np.ndarray:
    """Return (n,) whether modes are no rigid motions at 0 or slightly below; refuse other frequencies below 0."""
    moving = frequencies > SMALLEST
    lowest = frequencies[moving].min(initial=LARGEST)
    for at in np.flatnonzero(frequencies < -STILL * lowest)[:1]:
        line, cell = column.cells[at]
        raise SceneError(f"{path}: line {line}, frequency = {cell[:40]!r}: must be {LIMITS['frequency'][2]}")
    if not moving.any():
        raise SceneError(f"{path}: has no frequency above 0")
    return moving


def _point(path: Path, name: str) -> tuple[float, float]:
    """Return x, y of a column ``shape X Y``."""
    try:
        x, y = (float(text) for text in name.split()[1:])
    except ValueError:
        raise SceneError(f"{path}: column {name[:60]!r}: write 'shape X Y' with the point in metres") from None
    return x, y


def _universal(path: Path, fit: Fit | None) -> MeasuredModes:
    """Return the modes of a universal file that bend the panel, without shapes if nodes have no places."""
    check_file(path)
    try:
        frequencies, damping, shapes, points = universal_modes(read_universal(path), fit)
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from None
    order = np.argsort(frequencies, kind="stable")
    order = order[frequencies[order] > 0]
    frequencies, damping = frequencies[order], damping[order]
    if not 1 <= len(order) <= MOST_MODES:
        raise SceneError(f"{path}: needs 1 to {MOST_MODES} modes (dataset 55)")
    columns = {"frequency": frequencies, "damping": damping[np.isfinite(damping)]}
    columns |= {} if shapes is None else {SHAPE: np.abs(shapes[order])}
    for name, values in columns.items():
        low, high, rule = LIMITS.get(name, NUMBER)
        if not np.all((values > low) & (values < high)):
            raise SceneError(f"{path}: {name} in a mode (dataset 55): must be {rule}")
    return MeasuredModes(str(path), frequencies, damping, None, None if shapes is None else shapes[order], points)


def check_file(path: Path, most: int = TABLE_BYTES) -> None:
    """Raise a SceneError unless a file is there that may be read and is small enough."""
    if path.exists() and not path.is_file():
        raise SceneError(f"{path}: is a folder, a pipe or a device; data are read from files")
    if not path.is_file():
        raise SceneError(f"{path}: no such file")
    if not os.access(path, os.R_OK):
        raise SceneError(f"{path}: cannot be read: Permission denied")
    if path.stat().st_size > most:
        raise SceneError(f"{path}: {path.stat().st_size} bytes; at most {most} are read")


def read_table_columns(path: Path, wanted: str) -> dict[str, Column]:
    """Return the columns of a CSV file, see :func:`read_columns`."""
    try:
        check_file(path)
        return read_columns(path.read_bytes(), wanted)
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def column_numbers(path: Path, name: str, column: Column) -> np.ndarray:
    """Return the numbers of a column in SI units, NaN for damping that is empty or 0 and velocities that are empty."""
    low, high, rule = LIMITS.get(name, NUMBER)
    try:
        factor = column.heading.factor(name, UNITS[name]) if name in UNITS else 1.0
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from None
    factor *= HALF if name == "loss factor" else 1.0
    values: list[float] = []
    for line, cell in column.cells:
        missing = name in OPTIONAL and (not cell or cell.lower() == "nan")
        try:
            value = math.nan if missing else plain_number(cell) * factor
        except ValueError:
            value = high
        if value == 0 and name in DAMPING:
            value, missing = math.nan, True
        still = name == "frequency" and -LARGEST < value <= SMALLEST
        if not (missing or still or low < value < high) or (name == "mode" and (value % 1 or value in values)):
            raise SceneError(f"{path}: line {line}, {name} = {cell[:40]!r}: must be {rule}")
        values.append(value)
    return np.array(values)
