"""The points of a sweep: ranges written as START:STOP:COUNT, log:START:STOP:COUNT or a,b,c, and their combination.

Keys that hold texts, such as edges and names of files, take lists alone, in which *.csv stands for all such files.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path

import numpy as np

from warp_plate.scene.errors import SceneError, plain_number, printable
from warp_plate.scene.keys import resolved_key, scalar_keys
from warp_plate.scene.model import Scene

MOST_POINTS = 1_000_000
RANGE_FORMS = "START:STOP:COUNT, log:START:STOP:COUNT or a list a,b,c"
MOST_NAMED = 4  # longer lists of texts are counted
LARGEST_INTEGER = 2**53 - 1  # sweeps hold float64 numbers, which represent every integer up to this one


@dataclass(frozen=True)
class VariedKey:
    """A key of the scene and the range of its values."""

    key: str  # one of ``scalar_keys``
    start: float = math.nan
    stop: float = math.nan
    count: int | None = None  # number of values; None if the range has none
    logarithmic: bool = False  # true if values are spaced by a constant factor
    listed: tuple[float, ...] | tuple[str, ...] = ()  # values of a list; empty for a range
    integer: bool = False  # true if the key holds an integer

    def values(self) -> np.ndarray:
        """Return the (count,) values of a grid; raise a SceneError without COUNT, or if integers are not hit."""
        if self.listed:
            values = np.array(self.listed)
        elif self.count is None:
            raise SceneError(f"--vary {self.key}: COUNT is missing; write {RANGE_FORMS}, or draw points with --samples")
        else:
            values = (np.geomspace if self.logarithmic else np.linspace)(self.start, self.stop, self.count)
        if not self.integer:
            return values
        integers = _nearest_integers(values)
        if np.isnan(integers).any():
            value = values[np.isnan(integers)][0]
            raise SceneError(f"--vary {self.key}: {value:g} is not a whole number; write a list, or another COUNT")
        return integers

    def sample(self, fractions: np.ndarray) -> np.ndarray:
        """Return the (n,) values at fractions 0 ... 1 of the range; listed values have equal parts of it."""
        if self.listed:
            return np.take(self.listed, (fractions * len(self.listed)).astype(int), mode="clip")
        low, high = min(self.start, self.stop), max(self.start, self.stop)
        if self.integer and not self.logarithmic:
            return np.minimum(np.floor(low + fractions * (high - low + 1)), high)
        values = low * (high / low) ** fractions if self.logarithmic else low + fractions * (high - low)
        return np.rint(values) if self.integer else values


@dataclass(frozen=True, eq=False)
class Plan:
    """The points of a sweep."""

    keys: tuple[str, ...]  # varied keys
    # Array of numbers or texts for each key: its values along one axis of a grid, or its value in each sample
    coordinates: tuple[np.ndarray, ...]
    logarithmic: tuple[bool, ...]  # true for each key with a logarithmic range
    sampled: bool = False  # true for samples, False for a full grid

    def __len__(self) -> int:
        return math.prod(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each key of a grid, or (samples,)."""
        return self.coordinates[0].shape if self.sampled else tuple(map(len, self.coordinates))

    @cached_property
    def points(self) -> np.ndarray:
        """Numbers and texts (points, keys) as objects; the last key of a grid changes fastest."""
        columns = [values.astype(object) for values in self.coordinates]
        if self.sampled:
            return np.stack(columns, axis=1)
        return np.stack(np.meshgrid(*columns, indexing="ij"), axis=-1).reshape(len(self), -1)

    @property
    def description(self) -> str:
        """Number of points and range of each key, for messages."""
        ranges = zip(self.keys, self.coordinates, strict=True)
        count = counted(len(self), "sample" if self.sampled else "point")
        return ", ".join([count, *(f"{key} {_range_text(values)}" for key, values in ranges)])

    def values(self, point: int) -> dict[str, float | str]:
        """Return the varied numbers and texts of a point by key."""
        return dict(zip(self.keys, self.points[point].tolist(), strict=True))

    def same(self, other: Plan) -> bool:
        """Return whether both have bit-identical points in the same order."""
        alike = (self.keys, self.sampled, self.shape) == (other.keys, other.sampled, other.shape)
        return alike and np.array_equal(self.points, other.points)


def parse_vary(scene: Scene, text: str) -> VariedKey:
    """Parse one ``--vary KEY=RANGE`` for a scene; raise a SceneError if there is no such key, or no valid range."""
    shown = f"--vary {printable(text if len(text) <= 100 else text[:97] + '...')}"
    name, equals, range_text = text.rpartition("=")
    if not equals or not name.strip():
        raise SceneError(f"{shown}: must be KEY=RANGE; write {RANGE_FORMS}")
    try:
        key = resolved_key(scene, name)
        kind = scalar_keys(scene)[key]
        if kind is str:
            return _parse_texts(key, range_text, scene.folder)
        return _parse_range(key, range_text.strip(), kind is int)
    except SceneError as error:
        raise SceneError(f"--vary {error}") from None
    except ValueError as error:
        raise SceneError(f"{shown}: {error}") from None


def parse_frequencies(text: str) -> np.ndarray:
    """Return the (frequencies,) values [Hz] of a range written as for ``--vary``; raise a SceneError if it is none."""
    try:
        values = _parse_range("frequency", text, integer=False).values()
    except ValueError as error:
        raise SceneError(f"--frequencies {printable(text[:100])}: {error}") from None
    if values.min() <= 0:
        raise SceneError(f"--frequencies {text}: all must be greater than 0 (hertz)")
    return values


