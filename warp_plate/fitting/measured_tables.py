"""Text tables of measurements: their encoding, separators and decimal marks, and the units that their headings name.

A response H with a unit of the order k in time (0 for displacement, 1 for velocity, 2 for acceleration, per force) and
with a factor to SI units becomes one of the order n as (iω)ⁿ⁻ᵏ times the factor.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.plate.files import is_number, read_numbers

GRAVITY, POUND = 9.80665, 4.4482216152605
# Factors of units to Hz, 1, rad and s, and of motions (order in time, factor to SI units) and forces.
FREQUENCY_UNITS = {
    "hz": 1.0, "khz": 1e3, "1/s": 1.0, "rad/s": 0.5 / math.pi, "krad/s": 500 / math.pi, "rpm": 1 / 60, "1/min": 1 / 60,
}  # fmt: skip
RATIO_UNITS = {"1": 1.0, "-": 1.0, "%": 0.01, "percent": 0.01, "pct": 0.01}
PHASE_UNITS = {"rad": 1.0, **dict.fromkeys(("deg", "degree", "degrees", "°", "grad"), math.pi / 180)}
TIME_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6}
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
MOTION_UNITS = {
    f"{name}{'/s' * (order > 0)}{'2' * (order > 1)}": (order, factor)
    for name, factor in LENGTHS.items()
    for order in range(3)
} | {"g": (2, GRAVITY), "gn": (2, GRAVITY)}
FORCE_UNITS = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "lbf": POUND, "lb": POUND, "kgf": GRAVITY}


def _written(motion: str, force: str) -> tuple[str, ...]:
    """Return how a motion per force is written without brackets: m/s2/n, m/s2n of m/(s² N), m/ns2 of m/(N s²)."""
    return (f"{motion}/{force}", *((f"{motion}{force}", motion.replace("/", f"/{force}")) if "/" in motion else ()))


RESPONSE_UNITS = {
    written: (order, factor / per)
    for motion, (order, factor) in MOTION_UNITS.items()
    for force, per in FORCE_UNITS.items()
    for written in _written(motion, force)
} | {"1/kg": (2, 1.0), "s/kg": (1, 1.0), "s2/kg": (0, 1.0)}
# Words of headings, and those after which a heading is that of something else.
WORDS = {
    "coherence": ("coherence", "coh", "kohärenz"),
    "magnitude": ("magnitude", "mag", "amplitude", "ampl", "abs", "absolute", "betrag", "modulus", "level", "|"),
    "phase": ("phase", "arg", "angle", "winkel"),
    "real": ("real", "re", "realteil"),
    "imaginary": ("imaginary", "imag", "im", "imaginärteil"),
    "frequency": ("frequency", "frequencies", "freq", "frequenz", "eigenfrequenz", "fréquence", "f"),
    "time": ("time", "zeit", "temps", "t"),
}
KIND_OF = {word: kind for kind, words in WORDS.items() for word in words}
# Names of columns of modes and of velocities, and what they are.
ALIASES = {
    alias: name
    for name, aliases in {
        "frequency": ("frequencies", "freq", "natural frequency", "eigenfrequency", "frequenz", "eigenfrequenz"),
        "damping": ("damping ratio", "zeta", "ζ", "dämpfung", "dämpfungsgrad"),
        "mode": ("mode number", "mode no."),
        **dict.fromkeys(("x", "y", "velocity", "uncertainty", "loss factor"), ()),
    }.items()
    for alias in (name, *aliases)
}
OTHERS = ("error", "relative", "bound", "mean", "localization")
_BRACKETS = re.compile(r"^(.*)[\[(]((?:[^\[\]()]|\([^()]*\))*)[\])]\s*$")
_REFERENCE = re.compile(r"^db\W*(?:(?:reference|rel|ref|re)\b)?\.?:?\s*1?\s*", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?", re.IGNORECASE)
_BARE_UNITS = sorted({*FREQUENCY_UNITS, *RATIO_UNITS, *PHASE_UNITS, "db"} - {"1", "-"}, key=len, reverse=True)
_AFTER_NAME = re.compile(rf"^(.+?)(?:\s*/\s*|\s+in\s+|[_,\s]\s*)({'|'.join(map(re.escape, _BARE_UNITS))})$", re.I)
HEAD = 200  # lines among which the first one of numbers is


@dataclass(frozen=True)
class Heading:
    """The heading of a column."""

    text: str  # as it is written
    name: str  # in small letters, without the unit
    unit: str  # "" if there is none

    @property
    def kind(self) -> str | None:
        """The kind of number, one of ``WORDS``, by the first of these words; None if there is none."""
        words = re.findall(r"[^\W\d_]+|\|", self.name)
        known = (word for word in words if word in KIND_OF or word in OTHERS)
        return KIND_OF.get(next(known, ""))

    def factor(self, what: str, units: dict[str, float]) -> float:
        """Return the factor of the unit, 1 without one; ValueError: it is not among ``units``."""
        exact = {"MHz": 1e6, "mHz": 1e-3} if units is FREQUENCY_UNITS else {}
        if self.unit in exact:
            return exact[self.unit]
        unit = _plain(self.unit).replace("sec", "s") if units is not TIME_UNITS else _plain(self.unit)
        if unit and unit not in units:
            raise ValueError(f"column {self.text[:60]!r}: the unit of a {what} must be {', '.join(units)}")
        return units[unit] if unit else 1.0


def heading(text: str, unit: str = "") -> Heading:
    """Return the heading of a cell, and maybe of the cell with the unit below it."""
    text = " ".join(text.strip().strip('"').split())
    found = _BRACKETS.match(text) or _AFTER_NAME.match(text)
    name, own = found.groups() if found else (text, "")
    return Heading(text, name.strip().replace("_", " ").lower(), (own or unit.strip().strip("[]()")).strip())


def _plain(unit: str) -> str:
    """Return a unit in small letters without brackets, signs of powers and products."""
    unit = unit.replace("²", "2").replace("µ", "u").replace("μ", "u").lower()
    return re.sub(r"[\s^*·()\[\]]", "", unit)


def motion_unit(unit: str) -> tuple[int, float] | None:
    """Return the order in time and the factor to SI units of a motion's unit; None if it is not known."""
    return MOTION_UNITS.get(_plain(unit).replace("sec", "s").replace("s/s", "s2"))


