"""What a sweep varies: ranges written as START:STOP:COUNT, log:START:STOP:COUNT or a,b,c, and the points they make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.scene.errors import SceneError, printable
from warp_plate.scene.keys import numeric_keys, resolved_key, with_numbers
from warp_plate.scene.model import Scene

MOST_POINTS = 1_000_000
FORMS = "START:STOP:COUNT, log:START:STOP:COUNT or a list a,b,c"
FORM = f"write {FORMS}"
# A sweep's numbers are float64: the largest whole one that is told from its neighbours.
LARGEST_WHOLE = 2**53 - 1
# What is so near to a whole number, as a share of it and at most, is meant to be it: equal factors miss it by 1e-15.
NEAR_WHOLE, MOST_NEAR = 1e-9, 1e-3


@dataclass(frozen=True)
class Varied:
    """One key and its range, from ``start`` to ``stop`` in ``count`` values (None: not said), logarithmic or linear; or
    ``listed`` values. whole: whether the key holds a whole number."""

    key: str
    start: float
    stop: float
    count: int | None = None
    logarithmic: bool = False
    listed: tuple[float, ...] = ()
    whole: bool = False

    def values(self) -> np.ndarray:
        """(count,) those of a grid.

        Raises:
            SceneError: no COUNT; or a value that is not whole where the key holds whole numbers.
        """
        if self.listed:
            values = np.array(self.listed)
        elif self.count is None:
            raise SceneError(f"--vary {self.key}: COUNT is missing; {FORM}, or draw points with --samples")
        else:
            space = np.geomspace if self.logarithmic else np.linspace
            values = space(self.start, self.stop, self.count)
        if not self.whole:
            return values
        whole = _nearest_whole(values)
        if np.isnan(whole).any():
            value = values[np.isnan(whole)][0]
            raise SceneError(f"--vary {self.key}: {value:g} is no whole number; write a list, or another COUNT")
        return whole

    def drawn(self, shares: np.ndarray) -> np.ndarray:
        """(n,) values at (n,) shares 0 ... 1 of the range; of a list as many of each as may be."""
        if self.listed:
            return np.array(self.listed)[np.minimum((shares * len(self.listed)).astype(int), len(self.listed) - 1)]
        low, high = min(self.start, self.stop), max(self.start, self.stop)
        if self.whole and not self.logarithmic:
            return np.minimum(np.floor(low + shares * (high - low + 1)), high)
        values = low * (high / low) ** shares if self.logarithmic else low + shares * (high - low)
        return np.rint(values) if self.whole else values


@dataclass(frozen=True, eq=False)
class Plan:
    """The points of a sweep. keys: see ``numeric_keys``; coordinates: an array for each key, of a grid its values
    along this axis, of samples its value in each. logarithmic: whether a key's range is."""

    keys: tuple[str, ...]
    coordinates: tuple[np.ndarray, ...]
    logarithmic: tuple[bool, ...]
    sampled: bool = False

    def __len__(self) -> int:
        return math.prod(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        """(values of the first key, ...) of a grid, (samples,) else."""
        return self.coordinates[0].shape if self.sampled else tuple(len(one) for one in self.coordinates)

    @cached_property
    def points(self) -> np.ndarray:
        """(points, keys) values; the last key of a grid changes fastest."""
        if self.sampled:
            return np.stack(self.coordinates, axis=1)
        return np.stack(np.meshgrid(*self.coordinates, indexing="ij"), axis=-1).reshape(len(self), -1)

    @property
    def description(self) -> str:
        """For people: how many points, and of what."""
        ranges = (
            f"{key} from {values.min():g} to {values.max():g}"
            for key, values in zip(self.keys, self.coordinates, strict=True)
        )
        return ", ".join([counted(len(self), "sample" if self.sampled else "point"), *ranges])

    def numbers(self, point: int) -> dict[str, float]:
        """The varied numbers of a point, by key."""
        return dict(zip(self.keys, self.points[point].tolist(), strict=True))

    def scene(self, scene: Scene, point: int) -> Scene:
        """The scene of a point.

        Raises:
            SceneError: see ``with_numbers``.
        """
        return with_numbers(scene, self.numbers(point))

    def same(self, other: Plan) -> bool:
        """Whether both have the same points in the same order, to the last bit."""
        alike = (self.keys, self.sampled, self.shape) == (other.keys, other.sampled, other.shape)
        return alike and np.array_equal(self.points, other.points)


def parse_vary(scene: Scene, text: str) -> Varied:
    """One ``--vary KEY=RANGE`` for a scene.

    Raises:
        SceneError: no such key, or no range; one line with both.
    """
    shown = f"--vary {printable(text if len(text) <= 100 else text[:97] + '...')}"
    named, equals, said = text.rpartition("=")
    if not equals or not named.strip():
        raise SceneError(f"{shown}: must be KEY=RANGE; {FORM}")
    try:
        key = resolved_key(scene, named)
    except SceneError as error:
        raise SceneError(f"--vary {error}") from None
    whole = numeric_keys(scene)[key] is int
    said, logarithmic = said.strip(), said.strip().startswith("log:")
    pieces = said.removeprefix("log:").split(":")
    try:
        if len(pieces) == 1 and not logarithmic:
            listed = tuple(_number(piece, key, whole) for piece in said.split(","))
            if len(set(listed)) < len(listed):
                raise ValueError("a value is there twice")
            return Varied(key, min(listed), max(listed), len(listed), listed=listed, whole=whole)
        if len(pieces) not in (2, 3):
            raise ValueError(FORM)
        start, stop = (_number(piece, key, whole) for piece in pieces[:2])
        count = _count(pieces[2]) if len(pieces) == 3 else None
    except ValueError as error:
        raise SceneError(f"{shown}: {error}") from None
    if logarithmic and not (start > 0 and stop > 0):
        raise SceneError(f"{shown}: a logarithmic range has both ends above 0")
    if start == stop and count != 1:
        raise SceneError(f"{shown}: the range has no inside; write different START and STOP")
    if not math.isfinite(stop - start):
        raise SceneError(f"{shown}: the range is too wide for a number")
    return Varied(key, start, stop, count, logarithmic, whole=whole)


def make_plan(varied: Sequence[Varied], samples: int | None = None, seed: int = 0) -> Plan:
    """The full grid of what is varied, or so many points drawn from a Latin hypercube.

    Raises:
        SceneError: nothing is varied, a key twice, too many points, or see ``Varied.values``.
    """
    keys = tuple(one.key for one in varied)
    if not keys:
        raise SceneError(f"--vary: nothing is varied; write --vary KEY=RANGE, RANGE being {FORMS}")
    for index, key in enumerate(keys):
        if key in keys[:index]:
            raise SceneError(f"--vary {key}: is varied twice")
    logarithmic = tuple(one.logarithmic for one in varied)
    if samples is not None:
        if not 1 <= samples <= MOST_POINTS:
            raise SceneError(f"--samples {samples}: must be from 1 to {MOST_POINTS}")
        if not 0 <= seed < 2**63:
            raise SceneError(f"--seed {seed}: must be a whole number from 0 to 2^63 - 1")
        from scipy.stats import qmc  # takes a second to import

        shares = qmc.LatinHypercube(len(keys), seed=np.random.default_rng(seed)).random(samples)
        return Plan(keys, tuple(one.drawn(row) for one, row in zip(varied, shares.T, strict=True)), logarithmic, True)
    points = math.prod(one.count or 1 for one in varied)
    if points > MOST_POINTS:
        raise SceneError(f"--vary: {points} points; at most {MOST_POINTS} (draw some of them with --samples)")
    return Plan(keys, tuple(one.values() for one in varied), logarithmic)


def counted(number: int, thing: str) -> str:
    """For people: "1 point", "2 points"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _nearest_whole(values: np.ndarray) -> np.ndarray:
    """The whole numbers that values are but for rounding; NaN where one is none."""
    nearest = np.rint(values)
    near = np.minimum(NEAR_WHOLE * np.abs(nearest), MOST_NEAR)
    return np.where(np.abs(values - nearest) <= near, nearest, np.nan)


def _number(text: str, key: str, whole: bool) -> float:
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]!r} is no number; {FORM}")
    if not whole:
        return value
    if abs(value) > LARGEST_WHOLE:
        raise ValueError(
            f"{text[:40].strip()} is beyond ±{LARGEST_WHOLE} (2^53 - 1), where a sweep's numbers, which are float64, "
            f"cannot hold every whole number of {key}"
        )
    nearest = float(_nearest_whole(np.array(value)))
    if math.isnan(nearest):
        raise ValueError(f"{key} holds whole numbers; write such")
    return nearest


def _count(text: str) -> int:
    if not (text.strip().isdecimal() and 1 <= int(text[:20]) <= MOST_POINTS):
        raise ValueError(f"COUNT = {text[:40]!r}: must be a whole number from 1 to {MOST_POINTS}")
    return int(text)
