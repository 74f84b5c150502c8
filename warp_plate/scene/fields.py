"""What every table of the scene file has in common."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

# Far beyond any panel on both sides, and so near to one that fourth powers and products of several are still numbers.
SMALLEST, LARGEST = 1e-30, 1e30
# Part of a side that an area must cover; what is less would be lost in float32.
NARROWEST = 1e-6


class Table(BaseModel):
    """A table of the scene file: unknown keys are refused, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _moderate(value: float) -> float:
    if value and not SMALLEST <= abs(value) <= LARGEST:
        raise PydanticCustomError("moderate", f"must be 0, or of a size from {SMALLEST:g} to {LARGEST:g}")
    return value


def _not_zero(value: float) -> float:
    if value == 0:
        raise PydanticCustomError("not_zero", "must not be 0, which leaves nothing of the drive")
    return value


def _without(letter: str, words: str) -> Callable[[str], str]:
    """A check that a text has no such letter, which errors call by these words."""

    def checked(text: str) -> str:
        if letter in text:
            raise PydanticCustomError("letter", f"must be a text without {words}")
        return text

    return checked


Moderate = Annotated[float, AfterValidator(_moderate)]
Gain = Annotated[Moderate, AfterValidator(_not_zero)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_moderate)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_moderate)]
# What nothing is divided by may be as small as it likes.
Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Instant = Annotated[float, Field(ge=0, le=LARGEST)]
Area = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
# TOML has true and false: no text and no number that may stand for one of them.
Flag = Annotated[bool, Field(strict=True)]
# HDF5 cannot keep a text with a NUL in it.
Text = Annotated[str, AfterValidator(_without("\0", "the character NUL"))]
Name = Annotated[str, Field(min_length=1), AfterValidator(_without("\0", "the character NUL"))]
# What stands in the names of a result's datasets.
PartName = Annotated[Name, AfterValidator(_without("/", "'/'"))]


# A name, not a way: no folders, no drive letters, no line breaks.
_NAME = re.compile(r"[^/\\:\x00-\x1f\x7f]+")


def check_file_name(key: str, name: str, endings: tuple[str, ...]) -> None:
    """Raise ValueError, naming ``key``, unless this is a name without folders and with one of these endings."""
    if not _NAME.fullmatch(name) or not name.lower().endswith(endings) or name.lower() in endings:
        shown = name if len(name) <= 60 else name[:57] + "..."
        raise ValueError(
            f"{key}: {shown!r} is not the name of a {' or '.join(endings)} file; it lies beside the scene file, and is "
            "written without folders"
        )


def check_area(key: str, area: Area, size: tuple[float, float]) -> None:
    """Raise ValueError, naming ``key``, unless the rectangle has an inside and lies on the plate."""
    x0, x1, y0, y1 = area
    if x1 <= x0 or y1 <= y0:
        raise ValueError(f"{key}: {list(area)} has no inside; write x0, x1, y0, y1 with x0 < x1 and y0 < y1")
    slack_x, slack_y = (1e-9 * side for side in size)
    if x0 < -slack_x or y0 < -slack_y or x1 > size[0] + slack_x or y1 > size[1] + slack_y:
        raise ValueError(
            f"{key}: {list(area)} reaches off the plate; x must stay in 0 ... {size[0]:g}, "
            f"y in 0 ... {size[1]:g} (metres)"
        )
    for low, high, side, axis in ((x0, x1, size[0], "x"), (y0, y1, size[1], "y")):
        if high - low < NARROWEST * side:
            raise ValueError(
                f"{key}: {list(area)} is {high - low:.3g} m wide along {axis}; at least {NARROWEST:g} of the plate's "
                f"side are needed, {NARROWEST * side:.3g} m"
            )