def response_unit(unit: str) -> tuple[int, float] | None:
    """Return the order in time and the factor to SI units of a response's unit; None if it is not known."""
    return RESPONSE_UNITS.get(_plain(unit).replace("sec", "s"))


def decode(data: bytes) -> str:
    """Return the text of a file in UTF-8, UTF-16 or Latin-1; ValueError: it is no text."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    elif b"\0" in data[:2]:
        encodings = ["utf-16-be" if data[0] == 0 else "utf-16-le"]
    else:
        encodings = ["utf-8-sig", *["latin-1"] * (not re.search(rb"[\0-\x08\x0e-\x1f\x7f-\x9f]", data))]
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise ValueError("cannot be read as UTF-8 or UTF-16 text")


def numbered_lines(data: bytes) -> tuple[list[tuple[int, str]], str | None]:
    """Return the lines of a text with their numbers, without empty ones, and the separator of a line ``sep=``."""
    text = io.StringIO(decode(data), newline=None)
    lines = [(number, line.rstrip("\n")) for number, line in enumerate(text, 1) if line.strip()]
    stated = re.fullmatch(r"\"?sep=(.)\"?\s*", lines[0][1]) if lines else None
    return (lines[1:], stated[1]) if stated else (lines, None)


def split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes; None separates by spaces. ValueError: a cell is too long."""
    if separator is None:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except csv.Error:
        raise ValueError(f"a cell has more than {csv.field_size_limit()} characters") from None


def decimal(cell: str) -> str:
    """Return a cell with a decimal point in place of a comma."""
    return cell.replace(",", ".") if "," in cell and _DECIMAL_COMMA.fullmatch(cell.strip()) else cell