def _parse_texts(key: str, text: str, folder: Path | None) -> VariedKey:
    """Return a list of texts; one with * or ? stands for the files in the scene's folder whose names match it."""
    listed: list[str] = []
    for piece in map(str.strip, text.split(",")):
        matching = [piece]
        if folder is not None and ("*" in piece or "?" in piece):
            matching = sorted(file.name for file in folder.iterdir() if fnmatchcase(file.name, piece))
            if not matching:
                raise ValueError(f"no file beside the scene file has a name like {printable(piece)}")
        listed += matching
    if not all(listed):
        raise ValueError("holds text; write a list such as a,b,c")
    if len(set(listed)) < len(listed):
        raise ValueError("a value is listed twice")
    return VariedKey(key, count=len(listed), listed=tuple(listed))


def _range_text(values: np.ndarray) -> str:
    """Return the least and the largest number, or some texts."""
    if values.dtype.kind != "U":
        return f"from {values.min():g} to {values.max():g}"
    texts = list(dict.fromkeys(values.tolist()))
    return " or ".join(texts) if len(texts) <= MOST_NAMED else f"of {len(texts)} values"


def value_text(value: float | str, digits: int = 4) -> str:
    """Return a varied value for people."""
    return value if isinstance(value, str) else f"{value:.{digits}g}"


def _parse_range(key: str, text: str, integer: bool) -> VariedKey:
    logarithmic = text.startswith("log:")
    pieces = text.removeprefix("log:").split(":")
    if len(pieces) == 1 and not logarithmic:
        listed = tuple(_parse_number(piece, key, integer) for piece in text.split(","))
        if len(set(listed)) < len(listed):
            raise ValueError("a value is listed twice")
        return VariedKey(key, min(listed), max(listed), len(listed), listed=listed, integer=integer)
    if len(pieces) not in (2, 3):
        raise ValueError(f"write {RANGE_FORMS}")
    start, stop = (_parse_number(piece, key, integer) for piece in pieces[:2])
    count = None
    if len(pieces) == 3:
        if not (pieces[2].strip().isdecimal() and 1 <= int(pieces[2][:20]) <= MOST_POINTS):
            raise ValueError(f"COUNT = {pieces[2][:40]!r}: must be a whole number from 1 to {MOST_POINTS}")
        count = int(pieces[2])
    if logarithmic and not (start > 0 and stop > 0):
        raise ValueError("both ends of a logarithmic range must be greater than 0")
    if start == stop and count != 1:
        raise ValueError("START and STOP must differ")
    if not math.isfinite(stop - start):
        raise ValueError("STOP - START must be a finite number")
    return VariedKey(key, start, stop, count, logarithmic, integer=integer)


def make_plan(varied: Sequence[VariedKey], samples: int | None = None, seed: int = 0) -> Plan:
    """Return the full grid of the varied keys, or a number of samples drawn from a Latin hypercube.

    Raises:
        SceneError: no key is varied, or one twice; there are too many points, or no whole numbers.
    """
    keys = tuple(item.key for item in varied)
    if not keys:
        raise SceneError(f"--vary: nothing is varied; write --vary KEY=RANGE, RANGE being {RANGE_FORMS}")
    if (twice := next((key for key in keys if keys.count(key) > 1), None)) is not None:
        raise SceneError(f"--vary {twice}: is varied twice")
    logarithmic = tuple(item.logarithmic for item in varied)
    if samples is not None:
        if not 1 <= samples <= MOST_POINTS:
            raise SceneError(f"--samples {samples}: must be from 1 to {MOST_POINTS}")
        if not 0 <= seed < 2**63:
            raise SceneError(f"--seed {seed}: must be a whole number from 0 to 2^63 - 1")
        from scipy.stats import qmc  # takes a second to import

        fractions = qmc.LatinHypercube(len(keys), seed=np.random.default_rng(seed)).random(samples)
        drawn = tuple(item.sample(column) for item, column in zip(varied, fractions.T, strict=True))
        return Plan(keys, drawn, logarithmic, sampled=True)
    points = math.prod(item.count or 1 for item in varied)
    if points > MOST_POINTS:
        raise SceneError(f"--vary: {points} points; at most {MOST_POINTS} are allowed (or draw some with --samples)")
    return Plan(keys, tuple(item.values() for item in varied), logarithmic)


def counted(number: int, noun: str) -> str:
    """Return "1 point", "2 points"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _nearest_integers(values: np.ndarray) -> np.ndarray:
    """Return the integers that values equal up to rounding, NaN elsewhere; geometric ranges miss them by 1e-15."""
    nearest = np.rint(values)
    return np.where(np.abs(values - nearest) <= np.minimum(1e-9 * np.abs(nearest), 1e-3), nearest, np.nan)


def _parse_number(text: str, key: str, integer: bool) -> float:
    try:
        value = plain_number(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]!r} is not a number; write {RANGE_FORMS}")
    if not integer:
        return value
    if abs(value) > LARGEST_INTEGER:
        raise ValueError(f"{text[:40].strip()} is beyond ±{LARGEST_INTEGER} (2^53 - 1); a sweep's numbers are float64")
    nearest = float(_nearest_integers(np.array(value)))
    if math.isnan(nearest):
        raise ValueError(f"{key} holds whole numbers only")
    return nearest
