"""Natural frequencies and shapes that were measured, from CSV files and universal files.

Universal files hold modes (dataset 55), places of nodes (15), and frequency responses with coherence (58).
"""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST

TABLE_BYTES, MOST_MODES = 2**22, 200
MODE_COLUMNS = "frequency", "damping", "mode"
# Limits of the columns' numbers, excluded, and how they are written.
LIMITS = {
    "frequency": (SMALLEST, LARGEST, f"a number above {SMALLEST:g} and below {LARGEST:g} (hertz)"),
    "damping": (SMALLEST, 1.0, f"a ratio above {SMALLEST:g} and below 1, or empty"),
    "mode": (0.0, MOST_MODES + 1, f"a whole number from 1 to {MOST_MODES}, different in each line"),
    **dict.fromkeys(
        ("x", "y", "velocity", "uncertainty"), (-SMALLEST, LARGEST, f"a number, 0 or more and below {LARGEST:g}")
    ),
}
# First word of columns with shapes, and the rule for their numbers.
SHAPE, NUMBER = "shape", (-LARGEST, LARGEST, f"a number of at most {LARGEST:g}")
UNIVERSAL = (".uff", ".unv")
# Codes of dataset 58: a frequency response, a coherence. Of dataset 55: normal modes, and complex modes of displacement
# and of velocity.
RESPONSE, COHERENCE, NORMAL, COMPLEX = 4, 6, 2, (3, 7)
# Cells of a column with the numbers of their lines.
Cells = list[tuple[int, str]]


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
        named = textwrap.shorten(", ".join(columns), 200)
        raise SceneError(f"{path}: needs 1 to {MOST_MODES} numbers in a column 'frequency'; the columns are: {named}")
    table = {name: column_numbers(path, name, columns[name]) for name in MODE_COLUMNS if name in columns}
    order = np.argsort(table.get("mode", table["frequency"]), kind="stable")
    frequencies, numbers = table["frequency"][order], table.get("mode")
    damping = table.get("damping", np.full(len(cells), math.nan))[order]
    numbers = None if numbers is None else numbers[order].astype(int)
    shaped = [name for name in columns if name.split()[0:1] == [SHAPE]]
    if not shaped:
        return MeasuredModes(str(path), frequencies, damping, numbers)
    shapes = np.stack([column_numbers(path, name, columns[name]) for name in shaped], axis=1)[order]
    points = np.array([_point(path, name) for name in shaped])
    return MeasuredModes(str(path), frequencies, damping, numbers, shapes, points)


def _point(path: Path, name: str) -> tuple[float, float]:
    """Return x, y [m] of a column ``shape X Y``."""
    try:
        x, y = (float(text) for text in name.split()[1:])
    except ValueError:
        raise SceneError(f"{path}: column {name[:60]!r}: write 'shape X Y' with the point in metres") from None
    return x, y


def _universal(path: Path) -> MeasuredModes:
    """Return the modes of a universal file that bend the panel, without shapes if nodes have no places (dataset 15)."""
    check_file(path)
    try:
        sets = _sets(path)
        modes = [item for item in sets if item.get("type") == 55 and item.get("analysis_type") in (NORMAL, *COMPLEX)]
        if not modes:
            raise ValueError("has no mode (dataset 55 of analysis type 2, 3 or 7)")
        frequencies, damping = np.array([_frequency_and_damping(item) for item in modes], dtype=float).T
        shapes, points = _shapes_and_points(sets, modes)
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


def _shapes_and_points(
    sets: Sequence[dict[str, Any]], modes: Sequence[dict[str, Any]]
) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """Return (n, points) shapes along z and (points, 2) x, y [m]; None if the nodes have no places."""
    numbers = modes[0]["node_nums"]
    if any(not np.array_equal(item["node_nums"], numbers) for item in modes):
        raise ValueError("its modes (dataset 55) are at different nodes")
    places = {
        int(number): (float(x), float(y))
        for item in sets
        if item.get("type") == 15
        for number, x, y in zip(item["node_nums"], item["x"], item["y"], strict=True)
    }
    if not places:
        return None, None
    if missing := [int(number) for number in numbers if int(number) not in places]:
        raise ValueError(f"node {missing[0]} of a mode has no place (dataset 15)")
    if any("r3" not in item for item in modes):
        raise ValueError("a mode has no motion across the plate (r3 of dataset 55)")
    for number, item in enumerate(modes, 1):
        if len(item["r3"]) != len(numbers):
            stated = f"{item['n_data_per_node']} values a node, but {len(item['r3'])} of r3 for {len(numbers)} nodes"
            raise ValueError(f"mode {number} of {len(modes)} (dataset 55): record 6 states {stated}")
    return np.array([item["r3"] for item in modes]), np.array([places[int(number)] for number in numbers])