def is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether a line below the headings holds units."""
    known = {*FREQUENCY_UNITS, *PHASE_UNITS, *TIME_UNITS, *RATIO_UNITS, *MOTION_UNITS, *FORCE_UNITS, "db"}
    plain = [_plain(cell) for cell in cells if cell]
    return bool(plain) and any(cell in known for cell in plain) and not any(map(is_number, cells))


@dataclass(frozen=True, eq=False)
class NumberTable:
    """A table of numbers with the headings above it."""

    headings: tuple[Heading, ...]  # of the columns; () if there are none
    values: np.ndarray  # (rows, columns)


def read_number_table(data: bytes) -> NumberTable:
    """Return the numbers of a text table.

    Lines above the first line of numbers are skipped but for headings, the last line there with as many cells, and
    units below them. Columns are separated by semicolons, tabs, commas or spaces; decimal commas need one of the
    others, or quotes.

    Raises:
        ValueError: It is no text, a cell is no number, or rows differ in length.
    """
    lines, stated = numbered_lines(data)
    found = next(((at, cells) for at, cells in enumerate(_splits(lines, stated)) if cells is not None), None)
    if found is None:
        return NumberTable((), read_numbers("\n".join(line for _, line in lines).encode()))
    at, (separator, cells) = found
    above = [split(line.lstrip("# "), separator) for _, line in lines[:at]]
    above = [row for row in above if len(row) == len(cells)]
    units = above.pop() if len(above) > 1 and is_unit_row(above[-1]) else [""] * len(cells)
    names = tuple(map(heading, above[-1], units)) if above else ()
    body = [(number, line) for number, line in lines[at:] if not line.lstrip().startswith("#")]
    return NumberTable(names, read_numbers(_normalised(body, separator).encode()))


def _splits(lines: list[tuple[int, str]], stated: str | None) -> Sequence[tuple[str | None, list[str]] | None]:
    """Return separator and cells of the first lines, None for those that are not numbers."""
    found: list[tuple[str | None, list[str]] | None] = []
    for _, line in lines[:HEAD]:
        separators = [stated] if stated else [mark for mark in ";\t," if mark in line] + [None]
        rows = [] if line.lstrip().startswith("#") else [(mark, split(line, mark)) for mark in separators]
        numbers = (
            (mark, row) for mark, row in rows if any(row) and all(is_number(decimal(cell)) for cell in row if cell)
        )
        found.append(next(numbers, None))
        if found[-1] is not None:
            break
    return found


def _normalised(lines: list[tuple[int, str]], separator: str | None) -> str:
    """Return the lines, each at its number, with commas between cells and decimal points."""
    rows, before = [], 0
    for number, line in lines:
        rows += [""] * (number - before - 1)
        if separator == "," and '"' not in line:
            rows.append(line)
        elif separator is not None and '"' not in line:
            rows.append(line.replace(",", ".").replace(separator, ","))
        else:
            rows.append(",".join(decimal(cell) for cell in split(line, separator)))
        before = number
    return "\n".join(rows)


# Units (order in time, factor to SI units) of responses or channels; None where none is named.
Units = list[tuple[int, float] | None]


def read_response_table(data: bytes) -> tuple[np.ndarray, np.ndarray | None, Units]:
    """Return (1 + responses, n) frequencies and responses of a text table, their coherences, and their units.

    Headings that name real and imaginary parts, or magnitudes and phases, say which columns these are. Without such
    headings, the columns are frequency, real and imaginary part of the first response, and so on.

    Raises:
        ValueError: There is no such table, or headings contradict one another.
    """
    table = read_number_table(data)
    if table.values.size == 0 or table.values.shape[1] < 3:
        raise ValueError("needs the columns frequency, real and imaginary part of each response")
    if table.headings and table.headings[0].kind == "time":
        raise ValueError("its first column is time; write [fit.signals] for time signals")
    columns: dict[str | None, list[int]] = {}
    for index, each in enumerate(table.headings):
        columns.setdefault(each.kind, []).append(index)
    first = columns.get("frequency", [0])[0]
    frequencies = table.values[:, first]
    if table.headings:
        frequencies = frequencies * table.headings[first].factor("frequency", FREQUENCY_UNITS)
    pairs, polar = _pairs(table, columns)
    if pairs is None:
        count = (table.values.shape[1] - 1) // 2
        pairs = [(1 + 2 * index, 2 + 2 * index) for index in range(count)]
    responses, units = [], []
    for one, other in pairs:
        names = [table.headings[index] for index in (one, other)] if table.headings else []
        values = table.values[:, [one, other]].T
        responses.append(_polar(values, names) if polar else values[0] + 1j * values[1])
        units.append(_unit_of(names[:1] if polar else names))
    coherence = columns.get("coherence", [])
    of = table.values[:, coherence].T if len(coherence) == len(pairs) else None
    if of is not None:
        of = of * np.array([[table.headings[index].factor("coherence", RATIO_UNITS)] for index in coherence])
    return np.vstack([frequencies, *responses]), of, units


def _pairs(table: NumberTable, columns: dict[str | None, list[int]]) -> tuple[list[tuple[int, int]] | None, bool]:
    """Return the pairs of columns of responses, None if no heading names one, and whether they are polar."""
    for one, other, polar in (("real", "imaginary", False), ("magnitude", "phase", True)):
        first, second = columns.get(one, []), columns.get(other, [])
        if first and len(first) == len(second):
            return list(zip(first, second, strict=True)), polar
    for one, other in (("real", "imaginary"), ("magnitude", "phase")):
        if len(columns.get(one, [])) != len(columns.get(other, [])):
            names = [table.headings[index].text for kind in (one, other) for index in columns.get(kind, [])]
            raise ValueError(
                f"headings {', '.join(map(repr, names[:4]))}: each response needs a {one} and a {other} column"
            )
    return None, False


def _polar(values: np.ndarray, names: list[Heading]) -> np.ndarray:
    """Return complex numbers of magnitudes, maybe in decibels, and phases (2, n)."""
    size, angle = values
    if not names[1].unit:
        raise ValueError(f"column {names[1].text[:60]!r}: name its unit, such as 'Phase (deg)' or 'Phase (rad)'")
    if _plain(names[0].unit).startswith("db"):
        size = 10 ** (np.minimum(size, 6000) / 20)
    elif np.any(size < 0):
        raise ValueError(f"column {names[0].text[:60]!r}: is negative; if it is in decibels, write 'Magnitude (dB)'")
    return np.asarray(size * np.exp(1j * angle * names[1].factor("phase", PHASE_UNITS)))


def _unit_of(names: list[Heading]) -> tuple[int, float] | None:
    """Return the unit that the headings of a response name, or raise a ValueError if there are two."""
    bare = [_REFERENCE.sub("", each.unit) for each in names]
    units = {response_unit(unit) for unit in bare} - {None}
    if len(units) > 1:
        raise ValueError(f"headings {' and '.join(repr(each.text[:60]) for each in names)} name different units")
    return units.pop() if units else None


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a table with a header."""

    heading: Heading
    cells: list[tuple[int, str]]  # with the numbers of their lines


def read_columns(data: bytes, wanted: str) -> dict[str, Column]:
    """Return the columns of a text table by the names in its header, the first line that names one of ``wanted``.

    Without such a line, the header is the first line. Lines above it and those that begin with # are skipped, and a
    line below it may hold units.

    Raises:
        ValueError: It is no text, has no lines, names two columns alike, or a line has another number of columns.
    """
    lines, separator = numbered_lines(data)
    lines = [(number, line) for number, line in lines if not line.startswith("#")]
    if not lines:
        raise ValueError("is empty; its first line names the columns, such as frequency,damping")

    def named(line: str) -> list[Heading]:
        mark = separator or next((mark for mark in ";\t" if mark in line), ",")
        return [heading(cell) for cell in split(line, mark)]

    at = next((i for i, (_, line) in enumerate(lines) if any(ALIASES.get(h.name) == wanted for h in named(line))), 0)
    number, line = lines[at]
    separator = separator or next((mark for mark in ";\t" if mark in line), ",")
    rows = [(number, split(line, separator)) for number, line in lines[at:]]
    units = rows.pop(1)[1] if len(rows) > 1 and len(rows[1][1]) == len(rows[0][1]) and is_unit_row(rows[1][1]) else []
    headings = list(map(heading, rows[0][1], units or [""] * len(rows[0][1])))
    names = [ALIASES.get(each.name, each.name) for each in headings]
    if len(set(names)) < len(names):
        shown = textwrap.shorten(", ".join(names), 200)
        raise ValueError(f"line {number} names two columns alike: {shown}")
    columns = {name: Column(each, []) for name, each in zip(names, headings, strict=True)}
    for number, row in rows[1:]:
        if len(row) != len(names):
            decimals = "; columns with decimal commas are separated by semicolons" if len(row) == 2 * len(names) else ""
            raise ValueError(f"line {number} has {len(row)} columns; the first line names {len(names)}{decimals}")
        for column, cell in zip(columns.values(), row, strict=True):
            column.cells.append((number, decimal(cell)))
    return columns