def check_file(path: Path, most: int = TABLE_BYTES) -> None:
    """Raise a SceneError unless a file is there that is small enough."""
    if path.exists() and not path.is_file():
        raise SceneError(f"{path}: is a folder, a pipe or a device; data are read from files")
    if not path.is_file():
        raise SceneError(f"{path}: no such file")
    if path.stat().st_size > most:
        raise SceneError(f"{path}: {path.stat().st_size} bytes; at most {most} are read")


def read_columns(path: Path) -> dict[str, Cells]:
    """Return the cells of each column of a CSV file, by the names in its first line without their units."""
    try:
        check_file(path)
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
        raise SceneError(
            f"{path}: line {lines[0][0]} names two columns alike: {textwrap.shorten(', '.join(names), 200)}"
        )
    columns: dict[str, Cells] = {name: [] for name in names}
    for (number, _), row in zip(lines[1:], rows, strict=True):
        if len(row) != len(names):
            raise SceneError(f"{path}: line {number} has {len(row)} columns; the first line names {len(names)}")
        for name, cell in zip(names, row, strict=True):
            columns[name].append((number, cell))
    return columns


def column_numbers(path: Path, name: str, cells: Cells) -> np.ndarray:
    """Return the numbers of a column, NaN for empty dampings."""
    low, high, rule = LIMITS.get(name, NUMBER)
    values: list[float] = []
    for line, cell in cells:
        missing = name == "damping" and not cell
        try:
            value = math.nan if missing else float(cell)
        except ValueError:
            value = high
        if not (missing or low < value < high) or (name == "mode" and (value % 1 or value in values)):
            raise SceneError(f"{path}: line {line}, {name} = {cell[:40]!r}: must be {rule}")
        values.append(value)
    return np.array(values)


def universal_responses(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return (1 + responses, n) frequencies and responses of the datasets 58, and their (responses, n) coherences."""
    functions = [item for item in _sets(path) if item.get("type") == 58]
    sets = [item for item in functions if item.get("func_type") == RESPONSE]
    coherence = [item["data"] for item in functions if item.get("func_type") == COHERENCE]
    if not sets:
        raise ValueError("has no frequency response (dataset 58 of function type 4)")
    for number, item in enumerate(functions, 1):
        if item["num_pts"] != len(item["data"]):
            stated = f"record 7 states {item['num_pts']} points and {len(item['data'])} follow"
            raise ValueError(f"dataset 58, number {number} of {len(functions)}: {stated}")
    if any(not np.array_equal(item["x"], sets[0]["x"]) for item in functions):
        raise ValueError("its frequency responses are at different frequencies")
    columns = np.vstack([sets[0]["x"], *(item["data"] for item in sets)]).astype(complex)
    return columns, np.array(coherence, dtype=float) if len(coherence) == len(sets) else None


def _frequency_and_damping(item: dict[str, Any]) -> tuple[float, float]:
    if item["analysis_type"] == NORMAL:
        return item["freq"], item["modal_damp_vis"] or math.nan
    size = abs(item["eig"])
    return size / (2 * math.pi), -item["eig"].real / size if size else math.nan


def _sets(path: Path) -> list[dict[str, Any]]:
    """Return the datasets of a universal file."""
    try:
        import pyuff
    except ModuleNotFoundError:
        raise ValueError("universal files need pyuff: pip install 'warp-plate[uff]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyuff leaves files for Python to close
            sets = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(f"cannot be read as a universal file: {error}") from None
    return sets if isinstance(sets, list) else [sets]
